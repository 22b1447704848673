use super::*;
use crate::files::Disk;
use crate::test_data::{Folder, shared};

/// The reader on files on disk.
fn read(path: &Path) -> SetResult {
    super::read(&Disk, path, None)
}

fn text(model: &str, d: &str, r: &str, tx: f64) -> String {
    let count = d.split(',').count();
    format!(
        "image_width: 640\nimage_height: 480\ncamera_name: narrow_stereo/left\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
         data: [430.15433, 0., 311.71339, 0., 430.60920, 221.06824, 0., 0., 1.]\ndistortion_model: {model}\n\
         distortion_coefficients:\n  rows: 1\n  cols: {count}\n  data: [{d}]\nrectification_matrix:\n  rows: 3\n  \
         cols: 3\n  data: [{r}]\nprojection_matrix:\n  rows: 3\n  cols: 4\n  data: [400., 0., 320., {tx}, 0., 400., \
         240., 0., 0., 0., 1., 0.]\n"
    )
}

const STRAIGHT: &str = "1., 0., 0., 0., 1., 0., 0., 0., 1.";
const FIVE: &str = "-0.337586, 0.111612, -0.000218, -0.000030, 0.0";

#[test]
fn pair_extrinsics_follow_from_rectification() {
    let folder = Folder::new();
    // Both eyes are rotated about the optical axis, the left by a quarter turn more.
    let quarter = "0., -1., 0., 1., 0., 0., 0., 0., 1.";
    let left = folder.file("left.yaml", &text("plumb_bob", FIVE, quarter, 0.0));
    let right = folder.file("right.yaml", &text("plumb_bob", FIVE, STRAIGHT, -25.2));
    let (set, notes) = read(&left).unwrap();
    assert!(notes.is_empty(), "{notes:?}");
    let placed = set.cameras[1].camera_from_first.unwrap();
    // A point on the left x axis is on the rectified y axis, and the baseline is 25.2 / 400.
    let found = placed.apply([1.0, 0.0, 2.0]);
    for (a, b) in found.iter().zip([-0.063, 1.0, 2.0]) {
        assert!((a - b).abs() < 1e-12, "{found:?}");
    }
    assert_eq!(read(&right).unwrap().0.names(), ["left", "right"]);
    assert_eq!(set.provenance.files, [left, right]);
}

#[test]
fn models_are_read_and_invalid_files_rejected() {
    let folder = Folder::new();
    let model = |name: &str, d: &str| {
        let path = folder.file("camera.yaml", &text(name, d, STRAIGHT, 0.0));
        read(&path).map(|(set, _)| set.cameras[0].model.distortion)
    };
    assert!(matches!(
        model("plumb_bob", FIVE),
        Ok(Distortion::RadTan5 { .. })
    ));
    assert!(matches!(
        model("plumb_bob", "0, 0, 0, 0, 0"),
        Ok(Distortion::None)
    ));
    assert!(matches!(
        model("rational_polynomial", "1, 2, 3, 4, 5, 6, 7, 8"),
        Ok(Distortion::Rational8 { k6: 8.0, .. })
    ));
    assert!(matches!(
        model("equidistant", "1, 2, 3, 4"),
        Ok(Distortion::KannalaBrandt4 { k4: 4.0, .. })
    ));
    assert!(matches!(
        model("radtan", "1, 2, 3, 4"),
        Ok(Distortion::RadTan4 { p2: 4.0, .. })
    ));
    let error = |name: &str, d: &str| model(name, d).unwrap_err().to_string();
    assert!(error("plumb_bob", "1, 2, 3").contains("3 coefficients, expected 4 or 5 of plumb_bob"));
    assert!(error("brown", FIVE).contains("expected distortion_model to be plumb_bob or"));
    assert!(error("plumb_bob", "1, x, 3, 4, 5").contains("distortion_coefficients.data[1]"));
    let rotated = text(
        "plumb_bob",
        FIVE,
        "1., 0., 0., 0., 1., 0., 0., 0., -1.",
        0.0,
    );
    let error = read(&folder.file("camera.yaml", &rotated))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("left-handed") && error.contains("rectification_matrix"),
        "{error}"
    );

    let left = folder.file("left.yaml", &text("plumb_bob", FIVE, STRAIGHT, 0.0));
    folder.file("right.yaml", &text("plumb_bob", FIVE, STRAIGHT, -25_200.0));
    let error = read(&left).unwrap_err().to_string();
    assert!(
        error.contains("right is 63 m from the first camera"),
        "{error}"
    );
}

