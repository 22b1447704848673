//! What people have, from the simulator to a scene: bags of ROS 2 with images and IMU, and video files. Each is written by
//! tools of others, recorded by the daemon in virtual time with the lenses in a file, validated, handed over, and
//! reconstructed as far as the poses.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use capture_daemon::config::Config;
use capture_daemon::run::{Finished, RecordOptions, StopFlag, record};
use capture_daemon::sources::ImuValues;
use collector::console::{Clock, Console, Show};
use collector::outcome::Outcome;
use collector::target::Target;
use collector::validation::Validation;
use collector::{handoff, importing, validate};
use reconstruction::Input;
use reconstruction::evaluate::files;
use reconstruction::pipeline::stages::{self, Options, Preset, rig};
use reconstruction::pipeline::watch::Unwatched;
use reconstruction::pipeline::{Meter, Selection, Sources};
use scene_bundle::{Bundle, Provenance};
use session_archive::handoff::Verdict;
use tests::contents::Contents;
use tests::footage::bag::{self, BEGAN_NS, Images};
use tests::footage::film::{self, Film};
use tests::footage::{CAMERA, Footage, RIG};

/// Off the true length of the way from the first pose to the last, at most.
const OFF: f64 = 0.03;

fn walk() -> &'static Footage {
    static WALK: OnceLock<Footage> = OnceLock::new();
    WALK.get_or_init(|| Footage::walk().expect("a walk"))
}

/// A folder with the rig and the lenses in it.
fn desk() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("folder");
    std::fs::write(folder.path().join("rig.toml"), RIG).expect("a rig file");
    let lenses = folder.path().join("lenses");
    walk().write_calibration(&lenses).expect("a calibration");
    folder
}

/// Records a source in virtual time; `source` are the keys of its section.
fn recorded(folder: &Path, source: &str) -> Finished {
    let text = format!(
        "[disk]\nreserve_gb = 0.01\n[encoder]\nelement = \"x264enc\"\n[rig]\nfile = \"rig.toml\"\n[[camera]]\n\
         name = {CAMERA:?}\ncalibration = \"lenses\"\n[camera.source]\n{source}\n"
    );
    let config = Config::parse(&text, folder).expect("configuration");
    let options = RecordOptions {
        seconds: 60.0,
        virtual_time: true,
        name: "what people have".to_owned(),
        // Sessions of virtual time have one name: each source has a folder of its own.
        out: folder.join(format!("recorded-{}", source.len())),
    };
    let finished = record(&config, &options, &StopFlag::new(), Box::new(|_| {}));
    let finished = finished.expect("recording");
    assert_eq!(finished.error, None);
    finished
}

/// Imports, validates and hands over; gives the session's folder in the library.
fn handed(session: &Path, library: &Path) -> PathBuf {
    let mut said = Vec::new();
    let mut console = Console {
        out: &mut said,
        show: Show::Nothing,
        clock: Clock::STILL,
    };
    let imported = importing::run(&[session.to_owned()], library, &mut console);
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
    target.folder
}

