//! What is encoded in tests and measurements: synthetic images that are hard to compress, and real
//! stereo images where the shared data set is present.

use std::fs::{self, File};
use std::io::BufReader;
use std::path::{Path, PathBuf};

use video::raw_image::{grey_to_i420, rgb_to_i420, side_by_side};
use video::{PixelFormat, RawImage};

/// A smooth pseudo-random field in -1..1 with cells of one unit.
fn field(x: f64, y: f64, seed: u32) -> f64 {
    let corner = |x: i64, y: i64| {
        let mut hash = (x as u32).wrapping_mul(0x9e37_79b1)
            ^ (y as u32).wrapping_mul(0x85eb_ca77)
            ^ seed.wrapping_mul(0xc2b2_ae3d);
        hash = (hash ^ (hash >> 15)).wrapping_mul(0x2c1b_3c6d);
        hash = (hash ^ (hash >> 12)).wrapping_mul(0x297a_2d39);
        f64::from(hash ^ (hash >> 15)) / f64::from(u32::MAX) * 2.0 - 1.0
    };
    let (left, top) = (x.floor(), y.floor());
    let ease = |t: f64| t * t * (3.0 - 2.0 * t);
    let (u, v) = (ease(x - left), ease(y - top));
    let (left, top) = (left as i64, top as i64);
    let upper = corner(left, top) * (1.0 - u) + corner(left + 1, top) * u;
    let lower = corner(left, top + 1) * (1.0 - u) + corner(left + 1, top + 1) * u;
    upper * (1.0 - v) + lower * v
}

/// `count` images of a 1/f texture (equal variance in every octave, standard deviation about 40
/// grey levels) that moves by 1.7 and 0.6 pixels per image, with sensor noise of standard
/// deviation 1.6 on top. Chroma likewise, without the noise.
pub(crate) fn texture(width: u32, height: u32, count: usize) -> Vec<RawImage> {
    let octaves = 8;
    let sample = |x: f64, y: f64, seed: u32| {
        let sum: f64 = (0..octaves)
            .map(|octave| {
                field(
                    x / f64::from(1 << octave),
                    y / f64::from(1 << octave),
                    seed + octave,
                )
            })
            .sum();
        128.0 + 40.0 * sum / f64::from(octaves).sqrt() / 0.43
    };
    let mut state = 0x2545_f491_4f6c_dd1du64;
    let mut noise = move || {
        // The sum of four uniform numbers is close enough to a normal one.
        let mut sum = 0.0;
        for _ in 0..4 {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            sum += (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
        }
        1.6 * sum * 3f64.sqrt()
    };
    (0..count)
        .map(|number| {
            let (dx, dy) = (1.7 * number as f64, 0.6 * number as f64);
            let mut data = Vec::with_capacity(PixelFormat::I420.bytes(width, height).unwrap());
            for y in 0..height {
                for x in 0..width {
                    let value = sample(f64::from(x) + dx, f64::from(y) + dy, 1) + noise();
                    data.push(value.round().clamp(0.0, 255.0) as u8);
                }
            }
            for seed in [101, 201] {
                for y in 0..height / 2 {
                    for x in 0..width / 2 {
                        let value = sample(f64::from(x) + dx / 2.0, f64::from(y) + dy / 2.0, seed);
                        data.push((128.0 + (value - 128.0) / 2.0).round().clamp(0.0, 255.0) as u8);
                    }
                }
            }
            RawImage::new(width, height, PixelFormat::I420, data).unwrap()
        })
        .collect()
}

/// One PNG file as I420.
fn png(path: &Path) -> RawImage {
    let file = BufReader::new(File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut data = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut data).unwrap();
    data.truncate(info.buffer_size());
    match info.color_type {
        png::ColorType::Grayscale => {
            grey_to_i420(&RawImage::new(info.width, info.height, PixelFormat::Grey8, data).unwrap())
        }
        png::ColorType::Rgb => rgb_to_i420(info.width, info.height, &data),
        other => panic!("{other:?}: {}", path.display()),
    }
    .unwrap()
}

fn folder(path: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = fs::read_dir(path)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "png"));
    files.sort();
    files
}

/// Real stereo recordings, side by side: a name and the images of each. Empty without the data.
pub(crate) fn recordings(count: usize) -> Vec<(&'static str, Vec<RawImage>)> {
    let Some(root) = test_data::shared("") else {
        return Vec::new();
    };
    let pairs = |left: &str, right: &str| -> Vec<RawImage> {
        let (left, right) = (folder(&root.join(left)), folder(&root.join(right)));
        left.iter()
            .zip(&right)
            .take(count)
            .map(|(left, right)| side_by_side(&png(left), &png(right)).unwrap())
            .collect()
    };
    let kitti = "02_stereo_odometry_kitti/KITTI_sequence_1";
    let euroc = "03_stereo_imu/euroc_V1_01_micro/mav0";
    let desk = root.join("01_stereo_depth/foundationstereo_demo");
    let desk = side_by_side(&png(&desk.join("left.png")), &png(&desk.join("right.png"))).unwrap();
    vec![
        (
            "KITTI",
            pairs(&format!("{kitti}/image_l"), &format!("{kitti}/image_r")),
        ),
        (
            "EuRoC",
            pairs(&format!("{euroc}/cam0/data"), &format!("{euroc}/cam1/data")),
        ),
        ("desk", vec![desk; count.min(4)]),
    ]
}
