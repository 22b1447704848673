use std::fs;

use test_data::shared;

use super::*;

const START: HostTime = HostTime(5_000_000_000);

/// A folder of synthetic files.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        let path = self.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }

    fn png(&self, name: &str, colour: png::ColorType, width: u32, data: &[u8]) {
        let mut bytes = Vec::new();
        let height = (data.len() / colour.samples()) as u32 / width;
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(colour);
        encoder
            .write_header()
            .unwrap()
            .write_image_data(data)
            .unwrap();
        self.write(name, &bytes);
    }

    /// A uniform gray image of 4 x 2.
    fn flat(&self, name: &str, value: u8) {
        self.png(name, png::ColorType::Grayscale, 4, &[value; 8]);
    }

    /// ASL lists with a row per timestamp, and images for those with a value.
    fn asl(rows: &[(i64, Option<u8>)], imu: &str) -> Self {
        let folder = Self::new();
        for camera in ["cam0", "cam1"] {
            let mut list = "#timestamp [ns],filename\n".to_owned();
            for (stamp, value) in rows {
                list += &format!("{stamp},{stamp}.png\n");
                if let Some(value) = value {
                    folder.flat(&format!("{camera}/data/{stamp}.png"), *value);
                }
            }
            folder.write(&format!("{camera}/data.csv"), list.as_bytes());
        }
        folder.write("imu0/data.csv", imu.as_bytes());
        folder
    }

    fn replay(&self, rate_hz: Option<f64>, repeat: bool) -> Replay {
        Replay::open("cam", self.path(), rate_hz, repeat, true, START).unwrap()
    }
}

/// At most `count` samples, in order.
fn take(replay: &mut Replay, count: usize) -> Vec<Sample> {
    let next = || replay.next_sample().unwrap();
    let samples: Vec<Sample> = std::iter::from_fn(next).take(count).collect();
    assert!(samples.is_sorted_by_key(Sample::host_time));
    samples
}

fn frames(samples: &[Sample]) -> Vec<&RawFrame> {
    let mut frames = Vec::new();
    for sample in samples {
        if let Sample::Frame(frame) = sample {
            frames.push(frame);
        }
    }
    frames
}

fn imu(samples: &[Sample]) -> Vec<RawImu> {
    let imu = |sample: &Sample| match sample {
        Sample::Imu(imu) => Some(*imu),
        _ => None,
    };
    samples.iter().filter_map(imu).collect()
}

/// Number, device ticks, and arrival after the start.
fn times(frames: &[&RawFrame]) -> Vec<(u64, i64, i64)> {
    let times = |f: &&RawFrame| (f.number, f.device_ticks, f.host_time.since(START));
    frames.iter().map(times).collect()
}

#[test]
fn real_kitti_pairs() {
    let Some(path) = shared("02_stereo_odometry_kitti/KITTI_sequence_1") else {
        return;
    };
    let mut replay = Replay::open("feet", &path, Some(10.0), false, true, START).unwrap();
    let info = replay.info().clone();
    let expected = CameraInfo {
        width: 2452,
        height: 370,
        rate_hz: 10.0,
        tick: TickLength::NANOSECOND,
        tick_bits: None,
        number_bits: None,
        colour: false,
        still: false,
        stamped: None,
    };
    assert_eq!((info.camera, info.imu), (expected, None));
    assert_eq!(info.description, "replay of KITTI pairs: KITTI_sequence_1");
    let calibration_file = (
        "feet.calib.txt".to_owned(),
        fs::read(path.join("calib.txt")).unwrap(),
    );
    assert_eq!(info.calibration_files, [calibration_file]);
    assert!(replay.calibration().unwrap().unwrap().is_rectified());

    let samples = take(&mut replay, usize::MAX);
    let frames = frames(&samples);
    let at = |n: i64| (n as u64, n * 100_000_000, n * 100_000_000);
    assert_eq!(times(&frames), (0..30).map(at).collect::<Vec<_>>());
    let image = &frames[29].image;
    let luma = image.luma().unwrap();
    for (eye, file) in ["image_l/000029.png", "image_r/000029.png"]
        .iter()
        .enumerate()
    {
        let source = datasets::load_png(&path.join(file)).unwrap();
        for (row, expected) in luma.chunks_exact(2452).zip(source.data.chunks_exact(1226)) {
            assert_eq!(&row[eye * 1226..][..1226], expected);
        }
    }
    assert!(image.data[luma.len()..].iter().all(|&chroma| chroma == 128));
}

