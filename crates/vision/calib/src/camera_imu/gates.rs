//! Gates: unobservable directions, and checks of the result.

use std::fmt;

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::noise::{Noise, NoiseEstimates};
use super::problem::{BOARD, DRIFT, OFFSET, Prior, ROTATION, SHAPES, SHARED, Shared, TRANSLATION};

/// Maximum sigma of a determined direction: rotation in rad (0.1°), lever arm in m, offset in s.
pub(super) const MAX_ROTATION_SIGMA_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;
/// See [`MAX_ROTATION_SIGMA_RAD`].
pub(super) const MAX_TRANSLATION_SIGMA_M: f64 = 2e-3;
/// See [`MAX_ROTATION_SIGMA_RAD`].
pub(super) const MAX_OFFSET_SIGMA_S: f64 = 3e-4;

/// Significance: deviations from a nominal value up to this number of sigmas are chance.
const SIGNIFICANCE_SIGMAS: f64 = 3.5;
/// Limits for the difference of the halves (chi-squared of seven): exceeded by chance once in a
/// thousand; certain.
const MAX_HALVES_CHI2_WARN: f64 = 24.3;
const MAX_HALVES_CHI2_FAIL: f64 = 40.0;

/// Outcome of a check, from good to bad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// No objection.
    Pass,
    /// Usable, but a parameter deviates from its nominal value.
    Warn,
    /// Not to be used.
    Fail,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Pass => "PASS",
            Self::Warn => "WARN",
            Self::Fail => "FAIL",
        })
    }
}

/// A check of the result.
#[derive(Clone, Debug, PartialEq)]
pub struct Gate {
    /// Name of the check, one to three words.
    pub name: &'static str,
    /// Outcome.
    pub verdict: Verdict,
    /// What was found and what was expected.
    pub text: String,
}

/// A direction that the recording does not determine.
#[derive(Clone, Debug, PartialEq)]
pub enum UnobservableDirection {
    /// Rotation about an axis of the left optical frame.
    Rotation {
        /// Of length 1.
        axis: [f64; 3],
        /// rad.
        sigma_rad: f64,
    },
    /// Lever arm along a direction of the IMU's frame.
    Translation {
        /// Of length 1.
        direction: [f64; 3],
        /// m.
        sigma_m: f64,
    },
    /// Time offset.
    TimeOffset {
        /// s.
        sigma_s: f64,
    },
}

impl fmt::Display for UnobservableDirection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rotation { axis, sigma_rad } => write!(
                f,
                "rotation about {} of the left camera not determined by this recording (sigma {:.2} deg): rotate \
                 about other axes too",
                named(axis),
                sigma_rad.to_degrees()
            ),
            Self::Translation { direction, sigma_m } => write!(
                f,
                "lever arm along {} of the IMU not determined by this recording (sigma {:.1} mm): rotate about axes \
                 normal to it, faster",
                named(direction),
                1e3 * sigma_m
            ),
            Self::TimeOffset { sigma_s } => write!(
                f,
                "time offset not determined by this recording (sigma {:.2} ms): rotate back and forth",
                1e3 * sigma_s
            ),
        }
    }
}

/// Name of the nearest axis, or the components.
fn named(v: &[f64; 3]) -> String {
    let near = v.iter().position(|c| c.abs() > 0.97);
    match near {
        Some(k) => ["x", "y", "z"][k].to_owned(),
        None => format!("({:.2}, {:.2}, {:.2})", v[0], v[1], v[2]),
    }
}

/// Input of the checks.
pub(super) struct Evidence<'a> {
    pub noises: &'a NoiseEstimates,
    pub covariance: &'a SMatrix<f64, SHARED, SHARED>,
    pub prior: &'a Prior,
    pub shared: &'a Shared,
    pub halves: Option<f64>,
    pub seconds: f64,
    pub views: usize,
    pub outliers: usize,
    pub linked: usize,
}

