//! Conversion between lens models, with the error stated.
//!
//! Contract: [`convert`] keeps the image size and the directions of its pixels. If the target model
//! contains the source as a special case, the coefficients are copied and nothing changes.
//! Otherwise focal lengths, principal point and coefficients are fitted so that the target's pixels
//! match the source's, by least squares over a grid on the whole image with its border, and the
//! maximum and RMS difference are measured on a finer grid. A part of the image outside the domain
//! of the target is reported, never distorted to fit. The same input gives the same numbers on
//! every run.
//!
//! A pinhole model is fitted up to 80 degrees off the axis: beyond, a pixel of a real image would
//! span kilometres on the plane. [`convert_within`] narrows the range if the middle matters more.

use std::fmt;

use nalgebra::{DMatrix, DVector};

use crate::camera::{CameraModel, Distortion};
use crate::lens::Lens;

/// The lens models, without their parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // As in `Distortion`.
pub enum LensModel {
    None,
    Radial2,
    RadTan4,
    RadTan5,
    Rational8,
    KannalaBrandt4,
    DoubleSphere,
    Eucm,
}

/// Maximum angle off the axis for fitting pinhole models, radians.
const MAX_PINHOLE_ANGLE_RAD: f64 = 80.0 * std::f64::consts::PI / 180.0;
/// Columns and rows of the grid for fitting.
const FIT_GRID: [usize; 2] = [41, 31];
/// Columns and rows of the grid for measuring the error.
const CHECK_GRID: [usize; 2] = [129, 97];
/// The fit starts in the middle of the image and widens in these steps, as fractions of the maximum
/// angle.
const STAGES: [f64; 4] = [0.4, 0.65, 0.85, 1.0];
const ITERATIONS: usize = 300;

/// A converted model and its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conversion {
    /// The new model, of the same size.
    pub model: CameraModel,
    /// Whether the target contains the source as a special case. Then the errors are 0.
    pub exact: bool,
    /// Maximum distance between a pixel and its direction's projection in the new model, pixels.
    pub max_px: f64,
    /// RMS of these distances, pixels.
    pub rms_px: f64,
    /// The pixel with the maximum.
    pub worst_at: [f64; 2],
    /// Fraction of the image, 0 to 1, whose directions are outside the domain of the target or
    /// outside the requested range.
    pub lost: f64,
    /// Smallest angle off the axis among these, radians.
    pub lost_from_rad: Option<f64>,
    /// Fraction of the image, 0 to 1, for which the source itself has no direction.
    pub without_direction: f64,
}

/// Reasons for a failed conversion.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ConvertError {
    /// Hardly any pixel of the image has a direction in the source.
    #[error(
        "converting a lens: {directions} of {grid} pixels have a direction that {target} could mean, too few to fit"
    )]
    TooFew {
        /// Pixels with a direction.
        directions: usize,
        /// Pixels tested.
        grid: usize,
        /// The target.
        target: &'static str,
    },
    /// The fit did not converge to finite, valid parameters.
    #[error("converting a lens: no {target} fits")]
    NoFit {
        /// The target.
        target: &'static str,
    },
}

impl LensModel {
    /// All of them, the smallest of a family first.
    pub const ALL: [Self; 8] = [
        Self::None,
        Self::Radial2,
        Self::RadTan4,
        Self::RadTan5,
        Self::Rational8,
        Self::KannalaBrandt4,
        Self::DoubleSphere,
        Self::Eucm,
    ];

    /// The model of a distortion.
    pub fn of(distortion: &Distortion) -> Self {
        match distortion {
            Distortion::None => Self::None,
            Distortion::Radial2 { .. } => Self::Radial2,
            Distortion::RadTan4 { .. } => Self::RadTan4,
            Distortion::RadTan5 { .. } => Self::RadTan5,
            Distortion::Rational8 { .. } => Self::Rational8,
            Distortion::KannalaBrandt4 { .. } => Self::KannalaBrandt4,
            Distortion::DoubleSphere { .. } => Self::DoubleSphere,
            Distortion::Eucm { .. } => Self::Eucm,
        }
    }

