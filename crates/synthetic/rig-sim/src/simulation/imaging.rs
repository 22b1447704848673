//! Sensor response, and what distinguishes the eyes of a camera.

use crate::camera::sensor::{SensorModel, Tone};

/// Sensor response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imaging {
    /// Fixed exposure time of all images, s; `None` for automatic exposure.
    pub exposure_s: Option<f64>,
    /// Factor on the noise standard deviation; 1 is nominal.
    pub noise: f64,
    /// Tone curve.
    pub tone: Tone,
    /// Whether rolling-shutter cameras expose all rows simultaneously.
    pub global_shutter: bool,
    /// Difference of the right eyes.
    pub right_eye: EyeDifference,
    /// Quantization step of a codec, gray levels; see [`codec`](crate::camera::codec). 0 for none.
    pub codec_step: f32,
}

/// What distinguishes the right eye of a camera from the left one, beside the noise and the
/// nonuniformity of their sensors; none by default. An error of the rectification is a
/// [`CalibrationError`](crate::calibration_error::CalibrationError).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EyeDifference {
    /// Standard deviation of the additional blur, px.
    pub blur_px: f32,
    /// Additional part of the cos⁴ falloff.
    pub vignetting: f32,
    /// Gain relative to the left eye, minus 1.
    pub gain: f32,
}

impl Imaging {
    /// Sensors as modelled: automatic exposure, nominal noise, sRGB, each camera's own shutter.
    pub const USUAL: Self = Self {
        exposure_s: None,
        noise: 1.0,
        tone: Tone::Srgb,
        global_shutter: false,
        right_eye: EyeDifference {
            blur_px: 0.0,
            vignetting: 0.0,
            gain: 0.0,
        },
        codec_step: 0.0,
    };

    /// Of the left (0) or the right eye (1).
    pub(super) fn sensor(&self, eye: usize) -> SensorModel {
        let both = SensorModel {
            noise: self.noise as f32,
            tone: self.tone,
            ..SensorModel::SMALL
        };
        match eye {
            0 => both,
            _ => SensorModel {
                vignetting: both.vignetting + self.right_eye.vignetting,
                electrons_per_ms: both.electrons_per_ms * (1.0 + self.right_eye.gain),
                ..both
            },
        }
    }
}
