use std::sync::{Arc, Mutex};
use std::time::Duration;

use video::discover::best_encoder;
use video::{Decoder, Encoder, EncoderEvent, EncoderSettings};

use super::*;

const START: HostTime = HostTime(1_000_000_000_000);

fn camera(faults: FaultPlan) -> Synthetic {
    Synthetic::new("cam", 640, 240, 30.0, 400.0, 1, START)
        .unwrap()
        .with_faults(faults)
}

/// Frames and IMU samples, to the end or to `count` in all.
fn take(source: &mut Synthetic, count: usize) -> (Vec<RawFrame>, Vec<RawImu>) {
    let (mut frames, mut imu, mut last) = (Vec::new(), Vec::new(), HostTime::MIN);
    for _ in 0..count {
        let Some(sample) = source.next_sample().unwrap() else {
            break;
        };
        assert!(
            sample.host_time() >= last,
            "samples come in order of arrival"
        );
        last = sample.host_time();
        match sample {
            Sample::Frame(frame) => frames.push(frame),
            Sample::Imu(sample) => imu.push(sample),
            other => panic!("{other:?}"),
        }
    }
    (frames, imu)
}

/// Checksum of every image, number, time and measurement.
fn checksum(source: &mut Synthetic, count: usize) -> u32 {
    let (frames, imu) = take(source, count);
    let mut crc = crc32fast::Hasher::new();
    let mut add = |numbers: [i64; 3]| numbers.iter().for_each(|n| crc.update(&n.to_le_bytes()));
    for f in &frames {
        add([f.number as i64, f.device_ticks, f.host_time.ns()]);
    }
    for i in &imu {
        add([i.number as i64, i.device_ticks, i.host_time.ns()]);
        let ImuValues::Counts { gyro, accel } = i.values else {
            panic!("{:?}", i.values)
        };
        add(gyro.map(i64::from));
        add(accel.map(i64::from));
    }
    for f in &frames {
        crc.update(&f.image.data);
    }
    crc.finalize()
}

fn numbers(frames: &[RawFrame]) -> Vec<u64> {
    frames.iter().map(|frame| frame.number).collect()
}

#[test]
fn seed_determines_every_byte() {
    let new = |seed| Synthetic::new("cam", 320, 64, 30.0, 400.0, seed, START).unwrap();
    let one = checksum(&mut new(1), 300);
    assert_eq!(one, checksum(&mut new(1), 300));
    assert_ne!(one, checksum(&mut new(2), 300));
    // The same on every machine, and with every version: recordings of it are comparable.
    assert_eq!(
        one, 3_792_005_239,
        "changing the synthetic camera changes every recording made with it"
    );
}

/// While nobody stores frames nothing is rendered, and later images are unaffected.
#[test]
fn without_pixels_numbers_and_times_are_the_same() {
    let (frames, imu) = take(&mut camera(FaultPlan::default()), 200);
    let mut source = camera(FaultPlan::default());
    let (mut numbers, mut of_imu) = (Vec::new(), Vec::new());
    for i in 0..200 {
        source.set_pixels_needed(i >= 100);
        match source.next_sample().unwrap().unwrap() {
            Sample::Arrival(s) if i < 100 => numbers.push((s.number, s.device_ticks, s.host_time)),
            Sample::Frame(f) if i >= 100 => {
                assert_eq!(f.image, frames[numbers.len()].image);
                numbers.push((f.number, f.device_ticks, f.host_time));
            }
            Sample::Imu(sample) => of_imu.push(sample),
            other => panic!("sample {i}: {other:?}"),
        }
    }
    let expected = frames
        .iter()
        .map(|f| (f.number, f.device_ticks, f.host_time));
    assert_eq!(numbers, expected.collect::<Vec<_>>());
    assert_eq!(of_imu, imu);
}

#[test]
fn counts_are_exact() {
    let two_s = FaultPlan {
        end_after_frames: Some(60),
        ..FaultPlan::default()
    };
    let (frames, imu) = take(&mut camera(two_s), usize::MAX);
    assert_eq!((frames.len(), imu.len()), (60, 800));
    assert!(frames.iter().map(|f| f.number).eq(0..60));
    assert!(imu.iter().map(|i| i.number).eq(0..800));

    let mut without = Synthetic::new("cam", 640, 240, 30.0, 0.0, 1, START).unwrap();
    assert_eq!(without.info().imu, None);
    let (frames, imu) = take(&mut without, 5);
    assert_eq!((frames.len(), imu.len()), (5, 0));
}

