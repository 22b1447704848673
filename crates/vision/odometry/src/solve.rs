//! The least squares problem of a window: linearised, landmarks eliminated, solved.
//!
//! Levenberg-Marquardt on manifolds; each landmark has one number, its inverse range, which is eliminated where it is
//! linearised (Schur complement). Sights are weighed by Huber's function. Landmarks are summed in pieces of a fixed size, one after
//! another within a piece and pieces in order, so that the sum is the same on any number of threads.

use nalgebra::{DMatrix, DVector, SMatrix, SVector, Vector2, Vector3};
use rayon::prelude::*;

use crate::motion;
use crate::mount::{by_mounts, move_by};
use crate::sight::{Bearing, Camera, Placed, Sight, carry};
use crate::so3;
use crate::state::{Error, POSE, SIZE, State};
use crate::window::{Landmark, Window};

/// Landmarks per piece.
const PIECE: usize = 48;
/// Residual, in standard deviations, from which Huber's function is straight.
const HUBER: f64 = 1.5;
/// Least inverse range, 1/m: farther is as good as infinitely far.
pub(crate) const LEAST_RHO: f64 = 1e-4;

pub(crate) type PoseVector = SVector<f64, POSE>;
pub(crate) type PoseMatrix = SMatrix<f64, POSE, POSE>;
type ByPose = SMatrix<f64, 2, POSE>;

/// The problem at a place: information and gradient of all frames, landmarks eliminated.
pub(crate) struct Linear {
    pub(crate) information: DMatrix<f64>,
    pub(crate) gradient: DVector<f64>,
    pub(crate) cost: f64,
    /// What is needed to find the landmarks' steps, in the order of the window's.
    eliminated: Vec<Eliminated>,
}

/// A landmark's own equation.
#[derive(Clone, Debug, Default)]
pub(crate) struct Eliminated {
    information: f64,
    gradient: f64,
    /// By frames' poses and cameras' mounts, in the order of [`Window::blocks`].
    by: Vec<(usize, PoseVector)>,
}

impl Eliminated {
    fn add(&mut self, block: usize, by: &PoseVector) {
        match self.by.iter_mut().find(|(b, _)| *b == block) {
            Some((_, sum)) => *sum += by,
            None => self.by.push((block, *by)),
        }
    }
}

/// Huber's weight and cost for a squared residual in standard deviations.
#[inline]
pub(crate) fn huber(square: f64) -> (f64, f64) {
    if square <= HUBER * HUBER {
        (1.0, square)
    } else {
        let size = square.sqrt();
        (HUBER / size, 2.0 * HUBER * size - HUBER * HUBER)
    }
}

/// Where information and gradient are summed: by the frames' places, mounts behind them.
pub(crate) trait Sums {
    /// Adds a block of information; of each pair the one on or above the diagonal.
    fn add(&mut self, row: usize, column: usize, block: &PoseMatrix);
    /// Adds rows of the gradient.
    fn pull(&mut self, row: usize, rows: &PoseVector);
}

/// Of few frames, of which most see the same.
struct Dense {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl Sums for Dense {
    fn add(&mut self, row: usize, column: usize, block: &PoseMatrix) {
        let mut view = (self.information).fixed_view_mut::<POSE, POSE>(row * POSE, column * POSE);
        view += block;
    }

