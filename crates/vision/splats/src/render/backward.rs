//! Gradients of a loss, given its gradient with respect to an image.
//!
//! Each pair of a Gaussian and a tile has a slot into which its tile writes sums over pixels; the
//! slots of a Gaussian are then added in a fixed order. No two threads write to the same memory, so
//! that results do not depend on their number.

mod pixels;
mod sky;
#[cfg(test)]
mod tests;
mod tile;
mod transform;

use rayon::prelude::*;

use super::{Image, Pass, Renderer};
use crate::camera::Camera;
use crate::error::SplatError;
use crate::render::view::View;
use crate::scene::{Exposure, Plane, Scene};
use pixels::{Pixels, TileGradient};
pub(super) use tile::Slot;
use tile::TileBackward;

/// Gradient of a loss with respect to an image, row by row, a plane per channel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImageGradient {
    /// With respect to red, green and blue after the exposure.
    pub rgb: [Vec<f32>; 3],
    /// With respect to the expected depth, 1/m; ignored where there is none. Empty: none.
    pub expected_depth: Vec<f32>,
    /// With respect to the accumulated alpha. Empty: none.
    pub alpha: Vec<f32>,
    /// Error of each pixel, from which [`Gradients::error`] is gathered. Empty: none.
    pub error: Vec<f32>,
}

/// Gradients of a loss.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    /// Indices of the visible Gaussians, ascending. All others have gradients of 0.
    pub indices: Vec<u32>,
    /// With respect to the parameters of the visible Gaussians, in the order of [`Plane`].
    pub planes: Vec<Vec<f32>>,
    /// Absolute values of each pixel's gradient with respect to the mean in the image, x and y,
    /// summed, 1/px (Ye et al., AbsGS, 2024).
    pub absolute: Vec<[f32; 2]>,
    /// Errors of the pixels times the weight of the Gaussian there, summed.
    pub error: Vec<f32>,
    /// The weights, summed: pixels that the Gaussian fills.
    pub weight: Vec<f32>,
    /// With respect to a small motion of the camera in its own axes: translation, 1/m, and
    /// rotation, 1/rad; `world_from_camera · exp(motion)`. Without the part of a sky.
    pub motion: [f64; 6],
    /// With respect to the exposure's matrix.
    pub exposure: [[f64; 4]; 3],
    /// With respect to the texels of a sky, or one color.
    pub background: Vec<[f32; 3]>,
}

impl Renderer {
    /// Gradients of a loss whose gradient with respect to the image is given.
    ///
    /// ```
    /// use cad_transforms::RigidTransform;
    /// use camera_models::{CameraModel, Distortion};
    /// use splats::{
    ///     Background, Camera, Exposure, ImageGradient, Plane, RenderConfig, Renderer, Scene, Splat, Splats,
    /// };
    ///
    /// let mut splats = Splats::empty(0)?;
    /// splats.push(&Splat { position_m: [0.0, 0.0, 2.0], ..Splat::sphere(0.2, [0.5; 3]) })?;
    /// let scene = Scene { splats, background: Background::Constant([0.0; 3]) };
    /// let model = CameraModel::new((32, 32), [30.0, 30.0, 16.0, 16.0], Distortion::None);
    /// let camera = Camera::new(model, RigidTransform::identity())?;
    /// let renderer = Renderer::new(RenderConfig::default())?;
    ///
    /// // The loss is the sum of all red values: it grows with opacity.
    /// let pass = renderer.forward(&scene, &camera, &Exposure::NONE);
    /// let mut gradient = ImageGradient::default();
    /// gradient.rgb = [vec![1.0; 1024], vec![0.0; 1024], vec![0.0; 1024]];
    /// let gradients = renderer.backward(&scene, &camera, &Exposure::NONE, &pass, &gradient)?;
    /// assert_eq!(gradients.indices, [0]);
    /// assert!(gradients.planes[Plane::OPACITY][0] > 0.0);
    /// # Ok::<(), splats::SplatError>(())
    /// ```
    ///
    /// # Errors
    /// [`SplatError::Size`] if a plane has not one value per pixel.
    pub fn backward(
        &self,
        scene: &Scene,
        camera: &Camera,
        exposure: &Exposure,
        pass: &Pass,
        gradient: &ImageGradient,
    ) -> Result<Gradients, SplatError> {
        gradient.check(&pass.image)?;
        let view = View::new(camera, &self.config);
        let pixels = Pixels {
            scene,
            camera,
            view: &view,
            exposure,
            config: &self.config,
            gradient,
        };
        let mut slots = vec![Slot::default(); pass.bins.pairs()];
        let exposures: Vec<[f64; 12]> = pass
            .bins
            .split(&mut slots)
            .into_par_iter()
            .enumerate()
            .map(|(tile, slots)| {
                let mut of_tile = TileGradient::default();
                let exposure = pixels.tile(tile, &pass.tiles[tile], &mut of_tile);
                self.level.run(TileBackward {
                    footprints: &pass.footprints,
                    entries: pass.bins.entries(tile),
                    view: &view,
                    tile,
                    config: &self.config,
                    gradient: &of_tile,
                    slots,
                });
                exposure
            })
            .collect();
        let mut by_exposure = [[0.0; 4]; 3];
        for of_tile in exposures {
            for (k, value) in of_tile.into_iter().enumerate() {
                by_exposure[k / 4][k % 4] += value;
            }
        }
        let mut gradients = Gradients {
            indices: pass.footprints.iter().map(|f| f.index).collect(),
            planes: vec![vec![0.0; pass.footprints.len()]; Plane::count(scene.splats.degree())],
            absolute: vec![[0.0; 2]; pass.footprints.len()],
            error: vec![0.0; pass.footprints.len()],
            weight: vec![0.0; pass.footprints.len()],
            motion: [0.0; 6],
            exposure: by_exposure,
            background: sky::background(&pixels, &pass.tiles),
        };
        transform::transform(self, scene, &view, pass, &slots, &mut gradients);
        Ok(gradients)
    }
}

impl ImageGradient {
    fn check(&self, image: &Image) -> Result<(), SplatError> {
        let expected = image.alpha.len();
        let [red, green, blue] = &self.rgb;
        let all = [
            ("gradient of red", red, false),
            ("gradient of green", green, false),
            ("gradient of blue", blue, false),
            ("gradient of the expected depth", &self.expected_depth, true),
            ("gradient of the accumulated alpha", &self.alpha, true),
            ("error", &self.error, true),
        ];
        for (what, plane, may_be_empty) in all {
            let found = plane.len();
            if found != expected && !(may_be_empty && found == 0) {
                return Err(SplatError::Size {
                    what,
                    found,
                    expected,
                });
            }
        }
        Ok(())
    }
}
