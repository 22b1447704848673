//! Reference implementation: the motion is a cubic B-spline, every IMU sample a residual.
//!
//! Positions and cumulative rotations on uniform knots (Furgale, Barfoot and Sibley,
//! Continuous-time batch estimation using temporal basis functions, 2012; rotations as Kim, Kim and
//! Shin 1995). Jacobians with respect to rotations are finite differences. Biases are constant.
//! Three control points form a state of a chain, since a residual depends on four. Results:
//! docs/decisions/0006-camera-imu.md.

use super::*;

/// Control points per state.
const GROUP: usize = 3;
const GROUPED: usize = 6 * GROUP;
/// The shared parameters and two biases.
const SPLINE_SHARED: usize = SHARED + 6;

#[derive(Clone)]
pub(in crate::camera_imu) struct Motion {
    knot_s: f64,
    start_s: f64,
    controls: Vec<(Matrix3<f64>, Vector3<f64>)>,
}

#[derive(Clone, Copy)]
pub(in crate::camera_imu) struct Body {
    rotation: Matrix3<f64>,
    position: Vector3<f64>,
    rate: Vector3<f64>,
    acceleration: Vector3<f64>,
}

impl Motion {
    /// A spline near poses at given times; linear between them.
    pub(in crate::camera_imu) fn near(
        knot_s: f64,
        poses: &[(f64, Matrix3<f64>, Vector3<f64>)],
        pad_s: f64,
    ) -> Self {
        let start_s = poses[0].0 - pad_s;
        let end_s = poses[poses.len() - 1].0 + pad_s;
        let count = ((end_s - start_s) / knot_s).ceil() as usize + 4;
        let controls = (0..count)
            .map(|k| {
                // The basis of a control point peaks one knot before its index.
                let t = start_s + (k as f64 - 1.0) * knot_s;
                let after = poses.partition_point(|p| p.0 < t).clamp(1, poses.len() - 1);
                let (a, b) = (&poses[after - 1], &poses[after]);
                let part = ((t - a.0) / (b.0 - a.0)).clamp(0.0, 1.0);
                let turn = so3::log(&(a.1.transpose() * b.1)) * part;
                (a.1 * so3::exp(&turn), a.2 + (b.2 - a.2) * part)
            })
            .collect();
        Self {
            knot_s,
            start_s,
            controls,
        }
    }

    /// Index of the first of four control points at a time, and the time within the knot interval.
    fn place(&self, time_s: f64) -> Option<(usize, f64)> {
        let at = (time_s - self.start_s) / self.knot_s;
        let first = at.floor();
        let fits = first >= 0.0 && (first as usize) + 3 < self.controls.len();
        fits.then_some((first as usize, at - first))
    }

    fn at(&self, first: usize, s: f64) -> Body {
        let (value, slope, bend) = basis(s, self.knot_s);
        let c = &self.controls[first..first + 4];
        let mut body = Body {
            rotation: c[0].0,
            position: c[0].1,
            rate: Vector3::zeros(),
            acceleration: Vector3::zeros(),
        };
        for j in 0..3 {
            let step = c[j + 1].1 - c[j].1;
            body.position += step * value[j];
            body.acceleration += step * bend[j];
            let turn = so3::log(&(c[j].0.transpose() * c[j + 1].0));
            let part = so3::exp(&(turn * value[j]));
            body.rotation *= part;
            body.rate = part.transpose() * body.rate + turn * slope[j];
        }
        body
    }
}

/// Cumulative basis of the three differences, with first and second time derivative.
fn basis(s: f64, knot_s: f64) -> ([f64; 3], [f64; 3], [f64; 3]) {
    let value = [
        (5.0 + s * (3.0 + s * (-3.0 + s))) / 6.0,
        (1.0 + s * (3.0 + s * (3.0 - 2.0 * s))) / 6.0,
        s * s * s / 6.0,
    ];
    let slope = [
        (3.0 + s * (-6.0 + 3.0 * s)) / 6.0,
        (3.0 + s * (6.0 - 6.0 * s)) / 6.0,
        0.5 * s * s,
    ];
    let bend = [s - 1.0, 1.0 - 2.0 * s, s];
    (
        value,
        slope.map(|v| v / knot_s),
        bend.map(|v| v / (knot_s * knot_s)),
    )
}

