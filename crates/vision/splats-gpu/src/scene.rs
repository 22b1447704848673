//! A scene in the memory of the device.

use splats::{Background, Scene};

use crate::device::Gpu;
use crate::error::GpuError;
use crate::memory::Store;

/// Most Gaussians of a scene: 65 535 groups of 64 threads.
const MAX_SPLATS: usize = 65_535 * 64;

/// A scene in the memory of the device.
#[derive(Debug)]
pub struct GpuScene {
    pub(crate) planes: Store,
    /// The texels, or one color.
    pub(crate) background: Store,
    pub(crate) splats: usize,
    pub(crate) degree: usize,
    /// Edge of the sky, texels; 0 for one color.
    pub(crate) sky: usize,
}

impl GpuScene {
    /// Copies a scene to the device.
    ///
    /// # Errors
    /// [`GpuError`] if it does not fit.
    pub fn new(gpu: &Gpu, scene: &Scene) -> Result<Self, GpuError> {
        let (sky, colors) = match &scene.background {
            Background::Constant(color) => (0, std::slice::from_ref(color)),
            Background::Sky(sky) => (sky.size(), sky.texels()),
        };
        let background = Store::of(gpu, "the background", colors.as_flattened())?;
        let splats = &scene.splats;
        let values = splats.planes().iter().map(Vec::len).sum();
        if splats.len() > MAX_SPLATS {
            let bytes_of = |splats: usize| 4 * (splats * scene.splats.planes().len()) as u64;
            return Err(GpuError::TooLarge {
                what: "the Gaussians",
                bytes: bytes_of(splats.len()),
                limit: bytes_of(MAX_SPLATS),
                name: gpu.name().to_owned(),
            });
        }
        let planes = Store::new(gpu, "the Gaussians", values)?;
        let mut at = 0;
        for plane in splats.planes() {
            planes.write(gpu, at, plane);
            at += plane.len();
        }
        Ok(Self {
            planes,
            background,
            splats: splats.len(),
            degree: splats.degree(),
            sky,
        })
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.splats
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.splats == 0
    }

    /// Number of texels of the background.
    pub(crate) fn texels(&self) -> usize {
        (self.sky * self.sky).max(1)
    }
}
