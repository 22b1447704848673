use cad_transforms::RigidTransform;
use camera_models::{
    CameraModel, Distortion, ImuNoise, Lens, LensModel, NamedCamera, Provenance, SetImu, convert,
    exactly,
};

use super::*;
use crate::error::CalibError;
use crate::read_cameras;
use crate::test_data::{Folder, shared};
use crate::zed_conf;

const LENSES: [Distortion; 8] = [
    Distortion::None,
    Distortion::Radial2 { k1: -0.1, k2: 0.01 },
    Distortion::RadTan4 {
        k1: -0.28340811,
        k2: 0.07395907,
        p1: 0.00019359,
        p2: 1.76187114e-05,
    },
    Distortion::RadTan5 {
        k1: -0.16145666308195702,
        k2: 0.019494047870765748,
        p1: -0.0007681942397629087,
        p2: 0.0005395570518618749,
        k3: 0.00229138777250143,
    },
    Distortion::Rational8 {
        k1: 0.3,
        k2: 0.02,
        p1: 1e-4,
        p2: -2e-4,
        k3: 0.003,
        k4: 0.5,
        k5: 0.06,
        k6: 0.007,
    },
    Distortion::KannalaBrandt4 {
        k1: 0.0034,
        k2: 0.0007,
        k3: -0.002,
        k4: 0.0002,
    },
    Distortion::DoubleSphere {
        xi: -0.2409573942178872,
        alpha: 0.566996899163044,
    },
    Distortion::Eucm {
        alpha: 0.5903365915227143,
        beta: 1.127468196965374,
    },
];

fn pair(distortion: Distortion) -> CameraSet {
    let model = CameraModel {
        width: 1280,
        height: 720,
        fx: 690.638,
        fy: 690.7,
        cx: 640.723,
        cy: 371.0 / 1.01,
        distortion,
    };
    let right = CameraModel {
        fx: 693.193,
        cx: 632.251,
        ..model
    };
    let named = |name: &str, model, place| NamedCamera {
        name: name.to_owned(),
        model,
        camera_from_first: Some(place),
    };
    let right_from_left = RigidTransform::from_rotation_vector(
        [0.000940106, -0.00694236, -0.0005005],
        [-0.0629661, 0.00012, -0.0007],
    )
    .unwrap();
    CameraSet {
        cameras: vec![
            named("left", model, RigidTransform::identity()),
            named("right", right, right_from_left),
        ],
        imu: None,
        provenance: Provenance {
            format: None,
            files: Vec::new(),
            part: None,
        },
    }
}

fn with_imu(mut set: CameraSet) -> CameraSet {
    set.imu = Some(SetImu {
        imu_from_first: RigidTransform::from_rotation_vector([1.2, -1.1, 0.3], [0.02, -0.03, 0.01])
            .unwrap(),
        rate_hz: Some(400.0),
        noise: Some(ImuNoise {
            gyro_noise_density: 8.992407693407532e-05,
            gyro_random_walk: 4.968451356558349e-06,
            accel_noise_density: 0.00011342219135615652,
            accel_random_walk: 2.266045767910792e-06,
        }),
        time_offset_s: Some(-0.002500123),
        gyro_bias: Some([0.001, -0.002, 0.003]),
        accel_bias: Some([0.1, 0.2, -0.3]),
    });
    set
}

fn rectified() -> CameraSet {
    let mut set = pair(Distortion::None);
    set.cameras[0].model.fy = set.cameras[0].model.fx;
    set.cameras[1].model = set.cameras[0].model;
    set.cameras[1].camera_from_first =
        Some(RigidTransform::from_translation_m([-0.0629661, 0.0, 0.0]).unwrap());
    set
}

