//! Configuration of the prediction, and which scenes permit one.

use estimator_config::config;

use crate::error::{SimulationError, check_range};
use crate::scene::SceneData;

config! {
    /// How the PSNR of views is predicted.
    pub struct SupportConfig {
        /// Distance of the places at which images are judged, m.
        pub cell_m: f64 = 0.5,
        /// Headings at each place.
        pub headings: usize = 8,
        /// Field of view of the images from left to right, rad.
        pub field_of_view_rad: f64 = 1.6,
    }
}

impl SupportConfig {
    pub(crate) fn check(&self) -> Result<(), SimulationError> {
        for (name, value, range, expected) in [
            ("support.cell_m", self.cell_m, [0.05, 10.0], "0.05 to 10 m"),
            (
                "support.headings",
                self.headings as f64,
                [1.0, 64.0],
                "1 to 64",
            ),
            (
                "support.field_of_view_rad",
                self.field_of_view_rad,
                [0.1, 3.0],
                "0.1 to 3 rad",
            ),
        ] {
            check_range(name, value, range, expected)?;
        }
        Ok(())
    }

    /// Yaw of a heading, rad.
    pub(super) fn yaw_rad(&self, heading: usize) -> f64 {
        std::f64::consts::TAU * heading as f64 / self.headings as f64
    }
}

/// Refuses a scene of which it is not known what the training saw, for a setting that needs it.
pub(crate) fn check_scene(
    scene: &SceneData,
    name: &str,
    found: &str,
) -> Result<(), SimulationError> {
    let is_unknown = |sector: &&crate::scene::Sector| {
        let gaussians = sector.gaussians.as_ref();
        !gaussians.is_some_and(|gaussians| gaussians.is_observed())
    };
    match scene.sectors.iter().find(is_unknown) {
        None => Ok(()),
        Some(sector) => Err(SimulationError::Setting {
            name: name.to_owned(),
            found: found.to_owned(),
            expected: format!(
                "none: sector {} has no record of what the training of its Gaussians saw, which \
                 the stage splats writes",
                sector.name
            ),
        }),
    }
}