    fn pull(&mut self, row: usize, rows: &PoseVector) {
        let mut view = self.gradient.fixed_rows_mut::<POSE>(row * POSE);
        view += rows;
    }
}

/// One piece of the visual problem.
pub(crate) struct Piece<S> {
    pub(crate) sums: S,
    pub(crate) cost: f64,
    pub(crate) eliminated: Vec<Eliminated>,
}

/// One landmark's part, before elimination.
struct Part {
    own: Eliminated,
    cost: f64,
}

/// The residuals of a sight in one eye, with derivatives by the point in the left frame and, scaled, their size.
struct Residual {
    off: Vector2<f64>,
    by_x: SMatrix<f64, 2, 3>,
    by_rho: Vector2<f64>,
    weight: f64,
    cost: f64,
}

/// Residuals of both eyes for a point, times inverse range, in the left frame. The left one of a host is zero by definition
/// and left out. A point that is too far off to say which way costs the same wherever it is, and pulls nowhere.
fn residuals(
    camera: &Camera,
    sight: &Sight,
    x: &Vector3<f64>,
    by_rho: &Vector3<f64>,
    rho: f64,
    is_host: bool,
    sigma_px: f64,
) -> [Option<Residual>; 2] {
    let weigh = |off: Vector2<f64>, by_x: SMatrix<f64, 2, 3>, by_rho: Vector2<f64>| {
        let (weight, cost) = huber(off.norm_squared() / (sigma_px * sigma_px));
        Residual {
            off,
            by_x,
            by_rho,
            weight: weight / (sigma_px * sigma_px),
            cost,
        }
    };
    let beyond = |bearing: &Bearing| Residual {
        off: Vector2::zeros(),
        by_x: SMatrix::zeros(),
        by_rho: Vector2::zeros(),
        weight: 0.0,
        cost: huber(bearing.beyond() / (sigma_px * sigma_px)).1,
    };
    let left = (!is_host).then(|| match sight.left.off(x) {
        Some((off, by)) => weigh(off, by, by * by_rho),
        None => beyond(&sight.left),
    });
    let right = sight.right.as_ref().map(|right| {
        let (turn, origin) = &camera.right_from_left;
        let Some((off, by)) = right.off(&(turn * x + origin * rho)) else {
            return beyond(right);
        };
        let by_left = by * turn;
        weigh(off, by_left, by_left * by_rho + by * origin)
    });
    [left, right]
}

/// What a landmark adds to the mount of a camera.
#[derive(Default)]
struct Mounted {
    own: PoseMatrix,
    gradient: PoseVector,
    by_rho: PoseVector,
    /// Between the poses of the host and of the target and the mount, of one sight.
    by_host: PoseMatrix,
    by_target: PoseMatrix,
}

impl Mounted {
    fn add(&mut self, r: &Residual, j: &ByPose, j_host: &ByPose, j_target: &ByPose) {
        let weighted = j * r.weight;
        self.own += weighted.transpose() * j;
        self.gradient += weighted.transpose() * r.off;
        self.by_rho += weighted.transpose() * r.by_rho;
        self.by_host += j_host.transpose() * weighted;
        self.by_target += j_target.transpose() * weighted;
    }

