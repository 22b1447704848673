//! Constants of training.

use estimator_config::config;

/// Named settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// A few minutes of quality: 2000 steps at half size, one color from all sides.
    Fast,
    /// The default.
    Balanced,
    /// More Gaussians and steps, up to the gain of held-out images.
    Accurate,
    /// The settings of PAWS, which are those of Splatfacto with changes: growth by absolute
    /// gradients above 0.0006 until step 25 000, learning rate of means 5e-5, size 0.1 %, poses
    /// refined. Lengths are in its units: the largest coordinate of a camera is 1.
    Paws,
}

config! {
    /// Configuration of a training.
    pub struct TrainConfig {
        /// Number of steps, one image each.
        pub steps: usize = 7000,
        /// Degree of the spherical harmonics. 0 where surfaces look alike from all sides, which is
        /// what held-out images decide.
        pub degree: usize = 1,
        /// Share of the steps from which the first degree above 0 is trained; the others follow at
        /// equal distances until the end.
        pub degree_start: f32 = 0.5,
        /// Every which step trains the harmonics above degree 0: they are most of the memory.
        /// Source: Mallick et al., Taming 3DGS, 2024, with 16.
        pub harmonics_interval: usize = 4,
        /// Share of the steps with images at a quarter of their size.
        pub quarter_until: f32 = 0.07,
        /// Share of the steps from which images have their full size; at half before.
        pub full_from: f32 = 0.28,
        /// Settings of the loss.
        pub loss: LossConfig = LossConfig::default(),
        /// Settings of the optimizer.
        pub optimizer: OptimizerConfig = OptimizerConfig::default(),
        /// Settings of growth and removal.
        pub growth: GrowthConfig = GrowthConfig::default(),
        /// Settings of poses.
        pub poses: PoseConfig = PoseConfig::default(),
        /// Settings of exposures.
        pub exposure: ExposureConfig = ExposureConfig::default(),
    }

    /// Configuration of the loss.
    pub struct LossConfig {
        /// Weight of SSIM against L1. Source: Kerbl et al. 2023.
        pub ssim_weight: f32 = 0.2,
        /// Weight of the depth term at the first step. A likelihood: photometric errors of 0.03
        /// that 25 pixels share, depths that the 63 pixels of a matching window share.
        pub depth_weight: f32 = 0.012,
        /// The weight at the last step as a share of that at the first one.
        pub depth_decay: f32 = 0.1,
        /// Errors of depth count linearly beyond this, sigmas.
        pub depth_scale: f32 = 2.0,
        /// Smallest standard deviation of a depth, m.
        pub min_depth_sigma_m: f32 = 0.005,
        /// Noise of the images below which errors do not call for more Gaussians, 0 to 1.
        pub noise: f32 = 0.02,
    }

    /// Configuration of the optimizer, Adam (Kingma and Ba 2015), on the visible Gaussians of a
    /// step.
    pub struct OptimizerConfig {
        /// Learning rate of positions at the first step as a share of the largest scale of a
        /// Gaussian. One rate for all is too fast for small Gaussians nearby or too slow for large
        /// ones far away.
        pub position_by_size: f32 = 0.03,
        /// Added to it, per metre of the scene's radius. Source of rates by radius: Kerbl et al.
        /// 2023.
        pub position: f32 = 0.0,
        /// The learning rate of positions at the last step as a share of that at the first one.
        pub position_decay: f32 = 0.01,
        /// Learning rate of the logarithms of scales.
        pub scale: f32 = 5e-3,
        /// Learning rate of rotations.
        pub rotation: f32 = 1e-3,
        /// Learning rate of the logits of opacities.
        pub opacity: f32 = 5e-2,
        /// Learning rate of the harmonics of degree 0.
        pub color: f32 = 5e-3,
        /// Learning rate of the other harmonics.
        pub harmonics: f32 = 1.25e-4,
        /// Learning rate of the background's colors.
        pub background: f32 = 2.5e-3,
        /// Decay of the first moment.
        pub beta1: f32 = 0.9,
        /// Decay of the second moment.
        pub beta2: f32 = 0.999,
        /// Added to the root of the second moment. Source: Kerbl et al. 2023.
        pub epsilon: f32 = 1e-15,
    }

    /// Configuration of growth and removal of Gaussians.
    pub struct GrowthConfig {
        /// First step.
        pub start: usize = 300,
        /// Share of the steps after which the number of Gaussians does not change.
        pub stop: f32 = 0.8,
        /// Steps between two rounds.
        pub interval: usize = 200,
        /// Largest share of the Gaussians that one round splits.
        pub max_share: f32 = 0.1,
        /// Largest number of Gaussians.
        pub max_splats: usize = 500_000,
        /// Gaussians are split by their absolute gradient in place of the error that they show.
        pub by_gradient: bool = false,
        /// Mean over views of the absolute gradient above which Gaussians are split or cloned, per
        /// half image (Ye et al., AbsGS, 2024). Used with `by_gradient` only.
        pub min_gradient: f32 = 8e-4,
        /// Largest scale up to which Gaussians are cloned and not split, as a share of the scene's
        /// radius. Used with `by_gradient` only.
        pub clone_size: f32 = 0.01,
        /// Error times pixels in one view from which on a Gaussian can be split: a tenth of the
        /// range over ten pixels.
        pub min_error_px: f32 = 1.0,
        /// Instants that have to show such an error.
        pub min_instants: u32 = 2,
        /// Opacity below which Gaussians are removed.
        pub min_opacity: f32 = 0.005,
        /// Pixels that a Gaussian has to fill in one view at least. Those that no view has shown
        /// since the last round are kept.
        pub min_weight_px: f32 = 0.05,
        /// Largest scale, as a share of the scene's radius.
        pub max_size: f32 = 0.5,
        /// Steps between two resets of opacities; 0 for none.
        pub reset_interval: usize = 0,
        /// Opacity after a reset.
        pub reset_opacity: f32 = 0.2,
        /// Growth by need: PSNR of held-out views that a tenth more Gaussians has to gain, dB; 0
        /// to grow without the check. The upper bound of the gain (two standard errors) counts.
        pub min_gain_db: f32 = 0.05,
        /// Factor on the number of Gaussians between two checks.
        pub check_factor: f32 = 1.5,
        /// Share of the Gaussians by which the two scenes that are compared differ.
        pub check_share: f32 = 0.2,
        /// Steps of both of them before they are compared. Fewer and the halves of a split Gaussian
        /// have not parted.
        pub check_steps: usize = 200,
        /// Held-out views in which they are compared, at most. The differences are paired, so that
        /// more of them change little.
        pub check_views: usize = 64,
        /// Checks in a row without gain that end growth. One is not enough: a scene that has not
        /// converged gains from neither.
        pub failed_checks: usize = 2,
    }

    /// Configuration of the refinement of poses.
    pub struct PoseConfig {
        /// Whether poses are refined. Poses of a bundle adjustment rarely gain.
        pub refine: bool = false,
        /// First step.
        pub start: usize = 1000,
        /// Standard deviation of a position before refinement, m.
        pub position_sigma_m: f32 = 0.005,
        /// Standard deviation of a rotation before refinement, rad.
        pub rotation_sigma_rad: f32 = 5e-4,
        /// Learning rate, sigmas a step.
        pub rate: f32 = 0.02,
        /// Weight of half a squared sigma of a pose against the mean loss of one image.
        pub prior_weight: f32 = 3e-6,
    }

    /// Configuration of the refinement of exposures: one gain per group of images.
    pub struct ExposureConfig {
        /// Whether gains are refined.
        pub refine: bool = false,
        /// Standard deviation of the logarithm of a gain before refinement.
        pub sigma: f32 = 0.05,
        /// Learning rate, sigmas a step.
        pub rate: f32 = 0.02,
        /// Weight of half a squared sigma against the mean loss of one image.
        pub prior_weight: f32 = 3e-5,
    }
}