#[test]
fn every_frame_shows_its_number() {
    for (width, height) in [(128, 32), (640, 240), (2560, 720)] {
        let mut source = Synthetic::new("cam", width, height, 60.0, 0.0, 9, START).unwrap();
        for frame in take(&mut source, 20).0 {
            let image = &frame.image;
            assert_eq!((image.width, image.height), (width, height));
            assert_eq!(read_counter(image), Some(frame.number), "{width}x{height}");
            let (left, right) = video::raw_image::split(image).unwrap();
            assert_eq!(read_eye_counter(&left), Some(frame.number));
            assert_eq!(read_eye_counter(&right), Some(frame.number));
        }
    }
}

/// At a quality too low for recordings, and in the smallest image with a bar.
#[test]
fn the_number_survives_compression() {
    for (width, height) in [(128, 32), (640, 240)] {
        let element = match best_encoder(width, height) {
            Ok(choice) => choice.element,
            Err(error) => {
                eprintln!("skipped: {error}");
                return;
            }
        };
        let settings = EncoderSettings {
            element,
            width,
            height,
            rate_hz: 30.0,
            quality_db: 24.0,
            threads: 1,
            max_key_interval_frames: 15,
            preset: video::encoder::Preset::default(),
        };
        let units = Arc::new(Mutex::new(Vec::new()));
        let sink = Arc::clone(&units);
        let on_output = move |event| match event {
            EncoderEvent::AccessUnit(unit) => sink.lock().unwrap().push(unit),
            EncoderEvent::Failed(reason) => panic!("{reason}"),
        };
        let mut encoder = Encoder::start(&settings, Box::new(on_output)).unwrap();
        let codec = encoder.codec();
        let mut source = Synthetic::new("cam", width, height, 30.0, 0.0, 4, START).unwrap();
        for frame in take(&mut source, 30).0 {
            encoder
                .push(frame.number as i64, &frame.image, frame.number == 0)
                .unwrap();
        }
        encoder.finish(Duration::from_secs(20)).unwrap();
        let units = units.lock().unwrap();
        let images = Decoder::new(codec).decode(&units).unwrap();
        assert_eq!(images.len(), 30);
        for (number, image) in images {
            assert_eq!(
                read_counter(&image),
                Some(number as u64),
                "{width}x{height}"
            );
        }
    }
}

#[test]
fn images_move_smoothly() {
    let (frames, _) = take(&mut camera(FaultPlan::default()), 900);
    let luma = |i: usize| &frames[i].image.luma().unwrap()[640 * 120..];
    let change = |a: &[u8], b: &[u8]| {
        let sum: u64 = a
            .iter()
            .zip(b)
            .map(|(a, b)| u64::from(a.abs_diff(*b)))
            .sum();
        sum / a.len() as u64
    };
    let steps: Vec<u64> = (1..frames.len())
        .map(|i| change(luma(i - 1), luma(i)))
        .collect();
    assert!(steps.iter().all(|&step| step < 25), "{steps:?}");
    assert!(change(luma(0), luma(frames.len() - 1)) > 10);
}

#[test]
fn clocks_drift_and_arrivals_are_late() {
    let source = camera(FaultPlan::default());
    let slot = |number| Slot {
        number,
        taken_ns: time_at(number, 30.0),
        arrival: START,
    };
    // An hour: 72 ms and -126 ms.
    let hour = 3_600 * NS_PER_S;
    let frame = source.frame(slot(108_000)).unwrap();
    assert_eq!(
        frame.device_ticks - CAMERA_TICKS_AT_START,
        hour + 72_000_000
    );
    let imu = source.imu_sample(slot(108_000));
    let ns = TickLength::ZED_MINI
        .ns(imu.device_ticks - IMU_TICKS_AT_START)
        .unwrap();
    assert!((ns - (hour - 126_000_000)).abs() <= 39_063, "{ns}");
    assert_eq!(source.frame_time(108_000), START + hour);

    let mut source = camera(FaultPlan::default());
    let (frames, imu) = take(&mut source, 43_000);
    let frame_delays = frames
        .iter()
        .map(|f| f.host_time.since(source.frame_time(f.number)));
    let imu_delays = imu
        .iter()
        .map(|i| i.host_time.since(source.imu_time(i.number)));
    let delays: Vec<i64> = frame_delays.chain(imu_delays).collect();
    assert!(delays.iter().all(|delay| (0..=2_000_000).contains(delay)));
    let mean = delays.iter().sum::<i64>() / delays.len() as i64;
    assert!((195_000..205_000).contains(&mean), "{mean}");
}

