//! The main pipeline on real recordings: a street (KITTI), a room with an IMU (EuRoC) and a desk
//! (one pair, repeated) are recorded together, imported, validated, indexed, handed off and read
//! back. The result is compared with the files of the recordings, which this test reads
//! independently.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::{Path, PathBuf};

use capture_daemon::config::Config;
use capture_daemon::run::{RecordOptions, StopFlag, record};
use capture_daemon::sources::ImuValues;
use collector::commands::{handoff, import, index, validate};
use collector::target::Target;
use console_output::{Clock, Console, Outcome, Show};
use harness::contents::Contents;
use harness::data;
use reconstruction::Input;
use session_archive::handoff::Verdict;
use session_archive::time::{HostTime, NS_PER_S};

const KITTI: &str = "02_stereo_odometry_kitti/KITTI_sequence_1";
const EUROC: &str = "03_stereo_imu/euroc_V1_01_micro";
const DESK: &str = "01_stereo_depth/foundationstereo_demo";
/// Length of the recording.
const SECONDS: i64 = 5;
/// Minimum image quality, dB.
const MIN_PSNR_DB: f64 = 40.0;

/// Expected deliveries of a camera.
struct Truth {
    /// Device ticks and the two files of each frame, by number.
    frames: Vec<(i64, [PathBuf; 2])>,
    colour: bool,
}

/// A list of timestamped frames, repeated until the end of the recording; each repetition begins
/// one period after the last frame of the previous one.
fn played(list: &[(i64, [PathBuf; 2])], period_ns: i64) -> Vec<(i64, [PathBuf; 2])> {
    let (first, last) = (list[0].0, list[list.len() - 1].0);
    let round_ns = last - first + period_ns;
    (0..)
        .flat_map(|round| {
            list.iter()
                .map(move |(t, files)| (t + round * round_ns, files.clone()))
        })
        .take_while(|(t, _)| t - first < SECONDS * NS_PER_S)
        .collect()
}

fn kitti(folder: &Path) -> Truth {
    let list: Vec<_> = (0..30)
        .map(|i| {
            let name = format!("{i:06}.png");
            (
                i * 100_000_000,
                ["image_l", "image_r"].map(|eye| folder.join(eye).join(&name)),
            )
        })
        .collect();
    Truth {
        frames: played(&list, 100_000_000),
        colour: false,
    }
}

fn euroc(folder: &Path) -> Truth {
    let list: Vec<_> = rows(&folder.join("mav0/cam0/data.csv"))
        .into_iter()
        .map(|row| {
            let file = |camera| folder.join("mav0").join(camera).join("data").join(&row[1]);
            (row[0].parse().expect("a stamp"), ["cam0", "cam1"].map(file))
        })
        // The excerpt lists more images than it contains.
        .filter(|(_, files): &(i64, [PathBuf; 2])| files.iter().all(|file| file.is_file()))
        .collect();
    assert_eq!(list.len(), 20);
    // 20 Hz, with rounded timestamps: their median interval is the period.
    let mut intervals: Vec<i64> = list.windows(2).map(|w| w[1].0 - w[0].0).collect();
    intervals.sort_unstable();
    Truth {
        frames: played(&list, intervals[intervals.len() / 2]),
        colour: false,
    }
}

fn desk(folder: &Path) -> Truth {
    let files = ["left.png", "right.png"].map(|name| folder.join(name));
    let time = |i: i64| (i as f64 * 1e9 / 15.0).round() as i64;
    let frames = (0..15 * SECONDS)
        .map(|i| (time(1) * i, files.clone()))
        .collect();
    Truth {
        frames,
        colour: true,
    }
}

/// The fields of a CSV file without its heading.
fn rows(path: &Path) -> Vec<Vec<String>> {
    let text = fs::read_to_string(path).expect("a CSV file");
    let lines = text
        .lines()
        .filter(|line| !line.starts_with('#') && !line.trim().is_empty());
    lines
        .map(|line| {
            line.split(',')
                .map(|field| field.trim().to_owned())
                .collect()
        })
        .collect()
}

