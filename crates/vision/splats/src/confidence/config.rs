//! Constants of the measure of confidence.

use estimator_config::config;

use crate::error::SplatError;

config! {
    /// Configuration of what is gathered after a training and of the measure itself.
    pub struct ConfidenceConfig {
        /// Constants of what is gathered.
        pub coverage: CoverageConfig = CoverageConfig::default(),
        /// Constants of the measure.
        pub measure: MeasureConfig = MeasureConfig::default(),
    }

    /// Configuration of what is gathered from the views of a training.
    pub struct CoverageConfig {
        /// Weight at a pixel above which a view has seen a Gaussian.
        pub min_weight: f32 = 0.05,
        /// Edge of a voxel of the space through which views looked, m.
        pub voxel_m: f32 = 0.25,
        /// Distance from the camera up to which space counts as seen where a view shows no surface,
        /// m.
        pub range_m: f32 = 20.0,
        /// Every which pixel of a row and column looks through space.
        pub step_px: usize = 8,
        /// Texels along an edge of the map of directions in which sky was seen.
        pub sky_texels: usize = 32,
    }

    /// Configuration of the measure. The confidence of a pixel is `exp(-Σ a x)` over its channels
    /// `x` with these weights `a`.
    pub struct MeasureConfig {
        /// Weight of the share of the pixel's color that neither a Gaussian nor seen sky gives.
        pub uncovered: f32 = 1.0,
        /// Weight of the angle between the viewing direction and the nearest one that a view had,
        /// per rad beyond the spacing of directions.
        pub angle: f32 = 1.0,
        /// Weight of the share of Gaussians that fewer than three instants saw.
        pub few: f32 = 1.0,
        /// Weight of the magnification beyond the finest resolution of a view, per octave.
        pub magnification: f32 = 0.5,
        /// Weight of the share of the ray in space through which no view looked.
        pub space: f32 = 1.0,
        /// Weight of the spread of depth, relative to the depth.
        pub spread: f32 = 1.0,
        /// Error of color where nothing is known, 0 to 1.
        pub unknown_error: f32 = 0.3,
        /// Factor on the error of color in the views of the training.
        pub error_gain: f32 = 1.0,
        /// Relative error of depth where nothing is known.
        pub unknown_depth_error: f32 = 0.5,
        /// Predicted PSNR below which a view is outside of what was seen, dB.
        pub min_psnr_db: f32 = 18.0,
        /// Predicted median relative error of depth above which it is.
        pub max_depth_error: f32 = 0.1,
    }
}

impl CoverageConfig {
    /// # Errors
    /// [`SplatError::Setting`] if a setting is outside of its domain.
    pub(super) fn check(&self) -> Result<(), SplatError> {
        let setting = |name, found: f64, valid: bool, expected| match valid {
            true => Ok(()),
            false => Err(SplatError::Setting {
                name,
                found,
                expected,
            }),
        };
        let (voxel, range) = (f64::from(self.voxel_m), f64::from(self.range_m));
        setting(
            "voxel_m",
            voxel,
            (0.01..=10.0).contains(&voxel),
            "0.01 to 10",
        )?;
        setting(
            "range_m",
            range,
            (0.0..=1000.0).contains(&range),
            "0 to 1000",
        )?;
        setting("step_px", self.step_px as f64, self.step_px > 0, "above 0")?;
        let sky = self.sky_texels;
        setting(
            "sky_texels",
            sky as f64,
            (2..=4096).contains(&sky),
            "2 to 4096",
        )
    }
}
