//! Stage `splats`: the scene as 3D Gaussians, trained from images of keyframes.
//!
//! Contract: images are those of the session at the poses of the keyframes, without rectification,
//! each row of a rolling shutter at its own time. Pixels that masks exclude train nothing. The
//! scene starts at the depths of the keyframes; held-out instants decide how many Gaussians it has,
//! and neither their images nor their depths train it. Same input, settings and seed, same bytes on
//! any number of threads, also after a kill: every 500 steps the state is kept beside the bundle's
//! outputs, and a run with the same settings and inputs continues it.
//!
//! Too few images, no depth and images that are masked whole are losses, with an output without
//! sectors. Too little memory is an error before the training, values that are not finite one
//! during it; the older output is kept then.

use std::path::Path;

use scene_bundle::layout::SPLATS_CHECKPOINT;
use scene_bundle::outputs::{self, DEPTH, KEYFRAMES, MASKS, RIG_REFINED, SPLATS, TRAJECTORY};
use serde_json::{Value, json};
use session_input::{Color, View};
use splats::TrainingView;

pub use self::config::SplatsConfig;
pub use self::fit::start;
pub use self::recorded_depth::{DepthOfPixels, RecordedDepth};

use self::checkpoint::CheckpointFile;
use self::keyframes::{CameraKeyframes, ChosenKeyframe};
use self::product::{Names, Views};
use self::views::{BATCH, Inputs, RecordedView, ViewMaker};
use super::device::Device;
use super::preset::Preset;
use crate::input::{HANDOFF, Input};
use crate::pipeline::{Stage, StageError, Work};

mod checkpoint;
mod config;
mod fit;
mod keyframes;
mod masks;
mod memory;
mod product;
mod recorded_depth;
#[cfg(test)]
mod tests;
mod views;

/// Share of the progress for reading images, against the steps of the training.
const READ_STEPS: u64 = 5;

/// See the module.
pub(super) struct SplatsStage {
    pub(super) preset: Preset,
    /// Number of steps in place of the preset's.
    pub(super) steps: Option<usize>,
    /// Where to train. Its name is a setting unless it is the processor: rounding differs.
    pub(super) device: Device,
    /// Memory that may be used, bytes; not a setting, since no output depends on it.
    pub(super) memory_bytes: Option<u64>,
}

impl SplatsStage {
    fn config(&self) -> SplatsConfig {
        SplatsConfig::preset(self.preset, self.steps)
    }
}

impl Stage<Input> for SplatsStage {
    fn name(&self) -> &'static str {
        "splats"
    }

    fn version(&self) -> u32 {
        2
    }

    fn inputs(&self) -> &'static [&'static str] {
        &[HANDOFF, RIG_REFINED, TRAJECTORY, KEYFRAMES, DEPTH, MASKS]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[SPLATS]
    }

    fn settings(&self) -> Value {
        match self.device.setting() {
            Value::Null => json!({ "config": self.config() }),
            device => json!({ "config": self.config(), "device": device }),
        }
    }

    fn run(&self, work: &Work<'_, Input>) -> Result<(), StageError> {
        let config = self.config();
        let rig = outputs::rig::read(&work.read(RIG_REFINED)?)?;
        let trajectory = outputs::trajectory::read(&work.read(TRAJECTORY)?)?;
        let (depth, masks) = (work.read(DEPTH)?, work.read(MASKS)?);
        let keyframes = outputs::keyframes::read(&work.read(KEYFRAMES)?)?;
        let index = outputs::depth::read_index(&depth)?;
        let cameras = keyframes::choose(&rig, &keyframes, work.source().index(), &config)?;
        let names = Names {
            preset: self.preset.name(),
            exposure_model: exposure_model(&cameras),
        };
        check_memory(&cameras, &config, self.memory_bytes)?;
        let inputs = Inputs {
            trajectory: &trajectory,
            depth: &depth,
            index: &index,
            masks: &masks,
            config: &config,
        };
        let all = read_views(work, &inputs, &cameras)?;
        let Some(usable) = Usable::of(work, all, &config) else {
            product::write_empty(work.draft(SPLATS), names, &config)?;
            return Ok(());
        };
        let Some(scene) = fit::start(&usable.training, &config)? else {
            work.record_loss(
                "no keyframe has depth: there is nothing at which a scene of Gaussians can start",
            );
            product::write_empty(work.draft(SPLATS), names, &config)?;
            return Ok(());
        };
        let hashes = [RIG_REFINED, TRAJECTORY, KEYFRAMES, DEPTH, MASKS]
            .map(|input| Ok(work.read(input)?.output().hash.clone()));
        let hashes: Result<Vec<String>, StageError> = hashes.into_iter().collect();
        let path = work.folder().join(SPLATS_CHECKPOINT);
        let checkpoint = CheckpointFile::new(path, &self.settings(), &hashes?);
        let steps = config.train.steps as u64;
        let mut progress = |now: fit::Progress| {
            work.progress(
                read_steps(&cameras) + now.steps as u64,
                read_steps(&cameras) + steps,
            );
            let psnr = now
                .psnr_db
                .map_or(String::new(), |db| format!(", {db:.1} dB held out"));
            work.status(&format!("{} Gaussians{psnr}", now.splats));
        };
        let views = usable.training.len();
        let (training, held_out) = (usable.training, &usable.held_out);
        let fit = fit::fit(
            scene,
            training,
            held_out,
            &config,
            &checkpoint,
            fit::On {
                device: self.device.trainer()?,
                falls_back: self.device.falls_back,
            },
            &mut progress,
        )?;
        if let Some(name) = self.device.name() {
            work.note(format!("trained on {name}"));
        }
        if let Some(reason) = &fit.fell_back {
            work.note(format!("continued on the processor: {reason}"));
        }
        note_fit(work, &fit, views, held_out.len());
        let views = Views {
            records: usable.records,
            held_out: &usable.held_out_records,
            held_out_views: held_out,
        };
        product::write_fit(work.draft(SPLATS), &fit, views, names, &config)
    }

    fn clean_up(&self, bundle: &Path) {
        // It may not exist. One that cannot be removed is discarded by the next training.
        let _ = std::fs::remove_file(bundle.join(SPLATS_CHECKPOINT));
    }
}

