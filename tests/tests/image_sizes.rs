//! Images of any size through the whole daemon, the collector and into reconstruction: sizes that
//! 4:2:0 codecs cannot code are the same in archive, calibration and decoded images, and a
//! calibration of another size is refused before anything is recorded.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use capture_daemon::config::Config;
use capture_daemon::run::{RecordOptions, RecordingSummary, StopFlag, record};
use collector::commands::{handoff, import, index, validate};
use collector::target::Target;
use console_output::{Clock, Console, Outcome, Show};
use harness::contents::Contents;
use reconstruction::Input;
use reconstruction::pipeline::stages::rig::{self, RigOverrides};
use session_archive::handoff::Verdict;

const FRAMES: u32 = 12;
const DISPARITY_PX: u32 = 6;

/// Blocky texture that moves; that of the right image is shifted to the left.
fn pixel(x: u32, y: u32, frame: u32) -> u8 {
    let column = ((x + 2 * frame) / 5).wrapping_mul(2_654_435_761);
    let cell = column ^ (y / 5).wrapping_mul(40_503);
    (60 + (cell >> 7) % 120 + (x + y) % 3) as u8
}

/// A folder of pairs with a calibration that has no size of its own (KITTI).
fn folder(root: &Path, (width, height): (u32, u32)) -> PathBuf {
    for (eye, shift) in [("image_l", 0), ("image_r", DISPARITY_PX)] {
        fs::create_dir_all(root.join(eye)).expect("a folder");
        for frame in 0..FRAMES {
            let pixels = (0..height)
                .flat_map(|y| (0..width).map(move |x| pixel(x + shift, y, frame)))
                .collect::<Vec<u8>>();
            let file = File::create(root.join(eye).join(format!("{frame:06}.png")));
            let mut encoder = png::Encoder::new(file.expect("a file"), width, height);
            encoder.set_color(png::ColorType::Grayscale);
            let mut writer = encoder.write_header().expect("a header");
            writer.write_image_data(&pixels).expect("an image");
        }
    }
    let row = |shift: f64| {
        let (cx, cy) = (f64::from(width) / 2.0, f64::from(height) / 2.0);
        format!("700.0 0.0 {cx} {shift} 0.0 700.0 {cy} 0.0 0.0 0.0 1.0 0.0\n")
    };
    let calibration = [row(0.0), row(-380.0)].concat();
    fs::write(root.join("calib.txt"), calibration).expect("a calibration");
    root.to_owned()
}

fn recorded(
    set: &Path,
    out: &Path,
    calibration: Option<&Path>,
) -> anyhow::Result<RecordingSummary> {
    let calibration =
        calibration.map(|path| format!("calibration = {:?}\n", path.display().to_string()));
    let text = format!(
        "[[camera]]\nname = \"feet\"\n{}[camera.source]\nkind = \"replay\"\nrate_hz = 10.0\npath = {:?}\n",
        calibration.unwrap_or_default(),
        set.display().to_string()
    );
    let config = Config::parse(&text, Path::new("/")).expect("configuration");
    let options = RecordOptions {
        seconds: f64::from(FRAMES) / 10.0,
        virtual_time: true,
        name: "sizes".to_owned(),
        out: out.to_owned(),
    };
    record(&config, &options, &StopFlag::new(), Box::new(|_| {}))
}

/// Imports, validates, indexes and hands off; the folder in the library.
fn handed_off(session: &Path, library: &Path) -> PathBuf {
    let mut text = Vec::new();
    let mut console = Console {
        out: &mut text,
        show: Show::Nothing,
        clock: Clock::STILL,
    };
    let imported = import::run(&[session.to_owned()], library, &mut console).expect("import");
    let name = session
        .file_name()
        .and_then(|n| n.to_str())
        .expect("a name");
    let targets = [Target::find(name, Some(library)).expect("the imported session")];
    let options = validate::Options::default();
    let validated = validate::run(&targets, &options, &mut console).expect("validate");
    let indexed = index::run(&targets, &mut console).expect("index");
    let handed = handoff::run(&targets[0], None, &mut console).expect("hand off");
    let text = String::from_utf8(text).expect("text");
    assert_eq!(
        [imported, validated, indexed, handed],
        [Outcome::Fine; 4],
        "{text}"
    );
    assert!(!text.contains("another image size"), "{text}");
    targets[0].folder.clone()
}

