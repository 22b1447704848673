use camera_models::Distortion;

use super::*;
use crate::config::RenderConfig;
use crate::reference::tests::{camera, random_splats, shutter};
use crate::scene::{Background, Sky, Splat};

fn scene(splats: Splats) -> Scene {
    Scene {
        splats,
        background: Background::Constant([0.3, 0.1, 0.6]),
    }
}

fn psnr_db(a: &Image, b: &Image) -> f64 {
    let pairs = a.rgb.iter().flatten().zip(b.rgb.iter().flatten());
    let sum: f64 = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum();
    -10.0 * (sum / (3 * a.alpha.len()) as f64).log10()
}

#[test]
fn without_coarser_levels_culling_changes_nothing() {
    let splats = random_splats(4, 3000, 1);
    let exact = scene(splats.select(&halves::order(&splats)));
    let config = DetailConfig {
        levels: 0,
        cluster: 64,
        ..DetailConfig::default()
    };
    let detail = DetailScene::new(&exact, &config).unwrap();
    let renderer = Renderer::new(RenderConfig::default()).unwrap();
    let still = camera((64, 48), Distortion::None);
    let beside =
        cad_transforms::RigidTransform::from_rotation_vector([0.0, 0.7, 0.0], [0.2, 0.0, -1.0]);
    let beside = still.clone().with_pose(beside.unwrap());
    let fisheye = Distortion::KannalaBrandt4 {
        k1: 0.03,
        k2: -0.01,
        k3: 0.002,
        k4: 0.0,
    };
    let moving = still.clone().with_shutter(shutter()).unwrap();
    for camera in [moving, camera((64, 48), fisheye)] {
        let found = renderer.render_detail(&detail, &camera, &Exposure::NONE);
        let expected = renderer.render(&exact, &camera, &Exposure::NONE);
        assert!(found.rgb == expected.rgb && found.alpha == expected.alpha);
    }
    assert!(detail.count(&beside) < 2900, "{}", detail.count(&beside));
}

/// Largest absolute difference of two planes; infinite where only one has a value.
fn difference(a: &[f32], b: &[f32]) -> f32 {
    let pairs = a.iter().zip(b);
    let differences = pairs.map(|(a, b)| match a.is_nan() || b.is_nan() {
        true if a.is_nan() && b.is_nan() => 0.0,
        true => f32::INFINITY,
        false => (a - b).abs(),
    });
    differences.fold(0.0, f32::max)
}

#[test]
fn regions_show_what_the_exact_renderer_shows() {
    let sky = Sky::from_texels(
        4,
        (0..16)
            .map(|i| [0.05 * i as f32, 0.5, 1.0 - 0.04 * i as f32])
            .collect(),
    );
    let background = Background::Sky(sky.unwrap());
    let config = DetailConfig {
        levels: 0,
        cluster: 32,
        ..DetailConfig::default()
    };
    let compensating = RenderConfig {
        compensate: true,
        ..RenderConfig::default()
    };
    for (degree, count, renderer) in [
        (0, 400, RenderConfig::default()),
        (3, 400, RenderConfig::default()),
        (1, 4000, compensating),
    ] {
        let scene = Scene {
            splats: random_splats(7, count, degree),
            background: background.clone(),
        };
        // Thresholds of the exact renderer.
        let mut config = config;
        config.min_alpha = renderer.min_alpha;
        config.min_transmittance = renderer.min_transmittance;
        let detail = DetailScene::new(&scene, &config).unwrap();
        let renderer = Renderer::new(renderer).unwrap();
        let exposure = Exposure::from_log_gain([0.1, -0.2, 0.0]);
        // One region, parts of blocks at the border, single pixels of blocks, several regions.
        for size in [(64, 48), (37, 21), (41, 73), (300, 170)] {
            let camera = camera(size, Distortion::None);
            let found = renderer.render_detail(&detail, &camera, &exposure);
            let expected = renderer.render(&scene, &camera, &exposure);
            let db = psnr_db(&found, &expected);
            assert!(db > 60.0, "{size:?}, degree {degree}: {db} dB");
            let alpha = difference(&found.alpha, &expected.alpha);
            assert!(alpha < 0.02, "{size:?}, degree {degree}: {alpha}");
            let depths = found.median_depth_m.iter().zip(&expected.median_depth_m);
            let other = depths.filter(|(a, b)| {
                let is_equal = (*a - *b).abs() <= 1e-3 * *b || a.is_nan() && b.is_nan();
                !is_equal
            });
            let share = other.count() as f64 / found.alpha.len() as f64;
            assert!(share < 0.01, "{size:?}, degree {degree}: {share}");
            let depths = found
                .expected_depth_m
                .iter()
                .zip(&expected.expected_depth_m);
            let other = depths.filter(|(a, b)| (*a - *b).abs() > 1e-3 * *b);
            let share = other.count() as f64 / found.alpha.len() as f64;
            assert!(share < 0.01, "{size:?}, degree {degree}: {share}");
        }
    }
}

