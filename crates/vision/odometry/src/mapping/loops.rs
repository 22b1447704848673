//! Places seen again.
//!
//! Candidates are keyframes that by their poses may show the same: near, looking the same way, far apart in time. Marks are
//! matched by their looks; the relative pose that most matches agree with is found from the one that is expected, by least squares
//! whose reach shrinks. What would move the poses farther than they can have drifted is a place that looks like another, and is
//! left out. A loop enters the adjustment as a tie of two poses with the covariance of its own solution.

use calib::Eye as Side;
use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::Loop;
use super::adjust::Progress;
use crate::describe::unlike;
use crate::keyframe::{Keyframe, Mark};
use crate::sight::{self, Bearing, Camera};
use crate::so3;
use crate::solve::{PoseMatrix, PoseVector};
use crate::state::State;
use crate::window::Window;

/// Least time between the two, s.
const APART_S: f64 = 12.0;
/// How near they must be, m, and how much farther for each metre gone between them.
const NEAR_M: f64 = 1.5;
const DRIFT: f64 = 0.01;
/// Largest angle between the views of two cameras, rad.
const SAME_VIEW: f64 = 0.6;
/// A keyframe is looked at if the one looked at before is so far away, m.
const EVERY_M: f64 = 0.6;
/// Candidates tried for each.
const TRIED: usize = 3;
/// Most bits in which two looks of the same may differ, and how much better than any other it must be.
const ALIKE: u32 = 72;
const BETTER: f64 = 0.85;
/// How far off a mark may be expected, rad: what the poses may be off at near things.
const EXPECTED: f64 = 0.6;
/// Marks that must agree, and their share of all matches.
const FEWEST: f64 = 12.0;
const LEAST_SHARE: f64 = 0.3;
/// Reach of the least squares, px, one round each, and the standard deviation of a mark's place.
const REACH: [f64; 10] = [60.0, 45.0, 32.0, 24.0, 16.0, 12.0, 9.0, 7.0, 6.0, 6.0];
const SIGMA_PX: f64 = 1.4;
/// How far a loop may move things: m, per metre gone, and rad.
const MOST_M: f64 = 0.3;
const MOST_RAD: f64 = 0.12;
/// Residual of a loop, in standard deviations, from which it counts less (Cauchy), and the same as long as everything is far off.
const CAUCHY: f64 = 3.0;
const CAUCHY_FAR: f64 = 100.0;

/// A tie of two keyframes, by place in the window.
#[derive(Clone, Debug)]
pub(super) struct Closure {
    pub(super) frames: [usize; 2],
    numbers: [u64; 2],
    /// First body from second.
    turn: UnitQuaternion<f64>,
    shift: Vector3<f64>,
    information: PoseMatrix,
    marks: f64,
    off: [f64; 2],
    /// Residual from which it counts less.
    reach: f64,
}

/// A tie as a term of the least squares problem.
pub(super) struct Term {
    pub(super) own: PoseMatrix,
    pub(super) across: PoseMatrix,
    pub(super) other: PoseMatrix,
    pub(super) pull_own: PoseVector,
    pub(super) pull_other: PoseVector,
    pub(super) cost: f64,
}

impl Closure {
    /// For whoever reads the result.
    pub(super) fn told(&self) -> Loop {
        Loop {
            frames: self.numbers,
            marks: self.marks.round() as usize,
            off: self.off,
        }
    }

    /// Counts less from here on if it is far off from where everything else puts it.
    pub(super) fn narrow(&mut self) {
        self.reach = CAUCHY;
    }

    /// Shift and turn by which two poses fail to close it.
    fn residual(&self, window: &Window) -> PoseVector {
        let [a, b] = self.frames.map(|f| &window.frames[f].state);
        let shift = a.turn.inverse() * (b.position - a.position);
        let turn = a.turn.inverse() * b.turn;
        let mut r = PoseVector::zeros();
        r.fixed_rows_mut::<3>(0).copy_from(&(shift - self.shift));
        r.fixed_rows_mut::<3>(3)
            .copy_from(&so3::log(&(self.turn.inverse() * turn)));
        r
    }

