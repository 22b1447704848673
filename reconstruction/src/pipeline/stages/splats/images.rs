//! Images of a sector: those that train it, and held-out ones.

use serde::{Deserialize, Serialize};
use session_input::{Color, View};
use splats::TrainingView;

use super::keyframes::{CameraKeyframes, ChosenKeyframe};
use super::views::{BATCH, Inputs, KeyframeView, ViewMaker};
use crate::input::Input;
use crate::pipeline::{StageError, Work};

/// Images of a sector that can be used.
#[derive(Default)]
pub(super) struct Images {
    pub(super) training: Vec<TrainingView>,
    pub(super) held_out: Vec<TrainingView>,
    pub(super) found: ImageSummary,
}

/// Held-out images that can be used.
pub(super) struct HeldOutImages {
    /// Numbers of the views, in order.
    pub(super) numbers: Vec<usize>,
    pub(super) views: Vec<TrainingView>,
}

/// What was found in the images of a sector.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct ImageSummary {
    /// Numbers of the views of the training, in order.
    pub(super) training: Vec<usize>,
    /// Numbers of the held-out views, in order.
    pub(super) held_out: Vec<usize>,
    /// Images of keyframes inside of the sector, and how many of them are masked whole.
    pub(super) inside: usize,
    pub(super) masked: usize,
    /// All images.
    pub(super) all: usize,
    /// Names of gray cameras.
    pub(super) gray: Vec<String>,
    /// What could not be read or used.
    pub(super) losses: Vec<String>,
}

impl Images {
    /// Decodes the images of keyframes, and of those that `is_inside` says records what was lost.
    pub(super) fn read(
        work: &Work<'_, Input>,
        inputs: &Inputs<'_>,
        cameras: &[CameraKeyframes<'_>],
        is_inside: &dyn Fn(&ChosenKeyframe) -> bool,
        progress: &mut dyn FnMut(usize),
    ) -> Result<Self, StageError> {
        let (mut images, mut done) = (Self::default(), 0);
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
                    Err(loss) if is_inside(chosen) => {
                        images.found.losses.push(scene_bundle::error_chain(&loss));
                    }
                    Err(_) => {}
                }
                if batch.len() == BATCH {
                    images.extend(maker.views(&batch)?, is_inside);
                    batch.clear();
                }
                done += 1;
                progress(done);
            }
            images.extend(maker.views(&batch)?, is_inside);
            if is_gray {
                images.found.gray.push(name.clone());
            }
        }
        Ok(images)
    }

    fn extend(&mut self, views: Vec<KeyframeView>, is_inside: &dyn Fn(&ChosenKeyframe) -> bool) {
        for KeyframeView {
            view,
            number,
            keyframe,
        } in views
        {
            let is_masked = view.valid_pixels() == 0;
            self.found.all += 1;
            if is_inside(&keyframe) {
                self.found.inside += 1;
                self.found.masked += usize::from(is_masked);
            }
            match (is_masked, keyframe.is_held_out) {
                (true, _) => {}
                (false, true) => {
                    self.found.held_out.push(number);
                    self.held_out.push(view);
                }
                (false, false) => {
                    self.found.training.push(number);
                    self.training.push(view);
                }
            }
        }
    }
}
