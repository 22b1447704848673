//! A camera's turns against those of its own gyroscope: how the two are turned against each other, and how late pictures
//! are stamped.
//!
//! With `imu_from_left = told exp(w)`, the turn of a move is `imu_from_left⁻¹ G imu_from_left`, where `G` is the gyroscope's
//! turn between the picture times less `late`. Found are `w` (in the left optical frame), `late`, the bias and a
//! scale of each axis. Turns about one axis alone leave `w` about that axis open; turns that are steady leave `late` open;
//! both show as large variances.

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};

use serde::Serialize;

use super::eyes::{Eyes, Pair};
use super::gyro::{Gyro, Integrated};
use super::motion::{DISPARITY_PX, Seen, Start, Turned, solve};
use super::robust::{Grouped, median, sigmas_of, tukey};
use super::tracks::{Burst, Move};
use crate::lens::Lens;
use crate::stereo::StereoCalibration;

/// Fewest moves that say anything.
const FEWEST: usize = 12;
/// What a move's turn may be off besides what its corners say, rad: corners slide with shadows and shapes.
const FLOOR_RAD: f64 = 1.5e-4;
const ROUNDS: usize = 8;
/// Standard deviations before anything is seen: of `w`, rad; of biases, rad/s; of `late`, s; of scales.
const SIGMAS: [f64; 4] = [0.1, 0.03, 0.03, 0.01];
/// Offset of inverse distances, before and between moves: yaw of an eye over the baseline, rad.
const YAW_RAD: f64 = 2e-3;

/// See the module.
#[derive(Clone, Debug, Serialize)]
pub struct CameraImu {
    /// `w`, rad.
    pub turned_rad: [f64; 3],
    /// Standard deviation about each axis, rad.
    pub sigma_rad: [f64; 3],
    /// Covariance of it, rad².
    #[serde(skip)]
    pub(super) covariance: Matrix3<f64>,
    /// How much later pictures are stamped than the gyroscope's samples, s.
    pub late_s: f64,
    /// Its standard deviation, s.
    pub late_sigma_s: f64,
    /// Of the gyroscope, rad/s.
    pub bias_rad_s: [f64; 3],
    /// Time from the exposure of a row to that of the next, as told or found, s.
    pub line_s: f64,
    /// Moves used.
    pub moves: usize,
    /// Moves looked at.
    pub of: usize,
    /// Turns of moves as rates about the axes of the left optical frame, for a plot: middle of the move (s since the first
    /// one), by the pictures, by the gyroscope as told (bias as found), rad/s.
    #[serde(skip)]
    pub rates: Vec<(f64, [f64; 3], [f64; 3])>,
    /// Yaw of the right eye that distances ask for besides that of [`super::Eyes`], rad, and its standard deviation.
    pub yaw_rad: [f64; 2],
}

/// What is estimated.
#[derive(Clone, Copy)]
struct State {
    /// `imu_from_left`.
    imu_from_left: UnitQuaternion<f64>,
    bias: Vector3<f64>,
    late_s: f64,
    scale: Vector3<f64>,
}

/// A move whose turn is known.
struct Known {
    group: usize,
    times_ns: [f64; 2],
    turned: Turned,
}

struct Camera<'a> {
    pair: Pair,
    line_s: f64,
    told: UnitQuaternion<f64>,
    gyro: &'a Gyro,
    bursts: &'a [Burst],
}

/// Times that a sensor may take to read a picture, s, and how much better than for a global shutter one must explain
/// what was seen to be believed, and the moves that it is tried on.
const READOUTS_S: [f64; 9] = [0.0, 0.004, 0.008, 0.012, 0.016, 0.02, 0.024, 0.028, 0.032];
const BETTER: f64 = 0.97;
const TRIED: usize = 24;

