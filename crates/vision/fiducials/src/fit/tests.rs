use boards::Dictionary;
use camera_models::{CameraModel, Distortion, Lens};
use imaging::ImageView;
use nalgebra::Vector3;

use super::*;
use crate::view::{RowPose, window};

const SIZE: [usize; 2] = [160, 120];

fn lens() -> Lens {
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
struct Imaging {
    blur_px: f64,
    tone: f64,
    noise: f64,
    line_s: f64,
    exposure_s: f64,
    /// Cells of mud, as a share.
    dirt: f64,
}

const CLEAN: Imaging = Imaging {
    blur_px: 0.7,
    tone: 0.45,
    noise: 1.0,
    line_s: 0.0,
    exposure_s: 0.0,
    dirt: 0.0,
};

/// Uniform numbers from 0 to 1.
struct Draw(u64);

impl Draw {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn bell(&mut self) -> f64 {
        (0..12).map(|_| self.next()).sum::<f64>() - 6.0
    }
}

/// Renders a tag by brute force: rays through every pixel, spread over the blur and the exposure.
fn render(
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
    let light = |pose: &RowPose, column: f64, row: f64| {
        let ray = lens.unproject([column, row]).unwrap();
        let Some(point) = pose.meet(&Vector3::from(ray)) else {
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
    let Some((from, size)) = window(&view, tag, pose, 6.0) else {
        panic!("the tag is in the image")
    };
    let samples = samples();
    let mut image = vec![90; width * height];
    for row in from[1]..from[1] + size[1] {
        for column in from[0]..from[0] + size[0] {
            let mut sum = 0.0;
            for [dx, dy, t] in &samples {
                let time_s = view.row_s(row) + imaging.exposure_s * t[0];
                let pose = RowPose::new(&view, pose, motion, time_s);
                let [x, y] = [0, 1].map(|k| {
                    let (box_px, bell) = if k == 0 {
                        (dx[0], dx[1])
                    } else {
                        (dy[0], dy[1])
                    };
                    box_px + imaging.blur_px * bell
                });
                sum += light(&pose, column as f64 + x, row as f64 + y);
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

fn transform(rotation: [f64; 3], translation: [f64; 3]) -> RigidTransform {
    RigidTransform::from_rotation_vector(rotation, translation).unwrap()
}

/// Errors of fits: RMS of rotation about the tag's axes, degrees, and translation along them, mm,
/// and the mean squared error in stated sigmas per dimension.
fn errors(tilt_rad: f64, imaging: &Imaging, motion: &Motion, count: u64) -> ([f64; 6], f64, u32) {
    let tag = Tag::new(Dictionary::AprilTag36h11, 1, 0.06).unwrap();
    let lens = lens();
    let right = transform([0.0; 3], [-0.063, 0.0, 0.0]);
    let eyes = [RigidTransform::identity(), right];
    let mut squares = [0.0; 6];
    let (mut nees, mut wrong) = (0.0, 0);
    for n in 0..count {
        let mut draw = Draw(1000 + n);
        let truth = transform(
            [0.1 * draw.bell(), tilt_rad, 0.4 * draw.bell()],
            [0.03 + 0.01 * draw.bell(), 0.02 * draw.bell(), 1.1],
        );
        let images = eyes.map(|eye| render(&lens, &tag, &eye, &truth, motion, imaging, &mut draw));
        let views: Vec<View<'_>> = (images.iter().zip(eyes))
            .map(|(image, eye_from_reference)| View {
                image: ImageView::packed(SIZE[0], SIZE[1], image).unwrap(),
                lens: &lens,
                eye_from_reference,
                line_s: imaging.line_s,
                exposure_s: imaging.exposure_s,
            })
            .collect();
        let start = truth
            * transform(
                [0.05 * draw.bell(), 0.05 * draw.bell(), 0.03 * draw.bell()],
                [0.001 * draw.bell(), 0.001 * draw.bell(), 0.01 * draw.bell()],
            );
        let found = fit(&views, &tag, &start, motion, &Config::default()).expect("a fit");
        let error = truth.inverse() * found.reference_from_tag;
        let rotation = error.rotation_vector();
        let translation = error.translation_m();
        let vector = nalgebra::Vector6::from_fn(|k, _| {
            if k < 3 {
                rotation[k]
            } else {
                translation[k - 3]
            }
        });
        for k in 0..6 {
            let unit = if k < 3 { 57.3 } else { 1e3 };
            squares[k] += (unit * vector[k]).powi(2) / count as f64;
        }
        let inverse = found.covariance.try_inverse().unwrap();
        nees += (vector.transpose() * inverse * vector)[0] / 6.0 / count as f64;
        wrong = wrong.max(found.wrong_bits);
    }
    (squares.map(f64::sqrt), nees, wrong)
}

#[test]
fn print() {
    let still = Motion::default();
    let moving = Motion {
        linear: [0.9, 0.6, 0.0],
        angular: [0.0, 0.0, 1.0],
    };
    for (name, tilt, imaging, motion) in [
        ("fronto", 0.05, CLEAN, still),
        ("tilted", 0.35, CLEAN, still),
        (
            "noisy",
            0.35,
            Imaging {
                noise: 5.0,
                ..CLEAN
            },
            still,
        ),
        ("linear", 0.35, Imaging { tone: 1.0, ..CLEAN }, still),
        (
            "soft",
            0.35,
            Imaging {
                blur_px: 1.2,
                ..CLEAN
            },
            still,
        ),
        ("dirty", 0.35, Imaging { dirt: 0.2, ..CLEAN }, still),
        (
            "rolling",
            0.35,
            Imaging {
                line_s: 0.0085 / 376.0,
                ..CLEAN
            },
            moving,
        ),
        (
            "blurred",
            0.35,
            Imaging {
                line_s: 0.0085 / 376.0,
                exposure_s: 0.008,
                ..CLEAN
            },
            moving,
        ),
    ] {
        let begin = std::time::Instant::now();
        let (rms, nees, wrong) = errors(tilt, &imaging, &motion, 10);
        println!(
            "{name:8} deg {:.2?} mm {:.2?} nees {nees:.2} wrong {wrong} {:?}",
            &rms[..3],
            &rms[3..],
            begin.elapsed()
        );
    }
}
