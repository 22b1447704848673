use splats::Scene;

use super::*;
use crate::camera::{NoiseConfig, Quality, ShutterConfig, VariationConfig};
use crate::scene::{GaussianSource, ResidencyConfig, SceneData};
use crate::testing::SyntheticScene;

fn batch(scene: &SyntheticScene, change: impl Fn(&mut CameraConfig)) -> CameraBatch {
    let mut config = CameraConfig::pinhole([48, 40], 1.5).unwrap();
    change(&mut config);
    let store = GaussianStore::new(scene.scene.clone(), ResidencyConfig::default());
    CameraBatch::new(Arc::new(store), config).unwrap()
}

fn requests(scene: &SyntheticScene, count: usize) -> Vec<FrameRequest> {
    let sectors = scene.scene.sectors.len();
    let request = |number: usize| {
        let sector = number % sectors;
        let references = &scene.scene.sectors[sector].references;
        let pose = references[(17 * number) % references.len()];
        let mut request = FrameRequest::new(sector, pose);
        request.velocity_m_s = [0.3, 0.0, 1.2];
        request.rate_rad_s = [0.0, 0.8, 0.1];
        request.noise = NoiseKey {
            seed: number as u64 / 3,
            episode: 1,
            frame: number as u64,
            camera: 0,
        };
        request
    };
    (0..count).map(request).collect()
}

fn single(batch: &CameraBatch, request: &FrameRequest) -> Frames {
    let mut frames = Frames::default();
    batch.render(&[*request], &mut frames).unwrap();
    frames
}

/// The part of a batch that belongs to one frame.
fn part(frames: &Frames, number: usize) -> (&[u8], &[f32], &[bool]) {
    let pixels = frames.width * frames.height;
    let range = number * pixels..(number + 1) * pixels;
    let rgb = &frames.rgb[3 * range.start..3 * range.end];
    (
        rgb,
        &frames.depth_m[range.clone()],
        &frames.has_depth[range],
    )
}

fn with_everything(config: &mut CameraConfig) {
    config.noise.full_well_e = 4000.0;
    config.shutter.line_s = 5e-4;
    config.shutter.exposure_s = 0.02;
    config.shutter.blur_poses = 3;
    config.exposure.white_balance = [1.1, 1.0, 0.9];
}

#[test]
fn a_frame_has_the_same_bits_in_any_batch_in_any_order_on_any_number_of_threads() {
    let scene = SyntheticScene::corridor_loop().unwrap();
    let configs: [fn(&mut CameraConfig); 4] = [
        |_| {},
        |config| config.quality = Quality::Exact,
        with_everything,
        |config| config.model = crate::camera::pinhole([150, 140], 1.5).unwrap(),
    ];
    for change in configs {
        let batch = batch(&scene, change);
        let forward = requests(&scene, 9);
        let mut together = Frames::default();
        let report = batch.render(&forward, &mut together).unwrap();
        assert_eq!((report.frames, report.sectors), (9, 4));
        for (number, request) in forward.iter().enumerate() {
            let alone = single(&batch, request);
            assert_eq!(part(&alone, 0), part(&together, number), "frame {number}");
        }
        let backward: Vec<FrameRequest> = forward.iter().rev().copied().collect();
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            let mut frames = Frames::default();
            pool.install(|| batch.render(&backward, &mut frames))
                .unwrap();
            for number in 0..9 {
                let other = part(&together, 8 - number);
                assert_eq!(
                    part(&frames, number),
                    other,
                    "{threads} threads, frame {number}"
                );
            }
        }
        // Two cameras at one pose.
        let twice = [forward[4]; 2];
        batch.render(&twice, &mut together).unwrap();
        assert_eq!(part(&together, 0), part(&together, 1));
        let shows_something = |v: &[u8]| v.iter().any(|value| *value != v[0]);
        assert!(shows_something(part(&together, 0).0));
    }
}

