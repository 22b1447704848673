//! Memory of an image on the device.

use camera_models::{CameraModel, Distortion};
use splats::Camera;

use crate::device::Gpu;
use crate::error::GpuError;
use crate::memory::{Store, Uniform};
use crate::scene::GpuScene;
use crate::sort::Pairs;
use crate::view::View;

/// Planes of an image: red, green, blue, expected and median depth, alpha.
pub(crate) const IMAGE_PLANES: usize = 6;
/// Planes of what was blended: transmittance, red, green, blue, depth.
pub(crate) const BLENDED_PLANES: usize = 5;
/// Values of a footprint.
const FOOTPRINT: usize = 16;

/// Positions of values in the status.
pub(crate) mod status {
    /// Pairs that there are and that fit.
    pub(crate) const PAIRS: usize = 0;
    /// Gaussians of the scene.
    pub(crate) const SPLATS: usize = 1;
    pub(crate) const DEGENERATE: usize = 2;
    pub(crate) const VISIBLE: usize = 3;
    /// Pairs that there are.
    pub(crate) const ALL_PAIRS: usize = 4;
    /// Number of values that each image begins with.
    pub(crate) const OF_IMAGE: usize = 5;
    /// Set by pairs that did not fit. It and what follows lasts until the processor clears it.
    pub(crate) const OVERFLOW: usize = 5;
    /// Set by a gradient that is not finite.
    pub(crate) const NOT_FINITE: usize = 6;
    /// The step from which on nothing changes.
    pub(crate) const HALTED_AT: usize = 8;
    /// Most pairs that an image had: the last one may need fewer than the one that did not fit.
    pub(crate) const MOST_PAIRS: usize = 9;
    pub(crate) const LEN: usize = 16;
}

/// Memory of an image.
#[derive(Debug)]
pub(crate) struct Frame {
    pub(crate) view: Uniform,
    pub(crate) status: Store,
    pub(crate) footprints: Store,
    pub(crate) by_depth: Pairs,
    pub(crate) first_pair: Store,
    pub(crate) by_tile: Pairs,
    pub(crate) splat_of_pair: Store,
    pub(crate) first_entry: Store,
    pub(crate) image: Store,
    pub(crate) blended: Store,
    pub(crate) rays: Store,
    /// The lens whose directions `rays` has.
    rays_of: Option<CameraModel>,
}

/// Work on an image, as encoded.
pub(crate) struct EncodedFrame {
    pub(crate) view: View,
    /// Which copy of the Gaussians' order has the result.
    pub(crate) order: usize,
    /// Which copy of the tiles' lists has it.
    pub(crate) entries: usize,
}

impl Frame {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let store = |what, len| Store::new(gpu, what, len);
        Ok(Self {
            view: Uniform::new::<View>(gpu, &bytemuck::Zeroable::zeroed())?,
            status: store("the status", status::LEN)?,
            footprints: store("Gaussians in the image", 0)?,
            by_depth: Pairs::new(gpu, "the order by depth")?,
            first_pair: store("first pairs", 0)?,
            by_tile: Pairs::new(gpu, "pairs of Gaussians and tiles")?,
            splat_of_pair: store("pairs of Gaussians and tiles", 0)?,
            first_entry: store("tiles", 0)?,
            image: store("the image", 0)?,
            blended: store("the blended image", 0)?,
            rays: store("directions of the pixels", 0)?,
            rays_of: None,
        })
    }

    pub(crate) fn reserve(
        &mut self,
        gpu: &Gpu,
        scene: &GpuScene,
        camera: &Camera,
        view: &View,
    ) -> Result<(), GpuError> {
        let (splats, pixels) = (scene.splats, view.pixels());
        self.footprints.reserve(gpu, FOOTPRINT * splats)?;
        self.by_depth.reserve(gpu, splats)?;
        self.first_pair.reserve(gpu, splats + 1)?;
        self.first_entry.reserve(gpu, view.tiles() + 1)?;
        self.image.reserve(gpu, IMAGE_PLANES * pixels)?;
        self.blended.reserve(gpu, BLENDED_PLANES * pixels)?;
        let model = camera.model();
        let distorted = model.distortion != Distortion::None;
        if scene.sky > 0 && distorted && self.rays_of != Some(*model) {
            let rays = rays(camera);
            self.rays.reserve(gpu, rays.len())?;
            self.rays.write(gpu, 0, &rays);
            self.rays_of = Some(*model);
        }
        Ok(())
    }

    /// Forgets what lasts from image to image.
    pub(crate) fn clear_flags(&self, gpu: &Gpu) {
        let flags = [0_u32; status::LEN - status::OVERFLOW];
        self.status.write(gpu, status::OVERFLOW, &flags);
    }

    /// Gaussians, nearest first.
    pub(crate) fn order(&self, of: &EncodedFrame) -> &Store {
        &self.by_depth.values[of.order]
    }

    /// Pairs, tile by tile.
    pub(crate) fn entries(&self, of: &EncodedFrame) -> &Store {
        &self.by_tile.values[of.entries]
    }

    /// Number of pairs that fit.
    pub(crate) fn pairs(&self) -> usize {
        self.by_tile.len()
    }
}

/// Directions of the pixels in the axes of the camera, row by row; zeros where there is none.
fn rays(camera: &Camera) -> Vec<f32> {
    let (width, height) = (camera.model().width, camera.model().height);
    let mut out = Vec::with_capacity(3 * camera.pixels());
    for row in 0..height {
        for column in 0..width {
            let ray = camera.lens().unproject([column, row].map(f64::from));
            out.extend(ray.unwrap_or([0.0; 3]).map(|v| v as f32));
        }
    }
    out
}
