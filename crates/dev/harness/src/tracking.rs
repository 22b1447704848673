//! Odometry over a sequence, as poses that can be compared with ground truth: shared by tests and
//! benchmarks.
//!
//! Contract: [`Tracking`] is fed set by set, so that a caller can measure the time of each set;
//! reading its images is not part of that. Causal poses never change once they exist. Refined poses
//! are separate ([`Tracking::refine`]): the two are never mixed. *A pose that cannot be stored* (an
//! invalid covariance) is an error and not a pose.
//!
//! - [`drive`]: drift at the end of a drive (KITTI).
//! - [`still`]: estimates at rest (EuRoC).

use anyhow::{Context as _, Result};
use cad_transforms::Covariance;
use nalgebra::Matrix6;
use odometry::mapping::{
    Connectivity, OdomPose, RefinedExtrinsics, RefinedStereo, interpolate_poses,
};
use odometry::{CameraShift, Config, Estimate, ImuUse, Mapping, Odometry, Rig};
use scene_bundle::{Pose, Status, Trajectory};

use crate::sequences::{OwnedFrameSet, Sequence};

pub mod drive;
pub mod still;

/// Odometry over a sequence; see the module documentation.
pub struct Tracking {
    odometry: Odometry,
    mapping: Option<Mapping>,
    causal: Trajectory,
    odom: Vec<OdomPose>,
    keyframes: usize,
}

/// A whole session after bundle adjustment.
#[derive(Clone, Debug)]
pub struct RefinedWalk {
    /// One pose per causal pose. Its covariance is that of the causal pose where tracking was lost
    /// and the pose graph is not connected ([`Connectivity`]). The status is that of the causal
    /// pose, or relocalised.
    pub trajectory: Trajectory,
    /// Number of keyframes.
    pub keyframes: usize,
    /// Number of loop closures used.
    pub loop_closures: usize,
    /// Number of iterations.
    pub iterations: usize,
    /// Number of landmarks.
    pub landmarks: usize,
    /// Refined extrinsics of the cameras.
    pub extrinsics: Vec<RefinedExtrinsics>,
    /// Refined stereo calibrations of the cameras.
    pub stereo: Vec<RefinedStereo>,
}

impl Tracking {
    /// Odometry for a rig. Without mapping, keyframes are discarded immediately, and refinement is
    /// not possible.
    pub fn new(rig: &Rig, settings: Config, with_mapping: bool) -> Self {
        Self {
            odometry: Odometry::new(rig, settings),
            mapping: with_mapping.then(|| Mapping::new(rig, &settings)),
            causal: Trajectory::default(),
            odom: Vec::new(),
            keyframes: 0,
        }
    }

    /// Takes the next set with its samples.
    ///
    /// # Errors
    /// The pose cannot be stored in a trajectory.
    pub fn add(&mut self, set: &OwnedFrameSet) -> Result<Estimate> {
        for (k, samples) in set.imu.iter().enumerate() {
            for sample in samples {
                self.odometry.add_imu(k, sample);
                if let Some(mapping) = &mut self.mapping {
                    mapping.add_imu(k, sample);
                }
            }
        }
        let estimate = self.odometry.add_frames(&set.borrowed());
        self.take_keyframes(false);
        self.keyframes += usize::from(estimate.is_keyframe);
        let pose = pose(&estimate);
        let pose = pose.with_context(|| format!("adding the pose at {} ns", set.time_ns))?;
        self.causal.push(pose)?;
        if self.mapping.is_some() {
            self.odom.push(OdomPose::from(&estimate));
        }
        Ok(estimate)
    }

    fn take_keyframes(&mut self, all: bool) {
        for keyframe in self.odometry.take_keyframes(all) {
            if let Some(mapping) = &mut self.mapping {
                mapping.add_keyframe(keyframe);
            }
        }
    }

    /// The causal poses.
    pub fn causal(&self) -> &Trajectory {
        &self.causal
    }

    /// Number of keyframes.
    pub fn keyframes(&self) -> usize {
        self.keyframes
    }

