//! Growth by need: training that stops to add Gaussians when held-out views stop to gain.
//!
//! PSNR scatters by more from one evaluation to the next than a tenth more Gaussians gains. A check
//! therefore continues the training twice from the same state, as it is and with a share of the
//! Gaussians split, for the same steps and on the same views, and compares view by view.

use super::codec::{Codec, State, broken};
use super::config::TrainConfig;
use super::evaluate::Evaluation;
use super::trainer::Trainer;
use super::trainer::device::TrainingDevice;
use super::view::TrainingView;
use crate::error::SplatError;

/// Smallest number of held-out views for a check.
const MIN_VIEWS: usize = 4;
/// Seed and stream of random numbers of the choice of held-out views.
const SEED: u64 = 1;
const STREAM: u64 = 0x6865_6c64;

/// A comparison of two scenes that differ in their number of Gaussians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GrowthCheck {
    /// Step at which the two trainings parted.
    pub step: usize,
    /// Gaussians of the smaller and of the larger scene.
    pub splats: [usize; 2],
    /// Mean PSNR of the held-out views in both scenes, dB.
    pub psnr_db: [f64; 2],
    /// Gain of a tenth more Gaussians, dB.
    pub gain_db: f64,
    /// The gain plus two standard errors, dB.
    pub upper_gain_db: f64,
    /// Whether growth continues. It ends after [`GrowthConfig::failed_checks`] checks in a row that
    /// say no, and pauses after one.
    ///
    /// [`GrowthConfig::failed_checks`]: super::GrowthConfig::failed_checks
    pub continues: bool,
}

/// Result of [`train`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrainReport {
    /// All checks of growth: the curve of PSNR over the number of Gaussians.
    pub checks: Vec<GrowthCheck>,
    /// Held-out views at the end.
    pub evaluation: Evaluation,
}

/// Runs a training to its end. Without at least four held-out views, growth ends by schedule alone.
///
/// # Errors
/// Those of [`Trainer::step`].
pub fn train(trainer: &mut Trainer, held_out: &[TrainingView]) -> Result<TrainReport, SplatError> {
    let mut growth = GrowthByNeed::new(trainer.config());
    while trainer.steps() < trainer.config().steps {
        growth.advance(trainer, held_out)?;
    }
    Ok(TrainReport {
        checks: growth.checks,
        evaluation: trainer.evaluate(held_out),
    })
}

/// Growth by need, for a training that is run step by step and can be stopped and continued.
///
/// ```
/// # use cad_transforms::RigidTransform;
/// # use camera_models::{CameraModel, Distortion};
/// # use splats::{Background, Camera, GrowthByNeed, RenderConfig, Scene, Splat, Splats};
/// # use splats::{TrainConfig, Trainer, TrainingView};
/// # let model = CameraModel::new((16, 16), [16.0, 16.0, 7.5, 7.5], Distortion::None);
/// # let camera = Camera::new(model, RigidTransform::identity())?;
/// # let view = TrainingView::new(camera, vec![200; 3 * 16 * 16], 0);
/// # let mut splats = Splats::empty(0)?;
/// # splats.push(&Splat { position_m: [0.0, 0.0, 2.0], ..Splat::sphere(0.5, [0.5; 3]) })?;
/// # let scene = Scene { splats, background: Background::Constant([0.0; 3]) };
/// # let mut config = TrainConfig::default();
/// # config.steps = 20;
/// let views = vec![view];
/// let new = || Trainer::new(scene.clone(), views.clone(), config, RenderConfig::default(), 7);
/// let mut trainer = new()?;
/// let mut growth = GrowthByNeed::new(&config);
/// for _ in 0..10 {
///     growth.advance(&mut trainer, &[])?;
/// }
/// let checkpoint = growth.checkpoint(&trainer)?;
///
/// // Another process makes the same trainer from the same views and continues.
/// let mut resumed = new()?;
/// let mut resumed_growth = GrowthByNeed::resume(&checkpoint, &mut resumed)?;
/// for _ in 0..10 {
///     growth.advance(&mut trainer, &[])?;
///     resumed_growth.advance(&mut resumed, &[])?;
/// }
/// assert_eq!(resumed.scene(), trainer.scene());
/// # Ok::<(), splats::SplatError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct GrowthByNeed {
    /// Number of Gaussians and step of the next check.
    next_count: f32,
    next_step: usize,
    /// Failed checks in a row.
    failed: usize,
    checks: Vec<GrowthCheck>,
}

