//! Saturation, gaps and preintegration of samples of known motions.

use super::*;

const NOISE: ImuNoise = ImuNoise {
    gyro_noise_density: 1e-3,
    gyro_random_walk: 1e-5,
    accel_noise_density: 1e-2,
    accel_random_walk: 1e-4,
};

fn readings(rate_hz: f64, seconds: f64) -> Vec<Reading> {
    (0..=(seconds * rate_hz) as i64)
        .map(|k| {
            let t = k as f64 / rate_hz;
            Reading {
                time_ns: (t * 1e9).round() as i64,
                gyro: Vector3::new((3.0 * t).sin(), 1.4 * (4.0 * t).cos(), (2.0 * t).sin()),
                accel: Vector3::new(3.0 * (5.0 * t).cos(), 1.0 + t, 9.0 + (6.0 * t).sin()),
                saturated: [false; 2],
            }
        })
        .collect()
}

fn nine(a: &Preintegration, b: &Preintegration) -> Nine {
    let mut out = Nine::zeros();
    out.fixed_rows_mut::<3>(0)
        .copy_from(&so3::log(&(a.rotation.inverse() * b.rotation)));
    out.fixed_rows_mut::<3>(3)
        .copy_from(&(b.velocity - a.velocity));
    out.fixed_rows_mut::<3>(6)
        .copy_from(&(b.displacement - a.displacement));
    out
}

#[test]
fn constant_samples_of_a_moving_axis_are_saturated() {
    let range = [10.0, 80.0];
    let clip = |limit: f64| {
        let mut samples = ImuBuffer::new(&InertialConfig::default(), 400.0);
        let mut saturated = Vec::new();
        for k in 0..400_i64 {
            let t = k as f64 / 400.0;
            let gyro = [(2.0 * (9.0 * t).sin()).clamp(-limit, limit), 0.1, 0.0];
            // Gravity with noise in the last digit.
            let sample = ImuSample {
                time_ns: k,
                gyro: [gyro[0], gyro[1] + 1e-3 * (k % 3) as f64, gyro[2]],
                accel: [0.0, 0.0, 9.8 + 0.002 * (k % 7 / 3) as f64],
            };
            samples.push(&sample, range);
        }
        saturated.extend(samples.readings.iter().map(|r| r.saturated[GYROSCOPE]));
        assert!(samples.readings.iter().all(|r| !r.saturated[ACCELEROMETER]));
        let beyond = |r: &Reading| (2.0 * (9.0 * r.time_ns as f64 / 400.0).sin()).abs() > limit;
        let all = samples.readings.iter().filter(|r| beyond(r)).count();
        (all, saturated.iter().filter(|c| **c).count())
    };
    let (all, found) = clip(1.0);
    assert!(all > 200 && found.abs_diff(all) < 8, "{found} of {all}");
    // At rest samples repeat.
    assert_eq!(clip(5.0), (0, 0));
}

#[test]
fn gravity_beyond_the_range_is_saturated() {
    let saturated = |limit: f64| {
        let mut samples = ImuBuffer::new(&InertialConfig::default(), 100.0);
        for k in 0..200_i64 {
            // Gravity with noise, with a tilted axis.
            let noise = 0.02 * ((k * k % 17) as f64 / 8.0 - 1.0);
            let accel = [1.8 + noise, 0.2 - noise, 9.6 + noise];
            samples.push(
                &ImuSample {
                    time_ns: k,
                    gyro: [0.0; 3],
                    accel: accel.map(|a| a.clamp(-limit, limit)),
                },
                [10.0, 80.0],
            );
        }
        samples
            .readings
            .iter()
            .filter(|r| r.saturated == [false, true])
            .count()
    };
    assert_eq!(saturated(80.0), 0);
    assert!(saturated(1.5) >= 199, "{}", saturated(1.5));
}

