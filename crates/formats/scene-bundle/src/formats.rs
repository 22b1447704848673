//! Trajectories in other text formats.
//!
//! Contract: times are integers of nanoseconds on both sides; decimals are parsed exactly, never
//! through a floating-point number. Digits below a nanosecond are rounded to the nearest, halves
//! away from zero. Numbers are written with the digits that read back to the same bits. What cannot
//! be read is an error that names the line, what was found and what was expected. Times rise from
//! line to line; of consecutive lines with the same time the first is used, with a warning.
//! [`Lost`](crate::Status::Lost) poses are not written, since none of these formats can mark a pose
//! as invalid. Status and covariance are lost; poses that are read are
//! [`Tracked`](crate::Status::Tracked).

pub mod euroc;
pub mod kitti;
pub mod tum;

mod seconds;
mod text;

pub use seconds::{format_seconds, parse_seconds};
pub use text::FormatError;

#[cfg(test)]
mod tests {
    use cad_transforms::{Covariance, RigidTransform};

    use crate::trajectory::{Pose, Status, Trajectory};

    /// A walk with a full rotation, every status and numbers of many digits.
    pub(super) fn walk() -> Trajectory {
        let poses = (0..200).map(|i| {
            let s = f64::from(i);
            let turn = [0.3 * (s * 0.1).sin(), 0.01 * s, s * 0.05 - 3.0];
            let place = [s / 7.0, (s * 0.3).cos() * 1e-7, 1.4 + 1e3 * (s * 0.2).sin()];
            Pose {
                time_ns: 1_403_715_273_262_142_976 + i64::from(i) * 33_333_333,
                world_from_rig: RigidTransform::from_rotation_vector(turn, place).unwrap(),
                covariance: Some(Covariance::from_sigmas([1e-3; 3], [1e-4; 3]).unwrap()),
                velocity_in_world: Some([1.4, s / 3.0, -1e-9 * s]),
                status: Status::from_code((i / 50) as u8).unwrap(),
            }
        });
        Trajectory::new(poses.collect()).unwrap()
    }

    /// The part that time and pose alone represent: no lost poses, all tracked, no covariance, no
    /// velocity.
    pub(super) fn bare(trajectory: &Trajectory) -> Trajectory {
        let poses = trajectory.usable();
        Trajectory::new(
            poses
                .map(|p| Pose::new(p.time_ns, p.world_from_rig))
                .collect(),
        )
        .unwrap()
    }
}
