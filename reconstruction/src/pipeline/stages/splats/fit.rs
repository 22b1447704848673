//! The training from views, with checkpoints.

use splats::{
    Background, Coverage, GrowthByNeed, GrowthCheck, Scene, Sky, SplatError, Trainer,
    TrainingDevice, TrainingView, points_from_views, splats_from_points,
};

use super::checkpoint::CheckpointFile;
use super::config::SplatsConfig;
use crate::pipeline::StageError;

/// Steps between two checkpoints.
const CHECKPOINT_STEPS: usize = 500;

/// Held-out views whose PSNR is shown during the training.
const SHOWN_VIEWS: usize = 16;

/// A trained scene.
pub(super) struct Fit {
    pub(super) scene: Scene,
    /// Number of Gaussians at the start.
    pub(super) start_count: usize,
    /// Checks of growth.
    pub(super) checks: Vec<GrowthCheck>,
    /// What the views of the training saw of it.
    pub(super) coverage: Coverage,
    /// Why the processor took over from the device.
    pub(super) fell_back: Option<String>,
}

/// What runs the steps.
pub(super) struct On {
    /// The processor if there is none.
    pub(super) device: Option<Box<dyn TrainingDevice>>,
    /// Whether the processor takes over if the device fails.
    pub(super) falls_back: bool,
    /// Why the processor took over before the first step.
    pub(super) fell_back: Option<String>,
}

impl On {
    /// On a device, or on the processor if it cannot be used and the processor takes over: a
    /// device that was lost in the training of one sector remains lost for the next one.
    ///
    /// # Errors
    /// That of the device if the processor does not take over.
    pub(super) fn new(
        device: Result<Option<Box<dyn TrainingDevice>>, StageError>,
        falls_back: bool,
    ) -> Result<Self, StageError> {
        let (device, fell_back) = match device {
            Ok(device) => (device, None),
            Err(error) if falls_back => (None, Some(error.to_string())),
            Err(error) => return Err(error),
        };
        Ok(Self {
            device,
            falls_back,
            fell_back,
        })
    }
}

/// Progress of a training.
#[derive(Clone, Copy, Debug)]
pub(super) struct Progress {
    pub(super) steps: usize,
    pub(super) splats: usize,
    /// Mean PSNR of some held-out views at the last checkpoint, dB.
    pub(super) psnr_db: Option<f64>,
}

/// The scene at the start: discs at depths before a sky of the mean color of the rest. `None` where
/// no pixel has depth.
///
/// # Errors
/// Those of the discs and of the sky.
pub fn start(views: &[TrainingView], config: &SplatsConfig) -> Result<Option<Scene>, SplatError> {
    let points = points_from_views(views, &config.start);
    if points.is_empty() {
        return Ok(None);
    }
    let (mut sums, mut count) = ([0_u64; 3], 0_u64);
    for view in views {
        for (pixel, depth) in view.depth_m.iter().enumerate() {
            let is_usable = view.mask.get(pixel).copied().unwrap_or(true);
            if is_usable && depth.is_nan() {
                count += 1;
                for (sum, value) in sums.iter_mut().zip(&view.rgb[3 * pixel..]) {
                    *sum += u64::from(*value);
                }
            }
        }
    }
    let color = sums.map(|sum| (sum as f64 / (255.0 * count.max(1) as f64)) as f32);
    Ok(Some(Scene {
        splats: splats_from_points(&points)?,
        background: Background::Sky(Sky::uniform(config.sky_texels, color)?),
    }))
}

/// Trains a scene, from its checkpoint if there is one.
///
/// # Errors
/// [`SplatError::Diverged`], those of the views, and [`SplatError::Device`] if the device fails and
/// the processor does not take over.
pub(super) fn fit(
    scene: Scene,
    views: Vec<TrainingView>,
    held_out: &[TrainingView],
    config: &SplatsConfig,
    checkpoint: &CheckpointFile,
    mut on: On,
    progress: &mut dyn FnMut(Progress),
) -> Result<Fit, SplatError> {
    let start_count = scene.splats.len();
    let mut trainer = Trainer::new(scene, views, config.train, config.render, config.seed)?;
    let mut growth = GrowthByNeed::new(&config.train);
    if let Some(state) = checkpoint.read() {
        match GrowthByNeed::resume(&state, &mut trainer) {
            Ok(resumed) => growth = resumed,
            Err(error) => checkpoint.discarded(&error.to_string()),
        }
    }
    let shown = &held_out[..held_out.len().min(SHOWN_VIEWS)];
    let (mut psnr_db, mut fell_back) = (None, on.fell_back.take());
    while trainer.steps() < config.train.steps {
        let before = trainer.steps();
        let result = match &mut on.device {
            None => growth.advance(&mut trainer, held_out),
            Some(device) => growth.advance_on(&mut trainer, held_out, device.as_mut()),
        };
        match result {
            Err(SplatError::Device { reason }) if on.falls_back => {
                on.device = None;
                fell_back = Some(reason);
                continue;
            }
            other => other?,
        }
        let steps = trainer.steps();
        if steps / CHECKPOINT_STEPS > before / CHECKPOINT_STEPS && steps < config.train.steps {
            checkpoint.write(&growth.checkpoint(&trainer)?);
            psnr_db = (!shown.is_empty()).then(|| trainer.evaluate(shown).mean_psnr_db());
        }
        progress(Progress {
            steps: steps.min(config.train.steps),
            splats: trainer.scene().splats.len(),
            psnr_db,
        });
    }
    Ok(Fit {
        start_count,
        fell_back,
        checks: growth.checks().to_vec(),
        coverage: trainer.coverage(&config.coverage)?,
        scene: trainer.scene().clone(),
    })
}
