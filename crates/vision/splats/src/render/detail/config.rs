//! Constants of levels of detail.

use estimator_config::config;

config! {
    /// Configuration of [`DetailScene`](super::DetailScene).
    pub struct DetailConfig {
        /// Gaussians of a cluster. More are culled and coarsened together.
        pub cluster: usize = 64,
        /// Gaussians that one of the next level replaces, and clusters that it joins.
        pub merge: usize = 2,
        /// Number of levels above the originals.
        pub levels: usize = 10,
        /// Largest scale in the image that Gaussians of a coarser level may have, px: the mean over
        /// the cluster of the largest axis. More is faster and less sharp: in 48 views at 64 px of
        /// a trained scene the median PSNR to the exact renderer was 46.5 dB with 0.4 (fifth
        /// percentile 37.3), 41.5 dB with 0.5 (33.6), 39.3 dB with 0.6 (30.7).
        pub max_sigma_px: f32 = 0.4,
        /// Gaussians are merged only up to this factor on their largest scale.
        pub max_growth: f32 = 6.0,
        /// Dilation of the images in which coarser levels are used, px²: that of
        /// [`RenderConfig`](crate::RenderConfig), or 0 with its compensation.
        pub dilation_px2: f32 = 0.3,
        /// Alpha below which a Gaussian does not contribute to a pixel of a camera without
        /// distortion and motion.
        pub min_alpha: f32 = 1.0 / 255.0,
        /// Transmittance below which a pixel of such a camera is complete.
        pub min_transmittance: f32 = 1e-4,
    }
}

impl DetailConfig {
    /// The defaults for Gaussians that were trained with compensated dilation, or without: merged
    /// ones keep their light only with the dilation of the images that they are for.
    pub fn for_compensation(is_compensated: bool) -> Self {
        let mut config = Self::default();
        if is_compensated {
            config.dilation_px2 = 0.0;
        }
        config
    }
}
