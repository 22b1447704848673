//! The IMUs of a rig, of which one is used at a time.
//!
//! Contract: the first IMU of the rig is used until it is silent
//! ([`takeover_delay_ns`](crate::config::InertialConfig)) and another one has samples for the whole
//! interval from the last keyframe on; that one is used until it is silent itself. There is no way
//! back by itself: with every change the biases are those of another sensor, and begin with the
//! uncertainty that they had before any measurement. States keep the body frame of the first IMU,
//! see [`ImuPropagator`].

use cad_transforms::RigidTransform;
use camera_models::ImuSample;
use nalgebra::{SMatrix, Vector3};

use super::imu_buffer::{Coverage, Reading};
use super::propagation::{ImuPropagator, constant_velocity};
use crate::backend::observation::Camera;
use crate::backend::state::State;
use crate::backend::window::MotionFactor;
use crate::config::Config;
use crate::rig::{Imu, Rig};

/// Bias random walk without IMUs, where biases mean nothing.
const NO_BIAS_WALK: [f64; 2] = [1e-6; 2];

/// Cameras in the body frame, and the body frame: that of the first IMU, or the rig frame without
/// IMUs.
pub(crate) fn body_frame(rig: &Rig) -> (Vec<Camera>, RigidTransform) {
    let body_from_rig =
        (rig.imus.first()).map_or_else(RigidTransform::identity, |imu| imu.rig_from_imu.inverse());
    let cameras = rig.cameras.iter();
    let cameras = cameras.map(|camera| Camera::new(camera, &body_from_rig));
    (cameras.collect(), body_from_rig)
}

/// Beginning of the use of an IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImuUse {
    /// Time of the first pose that follows from its samples, ns.
    pub time_ns: i64,
    /// Its index in the rig.
    pub imu: usize,
}

/// See the module.
pub(crate) struct ImuSet {
    imus: Vec<ImuPropagator>,
    /// Sigmas of the biases of an IMU before any measurement.
    bias_sigma: [f64; 2],
    takeover_delay_ns: i64,
    uses: Vec<ImuUse>,
}

impl ImuSet {
    /// The IMUs of a rig; `None` without IMUs.
    pub(crate) fn new(rig: &Rig, config: &Config) -> Option<Self> {
        let first = rig.imus.first()?;
        let body_from_rig = first.rig_from_imu.inverse();
        let propagator = |(index, imu): (usize, &Imu)| {
            let body_from_imu = match index {
                // Exactly.
                0 => RigidTransform::identity(),
                _ => body_from_rig * imu.rig_from_imu,
            };
            ImuPropagator::new(imu, &body_from_imu, &config.inertial)
        };
        Some(Self {
            imus: rig.imus.iter().enumerate().map(propagator).collect(),
            bias_sigma: config.estimator.initialization.bias_sigma,
            takeover_delay_ns: config.inertial.takeover_delay_ns,
            uses: Vec::new(),
        })
    }

    /// Adds a sample of the IMU with this index in the rig.
    pub(crate) fn push(&mut self, imu: usize, sample: &ImuSample) {
        if let Some(imu) = self.imus.get_mut(imu) {
            imu.push(sample);
        }
    }

    /// Drops samples before a time.
    pub(crate) fn forget_before(&mut self, time_ns: i64) {
        for imu in &mut self.imus {
            imu.samples.forget_before(time_ns);
        }
    }

    /// The IMU in use.
    pub(crate) fn current(&self) -> &ImuPropagator {
        &self.imus[self.uses.last().map_or(0, |used| used.imu)]
    }

    /// The IMUs in order of their use.
    pub(crate) fn uses(&self) -> &[ImuUse] {
        &self.uses
    }

    /// Selects the IMU for the first state: the first one of the rig with samples at its time.
    pub(crate) fn initialize(&mut self, time_ns: i64) {
        let is_near = |imu: &ImuPropagator| imu.at(time_ns).is_some_and(|(_, is_near)| is_near);
        let imu = self.imus.iter().position(is_near).unwrap_or(0);
        self.uses = vec![ImuUse { time_ns, imu }];
    }