fn samples() -> Vec<CameraSet> {
    let mut all: Vec<CameraSet> = LENSES.into_iter().map(pair).collect();
    all.extend([
        rectified(),
        with_imu(pair(LENSES[2])),
        with_imu(pair(LENSES[6])),
    ]);
    all.extend(LENSES.into_iter().map(|lens| {
        let mut single = pair(lens);
        single.cameras.truncate(1);
        single
    }));
    let mut three = pair(LENSES[5]);
    let mut third = three.cameras[1].clone();
    third.name = "third".to_owned();
    third.camera_from_first =
        Some(RigidTransform::from_rotation_vector([0.1, 1.4, -0.2], [0.2, 0.1, -0.3]).unwrap());
    three.cameras.push(third);
    all.push(three);
    all
}

/// Writes, reads back, compares. False if the format rejected it for a reason other than the lens.
fn round_trip(set: &CameraSet, format: Format) -> bool {
    let folder = Folder::new();
    let out = folder.path().join("out");
    let set = match write_cameras(set, format, &out) {
        Ok(_) => set.clone(),
        Err(WriteError::Lens {
            camera, nearest, ..
        }) => {
            // A rejected model is not in the format, and the suggested one is accepted.
            assert!(!out.exists());
            let nearest = LensModel::from_name(nearest).unwrap();
            let refused = set.cameras.iter().find(|c| c.name == camera).unwrap();
            for model in format.models() {
                assert_eq!(exactly(&refused.model.distortion, *model), None);
            }
            let mut converted = set.clone();
            for camera in &mut converted.cameras {
                let conversion = convert(&camera.model, nearest).unwrap();
                // The nearest model is close, except for a pinhole without distortion.
                assert!(
                    nearest == LensModel::None || conversion.rms_px < 1.5,
                    "{} {conversion}",
                    format.name()
                );
                camera.model = conversion.model;
            }
            match write_cameras(&converted, format, &out) {
                Ok(_) => converted,
                Err(error @ WriteError::Refused { .. }) => {
                    println!("{error}");
                    return false;
                }
                Err(error) => panic!("{error}"),
            }
        }
        Err(error @ WriteError::Refused { .. }) => {
            assert!(!out.exists());
            println!("{error}");
            return false;
        }
        Err(error) => panic!("{}: {error}", format.name()),
    };
    let first = &set.cameras[0].model;
    let size = Some([first.width, first.height]);
    let (again, _) = read_cameras(&out, size).unwrap_or_else(|e| panic!("{}: {e}", format.name()));
    assert_eq!(again.cameras.len(), set.cameras.len());
    assert_eq!(again.provenance.format.as_deref(), Some(format.name()));
    for (a, b) in set.cameras.iter().zip(&again.cameras) {
        // Half a pixel more and less costs a bit.
        let exact = match format {
            Format::Colmap | Format::ColmapBin | Format::Nerfstudio => 1e-12,
            _ => 0.0,
        };
        let lens = exactly(&b.model.distortion, LensModel::of(&a.model.distortion));
        assert_eq!(lens, Some(a.model.distortion), "{}", format.name());
        let (p, q) = (a.model.parameters(), b.model.parameters());
        for (p, q) in p[..4].iter().zip(&q[..4]) {
            assert!(
                (p - q).abs() <= exact * p.abs(),
                "{} {p} {q}",
                format.name()
            );
        }
        match (a.camera_from_first, b.camera_from_first) {
            (Some(a), Some(b)) => same_place(&a, &b),
            (a, b) => assert_eq!((a, format.name()), (b, format.name())),
        }
    }
    let holds_imu = matches!(format, Format::Kalibr | Format::Basalt | Format::Euroc);
    if let Some(a) = set.imu.filter(|_| holds_imu) {
        let b = again.imu.expect("an IMU");
        same_place(&a.imu_from_first, &b.imu_from_first);
        assert_eq!((a.rate_hz, a.noise), (b.rate_hz, b.noise));
        if format != Format::Euroc {
            let off = a.time_offset_s.unwrap_or(0.0) - b.time_offset_s.unwrap_or(0.0);
            assert!(off.abs() < 1e-15, "{off}");
        }
    }
    true
}

