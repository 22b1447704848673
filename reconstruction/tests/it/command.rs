//! The program: its output files, messages, refusals and exit codes.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use reconstruction::input::Input;
use session_archive::handoff::Verdict;
use session_archive::layout;
use session_input::Color;

use video::AccessUnit;

use crate::session::{RecordedSession, hand_over, hand_over_with, seal};

fn session() -> (tempfile::TempDir, RecordedSession) {
    let folder = tempfile::tempdir().expect("folder");
    let recorded = hand_over(folder.path());
    (folder, recorded)
}

fn run(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_paws-reconstruct"));
    command.args(arguments).output().expect("run")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a path in UTF-8")
}

fn frames(session: &Path, out: &Path, more: &[&str]) -> Output {
    let mut arguments = vec!["frames", text(session), "--out", text(out)];
    arguments.extend(more);
    run(&arguments)
}

fn check_code(output: &Output, code: i32) {
    let shown = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{shown}");
}

/// Rows of a CSV file, the first one apart.
fn csv(path: &Path) -> (String, Vec<Vec<String>>) {
    let text = fs::read_to_string(path).expect("csv");
    let mut lines = text.lines();
    let head = lines.next().expect("a head").to_owned();
    let row = |line: &str| line.split(',').map(str::to_owned).collect();
    (head, lines.map(row).collect())
}

/// Every file below a folder, with its content.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).expect("folder") {
        let path = entry.expect("entry").path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            found.insert(path.clone(), fs::read(&path).expect("file"));
        }
    }
    found
}

#[test]
fn frames_writes_the_whole_session() {
    let (folder, recorded) = session();
    let out = folder.path().join("deep/frames");
    let output = frames(folder.path(), &out, &[]);
    check_code(&output, 0);
    let printed = String::from_utf8(output.stdout).expect("utf-8");
    let last = printed.lines().last().expect("a summary");
    assert!(
        last.starts_with("78 stereo frames in 45 sets, 500 IMU samples, nothing lost: "),
        "{last}"
    );
    assert!(!folder.path().join("deep/frames.partial").exists());

    let input = Input::open(folder.path()).expect("open");
    for camera in ["left_shoulder", "feet"] {
        let (head, rows) = csv(&out.join(camera).join("times.csv"));
        assert_eq!(head, "number,time_ns,sigma_ns,time_unreliable,set");
        let sources = recorded.camera(camera);
        assert_eq!(rows.len(), sources.len());
        for (row, source) in rows.iter().zip(sources) {
            let set = recorded.sets.iter().find(|set| {
                set.members
                    .iter()
                    .any(|m| m.camera == camera && m.number == source.number)
            });
            let expected = [
                source.number.to_string(),
                source.time.ns().to_string(),
                source.sigma_ns.to_string(),
                u8::from(source.time_unreliable).to_string(),
                set.map_or(String::new(), |s| s.number.to_string()),
            ];
            assert_eq!(row[..], expected);
        }
        for view in input.session().frames(camera).expect("frames") {
            let view = view.expect("view");
            for (eye, image) in [("left", &view.left), ("right", &view.right)] {
                let path = out.join(format!("{camera}/{eye}/{:06}.png", view.number));
                let file = BufReader::new(File::open(path).expect("png"));
                let mut reader = png::Decoder::new(file).read_info().expect("png");
                let mut pixels = vec![0; reader.output_buffer_size().expect("size")];
                let info = reader.next_frame(&mut pixels).expect("png");
                let color = match image.color {
                    Color::Grey => png::ColorType::Grayscale,
                    Color::Rgb => png::ColorType::Rgb,
                };
                assert_eq!((info.width, info.height), (image.width, image.height));
                assert_eq!(info.color_type, color);
                assert!(pixels == image.data[..], "{camera} {eye} {}", view.number);
            }
        }
    }

    let (head, rows) = csv(&out.join("sets.csv"));
    assert_eq!(head, "set,time_ns,left_shoulder,feet");
    for (row, set) in rows.iter().zip(&recorded.sets) {
        let number = |camera: &str| {
            let member = set.members.iter().find(|m| m.camera == camera);
            member.map_or(String::new(), |m| m.number.to_string())
        };
        let expected = [
            set.number.to_string(),
            set.time.to_string(),
            number("left_shoulder"),
            number("feet"),
        ];
        assert_eq!(row[..], expected);
    }
    assert_eq!(rows.len(), 45);

    let (_, rows) = csv(&out.join("imu/feet/imu.csv"));
    let samples = input.session().imu("feet/imu", ..).expect("imu");
    assert_eq!(rows.len(), samples.len());
    for (row, s) in rows.iter().zip(samples) {
        let integers = [s.number as i64, s.ticks, s.time_ns];
        let found: Vec<i64> = row[..3]
            .iter()
            .map(|n| n.parse().expect("integer"))
            .collect();
        assert_eq!(found, integers);
        assert_eq!(row[9], u8::from(s.time_unreliable).to_string());
        let found: Vec<f64> = row[3..9]
            .iter()
            .map(|n| n.parse().expect("number"))
            .collect();
        let expected = [s.gyro_rad_s, s.accel_m_s2].concat();
        assert!(
            found
                .iter()
                .zip(&expected)
                .all(|(a, b)| a.to_bits() == b.to_bits()),
            "{row:?}"
        );
    }

    let rig = fs::read(out.join("calibration.json")).expect("calibration");
    let rig: serde_json::Value = serde_json::from_slice(&rig).expect("JSON");
    assert_eq!(rig["cameras"]["left_shoulder"]["right"]["D"][4], 1.0 / 3.0);
    assert!(rig["cameras"]["feet"]["left"].is_null());
    let rotation = &rig["transforms"][0]["rotation_wxyz"];
    assert_eq!(*rotation, serde_json::json!([-0.5, 0.5, -0.5, 0.5]));
}

