use boards::Dictionary;
use imaging::ImageView;
use nalgebra::Vector6;

use super::*;
use crate::planar_pose::poses_from_corners;
use crate::search::{SearchConfig, Searcher};
use crate::test_images::{CLEAN, Draw, Imaging, SIZE, lens, render};

/// Baseline of the eyes, m.
const BASELINE_M: f64 = 0.063;
const STILL: Motion = Motion {
    linear: [0.0; 3],
    angular: [0.0; 3],
};
/// Some 2.5 cells during 8 ms.
const WALKING: Motion = Motion {
    linear: [1.9, 1.2, 0.0],
    angular: [0.0, 0.0, 1.0],
};
const ROLLING_S: f64 = 0.0085 / 376.0;

fn transform(rotation: [f64; 3], translation: [f64; 3]) -> RigidTransform {
    RigidTransform::from_rotation_vector(rotation, translation).unwrap()
}

fn tag() -> Tag {
    Tag::new(Dictionary::AprilTag36h11, 1, 0.06).unwrap()
}

/// A tag of 20 px before one or two eyes.
struct Scene {
    truth: RigidTransform,
    eyes: Vec<RigidTransform>,
    images: Vec<Vec<u8>>,
    motion: Motion,
    imaging: Imaging,
    lens: camera_models::Lens,
}

impl Scene {
    fn new(tilt_rad: f64, eyes: usize, imaging: Imaging, motion: Motion, draw: &mut Draw) -> Self {
        let truth = transform(
            [0.1 * draw.bell(), tilt_rad, 0.4 * draw.bell()],
            [0.03 + 0.01 * draw.bell(), 0.02 * draw.bell(), 1.1],
        );
        let lens = lens();
        let right = transform([0.0; 3], [-BASELINE_M, 0.0, 0.0]);
        let eyes = [RigidTransform::identity(), right][..eyes].to_vec();
        let image = |eye| render(&lens, &tag(), eye, &truth, &motion, &imaging, draw);
        let images = eyes.iter().map(image).collect();
        Self {
            truth,
            eyes,
            images,
            motion,
            imaging,
            lens,
        }
    }

    fn views(&self) -> Vec<View<'_>> {
        self.images
            .iter()
            .zip(&self.eyes)
            .map(|(image, eye)| View {
                image: ImageView::packed(SIZE[0], SIZE[1], image).unwrap(),
                lens: &self.lens,
                eye_from_reference: *eye,
                line_s: self.imaging.line_s,
                exposure_s: self.imaging.exposure_s,
            })
            .collect()
    }

    /// A start as a prediction gives it.
    fn start(&self, draw: &mut Draw) -> RigidTransform {
        self.truth
            * transform(
                [0.05 * draw.bell(), 0.05 * draw.bell(), 0.03 * draw.bell()],
                [0.002 * draw.bell(), 0.002 * draw.bell(), 0.01 * draw.bell()],
            )
    }

    /// Error of a fit: rotation, rad, and translation, m, along the axes of the tag.
    fn error(&self, fit: &Fit) -> Vector6<f64> {
        let error = self.truth.inverse() * fit.reference_from_tag;
        let ([a, b, c], [x, y, z]) = (error.rotation_vector(), error.translation_m());
        Vector6::new(a, b, c, x, y, z)
    }

    fn fit(&self, draw: &mut Draw) -> Option<Fit> {
        let start = self.start(draw);
        fit(
            &self.views(),
            &tag(),
            &start,
            &self.motion,
            &Config::default(),
        )
    }
}

/// Root mean square error of fits: tilt, degrees, in the plane and along the normal, mm; and the
/// mean squared error in stated sigmas, by dimension.
fn errors(tilt_rad: f64, imaging: Imaging, motion: Motion) -> ([f64; 3], f64) {
    const COUNT: u64 = 6;
    let (mut squares, mut nees) = (Vector6::zeros(), 0.0);
    for seed in 0..COUNT {
        let mut draw = Draw(1000 + seed);
        let scene = Scene::new(tilt_rad, 2, imaging, motion, &mut draw);
        let found = scene.fit(&mut draw).expect("a fit");
        assert!(found.wrong_bits <= 3, "{}", found.wrong_bits);
        let error = scene.error(&found);
        squares += error.component_mul(&error) / COUNT as f64;
        let inverse = found.covariance.try_inverse().unwrap();
        nees += (error.transpose() * inverse * error)[0] / (6 * COUNT) as f64;
    }
    let rms = squares.map(f64::sqrt);
    let tilt = libm::hypot(rms[0], rms[1]).to_degrees();
    let plane = 1e3 * libm::hypot(rms[3], rms[4]);
    ([tilt, plane, 1e3 * rms[5]], nees)
}

