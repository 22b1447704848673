use super::*;
use crate::files::Disk;
use crate::test_data::{Folder, shared};

/// The reader on files on disk.
fn read(path: &Path, width: u32, height: u32) -> PairResult {
    super::read_pair(&Disk, path, [width, height])
}

const USB: &str = "[LEFT_CAM_HD]\nfx=700\nfy=701\ncx=640\ncy=360\nk1=-0.17\nk2=0.02\np1=0.001\np2=-0.002\nk3=0.003\n\
                   [RIGHT_CAM_HD]\nfx=702\nfy=703\ncx=641\ncy=361\nk1=-0.18\nk2=0.03\np1=0\np2=0\nk3=0.001\n\
                   [STEREO]\nBaseline=62.8\nTY=-0.08\nTZ=-0.03\nCV_HD=0.01\nRX_HD=0.002\nRZ_HD=-0.003\n";

const GMSL: &str = "[LEFT_CAM_FHD1200]\nfx = 736.862\nfy = 736.696\ncx = 999.971\ncy = 570.414\n\n\
                    [RIGHT_CAM_FHD1200]\nfx = 737.375\nfy = 736.982\ncx = 970.855\ncy = 630.481\n\n\
                    [LEFT_DISTO]\nk1 = 0.5\nk2 = 0.6\np1 = 0.001\np2 = 0.002\nk3 = 0.7\nk4 = 0.8\nk5 = 0.9\nk6 = 1.1\n\n\
                    [RIGHT_DISTO]\nk1 = -0.01\nk2 = -0.02\np1 = 0.001\np2 = 0.002\nk3 = 0.03\nk4 = 0\nk5 = 0\nk6 = 0\n\n\
                    [MISC]\nSensor_ID = 1\n\n\
                    [STEREO]\nBaseline = 49.8789\nTY = 0.0509066\nTZ = 0.167848\nCV_FHD1200 = 0.0107261\n\
                    RX_FHD1200 = 0.00124871\nRZ_FHD1200 = 0.00138949\n";

fn read_text(
    text: &str,
    width: u32,
    height: u32,
) -> Result<(StereoCalibration, Vec<String>), CalibError> {
    let folder = Folder::new();
    let (calibration, notes) = read(&folder.file("SN1.conf", text), width, height)?;
    Ok((calibration, notes.into_iter().map(|note| note.0).collect()))
}

/// Parses each numeric line of the file independently: a reference implementation of the reader.
fn value(text: &str, section: &str, key: &str) -> f64 {
    let (_, rest) = text.split_once(&format!("[{section}]\n")).unwrap();
    let body = rest.split('[').next().unwrap();
    let line = body
        .lines()
        .find(|line| line.starts_with(&format!("{key}=")))
        .unwrap();
    line.split_once('=').unwrap().1.parse().unwrap()
}

#[test]
fn the_real_zed_mini_at_every_resolution() {
    let Some(path) = shared("06_calibration/zed/SN10028708.conf") else {
        return;
    };
    let text = std::fs::read_to_string(&path).unwrap();
    for (width, height, tag) in [
        (2208, 1242, "2K"),
        (1920, 1080, "FHD"),
        (1280, 720, "HD"),
        (672, 376, "VGA"),
    ] {
        let (calibration, notes) = crate::read_stereo(&path, width, height).unwrap();
        for (eye, camera) in [("LEFT", calibration.left), ("RIGHT", calibration.right)] {
            let v = |key| value(&text, &format!("{eye}_CAM_{tag}"), key);
            assert_eq!((camera.width, camera.height), (width, height));
            assert_eq!(
                (camera.fx, camera.fy, camera.cx, camera.cy),
                (v("fx"), v("fy"), v("cx"), v("cy"))
            );
            let expected = Distortion::RadTan5 {
                k1: v("k1"),
                k2: v("k2"),
                p1: v("p1"),
                p2: v("p2"),
                k3: v("k3"),
            };
            assert_eq!(camera.distortion, expected);
        }
        // 62.9661 mm, and no TY, TZ in this file.
        assert_eq!(
            calibration.right_from_left.translation_m(),
            [-0.0629661, 0.0, 0.0]
        );
        let rotation = calibration.right_from_left.rotation_vector();
        let expected = [0.000940106, -0.00694236, -0.0005005];
        assert!(
            rotation
                .iter()
                .zip(expected)
                .all(|(f, e)| (f - e).abs() < 1e-12),
            "{rotation:?}"
        );
        let notes: Vec<String> = notes.iter().map(Note::to_string).collect();
        assert_eq!(
            notes,
            [
                "[STEREO] has no TY: taken as 0",
                "[STEREO] has no TZ: taken as 0"
            ]
        );
        assert_eq!(calibration.provenance.part.as_deref(), Some(tag));
    }
    let error = read(&path, 1920, 1200).unwrap_err().to_string();
    assert!(
        error.contains("no section for FHD1200 among LEFT_CAM_2K, LEFT_CAM_FHD"),
        "{error}"
    );
    let error = read(&path, 2560, 720).unwrap_err().to_string();
    assert!(
        error.contains("images of 2560x720: found no such resolution"),
        "{error}"
    );
}