    /// As [`Distortion::name`].
    pub fn name(self) -> &'static str {
        self.neutral().name()
    }

    /// Parses a model name, in any case and with or without underscores: `rad_tan4`, `radtan4`.
    pub fn from_name(name: &str) -> Option<Self> {
        let plain = |text: &str| {
            let letters = text.chars().filter(|c| !matches!(c, '_' | '-'));
            letters.collect::<String>().to_ascii_lowercase()
        };
        Self::ALL
            .into_iter()
            .find(|model| plain(model.name()) == plain(name))
    }

    /// Initial coefficients of the fit. The two of a sphere model are correlated, so that a single
    /// start can end in a long valley.
    fn beginnings(self) -> Vec<Distortion> {
        let sphere = |xi: f64, alpha: f64| Distortion::DoubleSphere { xi, alpha };
        let unified = |alpha: f64, beta: f64| Distortion::Eucm { alpha, beta };
        match self {
            Self::DoubleSphere => vec![sphere(0.0, 0.5), sphere(-0.2, 0.6), sphere(0.3, 0.4)],
            Self::Eucm => vec![unified(0.5, 1.0), unified(0.6, 1.2), unified(0.3, 0.8)],
            other => vec![other.neutral()],
        }
    }

    /// Coefficients with which the model is nearest to a pinhole.
    fn neutral(self) -> Distortion {
        let (k1, k2, k3, k4, k5, k6, p1, p2) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        match self {
            Self::None => Distortion::None,
            Self::Radial2 => Distortion::Radial2 { k1, k2 },
            Self::RadTan4 => Distortion::RadTan4 { k1, k2, p1, p2 },
            Self::RadTan5 => Distortion::RadTan5 { k1, k2, p1, p2, k3 },
            Self::Rational8 => Distortion::Rational8 {
                k1,
                k2,
                p1,
                p2,
                k3,
                k4,
                k5,
                k6,
            },
            Self::KannalaBrandt4 => Distortion::KannalaBrandt4 { k1, k2, k3, k4 },
            Self::DoubleSphere => Distortion::DoubleSphere {
                xi: 0.0,
                alpha: 0.5,
            },
            Self::Eucm => Distortion::Eucm {
                alpha: 0.5,
                beta: 1.0,
            },
        }
    }

    fn is_pinhole(self) -> bool {
        self.neutral().rational().is_some()
    }
}

/// The same lens in another model that contains it exactly: `none` in every model with radial
/// terms, a smaller radial-tangential one in a larger, and a larger in a smaller whose missing
/// terms are 0.
///
/// ```
/// use camera_models::exactly;
/// use camera_models::{Distortion, LensModel};
///
/// let four = Distortion::RadTan4 { k1: -0.2, k2: 0.03, p1: 1e-3, p2: 0.0 };
/// let five = exactly(&four, LensModel::RadTan5).ok_or("not contained")?;
/// assert_eq!(five.coefficients(), [-0.2, 0.03, 1e-3, 0.0, 0.0]);
/// assert_eq!(exactly(&five, LensModel::RadTan4), Some(four));
/// // A fisheye is never the same lens: that takes a fit.
/// assert_eq!(exactly(&four, LensModel::KannalaBrandt4), None);
/// # Ok::<(), &str>(())
/// ```
pub fn exactly(distortion: &Distortion, target: LensModel) -> Option<Distortion> {
    if LensModel::of(distortion) == target {
        return Some(*distortion);
    }
    let rational = distortion.rational()?;
    let [k1, k2, k3] = rational.over;
    let [k4, k5, k6] = rational.under;
    let [p1, p2] = rational.tangential;
    let zero = |values: &[f64]| values.iter().all(|v| *v == 0.0);
    let found = match target {
        LensModel::None => (Distortion::None, zero(&[k1, k2, k3, k4, k5, k6, p1, p2])),
        LensModel::Radial2 => (
            Distortion::Radial2 { k1, k2 },
            zero(&[k3, k4, k5, k6, p1, p2]),
        ),
        LensModel::RadTan4 => (
            Distortion::RadTan4 { k1, k2, p1, p2 },
            zero(&[k3, k4, k5, k6]),
        ),
        LensModel::RadTan5 => (
            Distortion::RadTan5 { k1, k2, p1, p2, k3 },
            zero(&[k4, k5, k6]),
        ),
        LensModel::Rational8 => (
            Distortion::Rational8 {
                k1,
                k2,
                p1,
                p2,
                k3,
                k4,
                k5,
                k6,
            },
            true,
        ),
        _ => return None,
    };
    found.1.then_some(found.0)
}

/// Fits `target` to `source` over the whole image.
///
/// # Errors
/// [`ConvertError`].
///
/// ```
/// use camera_models::{CameraModel, Distortion, LensModel, convert};
///
/// let distortion = Distortion::RadTan4 { k1: -0.1, k2: 0.01, p1: 0.0, p2: 0.0 };
/// let source = CameraModel::new((64, 48), [60.0, 60.0, 31.5, 23.5], distortion);
/// let fitted = convert(&source, LensModel::KannalaBrandt4)?;
/// assert!(!fitted.exact);
/// assert!(fitted.max_px < 0.05, "{} px", fitted.max_px);
/// assert_eq!(fitted.lost, 0.0);
/// # Ok::<(), camera_models::ConvertError>(())
/// ```
pub fn convert(source: &CameraModel, target: LensModel) -> Result<Conversion, ConvertError> {
    convert_within(source, target, std::f64::consts::PI)
}

