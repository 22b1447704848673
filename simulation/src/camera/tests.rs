use std::sync::Arc;

use camera_models::{Distortion, Lens};

use super::*;
use crate::scene::{GaussianStore, ResidencyConfig};
use crate::testing::{DepthErrors, Surfaces, SyntheticScene, offset_pose};

fn lens(distortion: Distortion) -> CameraModel {
    CameraModel::new((96, 72), [52.0, 53.0, 46.8, 36.2], distortion)
}

/// Errors of depths up to 5 m.
fn depth_errors(batch: &CameraBatch, request: &FrameRequest, truth: &Surfaces) -> DepthErrors {
    let mut frames = Frames::default();
    batch.render(&[*request], &mut frames).unwrap();
    DepthErrors::new(&frames, request, &batch.config().model, truth, 5.0)
}

/// Gaussians of a scene at other distances.
fn with_spacing(scene: &SyntheticScene, spacing_m: f64) -> Arc<GaussianStore> {
    let scene = scene.with_spacing(spacing_m).unwrap();
    Arc::new(GaussianStore::new(scene, ResidencyConfig::default()))
}

/// Median and 95th percentile of the depth errors of views of a walk and beside it, m.
fn depth_percentiles(
    scene: &SyntheticScene,
    store: &Arc<GaussianStore>,
    model: &CameraModel,
    quality: Quality,
) -> [f64; 2] {
    let mut config = CameraConfig::new(*model).unwrap();
    config.quality = quality;
    let batch = CameraBatch::new(store.clone(), config).unwrap();
    let (mut all, mut missing) = (Vec::new(), 0);
    let references = &scene.scene.sectors[0].references;
    for (number, at) in references.iter().step_by(references.len() / 4).enumerate() {
        let yaw = 0.2 * number as f64 - 0.3;
        let offset = [0.1 * number as f64, 0.0, 0.0];
        let moved = RigidTransform::from_rotation_vector([0.0, yaw, 0.0], offset).unwrap();
        let request = FrameRequest::new(0, *at * moved);
        let found = depth_errors(&batch, &request, &scene.surfaces[0]);
        all.extend(found.errors_m);
        missing += found.missing;
    }
    all.sort_by(f64::total_cmp);
    let name = model.distortion.name();
    assert!(
        missing * 100 <= all.len(),
        "{name}: {missing} without depth of {}",
        all.len()
    );
    [0.5, 0.95].map(|share| all[(share * (all.len() - 1) as f64) as usize])
}

#[test]
fn depth_is_that_of_the_surfaces_with_all_lenses_on_and_off_the_walk() {
    let lenses = [
        lens(Distortion::None),
        lens(Distortion::RadTan5 {
            k1: -0.12,
            k2: 0.02,
            p1: 1e-3,
            p2: -5e-4,
            k3: 0.0,
        }),
        lens(Distortion::KannalaBrandt4 {
            k1: 0.02,
            k2: -0.01,
            k3: 0.0,
            k4: 0.0,
        }),
        lens(Distortion::DoubleSphere {
            xi: -0.1,
            alpha: 0.5,
        }),
    ];
    for scene in [SyntheticScene::stairs(), SyntheticScene::kerb(0.12)] {
        let scene = scene.unwrap();
        let store = with_spacing(&scene, 0.015);
        for model in &lenses {
            let model = scaled_model(model, [768, 576]).unwrap();
            // Other lenses take the tiles of the exact renderer with both.
            let qualities = match model.distortion {
                Distortion::None => &[Quality::Exact, Quality::Detail][..],
                _ => &[Quality::Exact],
            };
            for quality in qualities.iter().copied() {
                let [median, p95] = depth_percentiles(&scene, &store, &model, quality);
                let name = (&scene.scene.name, model.distortion.name(), quality);
                println!("{name:?}: median {median:.4} m, p95 {p95:.4} m");
                assert!(
                    median <= 0.001 && p95 <= 0.01,
                    "{name:?}: {median} m, {p95} m"
                );
            }
        }
    }
}

