//! One test for every kind of fault: its effect, and none at strength 0.

use std::sync::LazyLock;

use cad_transforms::rig::Rig;
use nalgebra::Vector3;

use super::*;
use crate::camera::Quality;
use crate::camera::sensor::Exposure;
use crate::faults::{Fault, Faults};
use crate::scene::{Kind as Place, Lighting};
use crate::simulation::Settings;

const FEET: &str = "feet";
const LEFT: &str = "left_shoulder";
const RATE_HZ: f64 = 20.0;
const FRAMES: u64 = 80;

static WALK: LazyLock<Arc<Simulation>> = LazyLock::new(|| {
    let settings = Settings {
        kind: Place::Pavement,
        lighting: Lighting::Day,
        seed: 3,
        seconds: FRAMES as f64 / RATE_HZ,
        rate_hz: RATE_HZ,
        width: 48,
        height: 28,
        quality: Quality::FAST,
    };
    let rig = Rig::parse(include_str!(
        "../../../../../cad-transforms/rigs/example.toml"
    ))
    .unwrap();
    Arc::new(Simulation::new(&settings, &rig).unwrap())
});

/// Images without rendering cost that differ in every pixel from the previous ones.
struct Counter;

impl FrameSource for Counter {
    fn render_frame(&mut self, number: u64, time_ns: i64) -> StereoFrame {
        StereoFrame {
            number,
            time_ns,
            exposure: Exposure {
                seconds: 1e-3,
                gain: 1.0,
            },
            width: 8,
            height: 4,
            i420: vec![number as u8; 48],
        }
    }
}

fn fault(kind: Kind, strength: f64, from_s: f64, to_s: f64) -> Fault {
    Fault {
        kind,
        strength,
        from_s,
        to_s,
        camera: None,
        foot: None,
    }
}

fn camera(name: &str) -> usize {
    let cameras = WALK.cameras();
    cameras.iter().position(|c| c.name == name).unwrap()
}

/// All deliveries and losses of a device with these faults.
fn run(name: &str, list: Vec<Fault>, rendered: bool) -> (Vec<Delivery>, Vec<Loss>) {
    let faults = Faults { list, seed: 1 }.of(name);
    let mut device = match rendered {
        true => Device::rendered(&WALK, camera(name), faults),
        false => Device::new(&WALK, camera(name), faults, Box::new(Counter)),
    };
    let delivered = std::iter::from_fn(|| device.deliver()).collect();
    (delivered, device.losses().to_vec())
}

fn counted(list: Vec<Fault>) -> (Vec<Delivery>, Vec<Loss>) {
    run(FEET, list, false)
}

fn frames(delivered: &[Delivery]) -> Vec<&DeviceFrame> {
    fn frame(delivery: &Delivery) -> Option<&DeviceFrame> {
        match delivery {
            Delivery::Frame(frame) => Some(frame),
            _ => None,
        }
    }
    delivered.iter().filter_map(frame).collect()
}

fn samples(delivered: &[Delivery]) -> Vec<DeviceImu> {
    let sample = |d: &Delivery| match d {
        Delivery::Imu(sample) => Some(*sample),
        _ => None,
    };
    delivered.iter().filter_map(sample).collect()
}

fn arrivals(delivered: &[Delivery]) -> Vec<i64> {
    let arrival = |d: &Delivery| match d {
        Delivery::Frame(f) => f.arrival_ns,
        Delivery::Imu(s) => s.arrival_ns,
        Delivery::Disconnected(at) => *at,
    };
    delivered.iter().map(arrival).collect()
}

/// Length of a tick of the IMU, ns.
const TICK_NS: f64 = 39_062.5;

