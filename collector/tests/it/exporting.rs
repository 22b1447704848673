//! Exports: the files contain the recorded data.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use calibration_files::read_stereo;
use camera_models::Distortion;
use collector::commands::export::{self, Format};
use collector::commands::validate::{Options, validate};
use collector::target::Target;
use console_output::Outcome;
use session_archive::handoff::Verdict;
use session_archive::index::{Access, Index};
use session_archive::reader::SessionReader;
use session_archive::storage::DiskStorage;

use crate::images::image;
use crate::support::{MS, START, Session, calib_program, capture};

fn export(session: &Path, format: Format, out: &Path) -> (Outcome, String) {
    let target = Target::find(session.to_str().unwrap(), None).unwrap();
    let (outcome, text) = capture(|console| export::run(&target, format, out, console));
    (outcome.unwrap(), text)
}

#[test]
fn tables_hold_every_sample_in_si_units() {
    let folder = tempfile::tempdir().unwrap();
    let (source, out) = (folder.path().join("s"), folder.path().join("out"));
    let mut session = Session::good(1.0);
    session.drop_frames(0, 110, 111, true);
    session.write(&source);
    assert_eq!(export(&source, Format::Csv, &out).0, Outcome::Fine);
    let lines = |name: &str| -> Vec<String> {
        let text = fs::read_to_string(out.join(name)).unwrap();
        text.lines().map(str::to_owned).collect()
    };
    let imu = lines("feet_imu.csv");
    assert_eq!(imu.len(), 201);
    assert!(imu[0].starts_with("number,time_ns,sigma_ns,host_time_ns,device_ticks,gyro_x_rad_s"));
    // Sample 21: the second of batch 1, counts 3 4 5 minus 6, scale 0.5; 100 - 3 4 5 minus 1, 0.25.
    let time = START + 21 * 5 * MS;
    let expected = format!(
        "21,{time},10000,{},{},-1.5,-1,-0.5,24,23.75,23.5,25.12,0",
        time + MS,
        21 * 128
    );
    assert_eq!(imu[22], expected);
    let frames = lines("left_shoulder_frames.csv");
    assert_eq!(frames.len(), 1 + 31 - 2);
    assert_eq!(
        frames[1],
        format!("100,{START},20000,{},,0,,200,1,0,1,0", START + 3 * MS)
    );
    let events = lines("events.csv");
    assert_eq!(
        events[2],
        format!(
            "{},mark,control,\"the \"\"stairs\"\", up\"",
            START + 500 * MS
        )
    );
    let gaps = lines("gaps.csv");
    assert!(
        gaps[1].starts_with("left_shoulder,110,111,2,encoder overload,"),
        "{}",
        gaps[1]
    );
    let sets = lines("frame_sets.csv");
    assert_eq!(sets.len(), 1 + 29);
    // The slow camera has no frame for the second set.
    assert!(sets[2].ends_with(",,"), "{}", sets[2]);
    let used = capture(|console| {
        let target = Target::find(source.to_str().unwrap(), None).unwrap();
        export::run(&target, Format::Csv, &out, console)
    });
    let error = used.0.unwrap_err().to_string();
    assert!(error.contains("new or an empty folder"), "{error}");
}

