use std::ops::Range;

use super::variance::MIN_LENGTHS;
use super::*;
use crate::allan::covariance::Covariances;
use crate::test_data::shared;

/// Normal numbers: Box and Muller's transform of splitmix64.
pub(crate) struct Noise(u64);

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0xD1B5_4A32_D192_ED03)
    }

    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 * (-53_f64).exp2() + (-54_f64).exp2()
    }

    pub(crate) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// A rate with white noise `n`, bias instability `b` and random walk `k`. The flicker is a sum
    /// of first-order processes of equal power, their time constants an octave apart from one
    /// period to 16 times the whole: power σ² each gives a two-sided density of σ² / (2 ln 2 f),
    /// which is B² / (2π f).
    pub(crate) fn rate(&mut self, samples: usize, period: f64, [n, b, k]: [f64; 3]) -> Vec<f64> {
        let sigma = b * (std::f64::consts::LN_2 / std::f64::consts::PI).sqrt();
        let mut flicker: Vec<(f64, f64)> = Vec::new();
        let mut constant = period;
        while b > 0.0 && constant < 16.0 * samples as f64 * period {
            flicker.push(((-period / constant).exp(), sigma * self.normal()));
            constant *= 2.0;
        }
        let mut walked = 0.0;
        let one = |_| {
            let mut rate = walked + n / period.sqrt() * self.normal();
            walked += k * period.sqrt() * self.normal();
            for (keep, state) in &mut flicker {
                rate += *state;
                *state = *keep * *state + sigma * (1.0 - *keep * *keep).sqrt() * self.normal();
            }
            rate
        };
        (0..samples).map(one).collect()
    }
}

/// The curve of a recording without a gap.
fn whole(rate: &[f64], period: f64) -> Curve {
    curve(rate, std::slice::from_ref(&(0..rate.len())), period)
}

/// The Allan variance as it is defined: half the mean squared difference of neighbouring averages.
fn slow(rate: &[f64], runs: &[Range<usize>], factor: usize) -> (f64, u64) {
    let (mut sum, mut terms) = (0.0, 0);
    for run in runs {
        if run.len() < MIN_LENGTHS * factor {
            continue;
        }
        for i in run.start..=run.end - 2 * factor {
            let mean = |at: usize| rate[at..at + factor].iter().sum::<f64>() / factor as f64;
            sum += (mean(i + factor) - mean(i)).powi(2);
            terms += 1;
        }
    }
    (0.5 * sum / terms as f64, terms)
}

#[test]
fn curve_agrees_with_the_definition_and_never_crosses_a_gap() {
    let mut rate = Noise::new(3).rate(700, 0.01, [1.0, 0.0, 0.5]);
    // The samples between two runs belong to neither.
    rate[200..230].fill(1e6);
    let runs = [0..200, 230..690];
    let found = curve(&rate, &runs, 0.01);
    assert_eq!(found.points.first().map(|p| p.factor), Some(1));
    assert_eq!(found.points.last().map(|p| p.factor), Some(91));
    for point in &found.points {
        let (variance, terms) = slow(&rate, &runs, point.factor);
        assert_eq!(point.terms, terms);
        // Both add some hundred squares in a different order.
        assert!((point.variance / variance - 1.0).abs() < 1e-10, "{point:?}");
    }
    assert!(curve(&[], &[], 0.01).points.is_empty());
}

/// Tables of a file of Stable32: averaging factor, τ, terms, exponent, least, value, greatest.
fn table(path: &std::path::Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    let rows = text.lines().map(|line| line.split_whitespace());
    let rows = rows.map(|row| row.map_while(|word| word.parse().ok()).collect());
    rows.filter(|row: &Vec<f64>| row.len() >= 6).collect()
}

