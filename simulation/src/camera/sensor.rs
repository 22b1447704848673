//! Lens, shutter, and what an image and its depth are.

use std::f64::consts::PI;

use camera_models::{CameraModel, Distortion};
use estimator_config::config;
use serde::{Deserialize, Serialize};

use crate::error::{SimulationError, check_range};

/// How images are rendered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quality {
    /// All Gaussians as they were trained.
    Exact,
    /// Levels of detail: faster, at a PSNR to the exact image that the benchmark `sim_render`
    /// states.
    #[default]
    Detail,
}

/// Definition of depth, along the optical axis. Pixels with accumulated alpha below a half have
/// none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthKind {
    /// Where the transmittance of the ray falls below a half.
    #[default]
    Median,
    /// Mean of the Gaussians, by their weights.
    Expected,
}

config! {
    /// Readout and motion blur. Both need the motion of the camera in its request.
    pub struct ShutterConfig {
        /// Readout line time of a rolling shutter, s; 0 for a global one. The pose holds at the
        /// middle row, and depth is along its optical axis then.
        pub line_s: f64 = 0.0,
        /// Exposure time, s, for motion blur.
        pub exposure_s: f64 = 0.0,
        /// Poses over the exposure whose images are averaged in linear light, an odd number; 1 for
        /// no blur. Each costs an image. The depth is that of the middle one.
        pub blur_poses: usize = 1,
    }
}

/// Poses of motion blur, at most.
const MAX_BLUR_POSES: usize = 63;

impl ShutterConfig {
    pub(super) fn check(&self) -> Result<(), SimulationError> {
        check_range(
            "camera.shutter.line_s",
            self.line_s,
            [0.0, 0.1],
            "0 to 0.1 s",
        )?;
        let exposure_s = self.exposure_s;
        check_range(
            "camera.shutter.exposure_s",
            exposure_s,
            [0.0, 1.0],
            "0 to 1 s",
        )?;
        let poses = self.blur_poses;
        if poses.is_multiple_of(2) || poses > MAX_BLUR_POSES {
            return Err(SimulationError::Setting {
                name: "camera.shutter.blur_poses".to_owned(),
                found: poses.to_string(),
                expected: format!("an odd number up to {MAX_BLUR_POSES}"),
            });
        }
        Ok(())
    }

    /// Time of a pose of the blur against the middle of the exposure, s.
    pub(super) fn blur_time_s(&self, pose: usize) -> f64 {
        let count = self.blur_poses as f64;
        self.exposure_s * ((pose as f64 + 0.5) / count - 0.5)
    }
}

/// A pinhole lens with a field of view from left to right, rad, and square pixels.
///
/// # Errors
/// [`SimulationError::Setting`] for an empty image and a field of view that is not between 0 and π.
pub fn pinhole(size: [u32; 2], horizontal_rad: f64) -> Result<CameraModel, SimulationError> {
    let is_angle = horizontal_rad > 0.0 && horizontal_rad < PI;
    if !is_angle {
        return Err(SimulationError::Setting {
            name: "camera field of view".to_owned(),
            found: format!("{horizontal_rad} rad"),
            expected: "above 0 and below pi".to_owned(),
        });
    }
    let [width, height] = size.map(f64::from);
    let focal = 0.5 * width / libm::tan(0.5 * horizontal_rad);
    let center = [width, height].map(|v| 0.5 * (v - 1.0));
    let model = CameraModel::new(
        (size[0], size[1]),
        [focal, focal, center[0], center[1]],
        Distortion::None,
    );
    check_model(&model)?;
    Ok(model)
}

/// A lens with images of another size: the same rays reach the borders of the image. Pixel centers
/// are integers, hence `c' = (c + 0.5) s - 0.5`; distortion does not depend on the size.
///
/// ```
/// use camera_models::{CameraModel, Distortion};
/// use simulation::scaled_model;
///
/// let distortion = Distortion::KannalaBrandt4 { k1: 0.02, k2: 0.0, k3: 0.0, k4: 0.0 };
/// let model = CameraModel::new((640, 480), [300.0, 300.0, 319.5, 240.5], distortion);
/// let small = scaled_model(&model, [160, 120])?;
/// assert_eq!((small.fx, small.cx, small.cy), (75.0, 79.5, 59.75));
/// # Ok::<(), simulation::SimulationError>(())
/// ```
///
/// # Errors
/// [`SimulationError::Setting`] for an empty image and impossible intrinsics.
pub fn scaled_model(model: &CameraModel, size: [u32; 2]) -> Result<CameraModel, SimulationError> {
    check_model(model)?;
    let [x, y] = [(size[0], model.width), (size[1], model.height)]
        .map(|(to, from)| f64::from(to) / f64::from(from));
    let scaled = CameraModel {
        width: size[0],
        height: size[1],
        fx: model.fx * x,
        fy: model.fy * y,
        cx: (model.cx + 0.5) * x - 0.5,
        cy: (model.cy + 0.5) * y - 0.5,
        distortion: model.distortion,
    };
    check_model(&scaled)?;
    Ok(scaled)
}

/// Largest edge of an image, px: that of the renderer.
const MAX_EDGE_PX: u32 = 16_384;

/// # Errors
/// [`SimulationError::Setting`] for an empty or too large image and impossible intrinsics.
pub(super) fn check_model(model: &CameraModel) -> Result<(), SimulationError> {
    let (width, height) = (model.width, model.height);
    let edges = 1..=MAX_EDGE_PX;
    let has_size = edges.contains(&width) && edges.contains(&height);
    let (name, found, expected) = match model.invalid_reason() {
        _ if !has_size => {
            let edge = if edges.contains(&width) {
                "height"
            } else {
                "width"
            };
            let expected = format!("1 to {MAX_EDGE_PX} px along both edges");
            (edge, format!("an image of {width}x{height}"), expected)
        }
        Some(reason) => ("model", reason, "a valid lens".to_owned()),
        None => return Ok(()),
    };
    Err(SimulationError::Setting {
        name: format!("camera.{name}"),
        found,
        expected,
    })
}
