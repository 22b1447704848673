//! Cameras of agents: images and depth of a scene's Gaussians at given poses.
//!
//! Contract: a frame is a function of the scene, the pose with its motion, the configuration, and
//! the seed, episode and number of the frame that noise is drawn with. It does not depend on other
//! frames of a batch, their order, or the number of threads.
//!
//! Optical frames have x right, y down, z forward; pixel coordinates are integers at pixel centers.
//! Colors are 8 bits per channel. Depth is along the optical axis, m.

mod exposure;
mod frames;
mod latency;
mod noise;
mod queue;
mod recorded;
mod sensor;
mod variation;

use cad_transforms::RigidTransform;
use camera_models::CameraModel;
use serde::{Deserialize, Serialize};

pub use exposure::ExposureConfig;
pub use frames::{CameraBatch, FrameBuffers, FrameRequest, Frames, NoiseKey, RenderReport};
pub(crate) use latency::nanoseconds;
pub use latency::{CameraSchedule, TimingConfig};
pub use noise::NoiseConfig;
pub use queue::{CameraView, Capture, FrameQueue};
pub use sensor::{DepthKind, Quality, ShutterConfig, pinhole, scaled_model};
pub use variation::VariationConfig;

use crate::error::{SimulationError, check_range};
use crate::scene::RecordingCamera;

/// A camera of an agent.
///
/// ```
/// use simulation::CameraConfig;
///
/// let config = CameraConfig::pinhole([64, 48], 90_f64.to_radians())?;
/// assert!((config.model.fx - 32.0).abs() < 1e-12 && config.model.cx == 31.5);
/// assert!(CameraConfig::pinhole([64, 48], 3.2).is_err());
/// # Ok::<(), simulation::SimulationError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Lens and image size.
    pub model: CameraModel,
    /// Its optical frame on the agent.
    pub body_from_camera: RigidTransform,
    /// When it captures, and when frames are delivered.
    #[serde(default)]
    pub timing: TimingConfig,
    /// Brightness and gamma.
    #[serde(default)]
    pub exposure: ExposureConfig,
    /// Noise of the sensor.
    #[serde(default)]
    pub noise: NoiseConfig,
    /// Readout and motion blur.
    #[serde(default)]
    pub shutter: ShutterConfig,
    /// What differs from episode to episode.
    #[serde(default)]
    pub variation: VariationConfig,
    /// Exact, or with levels of detail.
    #[serde(default)]
    pub quality: Quality,
    /// What depth is.
    #[serde(default)]
    pub depth: DepthKind,
    /// Depth of pixels without a surface, and the farthest depth that is reported, m.
    pub far_m: f32,
    /// Memory that the images of one batch may have, bytes.
    pub max_bytes: u64,
}

/// Farthest depth by default, m: that of the depth maps from which scenes are reconstructed.
const FAR_M: f32 = 20.0;
/// Memory of a batch by default: 4 GiB, 8192 frames of 256x256 pixels.
const MAX_BYTES: u64 = 4 << 30;

impl CameraConfig {
    /// A camera with a lens, at the origin of the agent, facing forward.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for impossible intrinsics.
    pub fn new(model: CameraModel) -> Result<Self, SimulationError> {
        let config = Self {
            model,
            body_from_camera: RigidTransform::body_from_optical(),
            timing: TimingConfig::default(),
            exposure: ExposureConfig::default(),
            noise: NoiseConfig::default(),
            shutter: ShutterConfig::default(),
            variation: VariationConfig::default(),
            quality: Quality::default(),
            depth: DepthKind::default(),
            far_m: FAR_M,
            max_bytes: MAX_BYTES,
        };
        config.check()?;
        Ok(config)
    }

    /// A pinhole camera with a field of view from left to right, rad.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for an empty image and a field of view of π or more.
    pub fn pinhole(size: [u32; 2], horizontal_rad: f64) -> Result<Self, SimulationError> {
        Self::new(pinhole(size, horizontal_rad)?)
    }

    /// A camera of the rig that recorded, with images of another size: its lens, its mount in the
    /// rig and its rolling shutter, with the readout time of the whole image kept.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for an empty image.
    pub fn of_recording(camera: &RecordingCamera, size: [u32; 2]) -> Result<Self, SimulationError> {
        let mut config = Self::new(scaled_model(&camera.model, size)?)?;
        config.body_from_camera = camera.rig_from_camera;
        config.shutter.line_s = camera.line_s * f64::from(camera.model.height) / f64::from(size[1]);
        Ok(config)
    }

    /// Whether images can be rendered with all settings.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] with the first setting that is out of its range.
    pub fn check(&self) -> Result<(), SimulationError> {
        sensor::check_model(&self.model)?;
        self.timing.check()?;
        self.exposure.check()?;
        self.noise.check()?;
        self.shutter.check()?;
        self.variation.check()?;
        let far_m = f64::from(self.far_m);
        check_range("camera.far_m", far_m, [0.1, 1e5], "0.1 to 100000 m")
    }
}

#[cfg(test)]
mod tests;