#[test]
fn euroc_folders_have_stereo_images_imu_and_calibration() {
    let folder = tempfile::tempdir().unwrap();
    let (source, out) = (folder.path().join("s"), folder.path().join("out"));
    let mut session = Session::decodable(1.0);
    session.spec.cameras[1].colour = "yuv420".to_owned();
    session.write(&source);
    let (outcome, text) = export(&source, Format::Euroc, &out);
    assert_eq!(outcome, Outcome::Fine, "{text}");

    // Our own reader of such folders reads it.
    let (stereo, _) = read_stereo(&out.join("feet"), 64, 48).unwrap();
    assert_eq!((stereo.left.fx, stereo.left.fy), (50.0, 51.0));
    assert_eq!((stereo.left.cx, stereo.left.cy), (32.0, 24.0));
    assert_eq!(
        stereo.left.distortion,
        Distortion::RadTan4 {
            k1: -0.1,
            k2: 0.02,
            p1: 0.001,
            p2: -0.002
        }
    );
    let near = |found: [f64; 3], expected: [f64; 3]| {
        let off = found.iter().zip(expected).map(|(a, b)| (a - b).abs());
        assert!(off.fold(0.0, f64::max) < 1e-9, "{found:?} {expected:?}");
    };
    near(stereo.right_from_left.translation_m(), [-0.063, 0.0, 0.0]);
    // The IMU is rotated by 90 degrees about z: its x axis is the eye's y axis. Stored as w x y z;
    // in any other order this would be another rotation.
    let imu = stereo.imu.unwrap();
    near(imu.imu_from_left.rotate([0.0, 1.0, 0.0]), [1.0, 0.0, 0.0]);
    near(
        imu.imu_from_left.inverse().apply([0.0; 3]),
        [0.01, 0.02, 0.03],
    );
    assert_eq!(imu.rate_hz, 200.0);

    let data = out.join("feet/mav0/cam0/data.csv");
    let list = fs::read_to_string(data).unwrap();
    let rows: Vec<&str> = list.lines().collect();
    assert_eq!(rows.len(), 1 + 15);
    assert_eq!(rows[0], "#timestamp [ns],filename");
    let second = START + 12 * MS + 66_666_666;
    assert_eq!(rows[2], format!("{second},{second}.png"));
    let imu = fs::read_to_string(out.join("feet/mav0/imu0/data.csv")).unwrap();
    assert_eq!(imu.lines().count(), 201);
    let last = imu.lines().last().unwrap();
    assert!(
        last.starts_with(&format!("{},", START + 995 * MS)),
        "{last}"
    );

    // The images are the recorded ones, left and right not swapped.
    let whole = image(2, 1, 128, 48);
    for (cam, side) in [("cam0", 0), ("cam1", 64)] {
        let path = out.join(format!("feet/mav0/{cam}/data/{second}.png"));
        let (pixels, kind) = decode(&path);
        assert_eq!(kind, png::ColorType::Grayscale);
        let seen = whole.luma().unwrap();
        let worst = (0..48 * 64)
            .map(|i| seen[i / 64 * 128 + side + i % 64].abs_diff(pixels[i]))
            .max();
        assert!(worst.unwrap() <= 6, "{cam} has the error {worst:?}");
    }
    let (pixels, kind) = decode(&out.join(format!(
        "right_shoulder/mav0/cam0/data/{}.png",
        START + 20_000
    )));
    assert_eq!((pixels.len(), kind), (64 * 48 * 3, png::ColorType::Rgb));
}

/// EuRoC has no column for host times, so it needs none.
#[test]
fn samples_without_host_time_are_in_euroc_folders_and_not_in_tables() {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("s");
    let mut session = Session::decodable(0.5);
    session.imu[3].host_times.truncate(12);
    session.write(&source);
    let first_column = |format, file: &str| -> Vec<i64> {
        let out = folder.path().join(file.replace('/', "_"));
        let (outcome, text) = export(&source, format, &out);
        assert_eq!(outcome, Outcome::Fine, "{text}");
        let text = fs::read_to_string(out.join(file)).unwrap();
        let rows = text.lines().skip(1);
        rows.map(|row| row.split(',').next().unwrap().parse().unwrap())
            .collect()
    };
    let numbers: Vec<i64> = (0..100).filter(|n| !(72..80).contains(n)).collect();
    assert_eq!(first_column(Format::Csv, "feet_imu.csv"), numbers);
    let times: Vec<i64> = (0..100).map(|n| START + n * 5 * MS).collect();
    assert_eq!(
        first_column(Format::Euroc, "feet/mav0/imu0/data.csv"),
        times
    );
}

fn decode(path: &Path) -> (Vec<u8>, png::ColorType) {
    let file = std::io::BufReader::new(fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((info.width, info.height), (64, 48));
    pixels.truncate(info.buffer_size());
    (pixels, info.color_type)
}

#[test]
fn mp4_files_contain_the_access_units_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let (source, out) = (folder.path().join("s"), folder.path().join("out"));
    let session = Session::decodable(1.0);
    session.write(&source);
    let (outcome, text) = export(&source, Format::Mp4, &out);
    assert_eq!(outcome, Outcome::Fine, "{text}");
    let origin = START + 12 * MS;
    let line = text.lines().last().unwrap();
    assert!(
        line.ends_with(&format!("15 frames, 0 in the file is {origin} ns")),
        "{text}"
    );
    // Without re-encoding every slice is in the file byte for byte, after its length.
    let file = fs::read(out.join("feet.mp4")).unwrap();
    for p in session.stereo_frames.iter().filter(|p| p.camera == 2) {
        let nals = video::annexb::nals(&p.unit);
        for nal in nals.filter(|n| n.is_slice(video::Codec::H264)) {
            let found = file.windows(nal.bytes.len()).any(|w| w == nal.bytes);
            assert!(found, "a slice of frame {} is not there", p.frame.number);
        }
    }
}

