//! Agreement of the cameras on the newest pose.
//!
//! A camera that faces down sees little but the wearer's legs on a plain floor. Without an IMU
//! nothing contradicts them: they are near, so that a dozen of their corners determine the position
//! more accurately than all distant ones of the other cameras, which are then outliers.
//!
//! So the pose is also estimated from each camera alone. If one of them contradicts all others, and
//! these agree with each other, its images are not used for the pose. If there is no majority, the
//! deviation is part of the uncertainty of the pose.

use nalgebra::{Matrix3, Vector3};

use crate::backend::covariance::NewestCovariance;
use crate::backend::newest_pose::{NewestInformation, refine_newest};
use crate::backend::state::State;
use crate::backend::window::Window;
use crate::config::EstimatorConfig;

/// Pose of one camera alone.
struct OwnPose {
    camera: usize,
    state: State,
    information: NewestInformation,
}

/// What the cameras agree on.
pub(super) enum Agreement {
    /// Nothing contradicts the pose of all cameras together.
    All,
    /// The pose was estimated again without a camera that contradicts all others.
    Majority(Option<Box<NewestInformation>>),
    /// Cameras contradict each other without a majority: covariance of the position in the world,
    /// by which they deviate from it.
    NoMajority(Matrix3<f64>),
}

/// Result of the pairwise comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Unanimous,
    /// This one contradicts all others, of which there are several that agree with each other.
    Alone(usize),
    Undecided,
}

fn verdict(count: usize, contradicts: impl Fn(usize, usize) -> bool) -> Verdict {
    let all_pairs = (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b)));
    let pairs: Vec<(usize, usize)> = all_pairs.filter(|(a, b)| contradicts(*a, *b)).collect();
    let is_alone = |k: usize| {
        count > 2 && pairs.len() == count - 1 && pairs.iter().all(|(a, b)| *a == k || *b == k)
    };
    match (0..count).find(|k| is_alone(*k)) {
        _ if pairs.is_empty() => Verdict::Unanimous,
        Some(k) => Verdict::Alone(k),
        None => Verdict::Undecided,
    }
}

/// Compares the cameras of a frame without an IMU. `guess` is the state before its images,
/// `start_covariance` that of the frame before it.
pub(super) fn compare_cameras(
    config: &EstimatorConfig,
    window: &mut Window,
    guess: &State,
    start_covariance: &NewestCovariance,
) -> Agreement {
    let last = window.frames.len() - 1;
    // With an IMU, objects that move are outliers from the start.
    let is_inertial = (window.frames[last].motion.as_ref()).is_some_and(|m| m.has_gravity);
    if is_inertial || window.cameras.len() < 2 {
        return Agreement::All;
    }
    let joint = window.frames[last].state;
    let rounds = window.config.newest_pose.max_iterations;
    let refine_with = |window: &mut Window, uses_camera: &dyn Fn(usize) -> bool| {
        window.frames[last].state = *guess;
        refine_newest(window, start_covariance, rounds, uses_camera)
    };
    let number = window.frames[last].number;
    let observed = |camera: usize| {
        let newest = (window.landmarks.values()).flat_map(|l| &l.observations[l.since(number)..]);
        newest.filter(|(_, o)| o.camera == camera).count()
    };
    // A camera that sees nothing would vote for the guess.
    let voters = (0..window.cameras.len()).filter(|k| observed(*k) >= config.min_inliers);
    let mut own = Vec::new();
    for camera in voters.collect::<Vec<_>>() {
        if let Some(information) = refine_with(window, &|k| k == camera) {
            own.push(OwnPose {
                camera,
                state: window.frames[last].state,
                information,
            });
        }
    }
    window.frames[last].state = joint;
    let inflation = window.config.covariance.sigma_inflation;
    let max_distance = config.max_camera_disagreement * inflation * inflation;
    match verdict(own.len(), |a, b| own[a].distance(&own[b]) > max_distance) {
        Verdict::Unanimous => Agreement::All,
        Verdict::Alone(dissenter) => {
            let camera = own[dissenter].camera;
            Agreement::Majority(refine_with(window, &|k| k != camera).map(Box::new))
        }
        Verdict::Undecided => {
            // Reported sigmas are multiplied by the inflation.
            let deviations = own
                .iter()
                .map(|one| (one.state.position - joint.position) / inflation);
            Agreement::NoMajority(deviations.map(|d| d * d.transpose()).sum())
        }
    }
}