/// Estimates; none with too little to see. `line_s` is the time from a row to the next, found out if it is not told.
pub(super) fn estimate(
    told: &StereoCalibration,
    eyes: &Eyes,
    line_s: Option<f64>,
    gyro: &Gyro,
    bursts: &[Burst],
) -> Option<CameraImu> {
    let mut pair = Pair::new(told);
    (pair.turn, pair.origin) = eyes.right_from_left;
    let mut camera = Camera {
        pair,
        line_s: line_s.unwrap_or(0.0),
        told: *told.imu.as_ref()?.imu_from_left.rotation(),
        gyro,
        bursts,
    };
    let mut state = State {
        imu_from_left: camera.told,
        bias: Vector3::zeros(),
        late_s: 0.0,
        scale: Vector3::repeat(1.0),
    };
    let baseline = told.right_from_left.distance_m();
    let mut offset = [0.0, YAW_RAD / baseline];
    if line_s.is_none() {
        camera.find_line(&state, offset);
    }
    let mut last = None;
    for (round, off_px) in [6.0, 2.0, 2.0].into_iter().enumerate() {
        let known = camera.known(&state, off_px, offset, 1);
        if known.len() < FEWEST {
            return None;
        }
        if round == 0 {
            offset = common_offset(&known, YAW_RAD / baseline);
        }
        let found = camera.align(&mut state, &known)?;
        last = Some((known, found));
    }
    let (known, (covariance, moves)) = last?;
    let turned = (camera.told.inverse() * state.imu_from_left).scaled_axis();
    let of_turn = covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let as_told = State {
        imu_from_left: camera.told,
        late_s: 0.0,
        ..state
    };
    Some(CameraImu {
        turned_rad: turned.into(),
        sigma_rad: sigmas_of(&of_turn),
        covariance: of_turn,
        late_s: state.late_s,
        late_sigma_s: covariance[(6, 6)].sqrt(),
        bias_rad_s: state.bias.into(),
        line_s: camera.line_s,
        moves,
        of: bursts.iter().map(|b| b.moves.len()).sum(),
        rates: camera.rates(&as_told, &known),
        yaw_rad: offset.map(|o| o * baseline),
    })
}

