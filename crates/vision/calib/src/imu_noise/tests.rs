use super::*;
use crate::allan::Value;
use crate::allan::tests::Noise;

const RATE: f64 = 100.0;
/// N and K of gyroscope and accelerometer.
const TRUTH: [[f64; 2]; 2] = [[2e-4, 2e-5], [2e-3, 2e-4]];

/// A static IMU for `seconds`.
fn still(seconds: f64, seed: u64) -> Series {
    let n = (seconds * RATE) as usize;
    let axis = |i: usize| {
        let [white, walk] = TRUTH[i / 3];
        let mut axis = Noise::new(10 * seed + i as u64).rate(n, 1.0 / RATE, [white, 0.0, walk]);
        let bias = if i == 5 { 9.81 } else { 0.001 * i as f64 };
        axis.iter_mut().for_each(|v| *v += bias);
        axis
    };
    Series {
        nominal_rate_hz: RATE,
        times_s: (0..n).map(|i| 100.0 + i as f64 / RATE).collect(),
        axes: [0, 1, 2, 3, 4, 5].map(axis),
        temperature_c: vec![30.0; n],
        runs: std::iter::once(0..n).collect(),
        bridged: Vec::new(),
    }
}

fn kinds(found: &Measurement) -> Vec<&'static str> {
    let mut kinds: Vec<&str> = found.findings.iter().map(|r| r.kind).collect();
    kinds.sort_unstable();
    kinds.dedup();
    kinds
}

/// Degrades a good recording, and expects the result with exactly this kind of finding.
fn check(kind: &'static str, refused: bool, spoil: impl FnOnce(&mut Series)) -> Measurement {
    let mut series = still(400.0, 1);
    spoil(&mut series);
    let found = measure(&series, &Config::default());
    assert!(
        kinds(&found).contains(&kind),
        "{kind}: {:?}",
        found.findings
    );
    assert_eq!(found.is_rejected(), refused, "{kind}: {:?}", found.findings);
    found
}

fn text<'a>(found: &'a Measurement, kind: &str) -> &'a str {
    &found.findings.iter().find(|r| r.kind == kind).unwrap().text
}

/// Whether N of all axes that have a fit is right within four sigma or 3 %.
fn assert_right(found: &Measurement) {
    for axis in &found.axes {
        let Some(fit) = &axis.fit else { continue };
        let truth = TRUTH[axis.index / 3][0];
        let Value::Known { value, sigma, .. } = fit.value(Coefficient::White) else {
            panic!("{}: {:?}", AXES[axis.index], fit);
        };
        assert!(
            (value - truth).abs() < 4.0 * sigma + 0.03 * truth,
            "{}: {value:e} {sigma:e}",
            AXES[axis.index]
        );
    }
}

#[test]
fn good_recording_gives_ground_truth_without_findings() {
    let found = measure(&still(1500.0, 7), &Config::default());
    let fit_findings = || {
        found
            .findings
            .iter()
            .filter(|r| r.severity != Severity::Note)
    };
    assert_eq!(fit_findings().count(), 0, "{:?}", found.findings);
    assert_eq!(found.used_s.len(), 1);
    assert_right(&found);
    let noise = found.noise().unwrap();
    for (value, truth) in [
        (noise.gyro_noise_density, TRUTH[0][0]),
        (noise.gyro_random_walk, TRUTH[0][1]),
        (noise.accel_noise_density, TRUTH[1][0]),
        (noise.accel_random_walk, TRUTH[1][1]),
    ] {
        // The worst of three axes; a random walk is determined to some 10 % after 25 minutes.
        assert!(
            value > 0.9 * truth && value < 1.5 * truth,
            "{value:e} {truth:e}"
        );
    }
    let yaml = found.kalibr_yaml("/feet/imu", "synthetic");
    assert!(yaml.contains("\ngyroscope_random_walk: "), "{yaml}");
    assert!(yaml.contains("\nupdate_rate: 100.000\n"), "{yaml}");
    assert_eq!(
        yaml,
        measure(&still(1500.0, 7), &Config::default()).kalibr_yaml("/feet/imu", "synthetic")
    );
}

#[test]
fn motion_is_reported_and_excluded() {
    let found = check("moved", false, |series| {
        for i in 1200..4000 {
            let t = i as f64 / RATE;
            series.axes[1][i] += 0.3 * (5.0 * t).sin();
            series.axes[3][i] += 0.5 * (9.0 * t).sin();
        }
    });
    assert_eq!(
        text(&found, "moved"),
        "the IMU moved between 12.0 s and 40.0 s; left out"
    );
    assert_eq!(found.used_s.len(), 2);
    assert_right(&found);

    // Put down again: the tilt differs, which is detected even if the rate was not.
    let found = check("moved", false, |series| {
        series.axes[3][20_000..].iter_mut().for_each(|v| *v += 0.2);
    });
    assert_right(&found);
}

#[test]
fn moving_imu_is_rejected() {
    let found = check("moved", true, |series| {
        for i in 0..series.times_s.len() {
            let t = i as f64 / RATE;
            series.axes[0][i] += 0.4 * (6.0 * t).sin();
            series.axes[5][i] += 2.0 * (12.0 * t).sin();
        }
    });
    assert_eq!(found.noise(), None);
    let yaml = found.kalibr_yaml("/imu", "synthetic");
    assert!(!yaml.contains("\naccelerometer_noise_density:"), "{yaml}");
    check("short", true, |series| *series = still(50.0, 2));
    check("short", true, |series| *series = Series::default());
}