#[test]
fn without_faults_all_deliveries_arrive_in_order() {
    let (delivered, losses) = counted(Vec::new());
    assert_eq!(losses, []);
    assert!(arrivals(&delivered).is_sorted());
    let (frames, samples) = (frames(&delivered), samples(&delivered));
    let numbers: Vec<u64> = frames.iter().map(|f| f.number).collect();
    assert_eq!(numbers, (0..FRAMES).collect::<Vec<_>>());
    for frame in &frames {
        assert_eq!(frame.taken_ns, WALK.settings().frame_ns(frame.index));
        assert!((0..2_000_001).contains(&(frame.arrival_ns - frame.taken_ns)));
    }
    // 400 Hz for 4 s, with an oscillator rate error of some ppm.
    assert!((1600..=1601).contains(&samples.len()), "{}", samples.len());
    for (n, sample) in samples.iter().enumerate() {
        assert_eq!(sample.number, n as u64);
    }
    let (first, last) = (samples[0], samples[1600 - 1]);
    let shown = (last.ticks - first.ticks) as f64 * TICK_NS;
    let rate_error_ppm = (shown / (last.taken_ns - first.taken_ns) as f64 - 1.0) * 1e6;
    assert!(rate_error_ppm.abs() < 100.0, "{rate_error_ppm}");
    // Every frame is reported once, by the first sample after it.
    assert_eq!(last.frame_sync_count, FRAMES as u32);
    let told = samples.iter().filter(|s| s.frame_sync);
    for (sample, frame) in told.zip(&frames) {
        let after = sample.taken_ns - frame.taken_ns;
        assert!((0..2_600_000).contains(&after), "{after}");
    }
}

#[test]
fn faults_of_strength_0_have_no_effect() {
    let all = Kind::ALL.map(|kind| fault(kind, 0.0, 0.0, 9.0)).to_vec();
    for name in [FEET, LEFT] {
        assert_eq!(run(name, all.clone(), true), run(name, Vec::new(), true));
    }
}

#[test]
fn fault_of_another_camera_has_no_effect() {
    let mut of_left = fault(Kind::Dropped, 1.0, 0.0, 9.0);
    of_left.camera = Some(LEFT.to_owned());
    assert_eq!(counted(vec![of_left]), counted(Vec::new()));
}

#[test]
fn dropped_frames_leave_gaps_in_the_numbers() {
    let (delivered, losses) = counted(vec![fault(Kind::Dropped, 0.5, 1.0, 3.0)]);
    let lost: Vec<u64> = losses.iter().map(|l| l.index).collect();
    assert!((10..30).contains(&lost.len()), "{lost:?}");
    assert!(
        losses
            .iter()
            .all(|l| l.cause == Kind::Dropped && l.stream == Stream::Frames)
    );
    assert!(lost.iter().all(|n| (20..60).contains(n)));
    let arrived = frames(&delivered).into_iter().map(|f| f.number);
    let mut all: Vec<u64> = arrived.chain(lost).collect();
    all.sort_unstable();
    assert_eq!(all, (0..FRAMES).collect::<Vec<_>>());
}

#[test]
fn late_frames_delay_the_following_frames() {
    let (delivered, losses) = counted(vec![fault(Kind::Late, 0.2, 0.0, 9.0)]);
    assert_eq!(losses, []);
    assert!(arrivals(&delivered).is_sorted());
    let delay = |f: &&DeviceFrame| f.arrival_ns - f.taken_ns;
    let delays: Vec<i64> = frames(&delivered).iter().map(delay).collect();
    let late = delays.iter().filter(|d| **d >= 200_000_000).count();
    assert!((2..20).contains(&late), "{late}");
    let held_up = |d: &&i64| (10_000_000..200_000_000).contains(*d);
    assert!(delays.iter().filter(held_up).count() >= late);
}

#[test]
fn duplicated_frames_are_delivered_twice() {
    let (delivered, losses) = counted(vec![fault(Kind::Duplicated, 0.5, 0.0, 9.0)]);
    assert_eq!(losses, []);
    let frames = frames(&delivered);
    let twice = frames.windows(2).filter(|w| w[0] == w[1]).count();
    assert!((25..55).contains(&twice), "{twice}");
    assert_eq!(frames.len(), FRAMES as usize + twice);
}