impl Camera<'_> {
    /// Finds the time from a row to the next with which what was seen holds together best.
    fn find_line(&mut self, state: &State, offset: [f64; 2]) {
        let moves: usize = self.bursts.iter().map(|b| b.moves.len()).sum();
        let every = moves.div_ceil(TRIED).max(1);
        let rows = f64::from(self.pair.lenses[0].model().height);
        let mut spread = |readout_s: f64| {
            self.line_s = readout_s / rows;
            let known = self.known(state, 6.0, offset, every);
            let mut spreads: Vec<f64> = known.iter().map(|k| k.turned.spread).collect();
            // Fewer moves that hold together are worse as well.
            let missing = (moves.div_ceil(every) - spreads.len()) as f64;
            match spreads.is_empty() {
                true => f64::INFINITY,
                false => median(&mut spreads) * (1.0 + missing / moves as f64),
            }
        };
        let spreads = READOUTS_S.map(&mut spread);
        let best = (0..spreads.len()).min_by(|a, b| spreads[*a].total_cmp(&spreads[*b]));
        let best = best.filter(|i| spreads[*i] < BETTER * spreads[0]);
        let step = READOUTS_S[1];
        let readout_s = best.map_or(0.0, |i| {
            // The vertex of the parabola through the best and its neighbours.
            let at = |i: usize| spreads.get(i).copied().unwrap_or(f64::INFINITY);
            let (left, middle, right) = (at(i - 1), at(i), at(i + 1));
            let bend = left - 2.0 * middle + right;
            let off = 0.5 * (left - right) / bend;
            READOUTS_S[i] + step * if off.is_finite() { off } else { 0.0 }
        });
        self.line_s = readout_s / rows;
    }

    /// Turns of every `every`-th move, where it has one.
    fn known(&self, state: &State, off_px: f64, offset: [f64; 2], every: usize) -> Vec<Known> {
        let gyro = self.gyro.integrate(state.scale, state.bias);
        let mut known = Vec::new();
        let mut number = 0;
        for (group, burst) in self.bursts.iter().enumerate() {
            for of in &burst.moves {
                number += 1;
                if number % every != 0 {
                    continue;
                }
                let times_ns = [of.from_ns, of.to_ns].map(|t| t as f64);
                let Some(turn) = predicted(state, &gyro, times_ns) else {
                    continue;
                };
                let seen = self.seen(of, state, &gyro);
                let start = Start {
                    turn,
                    off_px,
                    offset,
                };
                known.extend(solve(&seen, &start).map(|turned| Known {
                    group,
                    times_ns,
                    turned,
                }));
            }
        }
        known
    }

    fn seen(&self, of: &Move, state: &State, gyro: &Integrated<'_>) -> Vec<Seen> {
        let lens = &self.pair.lenses[0];
        let middle = 0.5 * f64::from(lens.model().height - 1);
        let seconds = (of.to_ns - of.from_ns) as f64 * 1e-9;
        let seen = of.features.iter().filter_map(|feature| {
            let later = feature.later?;
            let first = Vector3::from(lens.unproject(feature.left)?);
            let placed = self.pair.place(&first, feature.right?)?;
            let px_per_rad = px_per_rad(lens, later)?;
            let ray = Vector3::from(lens.unproject(later)?);
            let rows = [feature.left[1], later[1]].map(|row| self.line_s * (row - middle));
            let at_once = |ray: Vector3<f64>, time_ns: i64, row_s: f64| -> Option<Vector3<f64>> {
                if self.line_s == 0.0 {
                    return Some(ray);
                }
                let time_ns = time_ns as f64;
                let turn = predicted(state, gyro, [time_ns + row_s * 1e9, time_ns])?;
                Some(turn * ray)
            };
            Some(Seen {
                ray: at_once(first, of.from_ns, rows[0])?,
                per_metre: placed.per_metre,
                sigma_per_metre: DISPARITY_PX / placed.px_per,
                later: at_once(ray, of.to_ns, rows[1])?,
                px_per_rad,
                way: 1.0 + (rows[1] - rows[0]) / seconds,
                after_s: 0.5 * (rows[0] + rows[1]),
            })
        });
        seen.collect()
    }

    /// Moves the state to where the gyroscope fits the known turns best. Gives the covariance and the moves used.
    fn align(&self, state: &mut State, known: &[Known]) -> Option<(SMatrix<f64, 10, 10>, usize)> {
        let [w, bias, late, scale] = SIGMAS;
        let sigmas =
            SVector::<f64, 10>::from([w, w, w, bias, bias, bias, late, scale, scale, scale]);
        let mut limit = 4.0;
        let mut last = None;
        for _ in 0..ROUNDS {
            let mut towards = SVector::<f64, 10>::zeros();
            let w = (self.told.inverse() * state.imu_from_left).scaled_axis();
            towards.fixed_rows_mut::<3>(0).copy_from(&-w);
            towards.fixed_rows_mut::<3>(3).copy_from(&-state.bias);
            towards[6] = -state.late_s;
            let off = Vector3::repeat(1.0) - state.scale;
            towards.fixed_rows_mut::<3>(7).copy_from(&off);
            let mut sum = Grouped::<10>::new(self.bursts.len(), &sigmas, &towards);
            let gyro = self.gyro.integrate(state.scale, state.bias);
            let mut sizes = Vec::with_capacity(known.len());
            let mut used = 0;
            for known in known {
                let Some((error, by)) = residual(state, &gyro, known) else {
                    continue;
                };
                let covariance =
                    known.turned.covariance + Matrix3::identity() * (FLOOR_RAD * FLOOR_RAD);
                let weight = covariance.try_inverse()?;
                let size = (error.transpose() * weight * error)[0].sqrt();
                sizes.push(size);
                let kept = tukey(size / limit);
                if kept > 0.0 {
                    used += 1;
                    sum.add(known.group, &error, &by, &(weight * kept / (limit * limit)));
                }
            }
            if used < FEWEST || used * 2 < known.len() {
                return None;
            }
            let step = sum.step()?;
            let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
            state.imu_from_left *= turn;
            state.bias += step.fixed_rows::<3>(3);
            state.late_s += step[6];
            state.scale += step.fixed_rows::<3>(7);
            // The median of the length of three normal numbers is 1.538.
            limit = (median(&mut sizes) / 1.538).max(0.7);
            last = Some((sum, used));
        }
        let (sum, used) = last?;
        let (covariance, larger) = sum.covariance(&[0, 1, 2, 6])?;
        Some((covariance * larger, used))
    }

    fn rates(&self, as_told: &State, known: &[Known]) -> Vec<(f64, [f64; 3], [f64; 3])> {
        let gyro = self.gyro.integrate(as_told.scale, as_told.bias);
        let first = known.first().map_or(0.0, |k| k.times_ns[0]);
        let rate = |known: &Known| {
            let [from, to] = known.times_ns;
            let seconds = (to - from) * 1e-9;
            let expected = predicted(as_told, &gyro, known.times_ns)?;
            let rate = |turn: &UnitQuaternion<f64>| (-turn.scaled_axis() / seconds).into();
            let middle = (0.5 * (from + to) - first) * 1e-9;
            Some((middle, rate(&known.turned.turn), rate(&expected)))
        };
        known.iter().filter_map(rate).collect()
    }
}