#[test]
fn signs_and_units_of_the_pair() {
    let (calibration, notes) = read_text(USB, 1280, 720).unwrap();
    assert!(notes.is_empty(), "{notes:?}");
    assert_eq!(
        calibration.right_from_left.translation_m(),
        [-62.8 / 1000.0, -0.08 / 1000.0, -0.03 / 1000.0]
    );
    // CV is the rotation about y: the right camera converges, so that a point straight ahead of the
    // left one moves along +x by CV, in addition to the displacement by the baseline.
    let [x, _, z] = calibration.right_from_left.rotate([0.0, 0.0, 1.0]);
    assert!((x / z - 0.01).abs() < 1e-5);
    let (plain, _) = read_text(
        &USB.replace("TY=-0.08\nTZ=-0.03\n", "TY_HD=1\nTZ=2\nTY=9\n"),
        1280,
        720,
    )
    .unwrap();
    assert_eq!(
        plain.right_from_left.translation_m(),
        [-0.0628, 0.001, 0.002]
    );
}

#[test]
fn spelling_does_not_matter() {
    let (expected, _) = read_text(USB, 1280, 720).unwrap();
    let spellings = [
        USB.to_ascii_lowercase(),
        USB.to_ascii_uppercase(),
        USB.replace('=', " = "),
        USB.replace('\n', "\r\n"),
        USB.replace("Baseline", "BaseLine"),
        USB.replace("_HD=", "_RESOLUTION_HD="),
        format!("\u{feff}# comment\n; comment\n\n{USB}[MISC]\nnote=any 1,5 thing\n"),
        format!("{USB}[LEFT_CAM_HD]\nfx=700\n"),
    ];
    for text in spellings {
        let (mut found, _) = read_text(&text, 1280, 720).unwrap();
        found
            .provenance
            .files
            .clone_from(&expected.provenance.files);
        assert_eq!(found, expected, "{text}");
    }
}

#[test]
fn shared_distortion_and_derived_resolutions() {
    let (full, notes) = read_text(GMSL, 1920, 1200).unwrap();
    assert!(notes.is_empty(), "{notes:?}");
    assert_eq!(
        full.left.distortion,
        Distortion::Rational8 {
            k1: 0.5,
            k2: 0.6,
            p1: 0.001,
            p2: 0.002,
            k3: 0.7,
            k4: 0.8,
            k5: 0.9,
            k6: 1.1
        }
    );
    assert_eq!(
        full.right.distortion,
        Distortion::RadTan5 {
            k1: -0.01,
            k2: -0.02,
            p1: 0.001,
            p2: 0.002,
            k3: 0.03
        }
    );
    assert_eq!(
        full.right_from_left.translation_m(),
        [-49.8789 / 1000.0, 0.0509066 / 1000.0, 0.167848 / 1000.0]
    );

    let (fhd, notes) = read_text(GMSL, 1920, 1080).unwrap();
    assert_eq!(
        notes,
        ["no section for FHD: derived from FHD1200 by cutting 60 rows off above"]
    );
    assert_eq!(
        fhd.left,
        CameraModel {
            height: 1080,
            cy: 510.414,
            ..full.left
        }
    );
    assert_eq!(fhd.right_from_left, full.right_from_left);

    let (svga, notes) = read_text(GMSL, 960, 600).unwrap();
    assert_eq!(
        notes,
        ["no section for SVGA: derived from FHD1200 by halving"]
    );
    assert_eq!(
        svga.right.k_matrix(),
        [
            368.6875, 0.0, 485.4275, 0.0, 368.491, 315.2405, 0.0, 0.0, 1.0
        ]
    );
    assert_eq!(svga.right.distortion, full.right.distortion);

    // A file that contains them is used as it is.
    let with_fhd = format!(
        "{GMSL}CV_FHD = 0.5\n[LEFT_CAM_FHD]\nfx=1\nfy=2\ncx=3\ncy=4\n[RIGHT_CAM_FHD]\nfx=5\nfy=6\ncx=7\ncy=8\n"
    );
    let error = read_text(&with_fhd, 1920, 1080).unwrap_err().to_string();
    assert!(error.contains("RX_FHD in [STEREO] is missing"), "{error}");
    let whole = with_fhd.replace("CV_FHD =", "RX_FHD = 0\nRZ_FHD = 0\nCV_FHD =");
    let (fhd, notes) = read_text(&whole, 1920, 1080).unwrap();
    assert_eq!((fhd.left.fx, fhd.right.cy, notes.len()), (1.0, 8.0, 0));
    assert!((fhd.right_from_left.angle_rad() - 0.5).abs() < 1e-12);
}

