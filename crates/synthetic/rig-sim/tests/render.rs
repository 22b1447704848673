//! A rendered walk, read by other crates.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock};

use cad_transforms::rig::Rig;
use calibration_files::read_stereo;
use camera_models::Distortion;
use rig_sim::camera::Quality;
use rig_sim::faults::Faults;
use rig_sim::render::{Job, RenderError, render};
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation};

const RIG: &str = include_str!("../../../../cad-transforms/rigs/example.toml");

/// BLAKE3 of all files of the walk below. It changes with every change of an image or a number, and
/// with the PNG encoder; an unintended change indicates a dependence on the machine or on threads.
const HASH: &str = "f6f94c1e6ec6153d969727ce4855a405948b12e7b3757994bd4aac9b12c09e15";

fn simulation() -> Arc<Simulation> {
    let settings = Settings {
        kind: Kind::Pavement,
        lighting: Lighting::Day,
        seed: 1,
        seconds: 1.0,
        rate_hz: 10.0,
        width: 64,
        height: 36,
        quality: Quality::ACCURATE,
    };
    Arc::new(Simulation::new(&settings, &Rig::parse(RIG).unwrap()).unwrap())
}

/// No faults.
static NO_FAULTS: LazyLock<Faults> = LazyLock::new(Faults::default);
static EXAMPLE: LazyLock<Rig> = LazyLock::new(|| Rig::parse(RIG).unwrap());

fn job(threads: usize) -> Job<'static> {
    Job {
        rig: &EXAMPLE,
        rig_text: RIG,
        truth: true,
        session: false,
        faults: &NO_FAULTS,
        threads,
    }
}

/// All files below a folder, sorted.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => found.extend(files(&path)),
            false => found.push(path),
        }
    }
    found.sort();
    found
}

fn hash(folder: &Path) -> String {
    let mut hasher = blake3::Hasher::new();
    for file in files(folder) {
        let name = file.strip_prefix(folder).unwrap();
        hasher.update(name.as_os_str().as_encoded_bytes());
        hasher.update(&fs::read(&file).unwrap());
    }
    hasher.finalize().to_hex().to_string()
}

fn rows(path: PathBuf) -> Vec<Vec<f64>> {
    let text = fs::read_to_string(path).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines
        .map(|line| {
            let words = line.split([',', ' ']);
            words.map(|word| word.parse().unwrap()).collect()
        })
        .collect()
}

