//! Stage `splats`: the scene as 3D Gaussians, trained from images of keyframes.
//!
//! Contract: images are those of the session at the poses of the keyframes, without rectification,
//! each row of a rolling shutter at its own time. Pixels that masks exclude train nothing. The
//! scene starts at the depths of the keyframes; held-out instants decide how many Gaussians it has,
//! and neither their images nor their depths train it. A long walk is divided into sectors, which
//! are trained one after the other from the images in and around each; a Gaussian belongs to the
//! sector in whose cell its mean is. Same input, settings and seed, same bytes on any number of
//! threads, also after a kill: every 500 steps the state is kept beside the bundle's outputs, and
//! a run with the same settings and inputs continues it.
//!
//! Too few images, no depth and images that are masked whole are losses, with an output without
//! sectors. Too little memory is an error before the training, values that are not finite one
//! during it; the older output is kept then.

use std::collections::BTreeSet;
use std::path::Path;

use scene_bundle::layout::is_splats_checkpoint;
use scene_bundle::outputs::{self, DEPTH, KEYFRAMES, MASKS, RIG_REFINED, SPLATS, TRAJECTORY};
use serde_json::{Value, json};
use splats::{Part, merged_background};

pub use self::config::SplatsConfig;
pub use self::fit::start;
pub use self::recorded_depth::{DepthOfPixels, RecordedDepth};

use self::checkpoint::CheckpointFiles;
use self::evaluation::{HeldOutResult, Whole};
use self::fit::On;
use self::images::HeldOutImages;
use self::keyframes::CameraKeyframes;
use self::output_sectors::output_sectors;
use self::product::Names;
use self::sector_result::SectorResult;
use self::sectors::Sectors;
use self::views::Inputs;
use self::walk::Walk;
use super::device::Device;
use super::networks::Networks;
use super::preset::Preset;
use crate::input::{HANDOFF, Input};
use crate::pipeline::{Stage, StageError, Work};

mod checkpoint;
mod comparison;
mod config;
mod evaluation;
mod fit;
mod images;
mod keyframes;
mod masks;
mod memory;
mod output_sectors;
mod plan;
mod product;
mod recorded_depth;
mod sector_result;
mod sectors;
#[cfg(test)]
mod tests;
mod views;
mod walk;

/// See the module.
pub(super) struct SplatsStage {
    pub(super) preset: Preset,
    /// Number of steps in place of the preset's.
    pub(super) steps: Option<usize>,
    /// Most views inside of a sector in place of the configuration's.
    pub(super) sector_views: Option<usize>,
    /// Where to train. Its name is a setting unless it is the processor: rounding differs.
    pub(super) device: Device,
    /// For the LPIPS of held-out images.
    pub(super) networks: Networks,
    /// Memory that may be used, bytes; not a setting, since no output depends on it.
    pub(super) memory_bytes: Option<u64>,
}

impl SplatsStage {
    fn config(&self) -> SplatsConfig {
        let mut config = SplatsConfig::preset(self.preset, self.steps);
        config.sectors.views = self.sector_views.unwrap_or(config.sectors.views);
        config
    }

    /// What the trained scene depends on. Networks only compare it with held-out images.
    fn training_settings(&self) -> Value {
        match self.device.setting() {
            Value::Null => json!({ "config": self.config() }),
            device => json!({ "config": self.config(), "device": device }),
        }
    }
}