/// `later_from_first` of the left optical frame between two picture times, by the gyroscope.
fn predicted(
    state: &State,
    gyro: &Integrated<'_>,
    [from_ns, to_ns]: [f64; 2],
) -> Option<UnitQuaternion<f64>> {
    let late_ns = state.late_s * 1e9;
    let turn = gyro.to_from(to_ns - late_ns, from_ns - late_ns)?;
    Some(state.imu_from_left.inverse() * turn * state.imu_from_left)
}

/// How far a move's turn is off, and the derivatives of the predicted turn.
fn residual(
    state: &State,
    gyro: &Integrated<'_>,
    known: &Known,
) -> Option<(Vector3<f64>, SMatrix<f64, 3, 10>)> {
    let [from, to] = known.times_ns.map(|t| t - state.late_s * 1e9);
    let turn = gyro.to_from(to, from)?;
    let left_from_imu = state.imu_from_left.inverse();
    let expected = left_from_imu * turn * state.imu_from_left;
    let error = (known.turned.turn * expected.inverse()).scaled_axis();
    let left_from_imu = left_from_imu.to_rotation_matrix();
    let left_from_imu = left_from_imu.matrix();
    let half = UnitQuaternion::from_scaled_axis(turn.scaled_axis() * 0.5);
    let half = half.to_rotation_matrix();
    let seconds = (to - from) * 1e-9;
    let mut by = SMatrix::<f64, 3, 10>::zeros();
    let by_w = expected.to_rotation_matrix().into_inner() - Matrix3::identity();
    by.fixed_columns_mut::<3>(0).copy_from(&by_w);
    let by_angle = -left_from_imu * half.matrix();
    by.fixed_columns_mut::<3>(3)
        .copy_from(&(by_angle * -seconds));
    let by_late = left_from_imu * (gyro.rate(to)? - turn * gyro.rate(from)?);
    by.set_column(6, &by_late);
    let sum = gyro.sum(from, to)?;
    by.fixed_columns_mut::<3>(7)
        .copy_from(&(by_angle * Matrix3::from_diagonal(&sum)));
    Some((error, by))
}

/// Offset of inverse distances that all moves share, 1/m, and its standard deviation.
fn common_offset(known: &[Known], sigma: f64) -> [f64; 2] {
    let mut values: Vec<f64> = known.iter().map(|k| k.turned.offset[0]).collect();
    let middle = median(&mut values);
    let (mut weights, mut sum) = (1.0 / (sigma * sigma), 0.0);
    for k in known {
        let [offset, variance] = k.turned.offset;
        // The prior took part in each of them.
        let own = (1.0 / variance - 1.0 / (sigma * sigma)).max(0.0);
        let free = offset * (1.0 / variance) / own.max(1e-12);
        let size = (offset - middle) / variance.sqrt();
        let weight = own * tukey(size / 2.0);
        weights += weight;
        sum += weight * free;
    }
    // Moves are not as independent as that.
    [sum / weights, 2.0 / weights.sqrt()]
}

/// Pixels per radian around a pixel.
fn px_per_rad(lens: &Lens, pixel: [f64; 2]) -> Option<f64> {
    let ray = lens.unproject(pixel)?;
    let by_point = lens.project_with_jacobians(ray)?.by_point;
    // Both singular values of it are of directions across the ray, which is of length 1.
    Some(
        (by_point * by_point.transpose())
            .determinant()
            .sqrt()
            .sqrt(),
    )
}
