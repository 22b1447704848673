//! Constants of the stage `splats`.

use ::splats::{CoverageConfig, RenderConfig, SectorConfig, StartConfig, TrainConfig};
use estimator_config::config;

use super::super::preset::Preset;

config! {
    /// Which images train the scene, and how.
    pub struct SplatsConfig {
        /// Factor by which images are reduced before the training: memory and time fall with its
        /// square.
        pub reduction: u32 = 1,
        /// Whether right images are used too. They double the views of near surfaces, at the same
        /// number of steps, and have no depth.
        pub right_images: bool = true,
        /// Every which instant is held out, with all of its cameras and both images.
        pub held_out_interval: usize = 8,
        /// Which of those instants, from 0.
        pub held_out_offset: usize = 2,
        /// Fewest usable images of a training; of one of several sectors half of the images that
        /// it may have inside, if those are fewer.
        pub min_images: usize = 20,
        /// Part of the poses in the standard deviation of a depth, m; as in the stage `terrain`.
        pub pose_sigma_m: f32 = 0.003,
        /// Nearest distance of what a mask of a left image shows, m, where it has no depth: it
        /// decides how wide the mask of the right image is. As in the stage `depth`.
        pub min_distance_m: f64 = 0.25,
        /// Exponent between radiance and the values of images. Source: IEC 61966-2-1, whose curve
        /// it approximates.
        pub gamma: f64 = 2.2,
        /// Texels along an edge of the map of the sky: 1.5 degrees each.
        pub sky_texels: usize = 128,
        /// Seed of all random numbers.
        pub seed: u64 = 1,
        /// Division of long walks.
        pub sectors: SectorConfig = SectorConfig::default(),
        /// Points at which the scene starts.
        pub start: StartConfig = StartConfig::default(),
        /// The training.
        pub train: TrainConfig = TrainConfig::default(),
        /// The renderer.
        pub render: RenderConfig = RenderConfig::default(),
        /// What is gathered of the views after the training.
        pub coverage: CoverageConfig = CoverageConfig::default(),
    }
}

impl SplatsConfig {
    /// Configuration of a preset, with another number of steps if one is given.
    pub fn preset(preset: Preset, steps: Option<usize>) -> Self {
        let mut config = Self {
            train: TrainConfig::preset(match preset {
                Preset::Fast => ::splats::Preset::Fast,
                Preset::Balanced => ::splats::Preset::Balanced,
                Preset::Accurate => ::splats::Preset::Accurate,
            }),
            ..Self::default()
        };
        if let Preset::Fast = preset {
            // Never full: reduced once and not in each step.
            config.reduction = 2;
            config.start.step_px = 2;
            config.train.full_from = config.train.quarter_until;
            config.train.quarter_until = 0.0;
        }
        config.train.steps = steps.unwrap_or(config.train.steps);
        // Half of the Gaussians: the others come by growth, where they are needed.
        config.start.max_points = config.train.growth.max_splats / 2;
        config
    }
}