impl TrainConfig {
    /// Named settings.
    ///
    /// ```
    /// use splats::{Preset, TrainConfig};
    ///
    /// let paws = TrainConfig::preset(Preset::Paws);
    /// assert_eq!((paws.steps, paws.growth.min_gradient), (30_000, 6e-4));
    /// assert!(paws.poses.refine && paws.growth.by_gradient);
    /// ```
    pub fn preset(preset: Preset) -> Self {
        let mut config = Self::default();
        match preset {
            Preset::Fast => {
                config.steps = 2000;
                config.degree = 0;
                config.quarter_until = 0.25;
                // Never full.
                config.full_from = 2.0;
                config.growth.max_splats = 60_000;
            }
            Preset::Balanced => config.growth.max_splats = 150_000,
            Preset::Accurate => {
                config.steps = 20_000;
                config.growth.min_gain_db = 0.02;
            }
            Preset::Paws => config.set_paws(),
        }
        config
    }

    /// PAWS states the absolute gradient, the rate of means, the end of growth, the size and the
    /// refinement of poses; the others are Splatfacto's.
    fn set_paws(&mut self) {
        self.steps = 30_000;
        self.degree = 3;
        self.degree_start = 1.0 / 30.0;
        self.harmonics_interval = 1;
        self.quarter_until = 0.1;
        self.full_from = 0.2;
        self.loss.depth_weight = 0.0;
        let optimizer = &mut self.optimizer;
        (optimizer.position, optimizer.position_by_size) = (5e-5, 0.0);
        optimizer.color = 2.5e-3;
        let growth = &mut self.growth;
        (growth.start, growth.interval) = (500, 100);
        growth.stop = 25.0 / 30.0;
        (growth.by_gradient, growth.min_gradient) = (true, 6e-4);
        growth.clone_size = 1e-3;
        (growth.max_share, growth.max_splats) = (1.0, 10_000_000);
        (growth.min_opacity, growth.min_weight_px) = (0.1, 0.0);
        (growth.reset_interval, growth.reset_opacity) = (3000, 0.2);
        growth.min_gain_db = 0.0;
        self.poses.refine = true;
    }
}