/// A frame with gain and focal length of its episode is that of a request that states them.
#[test]
fn variations_are_those_of_the_episode() {
    let scene = SyntheticScene::room().unwrap();
    let mut varied = requests(&scene, 2);
    for (number, request) in varied.iter_mut().enumerate() {
        request.noise = NoiseKey {
            episode: number as u64,
            ..NoiseKey::default()
        };
    }
    let variation = VariationConfig {
        gain: [0.5, 2.0],
        focal_scale: [0.9, 1.1],
    };
    let mut stated = varied.clone();
    let plain = batch(&scene, |_| {});
    for request in &mut stated {
        let model = plain.config().model;
        request.gain = variation.gain_of(0, request.noise.episode, 0);
        let scale = variation.focal_scale_of(0, request.noise.episode, 0);
        request.intrinsics_px = [(scale - 1.0) * model.fx, (scale - 1.0) * model.fy, 0.0, 0.0];
    }
    let mut found = Frames::default();
    let with_variation = batch(&scene, |config| config.variation = variation);
    with_variation.render(&varied, &mut found).unwrap();
    let [mut expected, mut nominal] = [Frames::default(), Frames::default()];
    plain.render(&stated, &mut expected).unwrap();
    plain.render(&varied, &mut nominal).unwrap();
    // Rounding of the focal length decides single values.
    let pairs = found.rgb.iter().zip(&expected.rgb);
    let different = pairs.filter(|(a, b)| a.abs_diff(**b) > 1).count();
    assert!(different * 1000 <= found.rgb.len(), "{different}");
    assert!(found.rgb != nominal.rgb);
}

#[test]
fn memory_is_kept_for_batches_of_the_same_shape() {
    let scene = SyntheticScene::room().unwrap();
    let batch = batch(&scene, |_| {});
    let mut frames = Frames::default();
    batch.render(&requests(&scene, 3), &mut frames).unwrap();
    let (rgb, depth) = (frames.rgb.as_ptr(), frames.depth_m.as_ptr());
    batch.render(&requests(&scene, 2), &mut frames).unwrap();
    batch.render(&requests(&scene, 3), &mut frames).unwrap();
    assert_eq!((rgb, depth), (frames.rgb.as_ptr(), frames.depth_m.as_ptr()));
}

#[test]
fn what_cannot_be_rendered_is_refused_before_anything_is_written() {
    let scene = SyntheticScene::room().unwrap();
    let batch = batch(&scene, |config| config.max_bytes = 48 * 40 * 8 * 4);
    let mut frames = Frames::default();
    batch.render(&requests(&scene, 4), &mut frames).unwrap();
    let before = frames.clone();
    let refused = |requests: &[FrameRequest], frames: &mut Frames| {
        batch.render(requests, frames).unwrap_err().to_string()
    };
    let many = requests(&scene, 5);
    let text = refused(&many, &mut frames);
    assert!(
        text.contains("76800 bytes") && text.contains("5 images of 48x40"),
        "{text}"
    );
    let wrong = |change: fn(&mut FrameRequest)| {
        let mut requests = requests(&scene, 2);
        change(&mut requests[1]);
        requests
    };
    let sector = wrong(|request| request.sector = 7);
    assert!(refused(&sector, &mut frames).contains("sector of frame 1: found 7"));
    let rate = wrong(|request| request.rate_rad_s[2] = f64::NAN);
    assert!(refused(&rate, &mut frames).contains("request of frame 1"));
    let gain = wrong(|request| request.gain = 0.0);
    assert!(refused(&gain, &mut frames).contains("gain"));
    let lens = wrong(|request| request.intrinsics_px[0] = -1e3);
    assert!(refused(&lens, &mut frames).contains("focal"));
    assert_eq!(frames, before);

    let (mut rgb, mut depth_m, mut has_depth) = (vec![7; 3], vec![7.0; 1920], vec![true; 1920]);
    let buffers = FrameBuffers {
        rgb: &mut rgb,
        depth_m: &mut depth_m,
        has_depth: &mut has_depth,
    };
    let text = batch
        .render_into(&many[..1], buffers)
        .unwrap_err()
        .to_string();
    assert!(
        text.contains("length of rgb: found 3, expected 5760"),
        "{text}"
    );
    assert_eq!(rgb, [7; 3]);

    // The call after an error works.
    batch.render(&requests(&scene, 4), &mut frames).unwrap();
    assert_eq!(frames, before);
}