#[test]
fn deviations_agree_with_stable32() {
    let Some(folder) = shared("06_calibration/allan_reference/phasedat") else {
        return;
    };
    let phase: Vec<f64> = std::fs::read_to_string(folder.join("PHASE.DAT"))
        .unwrap()
        .lines()
        .filter_map(|line| line.trim().parse().ok())
        .collect();
    assert_eq!(phase.len(), 1001);
    type Deviation = fn(&[f64], f64, usize) -> Option<f64>;
    let kinds: [(&str, Deviation); 6] = [
        ("adev", deviation::adev),
        ("oadev", deviation::oadev),
        ("mdev", deviation::mdev),
        ("hdev", deviation::hdev),
        ("ohdev", deviation::ohdev),
        ("totdev", deviation::totdev),
    ];
    for (name, deviation) in kinds {
        let (mut rows, mut worst) = (0, 0.0_f64);
        for suffix in ["", "_octave"] {
            for row in table(&folder.join(format!("phase_dat_{name}{suffix}.txt"))) {
                let found = deviation(&phase, 1.0, row[0] as usize).unwrap();
                worst = worst.max((found / row[5] - 1.0).abs());
                rows += 1;
            }
        }
        println!("{name}: {rows} answers, worst relative difference {worst:.1e}");
        // The answers have five digits.
        assert!(rows > 100 && worst < 5e-5, "{name}: {rows} {worst}");
    }
    for (_, deviation) in kinds {
        assert_eq!(deviation(&phase[..2], 1.0, 1), None);
        assert_eq!(deviation(&phase, 1.0, 0), None);
        assert_eq!(deviation(&phase, 1.0, 2000), None);
    }
}

/// The degrees of freedom of the overlapping Allan variance as NIST SP 1065 approximates them
/// (5.4.1), for white, flicker and random-walk noise of the rate; `n` is the number of phase
/// points.
fn handbook(n: f64, m: f64) -> [f64; 3] {
    let white =
        (3.0 * (n - 1.0) / (2.0 * m) - 2.0 * (n - 2.0) / n) * 4.0 * m * m / (4.0 * m * m + 5.0);
    let flicker = 5.0 * n * n / (4.0 * m * (n + 3.0 * m));
    let walk =
        (n - 2.0) / m * ((n - 1.0).powi(2) - 3.0 * m * (n - 1.0) + 4.0 * m * m) / (n - 3.0).powi(2);
    [white, flicker, walk]
}

#[test]
fn degrees_of_freedom_agree_with_the_handbook() {
    let samples = 100_000;
    let curve = curve(
        &vec![0.0; samples],
        std::slice::from_ref(&(0..samples)),
        1.0,
    );
    let covariances = Covariances::new(&curve);
    let mut worst = [0.0_f64; 3];
    for (kind, worst) in worst.iter_mut().enumerate() {
        let mut powers = [0.0; 4];
        powers[kind + 1] = 1.0;
        let covariance = covariances.of(&powers);
        for (i, point) in curve.points.iter().enumerate().skip(2) {
            let variance = Coefficient::ALL[kind + 1].variance(point.tau_s);
            // The discrete sum of a short average of a random walk is a little more.
            let freedom = 2.0 * variance * variance / covariance[(i, i)];
            let expected = handbook(samples as f64 + 1.0, point.factor as f64)[kind];
            *worst = worst.max((freedom / expected - 1.0).abs());
        }
    }
    println!(
        "worst relative difference: white {:.3}, flicker {:.3}, walk {:.3}",
        worst[0], worst[1], worst[2]
    );
    // The handbook's formulas are fits, good to some percent.
    assert!(
        worst[0] < 0.03 && worst[1] < 0.1 && worst[2] < 0.13,
        "{worst:?}"
    );
}

/// Scatter of the points, and of pairs of points, against many simulated recordings.
#[test]
fn scatter_of_points_agrees_with_their_covariance() {
    let (samples, period, seeds) = (2000, 0.02, 300);
    for truth in [[1.0, 0.0, 0.0], [0.1, 1.0, 0.0], [0.2, 0.0, 1.0]] {
        let curves: Vec<Curve> = (0..seeds)
            .map(|seed| whole(&Noise::new(seed).rate(samples, period, truth), period))
            .collect();
        let powers = [0.0, truth[0].powi(2), truth[1].powi(2), truth[2].powi(2)];
        let computed = Covariances::new(&curves[0]).of(&powers);
        let n = curves[0].points.len();
        let mean = |i: usize| {
            curves.iter().map(|c| c.points[i].variance).sum::<f64>() / f64::from(seeds as u32)
        };
        // The shortest averages show the cut-off of the simulated flicker.
        for i in (8..n).step_by(4) {
            for j in [i, (i + 2).min(n - 1), (i + 6).min(n - 1)] {
                let (a, b) = (mean(i), mean(j));
                let products = curves
                    .iter()
                    .map(|c| (c.points[i].variance - a) * (c.points[j].variance - b));
                let measured = products.sum::<f64>() / (seeds - 1) as f64;
                let scale = (computed[(i, i)] * computed[(j, j)]).sqrt();
                let off = (measured - computed[(i, j)]) / scale;
                // 300 recordings determine a correlation to about 0.08; variances, which are
                // skewed, to 0.1 or more.
                assert!(
                    off.abs() < 0.35,
                    "{truth:?} {i} {j}: {measured:e} {:e}",
                    computed[(i, j)]
                );
            }
        }
    }
}