#[test]
fn frozen_frames_repeat_the_previous_image() {
    let (delivered, _) = counted(vec![fault(Kind::Frozen, 1.0, 1.0, 2.0)]);
    for frame in frames(&delivered) {
        let shown = match frame.index {
            20..40 => 19,
            n => n as u8,
        };
        assert_eq!(frame.image.i420, vec![shown; 48], "{}", frame.index);
        assert_eq!(frame.number, frame.index);
    }
}

#[test]
fn torn_frames_end_with_the_previous_image() {
    let (delivered, _) = counted(vec![fault(Kind::Torn, 1.0, 0.0, 9.0)]);
    let mut torn = 0;
    let frames = frames(&delivered);
    for pair in frames.windows(2) {
        let (before, now) = (&pair[0].image.i420, &pair[1].image.i420);
        let new = pair[1].index as u8;
        let old = now[..32].iter().filter(|v| **v != new).count();
        torn += usize::from(old > 0);
        // Whole rows at the end.
        assert!(now[..32 - old].iter().all(|v| *v == new));
        assert_eq!(now[32 - old..32], before[32 - old..32]);
    }
    assert!(torn > 20, "{torn}");
}

#[test]
fn latency_bursts_delay_both_streams() {
    let (delivered, losses) = counted(vec![fault(Kind::LatencyBurst, 0.05, 1.0, 2.0)]);
    assert_eq!(losses, []);
    assert!(arrivals(&delivered).is_sorted());
    let mean = |delays: Vec<i64>| delays.iter().sum::<i64>() as f64 / delays.len() as f64;
    let during = |taken: i64| (1_000_000_000..2_000_000_000).contains(&taken);
    let samples = samples(&delivered);
    let of = |wanted: bool| {
        let chosen = samples.iter().filter(|s| during(s.taken_ns) == wanted);
        mean(chosen.map(|s| s.arrival_ns - s.taken_ns).collect())
    };
    assert!(of(true) > 50e6, "{}", of(true));
    let frames = frames(&delivered);
    let chosen = frames.iter().filter(|f| during(f.taken_ns));
    assert!(mean(chosen.map(|f| f.arrival_ns - f.taken_ns).collect()) > 25e6);
}

/// Differences between the clocks of a device with and without a fault, ns, frames and samples.
fn shifts(list: Vec<Fault>) -> (Vec<f64>, Vec<f64>) {
    let (with, without) = (counted(list).0, counted(Vec::new()).0);
    let of_frames = frames(&with).into_iter().zip(frames(&without));
    let of_samples = samples(&with).into_iter().zip(samples(&without));
    (
        of_frames
            .map(|(a, b)| (a.ticks - b.ticks) as f64 * 1e3)
            .collect(),
        of_samples
            .map(|(a, b)| (a.ticks - b.ticks) as f64 * TICK_NS)
            .collect(),
    )
}

#[test]
fn clock_step_changes_both_clocks() {
    let (of_frames, of_samples) = shifts(vec![fault(Kind::ClockStep, -0.5, 2.0, f64::INFINITY)]);
    for (n, shift) in of_frames.iter().enumerate() {
        let expected = if n < 40 { 0.0 } else { -0.5e9 };
        assert!((shift - expected).abs() < 2e3, "{n}: {shift}");
    }
    assert!(of_samples[700].abs() < 4e4 && (of_samples[900] + 0.5e9).abs() < 8e4);
}

#[test]
fn clock_drift_changes_both_clocks() {
    let (of_frames, of_samples) = shifts(vec![fault(Kind::ClockDrift, 500.0, 1.0, 3.0)]);
    // 500 µs per second, from 1 s to 3 s.
    for (n, expected) in [(10, 0.0), (40, 512.5e3), (79, 1e6)] {
        assert!(
            (of_frames[n] - expected).abs() < 2e3,
            "{n}: {}",
            of_frames[n]
        );
    }
    assert!((of_samples[1599] - 1e6).abs() < 8e4);
}