    /// Detected camera shifts.
    pub fn camera_shifts(&self) -> &[CameraShift] {
        self.odometry.camera_shifts()
    }

    /// The IMUs that were used.
    pub fn imu_uses(&self) -> &[ImuUse] {
        self.odometry.imu_uses()
    }

    /// Bundle adjustment; `None` without mapping.
    ///
    /// # Errors
    /// A pose cannot be stored in a trajectory.
    pub fn refine(mut self) -> Result<Option<RefinedWalk>> {
        self.take_keyframes(true);
        let Some(mapping) = &self.mapping else {
            return Ok(None);
        };
        let adjusted = mapping.optimize(|_| {});
        Ok(Some(RefinedWalk {
            trajectory: refined_trajectory(&self.causal, &self.odom, &adjusted)?,
            keyframes: adjusted.poses.len(),
            loop_closures: adjusted.loop_closures.len(),
            iterations: adjusted.iterations,
            landmarks: adjusted.landmarks,
            extrinsics: adjusted.extrinsics,
            stereo: adjusted.stereo,
        }))
    }
}

/// One pose per causal pose, interpolated between refined keyframes; see
/// [`RefinedWalk::trajectory`].
/// `odom` are the poses of the same frame sets in the odom frame.
///
/// # Errors
/// A pose cannot be stored in a trajectory.
pub fn refined_trajectory(
    causal: &Trajectory,
    odom: &[OdomPose],
    adjusted: &odometry::MappingResult,
) -> Result<Trajectory> {
    let interpolated = interpolate_poses(odom, &adjusted.poses);
    let lost: Vec<(i64, bool)> = (causal.poses().iter())
        .map(|p| (p.time_ns, p.status == Status::Lost))
        .collect();
    let ties = adjusted.connectivity(&lost);
    let mut poses = Vec::with_capacity(odom.len());
    for ((pose, interpolated), tie) in causal.poses().iter().zip(interpolated).zip(ties) {
        let covariance = match tie {
            Connectivity::Unconstrained => pose.covariance,
            Connectivity::Continuous | Connectivity::LoopClosed => {
                Some(covariance(&interpolated.covariance)?)
            }
        };
        let status = match (pose.status, tie) {
            (Status::Tracked, Connectivity::LoopClosed) => Status::Relocalised,
            (status, _) => status,
        };
        poses.push(Pose {
            world_from_rig: interpolated.world_from_rig,
            covariance,
            velocity_in_world: None,
            status,
            ..pose.clone()
        });
    }
    Ok(Trajectory::new(poses)?)
}

/// All sets of a sequence.
///
/// # Errors
/// Images that cannot be read, and those of [`Tracking::add`].
pub fn track(sequence: &Sequence, settings: Config, with_mapping: bool) -> Result<Tracking> {
    let mut tracking = Tracking::new(sequence.rig(), settings, with_mapping);
    sequence.for_each(|set| tracking.add(&set).map(drop))?;
    Ok(tracking)
}

/// The true poses at the times of the sets.
///
/// # Errors
/// Times that do not increase.
pub fn truth(sequence: &Sequence) -> Result<Trajectory> {
    let poses = sequence.truth_at_sets().into_iter();
    Ok(Trajectory::new(
        poses.map(|(t, pose)| Pose::new(t, pose)).collect(),
    )?)
}

/// Converts an estimate to a pose of a trajectory.
///
/// # Errors
/// Its covariance is not valid.
pub fn pose(estimate: &Estimate) -> Result<Pose> {
    Ok(Pose {
        time_ns: estimate.time_ns,
        world_from_rig: estimate.world_from_rig,
        covariance: Some(covariance(&estimate.covariance)?),
        velocity_in_world: Some(estimate.velocity.into()),
        status: match estimate.status {
            odometry::Status::Tracked => Status::Tracked,
            odometry::Status::DeadReckoned => Status::DeadReckoned,
            odometry::Status::Lost => Status::Lost,
        },
    })
}

fn covariance(of: &Matrix6<f64>) -> Result<Covariance> {
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| of[(i, j)]));
    Covariance::from_rows(rows).context("the covariance of odometry")
}