#[test]
fn the_same_hand_off_gives_the_same_bytes() {
    let (folder, _) = session();
    let [one, two] = ["one", "two"].map(|name| {
        let out = tempfile::tempdir().expect("folder");
        check_code(&frames(folder.path(), &out.path().join(name), &[]), 0);
        let files = files(out.path()).into_values();
        (files.collect::<Vec<_>>(), out)
    });
    assert!(one.0 == two.0 && one.0.len() == 2 * 78 + 5);
}

#[test]
fn a_part_can_be_selected() {
    let (folder, recorded) = session();
    let out = folder.path().join("every");
    check_code(&frames(folder.path(), &out, &["--every", "5"]), 0);
    let (_, rows) = csv(&out.join("left_shoulder/times.csv"));
    let expected = |source: &&crate::session::Source| {
        let mut sets = recorded.sets.iter();
        let set = sets
            .find(|s| s.members[0].number == source.number)
            .map(|s| s.number);
        set.unwrap_or(source.number) % 5 == 0
    };
    let expected = recorded
        .left_shoulder
        .iter()
        .filter(expected)
        .map(|s| s.number.to_string());
    let found: Vec<String> = rows.iter().map(|row| row[0].clone()).collect();
    assert_eq!(found, expected.collect::<Vec<_>>());
    assert_eq!(csv(&out.join("sets.csv")).1.len(), 9);
    assert_eq!(csv(&out.join("imu/feet/imu.csv")).1.len(), 500);

    let out = folder.path().join("span");
    check_code(
        &frames(folder.path(), &out, &["--from", "0.5", "--to", "1.0"]),
        0,
    );
    assert_eq!(csv(&out.join("left_shoulder/times.csv")).1.len(), 10);
    assert_eq!(csv(&out.join("imu/feet/imu.csv")).1.len(), 100);
}

#[test]
fn existing_files_are_left_alone() {
    let (folder, _) = session();
    let out = folder.path().join("frames");
    fs::create_dir(&out).expect("folder");
    fs::write(out.join("mine"), "precious").expect("write");
    let output = frames(folder.path(), &out, &[]);
    check_code(&output, 1);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("new or an empty folder"), "{said}");
    assert_eq!(fs::read_dir(&out).expect("folder").count(), 1);

    fs::remove_file(out.join("mine")).expect("remove");
    let partial = folder.path().join("frames.partial");
    fs::create_dir(&partial).expect("folder");
    let output = frames(folder.path(), &out, &[]);
    check_code(&output, 1);
    assert!(String::from_utf8_lossy(&output.stderr).contains("delete it"));
    fs::remove_dir(&partial).expect("remove");
    check_code(&frames(folder.path(), &out, &[]), 0);
    assert!(!partial.exists());
}

/// An output that could not be replaced in the end is refused before the work, and not changed.
#[test]
fn a_link_to_an_empty_folder_is_refused() {
    let (folder, _) = session();
    let (real, out) = (folder.path().join("real"), folder.path().join("frames"));
    fs::create_dir(&real).expect("folder");
    std::os::unix::fs::symlink(&real, &out).expect("link");
    let output = frames(folder.path(), &out, &[]);
    check_code(&output, 1);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("Not a directory"), "{said}");
    assert!(!said.contains("stereo frames"), "{said}");
    assert!(out.is_symlink() && !folder.path().join("frames.partial").exists());
}

#[test]
fn a_failed_run_leaves_no_output_that_looks_complete() {
    let (folder, _) = session();
    seal(folder.path(), Verdict::Fail);
    let out = folder.path().join("frames");
    let output = frames(folder.path(), &out, &[]);
    check_code(&output, 1);
    assert!(String::from_utf8_lossy(&output.stderr).contains("failed its validation"));
    assert!(!out.exists() && !folder.path().join("frames.partial").exists());
}