/// Whether exposures of all, some or no cameras are recorded.
fn exposure_model(cameras: &[CameraKeyframes<'_>]) -> &'static str {
    let known = cameras.iter().filter(|camera| camera.is_exposure_known);
    match known.count() {
        0 => "none",
        count if count == cameras.len() => "recorded",
        _ => "recorded of some cameras",
    }
}

fn check_memory(
    cameras: &[CameraKeyframes<'_>],
    config: &SplatsConfig,
    available: Option<u64>,
) -> Result<(), StageError> {
    let pixels: Vec<[u64; 2]> = cameras
        .iter()
        .flat_map(|of| {
            let size = [&of.camera.left, &of.camera.right]
                .map(|model| u64::from(model.width) * u64::from(model.height));
            std::iter::repeat_n(size, of.keyframes.len())
        })
        .collect();
    let needed = memory::needed_bytes(&pixels, config);
    match available {
        Some(available) if needed > available => Err(format!(
            "training from {} stereo images needs up to {needed} bytes of memory, found {available} \
             available: take `--preset fast`, or end at the stage before with `--to maps`",
            pixels.len()
        )
        .into()),
        _ => Ok(()),
    }
}

fn read_steps(cameras: &[CameraKeyframes<'_>]) -> u64 {
    let keyframes: usize = cameras.iter().map(|of| of.keyframes.len()).sum();
    READ_STEPS * keyframes as u64
}

/// Decodes the images of all keyframes. Frames that cannot be read are losses.
fn read_views<'a>(
    work: &Work<'_, Input>,
    inputs: &Inputs<'a>,
    cameras: &[CameraKeyframes<'a>],
) -> Result<Vec<RecordedView>, StageError> {
    let total = read_steps(cameras) + inputs.config.train.steps as u64;
    let (mut views, mut done) = (Vec::new(), 0);
    for of_camera in cameras {
        let name = &of_camera.camera.name;
        let positions: Vec<usize> = of_camera.keyframes.iter().map(|k| k.position).collect();
        let session = work.source().session();
        let frames = session.frames_where(name, |p| positions.binary_search(&p).is_ok())?;
        let maker = ViewMaker::new(inputs, of_camera);
        let mut batch: Vec<(View, ChosenKeyframe)> = Vec::new();
        let mut is_gray = false;
        for (frame, chosen) in frames.zip(&of_camera.keyframes) {
            match frame {
                Ok(frame) => {
                    is_gray |= frame.left.color == Color::Grey;
                    batch.push((frame, *chosen));
                }
                Err(loss) => work.record_loss_from(&loss),
            }
            if batch.len() == BATCH {
                views.extend(maker.views(&batch)?);
                batch.clear();
            }
            done += READ_STEPS;
            work.progress(done, total);
        }
        views.extend(maker.views(&batch)?);
        if is_gray {
            work.note(format!("camera {name} is gray: it trains gray colors"));
        }
    }
    Ok(views)
}

/// Views that can be used, those of the training apart from held-out ones.
struct Usable {
    training: Vec<TrainingView>,
    held_out: Vec<TrainingView>,
    records: Vec<scene_bundle::outputs::splats::SplatView>,
    /// Index of each held-out view among the records.
    held_out_records: Vec<usize>,
}

impl Usable {
    /// `None` where there are too few, which is then a loss, or none at all, which is a note.
    fn of(work: &Work<'_, Input>, all: Vec<RecordedView>, config: &SplatsConfig) -> Option<Self> {
        let count = all.len();
        let mut usable = Self {
            training: Vec::new(),
            held_out: Vec::new(),
            records: Vec::new(),
            held_out_records: Vec::new(),
        };
        for RecordedView {
            view,
            record,
            is_held_out,
        } in all
        {
            if view.valid_pixels() == 0 {
                continue;
            }
            match is_held_out {
                true => {
                    usable.held_out_records.push(usable.records.len());
                    usable.held_out.push(view);
                }
                false => usable.training.push(view),
            }
            usable.records.push(record);
        }
        let found = usable.records.len();
        if count == 0 {
            work.note("no keyframe: there is nothing to train from");
            return None;
        }
        if found < count {
            let masked = count - found;
            work.note(format!(
                "{masked} of {count} images are masked whole and not used"
            ));
        }
        if found < config.min_images || usable.training.is_empty() {
            work.record_loss(format!(
                "{found} of {count} images can be used to train a scene of Gaussians, expected at \
                 least {}",
                config.min_images
            ));
            return None;
        }
        Some(usable)
    }
}

fn note_fit(work: &Work<'_, Input>, fit: &fit::Fit, views: usize, held_out: usize) {
    let evaluation = &fit.report.evaluation;
    let quality = match held_out {
        0 => "no image was held out".to_owned(),
        _ => format!(
            "PSNR {:.2} dB (worst {:.2} dB) and SSIM {:.3} in {held_out} held-out images",
            evaluation.mean_psnr_db(),
            evaluation.worst_psnr_db(),
            evaluation.mean_ssim()
        ),
    };
    work.note(format!(
        "{} Gaussians, {} at the start, from {views} images; {quality}",
        fit.scene.splats.len(),
        fit.start_count
    ));
}
