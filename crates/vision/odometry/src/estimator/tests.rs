//! Keyframes at rest, and behavior with few IMU samples. The scene is a wall of gray noise, 2 m
//! away.

use imaging::ImageView;

use super::*;
use crate::config::Preset;
use crate::input::View;
use crate::rig::StereoCamera;
use crate::test_rig::{self, SIZE_PX};

/// Disparity of the wall, px.
const DISPARITY: usize = 4;

fn rig(has_imu: bool) -> Rig {
    Rig {
        cameras: vec![test_rig::stereo(0.08)],
        imus: has_imu.then(test_rig::imu).into_iter().collect(),
    }
}

/// Random gray patches, shifted to the left by `shift` px, with sensor noise that is independent
/// for each image.
fn image(shift: usize, noise: u64) -> Vec<u8> {
    let hash = |a: u64| (a.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as u8;
    let [width, height] = SIZE_PX;
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    pixels
        .map(|(x, y)| {
            let patch = hash(((x + shift) / 5 * 1009 + y / 5) as u64);
            let own = hash(noise.wrapping_mul(7919) + (y * width + x) as u64) % 3;
            40 + patch / 2 + own
        })
        .collect()
}

fn view(pixels: &[u8]) -> ImageView<'_> {
    let [width, height] = SIZE_PX;
    ImageView::new(width, height, width, pixels).expect("a complete image")
}

/// Tracks a wall at rest.
fn at_rest(odometry: &mut Odometry, from: u64, to: u64) -> Vec<Estimate> {
    facing(odometry, |gray| gray, from, to)
}

/// The same with other gray levels.
fn facing(odometry: &mut Odometry, gray: fn(u8) -> u8, from: u64, to: u64) -> Vec<Estimate> {
    let sets = (from..to).map(|k| {
        let pixels = |shift: usize| image(shift, 2 * k + shift as u64).into_iter().map(gray);
        let [left, right] = [0, DISPARITY].map(|shift| pixels(shift).collect::<Vec<u8>>());
        let time_ns = k as i64 * 66_666_667;
        odometry.add_frames(&FrameSet {
            time_ns,
            views: vec![Some(View {
                time_ns,
                left: view(&left),
                right: view(&right),
                mask: None,
            })],
        })
    });
    sets.collect()
}

#[test]
fn keyframes_at_rest_are_finished_every_ten_seconds() {
    let mut odometry = Odometry::new(&rig(false), Config::preset(Preset::Balanced));
    let estimates = at_rest(&mut odometry, 0, 600);
    let last = estimates[estimates.len() - 1];
    assert_eq!(last.status, Status::Tracked);
    let distance = last.world_from_rig.translation().norm();
    assert!(distance < 1e-2, "{distance}");
    // Forty seconds: the keyframes of the window, and one every ten seconds.
    let keyframes = odometry.take_keyframes(true);
    let times: Vec<i64> = keyframes.iter().map(|k| k.state.time_ns).collect();
    let gaps = times.windows(2).map(|w| (w[1] - w[0]) as f64 * 1e-9);
    let long: Vec<f64> = gaps.filter(|gap| *gap > 1.0).collect();
    assert!((3..=4).contains(&long.len()), "{long:?}");
    assert!(
        long[..3].iter().all(|gap| (10.0..11.0).contains(gap)),
        "{long:?}"
    );
    assert!(times.len() <= 8 + long.len(), "{}", times.len());
}

#[test]
fn single_imu_sample_does_not_initialize_at_rest() {
    let sample = ImuSample {
        time_ns: 590_000_000,
        gyro: [0.0, 0.0, 0.05],
        accel: [1.0, -9.5, 1.0],
    };
    let first = |number: u64| {
        let mut odometry = Odometry::new(&rig(true), Config::preset(Preset::Balanced));
        odometry.add_imu(0, &sample);
        at_rest(&mut odometry, number, number + 1)[0]
    };
    let tilt = |of: &Estimate| of.covariance[(3, 3)].max(of.covariance[(5, 5)]).sqrt();
    // A single recent sample gives the vertical roughly; an old one gives nothing.
    let (near, late) = (first(9), first(12));
    assert_eq!(near.gyro_bias, Vector3::zeros());
    assert!((0.3..1.0).contains(&tilt(&near)), "{}", tilt(&near));
    assert!(tilt(&late) > 2.0, "{}", tilt(&late));
}

