//! Common sources, from the simulator to a scene: two USB cameras as a pair with Motion-JPEG, ROS 2
//! bags with images and IMU, and video files. Each is written by third-party tools, or put into
//! driver buffers where there is no file; recorded by the daemon in virtual time with intrinsics
//! from a file, validated, handed off, and reconstructed up to the cloud.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use anyhow::bail;
use capture_daemon::config::{Config, SourceConfig};
use capture_daemon::run::{RecordOptions, RecordingSummary, StopFlag, build, record, record_built};
use capture_daemon::sources::{AnySource, ImuValues};
use collector::commands::{handoff, import, validate};
use collector::target::Target;
use collector::validation::Validation;
use console_output::{Clock, Console, Outcome, Show};
use harness::cameras::TwoCameras;
use harness::contents::Contents;
use harness::footage::bag::{self, BEGAN_NS, Images};
use harness::footage::film::{self, Film};
use harness::footage::{CAMERA, Footage, RIG};
use reconstruction::Input;
use reconstruction::evaluate::files;
use reconstruction::pipeline::observer::NoObserver;
use reconstruction::pipeline::stages::{self, Options, Preset, rig};
use reconstruction::pipeline::{Meter, Selection, Sources};
use scene_bundle::{Bundle, Provenance, outputs};
use session_archive::handoff::Verdict;
use session_archive::record::paws::gap::Cause;

/// Maximum relative error of the distance between the first and the last pose.
const MAX_DISTANCE_ERROR: f64 = 0.03;
/// The same for sources of compressed images without IMU, whose calibration states no covariance:
/// three metres determine the rotation of the right eye only in part
/// (docs/decisions/0010-odometry.md), and encoders with several threads write other bytes in every
/// run. 1.4 to 7.6 % were measured, of stated standard deviations of 14 to 19 %.
const MAX_COMPRESSED_DISTANCE_ERROR: f64 = 0.12;
/// Minimum number of points of a cloud: the four keyframes of the walk give some thousand.
const MIN_POINTS: usize = 1000;

fn walk() -> &'static Footage {
    static WALK: OnceLock<Footage> = OnceLock::new();
    WALK.get_or_init(|| Footage::walk().expect("a walk"))
}

/// A folder with the rig file and the intrinsics.
fn desk() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("folder");
    std::fs::write(folder.path().join("rig.toml"), RIG).expect("a rig file");
    let lenses = folder.path().join("lenses");
    walk().write_calibration(&lenses).expect("a calibration");
    folder
}

/// Configuration to record a source in virtual time; `source` are the keys of its section.
fn configure(folder: &Path, source: &str) -> (Config, RecordOptions) {
    let text = format!(
        "[disk]\nreserve_gb = 0.01\n[encoder]\nelement = \"x264enc\"\n[rig]\nfile = \"rig.toml\"\n[[camera]]\n\
         name = {CAMERA:?}\ncalibration = \"lenses\"\n[camera.source]\n{source}\n"
    );
    let config = Config::parse(&text, folder).expect("configuration");
    let options = RecordOptions {
        seconds: 60.0,
        virtual_time: true,
        name: "a common source".to_owned(),
        // Sessions of virtual time have the same name: each source has its own folder.
        out: folder.join(format!("recorded-{}", source.len())),
    };
    (config, options)
}

/// Records a source, with any outcome.
fn record_source(folder: &Path, source: &str) -> RecordingSummary {
    let (config, options) = configure(folder, source);
    let finished = record(&config, &options, &StopFlag::new(), Box::new(|_| {}));
    finished.expect("recording")
}

/// Records a source; it must not fail.
fn record_source_ok(folder: &Path, source: &str) -> RecordingSummary {
    let finished = record_source(folder, source);
    assert_eq!(finished.error, None);
    finished
}

/// Two USB cameras as a pair.
const PAIR: &str = "kind = \"v4l2\"\ndevice = \"/dev/video0\"\nright_device = \"/dev/video2\"\nwidth = 960\nheight = 268\n\
                    rate_hz = 15\nformat = \"MJPG\"";

/// Delay of the right one of two unsynchronized cameras, µs: they drift by 45 ppm.
fn right_delay_us(n: usize) -> i64 {
    300 + 3 * n as i64
}

