//! Synthetic images of tags, by brute force, for tests.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion, Lens};
use imaging::ImageView;
use nalgebra::Vector3;

use crate::tag::Tag;
use crate::view::{Motion, RowPose, View, window};

pub(crate) const SIZE: [usize; 2] = [160, 120];

pub(crate) fn lens() -> Lens {
    let distortion = Distortion::RadTan4 {
        k1: -0.17,
        k2: 0.025,
        p1: 2e-4,
        p2: -1e-4,
    };
    Lens::new(&CameraModel::new(
        (160, 120),
        [367.0, 367.0, 80.0, 61.0],
        distortion,
    ))
}

/// What a synthetic image differs in.
#[derive(Clone, Copy)]
pub(crate) struct Imaging {
    pub(crate) blur_px: f64,
    pub(crate) tone: f64,
    pub(crate) noise: f64,
    pub(crate) line_s: f64,
    pub(crate) exposure_s: f64,
    /// Cells of mud, as a share.
    pub(crate) dirt: f64,
}

pub(crate) const CLEAN: Imaging = Imaging {
    blur_px: 0.7,
    tone: 0.45,
    noise: 1.0,
    line_s: 0.0,
    exposure_s: 0.0,
    dirt: 0.0,
};

/// Uniform numbers from 0 to 1.
pub(crate) struct Draw(pub(crate) u64);

impl Draw {
    pub(crate) fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub(crate) fn bell(&mut self) -> f64 {
        (0..12).map(|_| self.next()).sum::<f64>() - 6.0
    }
}

/// Renders a tag by brute force: rays through every pixel, spread over the blur and the exposure.
pub(crate) fn render(
    lens: &Lens,
    tag: &Tag,
    eye_from_reference: &RigidTransform,
    pose: &RigidTransform,
    motion: &Motion,
    imaging: &Imaging,
    draw: &mut Draw,
) -> Vec<u8> {
    let [width, height] = SIZE;
    let pixels = vec![0; width * height];
    let view = View {
        image: ImageView::packed(width, height, &pixels).unwrap(),
        lens,
        eye_from_reference: *eye_from_reference,
        line_s: imaging.line_s,
        exposure_s: imaging.exposure_s,
    };
    let dirty: Vec<bool> = (0..100).map(|_| draw.next() < imaging.dirt).collect();
    let light = |pose: &RowPose, ray: &Vector3<f64>| {
        let Some(point) = pose.meet(ray) else {
            return 0.2;
        };
        let place = point.at.map(|v| v / tag.cell_m() + tag.half_cells());
        if place.iter().any(|v| *v < 0.0 || *v >= tag.cells() as f64) {
            return 0.15 + 0.05 * libm::sin(20.0 * point.at[0] / tag.size_m);
        }
        let [x, y] = place.map(|v| v as usize);
        match (dirty[y * 10 + x], tag.is_white(y, x)) {
            (true, _) => 0.12,
            (false, true) => 0.6,
            (false, false) => 0.03,
        }
    };
    let ray = |column: f64, row: f64| {
        let ray = Vector3::from(lens.unproject([column, row]).unwrap());
        ray / ray.z
    };
    let Some((from, size)) = window(&view, tag, pose, 6.0) else {
        panic!("the tag is in the image")
    };
    let samples = samples();
    let mut image = vec![90; width * height];
    for row in from[1]..from[1] + size[1] {
        for column in from[0]..from[0] + size[0] {
            let (x, y) = (column as f64, row as f64);
            let middle = ray(x, y);
            let by_pixel = [
                ray(x + 0.5, y) - ray(x - 0.5, y),
                ray(x, y + 0.5) - ray(x, y - 0.5),
            ];
            let pose_at = |t: f64| {
                let time_s = view.row_s(row) + imaging.exposure_s * t;
                RowPose::new(&view, pose, motion, time_s)
            };
            let at_middle = pose_at(0.0);
            let mut sum = 0.0;
            for [dx, dy, t] in &samples {
                let moved = [dx, dy].map(|[box_px, bell]| box_px + imaging.blur_px * bell);
                let ray = middle + by_pixel[0] * moved[0] + by_pixel[1] * moved[1];
                sum += match imaging.exposure_s > 0.0 {
                    true => light(&pose_at(t[0]), &ray),
                    false => light(&at_middle, &ray),
                };
            }
            let mean = sum / samples.len() as f64;
            let level = 255.0 * libm::pow(mean, imaging.tone) + imaging.noise * draw.bell();
            image[row * width + column] = (level + 0.5).clamp(0.0, 255.0) as u8;
        }
    }
    image
}

/// Evenly distributed samples of the width of a pixel and a standard normal number, along both
/// axes, and of the exposure: an additive recurrence with the powers of the inverse of the root of
/// x^6 = x + 1.
fn samples() -> Vec<[[f64; 2]; 3]> {
    const ROOT: f64 = 1.134_724_138_401_519_5;
    let sample = |n: u32| {
        let uniform = |k: i32| (0.5 + f64::from(n + 1) * ROOT.powi(-k)).fract();
        let (radius, angle) = (
            (-2.0 * libm::log(1.0 - uniform(3))).sqrt(),
            std::f64::consts::TAU * uniform(4),
        );
        [
            [uniform(1) - 0.5, radius * libm::cos(angle)],
            [uniform(2) - 0.5, radius * libm::sin(angle)],
            [uniform(5) - 0.5, 0.0],
        ]
    };
    (0..512).map(sample).collect()
}