#[test]
fn bias_jacobians_equal_finite_differences() {
    let readings = readings(400.0, 0.2);
    let (bg, ba) = (
        Vector3::new(0.01, -0.02, 0.03),
        Vector3::new(0.1, 0.2, -0.1),
    );
    let here = Preintegration::new(&readings, &bg, &ba, &NOISE, &InertialConfig::default());
    for k in 0..6 {
        let h = 1e-5;
        let mut d = SMatrix::<f64, 6, 1>::zeros();
        d[k] = h;
        let (dg, da) = (
            d.fixed_rows::<3>(0).into_owned(),
            d.fixed_rows::<3>(3).into_owned(),
        );
        let there = Preintegration::new(
            &readings,
            &(bg + dg),
            &(ba + da),
            &NOISE,
            &InertialConfig::default(),
        );
        let by = nine(&here, &there) / h;
        // The mean of the rotated force at both ends approximates a 2 : 1 weighting in the
        // displacement.
        assert!((by - here.by_bias.column(k)).amax() < 2e-4, "{k}");
        let (rotation, velocity, displacement) =
            here.corrected(&(bg + dg), &(ba + da), &Vector3::zeros());
        assert!(rotation.angle_to(&there.rotation) < 1e-9);
        assert!((velocity - there.velocity).norm() < 1e-8);
        assert!((displacement - there.displacement).norm() < 1e-8);
    }
}

/// The motion of [`readings`] at a point of the body: its own specific force.
fn at_arm(readings: &[Reading], arm: &Vector3<f64>) -> Vec<Reading> {
    let rate = |t: f64| Vector3::new((3.0 * t).sin(), 1.4 * (4.0 * t).cos(), (2.0 * t).sin());
    readings
        .iter()
        .map(|r| {
            let t = r.time_ns as f64 * 1e-9;
            let acceleration = (rate(t + 1e-5) - rate(t - 1e-5)) / 2e-5;
            let centripetal = r.gyro.cross(&r.gyro.cross(arm));
            Reading {
                accel: r.accel + acceleration.cross(arm) + centripetal,
                ..*r
            }
        })
        .collect()
}

#[test]
fn lever_arm_gives_the_motion_of_the_body_origin() {
    let (body, arm) = (readings(2000.0, 0.2), Vector3::new(0.3, -0.2, 0.1));
    let elsewhere = at_arm(&body, &arm);
    let config = InertialConfig::default();
    let zero = Vector3::zeros();
    let moved = |gyro_bias: &Vector3<f64>, accel_bias: &Vector3<f64>| {
        let motion = Preintegration::new(&elsewhere, gyro_bias, accel_bias, &NOISE, &config);
        motion.at_body_origin(&LeverArm {
            arm,
            rates: [&body[0], &body[body.len() - 1]].map(|end| end.gyro - gyro_bias),
            rate_sigma: 0.01,
            scale_error: 0.0,
        })
    };
    let truth = Preintegration::new(&body, &zero, &zero, &NOISE, &config);
    let found = moved(&zero, &zero);
    assert!(
        nine(&truth, &found).amax() < 1e-5,
        "{}",
        nine(&truth, &found)
    );
    // Without it the difference is that of a point on the plate.
    let without = Preintegration::new(&elsewhere, &zero, &zero, &NOISE, &config);
    assert!(nine(&truth, &without).amax() > 0.05);
    // The noise of the rates at both ends moves the arm.
    let sigma = (found.covariance[(3, 3)] - without.covariance[(3, 3)]).sqrt();
    assert!((0.002..0.005).contains(&sigma), "{sigma}");
    for k in 0..6 {
        let h = 1e-5;
        let mut d = SMatrix::<f64, 6, 1>::zeros();
        d[k] = h;
        let there = moved(
            &d.fixed_rows::<3>(0).into_owned(),
            &d.fixed_rows::<3>(3).into_owned(),
        );
        let by = nine(&found, &there) / h;
        assert!((by - found.by_bias.column(k)).amax() < 2e-4, "{k}");
    }
}