fn same_place(a: &RigidTransform, b: &RigidTransform) {
    let off = *a * b.inverse();
    assert!(
        off.distance_m() < 1e-14 && off.angle_rad() < 1e-7,
        "{a:?} {b:?}"
    );
    for (p, q) in a.rotation_rows().iter().zip(b.rotation_rows()) {
        assert!((p - q).abs() < 1e-14, "{a:?} {b:?}");
    }
}

#[test]
fn every_sample_through_every_format() {
    for format in Format::ALL {
        let count = samples()
            .iter()
            .filter(|set| round_trip(set, format))
            .count();
        println!("{}: {count}", format.name());
        let least = match format {
            // Rectified pairs only.
            Format::Kitti | Format::Pair | Format::Middlebury => 1,
            // Pairs only, and without an IMU there is no body.
            Format::ZedConf | Format::Euroc => 11,
            _ => 19,
        };
        assert!(count >= least, "{}: {count}", format.name());
    }
}

/// All calibration files of the shared data: read, written in every format, read again.
#[test]
fn every_shared_file_through_every_format() {
    let files: [(&str, Option<[u32; 2]>, usize); 15] = [
        (
            "01_stereo_depth/foundationstereo_demo/K.txt",
            Some([960, 540]),
            2,
        ),
        (
            "01_stereo_depth/middlebury2014_motorcycle_Q/calib.txt",
            None,
            2,
        ),
        (
            "02_stereo_odometry_kitti/KITTI_sequence_1/calib.txt",
            Some([1226, 370]),
            2,
        ),
        ("03_stereo_imu/euroc_V1_01_micro/mav0", None, 2),
        ("06_calibration/basalt_calib/euroc_ds_calib.json", None, 2),
        ("06_calibration/basalt_calib/euroc_eucm_calib.json", None, 2),
        (
            "06_calibration/basalt_calib/tumvi_512_ds_calib.json",
            None,
            2,
        ),
        (
            "06_calibration/basalt_calib/tumvi_512_eucm_calib.json",
            None,
            2,
        ),
        ("06_calibration/grandtour/zed2i/zed_left.yaml", None, 2),
        ("06_calibration/zed/SN10028708.conf", Some([2208, 1242]), 2),
        ("06_calibration/zed/SN10028708.conf", Some([1920, 1080]), 2),
        ("06_calibration/zed/SN10028708.conf", Some([1280, 720]), 2),
        ("06_calibration/zed/SN10028708.conf", Some([672, 376]), 2),
        ("06_calibration/zed/zedxmini_rectified.json", None, 1),
        ("07_multiview/fox/transforms.json", None, 1),
    ];
    for (path, size, cameras) in files {
        let Some(path) = shared(path) else { continue };
        let (set, notes) = read_cameras(&path, size).unwrap();
        assert_eq!(set.cameras.len(), cameras);
        for note in &notes {
            println!("{}: {note}", path.display());
        }
        let written: Vec<&str> = Format::ALL
            .into_iter()
            .filter(|format| round_trip(&set, *format))
            .map(Format::name)
            .collect();
        println!("{}: {}", path.display(), written.join(" "));
        // Its own format is always among them.
        let own = set.provenance.format.unwrap();
        assert!(
            written.contains(&own.as_str()),
            "{}: {written:?}",
            path.display()
        );
        assert!(written.len() >= 4, "{written:?}");
    }
}