impl GrowthByNeed {
    /// Before the first step.
    pub fn new(config: &TrainConfig) -> Self {
        Self {
            next_count: 0.0,
            next_step: config.growth.start.saturating_sub(1),
            failed: 0,
            checks: Vec::new(),
        }
    }

    /// A step, or a check with all its steps.
    ///
    /// # Errors
    /// Those of [`Trainer::step`].
    pub fn advance(
        &mut self,
        trainer: &mut Trainer,
        held_out: &[TrainingView],
    ) -> Result<(), SplatError> {
        self.advance_with(trainer, held_out, None)
    }

    /// Some steps on a device, at most 100, or a check with all its steps.
    ///
    /// # Errors
    /// Those of [`Trainer::run_on`].
    pub fn advance_on(
        &mut self,
        trainer: &mut Trainer,
        held_out: &[TrainingView],
        device: &mut dyn TrainingDevice,
    ) -> Result<(), SplatError> {
        self.advance_with(trainer, held_out, Some(device))
    }

    fn advance_with(
        &mut self,
        trainer: &mut Trainer,
        held_out: &[TrainingView],
        mut device: Option<&mut dyn TrainingDevice>,
    ) -> Result<(), SplatError> {
        let config = *trainer.config();
        let growth = &config.growth;
        let checks = growth.min_gain_db > 0.0 && held_out.len() >= MIN_VIEWS;
        let ends = (growth.stop * config.steps as f32) as usize;
        let step = trainer.steps();
        let is_possible = checks
            && self.failed < growth.failed_checks
            && step + growth.check_steps < ends
            && trainer.is_before_round();
        let has_grown = self.failed > 0 || trainer.scene().splats.len() as f32 >= self.next_count;
        if !(is_possible && has_grown && step >= self.next_step) {
            match device {
                None => trainer.step().map(|_| ())?,
                Some(device) => trainer.run_on(device, usize::MAX - step).map(|_| ())?,
            }
            return Ok(());
        }
        let before = trainer.clone();
        let check = match parted(trainer, held_out, &config, &mut device) {
            Ok(check) => check,
            Err(error) => {
                *trainer = before;
                return Err(error);
            }
        };
        self.next_count = check.splats[0] as f32 * growth.check_factor;
        self.next_step = trainer.steps() + 2 * growth.check_steps;
        self.failed = if check.continues { 0 } else { self.failed + 1 };
        self.checks.push(check);
        Ok(())
    }

    /// The checks so far: the curve of PSNR over the number of Gaussians.
    pub fn checks(&self) -> &[GrowthCheck] {
        &self.checks
    }

    /// The state of a training, to continue it later: views and configuration are not in it.
    ///
    /// # Errors
    /// [`SplatError::Sky`] if the sky is not finite.
    pub fn checkpoint(&self, trainer: &Trainer) -> Result<Vec<u8>, SplatError> {
        let mut codec = Codec::Write(Vec::new());
        self.clone().visit(&mut codec)?;
        trainer.clone().visit(&mut codec)?;
        match codec {
            Codec::Write(bytes) => Ok(bytes),
            Codec::Read(_) => Ok(Vec::new()),
        }
    }

    /// Continues a training. The trainer is one of the same views, configuration and seed; it is
    /// unchanged on an error.
    ///
    /// # Errors
    /// [`SplatError::Checkpoint`] and those of a scene if the bytes are not the state of such a
    /// training. Any bytes are accepted.
    pub fn resume(bytes: &[u8], trainer: &mut Trainer) -> Result<Self, SplatError> {
        let mut growth = Self::new(trainer.config());
        let mut codec = Codec::Read(bytes);
        growth.visit(&mut codec)?;
        let mut loaded = trainer.clone();
        loaded.load(&mut codec)?;
        match codec {
            Codec::Read([]) => {}
            _ => return Err(broken("it has more bytes than its training")),
        }
        *trainer = loaded;
        Ok(growth)
    }
}

impl State for GrowthByNeed {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        self.next_count.visit(codec)?;
        self.next_step.visit(codec)?;
        self.failed.visit(codec)?;
        self.checks.visit(codec)
    }
}

impl State for GrowthCheck {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        self.step.visit(codec)?;
        self.splats.visit(codec)?;
        self.psnr_db.visit(codec)?;
        self.gain_db.visit(codec)?;
        self.upper_gain_db.visit(codec)?;
        self.continues.visit(codec)
    }
}

/// Runs steps on the device, if there is one.
fn run(
    trainer: &mut Trainer,
    steps: usize,
    device: &mut Option<&mut dyn TrainingDevice>,
) -> Result<(), SplatError> {
    let mut done = 0;
    while done < steps {
        done += match device {
            None => trainer.step().map(|_| 1)?,
            Some(device) => trainer.run_on(&mut **device, steps - done)?,
        };
    }
    Ok(())
}

