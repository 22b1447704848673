use super::*;
use crate::files::Disk;
use crate::test_data::{Folder, shared};

/// The reader on files on disk.
fn read(path: &Path) -> SetResult {
    super::read(&Disk, path, None)
}

/// `world_from_camera` of each frame.
fn poses(path: &Path) -> Vec<RigidTransform> {
    let disk: &dyn Files = &Disk;
    let source = disk.document(path).unwrap();
    let tree = json::parse(&source).unwrap();
    let frames = At::root(&source, &tree).get("frames").unwrap();
    let frames = frames.items().unwrap();
    frames.iter().map(|frame| pose(frame).unwrap()).collect()
}

/// All frames of a recording, longer than any handwritten file.
#[test]
fn a_file_of_many_frames_is_read() {
    let folder = Folder::new();
    let frame = "{\"file_path\": \"images/frame.png\", \"transform_matrix\": [[1.0, 0.0, 0.0, 5.0], [0.0, 0.0, -1.0, \
                 6.0], [0.0, 1.0, 0.0, 7.0], [0.0, 0.0, 0.0, 1.0]]}";
    let frames = vec![frame; 9000].join(",\n");
    let text = format!("{{\"fl_x\": 500, \"w\": 640, \"h\": 480, \"frames\": [{frames}]}}");
    assert!(text.len() as u64 > plain_file::TEXT_LIMIT);
    let path = folder.file("transforms.json", &text);
    let (set, _) = crate::read_cameras(&path, None).unwrap();
    assert_eq!(set.cameras[0].model.fx, 500.0);
    assert_eq!(poses(&path).len(), 9000);
}

#[test]
fn too_long_file_is_an_error_with_advice() {
    let folder = Folder::new();
    for (name, limit) in [
        ("transforms.json", plain_file::DOCUMENT_LIMIT),
        ("cameras.bin", plain_file::DOCUMENT_LIMIT),
        ("chain.yaml", plain_file::TEXT_LIMIT),
    ] {
        let path = folder.file(name, "");
        let file = std::fs::File::options().write(true).open(&path).unwrap();
        file.set_len(limit + 1).unwrap();
        let error = crate::read_cameras(&path, None).unwrap_err().to_string();
        let found = format!("found {} bytes, expected at most {limit}", limit + 1);
        for part in [&found[..], "make one that has the cameras alone", name] {
            assert!(error.contains(part), "no {part:?} in {error}");
        }
    }
}

#[test]
fn axes_and_half_pixels() {
    let folder = Folder::new();
    let text = "{\"fl_x\": 500, \"cx\": 320, \"cy\": 240, \"w\": 640.0, \"h\": 480, \"k1\": 0.1, \"k3\": 0.01, \
                \"frames\": [{\"file_path\": \"a.png\", \"transform_matrix\": [[1, 0, 0, 5], [0, 0, -1, 6], [0, 1, 0, \
                7], [0, 0, 0, 1]]}]}";
    let path = folder.file("transforms.json", text);
    let (set, _) = read(&path).unwrap();
    let m = &set.cameras[0].model;
    assert_eq!((m.fx, m.fy, m.cx, m.cy), (500.0, 500.0, 319.5, 239.5));
    assert!(matches!(
        m.distortion,
        Distortion::RadTan5 {
            k1: 0.1,
            k3: 0.01,
            ..
        }
    ));
    let world_from_camera = poses(&path)[0];
    // This camera faces along OpenGL's -z, which the matrix takes to the world's +y, and its y (up)
    // to the world's +z: an upright image, facing north.
    let ahead = world_from_camera.apply([0.0, 0.0, 2.0]);
    let down = world_from_camera.rotate([0.0, 1.0, 0.0]);
    for (found, expected) in [(ahead, [5.0, 8.0, 7.0]), (down, [0.0, 0.0, -1.0])] {
        for i in 0..3 {
            assert!((found[i] - expected[i]).abs() < 1e-12, "{found:?}");
        }
    }
}

#[test]
fn lenses_per_frame_and_angles_of_view() {
    let folder = Folder::new();
    let text = "{\"w\": 640, \"h\": 480, \"camera_model\": \"OPENCV_FISHEYE\", \"k2\": 0.2, \"frames\": [{\"fl_x\": 300, \
                \"file_path\": \"x/a.png\"}, {\"fl_x\": 301, \"file_path\": \"x/b.png\"}, {\"fl_x\": 300}]}";
    let error = read(&folder.file("t.json", text)).unwrap_err().to_string();
    assert!(error.contains("fl_x is missing"), "{error}");
    let text = text.replacen("\"w\"", "\"camera_angle_x\": 1.5707963267948966, \"w\"", 1);
    let (set, notes) = read(&folder.file("t.json", &text)).unwrap();
    assert_eq!(set.names(), ["camera", "a", "b"]);
    assert!((set.cameras[0].model.fx - 320.0).abs() < 1e-12);
    assert!(matches!(
        set.cameras[1].model.distortion,
        Distortion::KannalaBrandt4 { k2: 0.2, .. }
    ));
    assert!(notes.iter().any(|n| n.0.contains("several lenses")));
    assert!(notes.iter().any(|n| n.0.contains("no cx")));
    let k4 = text.replace("OPENCV_FISHEYE", "OPENCV").replace("k2", "k4");
    let error = read(&folder.file("t.json", &k4)).unwrap_err().to_string();
    assert!(error.contains("r to the 8th"), "{error}");
}