#[test]
fn real_euroc_images_and_imu() {
    let Some(path) = shared("03_stereo_imu/euroc_V1_01_micro") else {
        return;
    };
    let mut replay = Replay::open("right_shoulder", &path, None, false, true, START).unwrap();
    let info = replay.info().clone();
    assert_eq!((info.camera.width, info.camera.height), (1504, 480));
    assert!((info.camera.rate_hz - 20.0).abs() < 1e-3 && !info.camera.colour);
    let imu_info = info.imu.unwrap();
    assert!((imu_info.rate_hz - 200.0).abs() < 0.01, "{imu_info:?}");
    assert_eq!(
        (imu_info.tick, imu_info.scale),
        (TickLength::NANOSECOND, None)
    );
    let names: Vec<&str> = info
        .calibration_files
        .iter()
        .map(|(name, _)| name.as_str())
        .collect();
    let expected = [
        "right_shoulder.body.yaml",
        "right_shoulder.cam0.sensor.yaml",
        "right_shoulder.cam1.sensor.yaml",
        "right_shoulder.imu0.sensor.yaml",
    ];
    assert_eq!(names, expected);
    assert!(replay.calibration().unwrap().unwrap().imu.is_some());

    let samples = take(&mut replay, usize::MAX);
    let frames = frames(&samples);
    assert_eq!(frames.len(), 20);
    let first_ns = 1_403_715_273_262_142_976;
    for (frame, number) in frames.iter().zip(0..) {
        assert_eq!(frame.number, number);
        assert_eq!(frame.device_ticks - first_ns, frame.host_time.since(START));
        let file = path.join(format!("mav0/cam1/data/{}.png", frame.device_ticks));
        let right = datasets::load_png(&file).unwrap();
        let last_row = &frame.image.luma().unwrap()[479 * 1504 + 752..];
        assert_eq!(last_row, &right.data[479 * 752..]);
    }
    // The first image and the first IMU sample are of one instant.
    assert!(matches!(samples[0], Sample::Imu(_)) && matches!(samples[1], Sample::Frame(_)));

    // Every line of the list, with its exact digits.
    let list = fs::read_to_string(path.join("mav0/imu0/data.csv")).unwrap();
    let lines: Vec<&str> = list.lines().filter(|line| !line.starts_with('#')).collect();
    let imu = imu(&samples);
    assert_eq!((imu.len(), lines.len()), (29_120, 29_120));
    for ((sample, line), number) in imu.iter().zip(lines).zip(0..) {
        let (stamp, values) = line.split_once(',').unwrap();
        assert_eq!(stamp.parse(), Ok(sample.device_ticks));
        assert_eq!(
            sample.device_ticks - first_ns,
            sample.host_time.since(START)
        );
        assert_eq!(sample.number, number);
        let ImuValues::Si { gyro, accel } = sample.values else {
            panic!("{:?}", sample.values)
        };
        let expected: Vec<u64> = values
            .split(',')
            .map(|v| v.trim().parse::<f64>().unwrap().to_bits())
            .collect();
        let found: Vec<u64> = gyro.iter().chain(&accel).map(|v| v.to_bits()).collect();
        assert_eq!(found, expected, "{line}");
    }
}

#[test]
fn real_desk_pair_repeats() {
    let Some(path) = shared("01_stereo_depth/foundationstereo_demo") else {
        return;
    };
    let mut replay = Replay::open("left_shoulder", &path, Some(15.0), true, true, START).unwrap();
    let camera = &replay.info().camera;
    assert_eq!((camera.width, camera.height), (1920, 540));
    assert!(camera.colour && camera.still);
    assert_eq!(replay.info().calibration_files[0].0, "left_shoulder.K.txt");
    let samples = take(&mut replay, 100);
    let frames = frames(&samples);
    let at = |n: i64| (n as u64, n * 66_666_667, n * 66_666_667);
    assert_eq!(times(&frames), (0..100).map(at).collect::<Vec<_>>());
    // Decoded once, shared by all.
    let shared = frames[0].image.data.as_ptr();
    assert!(
        frames
            .iter()
            .all(|frame| frame.image.data.as_ptr() == shared)
    );
}

