//! Keyframes of the training, by camera: which of them are held out, and how they were exposed.

use std::collections::BTreeSet;

use scene_bundle::outputs::keyframes::Keyframe;
use scene_bundle::outputs::rig::{RigCamera, RigModel};
use session_archive::index::Index;
use session_input::ReadError;

use super::config::SplatsConfig;

/// Keyframes of one camera, in order of time.
pub(super) struct CameraKeyframes<'a> {
    pub(super) camera: &'a RigCamera,
    pub(super) keyframes: Vec<ChosenKeyframe>,
    /// Whether the exposure of all of them is recorded.
    pub(super) is_exposure_known: bool,
}

impl CameraKeyframes<'_> {
    /// The same with some of the keyframes.
    pub(super) fn of(&self, keep: impl Fn(&ChosenKeyframe) -> bool) -> Self {
        Self {
            camera: self.camera,
            keyframes: self.keyframes.iter().filter(|k| keep(k)).copied().collect(),
            is_exposure_known: self.is_exposure_known,
        }
    }
}

/// A keyframe in the training.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChosenKeyframe {
    /// Number among those of all cameras, one camera after the other.
    pub(super) number: usize,
    pub(super) keyframe: Keyframe,
    /// Position in the camera's index.
    pub(super) position: usize,
    /// Number of its instant, from 0.
    pub(super) instant: u32,
    pub(super) is_held_out: bool,
    /// Factor on the values of its images against the median exposure of all cameras.
    pub(super) gain: f32,
}

/// Chooses keyframes that the session has images of.
pub(super) fn choose<'a>(
    rig: &'a RigModel,
    keyframes: &[Keyframe],
    index: &Index,
    config: &SplatsConfig,
) -> Result<Vec<CameraKeyframes<'a>>, ReadError> {
    let sets: BTreeSet<u64> = keyframes.iter().map(|keyframe| keyframe.set).collect();
    let sets: Vec<u64> = sets.into_iter().collect();
    let mut cameras = Vec::new();
    let mut known_exposures: Vec<Vec<u32>> = Vec::new();
    let mut number = 0;
    for (of, camera) in rig.cameras.iter().enumerate() {
        let of_camera = keyframes.iter().filter(|k| usize::from(k.camera) == of);
        let entries = index.camera(&camera.name);
        let entries = entries.ok_or_else(|| ReadError::NoSuch(camera.name.clone()))?;
        let mut chosen = Vec::new();
        let mut exposures = Vec::new();
        for keyframe in of_camera {
            let Some(position) = entries.position(keyframe.frame) else {
                continue;
            };
            let instant = sets.partition_point(|set| *set < keyframe.set);
            let interval = config.held_out_interval.max(1);
            chosen.push(ChosenKeyframe {
                number,
                keyframe: *keyframe,
                position,
                instant: instant as u32,
                is_held_out: instant % interval == config.held_out_offset % interval,
                gain: 1.0,
            });
            number += 1;
            exposures.push(entries.frames[position].exposure_ns);
        }
        let known: Option<Vec<u32>> = exposures.into_iter().collect();
        let known = known.filter(|known| !known.is_empty() && known.iter().all(|ns| *ns > 0));
        known_exposures.push(known.clone().unwrap_or_default());
        cameras.push(CameraKeyframes {
            camera,
            keyframes: chosen,
            is_exposure_known: known.is_some(),
        });
    }
    set_gains(&mut cameras, &known_exposures, config.gamma);
    Ok(cameras)
}

/// Gains from exposure times, ns, by camera and keyframe; empty for a camera that records none. The
/// reference is the same for all cameras: they see the same surfaces.
fn set_gains(cameras: &mut [CameraKeyframes<'_>], exposures: &[Vec<u32>], gamma: f64) {
    let mut sorted: Vec<u32> = exposures.concat();
    sorted.sort_unstable();
    let Some(median) = sorted.get(sorted.len() / 2) else {
        return;
    };
    for (camera, exposures) in cameras.iter_mut().zip(exposures) {
        for (chosen, ns) in camera.keyframes.iter_mut().zip(exposures) {
            let ratio = f64::from(*ns) / f64::from(*median);
            chosen.gain = libm::pow(ratio, 1.0 / gamma) as f32;
        }
    }
}
