//! Batches of frames.

mod develop;
mod fade;
mod layers;

use std::sync::Arc;

use cad_transforms::RigidTransform;
use rayon::prelude::*;
use splats::{RenderConfig, Renderer};

use self::develop::{Developer, Slot};
use self::layers::{Contents, Layers};
use super::CameraConfig;
use crate::error::SimulationError;
use crate::scene::GaussianStore;

/// A frame to render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameRequest {
    /// Index of the sector that owns the camera.
    pub sector: usize,
    /// The optical frame in the frame of the sector, at the middle of the exposure of the middle
    /// row.
    pub world_from_camera: RigidTransform,
    /// Velocity of the camera in its own axes, m/s, for rolling shutter and motion blur.
    pub velocity_m_s: [f64; 3],
    /// Angular rate in its own axes, rad/s.
    pub rate_rad_s: [f64; 3],
    /// Gain of linear light beside that of the configuration, 1 for none.
    pub gain: f64,
    /// Deviation of fx, fy, cx and cy from the configuration, px: an error of the calibration.
    pub intrinsics_px: [f64; 4],
    /// What noise is drawn with.
    pub noise: NoiseKey,
}

impl FrameRequest {
    /// A frame of a camera at rest.
    pub fn new(sector: usize, world_from_camera: RigidTransform) -> Self {
        Self {
            sector,
            world_from_camera,
            velocity_m_s: [0.0; 3],
            rate_rad_s: [0.0; 3],
            gain: 1.0,
            intrinsics_px: [0.0; 4],
            noise: NoiseKey::default(),
        }
    }
}

/// What noise is a function of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NoiseKey {
    /// Seed of the environment.
    pub seed: u64,
    /// Its episode.
    pub episode: u64,
    /// Number of the frame in the episode, below 2^24.
    pub frame: u64,
    /// Number of the camera in the environment.
    pub camera: u8,
}

/// Images of a batch, frame by frame and row by row. The memory is kept for the next batch.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frames {
    /// Number of frames.
    pub count: usize,
    /// Rows of an image.
    pub height: usize,
    /// Columns of an image.
    pub width: usize,
    /// Red, green and blue of each pixel: shape (count, height, width, 3).
    pub rgb: Vec<u8>,
    /// Depth along the optical axis, m: shape (count, height, width).
    pub depth_m: Vec<f32>,
    /// Whether a pixel shows a surface, nearer than the farthest depth.
    pub has_depth: Vec<bool>,
}

impl Frames {
    /// Changes the shape. Content is kept where it fits, in no order that matters.
    fn resize(&mut self, count: usize, height: usize, width: usize) {
        let pixels = count * height * width;
        (self.count, self.height, self.width) = (count, height, width);
        self.rgb.resize(3 * pixels, 0);
        self.depth_m.resize(pixels, 0.0);
        self.has_depth.resize(pixels, false);
    }

    /// The memory, to render into.
    fn buffers(&mut self) -> FrameBuffers<'_> {
        FrameBuffers {
            rgb: &mut self.rgb,
            depth_m: &mut self.depth_m,
            has_depth: &mut self.has_depth,
        }
    }
}

/// Memory that the caller keeps, with the shapes of [`Frames`].
#[derive(Debug)]
pub struct FrameBuffers<'a> {
    /// Red, green and blue of each pixel.
    pub rgb: &'a mut [u8],
    /// Depth, m.
    pub depth_m: &'a mut [f32],
    /// Whether a pixel shows a surface.
    pub has_depth: &'a mut [bool],
}

/// What a batch needed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RenderReport {
    /// Frames.
    pub frames: usize,
    /// Frames in which two sectors were cross-faded.
    pub cross_faded_frames: usize,
    /// Sectors that were rendered from.
    pub sectors: usize,
}

/// Frames to render, with the Gaussians that they show.
struct Batch {
    layers: Vec<Layers>,
    contents: Contents,
}