/// Records the footage with [`PAIR`]; only half of a file arrives if `is_cut(frame, eye)`.
fn record_pair(
    folder: &Path,
    footage: &Footage,
    is_cut: impl Fn(usize, usize) -> bool,
) -> RecordingSummary {
    let (config, options) = configure(folder, PAIR);
    let finished = record_built(
        |start| {
            let mut built = build(&config, start)?;
            let info = built.sources[0].info().clone();
            let SourceConfig::V4l2(of) = &config.cameras[0].source else {
                bail!("found another source, expected the pair");
            };
            let cameras = TwoCameras::new(footage, of, info, right_delay_us, is_cut, start)?;
            built.sources = vec![AnySource::Scheduled(Box::new(cameras))];
            Ok(built)
        },
        &options,
        &StopFlag::new(),
        Box::new(|_| {}),
    );
    let finished = finished.expect("recording");
    assert_eq!(finished.error, None);
    finished
}

/// Imports, validates and hands off; returns the session's folder in the library.
fn hand_off(session: &Path, library: &Path) -> PathBuf {
    let mut said = Vec::new();
    let mut console = Console {
        out: &mut said,
        show: Show::Nothing,
        clock: Clock::STILL,
    };
    let imported = import::run(&[session.to_owned()], library, &mut console);
    assert_eq!(imported.expect("import"), Outcome::Fine);
    let name = session
        .file_name()
        .and_then(|n| n.to_str())
        .expect("a name");
    let target = Target::find(name, Some(library)).expect("the imported session");
    let options = validate::Options::default();
    validate::run(std::slice::from_ref(&target), &options, &mut console).expect("validate");
    handoff::run(&target, None, &mut console).expect("hand off");
    println!("{}", String::from_utf8_lossy(&said));
    target.folder.clone()
}

/// Result of a reconstruction.
struct Reconstruction {
    /// Distance from the first pose to the last, by odometry only.
    distance_m: f64,
    /// Its stated standard deviation, m.
    distance_sigma_m: f64,
    poses: usize,
    points: usize,
}

/// Reconstructs a scene, as `paws-reconstruct run` does.
fn reconstruct(session: &Path, scene: &Path) -> Reconstruction {
    let input = Input::open(session).expect("the hand-off");
    let options = Options {
        preset: Preset::Fast,
        ..Options::default()
    };
    let provenance = Provenance {
        session_id: input.handoff().session_id.clone(),
        handoff_blake3: input.handoff().seal.clone(),
        rig: rig::revision(&input, &options.rig_overrides),
        program: "tests".to_owned(),
        program_version: "0".to_owned(),
        started_civil_ns: 0,
        ended_civil_ns: None,
        judgement: None,
    };
    let sources = Sources {
        source: &input,
        hashes: BTreeMap::from([(stages::HANDOFF.to_owned(), input.handoff().seal.clone())]),
    };
    let pipeline = stages::pipeline(options).expect("stages");
    let bundle = Bundle::create_or_open(scene, provenance).expect("a bundle");
    // Without the training of Gaussians, which would take most of the time.
    let selection = Selection {
        to: Some("maps".to_owned()),
        ..Selection::default()
    };
    let outcomes = pipeline.run(&sources, &bundle, &selection, &NoObserver, &Meter::STILL);
    let outcomes = outcomes.expect("all stages");
    assert_eq!(outcomes.len(), stages::NAMES.len() - 1);
    for outcome in outcomes {
        // Poses of one camera without IMU may jump by centimetres, which feet without tags cannot
        // hide; where depends on the encoder, whose bytes differ between runs.
        let is_jump = |loss: &&String| outcome.stage == "feet" && loss.contains("jump by about");
        let losses: Vec<_> = (outcome.report.losses.iter())
            .filter(|loss| !is_jump(loss))
            .collect();
        assert!(losses.is_empty(), "{}: {losses:?}", outcome.stage);
    }
    let cloud = bundle.scene().output(outputs::CLOUD).expect("a cloud");
    let points = outputs::cloud::read(&cloud).expect("points").len();
    let loaded = files::load(scene, Some("trajectory-causal")).expect("a trajectory");
    let usable: Vec<_> = loaded.trajectory.usable().collect();
    let [first, last] = [usable[0], usable[usable.len() - 1]];
    let step = last.world_from_rig.translation() - first.world_from_rig.translation();
    // Covariances are along the axes of the rig; that of the first pose is zero.
    let along_rig = last.world_from_rig.rotation().inverse() * step.normalize();
    let covariance = last.covariance.as_ref().expect("a covariance");
    let position = covariance.matrix().fixed_view::<3, 3>(0, 0);
    let variance = along_rig.dot(&(position * along_rig));
    Reconstruction {
        distance_m: step.norm(),
        distance_sigma_m: variance.sqrt(),
        poses: usable.len(),
        points,
    }
}