#[test]
fn fewer_coefficients_and_fisheye_lenses() {
    // The first ZED's files have two coefficients and neither TY nor TZ.
    let old = USB
        .replace("p1=0.001\np2=-0.002\nk3=0.003\n", "")
        .replace("TY=-0.08\nTZ=-0.03\n", "");
    let (calibration, notes) = read_text(&old, 1280, 720).unwrap();
    assert_eq!(
        calibration.left.distortion,
        Distortion::RadTan5 {
            k1: -0.17,
            k2: 0.02,
            p1: 0.0,
            p2: 0.0,
            k3: 0.0
        }
    );
    assert_eq!(
        notes,
        [
            "[LEFT_CAM_HD] has no P1, P2, K3: taken as 0",
            "[STEREO] has no TY: taken as 0",
            "[STEREO] has no TZ: taken as 0"
        ]
    );

    let fisheye = GMSL.replace(
        "p1 = 0.001\np2 = 0.002\nk3 = 0.7\nk4 = 0.8\nk5 = 0.9\nk6 = 1.1",
        "k3 = 0.7\nk4 = 0.8\nk5 = 0\nk6 = 0\np1 = 0\np2 = 0",
    );
    let (calibration, notes) = read_text(&fisheye, 1920, 1200).unwrap();
    assert_eq!(
        calibration.left.distortion,
        Distortion::KannalaBrandt4 {
            k1: 0.5,
            k2: 0.6,
            k3: 0.7,
            k4: 0.8
        }
    );
    assert_eq!(
        notes,
        ["[LEFT_DISTO] has k1 to k4 alone: read as a fisheye lens"]
    );

    let flat = USB.replace(
        "k1=-0.17\nk2=0.02\np1=0.001\np2=-0.002\nk3=0.003",
        "k1=0\nk2=0\np1=0\np2=0\nk3=0",
    );
    let (calibration, notes) = read_text(&flat, 1280, 720).unwrap();
    assert_eq!(calibration.left.distortion, Distortion::None);
    assert!(
        notes[0].starts_with("[LEFT_CAM_HD] has only zeros"),
        "{notes:?}"
    );
}

