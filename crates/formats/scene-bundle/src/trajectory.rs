//! Trajectory: poses of the rig over time.
//!
//! Contract: a [`Trajectory`] that exists has strictly rising times and finite numbers. Nothing is
//! interpolated: during tracking loss there are poses with status [`Status::Lost`], or none. Times
//! are those of the recording (i64 ns, CLOCK_MONOTONIC of the recorder); a trajectory read from a
//! peer's file has that file's times.

use cad_transforms::{Covariance, RigidTransform};
use serde::{Deserialize, Serialize};

/// How a pose was obtained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Tracked by the cameras, continuously from before.
    Tracked,
    /// Dead reckoning: too few visual observations; the pose is propagated by the IMU, and its
    /// uncertainty grows.
    DeadReckoned,
    /// Tracked again after tracking loss: as accurate as tracked within its span; tied to the poses
    /// before the loss only by a loop closure.
    Relocalised,
    /// No usable pose. The transform is the last known one and must not be used; the row keeps the
    /// time.
    Lost,
}

impl Status {
    /// Every status, in the order of their codes.
    pub const ALL: [Self; 4] = [
        Self::Tracked,
        Self::DeadReckoned,
        Self::Relocalised,
        Self::Lost,
    ];

    /// Its code in tables: 0 tracked, 1 dead reckoned, 2 relocalised, 3 lost.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// The status of a number in a table.
    ///
    /// ```
    /// use scene_bundle::Status;
    ///
    /// assert_eq!(Status::from_code(1), Some(Status::DeadReckoned));
    /// assert_eq!(Status::from_code(4), None);
    /// assert!(Status::ALL.iter().all(|status| Status::from_code(status.code()) == Some(*status)));
    /// ```
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code)).copied()
    }

    /// Its name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tracked => "tracked",
            Self::DeadReckoned => "dead_reckoned",
            Self::Relocalised => "relocalised",
            Self::Lost => "lost",
        }
    }
}

/// Pose of the rig at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    /// Time in nanoseconds.
    pub time_ns: i64,
    /// Takes points in the rig's frame (or the body's, of a peer's file) to the world, metres.
    pub world_from_rig: RigidTransform,
    /// Covariance of a small motion of the rig in its own axes, see [`cad_transforms::covariance`].
    pub covariance: Option<Covariance>,
    /// Velocity of the rig's origin along the world's axes, m/s.
    pub velocity_in_world: Option<[f64; 3]>,
    /// How the pose was come by.
    pub status: Status,
}

impl Pose {
    /// A tracked pose without covariance or velocity.
    pub fn new(time_ns: i64, world_from_rig: RigidTransform) -> Self {
        Self {
            time_ns,
            world_from_rig,
            covariance: None,
            velocity_in_world: None,
            status: Status::Tracked,
        }
    }
}

/// Why poses are not a trajectory.
///
/// ```
/// use cad_transforms::RigidTransform;
/// use scene_bundle::{Pose, Trajectory};
///
/// let pose = |time_ns| Pose::new(time_ns, RigidTransform::identity());
/// let error = Trajectory::new(vec![pose(10), pose(20), pose(20)]).unwrap_err();
/// assert_eq!(
///     error.to_string(),
///     "checking a trajectory: pose 2 is at 20 ns, expected later than the one before, 20 ns"
/// );
/// ```
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// A time is not later than the one before.
    #[error(
        "checking a trajectory: pose {index} is at {found_ns} ns, expected later than the one before, {previous_ns} ns"
    )]
    NotRising {
        /// Which pose, from 0.
        index: usize,
        /// Its time.
        found_ns: i64,
        /// The time of the pose before.
        previous_ns: i64,
    },
    /// A velocity is NaN or infinite. (A transform or covariance cannot be.)
    #[error(
        "checking a trajectory: the velocity of pose {index} is {found:?} m/s, expected finite numbers"
    )]
    Velocity {
        /// Which pose, from 0.
        index: usize,
        /// The velocity as found.
        found: [f64; 3],
    },
}

/// Poses with strictly rising times. May be empty.
///
/// ```
/// use cad_transforms::RigidTransform;
/// use scene_bundle::{Pose, Status, Trajectory};
///
/// let pose = |i: i64, status| -> Result<Pose, cad_transforms::TransformError> {
///     let world_from_rig = RigidTransform::from_translation_m([0.5 * i as f64, 0.0, 1.4])?;
///     Ok(Pose { status, ..Pose::new(i * 500_000_000, world_from_rig) })
/// };
/// let mut trajectory = Trajectory::new(vec![pose(0, Status::Tracked)?, pose(1, Status::Tracked)?])?;
/// trajectory.push(pose(2, Status::Lost)?)?;
///
/// assert_eq!(trajectory.duration_ns(), 1_000_000_000);
/// assert_eq!(trajectory.usable().count(), 2);
/// // The step to the lost pose does not count.
/// assert_eq!(trajectory.path_length_m(), 0.5);
/// let spans = trajectory.spans();
/// assert_eq!((spans.len(), spans[1].status, spans[1].from_ns), (2, Status::Lost, 1_000_000_000));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    poses: Vec<Pose>,
}