#[test]
fn numbers_and_ticks_continue_when_images_repeat() {
    // Row 2 was never on disk: a lost frame. Intervals are 10, 20, 10: the median is 10.
    let rows = [
        (100, Some(1)),
        (110, Some(2)),
        (120, None),
        (130, Some(4)),
        (140, Some(5)),
    ];
    let folder = Folder::asl(&rows, "");
    let mut replay = folder.replay(None, true);
    let samples = take(&mut replay, 10);
    let frames = frames(&samples);
    let expected = [
        (0, 100, 0),
        (1, 110, 10),
        (3, 130, 30),
        (4, 140, 40),
        (5, 150, 50),
        (6, 160, 60),
        (8, 180, 80),
        (9, 190, 90),
        (10, 200, 100),
        (11, 210, 110),
    ];
    assert_eq!(times(&frames), expected);
    let shades: Vec<u8> = frames.iter().map(|frame| frame.image.data[0]).collect();
    assert_eq!(shades, [1, 2, 4, 5, 1, 2, 4, 5, 1, 2]);

    let samples = take(&mut folder.replay(None, false), 10);
    assert_eq!(times(&self::frames(&samples)), expected[..4]);
}

#[test]
fn rows_before_the_first_image_are_no_loss() {
    let folder = Folder::asl(
        &[(100, None), (110, None), (120, Some(3)), (130, Some(4))],
        "",
    );
    let samples = take(&mut folder.replay(None, false), 10);
    assert_eq!(times(&frames(&samples)), [(0, 120, 0), (1, 130, 10)]);
}

#[test]
fn imu_runs_once_from_the_first_image() {
    let line = |stamp: i64| format!("{stamp},0.1,-2.5e-3,3,4,-0,9.81\n");
    let list: String = (0..10).map(|i| line(80 + 5 * i)).collect();
    let folder = Folder::asl(&[(100, Some(1)), (110, Some(2))], &list);
    let mut replay = folder.replay(None, true);
    assert_eq!(replay.info().imu.as_ref().unwrap().rate_hz, 2e8);
    let samples = take(&mut replay, 12);
    // i: IMU, f: frame. Equal instants: the IMU sample first.
    let order: String = samples
        .iter()
        .map(|sample| match sample {
            Sample::Imu(_) => 'i',
            Sample::Frame(_) => 'f',
            _ => 'g',
        })
        .collect();
    assert_eq!(order, "ifiifiififff");
    let found: Vec<(u64, i64, i64)> = imu(&samples)
        .iter()
        .map(|i| (i.number, i.device_ticks, i.host_time.since(START)))
        .collect();
    let expected: Vec<(u64, i64, i64)> = (0..6).map(|i| (i as u64, 100 + 5 * i, 5 * i)).collect();
    assert_eq!(found, expected);
    let values = ImuValues::Si {
        gyro: [0.1, -2.5e-3, 3.0],
        accel: [4.0, -0.0, 9.81],
    };
    assert_eq!(imu(&samples)[0].values, values);

    // Images once: the IMU continues alone, to its end.
    let samples = take(&mut folder.replay(None, false), 100);
    assert_eq!((frames(&samples).len(), imu(&samples).len()), (2, 6));

    let mut without = Replay::open("cam", folder.path(), None, false, false, START).unwrap();
    assert_eq!(without.info().imu, None);
    assert!(imu(&take(&mut without, 100)).is_empty());

    let early = Folder::asl(&[(100, Some(1)), (110, Some(2))], &(line(90) + &line(100)));
    let replay = early.replay(None, false);
    assert_eq!(replay.info().imu, None);
    let notes = replay.notes();
    assert!(
        notes
            .iter()
            .any(|note| note.contains("fewer than two samples")),
        "{notes:?}"
    );
}