#[test]
fn a_batch_that_overflows_the_number_of_bytes_is_refused() {
    let scene = SyntheticScene::room().unwrap();
    let huge = batch(&scene, |config| {
        config.model = crate::camera::pinhole([16_384, 16_384], 1.5).unwrap();
    });
    let error = huge
        .render(&requests(&scene, 3), &mut Frames::default())
        .unwrap_err();
    assert!(matches!(error, SimulationError::Budget { needed, .. } if needed == 3 << 31));
}

#[test]
fn sky_has_the_farthest_depth_and_no_surface() {
    let scene = SyntheticScene::tilted_plane([0.0, 0.0]).unwrap();
    let batch = batch(&scene, |config| config.far_m = 3.0);
    // Level, 1 m above the ground: the upper half shows the sky, the middle ground beyond 3 m.
    let turned = RigidTransform::body_from_optical();
    let pose = RigidTransform::from_wxyz(turned.rotation_wxyz(), [0.5, 3.0, 1.0]).unwrap();
    let frames = single(&batch, &FrameRequest::new(0, pose));
    for row in 0..40 {
        for column in 0..48 {
            let pixel = 48 * row + column;
            let (depth, has_depth) = (frames.depth_m[pixel], frames.has_depth[pixel]);
            assert_eq!(has_depth, depth < 3.0);
            if row < 20 {
                assert_eq!(depth, 3.0);
                // Its color is that of the scene's sky.
                assert_eq!(frames.rgb[3 * pixel..3 * pixel + 3], [140, 179, 230]);
            }
        }
    }
    assert!(frames.has_depth[48 * 39 + 24]);
}

#[test]
fn noise_is_a_function_of_its_key_alone() {
    let scene = SyntheticScene::room().unwrap();
    let noisy = batch(&scene, |config| {
        config.noise = NoiseConfig {
            full_well_e: 2000.0,
            ..NoiseConfig::default()
        };
    });
    let clean = batch(&scene, |_| {});
    let base = requests(&scene, 1)[0];
    let reference = single(&noisy, &base);
    assert_eq!(single(&noisy, &base), reference);
    let changes: [fn(&mut NoiseKey); 4] = [
        |key| key.seed += 1,
        |key| key.episode += 1,
        |key| key.frame += 1,
        |key| key.camera += 1,
    ];
    for change in changes {
        let mut other = base;
        change(&mut other.noise);
        let other = single(&noisy, &other);
        assert_ne!(other.rgb, reference.rgb);
        assert_eq!(other.depth_m, reference.depth_m);
    }
    // It is centered on the image without it.
    let without = single(&clean, &base);
    let errors = reference.rgb.iter().zip(&without.rgb);
    let errors: Vec<f64> = errors.map(|(a, b)| f64::from(*a) - f64::from(*b)).collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    assert!(
        mean.abs() < 0.2 && (2.0..10.0).contains(&rms),
        "{mean} {rms}"
    );
}

#[test]
fn motion_blurs_what_it_moves_across_the_image() {
    let scene = SyntheticScene::room().unwrap();
    let sharp = batch(&scene, |_| {});
    let blurred = batch(&scene, |config| {
        config.shutter = ShutterConfig {
            exposure_s: 0.1,
            blur_poses: 9,
            ..ShutterConfig::default()
        };
    });
    let mut request = FrameRequest::new(0, scene.scene.sectors[0].references[0]);
    // Without motion the blur changes nothing but rounding of the tone curve.
    let [still, image] = [&blurred, &sharp].map(|batch| single(batch, &request));
    let differences = still
        .rgb
        .iter()
        .zip(&image.rgb)
        .map(|(a, b)| a.abs_diff(*b));
    assert!(differences.max().unwrap() <= 1);
    request.rate_rad_s = [0.0, 2.0, 0.0];
    let moved = single(&blurred, &request);
    assert_eq!(moved.depth_m, image.depth_m);
    let contrast = |frames: &Frames| -> u64 {
        let rows = frames.rgb.chunks_exact(3 * frames.width);
        let of_row = |row: &[u8]| -> u64 {
            row.windows(4)
                .map(|pair| u64::from(pair[0].abs_diff(pair[3])))
                .sum()
        };
        rows.map(of_row).sum()
    };
    assert!(
        contrast(&moved) < contrast(&image),
        "{} {}",
        contrast(&moved),
        contrast(&image)
    );
}