/// Consecutive poses of one status.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Span {
    /// The status all of them have.
    pub status: Status,
    /// Number of the first pose, from 0.
    pub first: usize,
    /// Number of poses, at least 1.
    pub count: usize,
    /// Time of the first pose, ns.
    pub from_ns: i64,
    /// Time of the last pose, ns. No status is stated between it and the next span's first pose.
    pub to_ns: i64,
}

impl Trajectory {
    /// Checks poses and takes them.
    ///
    /// # Errors
    /// [`TrajectoryError`], naming the first pose that does not fit.
    pub fn new(poses: Vec<Pose>) -> Result<Self, TrajectoryError> {
        for (index, pose) in poses.iter().enumerate() {
            check(index, pose, index.checked_sub(1).map(|i| poses[i].time_ns))?;
        }
        Ok(Self { poses })
    }

    /// Takes one more pose at the end.
    ///
    /// # Errors
    /// [`TrajectoryError`]; the trajectory is then as before.
    pub fn push(&mut self, pose: Pose) -> Result<(), TrajectoryError> {
        let last_ns = self.poses.last().map(|p| p.time_ns);
        check(self.poses.len(), &pose, last_ns)?;
        self.poses.push(pose);
        Ok(())
    }

    /// The poses, times rising.
    pub fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// Returns the poses by value.
    pub fn into_poses(self) -> Vec<Pose> {
        self.poses
    }

    /// Number of poses.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// The poses that can be used: all that are not lost.
    pub fn usable(&self) -> impl Iterator<Item = &Pose> {
        self.poses.iter().filter(|p| p.status != Status::Lost)
    }

    /// The pose at exactly this time.
    pub fn at(&self, time_ns: i64) -> Option<&Pose> {
        let found = self.poses.binary_search_by_key(&time_ns, |p| p.time_ns);
        found.ok().map(|index| &self.poses[index])
    }

    /// From the first pose to the last, ns; 0 with fewer than two.
    pub fn duration_ns(&self) -> i64 {
        match (self.poses.first(), self.poses.last()) {
            (Some(first), Some(last)) => last.time_ns.saturating_sub(first.time_ns),
            _ => 0,
        }
    }

    /// Runs of poses of equal status, in order. Together they are all poses, each once.
    pub fn spans(&self) -> Vec<Span> {
        let mut spans: Vec<Span> = Vec::new();
        for (index, pose) in self.poses.iter().enumerate() {
            append_span(&mut spans, index, pose);
        }
        spans
    }

    /// Path length of the rig's origin, metres: straight from pose to pose. A step from or to a
    /// lost pose does not count, since its length is not known. Jitter counts in full, so the sum
    /// grows with the rate of the poses.
    pub fn path_length_m(&self) -> f64 {
        let steps = self.poses.windows(2);
        steps
            .filter(|pair| pair.iter().all(|p| p.status != Status::Lost))
            .map(|pair| {
                let [from, to] = [&pair[0], &pair[1]].map(|p| *p.world_from_rig.translation());
                (to - from).norm()
            })
            .sum()
    }
}

/// Adds a pose to the span it continues, or begins one.
pub(crate) fn append_span(spans: &mut Vec<Span>, index: usize, pose: &Pose) {
    match spans.last_mut() {
        Some(span) if span.status == pose.status => {
            span.count += 1;
            span.to_ns = pose.time_ns;
        }
        _ => spans.push(Span {
            status: pose.status,
            first: index,
            count: 1,
            from_ns: pose.time_ns,
            to_ns: pose.time_ns,
        }),
    }
}

/// Checks a pose that follows one at `previous_ns`.
pub(crate) fn check(
    index: usize,
    pose: &Pose,
    previous_ns: Option<i64>,
) -> Result<(), TrajectoryError> {
    if let Some(previous_ns) = previous_ns
        && pose.time_ns <= previous_ns
    {
        return Err(TrajectoryError::NotRising {
            index,
            found_ns: pose.time_ns,
            previous_ns,
        });
    }
    match pose.velocity_in_world {
        Some(found) if found.iter().any(|v| !v.is_finite()) => {
            Err(TrajectoryError::Velocity { index, found })
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests;