/// Records and reconstructs a source that delivers every frame of the walk: see [`to_the_cloud`].
fn record_to_the_cloud(source: &str, folder: &Path, min_db: f64) -> (Contents, Validation) {
    to_the_cloud(source, &record_source_ok(folder, source), folder, min_db)
}

/// Checks the recording of the whole walk: frames, times, images, verdict, poses, cloud.
fn to_the_cloud(
    source: &str,
    finished: &RecordingSummary,
    folder: &Path,
    min_db: f64,
) -> (Contents, Validation) {
    let footage = walk();
    assert_eq!(finished.missing, 0, "{finished:?}");
    let contents = Contents::read(&finished.session).expect("contents");
    let frames = &contents.frames[CAMERA];
    assert_eq!(frames.len(), footage.frames.len());
    let mut lowest_db = f64::INFINITY;
    let decoded = contents.decode(CAMERA, |frame, image| {
        let truth = footage.image(frame.number as usize)?;
        lowest_db = lowest_db.min(video::raw_image::psnr(&truth, image));
        Ok(())
    });
    decoded.expect("decoding");
    println!("{source}: luma {lowest_db:.1} dB");
    assert!(lowest_db >= min_db, "{lowest_db} dB");

    let session = hand_off(&finished.session, &folder.join("library"));
    let validation = Validation::read(&session).expect("a validation");
    assert_ne!(
        validation.verdict,
        Verdict::Fail,
        "{:?}",
        validation.reasons
    );
    let found = reconstruct(&session, &folder.join("walk.scene"));
    let (found_m, sigma_m, points) = (found.distance_m, found.distance_sigma_m, found.points);
    let true_m = footage.distance_m(0, footage.frames.len() - 1);
    println!(
        "{source}: {} poses, {found_m:.3} m ± {sigma_m:.3} m, true {true_m:.3} m, {points} points",
        found.poses
    );
    assert_eq!(found.poses, footage.frames.len());
    assert!(points >= MIN_POINTS, "{points} points");
    let is_compressed = source == PAIR || source.contains("kind = \"video\"");
    let max_error = match is_compressed {
        true => MAX_COMPRESSED_DISTANCE_ERROR,
        false => MAX_DISTANCE_ERROR,
    };
    let error_m = (found_m - true_m).abs();
    assert!(
        error_m <= max_error * true_m && error_m <= sigma_m,
        "{found_m} m ± {sigma_m} m, true {true_m} m"
    );
    (contents, validation)
}

/// Time difference of the eyes by the validation, ns, and its verdict.
fn stereo_time_difference(validation: &Validation) -> Option<(f64, Verdict)> {
    let mut findings = validation.findings.iter();
    let found = findings.find(|f| f.metric == "camera.eyes_apart")?;
    Some((found.value, found.verdict))
}

#[test]
fn two_usb_cameras_with_motion_jpeg_are_paired() {
    let folder = desk();
    let finished = record_pair(folder.path(), walk(), |_, _| false);
    let (contents, validation) = to_the_cloud(PAIR, &finished, folder.path(), 34.0);
    assert!(contents.imu.is_empty());
    for stored in &contents.frames[CAMERA] {
        let frame = &stored.record;
        let later_ns = 1000 * right_delay_us(frame.number as usize);
        assert_eq!(frame.eyes_apart_ns, Some(later_ns));
        // It has the left timestamp, in whole microseconds.
        assert_eq!(frame.kernel_time, Some(frame.device_ticks));
        assert_eq!(frame.device_ticks % 1000, 0);
    }
    let (apart_ns, verdict) = stereo_time_difference(&validation).expect("two cameras");
    assert_eq!(verdict, Verdict::Pass);
    assert!((300_000.0..=477_000.0).contains(&apart_ns), "{apart_ns} ns");
}

#[test]
fn damaged_image_of_one_camera_is_a_gap_and_recording_continues() {
    let folder = desk();
    let short = walk().first(12);
    let finished = record_pair(folder.path(), &short, |n, eye| {
        [(5, 0), (8, 1)].contains(&(n, eye))
    });
    assert_eq!((finished.stored, finished.missing), (10, 2));
    let contents = Contents::read(&finished.session).expect("contents");
    let cause = Cause::Device as i32;
    assert_eq!(contents.gaps_of(CAMERA), [(5, 5, cause), (8, 8, cause)]);
    let details: Vec<&str> = contents.gaps.iter().map(|gap| &*gap.detail).collect();
    assert!(
        details[0].starts_with("the JPEG image is damaged: "),
        "{details:?}"
    );
    assert_eq!(
        details[1],
        "no right image was taken within 26.7 ms of the left one"
    );
}