/// The step before the check, and the check. It takes the place of the round, which would forget
/// what was gathered. After an error the trainer must not be used.
fn parted(
    trainer: &mut Trainer,
    held_out: &[TrainingView],
    config: &TrainConfig,
    device: &mut Option<&mut dyn TrainingDevice>,
) -> Result<GrowthCheck, SplatError> {
    trainer.set_growth(false);
    run(trainer, 1, device)?;
    check(trainer, held_out, config, device)
}

/// Compares both continuations; the trainer becomes the chosen one.
fn check(
    trainer: &mut Trainer,
    held_out: &[TrainingView],
    config: &TrainConfig,
    device: &mut Option<&mut dyn TrainingDevice>,
) -> Result<GrowthCheck, SplatError> {
    let step = trainer.steps();
    let mut same = trainer.clone();
    let mut larger = trainer.clone();
    larger.grow(config.growth.check_share);
    let compared = chosen(held_out, config.growth.check_views);
    let mut psnr_db = [Vec::new(), Vec::new()];
    for (trainer, psnr_db) in [&mut same, &mut larger].into_iter().zip(&mut psnr_db) {
        trainer.set_growth(false);
        run(trainer, config.growth.check_steps, device)?;
        *psnr_db = trainer.psnr_db(&compared);
    }
    let splats = [&same, &larger].map(|trainer| trainer.scene().splats.len());
    let (mean, error) = paired(&psnr_db[0], &psnr_db[1]);
    let has_grown = splats[1] > splats[0];
    // A gain is proportional to the logarithm of the number. Where more were removed than split
    // there is none.
    let per_tenth = match has_grown {
        true => libm::log(1.1) / libm::log(splats[1] as f64 / splats[0].max(1) as f64),
        false => 0.0,
    };
    let upper_gain_db = (mean + 2.0 * error) * per_tenth;
    let continues = has_grown && upper_gain_db >= f64::from(config.growth.min_gain_db);
    *trainer = if continues { larger } else { same };
    trainer.set_growth(continues);
    Ok(GrowthCheck {
        step,
        splats,
        psnr_db: psnr_db.map(|of| of.iter().sum::<f64>() / of.len() as f64),
        gain_db: mean * per_tenth,
        upper_gain_db,
        continues,
    })
}

/// At most that many of the views, always the same: one at random of each of equal parts. At equal
/// distances they could be those of one camera.
fn chosen(views: &[TrainingView], most: usize) -> Vec<&TrainingView> {
    let parts = views.len().min(most.max(MIN_VIEWS));
    let first = |part: usize| part * views.len() / parts;
    let one = |part: usize| {
        let length = first(part + 1) - first(part);
        let number = counter_random::bits(SEED, STREAM, part as u64) % length as u64;
        &views[first(part) + number as usize]
    };
    (0..parts).map(one).collect()
}

/// Mean of paired differences and its standard error.
fn paired(a: &[f64], b: &[f64]) -> (f64, f64) {
    let n = a.len() as f64;
    let differences = || a.iter().zip(b).map(|(a, b)| b - a);
    let mean = differences().sum::<f64>() / n;
    let squares: f64 = differences().map(|d| (d - mean) * (d - mean)).sum();
    (mean, (squares / (n - 1.0).max(1.0) / n).sqrt())
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;
    use camera_models::{CameraModel, Distortion};

    use super::*;
    use crate::camera::Camera;

    #[test]
    fn views_of_a_check_are_of_all_cameras() {
        let model = CameraModel::new((1, 1), [1.0, 1.0, 0.0, 0.0], Distortion::None);
        let camera = Camera::new(model, RigidTransform::identity()).unwrap();
        let view = |instant| TrainingView::new(camera.clone(), vec![0; 3], instant);
        let views: Vec<TrainingView> = (0..384).map(view).collect();
        let instants = |views, most| -> Vec<u32> {
            let chosen: Vec<&TrainingView> = chosen(views, most);
            chosen.iter().map(|view| view.instant).collect()
        };
        assert!(instants(&views[..64], 64).into_iter().eq(0..64));
        assert!(instants(&[], 64).is_empty());
        let chosen = instants(&views, 64);
        assert!(chosen.iter().map(|view| view / 6).eq(0..64));
        // Three cameras with two images each, in turn.
        for image in 0..6 {
            let count = chosen.iter().filter(|view| *view % 6 == image).count();
            assert!((4..=20).contains(&count), "{count} of image {image}");
        }
    }
}