#[test]
fn sensors_are_saturated_apart() {
    for (clipped, expected) in [
        ([false, true], Coverage::GyroscopeOnly),
        ([true, false], Coverage::AccelerometerOnly),
        ([true, true], Coverage::Gap),
    ] {
        let mut samples = ImuBuffer::new(&InertialConfig::default(), 100.0);
        for k in 0..50 {
            let is_peak = (20..24).contains(&k);
            let of = |sensor: usize, range: f64| match is_peak && clipped[sensor] {
                true => range,
                false => 1e-3 * k as f64,
            };
            let sample = ImuSample {
                time_ns: k * 10_000_000,
                gyro: [of(0, 10.0), 0.0, 0.0],
                // No sensor gives the same value for long.
                accel: [0.0, of(1, 80.0), 9.8 + 1e-3 * (k % 7) as f64],
            };
            samples.push(&sample, [10.0, 80.0]);
        }
        let mut out = Vec::new();
        let coverage = |from, to, out: &mut Vec<_>| samples.between(from, to, out);
        assert_eq!(coverage(150_000_000, 250_000_000, &mut out), expected);
        assert_eq!(coverage(0, 150_000_000, &mut out), Coverage::Complete);
    }
}

#[test]
fn preintegration_converges_with_the_sample_rate() {
    let zero = Vector3::zeros();
    let fine = Preintegration::new(
        &readings(20_000.0, 0.2),
        &zero,
        &zero,
        &NOISE,
        &InertialConfig::default(),
    );
    for (rate_hz, limit) in [(200.0, 2e-4), (800.0, 2e-5)] {
        let coarse = Preintegration::new(
            &readings(rate_hz, 0.2),
            &zero,
            &zero,
            &NOISE,
            &InertialConfig::default(),
        );
        let systematic_error = nine(&fine, &coarse).amax();
        assert!(systematic_error < limit, "{rate_hz}: {systematic_error}");
    }
}

#[test]
fn sample_that_is_not_finite_is_dropped() {
    let mut samples = ImuBuffer::new(&InertialConfig::default(), 100.0);
    for k in 0..20 {
        let mut sample = ImuSample {
            time_ns: k * 10_000_000,
            gyro: [0.01 * k as f64, 0.0, 0.0],
            accel: [0.0, 0.0, 9.8 + 1e-3 * k as f64],
        };
        match k {
            5 => sample.gyro[1] = f64::NAN,
            9 => sample.accel[2] = f64::INFINITY,
            _ => {}
        }
        samples.push(&sample, [f64::INFINITY; 2]);
    }
    let mut out = Vec::new();
    assert_eq!(
        samples.between(0, 190_000_000, &mut out),
        Coverage::Complete
    );
    assert_eq!(out.len(), 18);
    assert!(out.iter().all(|r| r.gyro.y == 0.0 && r.accel.z < 9.9));
}

#[test]
fn gap_and_end_of_samples_are_reported() {
    let mut samples = ImuBuffer::new(&InertialConfig::default(), 100.0);
    for k in (0..50).chain(80..100) {
        let sample = ImuSample {
            time_ns: k * 10_000_000,
            gyro: [k as f64, 0.0, 0.0],
            accel: [0.0; 3],
        };
        samples.push(&sample, [f64::INFINITY; 2]);
    }
    let mut out = Vec::new();
    assert_eq!(
        samples.between(105_000_000, 305_000_000, &mut out),
        Coverage::Complete
    );
    assert_eq!(out.len(), 22);
    assert!((out[0].gyro.x - 10.5).abs() < 1e-9 && (out[21].gyro.x - 30.5).abs() < 1e-9);
    assert_eq!(
        samples.between(400_000_000, 850_000_000, &mut out),
        Coverage::Gap
    );
    assert_eq!(
        samples.between(900_000_000, 1_200_000_000, &mut out),
        Coverage::Gap
    );
}