#[test]
fn invalid_files_are_rejected() {
    let check = |from: &str, to: &str, expected: &str| {
        assert!(USB.contains(from), "{from}");
        let error = read_text(&USB.replacen(from, to, 1), 1280, 720)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains(expected),
            "found {error:?}, expected {expected:?}"
        );
        assert!(error.ends_with("SN1.conf"), "{error}");
    };
    check(
        "fx=700",
        "fx=700,5",
        "line 2: found \"700,5\", expected a decimal point (the file was written with a decimal",
    );
    check(
        "k1=-0.17",
        "k1=-0,17",
        "line 6: found \"-0,17\", expected a decimal point",
    );
    check(
        "fx=700",
        "fx=",
        "line 2: found nothing, expected a finite number",
    );
    check(
        "fx=700",
        "fx=nan",
        "line 2: found \"nan\", expected a finite number",
    );
    check("RX_HD=0.002", "RX_HD=0.002 tilt", "found \"0.002 tilt\"");
    check(
        "fx=700\n",
        "",
        "FX in [LEFT_CAM_HD] is missing, found CX, CY, FY, K1",
    );
    check(
        "k1=-0.17\nk2=0.02\n",
        "",
        "section [LEFT_DISTO] is missing, found sections LEFT_CAM_HD, RIGHT_CAM_HD, STEREO",
    );
    check("k2=0.02\n", "", "K2 in [LEFT_CAM_HD] is missing");
    check(
        "[RIGHT_CAM_HD]",
        "[RIGHT_CAM_VGA]",
        "section [RIGHT_CAM_HD] is missing",
    );
    check("[STEREO]", "[STREO]", "section [STEREO] is missing");
    check(
        "CV_HD",
        "CV_VGA",
        "CV_HD in [STEREO] is missing, found BASELINE, CV_VGA",
    );
    check(
        "Baseline=62.8",
        "Baseline=0.0628",
        "line 22: found \"0.0628\", expected BASELINE in [STEREO] in millimetres",
    );
    check(
        "Baseline=62.8",
        "Baseline=-62.8",
        "expected BASELINE in [STEREO] in millimetres, positive",
    );
    check(
        "cx=640",
        "cx=1400",
        "line 4: CX in [LEFT_CAM_HD]: principal point (1400, 360) outside the image of 1280x720",
    );
    check(
        "fy=701",
        "fx=701",
        "line 3: found \"701\", expected the value of line 2, \"700\": FX comes twice",
    );
    check(
        "[LEFT_CAM_HD]\n",
        "",
        "line 1: found \"fx=700\", expected a [SECTION] before the first key",
    );
    check(
        "[LEFT_CAM_HD]",
        "[LEFT_CAM_HD",
        "line 1: found \"[LEFT_CAM_HD\", expected [SECTION]",
    );
    check(
        "cy=360",
        "cy 360",
        "line 5: found \"cy 360\", expected key=value or [SECTION]",
    );
    check(
        "CV_HD=0.01",
        "CV_HD=1e200",
        "RX, CV, RZ in [STEREO] of [0.002, 1e200, -0.003]: a component is not",
    );
    check(
        "TZ=-0.03",
        "TZ=1e9",
        "expected TZ in [STEREO] in millimetres",
    );
}

#[test]
fn never_panics_on_a_file_cut_anywhere() {
    let folder = Folder::new();
    for text in [USB, GMSL] {
        for end in 0..text.len() {
            let path = folder.file("SN1.conf", &text[..end]);
            let _ = read(&path, 1280, 720);
            let _ = read(&path, 1920, 1080);
        }
    }
}

#[test]
fn impossible_value_is_named_by_section_and_key() {
    let check = |text: &str, from: &str, to: &str, size: (u32, u32), expected: &str| {
        assert!(text.contains(from), "{from}");
        let error = read_text(&text.replacen(from, to, 1), size.0, size.1).unwrap_err();
        let error = error.to_string();
        assert!(error.contains(expected), "{error}");
    };
    let usb = |from, to, expected| check(USB, from, to, (1280, 720), expected);
    usb(
        "fx=700",
        "fx=-700",
        "line 2: FX in [LEFT_CAM_HD]: focal lengths -700 and 701",
    );
    usb(
        "fy=703",
        "fy=0",
        "line 13: FY in [RIGHT_CAM_HD]: focal lengths 702 and 0",
    );
    usb(
        "cy=361",
        "cy=3610",
        "line 15: CY in [RIGHT_CAM_HD]: principal point (641, 3610)",
    );
    usb(
        "Baseline=62.8",
        "Baseline=62966",
        "line 22: found \"62966\", expected BASELINE in [STEREO]",
    );
    usb(
        "TZ=-0.03",
        "TZ=-30000",
        "line 24: found \"-30000\", expected TZ in [STEREO]",
    );
    // For a derived resolution the key is the one in the file.
    check(
        GMSL,
        "cy = 630.481",
        "cy = 30.481",
        (1920, 1080),
        "CY in [RIGHT_CAM_FHD1200]: principal point",
    );
}
