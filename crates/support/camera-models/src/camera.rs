//! Lens models as data. How they project: [`Lens`](crate::Lens).
//!
//! Contract: pixel coordinates have integer values at pixel centres, the top-left pixel's centre is
//! (0, 0). Coefficients have OpenCV's meaning and order where OpenCV has the model, so that they
//! can be handed on unchanged.

use serde::{Deserialize, Serialize};

/// A camera: image size, pinhole intrinsics in pixels, lens distortion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraModel {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
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
    /// None: an ideal pinhole, as in a rectified image.
    None,
    /// Radial alone, with two terms.
    #[allow(missing_docs)]
    Radial2 { k1: f64, k2: f64 },
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
    /// Double sphere (Usenko, Demmel and Cremers 2018), with its own focal lengths.
    #[allow(missing_docs)]
    DoubleSphere { xi: f64, alpha: f64 },
    /// Extended unified camera (Khomutenko, Garcia and Martinet 2016), with its own focal lengths.
    #[allow(missing_docs)]
    Eucm { alpha: f64, beta: f64 },
}

/// The radial-tangential models as the largest of them: the radial factor is `(1 + o1 r² + o2 r⁴ +
/// o3 r⁶) / (1 + u1 r² + u2 r⁴ + u3 r⁶)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rational {
    /// `o`: k1 k2 k3.
    pub over: [f64; 3],
    /// `u`: k4 k5 k6.
    pub under: [f64; 3],
    /// p1 p2.
    pub tangential: [f64; 2],
}

impl CameraModel {
    /// Width and height, pixels; fx, fy, cx, cy, pixels; distortion.
    pub fn new(
        (width, height): (u32, u32),
        [fx, fy, cx, cy]: [f64; 4],
        distortion: Distortion,
    ) -> Self {
        Self {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            distortion,
        }
    }

    /// The camera matrix, row-major.
    pub fn k_matrix(&self) -> [f64; 9] {
        [self.fx, 0.0, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0]
    }

    /// Reason why these numbers are impossible for a camera of this size, if any. Detects a
    /// calibration of another resolution if its principal point is outside the image.
    pub fn invalid_reason(&self) -> Option<String> {
        self.invalid_parameter().map(|(_, reason)| reason)
    }

    /// The same with the parameter in question, as in [`Self::parameter_names`].
    pub fn invalid_parameter(&self) -> Option<(&'static str, String)> {
        let numbers = self.parameters();
        let names = self.parameter_names();
        if let Some(i) = numbers.iter().position(|v| !v.is_finite()) {
            return Some((names[i], "an intrinsic is not a finite number".to_owned()));
        }
        let focal = [("fx", self.fx), ("fy", self.fy)];
        if let Some((name, _)) = focal.into_iter().find(|(_, f)| *f <= 0.0) {
            let (fx, fy) = (self.fx, self.fy);
            let reason = format!("focal lengths {fx} and {fy}, expected both above 0");
            return Some((name, reason));
        }
        let centre = [("cx", self.cx, self.width), ("cy", self.cy, self.height)];
        let outside = |c: f64, size: u32| c <= -0.5 || c >= f64::from(size) - 0.5;
        let (name, ..) = centre.into_iter().find(|(_, c, size)| outside(*c, *size))?;
        let reason = format!(
            "principal point ({}, {}) outside the image of {}x{}: a calibration of another resolution?",
            self.cx, self.cy, self.width, self.height
        );
        Some((name, reason))
    }
}

impl Distortion {
    /// Number of coefficients of the largest model.
    pub const MAX_COEFFICIENTS: usize = 8;

    /// The model as a [`Rational`] one; `None` for other families.
    pub fn rational(&self) -> Option<Rational> {
        let (over, under, tangential) = match *self {
            Self::None => ([0.0; 3], [0.0; 3], [0.0; 2]),
            Self::Radial2 { k1, k2 } => ([k1, k2, 0.0], [0.0; 3], [0.0; 2]),
            Self::RadTan4 { k1, k2, p1, p2 } => ([k1, k2, 0.0], [0.0; 3], [p1, p2]),
            Self::RadTan5 { k1, k2, p1, p2, k3 } => ([k1, k2, k3], [0.0; 3], [p1, p2]),
            Self::Rational8 {
                k1,
                k2,
                p1,
                p2,
                k3,
                k4,
                k5,
                k6,
            } => ([k1, k2, k3], [k4, k5, k6], [p1, p2]),
            Self::KannalaBrandt4 { .. } | Self::DoubleSphere { .. } | Self::Eucm { .. } => {
                return None;
            }
        };
        Some(Rational {
            over,
            under,
            tangential,
        })
    }