/// Bytes of a pixel of [`Frames`].
const BYTES_PER_PIXEL: u64 = 3 + 4 + 1;

/// A camera, with the scene that it sees.
///
/// ```
/// use std::sync::Arc;
///
/// use simulation::testing::SyntheticScene;
/// use simulation::{
///     CameraBatch, CameraConfig, FrameRequest, Frames, GaussianStore, ResidencyConfig,
/// };
///
/// let room = SyntheticScene::room()?;
/// let store = GaussianStore::new(room.scene.clone(), ResidencyConfig::default());
/// let camera = CameraBatch::new(Arc::new(store), CameraConfig::pinhole([64, 48], 1.5)?)?;
///
/// let world_from_camera = room.scene.sectors[0].references[0];
/// let mut frames = Frames::default();
/// camera.render(&[FrameRequest::new(0, world_from_camera)], &mut frames)?;
/// assert_eq!((frames.rgb.len(), frames.depth_m.len()), (64 * 48 * 3, 64 * 48));
/// // The wall at the other end of the room.
/// let middle = 20 * 64 + 32;
/// assert!(frames.has_depth[middle]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct CameraBatch {
    store: Arc<GaussianStore>,
    config: CameraConfig,
    /// For Gaussians that were not and that were trained with compensated dilation.
    renderers: [Renderer; 2],
    developer: Developer,
}

impl CameraBatch {
    /// # Errors
    /// [`SimulationError::Setting`] with the first setting that is out of its range.
    pub fn new(store: Arc<GaussianStore>, config: CameraConfig) -> Result<Self, SimulationError> {
        config.check()?;
        let renderer = |compensate: bool| {
            let mut config = RenderConfig::default();
            config.compensate = compensate;
            Renderer::new(config).map_err(|error| refused(&error))
        };
        Ok(Self {
            renderers: [renderer(false)?, renderer(true)?],
            developer: Developer::new(&config),
            store,
            config,
        })
    }

    /// The camera.
    pub fn config(&self) -> &CameraConfig {
        &self.config
    }

    /// Gaussians that it sees.
    pub fn store(&self) -> &Arc<GaussianStore> {
        &self.store
    }

    /// Renders a batch, in parallel. Waits for sectors that are not in memory.
    ///
    /// # Errors
    /// As [`Self::render_into`].
    pub fn render(
        &self,
        requests: &[FrameRequest],
        frames: &mut Frames,
    ) -> Result<RenderReport, SimulationError> {
        let batch = self.prepare(requests)?;
        let (height, width) = (self.config.model.height, self.config.model.width);
        frames.resize(requests.len(), height as usize, width as usize);
        self.render_batch(batch, frames.buffers())
    }

    /// Renders a batch into memory of the caller.
    ///
    /// # Errors
    /// Before anything is written: [`SimulationError::Setting`] for a request that is not finite,
    /// an unknown sector and memory of another size, [`SimulationError::Budget`] for images that
    /// together are larger than the configuration allows and for sectors that do not fit in memory
    /// together, and errors of loading a sector.
    pub fn render_into(
        &self,
        requests: &[FrameRequest],
        buffers: FrameBuffers<'_>,
    ) -> Result<RenderReport, SimulationError> {
        let pixels = self.pixels();
        check_length("rgb", buffers.rgb.len(), 3 * pixels * requests.len())?;
        check_length("depth_m", buffers.depth_m.len(), pixels * requests.len())?;
        check_length(
            "has_depth",
            buffers.has_depth.len(),
            pixels * requests.len(),
        )?;
        let batch = self.prepare(requests)?;
        self.render_batch(batch, buffers)
    }

    /// Checks a batch and loads what it shows: what follows cannot fail.
    fn prepare(&self, requests: &[FrameRequest]) -> Result<Batch, SimulationError> {
        self.check(requests)?;
        let layers = requests.iter();
        let layers: Vec<Layers> = layers
            .map(|request| Layers::new(self.store.scene(), request))
            .collect();
        for layers in &layers {
            self.developer
                .times_s()
                .try_for_each(|time_s| layers.check(&self.config, time_s))?;
        }
        let contents = Contents::load(&self.store, &layers)?;
        Ok(Batch { layers, contents })
    }

