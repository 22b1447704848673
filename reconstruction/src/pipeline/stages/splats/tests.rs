use std::fs;

use ::splats::{
    Background, Camera, Evaluation, Exposure, RenderConfig, Renderer, Scene, Splat, SplatError,
    Splats, TrainingDevice, TrainingRun, TrainingState, TrainingView,
};
use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};
use serde_json::json;

use super::checkpoint::CheckpointFile;
use super::fit::{fit, start};
use super::*;

const SIZE: (u32, u32) = (48, 32);

/// A scene of colored balls before a plain background.
fn truth() -> Scene {
    let mut splats = Splats::empty(0).expect("a degree");
    for i in 0..60_u16 {
        let part = |k: u16| f32::from((i * 37 + k * 61) % 101) / 100.0;
        let mut splat = Splat::sphere(0.12, [part(1), part(2), part(3)]);
        splat.position_m = [2.4 * part(4) - 1.2, 1.6 * part(5) - 0.8, 3.0 + part(6)];
        splat.opacity_logit = 3.0;
        splats.push(&splat).expect("finite");
    }
    Scene {
        splats,
        background: Background::Constant([0.3, 0.4, 0.5]),
    }
}

/// Views from beside each other.
fn views(count: u32, offset_m: f64) -> Vec<TrainingView> {
    let renderer = Renderer::new(RenderConfig::default()).expect("a renderer");
    let model = CameraModel::new(SIZE, [45.0, 45.0, 23.5, 15.5], Distortion::None);
    let truth = truth();
    let view = |number: u32| {
        let x = 0.1 * f64::from(number) - 0.5 + offset_m;
        let pose = RigidTransform::from_translation_m([x, 0.0, 0.0]).expect("finite");
        let camera = Camera::new(model, pose).expect("a camera");
        let image = renderer.render(&truth, &camera, &Exposure::NONE);
        let bytes = (0..3 * camera.pixels()).map(|i| (image.rgb[i % 3][i / 3] * 255.0) as u8);
        let mut view = TrainingView::new(camera.clone(), bytes.collect(), number);
        view.depth_sigma_m = vec![0.03; image.median_depth_m.len()];
        view.depth_m = image.median_depth_m;
        view
    };
    (0..count).map(view).collect()
}

fn settings(steps: usize) -> SplatsConfig {
    let mut config = SplatsConfig::preset(Preset::Fast, Some(steps));
    config.train.growth.check_steps = 40;
    config.start.max_points = 300;
    config
}

fn processor() -> On {
    On::new(Ok(None), false).expect("the processor")
}

/// A device that is lost after some runs of steps, which it leaves to nobody.
pub(super) struct FailingDevice {
    pub(super) runs: usize,
}

impl TrainingDevice for FailingDevice {
    fn run(
        &mut self,
        _run: &TrainingRun<'_>,
        state: TrainingState,
    ) -> Result<TrainingState, SplatError> {
        if self.runs == 0 {
            let reason = "it was taken away".to_owned();
            return Err(SplatError::Device { reason });
        }
        self.runs -= 1;
        Ok(state)
    }
}

#[test]
fn the_processor_takes_over_from_a_lost_device_only_if_asked() {
    let config = settings(260);
    let training = views(6, 0.0);
    for falls_back in [false, true] {
        let mut steps = Vec::new();
        let result = fit(
            scene(&training, &config),
            training.clone(),
            &[],
            &config,
            &no_file(),
            On::new(Ok(Some(Box::new(FailingDevice { runs: 1 }))), falls_back).expect("a device"),
            &mut |now| steps.push(now.steps),
        );
        // A run ends at a hundred steps.
        assert_eq!(steps.first(), Some(&100));
        match result {
            Ok(fit) => {
                assert!(falls_back && steps.contains(&101) && steps.ends_with(&[260]));
                assert_eq!(fit.fell_back.as_deref(), Some("it was taken away"));
            }
            Err(error) => {
                assert!(!falls_back, "{error}");
                let expected = "training on a device failed: it was taken away";
                assert_eq!(error.to_string(), expected);
            }
        }
    }
}

/// Without checkpoint.
fn no_file() -> CheckpointFile {
    CheckpointFile::new("/nowhere/splats.checkpoint".into(), &json!({}), &[])
}

fn scene(views: &[TrainingView], config: &SplatsConfig) -> Scene {
    start(views, config).expect("points").expect("depth")
}