    pub(super) fn cost(&self, window: &Window) -> f64 {
        let r = self.residual(window);
        let square = (r.transpose() * self.information * r)[0];
        let reach = self.reach * self.reach;
        reach * (1.0 + square / reach).ln()
    }

    pub(super) fn linearise(&self, window: &Window) -> Term {
        let [a, b] = self.frames.map(|f| &window.frames[f].state);
        let r = self.residual(window);
        let square = (r.transpose() * self.information * r)[0];
        let weight = self.information / (1.0 + square / (self.reach * self.reach));
        let back: Matrix3<f64> = a.turn.inverse().to_rotation_matrix().into_inner();
        let shift = back * (b.position - a.position);
        let inverse = so3::right_jacobian_inverse(&r.fixed_rows::<3>(3).into_owned());
        let relative = back * b.turn.to_rotation_matrix().into_inner();
        let mut by_a = PoseMatrix::zeros();
        let mut by_b = PoseMatrix::zeros();
        by_a.fixed_view_mut::<3, 3>(0, 0).copy_from(&-back);
        by_b.fixed_view_mut::<3, 3>(0, 0).copy_from(&back);
        by_a.fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&so3::cross(&shift));
        by_a.fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&(-inverse * relative.transpose()));
        by_b.fixed_view_mut::<3, 3>(3, 3).copy_from(&inverse);
        let (weighted_a, weighted_b) = (by_a.transpose() * weight, by_b.transpose() * weight);
        Term {
            own: weighted_a * by_a,
            across: weighted_a * by_b,
            other: weighted_b * by_b,
            pull_own: weighted_a * r,
            pull_other: weighted_b * r,
            cost: self.cost(window),
        }
    }
}

/// All places seen again.
pub(super) fn find(
    keyframes: &[Keyframe],
    window: &Window,
    progress: &mut impl FnMut(Progress),
) -> Vec<Closure> {
    // How far was gone up to each.
    let mut gone = vec![0.0];
    for pair in window.frames.windows(2) {
        let step = (pair[1].state.position - pair[0].state.position).norm();
        gone.push(gone[gone.len() - 1] + step);
    }
    let mut looked = Vec::new();
    let mut last: Option<usize> = None;
    for k in 0..keyframes.len() {
        let far = |l: usize| {
            let (a, b) = (&window.frames[l].state, &window.frames[k].state);
            (a.position - b.position).norm() > EVERY_M || a.turn.angle_to(&b.turn) > 0.3
        };
        if last.is_none_or(far) {
            looked.push(k);
            last = Some(k);
        }
    }
    let mut closures = Vec::new();
    const AT_ONCE: usize = 64;
    for (n, some) in looked.chunks(AT_ONCE).enumerate() {
        progress(Progress::Looked {
            done: n * AT_ONCE,
            all: looked.len(),
        });
        let found: Vec<Vec<Closure>> = some
            .par_iter()
            .map(|b| {
                let candidates = candidates(*b, window, &gone, &looked);
                let tried = candidates
                    .iter()
                    .filter_map(|a| close(&keyframes[*a], &keyframes[*b], [*a, *b], window, &gone));
                tried.take(1).collect()
            })
            .collect();
        closures.extend(found.into_iter().flatten());
    }
    closures
}

/// Earlier keyframes that may show the same, the nearest first.
fn candidates(b: usize, window: &Window, gone: &[f64], looked: &[usize]) -> Vec<usize> {
    let now = &window.frames[b].state;
    let mut near: Vec<(f64, usize)> = looked
        .iter()
        .take_while(|a| **a < b)
        .filter_map(|a| {
            let then = &window.frames[*a].state;
            let seconds = (now.time_ns - then.time_ns) as f64 * 1e-9;
            let far = (now.position - then.position).norm();
            let turned = then.turn.angle_to(&now.turn);
            let fits = seconds > APART_S && far < NEAR_M + DRIFT * (gone[b] - gone[*a]);
            fits.then_some((far + turned, *a))
        })
        .collect();
    near.sort_by(|x, y| x.0.total_cmp(&y.0));
    near.truncate(TRIED);
    near.into_iter().map(|(_, a)| a).collect()
}

