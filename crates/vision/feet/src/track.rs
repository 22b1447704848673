//! Poses of a foot at any times, from its contacts and from what frames show in between.
//!
//! Contract: at rest a foot has the pose of its contact. From a contact to the next one it follows
//! its usual motion, with the deviation that frames show; where no frame does, the covariance says
//! so. A foot whose next contact is missing, or too late for one step, is lost.

use std::ops::Range;

use cad_transforms::{Covariance, RigidTransform};
use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};

use crate::bridge::{Measurement, Process, bridge};
use crate::config::SwingConfig;
use crate::events::Contact;
use crate::poses::{motion, pose};
use crate::stance::FootObservation;
use crate::swing::{SoleEdges, UsualMotion};

/// How the pose of a foot is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FootStatus {
    /// A frame shows the foot at that time, or within some tens of milliseconds.
    Observed,
    /// The foot is at rest, and no frame shows it.
    Held,
    /// Between two contacts, and no frame shows it.
    Bridged,
    /// Unknown: the pose is the last known one and must not be used.
    Lost,
}

/// Pose of a foot at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FootPose {
    /// The time, ns.
    pub time_ns: i64,
    /// Takes points of the foot to the world, m.
    pub world_from_foot: RigidTransform,
    /// Covariance of a small motion of the foot in its own axes, in the frame of the rig's
    /// trajectory; `None` if it is lost.
    pub covariance: Option<Covariance>,
    /// How it is known.
    pub status: FootStatus,
}

/// What is known of one foot.
#[derive(Clone, Copy, Debug)]
pub struct FootContacts<'a> {
    /// Its poses in frames, in order of time.
    pub observations: &'a [FootObservation],
    /// Its contacts, in order of time.
    pub contacts: &'a [Contact],
    /// The edges of its sole.
    pub sole: SoleEdges,
}

/// Poses of a foot at ordered times.
pub fn foot_poses(
    foot: &FootContacts<'_>,
    times_ns: &[i64],
    config: &SwingConfig,
) -> Vec<FootPose> {
    let mut poses = Vec::with_capacity(times_ns.len());
    let mut last = RigidTransform::identity();
    let mut next = 0;
    for (k, contact) in foot.contacts.iter().enumerate() {
        let until = |limit_s: f64, from: usize| {
            let count = times_ns[from..].partition_point(|ns| seconds(*ns) < limit_s);
            from..from + count
        };
        let lost = until(rest_s(contact)[0], next);
        next = lost.end;
        lost_poses(&mut poses, times_ns, lost, &last);
        let rest = until(rest_s(contact)[1], next);
        next = rest.end;
        last = contact.stance.world_from_foot;
        for &time_ns in &times_ns[rest] {
            poses.push(FootPose {
                time_ns,
                world_from_foot: last,
                covariance: Some(contact.stance.covariance),
                status: match is_observed(foot.observations, time_ns, config) {
                    true => FootStatus::Observed,
                    false => FootStatus::Held,
                },
            });
        }
        let Some(after) = foot.contacts.get(k + 1) else {
            continue;
        };
        if rest_s(after)[0] - rest_s(contact)[1] > config.max_swing_s {
            continue;
        }
        let between = until(rest_s(after)[0], next);
        next = between.end;
        poses.extend(swing_poses(
            foot,
            [contact, after],
            &times_ns[between],
            config,
        ));
    }
    lost_poses(&mut poses, times_ns, next..times_ns.len(), &last);
    poses
}

/// From when to when a foot is at rest, s.
fn rest_s(contact: &Contact) -> [f64; 2] {
    let seen = contact.stance.times_ns.map(seconds);
    [
        contact.foot_flat.time_s.min(seen[0]),
        contact.heel_off.time_s.max(seen[1]),
    ]
}

fn seconds(ns: i64) -> f64 {
    1e-9 * ns as f64
}

fn is_observed(observations: &[FootObservation], time_ns: i64, config: &SwingConfig) -> bool {
    let behind = observations.partition_point(|own| own.time_ns < time_ns);
    let near = observations[behind.saturating_sub(1)..].iter().take(2);
    let ages = near.map(|own| seconds((own.time_ns - time_ns).abs()));
    ages.fold(f64::INFINITY, f64::min) <= config.observed_s
}

fn lost_poses(
    poses: &mut Vec<FootPose>,
    times_ns: &[i64],
    range: Range<usize>,
    last: &RigidTransform,
) {
    poses.extend(times_ns[range].iter().map(|&time_ns| FootPose {
        time_ns,
        world_from_foot: *last,
        covariance: None,
        status: FootStatus::Lost,
    }));
}