/// The same up to an angle off the axis, radians.
///
/// # Errors
/// [`ConvertError`].
pub fn convert_within(
    source: &CameraModel,
    target: LensModel,
    widest_rad: f64,
) -> Result<Conversion, ConvertError> {
    let lens = Lens::new(source);
    if let Some(distortion) = exactly(&source.distortion, target) {
        let model = CameraModel {
            distortion,
            ..*source
        };
        return Ok(measure(&lens, &model, true, widest_rad));
    }
    let widest_rad = if target.is_pinhole() {
        widest_rad.min(MAX_PINHOLE_ANGLE_RAD)
    } else {
        widest_rad
    };
    let samples: Vec<Sample> = grid(source, FIT_GRID)
        .filter_map(|pixel| Sample::of(&lens, pixel))
        .filter(|sample| sample.angle_rad <= widest_rad)
        .collect();
    let least = 4 * CameraModel::MAX_PARAMETERS;
    if samples.len() < least {
        return Err(ConvertError::TooFew {
            directions: samples.len(),
            grid: FIT_GRID[0] * FIT_GRID[1],
            target: target.name(),
        });
    }
    let farthest = samples.iter().map(|s| s.angle_rad).fold(0.0, f64::max);
    // Near the axis a double sphere is a pinhole of a smaller focal length.
    let shrunk = |distortion: &Distortion| match distortion {
        Distortion::DoubleSphere { xi, .. } => 1.0 + xi,
        _ => 1.0,
    };
    let fitted = target.beginnings().into_iter().map(|distortion| {
        let scale = shrunk(&distortion) / shrunk(&source.distortion);
        let mut model = CameraModel {
            fx: source.fx * scale,
            fy: source.fy * scale,
            distortion,
            ..*source
        };
        for stage in STAGES {
            let enough = if stage < 1.0 { 1e-5 } else { 1e-11 };
            let inside: Vec<Sample> = samples
                .iter()
                .filter(|s| s.angle_rad <= stage * farthest)
                .copied()
                .collect();
            if inside.len() >= least {
                model = fit(model, &inside, enough);
            }
        }
        (cost(&model, &samples), model)
    });
    let best = fitted.reduce(|a, b| if b.0 < a.0 { b } else { a });
    let (_, model) = best.expect("every model has a beginning");
    if model.parameters().iter().any(|p| !p.is_finite()) || model.fx <= 0.0 || model.fy <= 0.0 {
        return Err(ConvertError::NoFit {
            target: target.name(),
        });
    }
    Ok(measure(&lens, &model, false, widest_rad))
}

/// A pixel of the source and its direction.
#[derive(Clone, Copy)]
struct Sample {
    pixel: [f64; 2],
    direction: [f64; 3],
    angle_rad: f64,
}

impl Sample {
    fn of(lens: &Lens, pixel: [f64; 2]) -> Option<Self> {
        let direction @ [x, y, z] = lens.unproject(pixel)?;
        Some(Self {
            pixel,
            direction,
            angle_rad: (x * x + y * y).sqrt().atan2(z),
        })
    }
}

/// Pixels over the whole image, the outer ones on its border.
fn grid(model: &CameraModel, [columns, rows]: [usize; 2]) -> impl Iterator<Item = [f64; 2]> {
    let (width, height) = (f64::from(model.width), f64::from(model.height));
    (0..columns * rows).map(move |i| {
        let part = |i: usize, count: usize| i as f64 / (count - 1) as f64;
        [
            part(i % columns, columns) * width - 0.5,
            part(i / columns, rows) * height - 0.5,
        ]
    })
}

/// Sum of squared distances. A direction outside the domain costs more than any residual within the
/// image, so that none is dropped to lower the sum.
fn cost(model: &CameraModel, samples: &[Sample]) -> f64 {
    if !possible(model) {
        return f64::INFINITY;
    }
    let penalty = 16.0 * (f64::from(model.width).powi(2) + f64::from(model.height).powi(2));
    let lens = Lens::new(model);
    let distance = |s: &Sample| {
        lens.project(s.direction).map_or(penalty, |[x, y]| {
            (x - s.pixel[0]).powi(2) + (y - s.pixel[1]).powi(2)
        })
    };
    samples.iter().map(distance).sum()
}

