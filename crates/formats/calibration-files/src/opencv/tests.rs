use super::*;
use crate::files::Disk;
use crate::test_data::Folder;

/// The reader on files on disk.
fn read(path: &Path, size: Option<[u32; 2]>) -> SetResult {
    super::read(&Disk, path, size)
}

/// As `cv::FileStorage` writes: no space in the first line, numbers that end in a point, a tag.
const PAIR: &str = "%YAML:1.0
---
image_width: 640
image_height: 480
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.3591573396163199e+02, 0., 3.4228315473308373e+02, 0.,
       5.3591573396163199e+02, 2.3557082909788173e+02, 0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 14
   dt: d
   data: [ -2.6637260909660682e-01, -3.8588898922304653e-02,
       1.7831947042852964e-03, -2.8122100441115472e-04,
       2.3839153080878486e-01, 0., 0., 0., 0., 0., 0., 0., 0., 0. ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.36e+02, 0., 3.26e+02, 0., 5.36e+02, 2.5e+02, 0., 0., 1. ]
D2: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0., 0., 0., 0., 0. ]
";
const EXTRINSICS: &str = "%YAML:1.0
---
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -6.3e-02, 1.0e-03, 0. ]
";

#[test]
fn the_files_of_the_samples() {
    let folder = Folder::new();
    let path = folder.file("intrinsics.yml", PAIR);
    let (set, notes) = read(&path, None).unwrap();
    assert!(
        notes.iter().any(|n| n.0.contains("no R and T")),
        "{notes:?}"
    );
    assert_eq!(set.cameras[1].camera_from_first, None);
    folder.file("extrinsics.yml", EXTRINSICS);
    let (set, notes) = read(&path, None).unwrap();
    assert!(notes.is_empty(), "{notes:?}");
    let left = &set.cameras[0].model;
    assert_eq!(
        (left.fx, left.cx, left.width),
        (535.915733961632, 342.28315473308373, 640)
    );
    let Distortion::Rational8 { k1, p1, k3, k6, .. } = left.distortion else {
        panic!("{left:?}");
    };
    assert_eq!(
        (k1, p1, k3, k6),
        (
            -0.2663726090966068,
            0.0017831947042852964,
            0.23839153080878486,
            0.0
        )
    );
    assert_eq!(set.cameras[1].model.distortion, Distortion::None);
    let right = set.cameras[1].camera_from_first.unwrap();
    assert_eq!(right.translation_m(), [-0.063, 0.001, 0.0]);
}

const MONO: &str = "%YAML:1.0\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 500., 0., \
                    320., 0., 501., 240., 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 4\n   \
                    cols: 1\n   dt: d\n   data: [ 0.1, 0.2, 0.3, 0.4 ]\n";

#[test]
fn four_coefficients_mean_what_the_file_says() {
    let folder = Folder::new();
    let check = |more: &str, fisheye: bool, noted: bool| {
        let path = folder.file("mono.yml", &format!("{MONO}{more}"));
        let (set, notes) = read(&path, Some([640, 480])).unwrap();
        let is = matches!(
            set.cameras[0].model.distortion,
            Distortion::KannalaBrandt4 { .. }
        );
        assert_eq!(
            (is, !notes.is_empty()),
            (fisheye, noted),
            "{more}: {notes:?}"
        );
    };
    check("", false, true);
    check("fisheye_model: 0\n", false, false);
    check("fisheye_model: 1\n", true, false);
    check("distortion_model: equidistant\n", true, false);
    let error = read(&folder.file("mono.yml", MONO), None)
        .unwrap_err()
        .to_string();
    assert!(error.contains("no image_width and image_height"), "{error}");
}

#[test]
fn invalid_files_are_rejected() {
    let folder = Folder::new();
    let check = |from: &str, to: &str, expected: &str| {
        assert!(MONO.contains(from), "{from}");
        let path = folder.file("mono.yml", &MONO.replacen(from, to, 1));
        let error = read(&path, Some([640, 480])).unwrap_err().to_string();
        assert!(
            error.contains(expected),
            "found {error:?}, expected {expected:?}"
        );
    };
    check(
        "rows: 3",
        "rows: 2",
        "2 rows and 3 columns, expected 3 rows and 3 columns as camera_matrix",
    );
    check("500., 0., ", "500., 2., ", "the form fx 0 cx 0 fy cy 0 0 1");
    check(
        "0.4 ]",
        "0.4, 0.5, 0.6 ]",
        "6 coefficients, expected 2, 4, 5, 8, 12 or 14",
    );
    check(
        "0.3",
        ".Nan",
        "expected a finite number as distortion_coefficients.data[2]",
    );
    check(
        "320.",
        "3200.",
        "principal point (3200, 240) outside the image",
    );
    check(
        "distortion_coefficients",
        "distortion",
        "distortion_coefficients is missing",
    );
    let both = format!(
        "{PAIR}{}",
        EXTRINSICS.trim_start_matches("%YAML:1.0\n---\n")
    );
    let path = folder.file("both.yml", &both.replace("-6.3e-02", "-63."));
    let error = read(&path, None).unwrap_err().to_string();
    assert!(error.contains("right is 63.0"), "{error}");
    let path = folder.file("both.yml", &both.replace("-6.3e-02", "6.3e-02"));
    let error = read(&path, None).unwrap_err().to_string();
    assert!(error.contains("left and right swapped"), "{error}");
    let path = folder.file(
        "thin.yml",
        &PAIR.replace(
            "0., 0., 0., 0., 0., 0., 0., 0., 0. ]",
            "0., 0., 0., 0., 0., 0., 0., 0., 0.1 ]",
        ),
    );
    let error = read(&path, None).unwrap_err().to_string();
    assert!(error.contains("thin prism or tilt terms in 14"), "{error}");
}

#[test]
fn impossible_value_is_named_by_its_key() {
    let folder = Folder::new();
    folder.file("extrinsics.yml", EXTRINSICS);
    let error = |name: &str, text: &str| {
        folder.file(name, text);
        let path = folder.path().join("intrinsics.yml");
        read(&path, None).unwrap_err().to_string()
    };
    let found = error(
        "intrinsics.yml",
        &PAIR.replace("5.36e+02, 2.5e+02", "-5.36e+02, 2.5e+02"),
    );
    assert!(
        found.contains("line 22: M2.data: focal lengths 536 and -536"),
        "{found}"
    );
    folder.file("intrinsics.yml", PAIR);
    for (x, expected) in [
        ("-63.", "T.data: right is 63.0"),
        (
            "6.3e-02",
            "T.data: the left camera's origin is at x = 0.063 m",
        ),
    ] {
        let found = error("extrinsics.yml", &EXTRINSICS.replace("-6.3e-02", x));
        assert!(
            found.contains(&format!("line 12: {expected}")) && found.ends_with("extrinsics.yml"),
            "{found}"
        );
    }
}
