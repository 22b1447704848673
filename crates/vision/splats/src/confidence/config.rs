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
    /// `x` with these weights `a`. Source of all: `bench confidence`, its walks of the fit.
    pub struct MeasureConfig {
        /// Weight of the share of the pixel's color that neither a Gaussian nor observed sky gives.
        pub uncovered: f32 = 0.01,
        /// Weight of the angle between the viewing direction and the nearest one that a view had,
        /// per rad beyond the spacing of directions.
        pub angle: f32 = 0.45,
        /// Weight of the share of Gaussians that fewer than three instants saw.
        pub few: f32 = 0.01,
        /// Weight of the magnification beyond the finest resolution of a view, per octave.
        pub magnification: f32 = 0.26,
        /// Weight of the share of the ray in space through which no view looked.
        pub space: f32 = 24.0,
        /// Weight of the spread of depth, relative to the depth.
        pub spread: f32 = 0.01,
        /// Error of color where nothing is known, 0 to 1.
        pub unknown_error: f32 = 0.17,
        /// Factor on the error of color in the views of the training.
        pub error_gain: f32 = 0.9,
        /// The measure of the whole image.
        pub image: ImageMeasureConfig = ImageMeasureConfig::default(),
    }

    /// Configuration of the measure of a whole image: log odds that it is bad, a constant and
    /// weights of the means of its channels.
    pub struct ImageMeasureConfig {
        /// The constant. Its value is lower by the margin with which all bad images of the fit are
        /// flagged.
        pub constant: f32 = -6.284,
        /// Weight of the share of pixels without median depth.
        pub holes: f32 = 5.39,
        /// Weight of the share of color that no Gaussian gives.
        pub transparency: f32 = 5.68,
        /// Weight of the share of color that neither a Gaussian nor observed sky gives.
        pub uncovered: f32 = -1.86,
        /// Weight of the angle to the nearest observed direction, per rad.
        pub angle: f32 = -3.13,
        /// Weight of the share of Gaussians that fewer than three instants saw.
        pub few: f32 = -1.45,
        /// Weight of the magnification, per octave.
        pub magnification: f32 = 0.36,
        /// Weight of the share of rays through which no view looked.
        pub space: f32 = 2.39,
        /// Weight of the relative spread of depth.
        pub spread: f32 = 15.8,
        /// Weight of the error of color in the views of the training, 0 to 1.
        pub color_error: f32 = 42.7,
        /// Weight of the relative error of depth in them.
        pub depth_error: f32 = 12.9,
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