fn configuration([kitti, euroc, desk]: &[PathBuf; 3]) -> Config {
    // Rust escapes quotes and backslashes as TOML does.
    let camera = |name: &str, path: &Path, rest: &str| {
        format!(
            "[[camera]]\nname = {name:?}\n[camera.source]\nkind = \"replay\"\npath = {:?}\nrepeat = true\n{rest}\n",
            path.display().to_string()
        )
    };
    let text = [
        camera("left_shoulder", kitti, "rate_hz = 10.0"),
        camera("right_shoulder", euroc, ""),
        camera("feet", desk, "rate_hz = 15.0"),
    ];
    Config::parse(&text.concat(), Path::new("/")).expect("configuration")
}

/// Imports, validates, indexes and hands off; returns the folder of the session in the library.
fn through_the_collector(session: &Path, library: &Path) -> PathBuf {
    let mut said = Vec::new();
    let mut console = Console {
        out: &mut said,
        show: Show::Nothing,
        clock: Clock::STILL,
    };
    let imported = import::run(&[session.to_owned()], library, &mut console).expect("import");
    assert_eq!(imported, Outcome::Fine);
    let name = session
        .file_name()
        .and_then(|n| n.to_str())
        .expect("a name");
    let target = Target::find(name, Some(library)).expect("the imported session");
    let targets = [target];
    let options = validate::Options {
        deep: true,
        calib_program: Some(harness::program::calib().expect("paws-calib")),
        ..validate::Options::default()
    };
    let validated = validate::run(&targets, &options, &mut console).expect("validate");
    let indexed = index::run(&targets, &mut console).expect("index");
    let handed = handoff::run(&targets[0], None, &mut console).expect("hand off");
    let said = String::from_utf8(said).expect("text");
    println!("{said}");
    assert_eq!([validated, indexed, handed], [Outcome::Fine; 3], "{said}");
    // The rows of the street's rectified pairs differ in the corners by up to 1.6 px, as its lenses
    // do, and not as a rotation of the right eye would.
    let warnings: Vec<&str> = said.lines().filter(|l| l.starts_with("  WARN")).collect();
    assert!(warnings.is_empty(), "{warnings:#?}");
    targets[0].folder.clone()
}

#[test]
fn real_recordings_are_read_back_unchanged() {
    let sets = match data::sets([KITTI, EUROC, DESK]) {
        Ok(sets) => sets,
        Err(reason) => return eprintln!("{reason}"),
    };
    let folder = tempfile::tempdir().expect("folder");
    let options = RecordOptions {
        seconds: SECONDS as f64,
        virtual_time: true,
        name: "real input".to_owned(),
        out: folder.path().join("recorded"),
    };
    let finished = record(
        &configuration(&sets),
        &options,
        &StopFlag::new(),
        Box::new(|_| {}),
    )
    .expect("recording");
    assert_eq!((finished.error.as_deref(), finished.missing), (None, 0));
    let handed = through_the_collector(&finished.session, &folder.path().join("library"));
    let input = Input::open(&handed).expect("the hand-off");
    assert_eq!(input.handoff().verdict, Verdict::Pass);

    let recorded = Contents::read(&finished.session).expect("contents");
    let truths = BTreeMap::from([
        ("left_shoulder", kitti(&sets[0])),
        ("right_shoulder", euroc(&sets[1])),
        ("feet", desk(&sets[2])),
    ]);
    assert_eq!(truths["left_shoulder"].frames.len(), 50);
    assert_eq!(truths["right_shoulder"].frames.len(), 100);
    assert_eq!(truths["feet"].frames.len(), 75);
    let begin = recorded.manifest.started;
    for (camera, truth) in &truths {
        times_are_exact(&recorded, &input, camera, truth, begin);
        images_have_quality(&recorded, &input, camera, truth);
    }
    imu_is_bit_equal(&recorded, &input, &sets[1], begin);
    // As in mav0/imu0/sensor.yaml: reconstruction weights the samples by it.
    let noise = recorded.manifest.imus[0].noise.expect("a recorded noise");
    assert_eq!(
        [
            noise.gyro_noise_density,
            noise.gyro_random_walk,
            noise.accel_noise_density,
            noise.accel_random_walk
        ],
        [1.6968e-4, 1.9393e-5, 2e-3, 3e-3]
    );
    sets_are_whole(&input, &recorded);
}