#[test]
fn nothing_is_overwritten() {
    let folder = Folder::new();
    let set = pair(LENSES[2]);
    let path = folder.file("mine.json", "precious");
    let error = write_cameras(&set, Format::Basalt, &path).unwrap_err();
    assert!(matches!(error, WriteError::Exists { .. }), "{error}");
    assert_eq!(fs::read_to_string(&path).unwrap(), "precious");
    // The same if it appears between the check and the write.
    let error = new_file(&path, b"other").unwrap_err();
    assert!(matches!(error, WriteError::Exists { .. }), "{error}");
    assert_eq!(fs::read_to_string(&path).unwrap(), "precious");
    let error = new_folder(folder.path(), &[("a".to_owned(), Vec::new())]).unwrap_err();
    assert!(matches!(error, WriteError::Write { .. }), "{error}");

    let (files, _) = write_cameras(&set, Format::Basalt, &folder.path().join("new.json")).unwrap();
    assert_eq!(files, [folder.path().join("new.json")]);
    let error = write_cameras(&set, Format::Euroc, &folder.path().join("x.yaml")).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("cam0/sensor.yaml and cam1/sensor.yaml"),
        "{error}"
    );
    let error = write_cameras(&set, Format::Basalt, &folder.path().join("no/where.json"));
    assert!(matches!(error, Err(WriteError::Write { .. })));
    // No incomplete file remains.
    let mut names: Vec<_> = fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(names, ["mine.json", "new.json"]);
}

#[test]
fn values_a_format_cannot_represent_are_noted() {
    let folder = Folder::new();
    let error = |set: &CameraSet, format| {
        write_cameras(set, format, &folder.path().join("out"))
            .unwrap_err()
            .to_string()
    };
    assert_eq!(
        error(&pair(LENSES[4]), Format::Kalibr),
        "writing kalibr: it cannot hold the lens rational8 of camera left; convert it first, the nearest it can \
         hold is rad_tan4"
    );
    assert!(error(&pair(LENSES[6]), Format::Colmap).ends_with("is kannala_brandt4"));
    assert!(error(&pair(LENSES[0]), Format::Pair).contains("rectify it first"));
    let mut swapped = pair(LENSES[3]);
    swapped.cameras[1].camera_from_first =
        swapped.cameras[1].camera_from_first.map(|t| t.inverse());
    assert!(error(&swapped, Format::ZedConf).contains("left and right swapped"));
    let mut odd = pair(LENSES[3]);
    odd.cameras[0].model.width = 1000;
    assert!(error(&odd, Format::ZedConf).contains("found 1000x720 and 1280x720"));
    let (_, notes) = write_cameras(
        &with_imu(pair(LENSES[3])),
        Format::Ros,
        &folder.path().join("ros"),
    )
    .unwrap();
    assert_eq!(
        notes[0].0,
        "ros has no field for the IMU's placement, rate, noise, time offset, biases: not written"
    );
}

/// Names and contents.
type Files = Vec<(String, Vec<u8>)>;

/// Files of every format as the writers make them.
fn all_files() -> Vec<(Format, Files)> {
    let mut all = Vec::new();
    for format in Format::ALL {
        for set in [pair(LENSES[5]), rectified(), with_imu(pair(LENSES[2]))] {
            if let Ok(written) = (registry::entry(format).write)(&set) {
                all.push((format, written.files));
            }
        }
    }
    assert!(all.len() > 20);
    all
}

/// Reads a modified file beside intact ones. An error must name a path and an existing line.
fn read_changed(
    folder: &Folder,
    files: &[(String, Vec<u8>)],
    which: usize,
    bytes: &[u8],
) -> Option<(CameraSet, Vec<Note>)> {
    fs::write(folder.path().join(&files[which].0), bytes).unwrap();
    let path = folder.path().join(&files[0].0);
    match read_cameras(&path, Some([1280, 720])) {
        Ok((set, notes)) => Some((set.validate().unwrap(), notes)),
        Err(error) => {
            let text = error.to_string();
            assert!(
                text.contains(&folder.path().display().to_string()),
                "{text}"
            );
            assert!(
                !matches!(error, CalibError::Malformed { line: 0, .. }),
                "{text}"
            );
            None
        }
    }
}

/// Whether a cut is within the last number of a file. The rest is a valid number too, which cannot
/// be detected: the end of the line and a comment are not part of any of these formats.
fn cuts_the_last_number(bytes: &[u8], end: usize) -> bool {
    let in_number = |b: u8| b.is_ascii_digit() || b"+-.e".contains(&b);
    let rest = String::from_utf8_lossy(&bytes[end..]);
    let line = rest.trim_end();
    let number = line.split('#').next().unwrap_or_default().trim_end();
    bytes[..end].last().is_some_and(|b| in_number(*b))
        && !line.contains('\n')
        && number.bytes().all(in_number)
}