#[test]
fn begins_at_the_configured_start() {
    let folder = Folder::asl(&[(100, Some(1)), (110, Some(2))], "");
    let mut replay = folder.replay(None, false);
    replay.begin_at(HostTime(-7));
    let times: Vec<i64> = take(&mut replay, 10)
        .iter()
        .map(|s| s.host_time().ns())
        .collect();
    assert_eq!(times, [-7, 3]);
    assert!(replay.next_sample().unwrap().is_none());
}

#[test]
fn odd_size_is_kept() {
    let folder = Folder::new();
    folder.png("left.png", png::ColorType::Grayscale, 3, &[1, 2, 3]);
    folder.png("right.png", png::ColorType::Grayscale, 3, &[4, 5, 6]);
    let mut replay = folder.replay(Some(1.0), false);
    let camera = &replay.info().camera;
    assert_eq!((camera.width, camera.height), (6, 1));
    let samples = take(&mut replay, 1);
    let expected = [&[1, 2, 3, 4, 5, 6][..], &[128; 6]].concat();
    assert_eq!(frames(&samples)[0].image.data, expected);

    // Color: the last pixel of a row has chroma of its own.
    let folder = Folder::new();
    let pixels = [255, 255, 255, 0, 0, 0, 255, 255, 255];
    folder.png("left.png", png::ColorType::Rgb, 1, &pixels);
    folder.png("right.png", png::ColorType::Rgb, 1, &pixels);
    let samples = take(&mut folder.replay(Some(1.0), false), 1);
    let image = &frames(&samples)[0].image;
    assert_eq!((image.width, image.height), (2, 3));
    assert_eq!(image.luma().unwrap(), [255, 255, 0, 0, 255, 255]);
}

#[test]
fn color_if_any_image_has_color() {
    let folder = Folder::new();
    folder.flat("left/0.png", 7);
    folder.flat("right/0.png", 7);
    folder.flat("left/1.png", 7);
    let red = [255, 0, 0].repeat(8);
    folder.png("right/1.png", png::ColorType::Rgb, 4, &red);
    let mut replay = folder.replay(Some(30.0), false);
    assert!(replay.info().camera.colour && !replay.info().camera.still);
    let samples = take(&mut replay, 10);
    let data: Vec<&[u8]> = frames(&samples).iter().map(|f| &f.image.data[..]).collect();
    let grey: Vec<u8> = [&[7; 16][..], &[128; 8]].concat();
    assert_eq!(data[0], grey);
    // JFIF: red is 76, 85, 255.
    let both = [7, 7, 7, 7, 76, 76, 76, 76];
    let expected = [&both[..], &both, &[128, 128, 85, 85, 128, 128, 255, 255]].concat();
    assert_eq!(data[1], expected);
}

#[test]
fn unusable_data_set_is_rejected_when_opened() {
    let check = |folder: &Folder, rate_hz: Option<f64>, expected: &str, file: &str| {
        let error = Replay::open("cam", folder.path(), rate_hz, false, true, START)
            .err()
            .map(|error| with_causes(&error))
            .unwrap();
        assert!(error.contains(expected), "{error}");
        let path = match file {
            "" => folder.path().to_owned(),
            file => folder.path().join(file),
        };
        assert!(error.ends_with(&path.display().to_string()), "{error}");
    };
    let pair = Folder::new();
    pair.flat("left.png", 1);
    pair.flat("right.png", 1);
    check(&pair, None, "expected a frame rate", "");
    check(&pair, Some(-1.0), "expected a number above 0", "");

    pair.png("right.png", png::ColorType::Grayscale, 2, &[1; 8]);
    check(
        &pair,
        Some(1.0),
        "found 2x4, expected 4x2 like the first one",
        "right.png",
    );
    pair.write("right.png", b"no image");
    check(&pair, Some(1.0), "expected a whole PNG file", "right.png");

    let ages = Folder::asl(&[(i64::MIN, Some(1)), (i64::MAX, Some(2))], "");
    let error = Replay::open("cam", ages.path(), None, true, true, START).err();
    assert!(
        matches!(
            error,
            Some(ReplayError::Dataset(_) | ReplayError::Span { .. })
        ),
        "{error:?}"
    );
}