#[test]
fn the_real_pair_of_a_zed_2i() {
    let Some(path) = shared("06_calibration/grandtour/zed2i/zed_left.yaml") else {
        return;
    };
    let (set, notes) = crate::read_cameras(&path, None).unwrap();
    let (left, right) = (&set.cameras[0].model, &set.cameras[1].model);
    assert_eq!((left.fx, right.fx), (1063.605596325284, 1064.945423674698));
    assert!(matches!(
        right.distortion,
        Distortion::RadTan4 {
            k1: -0.05652460911455223,
            ..
        }
    ));
    assert_eq!(set.cameras[1].camera_from_first, None);
    let said = |what: &str| assert!(notes.iter().any(|n| n.0.contains(what)), "{notes:?}");
    said("no baseline");
    // The file has 1280 rows; this camera's mode with 1920 columns has 1080.
    said("is the size right?");
    let error = crate::read_stereo(&path, 1920, 1280)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("the pose of camera right is missing"),
        "{error}"
    );
}

#[test]
fn coefficients_without_a_model_are_rejected() {
    let folder = Folder::new();
    for name in ["none", "\"\""] {
        let model = |d: &str| {
            let path = folder.file("camera.yaml", &text(name, d, STRAIGHT, 0.0));
            read(&path).map(|(set, _)| set.cameras[0].model.distortion)
        };
        assert!(matches!(model("0, 0, 0, 0"), Ok(Distortion::None)));
        let error = model(FIVE).unwrap_err().to_string();
        assert!(
            error.contains("expected only zeros as distortion_coefficients.data"),
            "{error}"
        );
    }
}

#[test]
fn siblings_differ_in_the_last_word_of_their_names() {
    let folder = Folder::new();
    let sound = text("plumb_bob", FIVE, STRAIGHT, 0.0);
    let cameras = |name: &str| read(&folder.path().join(name)).unwrap().0.cameras.len();
    for name in [
        "left_shoulder_left",
        "right_shoulder_left",
        "leftover",
        "rightover",
    ] {
        folder.file(&format!("{name}.yaml"), &sound);
    }
    assert_eq!(cameras("left_shoulder_left.yaml"), 1);
    assert_eq!(cameras("leftover.yaml"), 1);
    let sibling = text("plumb_bob", FIVE, STRAIGHT, -25.2);
    folder.file("left_shoulder_right.yaml", &sibling);
    let (set, _) = read(&folder.path().join("left_shoulder_right.yaml")).unwrap();
    assert_eq!(
        set.provenance.files,
        ["left_shoulder_left.yaml", "left_shoulder_right.yaml"]
            .map(|name| folder.path().join(name))
    );
    for [left, right] in [["left", "right"], ["zed-left", "zed-right"]] {
        folder.file(&format!("{left}.yaml"), &sound);
        folder.file(&format!("{right}.yaml"), &sibling);
        assert_eq!(cameras(&format!("{left}.yaml")), 2);
        assert_eq!(cameras(&format!("{right}.yaml")), 2);
    }
}

#[test]
fn impossible_value_is_named_by_its_key() {
    let folder = Folder::new();
    let sound = text("plumb_bob", FIVE, STRAIGHT, 0.0);
    let path = folder.file("camera.yaml", &sound.replace("311.71339", "3117.1339"));
    let error = read(&path).unwrap_err().to_string();
    assert!(
        error.contains("line 7: camera_matrix.data: principal point (3117.1339, "),
        "{error}"
    );
    let left = folder.file("left.yaml", &sound);
    for (x, expected) in [
        (
            -25_200.0,
            "line 20: projection_matrix.data: right is 63 m from",
        ),
        (
            25.2,
            "line 20: projection_matrix.data: the left camera's origin is at x = 0.063 m",
        ),
    ] {
        folder.file("right.yaml", &text("plumb_bob", FIVE, STRAIGHT, x));
        let error = read(&left).unwrap_err().to_string();
        assert!(
            error.contains(expected) && error.ends_with("right.yaml"),
            "{error}"
        );
    }
}