fn folder_with(files: &[(String, Vec<u8>)]) -> Folder {
    let folder = Folder::new();
    for (name, bytes) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
    folder
}

#[test]
fn files_cut_anywhere() {
    let mut silent = Vec::new();
    for (format, files) in all_files() {
        for (which, (name, bytes)) in files.iter().enumerate() {
            let folder = folder_with(&files);
            let (whole, all_notes) = read_changed(&folder, &files, which, bytes).unwrap();
            let parts = |set: &CameraSet| {
                let cameras = set.cameras.iter();
                let cameras: Vec<_> = cameras.map(|c| (c.model, c.camera_from_first)).collect();
                (cameras, set.imu)
            };
            for end in 0..bytes.len() {
                // The content is complete, or the reader reports what is missing.
                if let Some((set, notes)) = read_changed(&folder, &files, which, &bytes[..end])
                    && parts(&set) != parts(&whole)
                    && notes.iter().all(|note| all_notes.contains(note))
                    && !cuts_the_last_number(bytes, end)
                {
                    let there = String::from_utf8_lossy(&bytes[end.saturating_sub(30)..end]);
                    silent.push(format!("{} {name} {end}: {there:?}", format.name()));
                }
            }
        }
    }
    assert!(silent.is_empty(), "{silent:#?}");
}

#[test]
fn files_with_random_damage() {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut random = move |below: usize| {
        // Marsaglia 2003, xorshift64.
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as usize % below.max(1)
    };
    let words: [&[u8]; 16] = [
        b"nan", b"inf", b"1e999", b",", b"-", b"[", b"]", b"{", b"}", b":", b"\n", b"\"", b"  ",
        b"63", b"0", b"\xff",
    ];
    for (_, files) in all_files() {
        for (which, (_, bytes)) in files.iter().enumerate() {
            let folder = folder_with(&files);
            for _ in 0..150 {
                let mut changed = bytes.clone();
                for _ in 0..=random(3) {
                    let at = random(changed.len());
                    let end = (at + 1 + random(12)).min(changed.len());
                    match random(4) {
                        0 => changed[at] = random(256) as u8,
                        1 => drop(changed.drain(at..end)),
                        2 => {
                            let piece = changed[at..end].to_vec();
                            let to = random(changed.len());
                            drop(changed.splice(to..to, piece));
                        }
                        _ => {
                            let word = words[random(words.len())].iter().copied();
                            drop(changed.splice(at..end, word));
                        }
                    }
                }
                read_changed(&folder, &files, which, &changed);
            }
        }
    }
}

#[test]
fn decimal_commas_are_rejected() {
    for (format, files) in all_files() {
        if format == Format::ColmapBin {
            continue;
        }
        for (which, (name, bytes)) in files.iter().enumerate() {
            let folder = folder_with(&files);
            let text = String::from_utf8(bytes.clone()).unwrap();
            let commas = text
                .char_indices()
                .map(|(i, c)| {
                    let digit = |i: usize| text.as_bytes().get(i).is_some_and(u8::is_ascii_digit);
                    // The format's own numbers, not the version in the first line.
                    match c == '.'
                        && i > 0
                        && digit(i - 1)
                        && digit(i + 1)
                        && !text[..i].ends_with("YAML:1")
                    {
                        true => ',',
                        false => c,
                    }
                })
                .collect::<String>();
            fs::write(folder.path().join(&files[which].0), commas).unwrap();
            let path = folder.path().join(&files[0].0);
            let error = read_cameras(&path, Some([1280, 720]));
            assert!(error.is_err(), "{} {name}", format.name());
        }
    }
}