/// How often the ground truth is within two sigma and within the interval, and how often a term is
/// determined.
#[derive(Default)]
struct Tally {
    known: u32,
    in_two_sigma: u32,
    in_interval: u32,
    below: u32,
    below_right: u32,
}

impl Tally {
    fn add(&mut self, found: Value, truth: f64) {
        match found {
            Value::Known {
                value,
                sigma,
                interval,
            } => {
                self.known += 1;
                self.in_two_sigma += u32::from((value - truth).abs() <= 2.0 * sigma);
                self.in_interval += u32::from((interval[0]..=interval[1]).contains(&truth));
            }
            Value::Below(limit) => {
                self.below += 1;
                self.below_right += u32::from(truth <= limit);
            }
        }
    }
}

impl Tally {
    /// Of 100 intervals about 95 contain the ground truth; of [`SEEDS`], seven or more miss it by
    /// chance once in 1700 times (binomial).
    fn assert_calibrated(&self, name: &str) {
        let (all, right) = (self.known + self.below, self.in_interval + self.below_right);
        assert!(all - right <= 6, "{name}: {right} of {all}");
    }
}

/// Recordings of each trial.
const SEEDS: u64 = 30;

fn trial(samples: usize, period: f64, truth: [f64; 3]) -> [Tally; 4] {
    let mut tallies: [Tally; 4] = Default::default();
    let mut fitter = None;
    for seed in 0..SEEDS {
        let rate = Noise::new(1000 + seed).rate(samples, period, truth);
        let curve = whole(&rate, period);
        let fitter = fitter.get_or_insert_with(|| fit::Fitter::new(&curve, &FitConfig::default()));
        let fit = fitter.fit(&curve).unwrap();
        let truths = [0.0, truth[0], truth[1], truth[2]];
        for (k, kind) in Coefficient::ALL.into_iter().enumerate() {
            tallies[k].add(fit.value(kind), truths[k]);
        }
    }
    for (name, t) in ["Q", "N", "B", "K"].iter().zip(&tallies) {
        println!(
            "{truth:?} {name}: known {} (2 sigma {}, interval {}), below {} (right {})",
            t.known, t.in_two_sigma, t.in_interval, t.below, t.below_right
        );
    }
    tallies
}

#[test]
fn stated_uncertainties_hold_white_and_walk() {
    let [q, n, b, k] = trial(40_000, 0.01, [1e-3, 0.0, 1e-3]);
    n.assert_calibrated("N");
    assert_eq!(n.below, 0);
    assert!(k.known >= 15, "{}", k.known);
    k.assert_calibrated("K");
    assert!(q.known <= 2 && b.known <= 2, "{} {}", q.known, b.known);
}

#[test]
fn stated_uncertainties_hold_with_flicker() {
    let [q, n, b, k] = trial(30_000, 0.01, [1e-3, 1e-3, 0.0]);
    n.assert_calibrated("N");
    assert_eq!(n.below, 0);
    assert!(b.known >= 25, "{}", b.known);
    b.assert_calibrated("B");
    assert!(q.known <= 2 && k.known <= 2, "{} {}", q.known, k.known);
}

#[test]
fn stated_uncertainties_hold_with_all_three() {
    let [q, n, b, k] = trial(60_000, 0.01, [1e-3, 5e-4, 1e-4]);
    n.assert_calibrated("N");
    assert_eq!(n.below, 0);
    // Bias instability and random walk are hard to separate here. The stated uncertainties must
    // hold all the same.
    b.assert_calibrated("B");
    k.assert_calibrated("K");
    assert!(q.known <= 2, "{}", q.known);
}

