//! Domain randomization: what differs from episode to episode besides start and goal.

use cad_transforms::RigidTransform;
use estimator_config::config;

use crate::SimulationError;
use crate::randomness::{RandomStream, Stream};

config! {
    /// Ranges of domain randomization. Each is drawn once per episode from a stream of its own, so
    /// that a range that is changed leaves all other draws as they are.
    pub struct RandomizationConfig {
        /// Scale of the maximum speed and of wheel speeds. 1 to 1 is none.
        pub speed_scale: [f64; 2] = [1.0, 1.0],
        /// Scale of the maximum yaw rate.
        pub yaw_rate_scale: [f64; 2] = [1.0, 1.0],
        /// Translation of the camera's mount along each axis, at most, m. Source of a value:
        /// GaussGym, 0.02.
        pub mount_m: f64 = 0.0,
        /// Rotation of the camera's mount about each axis, at most, rad. Source of a value:
        /// GaussGym, 0.03.
        pub mount_rad: f64 = 0.0,
        /// Yaw that is added to that of the start in free space, rad.
        pub start_yaw_rad: [f64; 2] = [-std::f64::consts::PI, std::f64::consts::PI],
    }
}

/// Parameters of an episode that differ from the nominal ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct EpisodeParameters {
    pub(crate) speed_scale: f64,
    pub(crate) yaw_rate_scale: f64,
    /// Translation, m, and rotation vector, rad, of the camera in the frame of its nominal mount.
    pub(crate) mount: [f64; 6],
}

impl RandomizationConfig {
    pub(crate) fn check(&self) -> Result<(), SimulationError> {
        let pi = std::f64::consts::PI;
        for (name, [low, high], [least, greatest]) in [
            ("speed_scale", self.speed_scale, [0.01, 100.0]),
            ("yaw_rate_scale", self.yaw_rate_scale, [0.01, 100.0]),
            ("mount_m", [0.0, self.mount_m], [0.0, 10.0]),
            ("mount_rad", [0.0, self.mount_rad], [0.0, pi]),
            ("start_yaw_rad", self.start_yaw_rad, [-pi, pi]),
        ] {
            if !(least <= low && low <= high && high <= greatest) {
                return Err(SimulationError::Setting {
                    name: format!("randomization.{name}"),
                    found: format!("{low} to {high}"),
                    expected: format!("an ascending range within {least} to {greatest}"),
                });
            }
        }
        Ok(())
    }

    pub(crate) fn draw(&self, seed: u64, episode: u64) -> EpisodeParameters {
        let stream = |stream| RandomStream::new(seed, episode, stream);
        let (dynamics, mount) = (stream(Stream::Dynamics), stream(Stream::Mount));
        let limits = [self.mount_m, self.mount_rad];
        EpisodeParameters {
            speed_scale: dynamics.range(0, self.speed_scale),
            yaw_rate_scale: dynamics.range(1, self.yaw_rate_scale),
            mount: std::array::from_fn(|k| {
                let limit = limits[k / 3];
                mount.range(k as u64, [-limit, limit])
            }),
        }
    }
}

impl EpisodeParameters {
    /// Without randomization.
    pub(crate) const NOMINAL: Self = Self {
        speed_scale: 1.0,
        yaw_rate_scale: 1.0,
        mount: [0.0; 6],
    };

    /// The camera on its mount, with the error of the mount.
    pub(crate) fn body_from_camera(&self, nominal: &RigidTransform) -> RigidTransform {
        let [x, y, z, a, b, c] = self.mount;
        if self.mount == [0.0; 6] {
            return *nominal;
        }
        match RigidTransform::from_rotation_vector([a, b, c], [x, y, z]) {
            Ok(mount_from_camera) => *nominal * mount_from_camera,
            Err(_) => *nominal,
        }
    }
}