#[test]
fn file_of_another_camera_is_detected() {
    let path = Path::new("settings/SN10028708.conf");
    assert_eq!(zed_conf::serial_in_name(path), Some("10028708"));
    assert!(zed_conf::expect_serial(path, "10028708").is_ok());
    assert!(zed_conf::expect_serial(path, "SN10028708").is_ok());
    let error = zed_conf::expect_serial(path, "41234567").unwrap_err();
    assert_eq!(
        error.to_string(),
        "reading a calibration: found serial 10028708, expected 41234567: settings/SN10028708.conf"
    );
    assert_eq!(zed_conf::serial_in_name(Path::new("SNx.conf")), None);
    assert!(zed_conf::expect_serial(Path::new("renamed.conf"), "1").is_ok());
}

#[test]
fn factory_file_keeps_its_serial_number() {
    let (mut set, folder) = (pair(LENSES[3]), tempfile::tempdir().unwrap());
    let written = |set: &CameraSet, name: &str| {
        let (paths, notes) =
            write_cameras(set, Format::ZedConf, &folder.path().join(name)).unwrap();
        let name = paths[0].file_name().unwrap().to_str().unwrap().to_owned();
        (name, notes)
    };
    let (name, notes) = written(&set, "unknown");
    assert_eq!(name, "SN0.conf");
    assert!(
        notes[0]
            .0
            .contains("serial number of the camera is not known"),
        "{notes:?}"
    );
    for (folder, files, expected) in [
        ("one", &["SN10028708.conf"][..], "SN10028708.conf"),
        (
            "rewritten",
            &["a/chain.yaml", "b/SN10028708.conf"],
            "SN10028708.conf",
        ),
        ("two", &["a/SN1.conf", "b/SN2.conf"], "SN0.conf"),
    ] {
        set.provenance.files = files.iter().map(PathBuf::from).collect();
        assert_eq!(written(&set, folder).0, expected);
    }
    // Read and written again, as `paws calib convert --to zed` does.
    set.provenance.files = vec![PathBuf::from("SN10028708.conf")];
    write_cameras(&set, Format::ZedConf, &folder.path().join("again")).unwrap();
    let path = folder.path().join("again/SN10028708.conf");
    let (again, _) = read_cameras(&path, Some([1280, 720])).unwrap();
    assert_eq!(written(&again, "third").0, "SN10028708.conf");
}

#[test]
fn conversion_agrees_with_independent_fits() {
    // Basalt calibrated the same TUM-VI camera twice: a double sphere and an EUCM.
    for (from, to, target) in [
        ("tumvi_512_ds", "tumvi_512_eucm", LensModel::Eucm),
        ("tumvi_512_eucm", "tumvi_512_ds", LensModel::DoubleSphere),
    ] {
        let path = |name: &str| shared(&format!("06_calibration/basalt_calib/{name}_calib.json"));
        let (Some(from), Some(to)) = (path(from), path(to)) else {
            return;
        };
        let model = |path| read_cameras(path, None).unwrap().0.cameras[0].model;
        let (source, theirs) = (model(&from), model(&to));
        let ours = convert(&source, target).unwrap();
        println!("{ours}");
        // Their fit to corners of a board and ours to their other fit agree in the area where the
        // board was observed.
        let (source, ours, theirs) = (
            Lens::new(&source),
            Lens::new(&ours.model),
            Lens::new(&theirs),
        );
        let mut worst: f64 = 0.0;
        let part = |i: u32, size: u32| f64::from(i) / 32.0 * f64::from(size) - 0.5;
        let size = [source.model().width, source.model().height];
        for i in 0..33 * 33 {
            let pixel = [part(i % 33, size[0]), part(i / 33, size[1])];
            let Some(direction @ [x, y, z]) = source.unproject(pixel) else {
                continue;
            };
            if x.hypot(y).atan2(z) < 75_f64.to_radians() {
                let [a, b] = [&ours, &theirs].map(|lens| lens.project(direction).unwrap());
                worst = worst.max((a[0] - b[0]).hypot(a[1] - b[1]));
            }
        }
        println!("at most {worst} px apart");
        assert!(worst < 1.0, "{worst}");
    }
}