#[test]
fn odd_sizes_are_recorded_and_reconstructed_unchanged() {
    for size in [(1241, 376), (161, 121), (160, 121)] {
        let (width, height) = size;
        let root = tempfile::tempdir().expect("folder");
        let set = folder(&root.path().join("set"), size);
        let finished = recorded(&set, &root.path().join("out"), None).expect("recording");
        assert_eq!((finished.error.as_deref(), finished.missing), (None, 0));
        let contents = Contents::read(&finished.session).expect("contents");
        let camera = &contents.manifest.cameras[0];
        assert_eq!((camera.width, camera.height), (2 * width, height));

        let handed = handed_off(&finished.session, &root.path().join("library"));
        let input = Input::open(&handed).expect("the hand-off");
        assert_ne!(input.handoff().verdict, Verdict::Fail);
        let (model, report) = rig::model(&input, &RigOverrides::default()).expect("a rig");
        assert!(report.losses.is_empty(), "{:?}", report.losses);
        for lens in [&model.cameras[0].left, &model.cameras[0].right] {
            assert_eq!((lens.width, lens.height), size);
            assert_eq!(lens.cx, f64::from(width) / 2.0);
        }
        // The images have the size of the calibration, down to the last column and row.
        let session = input.session();
        let mut frames = 0;
        for view in session.frames("feet").expect("frames") {
            let view = view.expect("a view");
            for (image, shift) in [(&view.left, 0), (&view.right, DISPARITY_PX)] {
                assert_eq!((image.width, image.height), size);
                let error: u64 = (0..height)
                    .flat_map(|y| (0..width).map(move |x| (x, y)))
                    .map(|(x, y)| {
                        let found = image.data[(y * width + x) as usize];
                        let expected = pixel(x + shift, y, view.number as u32);
                        u64::from(found.abs_diff(expected))
                    })
                    .sum();
                let mean = error as f64 / f64::from(width * height);
                assert!(
                    mean < 2.5,
                    "{width}x{height}: mean error {mean} gray levels"
                );
            }
            frames += 1;
        }
        assert_eq!(frames, FRAMES);
    }
}

#[test]
fn calibration_of_another_size_is_refused_before_recording() {
    let root = tempfile::tempdir().expect("folder");
    let set = folder(&root.path().join("set"), (161, 121));
    let eye = |name: &str, resolution: &str, rest: &str| {
        format!(
            "{name}:\n  camera_model: pinhole\n  intrinsics: [100.0, 100.0, 80.0, 60.0]\n  \
             distortion_model: radtan\n  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]\n  \
             resolution: {resolution}\n{rest}"
        )
    };
    let right_from_left = "  T_cn_cnm1:\n  - [1.0, 0.0, 0.0, -0.1]\n  - [0.0, 1.0, 0.0, 0.0]\n  \
                           - [0.0, 0.0, 1.0, 0.0]\n  - [0.0, 0.0, 0.0, 1.0]\n";
    let chain = root.path().join("camchain.yaml");
    let out = root.path().join("out");
    for (resolution, is_fine) in [
        ("[161, 121]", true),
        ("[162, 122]", false),
        ("[160, 120]", false),
    ] {
        let text = eye("cam0", resolution, "") + &eye("cam1", resolution, right_from_left);
        fs::write(&chain, text).expect("a calibration");
        let result = recorded(&set, &out, Some(&chain));
        if is_fine {
            assert_eq!(result.expect("recording").missing, 0);
            fs::remove_dir_all(&out).expect("the recording");
            continue;
        }
        let error = format!("{:#}", result.expect_err("another size"));
        let size = resolution.trim_matches(['[', ']']).replace(", ", "x");
        for part in ["feet", "161x121", &size, "to fix it", "camchain.yaml"] {
            assert!(error.contains(part), "{part}: {error}");
        }
        // Nothing was recorded.
        let sessions = fs::read_dir(&out).map_or(0, Iterator::count);
        assert_eq!(sessions, 0, "{error}");
    }
}

/// The data set's own calibration, as in EuRoC's `sensor.yaml`.
#[test]
fn calibration_of_a_data_set_of_another_size_is_refused() {
    let root = tempfile::tempdir().expect("folder");
    let set = root.path().join("set");
    for camera in ["cam0", "cam1"] {
        let folder = set.join("mav0").join(camera);
        fs::create_dir_all(folder.join("data")).expect("a folder");
        let mut list = "#timestamp [ns],filename\n".to_owned();
        for frame in 0..4_i64 {
            let name = format!("{}.png", 50_000_000 * frame);
            list += &format!("{},{name}\n", 50_000_000 * frame);
            let file = File::create(folder.join("data").join(&name)).expect("a file");
            let mut encoder = png::Encoder::new(file, 161, 121);
            encoder.set_color(png::ColorType::Grayscale);
            let mut writer = encoder.write_header().expect("a header");
            writer.write_image_data(&[90; 161 * 121]).expect("an image");
        }
        fs::write(folder.join("data.csv"), list).expect("a list");
        let text = "%YAML:1.0\nsensor_type: camera\nrate_hz: 20\nresolution: [752, 480]\n\
                    camera_model: pinhole\nintrinsics: [458.654, 457.296, 367.215, 248.375]\n\
                    distortion_model: radial-tangential\n\
                    distortion_coefficients: [-0.28, 0.07, 0.0002, 0.00002]\n\
                    T_BS:\n  cols: 4\n  rows: 4\n  data: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, \
                    0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]\n";
        fs::write(folder.join("sensor.yaml"), text).expect("a calibration");
    }
    let out = root.path().join("out");
    let error = recorded(&set, &out, None).expect_err("another size");
    let error = format!("{error:#}");
    for part in ["feet", "161x121", "752x480", "to fix it"] {
        assert!(error.contains(part), "{part}: {error}");
    }
}
