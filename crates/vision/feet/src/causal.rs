//! Poses of a foot by what frames show until then: for what reacts while a person walks, and to see
//! what later frames add.
//!
//! Contract: a pose depends on no later frame, unlike those of [`track`](crate::track). A foot at
//! rest has the mean pose of its stance so far, one that moves that of the last frame. It is lost
//! soon after the last frame: there is no next contact to bridge to.

use cad_transforms::RigidTransform;

use crate::config::GaitConfig;
use crate::contact::seconds;
use crate::stance::{FootObservation, Stance, stances};
use crate::track::{FootPose, FootStatus};

/// Time before a frame in which frames decide whether the foot is at rest, ns.
const WINDOW_NS: i64 = 2_000_000_000;

/// Poses of a foot at ordered times, from
/// [`causal_observations`](crate::observation::causal_observations).
///
/// ```
/// use cad_transforms::{Covariance, RigidTransform};
/// use feet::GaitConfig;
/// use feet::causal::causal_poses;
/// use feet::stance::FootObservation;
/// use feet::track::FootStatus;
///
/// let at_rest = |n: i64| {
///     Ok(FootObservation {
///         time_ns: n * 33_000_000,
///         world_from_foot: RigidTransform::identity(),
///         covariance: Covariance::from_sigmas([2e-3; 3], [0.01; 3])?,
///     })
/// };
/// let observed = (0..6).map(at_rest).collect::<Result<Vec<_>, Box<dyn std::error::Error>>>()?;
/// let times = [100_000_000, 240_000_000, 600_000_000];
/// let poses = causal_poses(&observed, &times, &GaitConfig::default());
/// let status = [FootStatus::Observed, FootStatus::Held, FootStatus::Lost];
/// assert!(poses.iter().zip(status).all(|(pose, status)| pose.status == status));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn causal_poses(
    observations: &[FootObservation],
    times_ns: &[i64],
    config: &GaitConfig,
) -> Vec<FootPose> {
    let mut known = 0;
    let mut rest: Option<Stance> = None;
    let pose = |time_ns: &i64| {
        let end = observations.partition_point(|own| own.time_ns <= *time_ns);
        if end != known {
            known = end;
            rest = at_rest(&observations[..end], config);
        }
        let Some(last) = observations[..end].last() else {
            return FootPose {
                time_ns: *time_ns,
                world_from_foot: RigidTransform::identity(),
                covariance: None,
                status: FootStatus::Lost,
            };
        };
        let age_s = seconds(time_ns - last.time_ns);
        let status = match &rest {
            _ if age_s <= config.swing.observed_s => FootStatus::Observed,
            Some(_) if age_s <= config.swing.causal_held_s => FootStatus::Held,
            _ => FootStatus::Lost,
        };
        let (world_from_foot, covariance) = match &rest {
            Some(stance) => (stance.world_from_foot, stance.covariance),
            None => (last.world_from_foot, last.covariance),
        };
        FootPose {
            time_ns: *time_ns,
            world_from_foot,
            covariance: (status != FootStatus::Lost).then_some(covariance),
            status,
        }
    };
    times_ns.iter().map(pose).collect()
}

/// The stance that a foot is in, at the last of its observations.
fn at_rest(observations: &[FootObservation], config: &GaitConfig) -> Option<Stance> {
    let last_ns = observations.last()?.time_ns;
    let begin = observations.partition_point(|own| own.time_ns < last_ns - WINDOW_NS);
    let recent = &observations[begin..];
    let last = stances(recent, &config.stance).pop()?;
    (last.observations.end == recent.len()).then_some(last)
}

#[cfg(test)]
mod tests {
    use cad_transforms::Covariance;

    use super::*;
    use crate::poses::motion;
    use crate::test_noise::Noise;

    /// At rest for 0.6 s of each 1.1 s, then hidden for 0.3 s, then moving at 2 m/s.
    fn truth(t: f64) -> Option<RigidTransform> {
        let (step, phase) = ((t / 1.1).floor(), t.rem_euclid(1.1));
        let x = match phase {
            0.0..0.6 => 0.0,
            0.6..0.9 => return None,
            _ => 1.4 - 2.0 * (1.1 - phase),
        };
        RigidTransform::from_translation_m([1.4 * step + x, 0.1, 0.0]).ok()
    }

    fn observed() -> Vec<FootObservation> {
        let mut noise = Noise::new(11);
        let times = (0..200).map(|n| f64::from(n) / 30.0 + 1e-3);
        let frames = times.filter_map(|t| Some((t, truth(t)?)));
        let frame = |(t, truth): (f64, RigidTransform)| {
            let shift = [0, 1, 2].map(|_| 0.004 * noise.next());
            let turn = [0, 1, 2].map(|_| 0.015 * noise.next());
            FootObservation {
                time_ns: (1e9 * t) as i64,
                world_from_foot: truth * RigidTransform::from_rotation_vector(turn, shift).unwrap(),
                covariance: Covariance::from_sigmas([0.004; 3], [0.015; 3]).unwrap(),
            }
        };
        frames.map(frame).collect()
    }

    #[test]
    fn later_frames_change_nothing() {
        let (observed, config) = (observed(), GaitConfig::default());
        let times: Vec<i64> = (0..120).map(|n| 50_000_000 * n + 7_000_000).collect();
        let all = causal_poses(&observed, &times, &config);
        for (pose, time_ns) in all.iter().zip(&times) {
            let until: Vec<FootObservation> = observed
                .iter()
                .copied()
                .filter(|own| own.time_ns <= *time_ns)
                .collect();
            assert_eq!(causal_poses(&until, &[*time_ns], &config), [*pose]);
        }
    }

    #[test]
    fn known_poses_are_near_the_truth_and_hidden_feet_are_lost() {
        let (observed, config) = (observed(), GaitConfig::default());
        let times: Vec<i64> = observed.iter().map(|own| own.time_ns).collect();
        for pose in causal_poses(&observed, &times, &config) {
            let truth = truth(seconds(pose.time_ns)).expect("seen");
            let error = motion(&truth, &pose.world_from_foot)
                .fixed_rows::<3>(0)
                .norm();
            assert!(
                pose.status == FootStatus::Observed && error < 0.02,
                "{pose:?} {error}"
            );
        }
        let hidden = [0.8, 1.9, 3.0].map(|t| (1e9 * t) as i64);
        let lost = causal_poses(&observed, &hidden, &config);
        assert!(
            lost.iter()
                .all(|pose| pose.status == FootStatus::Lost && pose.covariance.is_none())
        );
    }
}
