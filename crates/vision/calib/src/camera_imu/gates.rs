//! Gates: unobservable directions, and checks of the result.

use std::fmt;

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::config::GateConfig;
use super::noise::{Noise, NoiseEstimates};
use super::problem::{BOARD, DRIFT, OFFSET, Prior, ROTATION, SHAPES, SHARED, Shared, TRANSLATION};

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
    pub config: &'a GateConfig,
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
    for (axis, sigma_rad) in directions(ROTATION, evidence.config.max_rotation_sigma_rad) {
        out.push(UnobservableDirection::Rotation { axis, sigma_rad });
    }
    for (direction, sigma_m) in directions(TRANSLATION, evidence.config.max_translation_sigma_m) {
        out.push(UnobservableDirection::Translation { direction, sigma_m });
    }
    let sigma_s = evidence.covariance[(OFFSET, OFFSET)].sqrt();
    if sigma_s > evidence.config.max_offset_sigma_s {
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
    let config = evidence.config;
    vec![
        observability(unobservable),
        noise("corner noise", &noises.corners, config.corner_noise),
        noise("views against motion", &noises.poses, config.pose_noise),
        noise("gyroscope noise", &noises.gyro, config.imu_noise),
        noise("accelerometer noise", &noises.accel, config.imu_noise),
        noise("gyroscope bias walk", &noises.gyro_walk, config.bias_walk),
        noise(
            "accelerometer bias walk",
            &noises.accel_walk,
            config.bias_walk,
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
    let verdict = if off.abs() > evidence.config.significance_sigma {
        Verdict::Fail
    } else {
        Verdict::Pass
    };
    let percent = 100.0 * (scale / nominal - 1.0);
    let text = format!(
        "{percent:+.2} % from its nominal size by the recording alone (sigma {:.2} %), expected within {:.2} %: square \
         size, baseline or accelerometer",
        100.0 * sigma,
        100.0 * evidence.config.significance_sigma * tolerance
    );
    gate(name, verdict, text)
}

fn drift(evidence: &Evidence<'_>) -> Gate {
    let drift = evidence.shared.drift;
    let sigma = evidence.covariance[(DRIFT, DRIFT)].sqrt();
    let [most, worst] = evidence.config.drift_s;
    let over_all = drift * evidence.seconds;
    let real = (drift / sigma).abs() > evidence.config.significance_sigma;
    let verdict = match over_all.abs() {
        s if real && s > worst => Verdict::Fail,
        s if real && s > most => Verdict::Warn,
        _ => Verdict::Pass,
    };
    let text = format!(
        "the time offset grows by {:.3} ms over the recording (sigma {:.3} ms), expected below {:.1} ms: clocks \
         that are not joined",
        1e3 * over_all,
        1e3 * sigma * evidence.seconds,
        1e3 * most
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
        z if z > evidence.config.shape_sigma[1] => Verdict::Fail,
        z if z > evidence.config.shape_sigma[0] => Verdict::Warn,
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
    let [most, worst] = evidence.config.halves_chi2;
    let verdict = match squared {
        s if s > worst => Verdict::Fail,
        s if s > most => Verdict::Warn,
        _ => Verdict::Pass,
    };
    let text = format!(
        "rotation, lever arm and offset differ by {squared:.1} (chi-squared of seven), expected below {most}: \
         a camera that was knocked, or a clock that jumped"
    );
    gate(name, verdict, text)
}

fn outliers(evidence: &Evidence<'_>) -> Gate {
    let share = evidence.outliers as f64 / evidence.views as f64;
    let [most, worst] = evidence.config.outlier_ratio;
    let verdict = match share {
        s if s > worst => Verdict::Fail,
        s if s > most => Verdict::Warn,
        _ => Verdict::Pass,
    };
    let text = format!(
        "{} of {} views contradict the motion, expected at most {:.0} %",
        evidence.outliers,
        evidence.views,
        100.0 * most
    );
    gate("outlier views", verdict, text)
}

fn inertial_coverage(evidence: &Evidence<'_>) -> Gate {
    let all = evidence.views - 1;
    let share = evidence.linked as f64 / all as f64;
    let verdict = if share < evidence.config.min_inertial_ratio {
        Verdict::Warn
    } else {
        Verdict::Pass
    };
    let text = format!(
        "{} of {all} intervals between views have complete IMU samples, expected at least {:.0} %",
        evidence.linked,
        100.0 * evidence.config.min_inertial_ratio
    );
    gate("inertial samples", verdict, text)
}