#[test]
fn the_fox() {
    let Some(path) = shared("07_multiview/fox/transforms.json") else {
        return;
    };
    let (set, _) = read(&path).unwrap();
    let m = &set.cameras[0].model;
    assert_eq!(
        (m.fx, m.fy, m.cx, m.cy),
        (1375.52, 1374.49, 554.058, 964.768)
    );
    assert!(matches!(
        m.distortion,
        Distortion::RadTan4 { k1: 0.0578421, .. }
    ));
    let poses = poses(&path);
    assert_eq!(poses.len(), 67);
    // Images taken around one object face its middle.
    let mut middle = [0.0; 3];
    for pose in &poses {
        let at = pose.translation_m();
        (0..3).for_each(|i| middle[i] += at[i] / 67.0);
    }
    let ahead: Vec<[f64; 3]> = poses.iter().map(|p| p.rotate([0.0, 0.0, 1.0])).collect();
    let mut mean = [0.0; 3];
    for a in &ahead {
        (0..3).for_each(|i| mean[i] += a[i] / 67.0);
    }
    // Nobody photographs with the camera upside down: down in the image is down in the world.
    assert!(poses.iter().all(|p| p.rotate([0.0, 1.0, 0.0])[2] < 0.0));
}

/// A pair with shared intrinsics.
const SHARED_LENS: &str = "{\"fl_x\": 500, \"fl_y\": 501, \"cx\": 320, \"cy\": 240, \"w\": 640, \"h\": 480, \"k1\": 0.1,
 \"frames\": [
 {\"file_path\": \"left.png\", \"transform_matrix\": [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]},
 {\"file_path\": \"right.png\", \"transform_matrix\": [[1, 0, 0, 0.625], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}]}";

#[test]
fn a_pair_may_share_its_lens() {
    let folder = Folder::new();
    let (set, notes) = read(&folder.file("t.json", SHARED_LENS)).unwrap();
    assert!(notes.is_empty(), "{notes:?}");
    assert_eq!(set.names(), ["left", "right"]);
    assert_eq!(set.cameras[0].model, set.cameras[1].model);
    let placed = set.cameras[1].camera_from_first.unwrap();
    assert_eq!(placed.translation_m(), [-0.125, 0.0, 0.0]);
    // Values of the frame take precedence.
    let own = SHARED_LENS.replace("\"right.png\"", "\"right.png\", \"fl_x\": 510, \"k1\": 0.2");
    let (set, _) = read(&folder.file("t.json", &own)).unwrap();
    let right = &set.cameras[1].model;
    assert_eq!(
        (set.cameras[0].model.fx, right.fx, right.fy),
        (500.0, 510.0, 501.0)
    );
    assert!(matches!(
        right.distortion,
        Distortion::RadTan4 { k1: 0.2, .. }
    ));
}

#[test]
fn impossible_value_is_named_by_its_key() {
    let folder = Folder::new();
    let check = |from: &str, to: &str, expected: &str| {
        let path = folder.file("t.json", &SHARED_LENS.replacen(from, to, 1));
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    };
    check("500", "-500", "line 1: fl_x: focal lengths -500 and 501");
    check("320", "3200", "line 1: cx: principal point (3199.5, 239.5)");
    check(
        "0.625",
        "62.5",
        "line 4: frames[1].transform_matrix: right is 62 m from",
    );
    check(
        "0.625",
        "0.25",
        "line 4: frames[1].transform_matrix: the left camera's origin is at x = 0.25 m",
    );
    let model = |name: &str| {
        SHARED_LENS.replace(
            "{\"fl_x\"",
            &format!("{{\"camera_model\": \"{name}\", \"fl_x\""),
        )
    };
    let error = read(&folder.file("t.json", &model("PINHOLE")))
        .unwrap_err()
        .to_string();
    assert!(error.contains("expected 0 of PINHOLE as k1"), "{error}");
    let fisheye = model("OPENCV_FISHEYE").replace("k1", "p1");
    let error = read(&folder.file("t.json", &fisheye))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("expected 0 of OPENCV_FISHEYE as p1"),
        "{error}"
    );
}