    /// Hands over what lies between the mount and the poses of a sight: blocks of the host, of the target and of the mount.
    fn leave_to(&mut self, sums: &mut impl Sums, [host, target, mount]: [usize; 3]) {
        sums.add(host, mount, &self.by_host);
        sums.add(target, mount, &self.by_target);
        self.by_host.fill(0.0);
        self.by_target.fill(0.0);
    }
}

/// Adds one landmark to sums by the frames of the window in order.
fn add(window: &Window, landmark: &Landmark, sums: &mut impl Sums) -> Part {
    let mut part = Part {
        own: Eliminated::default(),
        cost: 0.0,
    };
    let (host_number, host) = &landmark.sights[0];
    let Some(host_frame) = window.position(*host_number) else {
        return part;
    };
    let host_camera = &window.cameras[host.camera];
    let host_placed = Placed::new(&window.frames[host_frame].state, host.after_s);
    let mut by_host = PoseVector::zeros();
    let mut mount = Mounted::default();
    for (k, (number, sight)) in landmark.sights.iter().enumerate() {
        let camera = &window.cameras[sight.camera];
        if k == 0 {
            let rays = residuals(
                camera,
                sight,
                &host.left.ray,
                &Vector3::zeros(),
                landmark.rho,
                true,
                window.sigma_px,
            );
            for r in rays.into_iter().flatten() {
                part.cost += r.cost;
                part.own.information += r.weight * r.by_rho.norm_squared();
                part.own.gradient += r.weight * r.by_rho.dot(&r.off);
            }
            continue;
        }
        let Some(frame) = window.position(*number) else {
            continue;
        };
        let placed = Placed::new(&window.frames[frame].state, sight.after_s);
        let carried = carry(
            &host.left.ray,
            landmark.rho,
            (host_camera, &host_placed),
            (camera, &placed),
        );
        let same = frame == host_frame;
        // Derivatives of the point by the two poses.
        let to_left = &carried.left_from_world;
        let by_position = to_left * landmark.rho;
        let host_turn =
            -(to_left * host_placed.turn) * so3::cross(&carried.in_host) * host_placed.since;
        let left_from_body = camera.body_from_left.0.transpose();
        let own_turn = left_from_body * so3::cross(&carried.in_target) * placed.since;
        let mut by_target = PoseVector::zeros();
        let mut h_target = PoseMatrix::zeros();
        let mut h_host = PoseMatrix::zeros();
        let mut h_between = PoseMatrix::zeros();
        let (mut g_target, mut g_host) = (PoseVector::zeros(), PoseVector::zeros());
        let found = residuals(
            camera,
            sight,
            &carried.x,
            &carried.by_rho,
            landmark.rho,
            false,
            window.sigma_px,
        );
        let by_cameras = (!window.mounts.is_empty()).then(|| {
            let now_from_then =
                carried.left_from_world * host_placed.turn * host_camera.body_from_left.0;
            by_mounts(&host.left.ray, landmark.rho, &now_from_then, &carried.x)
        });
        // Of another camera than the host's, and with that one.
        let is_across = sight.camera != host.camera;
        let mut other = Mounted::default();
        let mut mounts_between = PoseMatrix::zeros();
        for r in found.into_iter().flatten() {
            part.cost += r.cost;
            part.own.information += r.weight * r.by_rho.norm_squared();
            part.own.gradient += r.weight * r.by_rho.dot(&r.off);
            let mut j_host = ByPose::zeros();
            let by_point = r.by_x * by_position;
            j_host.fixed_columns_mut::<3>(0).copy_from(&by_point);
            j_host
                .fixed_columns_mut::<3>(3)
                .copy_from(&(r.by_x * host_turn));
            let mut j_target = ByPose::zeros();
            j_target.fixed_columns_mut::<3>(0).copy_from(&-by_point);
            j_target
                .fixed_columns_mut::<3>(3)
                .copy_from(&(r.by_x * own_turn));
            match &by_cameras {
                Some([by_own, by_other]) if is_across => {
                    let (own, across) = (r.by_x * by_own, r.by_x * by_other);
                    mount.add(&r, &own, &j_host, &j_target);
                    other.add(&r, &across, &j_host, &j_target);
                    mounts_between += own.transpose() * across * r.weight;
                }
                Some([by_own, by_other]) => {
                    mount.add(&r, &(r.by_x * (by_own + by_other)), &j_host, &j_target);
                }
                None => {}
            }
            if same {
                // Another camera in the host's own frame: both poses are one.
                j_host += j_target;
                let weighted = j_host.transpose() * r.weight;
                h_host += weighted * j_host;
                g_host += weighted * r.off;
                by_host += weighted * r.by_rho;
                continue;
            }
            let host_weighted = j_host.transpose() * r.weight;
            let target_weighted = j_target.transpose() * r.weight;
            h_host += host_weighted * j_host;
            h_target += target_weighted * j_target;
            h_between += host_weighted * j_target;
            g_host += host_weighted * r.off;
            g_target += target_weighted * r.off;
            by_host += host_weighted * r.by_rho;
            by_target += target_weighted * r.by_rho;
        }
        let (h, t) = (host_frame, frame);
        if by_cameras.is_some() {
            let block = window.frames.len() + host.camera;
            mount.leave_to(sums, [h, t, block]);
            if is_across {
                let beside = window.frames.len() + sight.camera;
                other.leave_to(sums, [h, t, beside]);
                sums.add(beside, beside, &other.own);
                sums.pull(beside, &other.gradient);
                part.own.add(beside, &other.by_rho);
                if block < beside {
                    sums.add(block, beside, &mounts_between);
                } else {
                    let between = mounts_between.transpose();
                    sums.add(beside, block, &between);
                }
            }
        }
        sums.add(h, h, &h_host);
        sums.pull(h, &g_host);
        if !same {
            sums.add(t, t, &h_target);
            // The upper triangle alone is kept.
            if h < t {
                sums.add(h, t, &h_between);
            } else {
                sums.add(t, h, &h_between.transpose());
            }
            sums.pull(t, &g_target);
            part.own.add(frame, &by_target);
        }
    }
    part.own.add(host_frame, &by_host);
    if !window.mounts.is_empty() {
        let block = window.frames.len() + host.camera;
        sums.add(block, block, &mount.own);
        sums.pull(block, &mount.gradient);
        part.own.add(block, &mount.by_rho);
    }
    part.own.by.sort_by_key(|(frame, _)| *frame);
    part
}

/// Sums landmarks, one after another, and eliminates them with this damping.
pub(crate) fn piece<S: Sums>(
    window: &Window,
    landmarks: &[&Landmark],
    damping: f64,
    empty: S,
) -> Piece<S> {
    let mut piece = Piece {
        sums: empty,
        cost: 0.0,
        eliminated: Vec::with_capacity(landmarks.len()),
    };
    for landmark in landmarks {
        let part = add(window, landmark, &mut piece.sums);
        piece.cost += part.cost;
        let mut own = part.own;
        own.information *= 1.0 + damping;
        if own.information > 0.0 {
            let inverse = 1.0 / own.information;
            for (i, (a, by_a)) in own.by.iter().enumerate() {
                let scaled = by_a * inverse;
                for (b, by_b) in &own.by[i..] {
                    piece.sums.add(*a, *b, &-(scaled * by_b.transpose()));
                }
                piece.sums.pull(*a, &(-scaled * own.gradient));
            }
        }
        piece.eliminated.push(own);
    }
    piece
}

/// Linearises what is known of some landmarks, all motions or those that `keep` names (by the position of their later
/// frame), and the prior. Only the upper triangle of the information is complete where blocks of poses meet; the caller
/// gets it mirrored.
pub(crate) fn linearise(
    window: &Window,
    landmarks: &[&Landmark],
    keep: impl Fn(usize) -> bool,
    damping: f64,
) -> Linear {
    let size = window.frames.len() * SIZE;
    let mut information = DMatrix::zeros(size, size);
    let mut gradient = DVector::zeros(size);
    let mut cost = 0.0;
    let mut eliminated = Vec::with_capacity(landmarks.len());
    let poses = window.frames.len() * POSE;
    let empty = || Dense {
        information: DMatrix::zeros(poses, poses),
        gradient: DVector::zeros(poses),
    };
    let pieces: Vec<Piece<Dense>> = landmarks
        .par_chunks(PIECE)
        .map(|landmarks| piece(window, landmarks, damping, empty()))
        .collect();
    for piece in pieces {
        for a in 0..window.frames.len() {
            for b in a..window.frames.len() {
                let block = (piece.sums.information).fixed_view::<POSE, POSE>(a * POSE, b * POSE);
                let mut view = information.fixed_view_mut::<POSE, POSE>(a * SIZE, b * SIZE);
                view += block;
            }
            let rows = piece.sums.gradient.fixed_rows::<POSE>(a * POSE);
            let mut view = gradient.fixed_rows_mut::<POSE>(a * SIZE);
            view += rows;
        }
        cost += piece.cost;
        eliminated.extend(piece.eliminated);
    }
    for a in 0..window.frames.len() {
        let block = information
            .fixed_view::<POSE, POSE>(a * SIZE, a * SIZE)
            .into_owned();
        // Diagonal blocks of pieces are whole where they were added as such, upper where landmarks were eliminated; both are
        // symmetric by construction.
        let mut view = information.fixed_view_mut::<POSE, POSE>(a * SIZE, a * SIZE);
        view.copy_from(&((block + block.transpose()) * 0.5));
        for b in a + 1..window.frames.len() {
            let block = information
                .fixed_view::<POSE, POSE>(a * SIZE, b * SIZE)
                .transpose();
            let mut view = information.fixed_view_mut::<POSE, POSE>(b * SIZE, a * SIZE);
            view.copy_from(&block);
        }
    }
    for k in (1..window.frames.len()).filter(|k| keep(*k)) {
        let Some(motion) = &window.frames[k].motion else {
            continue;
        };
        let term = motion::linearise(motion, &window.frames[k - 1].state, &window.frames[k].state);
        cost += term.cost;
        let at = (k - 1) * SIZE;
        let mut view = information.view_mut((at, at), (2 * SIZE, 2 * SIZE));
        view += term.information;
        let mut rows = gradient.rows_mut(at, 2 * SIZE);
        rows += term.gradient;
    }
    cost += add_prior(window, &mut information, &mut gradient);
    Linear {
        information,
        gradient,
        cost,
        eliminated,
    }
}

/// Errors of the prior's frames against where it was made.
pub(crate) fn prior_error(window: &Window) -> DVector<f64> {
    let mut error = DVector::zeros(window.prior.at.len() * SIZE);
    for (k, (number, at)) in window.prior.at.iter().enumerate() {
        if let Some(frame) = window.position(*number) {
            let off: Error = window.frames[frame].state.minus(at);
            error.fixed_rows_mut::<SIZE>(k * SIZE).copy_from(&off);
        }
    }
    error
}

pub(crate) fn prior_cost(window: &Window, error: &DVector<f64>) -> f64 {
    let prior = &window.prior;
    (error.transpose() * (&prior.information * error + &prior.gradient * 2.0))[0]
}

fn add_prior(window: &Window, information: &mut DMatrix<f64>, gradient: &mut DVector<f64>) -> f64 {
    let prior = &window.prior;
    let error = prior_error(window);
    let moved = &prior.information * &error + &prior.gradient;
    let places: Vec<Option<usize>> = prior.at.iter().map(|(n, _)| window.position(*n)).collect();
    for (a, frame_a) in places.iter().enumerate() {
        let Some(frame_a) = frame_a else { continue };
        let mut rows = gradient.fixed_rows_mut::<SIZE>(frame_a * SIZE);
        rows += moved.fixed_rows::<SIZE>(a * SIZE);
        for (b, frame_b) in places.iter().enumerate() {
            let Some(frame_b) = frame_b else { continue };
            let block = prior
                .information
                .fixed_view::<SIZE, SIZE>(a * SIZE, b * SIZE);
            let mut view = information.fixed_view_mut::<SIZE, SIZE>(frame_a * SIZE, frame_b * SIZE);
            view += block;
        }
    }
    prior_cost(window, &error)
}

/// The cost alone.
fn cost(window: &Window, landmarks: &[&Landmark]) -> f64 {
    let pieces: Vec<f64> = landmarks
        .par_chunks(PIECE)
        .map(|landmarks| landmarks.iter().map(|l| landmark_cost(window, l)).sum())
        .collect();
    let mut sum: f64 = pieces.iter().sum();
    for pair in window.frames.windows(2) {
        if let Some(motion) = &pair[1].motion {
            sum += motion::cost(motion, &pair[0].state, &pair[1].state);
        }
    }
    sum + prior_cost(window, &prior_error(window))
}

pub(crate) fn landmark_cost(window: &Window, landmark: &Landmark) -> f64 {
    let mut sum = 0.0;
    for_each_residual(window, landmark, |_, _, square| sum += huber(square).1);
    sum
}

/// Squared residuals, in standard deviations, of each sight (by place) and eye (1 the right one).
pub(crate) fn for_each_residual(
    window: &Window,
    landmark: &Landmark,
    mut found: impl FnMut(usize, usize, f64),
) {
    let (host_number, host) = &landmark.sights[0];
    let Some(host_frame) = window.position(*host_number) else {
        return;
    };
    let host_camera = &window.cameras[host.camera];
    let host_placed = Placed::new(&window.frames[host_frame].state, host.after_s);
    let scale = 1.0 / (window.sigma_px * window.sigma_px);
    for (k, (number, sight)) in landmark.sights.iter().enumerate() {
        let Some(frame) = window.position(*number) else {
            continue;
        };
        let camera = &window.cameras[sight.camera];
        let x = if k == 0 {
            host.left.ray
        } else {
            let placed = Placed::new(&window.frames[frame].state, sight.after_s);
            let to = (camera, &placed);
            carry(
                &host.left.ray,
                landmark.rho,
                (host_camera, &host_placed),
                to,
            )
            .x
        };
        if k > 0 {
            found(k, 0, sight.left.square(&x) * scale);
        }
        if let Some(right) = &sight.right {
            let (turn, origin) = &camera.right_from_left;
            let x = turn * x + origin * landmark.rho;
            found(k, 1, right.square(&x) * scale);
        }
    }
}

/// How a solution ended.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Solved {
    /// Linearisations.
    pub(crate) rounds: usize,
    /// Sum of squares before and after, in standard deviations.
    pub(crate) cost: [f64; 2],
}

