//! Poses of a foot at any times, from its contacts and from what frames show in between.
//!
//! Contract: at rest a foot has the pose of its contact. From a contact to the next one it follows
//! its usual motion, with the deviation that frames show; where no frame does, the covariance says
//! so, and the sole clears the ground. A foot whose next contact is missing, or too late for one
//! step, is lost, and so is one that no frame shows between events that are hardly known.

use std::ops::Range;

use cad_transforms::{Covariance, RigidTransform};
use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};

use crate::config::SwingConfig;
use crate::contact::{Contact, rest_s, seconds};
use crate::poses::pose;
use crate::stance::FootObservation;
use crate::swing_clearance::SwingClearance;
use crate::swing_habit::{Swing, SwingHabit};
pub use crate::{contact::FootContacts, ground::GroundHeights};

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

/// Poses of a foot at ordered times, of a wearer who usually swings as `habit` says.
pub fn foot_poses(
    foot: &FootContacts<'_>,
    habit: &SwingHabit,
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
        let between = until(rest_s(after)[0], next);
        // Long walks are computed in parts, in which most swings have no time.
        if between.is_empty() {
            continue;
        }
        let Some(swing) = Swing::new(foot, [contact, after], habit, config) else {
            continue;
        };
        next = between.end;
        let between = &times_ns[between];
        let times_s: Vec<f64> = between.iter().map(|ns| seconds(*ns)).collect();
        let clearance = clearance(foot, &swing, [contact, after], habit);
        match swing.deviations(habit, &times_s) {
            Some(deviations) => poses.extend(between.iter().zip(deviations).map(|(ns, own)| {
                let status = match is_observed(foot.observations, *ns, config) {
                    true => FootStatus::Observed,
                    false => FootStatus::Bridged,
                };
                let factor = match status {
                    FootStatus::Bridged if swing.climbs() => config.climb_factor,
                    FootStatus::Bridged => config.hidden_factor,
                    _ => 1.0,
                };
                let factor = factor * factor;
                let mut own = own.map(|[value, variance]| [value, factor * variance]);
                let [up, variance] = own[UP];
                own[UP][0] = up + clearance.lift_m(seconds(*ns), variance.sqrt());
                let is_known = status != FootStatus::Bridged || swing.has_known_events(config);
                let pose = swing_pose(*ns, &swing, [contact, after], &own, status);
                pose.filter(|_| is_known).unwrap_or(FootPose {
                    time_ns: *ns,
                    world_from_foot: last,
                    covariance: None,
                    status: FootStatus::Lost,
                })
            })),
            None => lost_poses(&mut poses, between, 0..between.len(), &last),
        }
    }
    lost_poses(&mut poses, times_ns, next..times_ns.len(), &last);
    poses
}

/// Index of the height among the axes of a deviation.
const UP: usize = 2;

/// What the ground between two contacts adds to the height of a swing.
fn clearance(
    foot: &FootContacts<'_>,
    swing: &Swing<'_>,
    [from, to]: [&Contact; 2],
    habit: &SwingHabit,
) -> SwingClearance {
    let times_s = SwingClearance::times_s([from.toe_off.time_s, to.heel_strike.time_s]);
    let [a, b] = [from, to].map(|own| own.stance.world_from_foot.translation().z);
    let deviations = swing.deviations(habit, &times_s).unwrap_or_default();
    let shown = times_s.iter().zip(&deviations);
    let shown = shown.filter_map(|(time_s, own)| placed(swing, *time_s, &own.map(|own| own[0])));
    SwingClearance::new(times_s, shown, foot.sole, foot.ground, a.max(b))
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

/// Pose between two contacts, with its deviation from the usual motion: mean and variance along
/// each axis.
fn swing_pose(
    time_ns: i64,
    swing: &Swing<'_>,
    [from, to]: [&Contact; 2],
    deviation: &[[f64; 2]; 6],
    status: FootStatus,
) -> Option<FootPose> {
    let time_s = seconds(time_ns);
    let axes = swing.usual.axes();
    let variance = deviation.map(|[_, variance]| variance);
    let world_from_foot = placed(swing, time_s, &deviation.map(|[value, _]| value))?;
    let rotation = world_from_foot.rotation();
    let [from_s, to_s] = [rest_s(from)[1], rest_s(to)[0]];
    let share = ((time_s - from_s) / (to_s - from_s).max(1e-3)).clamp(0.0, 1.0);
    let [begin, end] = [from, to].map(|contact| contact.stance.covariance.matrix());
    let mut covariance: Matrix6<f64> = begin * (1.0 - share) + end * share;
    // The deviations are along the axes of the step, the covariance along those of the foot.
    let foot_from_step = (rotation.inverse() * axes).to_rotation_matrix();
    let positions = Matrix3::from_diagonal(&Vector3::new(variance[0], variance[1], variance[2]));
    let positions = foot_from_step * positions * foot_from_step.transpose();
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
        status,
    })
}

/// A foot that deviates from its usual motion.
fn placed(swing: &Swing<'_>, time_s: f64, deviation: &[f64; 6]) -> Option<RigidTransform> {
    let mean = swing.usual.at(time_s);
    let [x, y, z, a, b, c] = *deviation;
    let at = mean.translation() + swing.usual.axes() * Vector3::new(x, y, z);
    let rotation = mean.rotation() * UnitQuaternion::from_scaled_axis(Vector3::new(a, b, c));
    pose(&rotation, &at)
}

#[cfg(test)]
mod tests;
