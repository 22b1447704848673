//! Stage `depth`: depth of keyframes.
//!
//! Contract: keyframes are frames of each stereo camera, spaced by motion ([`keyframe_selection`]),
//! each with its pose at its own time. Each readable one has depth with a sigma ([`stereo_pair`]);
//! too distant surfaces have none. A frame that cannot be read, and a camera whose pair cannot be
//! rectified, are losses and have no keyframe. Images are decoded a few at a time, one camera after
//! the other; memory grows with the session only by one entry per keyframe.

use std::collections::BTreeMap;

use scene_bundle::outputs::depth::{DepthKey, DepthView, DepthWriter};
use scene_bundle::outputs::{self, DEPTH, KEYFRAMES, RIG_REFINED, TRAJECTORY};
use serde_json::{Value, json};
use session_input::ReadError;

use self::config::DepthStageConfig;
use self::stereo_pair::StereoPair;
use super::networks::Networks;
use super::preset::Preset;
use crate::input::{HANDOFF, Input};
use crate::pipeline::{Stage, StageError, Work};

mod config;
mod keyframe_selection;
mod stereo_pair;

/// See the module.
pub(super) struct DepthStage {
    pub(super) preset: Preset,
    pub(super) networks: Networks,
}

impl Stage<Input> for DepthStage {
    fn name(&self) -> &'static str {
        "depth"
    }

    fn version(&self) -> u32 {
        4
    }

    fn inputs(&self) -> &'static [&'static str] {
        &[HANDOFF, RIG_REFINED, TRAJECTORY]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[KEYFRAMES, DEPTH]
    }

    fn settings(&self) -> Value {
        json!({
            "config": DepthStageConfig::preset(self.preset),
            "network": self.networks.stereo_hash(),
        })
    }

    fn run(&self, work: &Work<'_, Input>) -> Result<(), StageError> {
        let config = DepthStageConfig::preset(self.preset);
        let rig = outputs::rig::read(&work.read(RIG_REFINED)?)?;
        let trajectory = outputs::trajectory::read(&work.read(TRAJECTORY)?)?;
        let input = work.source();
        let (mut pairs, mut views, mut chosen) = (Vec::new(), Vec::new(), Vec::new());
        for (place, camera) in rig.cameras.iter().enumerate() {
            match StereoPair::new(camera, &config) {
                Ok(pair) => {
                    views.push(DepthView {
                        camera: camera.name.clone(),
                        model: pair.model(),
                        view_from_left: pair.view_from_left(),
                    });
                    let of_camera = |c: &scene_bundle::outputs::rig::RigCamera| c.name.clone();
                    let index = input.index();
                    let number = index.cameras.iter().position(|c| c.name == camera.name);
                    let number = number.ok_or_else(|| ReadError::NoSuch(of_camera(camera)))?;
                    chosen.push(keyframe_selection::keyframes(
                        index,
                        number,
                        (place, camera),
                        &trajectory,
                        config.keyframes,
                    ));
                    pairs.push((camera, pair));
                }
                Err(error) => work.record_loss(format!(
                    "camera {}: {}",
                    camera.name,
                    scene_bundle::error_chain(&*error)
                )),
            }
        }
        let writer = DepthWriter::new(work.draft(DEPTH), views)?;
        let all: usize = chosen.iter().map(BTreeMap::len).sum();
        let (mut done, mut keyframes, mut share) = (0, Vec::new(), 0.0);
        for (view, ((camera, mut pair), chosen)) in pairs.into_iter().zip(chosen).enumerate() {
            let frames = input
                .session()
                .luma_frames_where(&camera.name, |p| chosen.contains_key(&p))?;
            for (frame, keyframe) in frames.zip(chosen.values()) {
                match frame {
                    Ok(frame) => {
                        let image =
                            pair.depth(&frame.left.data, &frame.right.data, &self.networks)?;
                        share += image.depth.iter().filter(|d| **d > 0).count() as f64
                            / image.depth.len().max(1) as f64;
                        let key = DepthKey {
                            view,
                            time_ns: keyframe.time_ns,
                            frame: keyframe.frame,
                            set: keyframe.set,
                        };
                        writer.write(key, &image)?;
                        keyframes.push(*keyframe);
                    }
                    Err(loss) => work.record_loss_from(&loss),
                }
                done += 1;
                work.progress(done, all as u64);
            }
        }
        writer.finish()?;
        outputs::keyframes::write(work.draft(KEYFRAMES), &keyframes)?;
        work.note(format!(
            "{} keyframes, {:.0} % of their pixels have depth",
            keyframes.len(),
            100.0 * share / keyframes.len().max(1) as f64
        ));
        Ok(())
    }
}