#[test]
fn pose_of_a_small_tag_is_accurate_under_blur_noise_and_any_tone_curve() {
    let moving = Imaging {
        line_s: ROLLING_S,
        ..CLEAN
    };
    /// Tilt, degrees; in the plane and along the normal, mm.
    type Bounds = [f64; 3];
    let sharp = [0.4, 0.15, 0.3];
    let cases: [(&str, f64, Imaging, Motion, Bounds); 7] = [
        ("facing", 0.05, CLEAN, STILL, sharp),
        ("tilted", 0.35, CLEAN, STILL, sharp),
        (
            "noisy",
            0.35,
            Imaging {
                noise: 5.0,
                ..CLEAN
            },
            STILL,
            [0.5, 0.4, 1.1],
        ),
        ("linear", 0.35, Imaging { tone: 1.0, ..CLEAN }, STILL, sharp),
        (
            "out of focus",
            0.35,
            Imaging {
                blur_px: 1.2,
                ..CLEAN
            },
            STILL,
            [1.1, 0.5, 1.0],
        ),
        ("rolling shutter", 0.35, moving, WALKING, sharp),
        (
            "moving",
            0.35,
            Imaging {
                exposure_s: 0.008,
                ..moving
            },
            WALKING,
            [0.8, 0.4, 1.2],
        ),
    ];
    for (name, tilt, imaging, motion, bounds) in cases {
        let (found, nees) = errors(tilt, imaging, motion);
        let is_accurate = found
            .iter()
            .zip(bounds)
            .all(|(error, bound)| *error < bound);
        assert!(is_accurate, "{name}: {found:?}, expected {bounds:?}");
        assert!((0.1..2.5).contains(&nees), "{name}: NEES {nees}");
    }
}

#[test]
fn mud_is_recognized() {
    for seed in 0..6 {
        let mut draw = Draw(2000 + seed);
        let dirty = Imaging { dirt: 0.2, ..CLEAN };
        let scene = Scene::new(0.35, 2, dirty, STILL, &mut draw);
        let found = scene.fit(&mut draw).expect("a fit");
        let error = scene.error(&found);
        let translation = error.fixed_rows::<3>(3).norm();
        assert!(translation < 0.004, "{seed}: {error}");
        let hidden = found.visible_share.iter().map(|share| 1.0 - share);
        // Mud on black cells differs little.
        assert!(
            hidden.into_iter().all(|h| (0.03..0.3).contains(&h)),
            "{found:?}"
        );
    }
}

#[test]
fn one_eye_has_the_range_from_the_size_of_the_cells() {
    for seed in 0..6 {
        let mut draw = Draw(3000 + seed);
        let noisy = Imaging {
            noise: 5.0,
            ..CLEAN
        };
        let scene = Scene::new(0.2, 1, noisy, STILL, &mut draw);
        let error = scene.error(&scene.fit(&mut draw).expect("a fit"));
        assert!(error[5].abs() < 0.005, "{seed}: {error}");
    }
}

#[test]
fn second_minimum_is_stated_where_noise_hides_which_is_right() {
    let mut stated = 0;
    for seed in 0..8 {
        let mut draw = Draw(5000 + seed);
        let noisy = Imaging {
            noise: 8.0,
            blur_px: 0.9,
            ..CLEAN
        };
        let mut scene = Scene::new(0.25, 1, noisy, STILL, &mut draw);
        // Twice as far: 10 px.
        scene.truth = transform(scene.truth.rotation_vector(), [0.05, 0.02, 2.2]);
        let eye = RigidTransform::identity();
        let image = render(
            &scene.lens,
            &tag(),
            &eye,
            &scene.truth,
            &STILL,
            &noisy,
            &mut draw,
        );
        scene.images = vec![image];
        let Some(found) = scene.fit(&mut draw) else {
            continue;
        };
        let angle = |pose: &RigidTransform| (scene.truth.inverse() * *pose).angle_rad();
        let first = angle(&found.reference_from_tag);
        let second = found
            .other
            .as_ref()
            .map(|other| angle(&other.reference_from_tag));
        stated += u32::from(second.is_some());
        assert!(
            first.min(second.unwrap_or(f64::INFINITY)) < 0.35,
            "{seed}: {first} {second:?}"
        );
    }
    assert!(stated >= 4, "{stated} of 8");
}

#[test]
fn search_starts_the_fit() {
    let searcher = Searcher::new(Dictionary::AprilTag36h11, &SearchConfig::default());
    for seed in 0..6 {
        let mut draw = Draw(4000 + seed);
        let scene = Scene::new(0.3, 2, CLEAN, STILL, &mut draw);
        let views = scene.views();
        let found = searcher.search(&views[0].image);
        let [one] = found[..] else {
            panic!("{found:?}")
        };
        assert_eq!((one.id, one.wrong_bits), (1, 0));
        for (corner, expected) in one.corners.iter().zip(tag().corners()) {
            let expected = scene.lens.project(scene.truth.apply(expected)).unwrap();
            assert!(crate::square::distance(*corner, expected) < 1.2, "{one:?}");
        }
        let [start, _] = poses_from_corners(&scene.lens, &tag(), &one.corners).unwrap();
        let found = fit(&views, &tag(), &start, &STILL, &Config::default()).unwrap();
        assert!(
            scene.error(&found).fixed_rows::<3>(3).norm() < 0.0006,
            "{}",
            scene.error(&found)
        );
    }
    let mut draw = Draw(1);
    let noise: Vec<u8> = (0..SIZE[0] * SIZE[1])
        .map(|_| (255.0 * draw.next()) as u8)
        .collect();
    let noise = ImageView::packed(SIZE[0], SIZE[1], &noise).unwrap();
    assert_eq!(searcher.search(&noise), []);
}