#[test]
fn imu_measures_gravity() {
    let (_, imu) = take(&mut camera(FaultPlan::default()), 4_300);
    let mut force = [0.0; 3];
    for sample in &imu {
        let ImuValues::Counts { gyro, accel } = sample.values else {
            panic!("{:?}", sample.values)
        };
        assert!(gyro.iter().all(|count| count.abs() < 1000), "{gyro:?}");
        for (sum, count) in force.iter_mut().zip(accel) {
            *sum += f64::from(count) * IMU_SCALE.1 / imu.len() as f64;
        }
    }
    assert!(
        force[0].abs() < 0.05 && (force[1] + 9.8).abs() < 0.05 && force[2].abs() < 0.4,
        "{force:?}"
    );
}

#[test]
fn dropped_frames_leave_the_others_unchanged() {
    let plan = |faults: FaultPlan| {
        let faults = FaultPlan {
            end_after_frames: Some(30),
            ..faults
        };
        take(&mut camera(faults), usize::MAX)
    };
    let (whole, whole_imu) = plan(FaultPlan::default());

    let (frames, imu) = plan(FaultPlan {
        drop_frames: vec![0, 7, 8, 29],
        ..FaultPlan::default()
    });
    let kept: Vec<u64> = (0..30).filter(|n| ![0, 7, 8, 29].contains(n)).collect();
    assert_eq!(numbers(&frames), kept);
    assert_eq!(imu, whole_imu);
    for frame in &frames {
        let same = &whole[frame.number as usize];
        assert_eq!(frame.image, same.image);
        assert_eq!(
            (frame.device_ticks, frame.host_time),
            (same.device_ticks, same.host_time)
        );
    }

    // 0.2 s to 0.5 s: frames 6 to 14, samples 80 to 199.
    let silence = Some(200_000_000..500_000_000);
    let (frames, imu) = plan(FaultPlan {
        camera_silence: silence.clone(),
        imu_silence: silence,
        ..FaultPlan::default()
    });
    assert_eq!(numbers(&frames), (0..6).chain(15..30).collect::<Vec<_>>());
    let kept: Vec<RawImu> = [&whole_imu[..80], &whole_imu[200..]].concat();
    assert_eq!(imu, kept);

    let (frames, imu) = plan(FaultPlan {
        camera_silence: Some(0..i64::MAX),
        ..FaultPlan::default()
    });
    assert_eq!((frames.len(), imu.len()), (0, 400));
}

#[test]
fn endless_silence_is_supported() {
    let mut source = camera(FaultPlan {
        camera_silence: Some(100_000_000..i64::MAX),
        ..FaultPlan::default()
    });
    let (frames, imu) = take(&mut source, 1003);
    assert_eq!((frames.len(), imu.len()), (3, 1000));
}

#[test]
fn frozen_images_are_bit_identical() {
    let (frames, _) = take(
        &mut camera(FaultPlan {
            frozen: Some(5..9),
            end_after_frames: Some(12),
            ..FaultPlan::default()
        }),
        usize::MAX,
    );
    assert_eq!(numbers(&frames), (0..12).collect::<Vec<_>>());
    let shown: Vec<u64> = frames
        .iter()
        .map(|frame| read_counter(&frame.image).unwrap())
        .collect();
    assert_eq!(shown, [0, 1, 2, 3, 4, 4, 4, 4, 4, 9, 10, 11]);
    assert!(
        frames[5..9]
            .iter()
            .all(|frame| frame.image == frames[4].image)
    );
    assert!(frames.is_sorted_by(|a, b| a.device_ticks < b.device_ticks));
}

#[test]
fn impossible_arguments_are_rejected() {
    let new = |width, height, rate_hz, imu_rate_hz| {
        Synthetic::new("cam", width, height, rate_hz, imu_rate_hz, 1, START).map(|_| ())
    };
    assert_eq!(new(128, 32, 30.0, 0.0), Ok(()));
    for (width, height) in [
        (0, 0),
        (124, 32),
        (128, 30),
        (130, 32),
        (128, 33),
        (u32::MAX - 3, u32::MAX - 1),
    ] {
        assert_eq!(
            new(width, height, 30.0, 0.0),
            Err(SyntheticError::Size { width, height })
        );
    }
    for (rate_hz, imu_rate_hz) in [
        (0.0, 0.0),
        (f64::NAN, 0.0),
        (1e9, 0.0),
        (30.0, -1.0),
        (30.0, f64::NAN),
    ] {
        let error = new(640, 240, rate_hz, imu_rate_hz).unwrap_err();
        assert!(matches!(error, SyntheticError::Rate { .. }), "{error}");
    }
}
