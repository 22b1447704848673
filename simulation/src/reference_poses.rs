//! Recorded camera poses, and how far a camera is from them.
//!
//! A view is as good as the recorded views around it. The nearest recorded camera is the one of
//! least weighted distance in position and viewing direction, found by a k-d tree over both.

mod tree;

use cad_transforms::RigidTransform;
use estimator_config::config;

use tree::Tree;

use crate::error::{SimulationError, check_range};

config! {
    /// What makes a recorded camera near.
    pub struct DeviationConfig {
        /// Distance that counts as one, m. Source: PAWS augments views by at most 3 m. Only the
        /// ratio to `angle_rad` matters: a small value looks for near cameras whatever they see.
        pub distance_m: f64 = 3.0,
        /// Angle of viewing directions that counts as one, rad. Source: PAWS augments views by at
        /// most 30 degrees.
        pub angle_rad: f64 = std::f64::consts::FRAC_PI_6,
    }
}

impl DeviationConfig {
    /// Factors of positions and of viewing directions.
    fn weights(&self) -> [f64; 2] {
        [1.0 / self.distance_m, 1.0 / self.angle_rad]
    }
}

/// Difference of a camera pose and the nearest recorded one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation {
    /// Distance of the two optical centers, m.
    pub distance_m: f64,
    /// Angle of the two optical axes, rad in `0..=π`. Rotation about the axis changes no view and
    /// does not count.
    pub angle_rad: f64,
    /// Index of the recorded pose.
    pub index: usize,
}

/// Recorded camera poses of a sector.
///
/// ```
/// use cad_transforms::RigidTransform;
/// use simulation::{DeviationConfig, ReferencePoses};
///
/// let poses = [0.0, 1.0, 2.0].map(|x| RigidTransform::from_translation_m([x, 0.0, 0.0]).unwrap());
/// let references = ReferencePoses::new(poses.to_vec(), &DeviationConfig::default())?;
/// let world_from_camera = RigidTransform::from_translation_m([1.1, 0.0, 0.3]).unwrap();
/// let deviation = references.nearest(&world_from_camera);
/// assert_eq!(deviation.index, 1);
/// assert!((deviation.distance_m - 0.1_f64.hypot(0.3)).abs() < 1e-12);
/// assert_eq!(deviation.angle_rad, 0.0);
/// # Ok::<(), simulation::SimulationError>(())
/// ```
#[derive(Clone, Debug)]
pub struct ReferencePoses {
    world_from_camera: Vec<RigidTransform>,
    config: DeviationConfig,
    tree: Tree,
}

impl ReferencePoses {
    /// # Errors
    /// [`SimulationError::Scene`] without poses, [`SimulationError::Setting`] for units that are
    /// not above 0.
    pub fn new(
        world_from_camera: Vec<RigidTransform>,
        config: &DeviationConfig,
    ) -> Result<Self, SimulationError> {
        for (name, unit) in [
            ("deviation.distance_m", config.distance_m),
            ("deviation.angle_rad", config.angle_rad),
        ] {
            check_range(name, unit, [f64::MIN_POSITIVE, 1e12], "above 0")?;
        }
        if world_from_camera.is_empty() {
            return Err(SimulationError::Scene {
                place: "reference poses".to_owned(),
                found: "none".to_owned(),
                expected: "at least one recorded camera pose".to_owned(),
            });
        }
        let points = world_from_camera.iter().map(coordinates).collect();
        Ok(Self {
            world_from_camera,
            config: *config,
            tree: Tree::new(points, config.weights()),
        })
    }

    /// The poses, in the order in which they were given.
    pub fn poses(&self) -> &[RigidTransform] {
        &self.world_from_camera
    }

    /// The nearest recorded pose: of least sum of squares of distance and viewing angle (its
    /// chord), each in units of the configuration. Of equal ones the first.
    pub fn nearest(&self, world_from_camera: &RigidTransform) -> Deviation {
        self.nearest_by(world_from_camera, &self.config)
    }

    /// The same in other units, which are above 0.
    pub(crate) fn nearest_by(
        &self,
        world_from_camera: &RigidTransform,
        config: &DeviationConfig,
    ) -> Deviation {
        let point = coordinates(world_from_camera);
        let index = self.tree.nearest(&point, config.weights());
        self.between(world_from_camera, index)
    }

    /// Difference of a camera and the recorded pose `index`.
    ///
    /// # Panics
    /// Without such a pose.
    pub fn between(&self, world_from_camera: &RigidTransform, index: usize) -> Deviation {
        let reference = &self.world_from_camera[index];
        let offset = world_from_camera.translation() - reference.translation();
        let [a, b] = [world_from_camera, reference].map(viewing_direction);
        let cross = [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ];
        let sine = (cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2]).sqrt();
        let cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        Deviation {
            distance_m: offset.norm(),
            angle_rad: libm::atan2(sine, cosine),
            index,
        }
    }
}

/// Optical axis in the world, of unit length.
pub(crate) fn viewing_direction(world_from_camera: &RigidTransform) -> [f64; 3] {
    world_from_camera.rotate([0.0, 0.0, 1.0])
}

/// Position and viewing direction.
fn coordinates(world_from_camera: &RigidTransform) -> [f64; 6] {
    let [x, y, z] = world_from_camera.translation_m();
    let [a, b, c] = viewing_direction(world_from_camera);
    [x, y, z, a, b, c]
}

#[cfg(test)]
mod tests;