#[test]
fn same_bytes_with_every_instruction_set_and_any_number_of_threads() {
    let exact = scene(random_splats(5, 5000, 1));
    let detail = DetailScene::new(&exact, &DetailConfig::default()).unwrap();
    let renderer = Renderer::new(RenderConfig::default()).unwrap();
    let cameras = [(64, 48), (300, 170)].map(|size| camera(size, Distortion::None));
    let run = |level: crate::Level, threads: usize| {
        let renderer = renderer.clone().with_level(level);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let pool = pool.build().unwrap();
        let images =
            pool.install(|| renderer.render_detail_batch(&detail, &cameras, &Exposure::NONE));
        let bits = |plane: &[f32]| plane.iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
        let planes = images.iter().flat_map(|image| {
            let depths = [&image.expected_depth_m, &image.median_depth_m, &image.alpha];
            image.rgb.iter().chain(depths).map(|plane| bits(plane))
        });
        planes.collect::<Vec<_>>()
    };
    let expected = run(crate::Level::Portable, 1);
    for level in crate::Level::all() {
        for threads in [1, 4] {
            assert!(
                run(level, threads) == expected,
                "{level:?}, {threads} threads"
            );
        }
    }
}

fn merging(count: usize, max_growth: f32) -> Merging {
    Merging {
        count,
        max_growth,
        dilation: 0.0,
    }
}

#[test]
fn merged_gaussians_keep_mean_covariance_and_optical_depth() {
    // Two halves of a Gaussian, as growth splits it.
    let mut splats = Splats::empty(0).unwrap();
    for x in [-0.06, 0.06] {
        let mut splat = Splat::sphere(0.1, [0.5, 0.2, 0.8]);
        splat.position_m = [1.0 + x, 2.0, 3.0];
        splat.log_scale = [0.08_f32.ln(), 0.1_f32.ln(), 0.03_f32.ln()];
        splats.push(&splat).unwrap();
    }
    let merged = merge::neighbors(&splats, &merging(2, 2.0));
    assert_eq!(merged.len(), 1);
    let found = merged.get(0);
    let mut scale = found.log_scale.map(f32::exp);
    scale.sort_by(f32::total_cmp);
    for (found, expected) in scale.into_iter().zip([0.03, 0.1, 0.1]) {
        assert!((found - expected).abs() < 1e-5, "{scale:?}");
    }
    assert!((found.position_m[0] - 1.0).abs() < 1e-6);
    // Optical depth times area: 2 * ln 2 * 0.08 * 0.1 = 1.109 * 0.1 * 0.1.
    let opacity = 1.0 / (1.0 + (-found.opacity_logit).exp());
    assert!(
        (opacity - (1.0 - (-1.109_f32).exp())).abs() < 1e-3,
        "{opacity}"
    );
    // Two that cover each other hide what both together hide.
    let mut splats = splats.select(&[0]);
    splats.push(&splats.get(0)).unwrap();
    let found = merge::neighbors(&splats, &merging(2, 2.0)).get(0);
    let opacity = 1.0 / (1.0 + (-found.opacity_logit).exp());
    assert!((opacity - 0.75).abs() < 1e-3, "{opacity}");
    // Distant ones remain.
    let mut far = splats.select(&[0, 1]);
    far.push(&Splat {
        position_m: [50.0, 0.0, 0.0],
        ..splats.get(0)
    })
    .unwrap();
    assert_eq!(merge::neighbors(&far, &merging(3, 6.0)), far);
}

#[test]
fn coarser_levels_need_fewer_gaussians_at_a_stated_price() {
    // A wall of 20 000 discs, 30 m away from a camera with pixels of 0.6 m there.
    let mut splats = Splats::empty(0).unwrap();
    for i in 0..20_000_u64 {
        let uniform = |k: u64| counter_random::uniform(1, k, i) as f32;
        let (x, y) = (40.0 * uniform(0) - 20.0, 30.0 * uniform(1) - 15.0);
        let shade = 0.5 + 0.3 * (x * 0.4).sin() * (y * 0.5).cos() + 0.1 * (uniform(2) - 0.5);
        let mut splat = Splat::sphere(0.15, [shade, 0.5, 1.0 - shade]);
        splat.position_m = [x, y, 30.0];
        splat.log_scale[2] = -5.0;
        splat.opacity_logit = 2.0;
        splats.push(&splat).unwrap();
    }
    let exact = scene(splats);
    let camera = camera((64, 48), Distortion::None);
    let renderer = Renderer::new(RenderConfig::default()).unwrap();
    let expected = renderer.render(&exact, &camera, &Exposure::NONE);
    let mut last = 20_001;
    for (max_sigma_px, min_db) in [(0.0, 60.0), (0.6, 32.0)] {
        let config = DetailConfig {
            max_sigma_px,
            ..DetailConfig::default()
        };
        let detail = DetailScene::new(&exact, &config).unwrap();
        let count = detail.count(&camera);
        let found = renderer.render_detail(&detail, &camera, &Exposure::NONE);
        let db = psnr_db(&found, &expected);
        assert!(
            count < last && db > min_db,
            "{max_sigma_px}: {count} Gaussians, {db} dB"
        );
        last = count;
    }
    assert!(last < 6000, "{last}");
    let default = DetailConfig::default();
    for config in [
        DetailConfig {
            merge: 1,
            ..default
        },
        DetailConfig {
            min_alpha: 0.0,
            ..default
        },
        DetailConfig {
            min_transmittance: 0.7,
            ..default
        },
    ] {
        assert!(DetailScene::new(&exact, &config).is_err(), "{config:?}");
    }
}
