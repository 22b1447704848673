use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};

use super::*;
use crate::config::RenderConfig;
use crate::lanes::Level;
use crate::render::{PixelErrors, Renderer};
use crate::scene::{Background, Exposure, Scene, Splat, Splats};
use crate::train::TrainingView;

const SIZE: [usize; 2] = [96, 64];

/// Two walls of small discs along z: one at x = 3 m in front of cameras that look along x, one at
/// x = -3 m behind them. Cameras are at x = 0.
fn walls() -> Scene {
    let mut splats = Splats::empty(0).unwrap();
    for x in [3.0, -3.0] {
        for i in 0..60 {
            for j in 0..30 {
                let color = if (i / 4 + j / 4) % 2 == 0 { 0.8 } else { 0.3 };
                let mut splat = Splat::sphere(0.08, [color, 0.5, 0.4]);
                splat.position_m = [x, -1.5 + 0.1 * j as f32, -3.0 + 0.1 * i as f32];
                splat.log_scale[0] = -5.0;
                splat.opacity_logit = 3.0;
                splats.push(&splat).unwrap();
            }
        }
    }
    Scene {
        splats,
        background: Background::Constant([0.2, 0.3, 0.9]),
    }
}

/// A camera at a point that looks along x, y down, rotated by `yaw_rad` about y.
fn camera(center: [f64; 3], yaw_rad: f64) -> crate::Camera {
    let [width, height] = SIZE.map(|edge| edge as u32);
    let model = CameraModel::new((width, height), [70.0, 70.0, 47.5, 31.5], Distortion::None);
    // Camera z is world x, camera x is world -z.
    let (s, c) = (libm::sin(yaw_rad), libm::cos(yaw_rad));
    let rows = [s, 0.0, -c, 0.0, 1.0, 0.0, c, 0.0, s];
    let rotation = RigidTransform::from_rotation_rows(rows, [0.0; 3]).unwrap();
    let moved = RigidTransform::from_translation_m(center.map(|v| -v)).unwrap();
    crate::Camera::new(model, rotation * moved).unwrap()
}

/// Eight views of the wall at x = 3 m, with a dark patch in every image.
fn views(renderer: &Renderer, scene: &Scene) -> Vec<TrainingView> {
    (0..8)
        .map(|i| {
            let camera = camera([0.0, 0.0, -0.7 + 0.2 * f64::from(i)], 0.0);
            let image = renderer.render(scene, &camera, &Exposure::NONE);
            let value = |pixel: usize, c: usize| libm::roundf(255.0 * image.rgb[c][pixel]) as u8;
            let pixels = 0..SIZE[0] * SIZE[1];
            let rgb = pixels
                .flat_map(|pixel| [0, 1, 2].map(|c| value(pixel, c)))
                .collect();
            let mut view = TrainingView::new(camera, rgb, i as u32);
            view.depth_m = image.median_depth_m.clone();
            view.depth_sigma_m = vec![0.01; view.depth_m.len()];
            view
        })
        .collect()
}

fn renderer() -> Renderer {
    Renderer::new(RenderConfig::default()).unwrap()
}

fn coverage(renderer: &Renderer, scene: &Scene) -> Coverage {
    let views = views(renderer, scene);
    Coverage::gather(renderer, scene, &views, &CoverageConfig::default()).unwrap()
}

/// Constants of this test: those of the crate are fitted.
fn config() -> MeasureConfig {
    MeasureConfig {
        uncovered: 1.0,
        angle: 1.0,
        few: 1.0,
        magnification: 0.5,
        space: 1.0,
        spread: 1.0,
        unknown_error: 0.3,
        error_gain: 1.0,
        image: ImageMeasureConfig::from_weights(-2.0, [5.0; IMAGE_CHANNELS]),
    }
}

#[test]
fn weights_sum_to_the_alpha_of_the_image() {
    let (renderer, scene) = (renderer(), walls());
    let camera = camera([0.5, 0.2, 0.3], 0.4);
    let pass = renderer.forward(&scene, &camera, &Exposure::NONE);
    let (mut alpha, mut depth) = (
        vec![0.0_f32; camera.pixels()],
        vec![0.0_f32; camera.pixels()],
    );
    for tile in 0..pass.tiles() {
        let z: Vec<f32> = pass.entries(tile).map(|(_, z)| z).collect();
        assert!(z.is_sorted());
        renderer.visit_weights(&pass, tile, |at| {
            alpha[at.pixel] += at.weight;
            depth[at.pixel] += at.weight * at.depth;
        });
    }
    for (pixel, alpha) in alpha.iter().enumerate() {
        assert!((alpha - pass.image.alpha[pixel]).abs() < 1e-4);
        let expected = pass.image.expected_depth_m[pixel];
        assert!(expected.is_nan() || (depth[pixel] / alpha - expected).abs() < 1e-3 * expected);
    }
    assert!(alpha.iter().any(|alpha| *alpha > 0.9));
}