/// Ticks are the timestamps of the recording, arrivals keep their intervals, and recorded times are
/// read back unchanged.
fn times_are_exact(
    recorded: &Contents,
    input: &Input,
    camera: &str,
    truth: &Truth,
    begin: HostTime,
) {
    let frames = &recorded.frames[camera];
    let index = input.index().camera(camera).expect("the camera's index");
    assert_eq!(
        (frames.len(), index.frames.len()),
        (truth.frames.len(), truth.frames.len())
    );
    let first = truth.frames[0].0;
    for (i, (frame, (stamp, _))) in frames.iter().zip(&truth.frames).enumerate() {
        let record = &frame.record;
        assert_eq!(record.number, i as u64, "{camera}");
        assert_eq!(record.device_ticks, *stamp, "{camera} {i}");
        assert_eq!(record.host_time, begin.0 + stamp - first, "{camera} {i}");
        let error = record.time.abs_diff(record.host_time);
        assert!(
            error <= record.sigma_ns,
            "{camera} {i}: {error} ns, {record:?}"
        );
        let entry = &index.frames[i];
        assert_eq!(
            (entry.number, entry.time_ns),
            (record.number, record.time),
            "{camera} {i}"
        );
    }
}

fn images_have_quality(recorded: &Contents, input: &Input, camera: &str, truth: &Truth) {
    let mut sources: BTreeMap<PathBuf, Png> = BTreeMap::new();
    let (mut lowest_luma, mut lowest_rgb) = (f64::INFINITY, f64::INFINITY);
    let mut luma = BTreeMap::new();
    if truth.colour {
        // The reader gives RGB, the decoder gives luma.
        let decoded = recorded.decode(camera, |frame, image| {
            let (left, right) = video::raw_image::split(image)?;
            luma.insert(
                frame.number,
                [left.luma()?.to_vec(), right.luma()?.to_vec()],
            );
            Ok(())
        });
        decoded.expect("decoding");
    }
    let views = input.session().frames(camera).expect("frames");
    assert_eq!(views.len(), truth.frames.len());
    for (view, (frame, (_, files))) in views.zip(recorded.frames[camera].iter().zip(&truth.frames))
    {
        let view = view.expect("an image");
        assert_eq!(
            (view.number, view.time.0),
            (frame.record.number, frame.record.time)
        );
        assert_eq!(view.sigma_ns, frame.record.sigma_ns);
        for (eye, (image, file)) in [&view.left, &view.right].into_iter().zip(files).enumerate() {
            let source = sources
                .entry(file.clone())
                .or_insert_with(|| Png::read(file));
            assert_eq!((image.width, image.height), (source.width, source.height));
            let db = psnr(&image.data, &source.data);
            if truth.colour {
                lowest_rgb = lowest_rgb.min(db);
                let db = psnr(&luma[&view.number][eye], &source.luma());
                lowest_luma = lowest_luma.min(db);
            } else {
                lowest_luma = lowest_luma.min(db);
            }
        }
    }
    let bytes: usize = recorded.frames[camera].iter().map(|f| f.unit.len()).sum();
    let encoder = &recorded
        .manifest
        .camera(camera)
        .expect("the camera")
        .encoder;
    let rgb = if truth.colour {
        format!(", RGB {lowest_rgb:.2} dB")
    } else {
        String::new()
    };
    println!(
        "{camera}: {} images, {encoder}, {:.2} Mbit/s; the worst eye has luma {lowest_luma:.2} dB{rgb}",
        2 * truth.frames.len(),
        8e-6 * bytes as f64 / SECONDS as f64
    );
    assert!(
        lowest_luma >= MIN_PSNR_DB,
        "{camera}: luma {lowest_luma:.2} dB"
    );
}