#[test]
fn bag_with_images_and_imu_is_reconstructed() {
    let (folder, footage) = (desk(), walk());
    bag::write(
        footage,
        Images::Rgb,
        300_000,
        &folder.path().join("walk.mcap"),
    )
    .expect("a bag");
    let source = "kind = \"bag\"\npath = \"walk.mcap\"";
    let (contents, validation) = record_to_the_cloud(source, folder.path(), 40.0);
    for (stored, truth) in contents.frames[CAMERA].iter().zip(&footage.frames) {
        assert_eq!(stored.record.device_ticks, BEGAN_NS + truth.time_ns);
        assert_eq!(stored.record.eyes_apart_ns, Some(300_000));
    }
    assert_eq!(
        stereo_time_difference(&validation),
        Some((300_000.0, Verdict::Pass))
    );
    // Samples from the first image on, to the bit.
    let first = footage.frames[0].time_ns;
    let truths = footage.samples.iter().filter(|(time, ..)| *time >= first);
    let samples = &contents.imu[&format!("{CAMERA}/imu")];
    assert_eq!(samples.len(), truths.clone().count());
    for (stored, (time, gyro, accel)) in samples.iter().zip(truths) {
        assert_eq!(stored.ticks, BEGAN_NS + time);
        let (gyro, accel) = (*gyro, *accel);
        assert_eq!(stored.values, ImuValues::Si { gyro, accel });
    }
}

#[test]
fn bag_with_large_stereo_time_difference_causes_a_warning() {
    let folder = desk();
    let bag = folder.path().join("bag");
    std::fs::create_dir(&bag).expect("a folder");
    bag::write(walk(), Images::Jpeg, 2_500_000, &bag.join("bag_0.mcap")).expect("a bag");
    let source = "kind = \"bag\"\npath = \"bag\"\nleft_topic = \"/left/image\"\n\
                  right_topic = \"/right/image\"\nimu_topic = \"/imu\"";
    let (_, validation) = record_to_the_cloud(source, folder.path(), 34.0);
    assert_eq!(
        stereo_time_difference(&validation),
        Some((2_500_000.0, Verdict::Warn))
    );
}

#[test]
fn bag_without_stereo_pairs_is_refused_before_recording() {
    let folder = desk();
    let bag = folder.path().join("walk.mcap");
    bag::write(&walk().first(6), Images::Mono, 30_000_000, &bag).expect("a bag");
    let (config, options) = configure(folder.path(), "kind = \"bag\"\npath = \"walk.mcap\"");
    let refused = record(&config, &options, &StopFlag::new(), Box::new(|_| {}));
    let said = format!("{:#}", refused.expect_err("no pair"));
    for part in [
        "of 6 left images, 0 have a right one within 26.7 ms",
        "30.0 ms away in the median",
        "(/left/image at 15.00 Hz and /right/image at 15.00 Hz)",
        "name the topics of one stereo camera as left_topic and right_topic",
    ] {
        assert!(said.contains(part), "{said}");
    }
    let left = std::fs::read_dir(&options.out).expect("the folder for sessions");
    assert_eq!(left.count(), 0);
}

#[test]
fn all_image_encodings_of_a_bag_give_the_same_walk() {
    let short = walk().first(6);
    for (images, colour) in [(Images::Bgr, "yuv420"), (Images::Mono, "grey")] {
        let folder = desk();
        bag::write(&short, images, 0, &folder.path().join("walk.mcap")).expect("a bag");
        let finished = record_source_ok(
            folder.path(),
            "kind = \"bag\"\npath = \"walk.mcap\"\nimu = false",
        );
        let contents = Contents::read(&finished.session).expect("contents");
        assert_eq!(contents.frames[CAMERA].len(), 6, "{images:?}");
        assert_eq!(contents.manifest.cameras[0].colour, colour);
        assert!(contents.imu.is_empty());
        let decoded = contents.decode(CAMERA, |frame, image| {
            let db = video::raw_image::psnr(&short.image(frame.number as usize)?, image);
            assert!(db >= 40.0, "{images:?} {}: {db} dB", frame.number);
            Ok(())
        });
        decoded.expect("decoding");
    }
}