/// Eigenvectors of the covariance of each group with too large a sigma, all other parameters free
/// within their priors.
pub(super) fn unobservable(evidence: &Evidence<'_>) -> Vec<UnobservableDirection> {
    let directions = |at: usize, most: f64| {
        let block: Matrix3<f64> = evidence.covariance.fixed_view::<3, 3>(at, at).into();
        let eigen = block.symmetric_eigen();
        let mut found: Vec<([f64; 3], f64)> = (0..3)
            .map(|k| {
                let v: Vector3<f64> = eigen.eigenvectors.column(k).into();
                // The sign is free; the largest part points forward.
                let v = v * v[v.iamax()].signum();
                (v.into(), eigen.eigenvalues[k].max(0.0).sqrt())
            })
            .filter(|(_, sigma)| *sigma > most)
            .collect();
        found.sort_by(|a, b| b.1.total_cmp(&a.1));
        found
    };
    let mut out = Vec::new();
    for (axis, sigma_rad) in directions(ROTATION, MAX_ROTATION_SIGMA_RAD) {
        out.push(UnobservableDirection::Rotation { axis, sigma_rad });
    }
    for (direction, sigma_m) in directions(TRANSLATION, MAX_TRANSLATION_SIGMA_M) {
        out.push(UnobservableDirection::Translation { direction, sigma_m });
    }
    let sigma_s = evidence.covariance[(OFFSET, OFFSET)].sqrt();
    if sigma_s > MAX_OFFSET_SIGMA_S {
        out.push(UnobservableDirection::TimeOffset { sigma_s });
    }
    out
}

/// Estimate and sigma of a parameter from the data alone, with its prior removed. `None` without
/// data.
fn data_alone(evidence: &Evidence<'_>, k: usize, found: f64, nominal: f64) -> Option<(f64, f64)> {
    let sigma = evidence.prior.sigmas[k];
    let with = 1.0 / evidence.covariance[(k, k)];
    let alone = with - sigma.powi(-2);
    (alone > 1e-3 * with).then(|| {
        let value = nominal + (found - nominal) * with / alone;
        (value, alone.powf(-0.5))
    })
}

/// Runs all checks.
pub(super) fn gates(evidence: &Evidence<'_>, unobservable: &[UnobservableDirection]) -> Vec<Gate> {
    let noises = evidence.noises;
    vec![
        observability(unobservable),
        noise("corner noise", &noises.corners, [0.3, 3.0, 8.0]),
        noise("views against motion", &noises.poses, [0.0, 1.5, 3.0]),
        noise("gyroscope noise", &noises.gyro, [0.4, 2.0, 10.0]),
        noise("accelerometer noise", &noises.accel, [0.4, 2.0, 10.0]),
        noise("gyroscope bias walk", &noises.gyro_walk, [0.0, 5.0, 100.0]),
        noise(
            "accelerometer bias walk",
            &noises.accel_walk,
            [0.0, 5.0, 100.0],
        ),
        board(evidence),
        drift(evidence),
        shapes(evidence),
        halves(evidence),
        outliers(evidence),
        inertial_coverage(evidence),
    ]
}

fn gate(name: &'static str, verdict: Verdict, text: String) -> Gate {
    Gate {
        name,
        verdict,
        text,
    }
}

fn observability(unobservable: &[UnobservableDirection]) -> Gate {
    let (verdict, text) = match unobservable.is_empty() {
        true => (Verdict::Pass, "all directions are determined".to_owned()),
        false => (
            Verdict::Warn,
            unobservable
                .iter()
                .map(UnobservableDirection::to_string)
                .collect::<Vec<_>>()
                .join("; "),
        ),
    };
    gate("observability", verdict, text)
}

/// `bounds`: warn below the first, warn above the second, fail above the third.
fn noise(name: &'static str, noise: &Noise, bounds: [f64; 3]) -> Gate {
    let found = noise.ratio_to_nominal;
    let [low, high, worst] = bounds;
    let verdict = match found {
        f if f > worst || !f.is_finite() => Verdict::Fail,
        f if f > high || f < low => Verdict::Warn,
        _ => Verdict::Pass,
    };
    let text = format!("{found:.2} times the nominal noise, expected {low} to {high}");
    gate(name, verdict, text)
}