/// Poses between two contacts.
fn swing_poses(
    foot: &FootContacts<'_>,
    [from, to]: [&Contact; 2],
    times_ns: &[i64],
    config: &SwingConfig,
) -> Vec<FootPose> {
    let usual = UsualMotion::new(from, to, foot.sole);
    let (from_s, to_s) = (rest_s(from)[1], rest_s(to)[0]);
    let seen = foot.observations.iter();
    let seen: Vec<&FootObservation> = seen
        .filter(|own| (from_s..to_s).contains(&seconds(own.time_ns)))
        .collect();
    let deviations: Vec<Deviation> = seen.iter().map(|own| deviation(own, &usual)).collect();
    let times_s: Vec<f64> = times_ns.iter().map(|ns| seconds(*ns)).collect();
    // A step that is late is elsewhere: where events are uncertain, all of it is.
    let late_s = from.toe_off.sigma_s.hypot(to.heel_strike.sigma_s);
    let by_axis = [0, 1, 2, 3, 4, 5].map(|axis| {
        let measurements = seen
            .iter()
            .zip(&deviations)
            .map(|(own, deviation)| Measurement {
                time_s: seconds(own.time_ns),
                value: deviation.value[axis],
                variance: deviation.variance[axis],
            });
        let measurements: Vec<Measurement> = measurements.collect();
        let by_time = config.jerk[axis] * late_s;
        let process = Process {
            acceleration: config.acceleration[axis].hypot(by_time),
            correlation_s: config.correlation_s,
        };
        bridge([from_s, to_s], 1e-8, &measurements, process, &times_s)
    });
    let of_time = |(n, &time_ns): (usize, &i64)| {
        let mean = usual.at(times_s[n]);
        let value = by_axis.each_ref().map(|axis| axis[n][0]);
        let variance = by_axis.each_ref().map(|axis| axis[n][1]);
        let [x, y, z, a, b, c] = value;
        let at = mean.translation() + usual.axes() * Vector3::new(x, y, z);
        let rotation = mean.rotation() * UnitQuaternion::from_scaled_axis(Vector3::new(a, b, c));
        let world_from_foot = pose(&rotation, &at)?;
        let share = (times_s[n] - from_s) / (to_s - from_s).max(1e-3);
        let ends =
            from.stance.covariance.matrix() * (1.0 - share) + to.stance.covariance.matrix() * share;
        // The deviations are along the axes of the step, the covariance along those of the foot.
        let foot_from_step = (rotation.inverse() * usual.axes()).to_rotation_matrix();
        let positions =
            Matrix3::from_diagonal(&Vector3::new(variance[0], variance[1], variance[2]));
        let positions = foot_from_step * positions * foot_from_step.transpose();
        let mut covariance: Matrix6<f64> = ends;
        for i in 0..3 {
            for j in 0..3 {
                covariance[(i, j)] += positions[(i, j)];
            }
            covariance[(i + 3, i + 3)] += variance[i + 3];
        }
        Some(FootPose {
            time_ns,
            world_from_foot,
            covariance: Some(crate::poses::covariance(&covariance)?),
            status: match is_observed(foot.observations, time_ns, config) {
                true => FootStatus::Observed,
                false => FootStatus::Bridged,
            },
        })
    };
    let lost = |time_ns: i64| FootPose {
        time_ns,
        world_from_foot: from.stance.world_from_foot,
        covariance: None,
        status: FootStatus::Lost,
    };
    let times = times_ns.iter().enumerate();
    times
        .map(|(n, ns)| of_time((n, ns)).unwrap_or_else(|| lost(*ns)))
        .collect()
}

/// Deviation of a frame from the usual motion: position along the axes of the step, rotation along
/// those of the foot; and its variances.
struct Deviation {
    value: [f64; 6],
    variance: [f64; 6],
}

fn deviation(observation: &FootObservation, usual: &UsualMotion<'_>) -> Deviation {
    let mean = usual.at(seconds(observation.time_ns));
    let seen = &observation.world_from_foot;
    let shift = usual.axes().inverse() * (seen.translation() - mean.translation());
    let turn = motion(&mean, seen);
    let covariance = observation.covariance.matrix();
    let step_from_foot = (usual.axes().inverse() * seen.rotation()).to_rotation_matrix();
    let positions: Matrix3<f64> = covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let positions = step_from_foot * positions * step_from_foot.transpose();
    let of_rotation = |k: usize| covariance[(k + 3, k + 3)];
    Deviation {
        value: [shift.x, shift.y, shift.z, turn[3], turn[4], turn[5]],
        variance: [
            positions[(0, 0)],
            positions[(1, 1)],
            positions[(2, 2)],
            of_rotation(0),
            of_rotation(1),
            of_rotation(2),
        ],
    }
}

#[cfg(test)]
mod tests;
