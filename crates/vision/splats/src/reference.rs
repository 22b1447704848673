//! The reference implementation: f64, one pixel and one Gaussian after the other, no tiles.
//!
//! It defines what an image is; the fast renderer is compared with it, and it with finite
//! differences. Sources: projection, blending and their gradients of Kerbl et al., 3D Gaussian
//! Splatting, 2023, after Zwicker et al., EWA Splatting, 2002; gradients as in Ye and Kanazawa,
//! Mathematical Supplement for the gsplat Library, 2023.
//!
//! For each pixel `u`, over Gaussians in the order of their depth z: `σ = ½ dᵀ Q d` with `d = u -
//! m`, `α = min(max_alpha, o exp(-σ))`, skipped below `min_alpha`; color, depth and transmittance
//! are `C += T α c`, `D += T α (z + gᵀ d)`, `T ← T (1 - α)`; a Gaussian that would take T to
//! `min_transmittance` or below ends the pixel and is left out. Accumulated alpha is `1 - T`, the
//! expected depth `D / (1 - T)`, the median depth the `z + gᵀ d` of the Gaussian that takes T to a
//! half or below.
//!
//! The slope g of the depth is that of its conditional mean given the pixel, from the covariance of
//! both under the affine projection at the mean: with `S` the covariance in the image before
//! dilation and `c` that of pixel and depth `g = f (S + δ I)⁻¹ c`. The factor `f ≤ 1` bounds the
//! depth: `√(gᵀ (S + ε I) g)` is at most a share of `z - near`, over the extent of the ellipse of
//! an opaque Gaussian in standard deviations. Depth is that at the reference time of a shutter.
//!
//! ```
//! use cad_transforms::RigidTransform;
//! use camera_models::{CameraModel, Distortion};
//! use splats::{Background, Camera, Exposure, RenderConfig, Scene, Splat, Splats, reference};
//!
//! let mut splats = Splats::empty(0)?;
//! let ball = Splat::sphere(0.1, [1.0, 0.0, 0.0]);
//! let ball = Splat { opacity_logit: 9.0, position_m: [0.0, 0.0, 2.0], ..ball };
//! splats.push(&ball)?;
//! let scene = Scene { splats, background: Background::Constant([0.0, 0.0, 1.0]) };
//! let model = CameraModel::new((9, 9), [20.0, 20.0, 4.0, 4.0], Distortion::None);
//! let camera = Camera::new(model, RigidTransform::identity())?;
//!
//! let scene = reference::Scene::from(&scene);
//! let image = reference::render(&scene, &camera, &Exposure::NONE, &RenderConfig::default());
//! let middle = 4 * 9 + 4;
//! assert!(image.rgb[middle][0] > 0.98 && image.rgb[0][2] > 0.98);
//! assert_eq!(image.median_depth_m[middle], 2.0);
//! assert!(image.median_depth_m[0].is_nan());
//! # Ok::<(), splats::SplatError>(())
//! ```

mod backward;
mod footprint;
mod forward;
mod lens;
mod scene;
mod slope;
#[cfg(test)]
pub(crate) mod tests;

pub use backward::{Gradients, ImageGradient, backward};
pub use forward::{Image, render};
pub use scene::{Background, Scene};
