//! Constants of rendering.

use estimator_config::config;

config! {
    /// Configuration of the renderers.
    pub struct RenderConfig {
        /// Variance that is added to every Gaussian in the image, px². Source: the published
        /// implementation of 3DGS (Kerbl et al. 2023); 0.1 with compensation is common too. Less
        /// lets distant Gaussians vanish between pixels, more blurs.
        pub dilation_px2: f32 = 0.3,
        /// Whether opacity falls as dilation enlarges (Yu et al., Mip-Splatting, 2024). Scenes
        /// trained with it need it for rendering, others must not have it.
        pub compensate: bool = false,
        /// Lower bound of that factor on the opacity. Source: gsplat.
        pub min_compensation: f32 = 0.005,
        /// Largest alpha of a Gaussian at a pixel. Backward divides by `1 - alpha`.
        pub max_alpha: f32 = 0.99,
        /// Alpha below which a Gaussian does not contribute to a pixel. Source: one step of 8 bits.
        pub min_alpha: f32 = 1.0 / 255.0,
        /// Transmittance at which a pixel is complete; the Gaussian that would reach it is left
        /// out.
        pub min_transmittance: f32 = 1e-4,
        /// Accumulated alpha below which a pixel has no expected depth, and no median depth below a
        /// half by definition.
        pub min_depth_alpha: f32 = 0.1,
        /// Variance that is added to a Gaussian's covariance in the image before the slope of its
        /// depth is taken, px². More damps the slope of discs that are thinner than a pixel, less
        /// lets the slope of edge-on discs grow.
        pub slope_dilation_px2: f32 = 0.03,
        /// Largest change of a Gaussian's depth over its pixels, as a share of the distance of its
        /// mean from `near_m`. 0: the depth of a Gaussian is that of its mean. In two trained
        /// scenes 0.2 had smaller errors than 0.1 (medians) and than 0.5 (95th percentiles).
        pub max_slope_share: f32 = 0.2,
        /// Nearest depth that is rendered, m. A Gaussian whose mean is nearer is not rendered.
        pub near_m: f32 = 0.05,
        /// Farthest depth that is rendered, m.
        pub far_m: f32 = 1e5,
        /// Share of the image size beyond its border up to which the projection of a pinhole camera
        /// is linearized at the mean itself; farther out at that border, because the
        /// linearization diverges. Source: gsplat. Of a lens with distortion, which has no such
        /// bound, Gaussians with their mean beyond that border are not rendered.
        pub margin: f32 = 0.15,
        /// Smallest share of an image's height left of a Gaussian that a rolling shutter
        /// compresses: `1 - time gradient · pixel velocity`. Below it the Gaussian is not rendered.
        pub min_shear: f32 = 0.1,
    }
}