fn board(evidence: &Evidence<'_>) -> Gate {
    let name = "size of the board";
    let nominal = evidence.prior.shared.board_scale;
    let Some((scale, sigma)) = data_alone(evidence, BOARD, evidence.shared.board_scale, nominal)
    else {
        return gate(
            name,
            Verdict::Pass,
            "not observed in this recording".to_owned(),
        );
    };
    let tolerance = evidence.prior.sigmas[BOARD];
    let off = (scale - nominal) / sigma.hypot(tolerance);
    let verdict = if off.abs() > SIGNIFICANCE_SIGMAS {
        Verdict::Fail
    } else {
        Verdict::Pass
    };
    let percent = 100.0 * (scale / nominal - 1.0);
    let text = format!(
        "{percent:+.2} % from its nominal size by the recording alone (sigma {:.2} %), expected within {:.2} %: square \
         size, baseline or accelerometer",
        100.0 * sigma,
        100.0 * SIGNIFICANCE_SIGMAS * tolerance
    );
    gate(name, verdict, text)
}

fn drift(evidence: &Evidence<'_>) -> Gate {
    let drift = evidence.shared.drift;
    let sigma = evidence.covariance[(DRIFT, DRIFT)].sqrt();
    let over_all = drift * evidence.seconds;
    let real = (drift / sigma).abs() > SIGNIFICANCE_SIGMAS;
    let verdict = match over_all.abs() {
        s if real && s > 1e-3 => Verdict::Fail,
        s if real && s > 1e-4 => Verdict::Warn,
        _ => Verdict::Pass,
    };
    let text = format!(
        "the time offset grows by {:.3} ms over the recording (sigma {:.3} ms), expected below 0.1 ms: clocks \
         that are not joined",
        1e3 * over_all,
        1e3 * sigma * evidence.seconds
    );
    gate("drift of the clocks", verdict, text)
}

fn shapes(evidence: &Evidence<'_>) -> Gate {
    let shapes = [
        (&evidence.shared.gyro_shape, "gyroscope"),
        (&evidence.shared.accel_shape, "accelerometer"),
    ];
    let mut worst = (0.0_f64, String::new());
    for (s, (shape, sensor)) in shapes.iter().enumerate() {
        for k in 0..9 {
            let (row, column) = (k / 3, k % 3);
            let off = shape[(row, column)] - f64::from(u8::from(row == column));
            let sigma = evidence.prior.sigmas[SHAPES + 9 * s + k];
            if (off / sigma).abs() > worst.0 {
                let what = if row == column { "scale" } else { "skew" };
                worst = (
                    (off / sigma).abs(),
                    format!(
                        "{what} {row}{column} of the {sensor} deviates by {:.2} %",
                        100.0 * off
                    ),
                );
            }
        }
    }
    let verdict = match worst.0 {
        z if z > 6.0 => Verdict::Fail,
        z if z > 4.0 => Verdict::Warn,
        _ => Verdict::Pass,
    };
    let text = format!("{}, {:.1} times its prior sigma", worst.1, worst.0);
    gate("scale and skew", verdict, text)
}

fn halves(evidence: &Evidence<'_>) -> Gate {
    let name = "first half against second";
    let Some(squared) = evidence.halves else {
        return gate(name, Verdict::Warn, "too short to compare".to_owned());
    };
    let verdict = match squared {
        s if s > MAX_HALVES_CHI2_FAIL => Verdict::Fail,
        s if s > MAX_HALVES_CHI2_WARN => Verdict::Warn,
        _ => Verdict::Pass,
    };
    let text = format!(
        "rotation, lever arm and offset differ by {squared:.1} (chi-squared of seven), expected below {MAX_HALVES_CHI2_WARN}: \
         a camera that was knocked, or a clock that jumped"
    );
    gate(name, verdict, text)
}

fn outliers(evidence: &Evidence<'_>) -> Gate {
    let share = evidence.outliers as f64 / evidence.views as f64;
    let verdict = match share {
        s if s > 0.2 => Verdict::Fail,
        s if s > 0.03 => Verdict::Warn,
        _ => Verdict::Pass,
    };
    let text = format!(
        "{} of {} views contradict the motion, expected at most 3 %",
        evidence.outliers, evidence.views
    );
    gate("outlier views", verdict, text)
}

fn inertial_coverage(evidence: &Evidence<'_>) -> Gate {
    let all = evidence.views - 1;
    let share = evidence.linked as f64 / all as f64;
    let verdict = if share < 0.8 {
        Verdict::Warn
    } else {
        Verdict::Pass
    };
    let text = format!(
        "{} of {all} intervals between views have complete IMU samples, expected at least 80 %",
        evidence.linked
    );
    gate("inertial samples", verdict, text)
}