#[test]
fn short_recording_gives_an_upper_limit() {
    let [_, n, b, k] = trial(6_000, 0.01, [1e-3, 1e-5, 1e-5]);
    n.assert_calibrated("N");
    assert_eq!(n.below, 0);
    assert!(k.known <= 2 && b.known <= 2, "{} {}", k.known, b.known);
    assert!(k.below - k.below_right <= 1, "{}", k.below_right);
}

#[test]
fn coarse_counts_are_quantization_and_filtered_averages_are_skipped() {
    // An angle in coarse steps: each rate is the difference of two rounded angles.
    let mut noise = Noise::new(5);
    let (period, step) = (0.01, 1e-3);
    let rate = noise.rate(30_000, period, [6e-3, 0.0, 0.0]);
    let angle: Vec<f64> = deviation::phase(&rate)
        .iter()
        .map(|x| (x * period / step).round() * step)
        .collect();
    let coarse: Vec<f64> = angle.windows(2).map(|w| (w[1] - w[0]) / period).collect();
    let found = fit(&whole(&coarse, period), &FitConfig::default()).unwrap();
    let q = found.value(Coefficient::Quantisation).known().unwrap();
    assert!((q / (step / 12_f64.sqrt()) - 1.0).abs() < 0.1, "{q}");

    // The mean of the last 4 samples takes noise from short averages only.
    let white = noise.rate(60_000, period, [1e-4, 0.0, 0.0]);
    let smooth: Vec<f64> = white
        .windows(4)
        .map(|w| w.iter().sum::<f64>() / 4.0)
        .collect();
    let found = fit(&whole(&smooth, period), &FitConfig::default()).unwrap();
    let n = found.value(Coefficient::White);
    let Value::Known { value, sigma, .. } = n else {
        panic!("{n:?}");
    };
    assert!(
        found.from_s > 0.04 && (value - 1e-4).abs() < 3e-6 + 2.0 * sigma,
        "{} {n:?}",
        found.from_s
    );
    assert!(sigma < 3e-6, "{sigma}");
}

/// The curve that a recording without a gap has on average: no hours of samples have to be made.
/// Of a random walk it is that of its samples, not of averages over the period; `ramp` is a steady
/// change of the rate, per second.
fn mean_curve(hours: f64, rate_hz: f64, [n, b, k]: [f64; 3], ramp: f64) -> Curve {
    let (samples, period_s) = ((hours * 3600.0 * rate_hz) as usize, 1.0 / rate_hz);
    let powers = [0.0, n * n + k * k * period_s * period_s / 6.0, b * b, k * k];
    let point = |factor: usize| {
        let tau_s = factor as f64 * period_s;
        let parts = Coefficient::ALL.iter().zip(powers);
        let noise: f64 = parts.map(|(c, power)| power * c.variance(tau_s)).sum();
        Point {
            factor,
            tau_s,
            variance: noise + 0.5 * (ramp * tau_s).powi(2),
            terms: (samples + 1 - 2 * factor) as u64,
        }
    };
    let factors = super::variance::factors(samples / MIN_LENGTHS);
    Curve {
        period_s,
        runs: vec![samples],
        points: factors.into_iter().map(point).collect(),
    }
}

/// One process alone: its own coefficient is right, and no other is called known. 36 hours at
/// 200 Hz of the random walk were once reported as white noise of 71.7 ± 7.0.
#[test]
fn pure_process_has_one_known_coefficient_however_long_the_recording() {
    for hours in [3.0, 36.0] {
        for (kind, truth) in [
            (Coefficient::White, [1e-3, 0.0, 0.0]),
            (Coefficient::Instability, [0.0, 1e-3, 0.0]),
            (Coefficient::Walk, [0.0, 0.0, 0.0266]),
        ] {
            let fit = fit(&mean_curve(hours, 200.0, truth, 0.0), &FitConfig::default());
            let fit = fit.expect("a fit");
            let expected: f64 = truth.iter().sum();
            for coefficient in Coefficient::ALL {
                let value = fit.value(coefficient);
                match value.known() {
                    Some(found) if coefficient == kind => {
                        assert!(
                            (found / expected - 1.0).abs() < 0.05,
                            "{kind:?} {hours} h: {value:?}"
                        );
                    }
                    None if coefficient != kind => {}
                    _ => panic!("{kind:?} {hours} h: {coefficient:?} {value:?}"),
                }
            }
            assert_eq!(fit.misfit, 0.0, "{kind:?} {hours} h");
        }
    }
}