impl Stage<Input> for SplatsStage {
    fn name(&self) -> &'static str {
        "splats"
    }

    fn version(&self) -> u32 {
        7
    }

    fn inputs(&self) -> &'static [&'static str] {
        &[HANDOFF, RIG_REFINED, TRAJECTORY, KEYFRAMES, DEPTH, MASKS]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[SPLATS]
    }

    fn settings(&self) -> Value {
        let mut settings = self.training_settings();
        if self.networks.has_lpips() {
            settings["lpips_network"] = self.networks.lpips_hash();
        }
        settings
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
        let inputs = Inputs {
            trajectory: &trajectory,
            depth: &depth,
            index: &index,
            masks: &masks,
            config: &config,
        };
        let walk = Walk::new(work, &inputs, &cameras)?;
        let [all, held_out] =
            [false, true].map(|only| walk.image_sizes(|keyframe| keyframe.is_held_out || !only));
        memory::check(&all, &held_out, &config, self.memory_bytes)?;
        let hashes = [RIG_REFINED, TRAJECTORY, KEYFRAMES, DEPTH, MASKS]
            .map(|input| Ok(work.read(input)?.output().hash.clone()));
        let hashes: Result<Vec<String>, StageError> = hashes.into_iter().collect();
        let checkpoints = CheckpointFiles {
            folder: work.folder(),
            version: self.version(),
            settings: self.training_settings(),
            inputs: hashes?,
        };
        let views = walk.views();
        let sectors = Sectors {
            cells: walk.cells(),
            config: &config,
            checkpoints: &checkpoints,
            views: &views,
        };
        let (trained, mut held_out) = sectors.train(
            &mut |sector| walk.images(sector),
            &mut || On::new(self.device.trainer(), self.device.falls_back),
            &mut |sector, now| walk.progress(sector, now),
        )?;
        note_images(work, &trained);
        let kept = output_sectors(walk.cells(), &trained);
        if kept.is_empty() {
            refuse_to_replace(work)?;
            return Ok(product::write_empty(work.draft(SPLATS), names, &config)?);
        }
        let parts: Vec<&Part> = kept.iter().map(|of| of.part).collect();
        let background = merged_background(&parts)?;
        let whole = Whole {
            cells: walk.cells(),
            sectors: &trained,
            kept: &kept,
            background: &background,
            config: &config,
            networks: &self.networks,
        };
        let record = |view| walk.record(view);
        let mut read = |sector: usize| match held_out.take() {
            Some(views) => Ok(HeldOutImages {
                numbers: trained[sector].found.held_out.clone(),
                views,
            }),
            None => walk.held_out(sector),
        };
        let result = whole.evaluate(&mut read, &record)?;
        if let Some(name) = self.device.name() {
            work.note(format!("trained on {name}"));
        }
        note_result(work, &whole, &result);
        product::write_sectors(work.draft(SPLATS), &whole, &result, &record, names)
    }

    fn clean_up(&self, bundle: &Path) {
        let names = std::fs::read_dir(bundle).into_iter().flatten().flatten();
        let files =
            names.filter(|entry| is_splats_checkpoint(&entry.file_name().to_string_lossy()));
        for file in files {
            // One that cannot be removed is discarded by the next training.
            let _ = std::fs::remove_file(file.path());
        }
    }
}

/// A scene of an earlier run is not replaced by one without Gaussians.
fn refuse_to_replace(work: &Work<'_, Input>) -> Result<(), StageError> {
    let earlier = work.earlier(SPLATS);
    let earlier = earlier.and_then(|reader| outputs::splats::read(&reader).ok());
    match earlier.map_or(0, |scene| scene.count()) {
        0 => Ok(()),
        count => {
            let losses = work.findings().losses();
            Err(format!(
                "no scene of Gaussians can be trained ({}), and the one of before, of {count} \
                 Gaussians, is kept",
                losses.join("; ")
            )
            .into())
        }
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

/// Notes and losses of the images, as if they had been read together.
fn note_images(work: &Work<'_, Input>, sectors: &[SectorResult]) {
    let found = || sectors.iter().map(|of| &of.found);
    let mut gray: Vec<&String> = Vec::new();
    for name in found().flat_map(|of| &of.gray) {
        if !gray.contains(&name) {
            work.note(format!("camera {name} is gray: it trains gray colors"));
            gray.push(name);
        }
    }
    let [count, masked] = [
        found().map(|of| of.inside).sum::<usize>(),
        found().map(|of| of.masked).sum(),
    ];
    if count == 0 {
        work.note("no keyframe: there is nothing to train from");
    }
    if masked > 0 {
        work.note(format!(
            "{masked} of {count} images are masked whole and not used"
        ));
    }
    for loss in found().flat_map(|of| &of.losses) {
        work.record_loss(loss);
    }
}

fn note_result(work: &Work<'_, Input>, whole: &Whole<'_>, result: &HeldOutResult) {
    let reasons: BTreeSet<&String> = whole
        .sectors
        .iter()
        .filter_map(|of| of.fell_back.as_ref())
        .collect();
    for reason in reasons {
        work.note(format!("continued on the processor: {reason}"));
    }
    let evaluation = &result.evaluation;
    let quality = match result.views.len() {
        0 => "no image was held out".to_owned(),
        count => {
            let [psnr_db, worst_db] = [evaluation.mean_psnr_db(), evaluation.worst_psnr_db()];
            let ssim = evaluation.mean_ssim();
            let others = match result.lpips.len() {
                0 => format!(" and SSIM {ssim:.3}"),
                count => {
                    let lpips = result.lpips.iter().sum::<f64>() / count as f64;
                    format!(", SSIM {ssim:.3} and LPIPS {lpips:.3}")
                }
            };
            format!(
                "PSNR {psnr_db:.2} dB (worst {worst_db:.2} dB){others} in {count} held-out images"
            )
        }
    };
    let kept = whole.kept;
    let views: BTreeSet<usize> = kept
        .iter()
        .flat_map(|of| of.training.iter().copied())
        .collect();
    let divided = match (whole.sectors.len(), kept.len()) {
        (1, _) => String::new(),
        (all, count) if count < all => format!(" in {count} of {all} sectors"),
        (_, count) => format!(" in {count} sectors"),
    };
    work.note(format!(
        "{} Gaussians{divided}, {} at the start, from {} images; {quality}",
        kept.iter().map(|of| of.part.splats.len()).sum::<usize>(),
        kept.iter().map(|of| of.part.start_count).sum::<usize>(),
        views.len()
    ));
}