/// Every sample from the first image on, with the ticks and bit-exact values of the CSV.
fn imu_is_bit_equal(recorded: &Contents, input: &Input, folder: &Path, begin: HostTime) {
    const NAME: &str = "right_shoulder/imu";
    let first = recorded.frames["right_shoulder"][0].record.device_ticks;
    let expected: Vec<(i64, [f64; 6])> = rows(&folder.join("mav0/imu0/data.csv"))
        .iter()
        .map(|row| {
            let value = |i: usize| row[i].parse::<f64>().expect("a number");
            (
                row[0].parse().expect("a stamp"),
                [1, 2, 3, 4, 5, 6].map(value),
            )
        })
        .filter(|(stamp, _)| (0..SECONDS * NS_PER_S).contains(&(stamp - first)))
        .collect();
    let stored = &recorded.imu[NAME];
    let read = input.session().imu(NAME, ..).expect("samples");
    assert_eq!((stored.len(), read.len()), (expected.len(), expected.len()));
    // 200 Hz, the first one together with the first image.
    assert_eq!(expected.len(), 200 * SECONDS as usize);
    for (i, (stamp, values)) in expected.iter().enumerate() {
        let (kept, back) = (&stored[i], &read[i]);
        let ImuValues::Si { gyro, accel } = kept.values else {
            panic!("values were converted: {kept:?}");
        };
        assert_eq!((kept.number, kept.ticks), (i as u64, *stamp));
        assert_eq!(kept.host_time, begin + (stamp - first));
        assert_eq!(
            (back.number, back.ticks, back.time_ns),
            (kept.number, kept.ticks, kept.time.ns())
        );
        let bits = |gyro: [f64; 3], accel: [f64; 3]| [gyro, accel].map(|v| v.map(f64::to_bits));
        let right = bits(
            [values[0], values[1], values[2]],
            [values[3], values[4], values[5]],
        );
        assert_eq!(bits(gyro, accel), right, "sample {i} as stored");
        assert_eq!(
            bits(back.gyro_rad_s, back.accel_m_s2),
            right,
            "sample {i} as read back"
        );
    }
}

/// Frame sets as recorded, in order of time, with every IMU sample up to the last set once.
fn sets_are_whole(input: &Input, recorded: &Contents) {
    let samples = &recorded.imu["right_shoulder/imu"];
    let mut count = 0;
    let mut next = 0;
    for (set, stored) in input.session().sets().expect("sets").zip(&recorded.sets) {
        let set = set.expect("a set");
        assert_eq!((set.number, set.time.0), (stored.number, stored.time));
        let there: Vec<(&str, u64)> = set
            .views
            .iter()
            .flatten()
            .map(|v| (&*v.camera, v.number))
            .collect();
        let named: Vec<(&str, u64)> = stored
            .members
            .iter()
            .map(|m| (m.camera.as_str(), m.number))
            .collect();
        assert_eq!(there, named);
        for sample in &set.imu[0] {
            assert_eq!(sample.number, next);
            assert!(sample.time_ns <= set.time.ns(), "{sample:?}");
            next += 1;
        }
        assert!(
            samples.get(next as usize).is_none_or(|s| s.time > set.time),
            "one too few"
        );
        count += 1;
    }
    assert_eq!(count, recorded.sets.len());
    assert!(count >= 50, "a set for each frame of the slowest camera");
}

/// An image of a recording, read by the `png` crate only.
struct Png {
    width: u32,
    height: u32,
    channels: usize,
    data: Vec<u8>,
}

impl Png {
    fn read(path: &Path) -> Self {
        let file = BufReader::new(File::open(path).expect("an image"));
        let mut reader = png::Decoder::new(file).read_info().expect("a PNG file");
        let mut data = vec![0; reader.output_buffer_size().expect("a size")];
        let info = reader.next_frame(&mut data).expect("a PNG file");
        assert_eq!(info.bit_depth, png::BitDepth::Eight);
        data.truncate(info.buffer_size());
        let channels = info.color_type.samples();
        Self {
            width: info.width,
            height: info.height,
            channels,
            data,
        }
    }

    /// Luma by the formula of JFIF (full-range BT.601).
    fn luma(&self) -> Vec<u8> {
        assert_eq!(self.channels, 3);
        let luma = |p: &[u8]| {
            (0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2])).round()
        };
        self.data
            .chunks_exact(3)
            .map(|pixel| luma(pixel) as u8)
            .collect()
    }
}

/// Peak signal-to-noise ratio of two images of 8 bits, dB.
fn psnr(a: &[u8], b: &[u8]) -> f64 {
    assert_eq!(a.len(), b.len());
    let squares = a
        .iter()
        .zip(b)
        .map(|(a, b)| u64::from(a.abs_diff(*b)).pow(2));
    let mean = squares.sum::<u64>() as f64 / a.len() as f64;
    10.0 * (255.0 * 255.0 / mean).log10()
}