/// A mark with where its eye was on the body when it saw it: rows and cameras have times of their own, during which the body moves.
struct Placed<'a> {
    mark: &'a Mark,
    seen: Bearing,
    /// Body at the keyframe's time from left eye at the mark's.
    eye: Matrix3<f64>,
    arm: Vector3<f64>,
}

impl Placed<'_> {
    /// The point in the body, times its inverse range, if that is known.
    fn point(&self) -> Option<(Vector3<f64>, f64)> {
        let rho = f64::from(self.mark.rho);
        (rho > 0.0).then(|| (self.eye * self.seen.ray + self.arm * rho, rho))
    }

    /// The view's axis in the body.
    fn axis(&self) -> Vector3<f64> {
        self.eye.column(2).into_owned()
    }
}

/// The marks of one camera.
fn placed<'a>(
    keyframe: &'a Keyframe,
    state: &State,
    (index, camera): (usize, &Camera),
) -> Vec<Placed<'a>> {
    let own = (keyframe.marks.iter()).filter(|m| usize::from(m.camera) == index);
    let each = own.filter_map(|mark| {
        let seen = camera.bearing(Side::Left, mark.left)?;
        let after_s = keyframe.after_s[index] + camera.row_after_s(Side::Left, mark.left[1]);
        let then = sight::Placed::new(state, after_s);
        let (eye, arm) = &camera.body_from_left;
        let shift = state.turn.inverse() * (then.position - state.position);
        let turn = then.since.transpose();
        Some(Placed {
            mark,
            seen,
            eye: turn * eye,
            arm: turn * arm + shift,
        })
    });
    each.collect()
}

/// A mark of one keyframe that another one sees.
struct Match {
    /// In the first body, times its inverse range.
    x: Vector3<f64>,
    rho: f64,
    /// Where the other body's eye was, and where it saw it.
    eye: Matrix3<f64>,
    arm: Vector3<f64>,
    seen: Bearing,
    /// Whether the point is of the later keyframe and seen by the earlier.
    is_back: bool,
    /// How much it counts: of two marks whose ranges both are known each sees the other, which tells the same twice.
    share: f64,
}

fn close(
    from: &Keyframe,
    to: &Keyframe,
    frames: [usize; 2],
    window: &Window,
    gone: &[f64],
) -> Option<Closure> {
    let [a, b] = frames.map(|f| &window.frames[f].state);
    let mut turn = a.turn.inverse() * b.turn;
    let mut shift = a.turn.inverse() * (b.position - a.position);
    let expected = (turn, shift);
    let matches = matches(from, to, (a, b), &window.cameras);
    let all: f64 = matches.iter().map(|m| m.share).sum();
    if all < FEWEST {
        return None;
    }
    let mut information = PoseMatrix::zeros();
    let mut agree = 0.0;
    for reach in REACH {
        let mut h = SMatrix::<f64, 6, 6>::identity() * 1e-6;
        let mut g = SVector::<f64, 6>::zeros();
        agree = 0.0;
        let r: Matrix3<f64> = turn.to_rotation_matrix().into_inner();
        for m in &matches {
            // Forth: first to second body. Back: second to first.
            let (in_body, by_shift, by_turn) = if m.is_back {
                let turned = r * m.x;
                (
                    turned + shift * m.rho,
                    Matrix3::identity() * m.rho,
                    -r * so3::cross(&m.x),
                )
            } else {
                let back = r.transpose() * (m.x - shift * m.rho);
                (back, -r.transpose() * m.rho, so3::cross(&back))
            };
            let x = m.eye.transpose() * (in_body - m.arm * m.rho);
            let Some((off, by)) = m.seen.off(&x) else {
                continue;
            };
            let size = off.norm() / reach;
            if size >= 1.0 {
                continue;
            }
            agree += m.share;
            let weight = m.share * (1.0 - size * size).powi(2) / (SIGMA_PX * SIGMA_PX);
            let by_body = by * m.eye.transpose();
            let mut j = SMatrix::<f64, 2, 6>::zeros();
            j.fixed_columns_mut::<3>(0).copy_from(&(by_body * by_shift));
            j.fixed_columns_mut::<3>(3).copy_from(&(by_body * by_turn));
            let weighted = j.transpose() * weight;
            h += weighted * j;
            g += weighted * off;
        }
        let step = -h.cholesky()?.solve(&g);
        shift += step.fixed_rows::<3>(0);
        turn *= so3::exp(&step.fixed_rows::<3>(3).into_owned());
        information = h;
    }
    let gone = gone[frames[1]] - gone[frames[0]];
    let off = [(shift - expected.1).norm(), turn.angle_to(&expected.0)];
    let is_plausible = off[0] < MOST_M + DRIFT * gone && off[1] < MOST_RAD;
    let is_agreed = agree >= FEWEST && agree >= LEAST_SHARE * all;
    // The shift is that of the second body in the first one's axes; a turn of the first is not in it.
    (is_plausible && is_agreed).then_some(Closure {
        frames,
        numbers: [from.number, to.number],
        turn,
        shift,
        information,
        marks: agree,
        off,
        reach: CAUCHY_FAR,
    })
}