#[test]
fn a_rolling_shutter_shows_the_first_and_last_row_from_their_own_poses() {
    let scene = SyntheticScene::room().unwrap();
    let line_s = 1e-3;
    let global = batch(&scene, |config| config.quality = Quality::Exact);
    let rolling = batch(&scene, |config| {
        config.quality = Quality::Exact;
        config.shutter.line_s = line_s;
    });
    let mut request = FrameRequest::new(0, scene.scene.sectors[0].references[0]);
    let at_rest = single(&global, &request);
    assert_eq!(single(&rolling, &request), at_rest);
    let rate = 6.0;
    request.rate_rad_s = [0.0, rate, 0.0];
    let found = single(&rolling, &request);
    let row_of =
        |frames: &Frames, row: usize| frames.rgb[3 * 48 * row..3 * 48 * (row + 1)].to_vec();
    for row in [3, 20, 36] {
        // From the pose of the camera at the time of the row.
        let yaw = rate * line_s * (row as f64 - 19.5);
        let motion = RigidTransform::from_rotation_vector([0.0, yaw, 0.0], [0.0; 3]).unwrap();
        let pose = request.world_from_camera * motion;
        let expected = single(&global, &FrameRequest::new(0, pose));
        let [of_row, still] =
            [&expected, &at_rest].map(|other| psnr_db(&row_of(&found, row), &row_of(other, row)));
        assert!(of_row > 33.0, "row {row}: {of_row} dB");
        assert_eq!(
            of_row > still + 3.0,
            row != 20,
            "row {row}: {of_row} dB, {still} dB"
        );
    }
}

/// PSNR of two images, dB.
fn psnr_db(a: &[u8], b: &[u8]) -> f64 {
    let square = |(a, b): (&u8, &u8)| (f64::from(*a) - f64::from(*b)).powi(2);
    let mse = a.iter().zip(b).map(square).sum::<f64>() / a.len() as f64;
    10.0 * libm::log10(255.0 * 255.0 / mse.max(1e-9))
}

#[test]
fn images_with_levels_of_detail_are_close_to_exact_ones() {
    let scenes = [SyntheticScene::room(), SyntheticScene::stairs()].map(Result::unwrap);
    let scenes = scenes
        .into_iter()
        .flat_map(|scene| [(scene.clone(), false), (scene, true)]);
    for (mut scene, is_compensated) in scenes {
        let mut sector = scene.scene.sectors[0].clone();
        let gaussians = sector.gaussians.unwrap().load().unwrap();
        let source = GaussianSource::new(Scene::clone(&gaussians), is_compensated);
        sector.gaussians = Some(source.unwrap());
        scene.scene = Arc::new(SceneData::new("test", vec![sector]).unwrap());
        let [exact, detail] =
            [Quality::Exact, Quality::Detail].map(|quality| batch(&scene, |c| c.quality = quality));
        let mut all: Vec<f64> = requests(&scene, 24)
            .iter()
            .map(|request| psnr_db(&single(&detail, request).rgb, &single(&exact, request).rgb))
            .collect();
        all.sort_by(f64::total_cmp);
        println!(
            "compensated {is_compensated}: {:.1} dB at least, {:.1} dB",
            all[0], all[12]
        );
        assert!(all[0] >= 35.0 && all[12] >= 40.0, "{all:?}");
    }
}

#[test]
fn images_fade_without_a_jump_across_an_imported_border() {
    for scale in [1.0, 1.02] {
        images_fade(scale);
    }
}