/// Damaged data cannot be exported, and every format reports it.
#[test]
fn damage_is_reported_by_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("s");
    Session::decodable(2.0).write(&source);
    let segment = source.join("segments/000000.mcap");
    let mut bytes = fs::read(&segment).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&segment, bytes).unwrap();
    for (format, name) in [
        (Format::Euroc, "euroc"),
        (Format::Mp4, "mp4"),
        (Format::Csv, "csv"),
    ] {
        let (outcome, text) = export(&source, format, &folder.path().join(name));
        assert_eq!(outcome, Outcome::Loss, "{text}");
        assert!(text.contains("1 damaged place left out"), "{text}");
    }
}

#[test]
fn streams_with_colliding_file_names_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    for (i, (camera, imu)) in [("feet_imu", "feet/imu"), ("feet", "events")]
        .iter()
        .enumerate()
    {
        let source = folder.path().join(format!("s{i}"));
        let mut session = Session::good(0.1);
        session.spec.cameras[2].name = (*camera).to_owned();
        session.spec.imus[0].name = (*imu).to_owned();
        session.calibrations.clear();
        session.clocks.clear();
        session.imu.clear();
        session.write(&source);
        let target = Target::find(source.to_str().unwrap(), None).unwrap();
        let out = folder.path().join("out");
        let refused = capture(|console| export::run(&target, Format::Csv, &out, console)).0;
        let error = refused.unwrap_err().to_string();
        assert!(error.contains("written to files named"), "{error}");
        assert!(!out.exists());
    }
}

#[test]
fn decode_check_finds_errors_that_checksums_cannot() {
    let folder = tempfile::tempdir().unwrap();
    let deep = |session: &Session, name: &str| {
        let path = folder.path().join(name);
        session.write(&path);
        let options = Options {
            deep: true,
            calib_program: calib_program(folder.path()),
            ..Options::default()
        };
        let result = capture(|console| validate(&path, &options, console)).0;
        result.unwrap().validation
    };
    let mut session = Session::decodable(1.0);
    let good = deep(&session, "good");
    assert_eq!(good.verdict, Verdict::Pass, "{:?}", good.reasons);
    let of = |v: &collector::validation::Validation| -> Vec<f64> {
        let findings = v.findings.iter().filter(|f| f.metric == "camera.undecoded");
        findings.map(|f| f.value).collect()
    };
    assert_eq!(of(&good), [0.0; 3]);
    // The encoder's output was wrong, and the checksums match it.
    let bad = session
        .stereo_frames
        .iter_mut()
        .rfind(|p| p.camera == 2)
        .unwrap();
    bad.unit = vec![0, 0, 0, 1, 0x41, 0xFF, 0xFF, 0xFF];
    let found = deep(&session, "bad");
    assert_eq!(of(&found), [0.0, 0.0, 1.0]);
    assert_eq!(found.verdict, Verdict::Fail);
    // The size differs from the manifest.
    let mut session = Session::decodable(1.0);
    session.spec.cameras[2].width = 96;
    let found = deep(&session, "size");
    assert_eq!(of(&found), [0.0, 0.0, 15.0]);
    assert!(
        (found.reasons.iter()).any(|reason| reason.contains("128x48 pixels, expected 96x48")),
        "{:?}",
        found.reasons
    );
}

#[test]
fn an_index_leads_to_every_access_unit() {
    let folder = tempfile::tempdir().unwrap();
    let session = Session::good(1.0);
    session.write(folder.path());
    let storage = Arc::new(DiskStorage::new(folder.path()));
    let reader = SessionReader::open(storage.clone()).unwrap();
    let index = Index::build(&reader, |_| {}).unwrap();
    let access = Access::open(&*storage, &index).unwrap();
    for p in &session.stereo_frames {
        let frame = index.cameras[p.camera].frame(p.frame.number).unwrap();
        assert_eq!(access.unit(frame).unwrap(), p.unit);
    }
}