#[test]
fn a_killed_training_resumes_with_the_same_result() {
    let config = settings(1200);
    let (training, held_out) = (views(10, 0.0), views(4, 0.23));
    let folder = tempfile::tempdir().expect("a folder");
    let of = |name: &str| {
        let path = folder.path().join(name);
        CheckpointFile::new(path, &json!({ "config": config }), &[])
    };
    let (mut steps, mut held) = (Vec::new(), None);
    let mut progress = |now: fit::Progress| {
        steps.push(now.steps);
        held = held.or(now.psnr_db);
        // What a process that is killed here leaves.
        if now.steps >= 700 && !folder.path().join("killed").exists() {
            let left = fs::copy(folder.path().join("whole"), folder.path().join("killed"));
            left.expect("a checkpoint after 500 steps");
        }
    };
    let whole = fit(
        scene(&training, &config),
        training.clone(),
        &held_out,
        &config,
        &of("whole"),
        processor(),
        &mut progress,
    )
    .expect("a training");
    assert_eq!((steps[0], steps.last()), (1, Some(&1200)));
    assert!(held.is_some_and(|db| db > 10.0), "{held:?}");
    assert!(!whole.checks.is_empty());

    let mut first = None;
    let resumed = fit(
        scene(&training, &config),
        training,
        &held_out,
        &config,
        &of("killed"),
        processor(),
        &mut |now| first = first.or(Some(now.steps)),
    )
    .expect("a training");
    assert!(first.is_some_and(|step| step > 500), "{first:?}");
    assert!(resumed.scene == whole.scene);
    assert_eq!(resumed.checks, whole.checks);
    assert!(resumed.coverage == whole.coverage);
    let renderer = Renderer::new(RenderConfig::default()).expect("a renderer");
    let evaluation = Evaluation::new(&renderer, &whole.scene, &held_out);
    assert!(evaluation.mean_psnr_db() > 18.0, "{evaluation:?}");
}

#[test]
fn a_number_that_is_not_finite_is_an_error_with_its_step() {
    let config = settings(50);
    let mut training = views(4, 0.0);
    let scene = scene(&training, &config);
    training[0].exposure.matrix[1][1] = f32::NAN;
    let result = fit(
        scene,
        training,
        &[],
        &config,
        &no_file(),
        processor(),
        &mut |_| {},
    );
    let error = result.err().expect("a failed training");
    assert!(
        matches!(error, SplatError::Diverged { step: 0..4, .. }),
        "{error}"
    );
    assert!(
        error.to_string().contains("training failed at step"),
        "{error}"
    );
}

#[test]
fn depths_that_are_not_finite_are_no_depth() {
    let config = settings(50);
    let mut all = views(2, 0.0);
    for view in &mut all {
        view.depth_m[7] = f32::INFINITY;
        view.depth_sigma_m[9] = f32::NAN;
    }
    let scene = start(&all, &config).expect("points").expect("depth");
    assert!(Splats::from_planes(0, scene.splats.planes().to_vec()).is_ok());
    for view in &mut all {
        view.depth_m.fill(f32::NAN);
    }
    assert!(start(&all, &config).expect("no error").is_none());
}

#[test]
fn too_little_memory_is_an_error_in_bytes_before_the_start() {
    let sizes = |count: usize| vec![[672 * 376_u64; 2]; count];
    let needed = |count: usize, preset: Preset| {
        let config = SplatsConfig::preset(preset, None);
        let check = |sectors: &[Vec<[u64; 2]>], available| {
            memory::check(sectors, &[sizes(8)], &config, available)
                .map_err(|error| error.to_string())
        };
        let sectors = [sizes(count)];
        let text = check(&sectors, Some(0)).expect_err("no memory");
        let bytes = text
            .split(" bytes")
            .next()
            .and_then(|t| t.rsplit(' ').next());
        assert!(text.contains("found 0 available"), "{text}");
        let bytes: u64 = bytes.expect("a number").parse().expect("a number");
        assert!(check(&sectors, Some(bytes)).is_ok());
        assert!(check(&sectors, None).is_ok());
        // Of several sectors the largest one counts, and the Gaussians of the others.
        let several = [sizes(count / 2), sizes(count), sizes(1)];
        let text = check(&several, Some(bytes)).expect_err("more memory");
        assert!(text.contains("of the largest of 3 sectors needs"), "{text}");
        assert!(
            text.contains(&format!("from {count} stereo images")),
            "{text}"
        );
        let others = 2 * config.train.growth.max_splats as u64 * 200;
        assert!(check(&several, Some(bytes + others)).is_ok());
        bytes
    };
    let balanced = needed(625, Preset::Balanced);
    // Colors, masks and depths of 1250 images of 253 kpx, and the Gaussians.
    assert!(
        (2_500_000_000..4_000_000_000).contains(&balanced),
        "{balanced}"
    );
    assert!(needed(625, Preset::Fast) < balanced / 3);
    let per_image = (needed(1250, Preset::Balanced) - balanced) / 625;
    // And the combined depth of a sixteenth of the pixels of left images.
    let pixels = 672 * 376;
    assert_eq!(per_image, pixels * (3 + 1 + 8 + 3 + 1) + pixels / 16 * 8);

    // Of many sectors all Gaussians are the most: as they are, as copies for the files, and what
    // was seen of both.
    let config = SplatsConfig::preset(Preset::Balanced, None);
    let many = |count: usize| {
        let sectors = vec![sizes(100); count];
        let error = memory::check(&sectors, &[sizes(8)], &config, Some(0)).expect_err("no memory");
        let text = error.to_string();
        let start = format!("comparing and writing {count} sectors needs up to ");
        let rest = text
            .strip_prefix(&start)
            .unwrap_or_else(|| panic!("{text}"));
        assert!(
            rest.contains("take more for `--splat-sector-views`"),
            "{text}"
        );
        let (bytes, _) = rest.split_once(' ').expect("a number");
        bytes.parse::<u64>().expect("a number")
    };
    let of_sector = 2 * (23 * 4 + 32) * config.train.growth.max_splats as u64;
    assert_eq!(many(80) - many(40), 40 * of_sector);
}