/// Brings a window to where everything fits best, in at most `rounds` linearisations. Gives also the covariance of the
/// newest state's error, if it has one.
pub(crate) fn solve(
    window: &mut Window,
    rounds: usize,
) -> (Solved, Option<SMatrix<f64, SIZE, SIZE>>) {
    let mut solved = Solved {
        rounds: 0,
        cost: [0.0; 2],
    };
    let mut damping = 1e-5;
    let mut latest = None;
    let mut before: Option<f64> = None;
    for round in 0..rounds {
        let landmarks: Vec<&Landmark> = window.landmarks.values().collect();
        let linear = linearise(window, &landmarks, |_| true, damping);
        if round == 0 {
            solved.cost[0] = linear.cost;
        }
        solved.rounds += 1;
        let now = before.unwrap_or(linear.cost);
        let mut damped = linear.information.clone();
        for k in 0..damped.nrows() {
            damped[(k, k)] += damping * damped[(k, k)].max(1e-6);
        }
        let Some(cholesky) = damped.cholesky() else {
            damping = (damping * 100.0).max(1e-3);
            continue;
        };
        let step = -cholesky.solve(&linear.gradient);
        if !step.iter().all(|v| v.is_finite()) {
            break;
        }
        latest = Some(linear.information);
        let mut moved = window.clone();
        apply(&mut moved, &step, &linear.eliminated);
        let landmarks: Vec<&Landmark> = moved.landmarks.values().collect();
        let after = cost(&moved, &landmarks);
        if after <= now * (1.0 + 1e-9) {
            let gained = now - after;
            *window = moved;
            before = Some(after);
            solved.cost[1] = after;
            damping = (damping * 0.1).max(1e-7);
            if gained < 1e-3 * now.max(1.0) || step.amax() < 1e-6 {
                break;
            }
        } else {
            before = Some(now);
            solved.cost[1] = now;
            damping = (damping * 30.0).max(1e-3);
        }
    }
    // Damping would make certain what is not: without it, but for what rounding needs.
    let covariance = latest.and_then(|mut information: DMatrix<f64>| {
        for k in 0..information.nrows() {
            information[(k, k)] *= 1.0 + 1e-12;
        }
        information.cholesky().map(|c| c.inverse_corner())
    });
    (solved, covariance)
}

