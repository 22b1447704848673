//! COLMAP models, text and binary, read back by small readers defined here.

use std::path::Path;

use cad_transforms::RigidTransform;
use camera_models::Lens;
use scene_bundle::export::{Format, Options, export};

use crate::export::{keyframes, near};
use crate::sample::{self, Sample};

/// An image of a COLMAP model: pose, number of its camera, name.
type Image = ([f64; 7], u32, String);
/// A point: position, color, error.
type Point = ([f64; 3], [u8; 3], f64);

struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let (head, rest) = self.0.split_first_chunk().expect("the file is long enough");
        self.0 = rest;
        *head
    }

    fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.take())
    }

    fn f64<const N: usize>(&mut self) -> [f64; N] {
        std::array::from_fn(|_| f64::from_le_bytes(self.take()))
    }
}

fn binary_model(folder: &Path) -> (Vec<Image>, Vec<Point>) {
    let bytes = std::fs::read(folder.join("images.bin")).unwrap();
    let mut bytes = Bytes(&bytes);
    let count = bytes.u64();
    let images = (1..=count).map(|id| {
        assert_eq!(u64::from(u32::from_le_bytes(bytes.take())), id);
        let pose = bytes.f64();
        let camera = u32::from_le_bytes(bytes.take());
        let mut name = String::new();
        while let [byte @ 1..=255] = bytes.take::<1>() {
            name.push(char::from(byte));
        }
        assert_eq!(bytes.u64(), 0, "2D points");
        (pose, camera, name)
    });
    let images = images.collect();
    assert!(bytes.0.is_empty());
    let points = std::fs::read(folder.join("points3D.bin")).unwrap();
    let mut bytes = Bytes(&points);
    let count = bytes.u64();
    let points = (1..=count).map(|id| {
        assert_eq!(bytes.u64(), id);
        let (place, color, [error]) = (bytes.f64(), bytes.take(), bytes.f64());
        assert_eq!(bytes.u64(), 0, "track");
        (place, color, error)
    });
    let points = points.collect();
    assert!(bytes.0.is_empty());
    (images, points)
}

fn text_model(folder: &Path) -> (Vec<Image>, Vec<Point>) {
    let lines = |name: &str| -> Vec<String> {
        let text = std::fs::read_to_string(folder.join(name)).unwrap();
        text.lines()
            .filter(|l| !l.starts_with('#'))
            .map(str::to_owned)
            .collect()
    };
    let numbers =
        |words: &[&str]| -> Vec<f64> { words.iter().map(|w| w.parse().unwrap()).collect() };
    let images = lines("images.txt");
    let images = (1..).zip(images.chunks(2)).map(|(id, pair)| {
        let [line, points] = pair else {
            panic!("two lines per image");
        };
        assert_eq!(points, "");
        let words: Vec<&str> = line.split(' ').collect();
        assert_eq!(words[0].parse::<u32>().unwrap(), id);
        let pose = numbers(&words[1..8]).try_into().unwrap();
        (pose, words[8].parse().unwrap(), words[9].to_owned())
    });
    let points = lines("points3D.txt");
    let points = (1..).zip(points.iter()).map(|(id, line)| {
        let words: Vec<&str> = line.split(' ').collect();
        assert_eq!(words[0].parse::<u64>().unwrap(), id);
        let place = numbers(&words[1..4]).try_into().unwrap();
        let color: [u8; 3] = std::array::from_fn(|i| words[4 + i].parse().unwrap());
        assert_eq!(words.len(), 8, "no track");
        (place, color, words[7].parse().unwrap())
    });
    (images.collect(), points.collect())
}

#[test]
fn colmap_text_and_binary_hold_the_same() {
    let sample = Sample::new();
    let options = Options {
        right: true,
        ..Options::default()
    };
    let [text, binary] = [Format::ColmapText, Format::ColmapBinary].map(|format| {
        let out = sample.out(format.name());
        export(&sample.scene(), format, &options, &out).unwrap();
        out
    });
    let names = |folder: &Path| sample::files(folder).into_keys().collect::<Vec<_>>();
    assert_eq!(names(&text), ["cameras.txt", "images.txt", "points3D.txt"]);
    assert_eq!(
        names(&binary),
        ["cameras.bin", "images.bin", "points3D.bin"]
    );
    let model = text_model(&text);
    assert_eq!(model, binary_model(&binary));
    let (from_text, _) = calibration_files::read_cameras(&text.join("cameras.txt"), None).unwrap();
    let (from_binary, _) =
        calibration_files::read_cameras(&binary.join("cameras.bin"), None).unwrap();
    assert_eq!(from_text.cameras, from_binary.cameras);

    // And it matches the bundle.
    let rig = sample::rig_model();
    let lenses: Vec<_> = from_text.cameras.iter().map(|c| c.model).collect();
    let eyes = rig.cameras.iter().flat_map(|c| [c.left, c.right]);
    // rad_tan5 is one of the rational ones in COLMAP; the lens means the same.
    for (found, expected) in lenses.iter().zip(eyes) {
        let [found, expected] =
            [found, &expected].map(|model| Lens::new(model).project([0.3, -0.2, 1.0]).unwrap());
        assert!((0..2).all(|i| (found[i] - expected[i]).abs() < 1e-12));
    }
    let text = std::fs::read_to_string(text.join("cameras.txt")).unwrap();
    // cx 31 of ours is 31.5 where pixels begin at their corner.
    assert!(
        text.contains("\n1 FULL_OPENCV 64 48 51.25 50.5 31.5 24.25 -0.12 "),
        "{text}"
    );
    let (images, points) = model;
    assert_eq!(images.len(), 12);
    for (pose, camera, name) in &images {
        let rig_camera = &rig.cameras[(*camera as usize - 1) / 2];
        let is_right = camera % 2 == 0;
        let number: u64 = name
            .rsplit_once('/')
            .unwrap()
            .1
            .trim_end_matches(".png")
            .parse()
            .unwrap();
        let side = if is_right { "right" } else { "left" };
        assert_eq!(*name, format!("{}/{side}/{number:06}.png", rig_camera.name));
        let place = rig
            .cameras
            .iter()
            .position(|c| c.name == rig_camera.name)
            .unwrap();
        let keyframe = keyframes()
            .into_iter()
            .find(|k| (usize::from(k.camera), k.frame) == (place, number))
            .unwrap();
        let [w, x, y, z, tx, ty, tz] = *pose;
        let camera_from_world = RigidTransform::from_wxyz([w, x, y, z], [tx, ty, tz]).unwrap();
        let left_from_world = keyframe.world_from_left.inverse();
        let expected = if is_right {
            rig_camera.right_from_left * left_from_world
        } else {
            left_from_world
        };
        assert!(near(&camera_from_world, &expected), "{name}");
    }
    assert_eq!(points.len(), 500);
    for (found, expected) in points.iter().zip(sample::points()) {
        assert_eq!(found.0, expected.x_in_world.map(f64::from));
        assert_eq!((found.1, found.2), (expected.color, -1.0));
    }
}