#[test]
fn rate_is_dropped_when_the_imu_falls_silent() {
    let mut odometry = Odometry::new(&rig(true), Config::preset(Preset::Balanced));
    for k in 0..60 {
        let is_last = k == 59;
        odometry.add_imu(
            0,
            &ImuSample {
                time_ns: k * 10_000_000,
                // One sample with a large rate, then silence.
                gyro: [0.0, 0.0, if is_last { 2.0 } else { 1e-5 * k as f64 }],
                accel: [0.0, -9.80665, 1e-4 * k as f64],
            },
        );
    }
    at_rest(&mut odometry, 9, 14);
    let rate = odometry.rate().norm();
    assert!(rate < 0.05, "{rate}");
}

#[test]
fn uncertainty_of_a_loss_without_imu_remains() {
    let mut odometry = Odometry::new(&rig(false), Config::preset(Preset::Balanced));
    // The rotation of the right eye about x, which every match determines.
    let row_variance = |odometry: &Odometry| odometry.keyframe_covariance.stereo()[(0, 0)];
    at_rest(&mut odometry, 0, 1);
    let prior = row_variance(&odometry);
    at_rest(&mut odometry, 1, 20);
    let before = row_variance(&odometry);
    assert!(before < 0.25 * prior, "{before} {prior}");
    // The negative of the wall: no patch of it resembles those before.
    let mut after = facing(&mut odometry, |gray| 255 - gray, 20, 22);
    assert_eq!(after[0].status, Status::Lost);
    // The new window knows the calibrations as the last one did.
    let kept = row_variance(&odometry);
    assert!(kept < 1.05 * before, "{kept} {before}");
    after.extend(facing(&mut odometry, |gray| 255 - gray, 22, 60));
    let sigma = |of: &Estimate| of.covariance[(5, 5)].sqrt();
    assert!(sigma(&after[0]) > 0.3, "{}", sigma(&after[0]));
    for (k, estimate) in after.iter().enumerate().skip(1) {
        assert_eq!(estimate.status, Status::Tracked, "{k}");
        assert!(sigma(estimate) > 0.95 * sigma(&after[0]), "{k}");
    }
}

/// Inliers are required of the cameras that gave images.
#[test]
fn absent_camera_does_not_widen_sigmas() {
    let mut pair = rig(false);
    pair.cameras.push(StereoCamera {
        name: "absent".to_owned(),
        ..test_rig::stereo(0.08)
    });
    let sigma = |rig: &Rig| {
        let mut config = Config::preset(Preset::Balanced);
        // Enough inliers for one camera, too few for two.
        config.frontend.max_features = config.estimator.independent_inliers + 8;
        let mut odometry = Odometry::new(rig, config);
        let mut last = None;
        for k in 0..20 {
            let [left, right] = [0, DISPARITY].map(|shift| image(shift, 2 * k + shift as u64));
            let time_ns = k as i64 * 66_666_667;
            let mut views = vec![None; rig.cameras.len()];
            views[0] = Some(View {
                time_ns,
                left: view(&left),
                right: view(&right),
                mask: None,
            });
            last = Some(odometry.add_frames(&FrameSet { time_ns, views }));
        }
        last.expect("estimates").relative_covariance[(0, 0)].sqrt()
    };
    let [alone, with_absent] = [rig(false), pair].map(|rig| sigma(&rig));
    assert!(
        (0.8..1.2).contains(&(with_absent / alone)),
        "{alone} m, {with_absent} m"
    );
}