/// The lower right corner of an inverse.
trait Corner {
    fn inverse_corner(&self) -> SMatrix<f64, SIZE, SIZE>;
}

impl Corner for nalgebra::Cholesky<f64, nalgebra::Dyn> {
    fn inverse_corner(&self) -> SMatrix<f64, SIZE, SIZE> {
        // With `A = L Lᵀ` the corner of the inverse is that of the corner of `L` alone.
        let l = self.l_dirty();
        let at = l.nrows() - SIZE;
        let corner =
            SMatrix::<f64, SIZE, SIZE>::from_fn(
                |i, j| {
                    if i >= j { l[(at + i, at + j)] } else { 0.0 }
                },
            );
        let inverse = corner
            .solve_lower_triangular(&SMatrix::<f64, SIZE, SIZE>::identity())
            .expect("a Cholesky factor has no zero on its diagonal");
        inverse.transpose() * inverse
    }
}

/// Moves states by a step and landmarks, in the order of the window's, by what follows from it.
pub(crate) fn apply<'a>(
    window: &mut Window,
    step: &DVector<f64>,
    eliminated: impl IntoIterator<Item = &'a Eliminated>,
) {
    let rows: Vec<usize> = (0..window.blocks()).map(|k| window.row_of(k)).collect();
    for (frame, row) in window.frames.iter_mut().zip(&rows) {
        let error: Error = step.fixed_rows::<SIZE>(*row).into_owned();
        frame.state = frame.state.plus(&error);
    }
    if !window.mounts.is_empty() {
        let rows = &rows[window.frames.len()..];
        for (camera, row) in window.cameras.iter_mut().zip(rows) {
            move_by(camera, &step.fixed_rows::<POSE>(*row).into_owned());
        }
    }
    for (landmark, own) in window.landmarks.values_mut().zip(eliminated) {
        if own.information <= 0.0 {
            continue;
        }
        let mut right = own.gradient;
        for (block, by) in &own.by {
            right += by.dot(&step.fixed_rows::<POSE>(rows[*block]));
        }
        landmark.rho = (landmark.rho - right / own.information).max(LEAST_RHO);
    }
}

