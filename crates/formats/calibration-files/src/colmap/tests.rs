use camera_models::Lens;

use super::*;
use crate::files::Disk;
use crate::test_data::Folder;

/// The reader on files on disk.
fn read(path: &Path) -> SetResult {
    super::read(&Disk, path, None)
}

const TEXT: &str = "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n\
                    3 SIMPLE_RADIAL 640 480 500 320 240 -0.1\n1 OPENCV 640 480 500 501 321.5 241.5 0.1 0.01 0.001 \
                    0.002\n7 OPENCV_FISHEYE 640 480 300 300 320 240 0.01 0.02 0.03 0.04\n";

#[test]
fn pixel_conventions_differ_by_half_a_pixel() {
    let folder = Folder::new();
    let (set, notes) = read(&folder.file("cameras.txt", TEXT)).unwrap();
    assert_eq!(set.names(), ["3", "1", "7"]);
    let m = &set.cameras[0].model;
    // The centre of an image of 640 columns is 320 in COLMAP's coordinates and 319.5 in ours.
    assert_eq!((m.cx, m.cy, m.fx, m.fy), (319.5, 239.5, 500.0, 500.0));
    let axis = Lens::new(m).project([0.0, 0.0, 1.0]).unwrap();
    assert_eq!(axis, [0.5 * (640.0 - 1.0), 0.5 * (480.0 - 1.0)]);
    assert_eq!(m.distortion, Distortion::Radial2 { k1: -0.1, k2: 0.0 });
    assert!(notes[0].0.contains("no rigs.txt"), "{notes:?}");
    let output = write(&set, Form::Text).unwrap();
    let text = String::from_utf8(output.files[0].1.clone()).unwrap();
    assert!(
        text.contains("1 RADIAL 640 480 500.0 320.0 240.0 -0.1 0.0\n"),
        "{text}"
    );
    assert!(
        text.contains("2 OPENCV 640 480 500.0 501.0 321.5 241.5 0.1 "),
        "{text}"
    );
}

/// A camera for each of many images.
#[test]
fn a_file_of_many_cameras_is_read() {
    let folder = Folder::new();
    let lines = (0..20_000).map(|id| {
        format!("{id} OPENCV 640 480 500.125 501.125 321.5 241.5 0.1 0.01 0.001 0.002\n")
    });
    let text: String = lines.collect();
    assert!(text.len() as u64 > plain_file::TEXT_LIMIT);
    let path = folder.file("cameras.txt", &text);
    let (set, _) = crate::read_cameras(&path, None).unwrap();
    assert_eq!(set.cameras.len(), 20_000);
}

#[test]
fn a_rig_places_its_cameras() {
    let folder = Folder::new();
    let path = folder.file("cameras.txt", TEXT);
    // The reference is camera 1; sensor_from_rig of camera 3 puts the rig's origin at x = 0.1.
    folder.file(
        "rigs.txt",
        "# rigs\n1 1 CAMERA 9\n2 4 CAMERA 1 IMU 1 1 1 0 0 0 0 0 0 CAMERA 3 1 1 0 0 0 0.1 0 0 CAMERA 7 0\n",
    );
    let (set, _) = read(&path).unwrap();
    let place = |i: usize| set.cameras[i].camera_from_first.map(|t| t.translation_m());
    assert_eq!(
        (place(0), place(1), place(2)),
        (Some([0.0; 3]), Some([-0.1, 0.0, 0.0]), None)
    );
    folder.file("rigs.txt", "2 2 CAMERA 3 CAMERA 1 1 1 0 0\n");
    let error = read(&path).unwrap_err().to_string();
    assert!(error.contains("expected QZ before the end"), "{error}");
    folder.file("rigs.txt", "2 2 CAMERA 3 CAMERA 1 1 0.9 0 0 0 0 0 0\n");
    let error = read(&path).unwrap_err().to_string();
    assert!(
        error.contains("a pose of sensor 1 where the quaternion's norm"),
        "{error}"
    );
}

#[test]
fn text_and_binary_hold_the_same() {
    let folder = Folder::new();
    let (set, _) = read(&folder.file("cameras.txt", TEXT)).unwrap();
    let output = write(&set, Form::Binary).unwrap();
    let bytes = &output.files[0].1;
    assert_eq!(bytes[..12], [3, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0]);
    let path = folder.path().join("cameras.bin");
    std::fs::write(&path, bytes).unwrap();
    let (again, _) = read(&path).unwrap();
    for (a, b) in set.cameras.iter().zip(&again.cameras) {
        assert_eq!(a.model, b.model);
    }
    // Every shorter and longer file is an error.
    for end in 0..bytes.len() {
        std::fs::write(&path, &bytes[..end]).unwrap();
        assert!(read(&path).is_err(), "{end} bytes");
    }
    std::fs::write(&path, [&bytes[..], &[0]].concat()).unwrap();
    assert!(
        read(&path)
            .unwrap_err()
            .to_string()
            .contains("1 bytes behind the last")
    );
    std::fs::write(&path, [0xff; 80]).unwrap();
    assert!(read(&path).is_err());
}

#[test]
fn invalid_files_are_rejected() {
    let folder = Folder::new();
    for (text, expected) in [
        (
            "1 FOV 640 480 1 1 1 1 1\n",
            "line 1: found \"FOV\", expected one of SIMPLE_PINHOLE",
        ),
        (
            "1 PINHOLE 640 480 500 500 320\n",
            "3 parameters, expected 4 of PINHOLE",
        ),
        (
            "1 PINHOLE 640 480 500 500 320,5 240\n",
            "expected a decimal point",
        ),
        (
            "1 PINHOLE 640 480 nan 500 320 240\n",
            "expected a finite number",
        ),
        ("1 PINHOLE 640\n", "expected CAMERA_ID MODEL WIDTH HEIGHT"),
        ("1 PINHOLE 64.0 480 1 1 1 1\n", "expected a whole number"),
        ("1 PINHOLE 9 9 1 1 1 1\n1 PINHOLE 9 9 1 1 1 1\n", "line 2"),
        ("# nothing\n", "a camera is missing"),
    ] {
        let error = read(&folder.file("cameras.txt", text))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains(expected),
            "found {error:?}, expected {expected:?}"
        );
    }
}

#[test]
fn truncated_file_is_noted() {
    let folder = Folder::new();
    let camera = |id: u32| format!("{id} PINHOLE 640 480 500 500 320 240\n");
    let text = format!("# Number of cameras: 2\n{}", camera(1));
    let path = folder.file("cameras.txt", &text);
    let notes = |path: &Path| -> Vec<String> {
        let (_, notes) = read(path).unwrap();
        notes.into_iter().map(|note| note.0).collect()
    };
    assert_eq!(
        notes(&path),
        ["the file says that it has 2 cameras, found 1: was it cut off?"]
    );
    folder.file("rigs.txt", "# Number of rigs: 1\n");
    folder.file("cameras.txt", &format!("{text}{}", camera(2)));
    assert_eq!(
        notes(&path),
        ["rigs.txt does not say where camera 2 is beside camera 1"]
    );
    folder.file("rigs.txt", "1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 -0.1 0 0\n");
    assert_eq!(notes(&path), [""; 0]);
}