/// Offsets of PAWS-Sim: up to 3 m and 30 degrees. `bench sim_truth --only exact` has all lenses.
#[test]
fn depth_is_that_of_the_surfaces_beside_the_walk() {
    for scene in [SyntheticScene::stairs(), SyntheticScene::kerb(0.12)] {
        let scene = scene.unwrap();
        let model = scaled_model(&lens(Distortion::None), [768, 576]).unwrap();
        let store = with_spacing(&scene, 0.015);
        let batch = CameraBatch::new(store, CameraConfig::new(model).unwrap()).unwrap();
        let pose = scene.scene.sectors[0].references[scene.scene.sectors[0].references.len() / 2];
        for offset_m in [0.3, 1.0, 3.0] {
            let (mut all, mut missing) = (Vec::new(), 0);
            for number in 0..6 {
                let yaw_rad = 30_f64.to_radians() * f64::from(number % 3 - 1);
                let along_rad = std::f64::consts::FRAC_PI_3 * f64::from(number);
                let pose = offset_pose(&pose, offset_m, along_rad, yaw_rad).unwrap();
                let request = FrameRequest::new(0, pose);
                let found = depth_errors(&batch, &request, &scene.surfaces[0]);
                // Others stand in the stairs or look away from them.
                if found.nearest_m >= 0.5 {
                    all.extend(found.errors_m);
                    missing += found.missing;
                }
            }
            all.sort_by(f64::total_cmp);
            assert!(all.len() > 100_000, "{} pixels", all.len());
            let [median, p95] = [0.5, 0.95].map(|q| all[(q * (all.len() - 1) as f64) as usize]);
            let name = &scene.scene.name;
            println!("{name}, {offset_m} m: median {median:.4} m, p95 {p95:.4} m");
            assert!(
                missing * 100 <= all.len(),
                "{name}, {offset_m} m: {missing}"
            );
            assert!(median <= 0.01 && p95 <= 0.03, "{name}, {offset_m} m");
        }
    }
}

#[test]
fn depth_errors_fall_with_the_size_of_pixels_and_gaussians() {
    let scene = SyntheticScene::kerb(0.12).unwrap();
    let error = |spacing_m: f64, width: u32| {
        let store = with_spacing(&scene, spacing_m);
        let model = scaled_model(&lens(Distortion::None), [width, width * 3 / 4]).unwrap();
        depth_percentiles(&scene, &store, &model, Quality::Exact)
    };
    let all = [error(0.06, 96), error(0.03, 384), error(0.015, 768)];
    println!("{all:?}");
    for pair in all.windows(2) {
        assert!(
            pair[1][0] < pair[0][0] && pair[1][1] < pair[0][1],
            "{all:?}"
        );
    }
    // Goals for small pixels and Gaussians, which larger ones meet too.
    assert!(all[0][0] <= 0.01, "{all:?}");
    assert!(all[1][0] <= 0.002 && all[1][1] <= 0.015, "{all:?}");
}

#[test]
fn lenses_of_another_size_have_the_same_rays_at_the_borders() {
    let distortion = Distortion::RadTan4 {
        k1: -0.1,
        k2: 0.01,
        p1: 1e-3,
        p2: 2e-3,
    };
    let model = CameraModel::new((672, 376), [262.0, 263.0, 330.1, 190.4], distortion);
    let size = [84, 48];
    let small = scaled_model(&model, size).unwrap();
    let [large_lens, small_lens] = [model, small].map(|model| Lens::new(&model));
    for corner in [[0.0, 0.0], [1.0, 0.0], [0.3, 1.0]] {
        // A border is half a pixel beyond the centers.
        let of = |size: [u32; 2]| [0, 1].map(|k| corner[k] * f64::from(size[k]) - 0.5);
        let a = large_lens.unproject(of([672, 376])).unwrap();
        let b = small_lens.unproject(of(size)).unwrap();
        for k in 0..3 {
            assert!((a[k] - b[k]).abs() < 1e-9, "{a:?} {b:?}");
        }
    }
    assert!(scaled_model(&model, [0, 48]).is_err());
}

#[test]
fn settings_out_of_their_range_are_refused_by_name() {
    let refused = |change: fn(&mut CameraConfig)| {
        let mut config = CameraConfig::pinhole([8, 8], 1.0).unwrap();
        change(&mut config);
        config.check().unwrap_err().to_string()
    };
    assert!(refused(|c| c.far_m = f32::NAN).contains("far_m"));
    assert!(refused(|c| c.model.width = 20_000).contains("20000x8"));
    assert!(refused(|c| c.model.width = 20_000).starts_with("camera.width"));
    assert!(refused(|c| c.model.height = 0).starts_with("camera.height"));
    assert!(refused(|c| c.exposure.gain = 0.0).contains("gain"));
    assert!(refused(|c| c.noise.full_well_e = -1.0).contains("full_well_e"));
    assert!(refused(|c| c.shutter.blur_poses = 2).contains("odd"));
    assert!(refused(|c| c.timing.latency_s = [1.0, 0.0]).contains("latency_s"));
}

#[test]
fn a_camera_of_the_recording_keeps_its_lens_mount_and_readout() {
    let mut recorded = SyntheticScene::room().unwrap().scene.sectors[0]
        .recording
        .cameras[0]
        .clone();
    recorded.line_s = 2e-5;
    let size = [recorded.model.width / 4, recorded.model.height / 4];
    let config = CameraConfig::of_recording(&recorded, size).unwrap();
    assert_eq!(config.body_from_camera, recorded.rig_from_camera);
    assert!((config.shutter.line_s - 8e-5).abs() < 1e-12);
    assert_eq!(config.model.fx, recorded.model.fx / 4.0);
    let text = serde_json::to_string(&config).unwrap();
    assert_eq!(serde_json::from_str::<CameraConfig>(&text).unwrap(), config);
}