    /// The coefficients in OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6, or k1 k2 k3 k4 of a fisheye, or
    /// those of the other models in the order of their names here.
    pub fn coefficients(&self) -> Vec<f64> {
        match *self {
            Self::None => Vec::new(),
            Self::Radial2 { k1, k2 } => vec![k1, k2],
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
            Self::DoubleSphere { xi, alpha } => vec![xi, alpha],
            Self::Eucm { alpha, beta } => vec![alpha, beta],
        }
    }

    /// The names of [`Self::coefficients`].
    pub fn coefficient_names(&self) -> &'static [&'static str] {
        match self {
            Self::None => &[],
            Self::Radial2 { .. } => &["k1", "k2"],
            Self::RadTan4 { .. } => &["k1", "k2", "p1", "p2"],
            Self::RadTan5 { .. } => &["k1", "k2", "p1", "p2", "k3"],
            Self::Rational8 { .. } => &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"],
            Self::KannalaBrandt4 { .. } => &["k1", "k2", "k3", "k4"],
            Self::DoubleSphere { .. } => &["xi", "alpha"],
            Self::Eucm { .. } => &["alpha", "beta"],
        }
    }

    /// The same model with other coefficients, in the order of [`Self::coefficients`].
    ///
    /// # Panics
    /// If the number of coefficients differs from the model's.
    #[must_use]
    pub fn with_coefficients(&self, c: &[f64]) -> Self {
        assert_eq!(c.len(), self.coefficient_names().len(), "coefficients");
        match self {
            Self::None => Self::None,
            Self::Radial2 { .. } => Self::Radial2 { k1: c[0], k2: c[1] },
            Self::RadTan4 { .. } => Self::RadTan4 {
                k1: c[0],
                k2: c[1],
                p1: c[2],
                p2: c[3],
            },
            Self::RadTan5 { .. } => Self::RadTan5 {
                k1: c[0],
                k2: c[1],
                p1: c[2],
                p2: c[3],
                k3: c[4],
            },
            Self::Rational8 { .. } => Self::Rational8 {
                k1: c[0],
                k2: c[1],
                p1: c[2],
                p2: c[3],
                k3: c[4],
                k4: c[5],
                k5: c[6],
                k6: c[7],
            },
            Self::KannalaBrandt4 { .. } => Self::KannalaBrandt4 {
                k1: c[0],
                k2: c[1],
                k3: c[2],
                k4: c[3],
            },
            Self::DoubleSphere { .. } => Self::DoubleSphere {
                xi: c[0],
                alpha: c[1],
            },
            Self::Eucm { .. } => Self::Eucm {
                alpha: c[0],
                beta: c[1],
            },
        }
    }

    /// The model's name in messages and files of this project.
    pub fn name(&self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Radial2 { .. } => "radial2",
            Self::RadTan4 { .. } => "rad_tan4",
            Self::RadTan5 { .. } => "rad_tan5",
            Self::Rational8 { .. } => "rational8",
            Self::KannalaBrandt4 { .. } => "kannala_brandt4",
            Self::DoubleSphere { .. } => "double_sphere",
            Self::Eucm { .. } => "eucm",
        }
    }
}

impl CameraModel {
    /// Number of parameters of the largest model: fx fy cx cy and the coefficients.
    pub const MAX_PARAMETERS: usize = 4 + Distortion::MAX_COEFFICIENTS;

    /// fx fy cx cy and the coefficients in the order of [`Distortion::coefficients`].
    pub fn parameters(&self) -> Vec<f64> {
        let mut all = vec![self.fx, self.fy, self.cx, self.cy];
        all.extend(self.distortion.coefficients());
        all
    }

    /// The names of [`Self::parameters`].
    pub fn parameter_names(&self) -> Vec<&'static str> {
        let mut all = vec!["fx", "fy", "cx", "cy"];
        all.extend(self.distortion.coefficient_names());
        all
    }

    /// The same model with other parameters, in the order of [`Self::parameters`].
    ///
    /// # Panics
    /// If the number of parameters differs from the model's.
    ///
    /// ```
    /// use camera_models::{CameraModel, Distortion};
    ///
    /// let distortion = Distortion::RadTan4 { k1: -0.2, k2: 0.03, p1: 0.0, p2: 0.0 };
    /// let model = CameraModel::new((640, 480), [500.0, 501.0, 319.5, 239.5], distortion);
    /// assert_eq!(model.parameter_names(), ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"]);
    ///
    /// // One step of an optimizer.
    /// let mut parameters = model.parameters();
    /// parameters[4] += 0.01;
    /// let next = model.with_parameters(&parameters);
    /// assert_eq!(next.distortion.coefficients(), [-0.19, 0.03, 0.0, 0.0]);
    /// assert_eq!((next.width, next.fy), (640, 501.0));
    /// ```
    #[must_use]
    pub fn with_parameters(&self, p: &[f64]) -> Self {
        Self {
            fx: p[0],
            fy: p[1],
            cx: p[2],
            cy: p[3],
            distortion: self.distortion.with_coefficients(&p[4..]),
            ..*self
        }
    }
}