#[test]
fn counters_of_32_bits_wrap() {
    let (delivered, _) = counted(vec![fault(Kind::TickWrap, 1.0, 2.0, f64::INFINITY)]);
    let frames = frames(&delivered);
    let all = frames.iter().map(|f| f.ticks);
    assert!(all.clone().all(|t| (0..1 << 32).contains(&t)));
    let falls: Vec<usize> = (1..frames.len())
        .filter(|&i| frames[i].ticks < frames[i - 1].ticks)
        .collect();
    assert_eq!(falls, [40]);
    let samples = samples(&delivered);
    let fall = (1..samples.len())
        .find(|&i| samples[i].ticks < samples[i - 1].ticks)
        .unwrap();
    assert!((798..803).contains(&fall), "{fall}");
    let faults = Faults {
        list: vec![fault(Kind::TickWrap, 1.0, 2.0, 9.0)],
        seed: 1,
    }
    .of(FEET);
    let device = Device::new(&WALK, camera(FEET), faults, Box::new(Counter));
    assert_eq!(device.clocks()[0].tick_bits(), Some(32));
}

#[test]
fn device_counters_restart_after_a_disconnect() {
    let (delivered, losses) = counted(vec![
        fault(Kind::Disconnect, 0.5, 1.0, f64::INFINITY),
        fault(Kind::Disconnect, 0.7, 1.2, f64::INFINITY),
    ]);
    assert!(arrivals(&delivered).is_sorted());
    let disconnected: Vec<&Delivery> = delivered
        .iter()
        .filter(|d| matches!(d, Delivery::Disconnected(_)))
        .collect();
    assert_eq!(disconnected, [&Delivery::Disconnected(1_000_000_000)]);
    assert!(losses.iter().all(|l| l.cause == Kind::Disconnect));
    let of = |stream| losses.iter().filter(|l| l.stream == stream).count();
    // 0.9 s of 20 and of 400 Hz.
    assert!(
        (18..=19).contains(&of(Stream::Frames)),
        "{}",
        of(Stream::Frames)
    );
    assert!(
        (359..=362).contains(&of(Stream::Imu)),
        "{}",
        of(Stream::Imu)
    );
    let back = frames(&delivered)
        .into_iter()
        .find(|f| f.taken_ns > 1_900_000_000)
        .unwrap();
    assert_eq!((back.number, back.index), (0, 38));
    // One second after reconnecting.
    assert!(
        (1_000_000..1_100_000).contains(&back.ticks),
        "{}",
        back.ticks
    );
    let back = samples(&delivered)
        .into_iter()
        .find(|s| s.taken_ns > 1_900_000_000)
        .unwrap();
    assert_eq!((back.number, back.frame_sync_count), (0, 0));
}

#[test]
fn imu_gap_loses_samples() {
    let (delivered, losses) = counted(vec![fault(Kind::ImuGap, 0.25, 1.0, f64::INFINITY)]);
    assert_eq!(frames(&delivered).len(), FRAMES as usize);
    let numbers: Vec<u64> = samples(&delivered).iter().map(|s| s.number).collect();
    let hole = numbers.windows(2).find(|w| w[1] != w[0] + 1).unwrap();
    assert!((99..=101).contains(&(hole[1] - hole[0] - 1)), "{hole:?}");
    assert_eq!(losses.len() as u64, hole[1] - hole[0] - 1);
    assert!(
        losses
            .iter()
            .all(|l| l.cause == Kind::ImuGap && l.stream == Stream::Imu)
    );
}