/// Moves one state alone, everything else held still, and gives the information about it. Sights far off count
/// less by Tukey's function, whose reach falls with the rounds. `kept` is the covariance of the state before: how it moved, and
/// where down is, is not known exactly.
pub(crate) fn solve_newest(
    window: &mut Window,
    kept: &SMatrix<f64, SIZE, SIZE>,
    rounds: usize,
) -> Option<SMatrix<f64, SIZE, SIZE>> {
    let last = window.frames.len() - 1;
    let number = window.frames[last].number;
    let sigma = window.sigma_px;
    // Where landmarks are does not change: in the world, times their inverse ranges.
    let seen: Vec<(Vector3<f64>, Vector3<f64>, f64, Sight)> = window
        .landmarks
        .values()
        .filter_map(|landmark| {
            let sights = &landmark.sights[landmark.since(number)..];
            let (host_number, host) = &landmark.sights[0];
            let frame = window.position(*host_number)?;
            if sights.is_empty() || frame == last {
                return None;
            }
            let placed = Placed::new(&window.frames[frame].state, host.after_s);
            let (turn, arm) = &window.cameras[host.camera].body_from_left;
            let in_host = turn * host.left.ray + arm * landmark.rho;
            let x = placed.turn * in_host;
            let each = sights.iter();
            Some(each.map(move |(_, sight)| (x, placed.position, landmark.rho, *sight)))
        })
        .flatten()
        .collect();
    // Where nothing was felt the guess may be far off.
    let felt = window.frames[last]
        .motion
        .as_ref()
        .is_some_and(|m| m.has_gravity);
    let reach: &[f64] = if felt {
        &[12.0, 8.0, 6.0, 5.0]
    } else {
        &[240.0, 160.0, 100.0, 60.0, 36.0, 24.0, 16.0, 10.0, 7.0, 5.0]
    };
    let mut information = None;
    for round in 0..rounds + reach.len() {
        let state: State = window.frames[last].state;
        let most = reach.get(round).copied().unwrap_or(4.0);
        let mut h = SMatrix::<f64, SIZE, SIZE>::zeros();
        let mut g = SVector::<f64, SIZE>::zeros();
        for (x, position, rho, sight) in &seen {
            let camera = &window.cameras[sight.camera];
            let placed = Placed::new(&state, sight.after_s);
            let (turn, arm) = &camera.body_from_left;
            let in_target = placed.turn.transpose() * (x + (position - placed.position) * *rho);
            let x_in_left = turn.transpose() * (in_target - arm * *rho);
            let left_from_world = turn.transpose() * placed.turn.transpose();
            let by_turn = turn.transpose() * so3::cross(&in_target) * placed.since;
            let rays = residuals(
                camera,
                sight,
                &x_in_left,
                &Vector3::zeros(),
                *rho,
                false,
                sigma,
            );
            for r in rays.into_iter().flatten() {
                let size = r.off.norm() / (sigma * most);
                if size >= 1.0 {
                    continue;
                }
                let kept = (1.0 - size * size).powi(2) / (sigma * sigma);
                let mut j = ByPose::zeros();
                j.fixed_columns_mut::<3>(0)
                    .copy_from(&(-r.by_x * left_from_world * *rho));
                j.fixed_columns_mut::<3>(3).copy_from(&(r.by_x * by_turn));
                let weighted = j.transpose() * kept;
                let block = weighted * j;
                let mut view = h.fixed_view_mut::<POSE, POSE>(0, 0);
                view += block;
                let mut rows = g.fixed_rows_mut::<POSE>(0);
                rows += weighted * r.off;
            }
        }
        if let (Some(motion), true) = (&window.frames[last].motion, last > 0) {
            let before = &window.frames[last - 1].state;
            let (information, gradient) = motion::of_later(motion, before, kept, &state);
            h += information;
            g += gradient;
        }
        let step = -h.cholesky()?.solve(&g);
        if !step.iter().all(|v| v.is_finite()) {
            return None;
        }
        information = Some(h);
        window.frames[last].state = state.plus(&step);
        if round >= reach.len() && step.fixed_rows::<POSE>(0).amax() < 1e-6 {
            break;
        }
    }
    information
}

#[cfg(test)]
pub(crate) mod tests;