/// Levenberg–Marquardt with analytic Jacobians, until a step decreases the sum by a fraction of
/// less than `enough`.
fn fit(start: CameraModel, samples: &[Sample], enough: f64) -> CameraModel {
    let mut model = start;
    let mut best = cost(&model, samples);
    let mut damping = 1e-3;
    for _ in 0..ITERATIONS {
        let (normal, gradient) = normal_equations(&model, samples);
        let mut improved = None;
        while damping < 1e12 {
            let mut damped = normal.clone();
            for i in 0..damped.nrows() {
                damped[(i, i)] += damping * normal[(i, i)].max(1e-12);
            }
            let step = damped.cholesky().map(|c| c.solve(&gradient));
            if let Some(step) = step {
                let moved: Vec<f64> = model
                    .parameters()
                    .iter()
                    .zip(step.iter())
                    .map(|(p, s)| p - s)
                    .collect();
                let candidate = model.with_parameters(&moved);
                let value = cost(&candidate, samples);
                if value < best {
                    improved = Some((candidate, value));
                    break;
                }
            }
            damping *= 8.0;
        }
        let Some((candidate, value)) = improved else {
            break;
        };
        let gain = best - value;
        (model, best) = (candidate, value);
        damping = (damping / 10.0).max(1e-12);
        if gain <= enough * best || best < 1e-20 {
            break;
        }
    }
    model
}

/// Whether the parameters are in the range of the model (Usenko et al. 2018, section 2).
fn possible(model: &CameraModel) -> bool {
    let lens = match model.distortion {
        Distortion::DoubleSphere { xi, alpha } => {
            (-0.999..=2.0).contains(&xi) && (0.0..=1.0).contains(&alpha)
        }
        Distortion::Eucm { alpha, beta } => (0.0..=1.0).contains(&alpha) && beta > 1e-3,
        _ => true,
    };
    lens && model.fx > 0.0 && model.fy > 0.0 && model.parameters().iter().all(|p| p.is_finite())
}

fn normal_equations(model: &CameraModel, samples: &[Sample]) -> (DMatrix<f64>, DVector<f64>) {
    let count = model.parameters().len();
    let lens = Lens::new(model);
    let mut normal = DMatrix::zeros(count, count);
    let mut gradient = DVector::zeros(count);
    for sample in samples {
        let Some(found) = lens.project_with_jacobians(sample.direction) else {
            continue;
        };
        for row in 0..2 {
            let residual = found.pixel[row] - sample.pixel[row];
            for i in 0..count {
                let by = found.by_parameters[(row, i)];
                gradient[i] += by * residual;
                for j in 0..count {
                    normal[(i, j)] += by * found.by_parameters[(row, j)];
                }
            }
        }
    }
    (normal, gradient)
}

fn measure(source: &Lens, model: &CameraModel, exact: bool, widest_rad: f64) -> Conversion {
    let target = Lens::new(model);
    let mut conversion = Conversion {
        model: *model,
        exact,
        max_px: 0.0,
        rms_px: 0.0,
        worst_at: [model.cx, model.cy],
        lost: 0.0,
        lost_from_rad: None,
        without_direction: 0.0,
    };
    let (mut all, mut compared, mut lost, mut without) = (0_usize, 0_usize, 0_usize, 0_usize);
    for pixel in grid(model, CHECK_GRID) {
        all += 1;
        let Some(sample) = Sample::of(source, pixel) else {
            without += 1;
            continue;
        };
        let found = (sample.angle_rad <= widest_rad)
            .then(|| target.project(sample.direction))
            .flatten();
        let Some([x, y]) = found else {
            lost += 1;
            let nearest = conversion.lost_from_rad.unwrap_or(f64::INFINITY);
            conversion.lost_from_rad = Some(nearest.min(sample.angle_rad));
            continue;
        };
        compared += 1;
        if exact {
            continue;
        }
        let off = (x - pixel[0]).hypot(y - pixel[1]);
        conversion.rms_px += off * off;
        if off > conversion.max_px {
            conversion.max_px = off;
            conversion.worst_at = pixel;
        }
    }
    conversion.rms_px = (conversion.rms_px / compared.max(1) as f64).sqrt();
    conversion.lost = lost as f64 / all as f64;
    conversion.without_direction = without as f64 / all as f64;
    conversion
}

impl fmt::Display for Conversion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.model.distortion.name();
        if self.exact {
            write!(f, "{name} holds the lens exactly")?;
        } else {
            let [x, y] = self.worst_at;
            write!(
                f,
                "{name} has a maximum error of {:.4} px (at {x:.0}, {y:.0}), {:.4} px RMS",
                self.max_px, self.rms_px
            )?;
        }
        if let Some(from) = self.lost_from_rad {
            write!(
                f,
                "; {:.1} % of the image, from {:.1}° off the axis on, is outside its domain",
                100.0 * self.lost,
                from.to_degrees()
            )?;
        }
        if self.without_direction > 0.0 {
            write!(
                f,
                "; {:.1} % of the image had no direction in the source",
                100.0 * self.without_direction
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