#[test]
fn observations_are_sums_of_weights() {
    let (renderer, scene) = (renderer(), walls());
    let camera = camera([0.5, 0.2, 0.3], 0.4);
    let pass = renderer.forward(&scene, &camera, &Exposure::NONE);
    let plane = |stream| {
        let values = 0..camera.pixels() as u64;
        let values = values.map(|pixel| counter_random::uniform(3, stream, pixel) as f32);
        values.collect::<Vec<f32>>()
    };
    let [color, depth] = [0, 1].map(plane);
    let depth: Vec<f32> = depth
        .into_iter()
        .map(|v| if v < 0.2 { f32::NAN } else { v })
        .collect();
    let usable: Vec<bool> = plane(2).iter().map(|v| *v > 0.3).collect();
    let errors = PixelErrors {
        usable: &usable,
        color: &color,
        depth: &depth,
    };
    let mut expected = vec![[0.0_f32; 5]; scene.splats.len()];
    for tile in 0..pass.tiles() {
        let entries: Vec<(u32, f32)> = pass.entries(tile).collect();
        renderer.visit_weights(&pass, tile, |at| {
            if !usable[at.pixel] {
                return;
            }
            let of = &mut expected[entries[at.entry].0 as usize];
            of[0] = of[0].max(at.weight);
            of[1] += at.weight;
            of[2] += at.weight * color[at.pixel];
            if !depth[at.pixel].is_nan() {
                of[3] += at.weight;
                of[4] += at.weight * depth[at.pixel];
            }
        });
    }
    let reference = renderer.observe(&camera, &pass, &errors);
    let mut visible = 0;
    for (index, _, of) in &reference {
        let found = [of.largest, of.weight, of.color, of.depth_weight, of.depth];
        for (found, expected) in found.iter().zip(expected[*index as usize]) {
            let difference = (found - expected).abs();
            assert!(difference < 1e-5 + 1e-4 * expected, "{found} {expected}");
        }
        visible += usize::from(of.weight > 0.0);
    }
    assert!(visible > 300, "{visible}");
    for level in Level::all() {
        let other = renderer.clone().with_level(level);
        assert_eq!(other.observe(&camera, &pass, &errors), reference);
    }
}

#[test]
fn gaussians_know_what_saw_them() {
    let (renderer, scene) = (renderer(), walls());
    let coverage = coverage(&renderer, &scene);
    // The middle of the wall in front, and the same place on the wall behind.
    let index = 30 * 30 + 15;
    let [front, behind] = [index, 1800 + index].map(|k| coverage.gaussians()[k]);
    assert_eq!((front.instants, behind.instants), (8, 0));
    assert!((front.finest_m - 3.0 / 70.0).abs() < 1e-4, "{front:?}");
    // Images are the scene's own, rounded to 8 bits.
    assert!(
        front.color_error < 0.003 && front.depth_error < 1e-3,
        "{front:?}"
    );
    assert!((behind.finest_m, behind.color_error) == (0.0, 1.0) && behind.depth_error.is_nan());
    assert!(front.directions.angle_rad([-1.0, 0.0, 0.0]) < 0.4);
    assert!(front.directions.angle_rad([1.0, 0.0, 0.0]) > 2.0);
    assert!(behind.directions.is_empty());
    assert!(coverage.space().voxels() > 500);
}

#[test]
fn errors_of_views_are_those_of_the_gaussians_there() {
    let (renderer, scene) = (renderer(), walls());
    let mut views = views(&renderer, &scene);
    for view in &mut views {
        view.rgb
            .iter_mut()
            .for_each(|value| *value = value.saturating_sub(26));
        view.depth_m.iter_mut().for_each(|depth| *depth *= 1.25);
    }
    let coverage = Coverage::gather(&renderer, &scene, &views, &CoverageConfig::default()).unwrap();
    let seen = coverage.gaussians()[30 * 30 + 15];
    assert!((seen.color_error - 0.1).abs() < 0.01, "{seen:?}");
    assert!((seen.depth_error - 0.2).abs() < 0.01, "{seen:?}");
    // Masked, they saw nothing.
    for view in &mut views {
        view.mask = vec![false; SIZE[0] * SIZE[1]];
    }
    let none = Coverage::gather(&renderer, &scene, &views, &CoverageConfig::default()).unwrap();
    assert!(none.gaussians().iter().all(|seen| seen.instants == 0));
    assert_eq!(none.space().voxels(), 0);
}