fn images_fade(scale: f32) {
    let scene = SyntheticScene::corridor_loop_scaled(0.06, f64::from(scale)).unwrap();
    let batch = batch(&scene, |_| {});
    let edge = scene.scene.sectors[0]
        .edges
        .iter()
        .find(|edge| edge.to == 1)
        .unwrap();
    let looking = RigidTransform::body_from_optical().rotation_wxyz();
    let at = |x: f64| RigidTransform::from_wxyz(looking, [x, 0.9, 1.3]).unwrap();
    let mut faded = 0;
    for step in 0..40 {
        let pose = at(8.0 + 0.1 * f64::from(step));
        let here = FrameRequest::new(0, pose);
        let there = FrameRequest::new(1, edge.to_from_here.carry(&pose));
        let mut frames = Frames::default();
        let report = batch.render(&[here, there], &mut frames).unwrap();
        // Whichever sector owns the camera: the same image, where the border is.
        let [a, b] = [0, 1].map(|number| part(&frames, number));
        let psnr_db = psnr_db(a.0, b.0);
        assert!(psnr_db >= 30.0, "{psnr_db} dB at step {step}");
        // Each in the unit of its sector, but for the sky.
        let error_m = |(a, b): (&f32, &f32)| if a == b { 0.0 } else { (a - b / scale).abs() };
        let errors = a.1.iter().zip(b.1).map(error_m);
        let mut errors: Vec<f32> = errors.collect();
        errors.sort_by(f32::total_cmp);
        let p95 = errors[errors.len() * 95 / 100];
        assert!(p95 <= 0.02, "{p95} m at step {step}");
        faded += report.cross_faded_frames;
    }
    assert!((10..70).contains(&faded), "{faded}");
}

/// The side of the smaller weight has half the columns and rows, whichever sector owns the camera.
#[test]
fn cross_faded_images_are_close_to_those_of_two_whole_ones() {
    let scene = SyntheticScene::corridor_loop_with(0.03).unwrap();
    let edges = &scene.scene.sectors[0].edges;
    let there = edges.iter().find(|edge| edge.to == 1).unwrap().to_from_here;
    let looking = RigidTransform::body_from_optical().rotation_wxyz();
    for size in [[64, 48], [161, 121], [320, 240]] {
        let [exact, fast] = [Quality::Exact, Quality::Detail].map(|quality| {
            batch(&scene, |config| {
                config.model = crate::camera::pinhole(size, 1.5).unwrap();
                config.quality = quality;
            })
        });
        let (mut all_db, mut all_m, mut weights) = (Vec::new(), Vec::new(), Vec::new());
        for step in 0..10 {
            // Diagonally across the border, on which both weights are a half.
            let along = 0.1 * f64::from(step);
            let at = [10.2 + along, 0.6 + along, 1.3];
            let pose = RigidTransform::from_wxyz(looking, at).unwrap();
            let Some((_, weight)) = scene.scene.fade(0, at) else {
                continue;
            };
            weights.push(weight);
            let request = FrameRequest::new(0, pose);
            let [a, b] = [&exact, &fast].map(|batch| single(batch, &request));
            all_db.push(psnr_db(&a.rgb, &b.rgb));
            let known = a.has_depth.iter().zip(&b.has_depth);
            let depths = a.depth_m.iter().zip(&b.depth_m).zip(known);
            let known = depths.filter(|(_, (a, b))| **a && **b);
            all_m.extend(known.map(|((a, b), _)| (a - b).abs()));
            let other = single(&fast, &FrameRequest::new(1, there.carry(&pose)));
            let db = psnr_db(&b.rgb, &other.rgb);
            assert!(
                db > 50.0,
                "{size:?}, weight {weight}: {db} dB from both sectors"
            );
        }
        let middle = weights.iter().filter(|weight| (0.3..0.7).contains(*weight));
        assert!(middle.count() >= 2, "{weights:?}");
        all_db.sort_by(f64::total_cmp);
        all_m.sort_by(f32::total_cmp);
        let p95_m = all_m[all_m.len() * 95 / 100];
        let (least_db, median_db) = (all_db[0], all_db[all_db.len() / 2]);
        println!(
            "{size:?}, weights {weights:.2?}: {least_db:.1} dB at least, {median_db:.1} dB, depth {p95_m:.4} m"
        );
        assert!(
            least_db >= 35.0 && median_db >= 40.0,
            "{size:?}: {all_db:?}"
        );
        assert!(p95_m <= 0.02, "{size:?}: {p95_m} m");
    }
}