impl OwnPose {
    /// Squared Mahalanobis distance between two positions, by covariances of the solver.
    fn distance(&self, other: &Self) -> f64 {
        let difference: Vector3<f64> = self.state.position - other.state.position;
        let covariance = self.information.difference_covariance(&other.information);
        let position = covariance.and_then(|c| c.fixed_view::<3, 3>(0, 0).cholesky());
        position.map_or(0.0, |factor| difference.dot(&factor.solve(&difference)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::observation::BearingObservation;
    use crate::backend::solver::tests::{
        add_constant_velocity, camera, start_covariance, window_of,
    };

    /// A window in which the features of some cameras move with the body, as the wearer's legs do.
    fn window_with_legs(cameras: usize, legs: usize) -> Window {
        let yaws = [-0.6, 0.5, 0.0];
        let mut window = window_of(yaws[..cameras].iter().map(|y| camera(*y, 0.0)).collect(), 4);
        add_constant_velocity(&mut window);
        for landmark in window.landmarks.values_mut() {
            for camera in cameras - legs..cameras {
                let of = |frame: u64| {
                    let mut all = landmark.observations.iter();
                    all.position(|(number, o)| *number == frame && o.camera == camera)
                };
                if let (Some(before), Some(newest)) = (of(2), of(3)) {
                    let still = landmark.observations[before].1;
                    let (_, moving) = &mut landmark.observations[newest];
                    (moving.left, moving.right) = (still.left, still.right);
                }
            }
        }
        window
    }

    fn compared(window: &mut Window) -> Agreement {
        let guess = window.newest().state;
        let config = EstimatorConfig::default();
        compare_cameras(&config, window, &guess, &start_covariance())
    }

    #[test]
    fn cameras_that_see_the_world_agree() {
        let mut window = window_with_legs(3, 0);
        assert!(matches!(compared(&mut window), Agreement::All));
    }

    #[test]
    fn camera_that_sees_legs_is_outvoted() {
        let mut window = window_with_legs(3, 1);
        let truth = window.newest().state;
        // Where the legs pull the pose.
        let last = window.frames.len() - 1;
        window.frames[last].state = window.frames[last - 1].state;
        let guess = window.frames[last].state;
        let config = EstimatorConfig::default();
        let agreement = compare_cameras(&config, &mut window, &guess, &start_covariance());
        assert!(matches!(agreement, Agreement::Majority(Some(_))));
        let error = (window.newest().state.position - truth.position).norm();
        assert!(error < 1e-3, "{error}");
    }

    #[test]
    fn cameras_that_see_nothing_do_not_vote() {
        let mut window = window_with_legs(3, 0);
        let number = window.newest().number;
        for landmark in window.landmarks.values_mut() {
            let is_seen = |(n, o): &(u64, BearingObservation)| *n != number || o.camera == 0;
            landmark.observations.retain(is_seen);
        }
        // With the predicted motion as their estimates, both would contradict the camera that sees.
        let last = window.frames.len() - 1;
        window.frames[last - 1].state.velocity.x += 20.0;
        let guess = window.frames[last].state;
        let mut start_covariance = start_covariance();
        start_covariance.joint *= 1e-6;
        let config = EstimatorConfig::default();
        let agreement = compare_cameras(&config, &mut window, &guess, &start_covariance);
        assert!(matches!(agreement, Agreement::All));
    }

    #[test]
    fn disagreement_of_two_cameras_is_uncertainty() {
        let mut window = window_with_legs(2, 1);
        let Agreement::NoMajority(covariance) = compared(&mut window) else {
            panic!("two cameras have no majority");
        };
        let n = window.frames.len();
        let motion = window.frames[n - 1].state.position - window.frames[n - 2].state.position;
        let inflation = window.config.covariance.sigma_inflation;
        let sigma = inflation * covariance.trace().sqrt();
        assert!(sigma > 0.5 * motion.norm(), "{sigma}");
    }

    #[test]
    fn majority_decides() {
        let of = |count, pairs: &[(usize, usize)]| verdict(count, |a, b| pairs.contains(&(a, b)));
        assert_eq!(of(3, &[]), Verdict::Unanimous);
        assert_eq!(of(3, &[(0, 1), (0, 2)]), Verdict::Alone(0));
        assert_eq!(of(3, &[(0, 2), (1, 2)]), Verdict::Alone(2));
        assert_eq!(of(3, &[(0, 1)]), Verdict::Undecided);
        assert_eq!(of(3, &[(0, 1), (0, 2), (1, 2)]), Verdict::Undecided);
        assert_eq!(of(2, &[(0, 1)]), Verdict::Undecided);
        assert_eq!(of(1, &[]), Verdict::Unanimous);
    }
}
