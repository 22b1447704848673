//! Lens models as data. Projection comes with the estimation of calibrations.
//!
//! Contract: pixel coordinates have integer values at pixel centres, the top-left pixel's centre is
//! (0, 0). Coefficients have OpenCV's meaning and order, so that they can be handed on unchanged.

use serde::{Deserialize, Serialize};

/// A camera: size of its picture, pinhole intrinsics in pixels, lens distortion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraModel {
    /// Picture width, pixels.
    pub width: u32,
    /// Picture height, pixels.
    pub height: u32,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point x, pixels from the centre of the leftmost column.
    pub cx: f64,
    /// Principal point y, pixels from the centre of the topmost row.
    pub cy: f64,
    /// Lens distortion.
    pub distortion: Distortion,
}

/// Lens distortion. `k` are radial, `p` tangential coefficients.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "snake_case", deny_unknown_fields)]
pub enum Distortion {
    /// None: an ideal pinhole, as in a rectified picture.
    None,
    /// Radial-tangential with two radial terms (Brown 1966; OpenCV with k3 = 0).
    #[allow(missing_docs)]
    RadTan4 { k1: f64, k2: f64, p1: f64, p2: f64 },
    /// Radial-tangential with three radial terms (OpenCV's default).
    #[allow(missing_docs)]
    RadTan5 {
        k1: f64,
        k2: f64,
        p1: f64,
        p2: f64,
        k3: f64,
    },
    /// Rational: radial factor `(1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)`
    /// (OpenCV's `CALIB_RATIONAL_MODEL`).
    #[allow(missing_docs)]
    Rational8 {
        k1: f64,
        k2: f64,
        p1: f64,
        p2: f64,
        k3: f64,
        k4: f64,
        k5: f64,
        k6: f64,
    },
    /// Equidistant fisheye, `θ_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)` (Kannala and Brandt 2006;
    /// OpenCV's `fisheye`).
    #[allow(missing_docs)]
    KannalaBrandt4 { k1: f64, k2: f64, k3: f64, k4: f64 },
}

impl CameraModel {
    /// The camera matrix, rows first.
    pub fn k_matrix(&self) -> [f64; 9] {
        [self.fx, 0.0, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0]
    }

    /// What makes these numbers impossible for a camera of this size, if anything does. Catches a
    /// calibration of another resolution where its principal point falls outside the picture.
    pub(crate) fn objection(&self) -> Option<String> {
        let numbers = [self.fx, self.fy, self.cx, self.cy];
        if numbers
            .iter()
            .chain(&self.distortion.coefficients())
            .any(|v| !v.is_finite())
        {
            return Some("an intrinsic is not a finite number".to_owned());
        }
        if self.fx <= 0.0 || self.fy <= 0.0 {
            return Some(format!(
                "focal lengths {} and {}, expected both above 0",
                self.fx, self.fy
            ));
        }
        let inside = |c: f64, size: u32| c > -0.5 && c < f64::from(size) - 0.5;
        if !inside(self.cx, self.width) || !inside(self.cy, self.height) {
            return Some(format!(
                "principal point ({}, {}) outside the picture of {}x{}: a calibration of another resolution?",
                self.cx, self.cy, self.width, self.height
            ));
        }
        None
    }
}

impl Distortion {
    /// The coefficients in OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6, or k1 k2 k3 k4 of a fisheye.
    pub fn coefficients(&self) -> Vec<f64> {
        match *self {
            Self::None => Vec::new(),
            Self::RadTan4 { k1, k2, p1, p2 } => vec![k1, k2, p1, p2],
            Self::RadTan5 { k1, k2, p1, p2, k3 } => vec![k1, k2, p1, p2, k3],
            Self::Rational8 {
                k1,
                k2,
                p1,
                p2,
                k3,
                k4,
                k5,
                k6,
            } => vec![k1, k2, p1, p2, k3, k4, k5, k6],
            Self::KannalaBrandt4 { k1, k2, k3, k4 } => vec![k1, k2, k3, k4],
        }
    }
}