/// Estimated parameters.
#[derive(Clone)]
pub(in crate::camera_imu) struct Whole {
    pub(in crate::camera_imu) motion: Motion,
    pub(in crate::camera_imu) shared: Shared,
    pub(in crate::camera_imu) biases: [Vector3<f64>; 2],
}

pub(in crate::camera_imu) struct SplineFit {
    pub(in crate::camera_imu) whole: Whole,
    pub(in crate::camera_imu) covariance: SMatrix<f64, SPLINE_SHARED, SPLINE_SHARED>,
    /// Cost per measurement.
    pub(in crate::camera_imu) misfit: f64,
}

impl Whole {
    fn moved(&self, own: &[SVector<f64, GROUPED>], shared: &SVector<f64, SPLINE_SHARED>) -> Self {
        let mut out = self.clone();
        for (k, control) in out.motion.controls.iter_mut().enumerate() {
            let step = own[k / GROUP].fixed_rows::<6>(6 * (k % GROUP));
            let turn = Vector3::new(step[0], step[1], step[2]);
            control.0 = so3::tidy(&(control.0 * so3::exp(&turn)));
            control.1 += Vector3::new(step[3], step[4], step[5]);
        }
        out.shared = self.shared.moved(&shared.fixed_rows::<SHARED>(0).into());
        for k in 0..3 {
            out.biases[0][k] += shared[SHARED + k];
            out.biases[1][k] += shared[SHARED + 3 + k];
        }
        out
    }
}