    /// Index of the IMU that the biases of a state belong to.
    fn imu_of(&self, time_ns: i64) -> usize {
        let before = self.uses.partition_point(|used| used.time_ns <= time_ns);
        let used = self.uses[..before].last().or(self.uses.first());
        used.map_or(0, |used| used.imu)
    }

    /// Lets another IMU take over if the one in use is silent at the end of an interval.
    fn select(&mut self, from_ns: i64, to_ns: i64) {
        let silence_ns = self.current().samples.silence_ns(to_ns);
        if silence_ns.is_some_and(|silence_ns| silence_ns < self.takeover_delay_ns) {
            return;
        }
        let is_complete = |imu: &ImuPropagator| imu.between(from_ns, to_ns).1 == Coverage::Complete;
        if let Some(imu) = self.imus.iter().position(is_complete) {
            self.uses.push(ImuUse {
                time_ns: to_ns,
                imu,
            });
        }
    }

    /// Bias random walk densities between two states. If another IMU is in use at the later one,
    /// its biases have the initial uncertainty.
    fn bias_walk(&self, from_ns: i64, to_ns: i64) -> [f64; 2] {
        if self.imu_of(from_ns) == self.imu_of(to_ns) {
            return self.current().bias_walk();
        }
        let seconds = (to_ns - from_ns) as f64 * 1e-9;
        self.bias_sigma
            .map(|sigma| sigma / seconds.max(1e-6).sqrt())
    }
}

/// Motion factor from a state to a time: of the IMU in use where it has samples and
/// `has_valid_samples`, else of constant velocity. `rate` is the angular rate in the body frame
/// that is assumed without a gyroscope, rad/s.
pub(crate) fn motion_factor(
    imus: Option<&mut ImuSet>,
    config: &Config,
    from: &State,
    to_ns: i64,
    rate: Vector3<f64>,
    has_valid_samples: bool,
) -> MotionFactor {
    let without_samples = || constant_velocity(&config.inertial, from, rate, to_ns);
    let Some(imus) = imus else {
        return MotionFactor {
            preintegrated: without_samples(),
            has_gravity: false,
            bias_walk: NO_BIAS_WALK,
        };
    };
    if has_valid_samples {
        imus.select(from.time_ns, to_ns);
    }
    let bias_walk = imus.bias_walk(from.time_ns, to_ns);
    let is_same = imus.imu_of(from.time_ns) == imus.imu_of(to_ns);
    // The biases of the earlier state are those of another IMU.
    let own = match is_same {
        true => *from,
        false => State {
            gyro_bias: Vector3::zeros(),
            accel_bias: Vector3::zeros(),
            ..*from
        },
    };
    let motion = has_valid_samples
        .then(|| imus.current().preintegrate(&own, to_ns, rate))
        .flatten();
    let Some((mut preintegrated, has_gravity)) = motion else {
        return MotionFactor {
            preintegrated: without_samples(),
            has_gravity: false,
            bias_walk,
        };
    };
    if !is_same {
        let [gyro, accel] = imus.bias_sigma.map(|sigma| sigma * sigma);
        let mut prior = SMatrix::<f64, 6, 6>::zeros();
        prior.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(gyro);
        prior.fixed_view_mut::<3, 3>(3, 3).fill_diagonal(accel);
        let by_bias = preintegrated.by_bias;
        preintegrated.covariance += by_bias * prior * by_bias.transpose();
        preintegrated.by_bias = SMatrix::zeros();
    }
    MotionFactor {
        preintegrated,
        has_gravity,
        bias_walk,
    }
}

/// The samples without gap or saturation before `until_ns`, of the last `window_ns` at most. They
/// show gravity and, at rest, the gyroscope bias.
pub(crate) fn continuous_readings(
    imu: &ImuPropagator,
    until_ns: i64,
    window_ns: i64,
) -> Vec<Reading> {
    let since = imu.samples.continuous_since(until_ns).unwrap_or(until_ns);
    match since < until_ns {
        true => imu.between(since.max(until_ns - window_ns), until_ns).0,
        false => Vec::new(),
    }
}

#[cfg(test)]
mod tests;