#[test]
fn confidence_falls_with_the_distance_from_what_was_seen() {
    let (renderer, scene) = (renderer(), walls());
    let coverage = coverage(&renderer, &scene);
    let measure = |camera: &crate::Camera| {
        let image = coverage.render(&renderer, &scene, camera).unwrap();
        image.confidence(&config())
    };
    let trained = measure(&camera([0.0, 0.0, 0.0], 0.0));
    let near = measure(&camera([0.1, 0.0, 0.1], 0.0));
    let aside = measure(&camera([0.0, 0.0, 2.5], 0.0));
    let behind = measure(&camera([0.0, 0.0, 0.0], std::f64::consts::PI));
    assert!(trained.image > 0.9 && trained.psnr_db > 30.0 && !trained.is_outside);
    assert!(
        near.image > 0.8 && !near.is_outside,
        "{} {}",
        near.image,
        near.psnr_db
    );
    assert!(aside.image < near.image && behind.image < 0.1);
    assert!(behind.is_outside && behind.psnr_db < aside.psnr_db);
    assert!(behind.log_odds > aside.log_odds && aside.log_odds > near.log_odds);
    assert!(behind.psnr_db < 14.0, "{}", behind.psnr_db);
}

#[test]
fn pixels_without_a_ray_were_not_seen() {
    let (renderer, scene) = (renderer(), walls());
    let coverage = coverage(&renderer, &scene);
    // Wider than half of a sphere: corners look backward.
    let none = Distortion::KannalaBrandt4 {
        k1: 0.0,
        k2: 0.0,
        k3: 0.0,
        k4: 0.0,
    };
    let model = CameraModel::new((96, 64), [20.0, 20.0, 47.5, 31.5], none);
    // Upward: no wall there.
    let up = RigidTransform::from_rotation_vector([1.57, 0.0, 0.0], [0.0; 3]).unwrap();
    let fisheye = crate::Camera::new(model, up).unwrap();
    let image = coverage.render(&renderer, &scene, &fisheye).unwrap();
    let corner = 0;
    assert!(image.alpha[corner] == 0.0);
    assert_eq!((image.uncovered[corner], image.space[corner]), (1.0, 1.0));
    assert!(image.confidence(&config()).pixels[corner] < 0.2);
}

#[test]
fn a_closer_look_is_a_magnification() {
    let (renderer, scene) = (renderer(), walls());
    let coverage = coverage(&renderer, &scene);
    let middle = 32 * SIZE[0] + 48;
    for (x, octaves) in [(-1.0, 0.0), (0.0, 0.0), (1.5, 1.0), (2.25, 2.0)] {
        let camera = camera([x, 0.0, 0.0], 0.0);
        let image = coverage.render(&renderer, &scene, &camera).unwrap();
        let found = image.magnification[middle];
        assert!((found - octaves).abs() < 0.05, "at {x} m: {found} octaves");
        assert!(image.alpha[middle] > 0.9 && image.few[middle] < 1e-6);
    }
}

#[test]
fn threads_change_no_byte() {
    let (renderer, scene) = (renderer(), walls());
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let coverage = coverage(&renderer, &scene);
            let image = coverage
                .render(&renderer, &scene, &camera([0.4, 0.1, 0.8], 0.6))
                .unwrap();
            (coverage, image.confidence(&MeasureConfig::default()).pixels)
        })
    };
    let one = run(1);
    assert!(one.0.gaussians().iter().any(|seen| seen.instants > 0));
    for threads in [2, 3] {
        let other = run(threads);
        assert_eq!(format!("{:?}", one.0), format!("{:?}", other.0));
        assert_eq!(one.1, other.1);
    }
}

#[test]
fn a_scene_of_another_size_and_wrong_settings_are_refused() {
    let (renderer, scene) = (renderer(), walls());
    let coverage = coverage(&renderer, &scene);
    let other = Scene {
        splats: scene.splats.select(&[0, 1]),
        background: scene.background.clone(),
    };
    let camera = camera([0.0; 3], 0.0);
    assert!(coverage.render(&renderer, &other, &camera).is_err());
    for wrong in [
        CoverageConfig {
            voxel_m: f32::NAN,
            ..CoverageConfig::default()
        },
        CoverageConfig {
            step_px: 0,
            ..CoverageConfig::default()
        },
        CoverageConfig {
            sky_texels: 1,
            ..CoverageConfig::default()
        },
    ] {
        assert!(Coverage::gather(&renderer, &scene, &[], &wrong).is_err());
    }
}