#[test]
fn rendered_bytes_are_independent_of_threads_and_readable() {
    let folder = tempfile::tempdir().unwrap();
    let simulation = simulation();
    let out = folder.path().join("three");
    render(&simulation, &job(3), &out, &|| {}).unwrap();
    let one = folder.path().join("one");
    render(&simulation, &job(1), &one, &|| {}).unwrap();
    assert_eq!(hash(&out), hash(&one));
    assert_eq!(hash(&out), HASH, "images or numbers of a walk have changed");

    let rig = Rig::parse(RIG).unwrap();
    for (number, camera) in simulation.cameras().iter().enumerate() {
        let root = out.join(&camera.name);
        let (calibration, notes) = read_stereo(&root, 64, 36).unwrap();
        assert!(notes.is_empty(), "{notes:?}");
        for (found, expected) in [calibration.left, calibration.right]
            .iter()
            .zip(&camera.models)
        {
            assert_eq!((found.fx, found.fy), (expected.fx, expected.fy));
            assert_eq!((found.cx, found.cy), (expected.cx, expected.cy));
            let Distortion::RadTan5 { k1, k2, p1, p2, .. } = expected.distortion else {
                panic!("{:?}", expected.distortion);
            };
            assert_eq!(found.distortion, Distortion::RadTan4 { k1, k2, p1, p2 });
        }
        let frame = |part: &str| format!("{}/{part}", camera.name).parse().unwrap();
        let expected = rig.transform(&frame("right"), &frame("left")).unwrap();
        let off = calibration.right_from_left.inverse() * expected;
        assert!(off.distance_m() < 1e-12 && off.angle_rad() < 1e-9);
        let imu = calibration.imu.unwrap();
        let expected = rig.transform(&frame("imu"), &frame("left")).unwrap();
        assert!((imu.imu_from_left.inverse() * expected).distance_m() < 1e-12);
        assert_eq!(imu.rate_hz, 400.0);
        assert!(imu.noise.is_some());

        let samples = rows(root.join("mav0/imu0/data.csv"));
        assert_eq!(samples.len(), 401);
        assert_eq!(samples[400][0], 1e9);
        // At rest the IMU measures gravity.
        let force = samples[0][4..].iter().map(|v| v * v).sum::<f64>().sqrt();
        assert!((force - 9.8).abs() < 1.0, "{force}");
        let state = rows(root.join("mav0/state_groundtruth_estimate0/data.csv"));
        assert_eq!((state.len(), state[0].len()), (401, 17));
        let expected = simulation.imus()[number].imu_from_rig.inverse();
        let arm = expected.distance_m();
        let rig = simulation.walker().rig(0.5).position;
        let far = (0..3)
            .map(|i| (state[200][1 + i] - rig[i]).powi(2))
            .sum::<f64>();
        assert!((far.sqrt() - arm).abs() < 1e-9);

        let layers = ["cam", "depth", "class", "instance", "flow"];
        for name in [0, 1]
            .map(|eye| layers.map(|l| format!("{l}{eye}")))
            .as_flattened()
        {
            let list = fs::read_to_string(root.join("mav0").join(name).join("data.csv")).unwrap();
            let names: Vec<&str> = list
                .lines()
                .skip(1)
                .map(|l| l.split_once(',').unwrap().1)
                .collect();
            assert_eq!(names.len(), 10);
            assert_eq!(names[0], "50000000.png");
            for image in names {
                let path = root.join("mav0").join(name).join("data").join(image);
                let file = std::io::BufReader::new(fs::File::open(path).unwrap());
                let mut reader = png::Decoder::new(file).read_info().unwrap();
                let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
                reader.next_frame(&mut pixels).unwrap();
                assert_eq!(reader.info().size(), (64, 36));
                assert!(
                    pixels.iter().any(|&v| v != pixels[0]),
                    "{name}: {image} is blank"
                );
            }
        }
    }
    assert_eq!(rows(out.join("rig.kitti.txt")).len(), 10);
    let tum = rows(out.join("rig.tum"));
    assert_eq!((tum.len(), tum[0].len(), tum[9][0]), (10, 8, 0.95));
    let expected = simulation.walker().rig(0.95);
    assert_eq!(tum[9][1], expected.position.x);
    assert_eq!(tum[9][7], expected.rotation.w);
    let contacts = fs::read_to_string(out.join("contacts.csv")).unwrap();
    assert!(
        contacts
            .lines()
            .nth(1)
            .unwrap()
            .starts_with("left,-1000000000,")
    );
    assert_eq!(fs::read_to_string(out.join("rig.toml")).unwrap(), RIG);
}

#[test]
fn existing_files_are_not_modified() {
    let folder = tempfile::tempdir().unwrap();
    let simulation = simulation();
    let occupied = folder.path().join("occupied");
    fs::create_dir(&occupied).unwrap();
    fs::write(occupied.join("mine"), "text").unwrap();
    let error = render(&simulation, &job(1), &occupied, &|| {}).unwrap_err();
    assert!(matches!(error, RenderError::Occupied(_)), "{error}");
    assert_eq!(files(folder.path()), [occupied.join("mine")]);

    let unfinished = folder.path().join("new.unfinished");
    fs::create_dir(&unfinished).unwrap();
    let error = render(&simulation, &job(1), &folder.path().join("new"), &|| {}).unwrap_err();
    assert!(matches!(error, RenderError::Unfinished(_)), "{error}");
    assert!(unfinished.is_dir());

    // An empty folder is accepted, and nothing is left beside it.
    let empty = folder.path().join("empty");
    fs::create_dir(&empty).unwrap();
    render(&simulation, &job(3), &empty, &|| {}).unwrap();
    assert!(empty.join("rig.tum").is_file());
    assert!(!folder.path().join("empty.unfinished").exists());
}