/// A steady change of the rate is none of the four: nothing is called known, and the curve is
/// reported as off the model. A random walk fits it best, and is not seen.
#[test]
fn pure_ramp_has_no_known_coefficient() {
    let curve = mean_curve(3.0, 200.0, [0.0; 3], 1e-6);
    let fit = fit(&curve, &FitConfig::default()).expect("a fit");
    for coefficient in Coefficient::ALL {
        let value = fit.value(coefficient);
        assert_eq!(value.known(), None, "{coefficient:?} {value:?}");
    }
    assert!(fit.misfit > 0.0);
}

#[test]
fn constant_signal_has_no_fit() {
    assert_eq!(
        fit(&whole(&vec![0.1; 5000], 0.01), &FitConfig::default()),
        None
    );
    assert_eq!(
        fit(&whole(&[1.0, 2.0, 3.0], 0.01), &FitConfig::default()),
        None
    );
}

/// Curves and noise of an Alphasense's IMU over 36 hours (GrandTour), against the file made from
/// them with `allan_variance_ros`. There is no curve of the ZED 2i beside its file.
#[test]
fn curves_of_a_real_imu() {
    let Some(folder) = shared("06_calibration/grandtour/allan_variances/alphasense") else {
        return;
    };
    let text = std::fs::read_to_string(folder.join("allan_variance.csv")).unwrap();
    let rows: Vec<Vec<f64>> = text
        .lines()
        .map(|line| {
            line.split_whitespace()
                .map(|w| w.parse().unwrap())
                .collect()
        })
        .collect();
    assert_eq!(rows.len(), 9999);
    let yaml = std::fs::read_to_string(folder.join("imu.yaml")).unwrap();
    let stated = |key: &str| -> f64 {
        let line = yaml.lines().find(|line| line.starts_with(key)).unwrap();
        let value = line.split(':').nth(1).unwrap();
        value.split('#').next().unwrap().trim().parse().unwrap()
    };
    let sensors = [
        ("accelerometer", 1, 1.0),
        // The columns of the gyroscope are in degrees.
        ("gyroscope", 4, std::f64::consts::PI / 180.0),
    ];
    let samples = 129_621 * 200;
    for (sensor, column, unit) in sensors {
        let (mut white, mut walk) = (0.0_f64, 0.0_f64);
        let (n, k) = (
            stated(&format!("{sensor}_noise")),
            stated(&format!("{sensor}_random")),
        );
        for axis in 0..3 {
            let points: Vec<(f64, f64)> = rows
                .iter()
                .map(|row| (row[0], row[column + axis] * unit))
                .collect();
            let lines =
                [lines::white(&points, 9.95), lines::walk(&points, 0.0)].map(Option::unwrap);
            white = white.max(lines[0]);
            walk = walk.max(lines[1]);

            let mut taken = Vec::new();
            let mut next = 0.0;
            for (tau_s, sigma) in points {
                if tau_s >= next {
                    let factor = (tau_s * 200.0).round() as usize;
                    let terms = (samples + 1 - 2 * factor) as u64;
                    taken.push(Point {
                        factor,
                        tau_s,
                        variance: sigma * sigma,
                        terms,
                    });
                    next = tau_s * 0.25_f64.exp2() - 0.05;
                }
            }
            let curve = Curve {
                period_s: 0.005,
                runs: vec![samples],
                points: taken,
            };
            let fit = fit(&curve, &FitConfig::default()).unwrap();
            println!(
                "{sensor} axis {axis}: lines N {:.4e} K {:.4e}; fit N {:?} B {:?} K {:?}, misfit {}",
                lines[0],
                lines[1],
                fit.value(Coefficient::White),
                fit.value(Coefficient::Instability),
                fit.value(Coefficient::Walk),
                fit.misfit
            );
        }
        println!(
            "{sensor}: worst axis by lines N {white:.5e} (file {n:.5e}), K {walk:.5e} (file {k:.5e})"
        );
        assert!((white / n - 1.0).abs() < 0.005 && (walk / k - 1.0).abs() < 0.005);
    }
}