#[test]
fn late_damage_names_camera_and_file() {
    let folder = Folder::new();
    folder.flat("left/0.png", 1);
    folder.flat("right/0.png", 1);
    folder.flat("left/1.png", 1);
    folder.flat("right/1.png", 1);
    let damaged = folder.path().join("right/1.png");
    let mut bytes = fs::read(&damaged).unwrap();
    bytes.truncate(bytes.len() - 20);
    fs::write(&damaged, bytes).unwrap();
    let mut replay = folder.replay(Some(1.0), true);
    assert!(replay.next_sample().unwrap().is_some());
    for _ in 0..2 {
        let error = replay.next_sample().unwrap_err();
        assert!(
            matches!(&error, SourceError::Unusable { source_name, .. } if source_name == "cam")
        );
        let text = error.to_string();
        assert!(text.contains("expected a whole PNG file"), "{text}");
        assert!(text.ends_with(&damaged.display().to_string()), "{text}");
    }

    // A file that changes after it was probed.
    let folder = Folder::new();
    folder.flat("left.png", 1);
    folder.flat("right.png", 1);
    let mut replay = folder.replay(Some(1.0), false);
    folder.png("left.png", png::ColorType::Grayscale, 2, &[1; 8]);
    let text = replay.next_sample().unwrap_err().to_string();
    assert!(text.contains("found 2x4, expected 4x2"), "{text}");
    fs::remove_file(folder.path().join("left.png")).unwrap();
    let text = replay.next_sample().unwrap_err().to_string();
    assert!(text.contains("left.png: No such file"), "{text}");
}

#[test]
fn unreadable_calibration_is_noted_and_stored() {
    let folder = Folder::new();
    folder.flat("left.png", 1);
    folder.flat("right.png", 1);
    let replay = folder.replay(Some(1.0), false);
    assert_eq!(replay.notes(), ["the data set contains no calibration"]);

    folder.write("K.txt", b"no matrix");
    let replay = folder.replay(Some(1.0), false);
    assert!(replay.calibration().unwrap().is_none());
    assert!(
        replay.notes()[0].starts_with("the calibration is not used: "),
        "{:?}",
        replay.notes()
    );
    let kept = ("cam.K.txt".to_owned(), b"no matrix".to_vec());
    assert_eq!(replay.info().calibration_files, [kept]);
}

/// While nobody stores frames they are counted and timed as usual, and no file is decoded: not even
/// a damaged one.
#[test]
fn without_pixels_numbers_and_times_are_the_same() {
    let rows: Vec<(i64, Option<u8>)> = [0, 50, 100, 250]
        .into_iter()
        .map(|ms| (7_000_000_000 + ms * 1_000_000, Some(ms as u8)))
        .collect();
    let folder = Folder::asl(
        &rows,
        "7000000000,0,0,0,0,0,9.8\n7020000000,0,0,0,0,0,9.8\n",
    );
    let with = take(&mut folder.replay(None, true), 14);

    let mut replay = folder.replay(None, true);
    let damaged = folder.path().join("cam1/data/7050000000.png");
    let mut bytes = fs::read(&damaged).unwrap();
    bytes.truncate(bytes.len() - 20);
    fs::write(&damaged, bytes).unwrap();
    replay.set_pixels_needed(false);
    let without = take(&mut replay, 14);
    let seen: Vec<(u64, i64, i64)> = without
        .iter()
        .filter_map(|sample| match sample {
            Sample::Arrival(s) => Some((s.number, s.device_ticks, s.host_time.since(START))),
            Sample::Imu(_) => None,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(seen, times(&frames(&with)));
    assert_eq!((seen.len(), imu(&without)), (12, imu(&with)));

    replay.set_pixels_needed(true);
    let after = take(&mut replay, 1);
    assert!(matches!(&after[..], [Sample::Frame(_)]), "{after:?}");
}