#[test]
fn imu_clipping_saturates_at_the_reduced_range() {
    let whole = samples(&counted(Vec::new()).0);
    let clipped = samples(&counted(vec![fault(Kind::ImuClipping, 0.9, 0.0, 9.0)]).0);
    // A tenth of 32768.
    let limit = 3277;
    let mut cut = 0;
    for (a, b) in whole.iter().zip(&clipped) {
        for k in 0..3 {
            let expected = a.accel[k].clamp(-limit, limit);
            assert!((expected - b.accel[k]).abs() <= 1, "{a:?} {b:?}");
            cut += i32::from(a.accel[k].abs() > limit);
        }
    }
    // A tenth of 8 g remains, less than gravity.
    assert!(cut > 500, "{cut}");
}

/// Mean luma of the left eye of each frame.
fn means(delivered: &[Delivery]) -> Vec<f64> {
    let mean = |f: &DeviceFrame| {
        let gray = f.image.gray(0);
        gray.iter().map(|v| f64::from(*v)).sum::<f64>() / gray.len() as f64
    };
    frames(delivered).into_iter().map(mean).collect()
}

/// Frames of a shoulder camera without and with a fault from 1 s to 2 s.
fn seen(kind: Kind, strength: f64) -> [Vec<Delivery>; 2] {
    let list = vec![fault(kind, strength, 1.0, 2.0)];
    let both = [run(LEFT, Vec::new(), true).0, run(LEFT, list, true).0];
    // Before the fault begins nothing differs.
    let (fine, with) = (frames(&both[0]), frames(&both[1]));
    assert_eq!(fine[..20], with[..20]);
    assert_ne!(fine[20].image, with[20].image);
    both
}

#[test]
fn darkness_dims_images_and_the_exposure_adapts() {
    let [fine, dark] = seen(Kind::Darkness, 4.0);
    let (light, less) = (means(&fine), means(&dark));
    assert!(less[20] < 0.4 * light[20], "{} {}", less[20], light[20]);
    assert!(less[39] > 1.5 * less[20], "{} {}", less[39], less[20]);
    let product = |d: &[Delivery], n: usize| {
        let exposure = frames(d)[n].image.exposure;
        exposure.seconds * exposure.gain
    };
    assert!(product(&dark, 39) > 4.0 * product(&fine, 39));
    // After the fault the exposure has to recover.
    assert!(less[40] > light[40]);
}

#[test]
fn flash_brightens_images() {
    let [fine, flash] = seen(Kind::Flash, 8.0);
    assert!(means(&flash)[20] > 1.4 * means(&fine)[20]);
}

#[test]
fn covered_lens_shows_part_of_the_scene() {
    let [fine, covered] = seen(Kind::CoveredLens, 0.5);
    let (fine, covered) = (
        frames(&fine)[20].image.gray(0),
        frames(&covered)[20].image.gray(0),
    );
    let black = covered.iter().filter(|v| **v < 8).count();
    let (least, most) = (covered.len() / 4, 3 * covered.len() / 4);
    assert!((least..most).contains(&black), "{black}");
    let same = fine
        .iter()
        .zip(&covered)
        .filter(|(a, b)| a.abs_diff(**b) < 12)
        .count();
    assert!(same > covered.len() / 5, "{same}");
    let [_, closed] = seen(Kind::CoveredLens, 1.0);
    assert!(frames(&closed)[20].image.gray(1).iter().all(|v| *v < 16));
}

/// Differences between neighbours in a row, summed.
fn detail(delivered: &[Delivery], n: usize) -> f64 {
    let gray = frames(delivered)[n].image.gray(0);
    gray.windows(2)
        .map(|w| f64::from(w[0].abs_diff(w[1])))
        .sum()
}

#[test]
fn blurred_image_has_less_detail() {
    let [fine, blurred] = seen(Kind::Blur, 0.05);
    assert!(detail(&blurred, 25) < 0.6 * detail(&fine, 25));
}

#[test]
fn dirty_lens_reduces_contrast() {
    let [fine, dirty] = seen(Kind::DirtyLens, 1.0);
    let (less, whole) = (detail(&dirty, 25), detail(&fine, 25));
    assert!(less < 0.75 * whole, "{less} {whole}");
}