#[test]
fn bad_values_are_reported() {
    let found = check("frozen", false, |series| {
        let value = series.axes[2][5000];
        series.axes[2][5000..9000].fill(value);
    });
    let said = text(&found, "frozen");
    assert!(
        said.starts_with("gyro z is frozen between 50.0 s and 90.0 s"),
        "{said}"
    );
    assert_right(&found);

    let found = check("frozen", false, |series| series.axes[4].fill(0.0));
    assert_eq!(
        text(&found, "frozen"),
        "accel y never changes: it is always 0 m/s²"
    );
    assert_eq!(found.worst(1, Coefficient::White), Worst::Unavailable);
    assert!(matches!(
        found.worst(0, Coefficient::White),
        Worst::Known(_)
    ));

    let found = check("clipped", false, |series| {
        series.axes[5].iter_mut().for_each(|v| *v = v.min(9.82));
    });
    assert!(
        text(&found, "clipped").contains("accel z"),
        "{}",
        text(&found, "clipped")
    );
    check("coarse", false, |series| {
        series.axes[0]
            .iter_mut()
            .for_each(|v| *v = (*v / 0.01).round() * 0.01);
    });
    let found = check("outliers", false, |series| series.axes[0][7777] = 5.0);
    assert_right(&found);
    let found = check("not finite", false, |series| {
        series.axes[3][1234] = f64::NAN
    });
    assert_right(&found);
    let found = check("repeated", false, |series| {
        for axis in &mut series.axes {
            for i in (1..axis.len()).step_by(2) {
                axis[i] = axis[i - 1];
            }
        }
    });
    assert!(
        text(&found, "repeated").contains("50 Hz"),
        "{}",
        text(&found, "repeated")
    );
}

#[test]
fn bad_times_and_gaps_are_reported() {
    let found = check("rate", false, |series| series.nominal_rate_hz = 200.0);
    assert_right(&found);
    let found = check("jitter", false, |series| {
        for (i, t) in series.times_s.iter_mut().enumerate() {
            *t += 0.004 * ((i * 7 % 11) as f64 / 11.0 - 0.5);
        }
    });
    assert_right(&found);
    let found = check("gaps", false, |series| {
        series.runs = vec![0..15_000, 15_000..40_000]
    });
    assert!(
        text(&found, "gaps").contains("250 s"),
        "{}",
        text(&found, "gaps")
    );
    assert_eq!(found.used_s.len(), 2);
    assert_right(&found);
}

/// Takes samples out.
fn cut(series: &mut Series, gaps: &[std::ops::Range<usize>]) {
    let keep = |i: usize| !gaps.iter().any(|gap| gap.contains(&i));
    let kept: Vec<usize> = (0..series.times_s.len()).filter(|i| keep(*i)).collect();
    series.times_s = kept.iter().map(|&i| series.times_s[i]).collect();
    for axis in &mut series.axes {
        *axis = kept.iter().map(|&i| axis[i]).collect();
    }
    series.temperature_c.truncate(kept.len());
    let ends: Vec<usize> = (1..kept.len())
        .filter(|&i| kept[i] != kept[i - 1] + 1)
        .collect();
    let starts = std::iter::once(0).chain(ends.iter().copied());
    let stops = ends.iter().copied().chain([kept.len()]);
    series.runs = starts.zip(stops).map(|(a, b)| a..b).collect();
}

#[test]
fn short_gaps_are_filled_and_long_ones_are_not() {
    let mut series = still(400.0, 1);
    let whole = measure(&series, &Config::default());
    cut(&mut series, &[5000..5003, 12_000..12_001, 30_000..30_300]);
    assert_eq!(series.runs.len(), 4);
    let filled = series.bridged(&BridgingConfig::default());
    assert_eq!(filled.runs, [0..30_000, 30_000..39_700]);
    assert!(filled.times_s.windows(2).all(|w| w[1] > w[0]));
    let found = measure(&filled, &Config::default());
    assert_eq!(
        text(&found, "bridged"),
        "2 short gaps of 4 samples in all filled with the mean around"
    );
    assert!(kinds(&found).contains(&"gaps"));
    assert_right(&found);
    // Four samples of 40000 have no visible effect.
    let white = |found: &Measurement| found.axes[0].fit.as_ref().unwrap().deviation(0.1);
    assert!((white(&found) / white(&whole) - 1.0).abs() < 0.01);

    let mut many = still(400.0, 1);
    let gaps: Vec<_> = (1..100).map(|k| 400 * k..400 * k + 2).collect();
    cut(&mut many, &gaps);
    assert_eq!(many.clone().bridged(&BridgingConfig::default()), many);
}

#[test]
fn temperature_change_and_drift_are_reported() {
    check("temperature", false, |series| {
        for (i, t) in series.temperature_c.iter_mut().enumerate() {
            *t += i as f32 * 2e-4;
        }
    });
    let mut series = still(400.0, 3);
    for axis in [0, 1, 2] {
        let white = Noise::new(77 + axis as u64).rate(40_000, 1.0 / RATE, [2e-4, 0.0, 0.0]);
        series.axes[axis] = white;
    }
    for (i, value) in series.axes[0].iter_mut().enumerate() {
        *value += 2e-6 * i as f64 / RATE;
    }
    let found = measure(&series, &Config::default());
    let said = text(&found, "drift");
    assert!(said.starts_with("gyro x: the halves"), "{said}");
    assert!(
        found.findings.iter().all(|r| !r.text.starts_with("gyro y")),
        "{:?}",
        found.findings
    );
}