/// Finds the poses and gives how far the last one is from the first, and how many there are.
fn reconstructed(session: &Path, scene: &Path) -> (f64, usize) {
    let input = Input::open(session).expect("the hand-off");
    let options = Options {
        preset: Preset::Fast,
        ..Options::default()
    };
    let provenance = Provenance {
        session_id: input.handoff().session_id.clone(),
        handoff_blake3: input.handoff().seal.clone(),
        rig: rig::revision(&input, &options.told),
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
    let selection = Selection {
        to: Some("odometry".to_owned()),
        ..Selection::default()
    };
    let outcomes = pipeline.run(&sources, &bundle, &selection, &Unwatched, &Meter::STILL);
    for outcome in outcomes.expect("rig and odometry") {
        assert!(
            outcome.report.losses.is_empty(),
            "{:?}",
            outcome.report.losses
        );
    }
    let loaded = files::load(scene, Some("trajectory-causal")).expect("a trajectory");
    let usable: Vec<_> = loaded.trajectory.usable().collect();
    let place = |pose: usize| *usable[pose].world_from_rig.translation();
    let distance_m = (place(usable.len() - 1) - place(0)).norm();
    (distance_m, usable.len())
}

/// The whole way of a source that brings every frame of the walk: frames, times, images, verdict, poses.
fn whole_way(source: &str, folder: &Path, least_db: f64) -> (Contents, Validation) {
    let footage = walk();
    let finished = recorded(folder, source);
    assert_eq!(finished.missing, 0, "{finished:?}");
    let contents = Contents::read(&finished.session).expect("contents");
    let frames = &contents.frames[CAMERA];
    assert_eq!(frames.len(), footage.frames.len());
    let mut lowest_db = f64::INFINITY;
    let decoded = contents.decode(CAMERA, |frame, picture| {
        let truth = footage.picture(frame.number as usize)?;
        lowest_db = lowest_db.min(video::picture::psnr(&truth, picture));
        Ok(())
    });
    decoded.expect("decoding");
    println!("{source}: luma {lowest_db:.1} dB");
    assert!(lowest_db >= least_db, "{lowest_db} dB");

    let session = handed(&finished.session, &folder.join("library"));
    let validation = Validation::read(&session).expect("a validation");
    assert_ne!(
        validation.verdict,
        Verdict::Fail,
        "{:?}",
        validation.reasons
    );
    let (found_m, poses) = reconstructed(&session, &folder.join("walk.scene"));
    let true_m = footage.distance_m(0, footage.frames.len() - 1);
    println!("{source}: {poses} poses, {found_m:.3} m, really {true_m:.3} m");
    assert_eq!(poses, footage.frames.len());
    assert!(
        (found_m / true_m - 1.0).abs() <= OFF,
        "{found_m} m, really {true_m} m"
    );
    (contents, validation)
}

/// By how much the validation says that the eyes are apart, ns, and its verdict on that.
fn eyes_apart(validation: &Validation) -> Option<(f64, Verdict)> {
    let mut findings = validation.findings.iter();
    let found = findings.find(|f| f.metric == "camera.eyes_apart")?;
    Some((found.value, found.verdict))
}

#[test]
fn a_bag_with_images_and_imu() {
    let (folder, footage) = (desk(), walk());
    bag::write(
        footage,
        Images::Rgb,
        300_000,
        &folder.path().join("walk.mcap"),
    )
    .expect("a bag");
    let source = "kind = \"bag\"\npath = \"walk.mcap\"";
    let (contents, validation) = whole_way(source, folder.path(), 40.0);
    for (stored, truth) in contents.frames[CAMERA].iter().zip(&footage.frames) {
        assert_eq!(stored.record.device_ticks, BEGAN_NS + truth.time_ns);
        assert_eq!(stored.record.eyes_apart_ns, Some(300_000));
    }
    assert_eq!(eyes_apart(&validation), Some((300_000.0, Verdict::Pass)));
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
fn a_bag_of_compressed_images_whose_eyes_are_too_far_apart_is_warned_of() {
    let folder = desk();
    let bag = folder.path().join("bag");
    std::fs::create_dir(&bag).expect("a folder");
    bag::write(walk(), Images::Jpeg, 2_500_000, &bag.join("bag_0.mcap")).expect("a bag");
    let source = "kind = \"bag\"\npath = \"bag\"\nleft_topic = \"/left/image\"\n\
                  right_topic = \"/right/image\"\nimu_topic = \"/imu\"";
    let (_, validation) = whole_way(source, folder.path(), 34.0);
    assert_eq!(eyes_apart(&validation), Some((2_500_000.0, Verdict::Warn)));
}

#[test]
fn every_encoding_of_a_bag_is_the_same_walk() {
    let short = walk().first(6);
    for (images, colour) in [(Images::Bgr, "yuv420"), (Images::Mono, "grey")] {
        let folder = desk();
        bag::write(&short, images, 0, &folder.path().join("walk.mcap")).expect("a bag");
        let finished = recorded(
            folder.path(),
            "kind = \"bag\"\npath = \"walk.mcap\"\nimu = false",
        );
        let contents = Contents::read(&finished.session).expect("contents");
        assert_eq!(contents.frames[CAMERA].len(), 6, "{images:?}");
        assert_eq!(contents.manifest.cameras[0].colour, colour);
        assert!(contents.imu.is_empty());
        let decoded = contents.decode(CAMERA, |frame, picture| {
            let db = video::picture::psnr(&short.picture(frame.number as usize)?, picture);
            assert!(db >= 40.0, "{images:?} {}: {db} dB", frame.number);
            Ok(())
        });
        decoded.expect("decoding");
    }
}

/// All pictures of the walk with their times from 0.
fn pictures(eye: Option<usize>) -> Vec<(i64, video::Picture)> {
    let footage = walk();
    let first = footage.frames[0].time_ns;
    let picture = |n: usize| match eye {
        None => footage.picture(n).expect("a picture"),
        Some(eye) => footage.one_eye(n, eye).expect("a picture"),
    };
    let frames = footage.frames.iter().enumerate();
    frames
        .map(|(n, frame)| (frame.time_ns - first, picture(n)))
        .collect()
}

#[test]
fn a_video_file_with_both_eyes_side_by_side() {
    let folder = desk();
    film::write(
        Film::Mp4,
        15,
        pictures(None),
        &folder.path().join("walk.mp4"),
    )
    .expect("a film");
    let source = "kind = \"video\"\npath = \"walk.mp4\"";
    let (contents, validation) = whole_way(source, folder.path(), 34.0);
    assert!(contents.imu.is_empty());
    assert_eq!(eyes_apart(&validation), None);
}

#[test]
fn a_film_of_motion_jpeg() {
    let folder = desk();
    film::write(
        Film::MjpegAvi,
        15,
        pictures(None),
        &folder.path().join("walk.avi"),
    )
    .expect("a film");
    whole_way("kind = \"video\"\npath = \"walk.avi\"", folder.path(), 34.0);
}

#[test]
fn two_video_files_one_for_each_eye() {
    let folder = desk();
    for (eye, name) in ["left.mp4", "right.mp4"].into_iter().enumerate() {
        let path = folder.path().join(name);
        film::write(Film::Mp4, 15, pictures(Some(eye)), &path).expect("a film");
    }
    let source = "kind = \"video\"\npath = \"left.mp4\"\nright_path = \"right.mp4\"";
    let (_, validation) = whole_way(source, folder.path(), 34.0);
    assert_eq!(eyes_apart(&validation), Some((0.0, Verdict::Pass)));

    // The right camera was started 30 ms later, which is beyond two fifths of a period: nothing is a pair.
    let late = format!("{source}\nright_later_ms = 30");
    let finished = recorded(folder.path(), &late);
    let contents = Contents::read(&finished.session).expect("contents");
    assert!(contents.frames[CAMERA].is_empty());
    let said: Vec<&str> = contents
        .events
        .iter()
        .map(|(_, e)| e.text.as_str())
        .collect();
    assert!(
        said.iter()
            .any(|text| text.contains("60 have no left one within 26.7 ms")),
        "{said:?}"
    );
}