#[test]
fn shifted_camera_rotates_with_its_imu() {
    let [fine, shifted] = seen(Kind::ShiftedCamera, 5.0);
    let turn = |gyro: bool| {
        let mut angles = Vec::new();
        for (a, b) in samples(&fine).iter().zip(&samples(&shifted)) {
            let vector = |s: &DeviceImu| {
                let counts = if gyro { s.gyro } else { s.accel };
                Vector3::from(counts.map(f64::from))
            };
            if (1_100_000_000..1_900_000_000).contains(&a.taken_ns) {
                angles.push(vector(a).angle(&vector(b)).to_degrees());
            }
        }
        angles.sort_by(f64::total_cmp);
        angles[angles.len() - 1]
    };
    // A vector along the axis is not rotated; no vector is rotated by more.
    assert!((1.5..6.5).contains(&turn(false)), "{}", turn(false));
    let faults = Faults {
        list: vec![fault(Kind::ShiftedCamera, 5.0, 0.0, 9.0)],
        seed: 1,
    }
    .of(LEFT);
    let of = &WALK.cameras()[camera(LEFT)];
    let slip = of.slip(&Conditions::of(&faults, 1.0).rotation).unwrap();
    assert!((slip.angle_rad().to_degrees() - 5.0).abs() < 1e-9);
    let left = of.rig_from_eye[0].translation_m();
    let moved = slip.apply(left);
    assert!((0..3).all(|k| (moved[k] - left[k]).abs() < 1e-12));
}

#[test]
fn frames_that_are_not_fetched_are_dropped() {
    let mut device = Device::new(
        &WALK,
        camera(FEET),
        CameraFaults::default(),
        Box::new(Counter),
    );
    let skipped = device.skip_frames_to(1_000_000_000);
    assert!(skipped.into_iter().eq(0..20), "by their numbers");
    assert_eq!(device.losses().len(), 20);
    let delivered: Vec<_> = std::iter::from_fn(|| device.deliver()).collect();
    assert_eq!(frames(&delivered)[0].number, 20);
}

#[test]
fn pixels_have_the_layout_of_the_device() {
    let mut image = Counter.render_frame(0, 0);
    image.i420 = (0..48).collect();
    let nv12 = image.pixels(PixelFormat::Nv12);
    assert_eq!(nv12[..32], image.i420[..32]);
    assert_eq!(nv12[32..36], [32, 40, 33, 41]);
    let yuyv = image.pixels(PixelFormat::Yuyv);
    assert_eq!(yuyv.len(), 64);
    assert_eq!(yuyv[..8], [0, 32, 1, 40, 2, 33, 3, 41]);
    // The second row has the chroma of the first, the third its own.
    assert_eq!(yuyv[16..20], [8, 32, 9, 40]);
    assert_eq!(yuyv[32..36], [16, 36, 17, 44]);
}

#[test]
fn report_fields_have_the_offsets_of_the_vendor_library() {
    let sample = DeviceImu {
        number: 9,
        index: 9,
        ticks: 0x0102_0304_0506_0708,
        arrival_ns: 0,
        taken_ns: 0,
        gyro: [1, -2, 3],
        accel: [-4, 5, 0x0607],
        temperature: 2512,
        frame_sync: true,
        frame_sync_count: 77,
    };
    let report = sample.report();
    let mut expected = vec![0, 0, 8, 7, 6, 5, 4, 3, 2, 1];
    expected.extend([1, 0, 0xfe, 0xff, 3, 0]);
    expected.extend([0xfc, 0xff, 5, 0, 7, 6]);
    expected.extend([1, 1, 77, 0, 0, 0, 0xd0, 9]);
    assert_eq!(report[..30], expected);
    assert_eq!(report[30..58], [0; 28]);
    assert_eq!(report[58..62], [0x4d, 0x95, 0x4d, 0x95]);
}