/// All images of the walk with their times from 0.
fn images(eye: Option<usize>) -> Vec<(i64, video::RawImage)> {
    let footage = walk();
    let first = footage.frames[0].time_ns;
    let image = |n: usize| match eye {
        None => footage.image(n).expect("an image"),
        Some(eye) => footage.one_eye(n, eye).expect("an image"),
    };
    let frames = footage.frames.iter().enumerate();
    frames
        .map(|(n, frame)| (frame.time_ns - first, image(n)))
        .collect()
}

#[test]
fn video_file_with_side_by_side_images_is_reconstructed() {
    let folder = desk();
    film::write(Film::Mp4, 15, images(None), &folder.path().join("walk.mp4")).expect("a film");
    let source = "kind = \"video\"\npath = \"walk.mp4\"";
    let (contents, validation) = record_to_the_cloud(source, folder.path(), 34.0);
    assert!(contents.imu.is_empty());
    assert_eq!(stereo_time_difference(&validation), None);
}

#[test]
fn motion_jpeg_video_is_reconstructed() {
    let folder = desk();
    film::write(
        Film::MjpegAvi,
        15,
        images(None),
        &folder.path().join("walk.avi"),
    )
    .expect("a film");
    record_to_the_cloud("kind = \"video\"\npath = \"walk.avi\"", folder.path(), 34.0);
}

/// Matroska rounds times; a whole walk in it is beyond the limits of `paws validate`, see
/// docs/reference/sources.md.
#[test]
fn matroska_video_has_times_in_whole_milliseconds() {
    let folder = desk();
    let frames = 6;
    let images = images(None).into_iter().take(frames);
    film::write(Film::Mkv, 15, images, &folder.path().join("walk.mkv")).expect("a film");
    let finished = record_source_ok(folder.path(), "kind = \"video\"\npath = \"walk.mkv\"");
    assert_eq!((finished.stored, finished.missing), (frames as u64, 0));
    let contents = Contents::read(&finished.session).expect("contents");
    let ticks = contents.frames[CAMERA]
        .iter()
        .map(|f| f.record.device_ticks);
    let ticks: Vec<i64> = ticks.collect();
    let truths = &walk().frames;
    for (found, truth) in ticks.iter().zip(truths) {
        let off_ns = (found - ticks[0]) - (truth.time_ns - truths[0].time_ns);
        assert!(off_ns.abs() <= 1_000_000, "{ticks:?}");
    }
}

#[test]
fn two_video_files_one_per_eye_are_paired() {
    let folder = desk();
    for (eye, name) in ["left.mp4", "right.mp4"].into_iter().enumerate() {
        let path = folder.path().join(name);
        film::write(Film::Mp4, 15, images(Some(eye)), &path).expect("a film");
    }
    let source = "kind = \"video\"\npath = \"left.mp4\"\nright_path = \"right.mp4\"";
    let (_, validation) = record_to_the_cloud(source, folder.path(), 34.0);
    assert_eq!(
        stereo_time_difference(&validation),
        Some((0.0, Verdict::Pass))
    );
}

#[test]
fn two_video_files_without_pairs_end_with_an_error() {
    let folder = desk();
    let frames = 12;
    for (eye, name) in ["left.mp4", "right.mp4"].into_iter().enumerate() {
        let path = folder.path().join(name);
        let images = images(Some(eye)).into_iter().take(frames);
        film::write(Film::Mp4, 15, images, &path).expect("a film");
    }
    // The right camera starts 30 ms later, which is more than two fifths of a period: nothing is
    // paired.
    let source =
        "kind = \"video\"\npath = \"left.mp4\"\nright_path = \"right.mp4\"\nright_later_ms = 30";
    let finished = record_source(folder.path(), source);
    let error = finished.error.as_deref().expect("no pair is an error");
    for part in [
        "left_shoulder cannot be read: no image of the right file was taken within 26.7 ms of one of the left file",
        "the nearest two are 30.0 ms apart",
        "left images: 12 at 15.00 Hz from 0.000 s to 0.733 s",
        "right images: 12 at 15.00 Hz from 0.030 s to 0.763 s",
        "say by right_later_ms how much later the right file began",
    ] {
        assert!(error.contains(part), "{error}");
    }
    // There is a session, which states why it is empty.
    assert_eq!(
        (finished.stored, &*finished.absent),
        (0, &[CAMERA.to_owned()][..])
    );
    let contents = Contents::read(&finished.session).expect("contents");
    assert!(contents.frames[CAMERA].is_empty());
    let events = contents.events.iter();
    let said: Vec<&str> = events.map(|(_, event)| event.text.as_str()).collect();
    for part in ["12 have no left one within 26.7 ms", error] {
        assert!(said.iter().any(|text| text.contains(part)), "{said:?}");
    }
}