#[test]
fn loss_is_counted_and_has_its_own_exit_code() {
    let folder = tempfile::tempdir().expect("folder");
    hand_over_with(folder.path(), |camera, number, unit| {
        match (camera, number) {
            // Not marked as key frame: frames that depend on it cannot be decoded.
            ("left_shoulder", 100) => AccessUnit { key: false, ..unit },
            // A start code and no data that a decoder could use.
            ("feet", 121) => AccessUnit {
                data: vec![0, 0, 0, 1, 0x3f, 0x55, 0x55].into(),
                ..unit
            },
            _ => unit,
        }
    });
    let out = folder.path().join("frames");
    let output = frames(folder.path(), &out, &[]);
    check_code(&output, 3);
    let said = String::from_utf8(output.stderr).expect("utf-8");
    assert!(
        said.contains("frames of left_shoulder have no key frame"),
        "{said}"
    );
    assert!(said.contains("lost: reading frame 121 of feet: "), "{said}");
    let printed = String::from_utf8(output.stdout).expect("utf-8");
    assert!(
        printed
            .lines()
            .last()
            .is_some_and(|l| l.contains(" losses: ")),
        "{printed}"
    );

    // The remaining frames are correct, and lost ones are not replaced.
    let (_, rows) = csv(&out.join("feet/times.csv"));
    let numbers: Vec<&str> = rows.iter().map(|row| &*row[0]).collect();
    assert!(!numbers.contains(&"121") && numbers.contains(&"100") && numbers.contains(&"130"));
    assert!(!out.join("feet/left/000121.png").exists());
    for name in numbers {
        assert!(
            out.join(format!("feet/right/000{name}.png")).exists(),
            "{name}"
        );
    }
    let (_, rows) = csv(&out.join("left_shoulder/times.csv"));
    assert!(rows.len() < 50 && rows.len() > 35, "{}", rows.len());
    // Sets with a member that cannot be decoded have an empty field for it.
    let (_, rows) = csv(&out.join("sets.csv"));
    assert!(rows[0][2].is_empty());
}

#[test]
fn bad_arguments_have_their_own_exit_code() {
    let (folder, _) = session();
    let session = text(folder.path());
    for arguments in [
        &["frames", session][..],
        &["frames", session, "--out", "x", "--every", "0"],
        &["frames", session, "--out", "x", "--from", "now"],
        &[
            "frames", session, "--out", "x", "--from", "2", "--to", "2.0",
        ],
        &["depth", session],
        &[],
    ] {
        check_code(&run(arguments), 2);
    }
    let version = run(&["--version"]);
    check_code(&version, 0);
    let said = String::from_utf8_lossy(&version.stdout).into_owned();
    assert_eq!(
        said.trim(),
        concat!("paws-reconstruct ", env!("CARGO_PKG_VERSION"))
    );
}

#[test]
fn info_prints_the_content() {
    let (folder, _) = session();
    let output = run(&["info", text(&folder.path().join(layout::HANDOFF))]);
    check_code(&output, 0);
    let said = String::from_utf8(output.stdout).expect("utf-8");
    for part in [
        "0192aa00-0000-7000-8000-000000000001",
        "PASS",
        "left_shoulder: 50 stereo frames of 2 x 96x64 grey",
        "feet: 28 stereo frames of 2 x 74x50 yuv420",
        "feet/imu: 500 samples",
        "frame sets  45",
        "2.5 s, ended by duration",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    fs::remove_file(folder.path().join(layout::HANDOFF)).expect("remove");
    check_code(&run(&["info", text(folder.path())]), 1);
}

/// Nothing on standard error where nothing failed; messages never mix with results.
#[test]
fn quiet_prints_only_errors() {
    let (folder, _) = session();
    let session = text(folder.path());
    let usual = run(&["info", session]);
    for arguments in [
        &["-q", "info", session][..],
        &["info", session, "-q"],
        &["info", "--quiet", session],
        &["-v", "info", session],
        &["info", session, "-vv"],
    ] {
        let output = run(arguments);
        check_code(&output, 0);
        assert_eq!(output.stdout, usual.stdout, "{arguments:?}");
        if !arguments.iter().any(|a| a.starts_with("-v")) {
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(said, "", "{arguments:?}");
        }
    }
    check_code(&run(&["-q", "-v", "info", session]), 2);
    fs::remove_file(folder.path().join(layout::HANDOFF)).expect("remove");
    let output = run(&["-q", "info", session]);
    check_code(&output, 1);
    assert!(String::from_utf8_lossy(&output.stderr).starts_with("error: "));
}
