use std::ops::Range;

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};

use super::*;
use crate::config::RenderConfig;
use crate::scene::{Background, Splat, Splats};

/// A device that changes the first opacity in each run, and fails in the run of a step.
struct Recorder {
    runs: Vec<Range<usize>>,
    fails_at: usize,
}

impl TrainingDevice for Recorder {
    fn run(
        &mut self,
        run: &TrainingRun<'_>,
        mut state: TrainingState,
    ) -> Result<TrainingState, SplatError> {
        for step in run.steps.clone() {
            assert_eq!(run.step(step)?.step, step);
        }
        self.runs.push(run.steps.clone());
        let mut planes = state.scene.splats.planes().to_vec();
        planes[10][0] += 0.01;
        state.scene.splats = Splats::from_planes(state.scene.splats.degree(), planes)?;
        match run.steps.contains(&self.fails_at) {
            true => Err(SplatError::Device {
                reason: "as requested".to_owned(),
            }),
            false => Ok(state),
        }
    }
}

fn trainer(config: TrainConfig) -> Trainer {
    let model = CameraModel::new((16, 16), [16.0, 16.0, 7.5, 7.5], Distortion::None);
    let camera = Camera::new(model, RigidTransform::identity()).unwrap();
    let view = TrainingView::new(camera, vec![200; 3 * 16 * 16], 0);
    let mut splats = Splats::empty(1).unwrap();
    let position_m = [0.0, 0.0, 2.0];
    let ball = Splat {
        position_m,
        ..Splat::sphere(0.1, [0.5; 3])
    };
    splats.push(&ball).unwrap();
    let background = Background::Constant([0.0; 3]);
    let scene = Scene { splats, background };
    Trainer::new(scene, vec![view], config, RenderConfig::default(), 7).unwrap()
}

fn config() -> TrainConfig {
    let mut config = TrainConfig {
        steps: 420,
        degree: 1,
        degree_start: 0.5,
        ..TrainConfig::default()
    };
    (config.growth.start, config.growth.interval) = (150, 150);
    config
}

#[test]
fn runs_end_where_only_the_processor_changes_something() {
    let mut trainer = trainer(config());
    let mut device = Recorder {
        runs: Vec::new(),
        fails_at: usize::MAX,
    };
    let before = trainer.scene().splats.planes()[10][0];
    while trainer.steps() < 420 {
        trainer.run_on(&mut device, 420 - trainer.steps()).unwrap();
    }
    // Every hundred steps, at rounds of growth and the step before, at the second degree, the end.
    let ends: Vec<usize> = device.runs.iter().map(|run| run.end).collect();
    assert_eq!(ends, [100, 149, 150, 200, 210, 299, 300, 400, 420]);
    let starts = device.runs.iter().map(|run| run.start);
    assert!(starts.skip(1).eq(ends.iter().copied().take(8)));
    let after = trainer.scene().splats.planes()[10][0];
    assert!((after - before - 0.09).abs() < 1e-5, "{before} {after}");
}

#[test]
fn a_failed_run_changes_nothing() {
    let mut trainer = trainer(config());
    let mut device = Recorder {
        runs: Vec::new(),
        fails_at: 120,
    };
    trainer.run_on(&mut device, 110).unwrap();
    let before = trainer.scene().clone();
    assert_eq!(trainer.steps(), 100);
    assert!(trainer.run_on(&mut device, 30).is_err());
    assert!(trainer.steps() == 100 && *trainer.scene() == before);
    assert_eq!(trainer.run_on(&mut device, 10), Ok(10));
}
