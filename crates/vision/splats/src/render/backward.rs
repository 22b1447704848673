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

use super::forward::{Pass, Renderer};
use super::gradients::{Gradients, ImageGradient};
use crate::camera::Camera;
use crate::error::SplatError;
use crate::scene::{Exposure, Plane, Scene};
use pixels::{Pixels, TileGradient};
use tile::{Slot, TileBackward};

impl Renderer {
    /// Gradients of a loss whose gradient with respect to the image is given.
    ///
    /// ```
    /// use cad_transforms::RigidTransform;
    /// use camera_models::{CameraModel, Distortion};
    /// use splats::{
    ///     Background, Camera, Exposure, ImageGradient, Plane, RenderConfig, Renderer, Scene,
    ///     Splat, Splats,
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
        let view = self.view(scene, camera);
        let pixels = Pixels {
            scene,
            view: &view,
            exposure,
            config: &self.config,
            gradient,
        };
        // In parallel: these are tens of megabytes.
        let slots = (0..pass.bins.pairs()).into_par_iter();
        let mut slots: Vec<Slot> = slots.map(|_| Slot::default()).collect();
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