fn matches(
    from: &Keyframe,
    to: &Keyframe,
    (a, b): (&State, &State),
    cameras: &[Camera],
) -> Vec<Match> {
    let mut out = Vec::new();
    let turn = a.turn.inverse() * b.turn;
    let shift = a.turn.inverse() * (b.position - a.position);
    let r: Matrix3<f64> = turn.to_rotation_matrix().into_inner();
    let all = |keyframe, state| -> Vec<Vec<Placed<'_>>> {
        let each = cameras.iter().enumerate();
        each.map(|camera| placed(keyframe, state, camera)).collect()
    };
    let (of_a, of_b) = (all(from, a), all(to, b));
    for seen_a in &of_a {
        for seen_b in &of_b {
            let (Some(first_a), Some(first_b)) = (seen_a.first(), seen_b.first()) else {
                continue;
            };
            if first_a.axis().dot(&(r * first_b.axis())) < SAME_VIEW.cos() {
                continue;
            }
            // Where a mark of the first is expected in the second's body.
            let expected: Vec<(Vector3<f64>, f64)> = seen_a
                .iter()
                .map(|m| {
                    let rho = f64::from(m.mark.rho);
                    let x = m.eye * m.seen.ray + (m.arm - shift) * rho;
                    (r.transpose() * x, rho)
                })
                .collect();
            let best = |look: &[u64; 4], among: &mut dyn Iterator<Item = (usize, &[u64; 4])>| {
                let (mut best, mut second) = ((u32::MAX, usize::MAX), u32::MAX);
                for (k, other) in among {
                    let bits = unlike(look, other);
                    if bits < best.0 {
                        second = best.0;
                        best = (bits, k);
                    } else if bits < second {
                        second = bits;
                    }
                }
                let sure = best.0 <= ALIKE && f64::from(best.0) < BETTER * f64::from(second);
                sure.then_some(best.1)
            };
            for (q, mark_b) in seen_b.iter().enumerate() {
                let is_near = |p: usize| {
                    let (x, rho) = &expected[p];
                    let there = mark_b.eye.transpose() * (x - mark_b.arm * *rho);
                    there.dot(&mark_b.seen.ray) > EXPECTED.cos() * there.norm()
                };
                let mut near = (seen_a.iter().enumerate())
                    .filter(|(p, _)| is_near(*p))
                    .map(|(p, m)| (p, &m.mark.looks));
                let Some(p) = best(&mark_b.mark.looks, &mut near) else {
                    continue;
                };
                let mark_a = &seen_a[p];
                let mut all = (seen_b.iter().enumerate()).map(|(q, m)| (q, &m.mark.looks));
                if best(&mark_a.mark.looks, &mut all) != Some(q) {
                    continue;
                }
                let points = [mark_a.point(), mark_b.point()];
                let share = if points.iter().all(Option::is_some) {
                    0.5
                } else {
                    1.0
                };
                for ((point, by), is_back) in
                    points.into_iter().zip([mark_b, mark_a]).zip([false, true])
                {
                    out.extend(point.map(|(x, rho)| Match {
                        x,
                        rho,
                        eye: by.eye,
                        arm: by.arm,
                        seen: by.seen,
                        is_back,
                        share,
                    }));
                }
            }
        }
    }
    out
}

#[cfg(test)]
mod tests;