impl Problem<'_> {
    /// Residual of a sample at a body state.
    fn sample_error(
        &self,
        body: &Body,
        whole: &Whole,
        raw: &Raw,
        weights: [f64; 2],
    ) -> SVector<f64, 6> {
        let shared = &whole.shared;
        let force = body.rotation.transpose() * (body.acceleration - shared.gravity);
        let gyro = shared.gyro_shape * body.rate + whole.biases[0] - raw.gyro;
        let accel = shared.accel_shape * force + whole.biases[1] - raw.accel;
        let mut out = SVector::<f64, 6>::zeros();
        out.fixed_rows_mut::<3>(0).copy_from(&(gyro * weights[0]));
        out.fixed_rows_mut::<3>(3).copy_from(&(accel * weights[1]));
        out
    }

    fn spline_equations(
        &self,
        rooted: &[WhitenedView],
        raw: &[Raw],
        whole: &Whole,
    ) -> (Chain<GROUPED, SPLINE_SHARED>, f64, usize) {
        let motion = &whole.motion;
        let shared = &whole.shared;
        let groups = motion.controls.len().div_ceil(GROUP);
        let mut chain = Chain::new(groups);
        // A control point without residuals keeps its value.
        for own in &mut chain.own {
            *own += SMatrix::<f64, GROUPED, GROUPED>::identity() * 1e-6;
        }
        let prior = self.prior.factor(shared, self.config.fixed_sigma);
        let mut wide = SMatrix::<f64, SHARED, SPLINE_SHARED>::zeros();
        wide.fixed_columns_mut::<SHARED>(0).copy_from(&prior.shared);
        chain.shared += wide.transpose() * wide;
        chain.shared_gradient += wide.transpose() * prior.residual;
        for k in 0..6 {
            let weight = self.prior.biases[k / 3].powi(-2);
            chain.shared[(SHARED + k, SHARED + k)] += weight;
            chain.shared_gradient[SHARED + k] += weight * whole.biases[k / 3][k % 3];
        }
        let mut cost = prior.residual.norm_squared();
        let mut count = 0;
        const H: f64 = 1e-6;
        // Rotates one control point at a time, in both directions: body states at the same time.
        let rotated = |first: usize, s: f64, k: usize, axis: usize| {
            let mut part = Motion {
                knot_s: motion.knot_s,
                start_s: 0.0,
                controls: motion.controls[first..first + 4].to_vec(),
            };
            let mut d = Vector3::zeros();
            d[axis] = H;
            let rotation = part.controls[k].0;
            part.controls[k].0 = rotation * so3::exp(&d);
            let high = part.at(0, s);
            part.controls[k].0 = rotation * so3::exp(&-d);
            (part.at(0, s), high)
        };
        let put = |own: &mut SMatrix<f64, 6, GROUPED>,
                   next: &mut SMatrix<f64, 6, GROUPED>,
                   first: usize,
                   control: usize,
                   column: usize,
                   by: &SVector<f64, 6>| {
            let k = first + control;
            let at = 6 * (k % GROUP) + column;
            match k / GROUP == first / GROUP {
                true => own.set_column(at, by),
                false => next.set_column(at, by),
            }
        };
        // Positions: weight of each control point.
        let shares = |of: &[f64; 3]| [1.0 - of[0], of[0] - of[1], of[1] - of[2], of[2]];
        let bends = |of: &[f64; 3]| [-of[0], of[0] - of[1], of[1] - of[2], of[2]];
        for (i, view) in self.views.iter().enumerate() {
            let Some((first, s)) = motion.place(view.time_s) else {
                continue;
            };
            let body = motion.at(first, s);
            let state = |body: &Body| State {
                rotation: body.rotation,
                position: body.position,
                velocity: Vector3::zeros(),
                gyro_bias: Vector3::zeros(),
                accel_bias: Vector3::zeros(),
            };
            let mut found = self.view_factor(&rooted[i], &state(&body), shared);
            cost += found.apply_loss(self.loss_threshold());
            count += VIEW;
            let root = found.weight.sqrt();
            let mut own = SMatrix::<f64, VIEW, GROUPED>::zeros();
            let mut next = SMatrix::<f64, VIEW, GROUPED>::zeros();
            let (value, ..) = basis(s, motion.knot_s);
            for (k, share) in shares(&value).into_iter().enumerate() {
                let mut block = SMatrix::<f64, VIEW, 6>::zeros();
                for axis in 0..3 {
                    let (low, high) = rotated(first, s, k, axis);
                    let turn = so3::log(&(low.rotation.transpose() * high.rotation)) / (2.0 * H);
                    block.set_column(axis, &(found.own.fixed_columns::<3>(0) * turn));
                }
                let by_position = found.own.fixed_columns::<3>(3) * share;
                block.fixed_columns_mut::<3>(3).copy_from(&by_position);
                let c = first + k;
                let to = if c / GROUP == first / GROUP {
                    &mut own
                } else {
                    &mut next
                };
                to.fixed_columns_mut::<6>(6 * (c % GROUP))
                    .copy_from(&(block * root));
            }
            let mut wide = SMatrix::<f64, VIEW, SPLINE_SHARED>::zeros();
            wide.fixed_columns_mut::<SHARED>(0)
                .copy_from(&(found.shared * root));
            let i = first / GROUP;
            let next = (i + 1 < groups).then_some(&next);
            chain.add(i, &(found.residual * root), &own, next, &wide);
        }
        let root_rate = self.track.period_s.sqrt();
        let weights = [
            root_rate / self.noise.gyro_noise_density,
            root_rate / self.noise.accel_noise_density,
        ];
        for raw in raw {
            let in_camera = |offset: f64| {
                let t = raw.time_s - offset;
                t - shared.drift * (t - self.middle_s)
            };
            let Some((first, s)) = motion.place(in_camera(shared.offset_s)) else {
                continue;
            };
            let body = motion.at(first, s);
            let residual = self.sample_error(&body, whole, raw, weights);
            cost += residual.norm_squared();
            count += 6;
            let mut own = SMatrix::<f64, 6, GROUPED>::zeros();
            let mut next = SMatrix::<f64, 6, GROUPED>::zeros();
            let (.., bend) = basis(s, motion.knot_s);
            let by_acceleration = shared.accel_shape * body.rotation.transpose() * weights[1];
            for (k, share) in bends(&bend).into_iter().enumerate() {
                for axis in 0..3 {
                    let (low, high) = rotated(first, s, k, axis);
                    let by = (self.sample_error(&high, whole, raw, weights)
                        - self.sample_error(&low, whole, raw, weights))
                        / (2.0 * H);
                    put(&mut own, &mut next, first, k, axis, &by);
                    let mut by = SVector::<f64, 6>::zeros();
                    by.fixed_rows_mut::<3>(3)
                        .copy_from(&(by_acceleration.column(axis) * share));
                    put(&mut own, &mut next, first, k, 3 + axis, &by);
                }
            }
            let mut wide = SMatrix::<f64, 6, SPLINE_SHARED>::zeros();
            let h = 1e-5;
            let ends = [-h, h].map(|d| {
                let (first, s) = motion.place(in_camera(shared.offset_s + d))?;
                Some(self.sample_error(&motion.at(first, s), whole, raw, weights))
            });
            if let [Some(low), Some(high)] = ends {
                let by = (high - low) / (2.0 * h);
                wide.set_column(OFFSET, &by);
                wide.set_column(
                    DRIFT,
                    &(by * (raw.time_s - shared.offset_s - self.middle_s)),
                );
            }
            let force = body.rotation.transpose() * (body.acceleration - shared.gravity);
            let down = -(by_acceleration * shared.gravity_tangent() * GRAVITY);
            wide.fixed_view_mut::<3, 2>(3, DOWN).copy_from(&down);
            for row in 0..3 {
                for column in 0..3 {
                    wide[(row, SHAPES + 3 * row + column)] = body.rate[column] * weights[0];
                    wide[(3 + row, SHAPES + 9 + 3 * row + column)] = force[column] * weights[1];
                }
                wide[(row, SHARED + row)] = weights[0];
                wide[(3 + row, SHARED + 3 + row)] = weights[1];
            }
            let i = first / GROUP;
            let next = (i + 1 < groups).then_some(&next);
            chain.add(i, &residual, &own, next, &wide);
        }
        (chain, cost, count)
    }

    /// Fits from initial values, damped as the other formulation is.
    pub(in crate::camera_imu) fn fit_spline(
        &self,
        raw: &[Raw],
        mut whole: Whole,
    ) -> Option<SplineFit> {
        for round in 0..3 {
            let rooted: Option<Vec<WhitenedView>> = (0..self.views.len())
                .map(|i| {
                    let view = &self.views[i];
                    let (pose, size) = match round {
                        0 => (self.poses[i], 1.0),
                        _ => {
                            let (first, s) = whole.motion.place(view.time_s)?;
                            let body = whole.motion.at(first, s);
                            let camera = Pose {
                                rotation: body.rotation * whole.shared.rotation,
                                position: body.position + body.rotation * whole.shared.translation,
                            };
                            (camera, whole.shared.board_scale)
                        }
                    };
                    WhitenedView::new(&view.linearise(self.cameras, &pose, size, self.corner_scale))
                })
                .collect();
            let rooted = rooted?;
            let mut damping = 1e-6;
            let (mut chain, mut cost, mut count) = self.spline_equations(&rooted, raw, &whole);
            for _ in 0..30 {
                let step = chain.factor(damping)?.step();
                let promised = -(step.shared.dot(&chain.shared_gradient)
                    + (step.own.iter().zip(&chain.own_gradient))
                        .map(|(s, g)| s.dot(g))
                        .sum::<f64>());
                if promised < 1e-3 {
                    break;
                }
                let tried = whole.moved(&step.own, &step.shared);
                let (next, lower, counted) = self.spline_equations(&rooted, raw, &tried);
                if lower <= cost {
                    (whole, chain, cost, count) = (tried, next, lower, counted);
                    damping = (damping * 0.1_f64).max(1e-9);
                } else {
                    damping *= 10.0;
                }
            }
            if round == 2 {
                return Some(SplineFit {
                    covariance: chain.factor(0.0)?.covariance().shared,
                    whole,
                    misfit: cost / count as f64,
                });
            }
        }
        None
    }
}