    fn render_batch(
        &self,
        batch: Batch,
        buffers: FrameBuffers<'_>,
    ) -> Result<RenderReport, SimulationError> {
        let Batch { layers, contents } = batch;
        let frames = layers.len();
        let cross_faded_frames = layers.iter().filter(|layers| layers.is_faded()).count();
        let slots = slots(buffers, self.pixels());
        let mut jobs: Vec<(Layers, Slot<'_>)> = layers.into_iter().zip(slots).collect();
        // Frames of one sector follow each other, so that its Gaussians stay in the cache.
        jobs.sort_by_key(|(layers, _)| layers.sector());
        let render = |(layers, slot): (Layers, Slot<'_>)| {
            let image = |time_s: f64, exposure: &splats::Exposure| {
                layers.image(&self.config, &self.renderers, &contents, time_s, exposure)
            };
            self.developer.develop(layers.request(), image, slot)
        };
        jobs.into_par_iter().try_for_each(render)?;
        Ok(RenderReport {
            frames,
            cross_faded_frames,
            sectors: contents.len(),
        })
    }

    fn pixels(&self) -> usize {
        self.config.model.width as usize * self.config.model.height as usize
    }

    fn check(&self, requests: &[FrameRequest]) -> Result<(), SimulationError> {
        let count = requests.len() as u64;
        let needed = (self.pixels() as u64 * BYTES_PER_PIXEL).saturating_mul(count);
        if needed > self.config.max_bytes {
            let (width, height) = (self.config.model.width, self.config.model.height);
            return Err(SimulationError::Budget {
                place: format!("{count} images of {width}x{height}"),
                needed,
                allowed: self.config.max_bytes,
            });
        }
        for (number, request) in requests.iter().enumerate() {
            let motion = request.velocity_m_s.iter().chain(&request.rate_rad_s);
            let is_finite = motion.chain(&request.intrinsics_px).all(|v| v.is_finite());
            let is_positive = request.gain.is_finite() && request.gain > 0.0;
            if !is_finite || !is_positive {
                return Err(SimulationError::Setting {
                    name: format!("request of frame {number}"),
                    found: format!("{request:?}"),
                    expected: "finite numbers and a gain above 0".to_owned(),
                });
            }
            let sectors = self.store.scene().sectors.len();
            if request.sector >= sectors {
                return Err(SimulationError::Setting {
                    name: format!("sector of frame {number}"),
                    found: request.sector.to_string(),
                    expected: format!("below {sectors}"),
                });
            }
            super::sensor::check_model(&layers::model(&self.config, request))?;
        }
        Ok(())
    }
}

fn slots(buffers: FrameBuffers<'_>, pixels: usize) -> impl Iterator<Item = Slot<'_>> {
    let rgb = buffers.rgb.chunks_exact_mut(3 * pixels);
    let depth_m = buffers.depth_m.chunks_exact_mut(pixels);
    let has_depth = buffers.has_depth.chunks_exact_mut(pixels);
    rgb.zip(depth_m)
        .zip(has_depth)
        .map(|((rgb, depth_m), has_depth)| Slot {
            rgb,
            depth_m,
            has_depth,
        })
}

fn check_length(name: &str, found: usize, expected: usize) -> Result<(), SimulationError> {
    match found == expected {
        true => Ok(()),
        false => Err(SimulationError::Setting {
            name: format!("length of {name}"),
            found: found.to_string(),
            expected: expected.to_string(),
        }),
    }
}

/// An error of the renderer.
fn refused(error: &splats::SplatError) -> SimulationError {
    SimulationError::Setting {
        name: "camera".to_owned(),
        found: error.to_string(),
        expected: "what the renderer can show".to_owned(),
    }
}

#[cfg(test)]
mod tests;
