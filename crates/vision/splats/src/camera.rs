//! A camera: lens, pose, and its motion while a rolling shutter reads the rows.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Lens};

use crate::error::SplatError;

/// Largest edge of an image, px.
const MAX_EDGE_PX: u32 = 16_384;

/// A camera to render with.
///
/// ```
/// use cad_transforms::RigidTransform;
/// use camera_models::{CameraModel, Distortion};
/// use splats::Camera;
///
/// let model = CameraModel::new((64, 48), [60.0, 60.0, 31.5, 23.5], Distortion::None);
/// let camera = Camera::new(model, RigidTransform::identity())?;
/// assert_eq!(camera.pixels(), 64 * 48);
///
/// let broken = CameraModel { fx: f64::NAN, ..model };
/// assert!(Camera::new(broken, RigidTransform::identity()).is_err());
/// # Ok::<(), splats::SplatError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Camera {
    lens: Lens,
    camera_from_world: RigidTransform,
    shutter: Option<Shutter>,
}

/// Time of a pixel and motion of the camera at the reference time, at which its pose holds.
///
/// The time of pixel `u` minus the reference time is `time_gradient · (u - reference)`; on a
/// recorded image the gradient is `(0, readout time of a line)`, after rectification that of the
/// recorded row. Velocities are taken as constant over the readout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shutter {
    /// Change of the time along x and y, s/px.
    pub time_gradient_s_per_px: [f64; 2],
    /// Pixel at the reference time.
    pub reference_px: [f64; 2],
    /// Velocity of the camera in its own axes, m/s.
    pub velocity_m_s: [f64; 3],
    /// Angular rate of the camera in its own axes, rad/s.
    pub rate_rad_s: [f64; 3],
}

impl Shutter {
    /// Rows one after the other, with the pose of the camera at the middle row.
    pub fn rows(line_s: f64, height: u32, velocity_m_s: [f64; 3], rate_rad_s: [f64; 3]) -> Self {
        Self {
            time_gradient_s_per_px: [0.0, line_s],
            reference_px: [0.0, (f64::from(height) - 1.0) / 2.0],
            velocity_m_s,
            rate_rad_s,
        }
    }

    fn values(&self) -> [f64; 10] {
        let [[a, b], [c, d]] = [self.time_gradient_s_per_px, self.reference_px];
        let ([e, f, g], [h, i, j]) = (self.velocity_m_s, self.rate_rad_s);
        [a, b, c, d, e, f, g, h, i, j]
    }
}

impl Camera {
    /// A camera at rest, or with a global shutter.
    ///
    /// # Errors
    /// [`SplatError::Camera`] if the model is invalid or its image is empty or larger than
    /// 16384 px along an edge. The principal point may be outside the image.
    pub fn new(model: CameraModel, camera_from_world: RigidTransform) -> Result<Self, SplatError> {
        let (width, height) = (model.width, model.height);
        let edges = 1..=MAX_EDGE_PX;
        let finite = model.parameters().iter().all(|v| v.is_finite());
        let reason = if !edges.contains(&width) || !edges.contains(&height) {
            format!("an image of {width}x{height}, expected 1 to {MAX_EDGE_PX} px along both edges")
        } else if !finite {
            "a parameter of its lens is not a finite number".to_owned()
        } else if model.fx <= 0.0 || model.fy <= 0.0 {
            let (fx, fy) = (model.fx, model.fy);
            format!("focal lengths {fx} and {fy}, expected both above 0")
        } else {
            return Ok(Self {
                lens: Lens::new(&model),
                camera_from_world,
                shutter: None,
            });
        };
        Err(SplatError::Camera { reason })
    }

    /// The same camera in motion with a rolling shutter.
    ///
    /// # Errors
    /// [`SplatError::Camera`] if a value is not finite.
    pub fn with_shutter(mut self, shutter: Shutter) -> Result<Self, SplatError> {
        if shutter.values().iter().any(|value| !value.is_finite()) {
            let reason = format!("a value of its shutter is not a finite number: {shutter:?}");
            return Err(SplatError::Camera { reason });
        }
        self.shutter = Some(shutter);
        Ok(self)
    }

    /// The same camera elsewhere.
    #[must_use]
    pub fn with_pose(mut self, camera_from_world: RigidTransform) -> Self {
        self.camera_from_world = camera_from_world;
        self
    }

    /// Lens and image size.
    pub fn model(&self) -> &CameraModel {
        self.lens.model()
    }

    /// The lens.
    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// The pose at the reference time.
    pub fn camera_from_world(&self) -> &RigidTransform {
        &self.camera_from_world
    }

    /// Rolling shutter and motion, if any.
    pub fn shutter(&self) -> Option<&Shutter> {
        self.shutter.as_ref()
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.model().width as usize * self.model().height as usize
    }
}
