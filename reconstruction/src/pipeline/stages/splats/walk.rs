//! The walk of a session as the training reads it: sector by sector.

use camera_models::Eye;
use scene_bundle::outputs::splats::SplatView;
use splats::Cells;

use super::fit;
use super::images::{HeldOutImages, Images};
use super::keyframes::{CameraKeyframes, ChosenKeyframe};
use super::plan::Plan;
use super::sector_result::SectorViews;
use super::views::{Inputs, ViewMaker, view_number};
use crate::input::Input;
use crate::pipeline::{StageError, Work};

/// Share of the progress for reading an image, against the steps of the training.
const READ_STEPS: u64 = 5;

/// Keyframes of a walk in sectors.
pub(super) struct Walk<'a> {
    work: &'a Work<'a, Input>,
    inputs: &'a Inputs<'a>,
    plan: Plan,
    /// Keyframes of each sector, by camera.
    sectors: Vec<Vec<CameraKeyframes<'a>>>,
    makers: Vec<ViewMaker<'a>>,
    /// Of each keyframe its camera, by number.
    keyframes: Vec<(usize, ChosenKeyframe)>,
}

impl<'a> Walk<'a> {
    /// Divides keyframes into sectors.
    pub(super) fn new(
        work: &'a Work<'a, Input>,
        inputs: &'a Inputs<'a>,
        cameras: &[CameraKeyframes<'a>],
    ) -> Result<Self, StageError> {
        let plan = Plan::new(inputs, cameras)?;
        let sectors = (0..plan.len()).map(|sector| plan.keyframes(sector, cameras));
        let of_cameras = cameras.iter().enumerate();
        Ok(Self {
            work,
            inputs,
            sectors: sectors.collect(),
            plan,
            makers: cameras
                .iter()
                .map(|of| ViewMaker::new(inputs, of))
                .collect(),
            keyframes: of_cameras
                .flat_map(|(camera, of)| of.keyframes.iter().map(move |k| (camera, *k)))
                .collect(),
        })
    }

    /// Cells of the sectors.
    pub(super) fn cells(&self) -> &Cells {
        &self.plan.cells
    }

    /// Views of each sector.
    pub(super) fn views(&self) -> Vec<SectorViews> {
        let of_sector = |cameras: &Vec<CameraKeyframes<'_>>| {
            let mut views = SectorViews::default();
            for chosen in cameras.iter().flat_map(|of| &of.keyframes) {
                let numbers = match chosen.is_held_out {
                    true => &mut views.held_out,
                    false => &mut views.training,
                };
                numbers.push(view_number(chosen, Eye::Left));
                if self.inputs.config.right_images {
                    numbers.push(view_number(chosen, Eye::Right));
                }
            }
            views
        };
        self.sectors.iter().map(of_sector).collect()
    }

    /// Pixels of the left and right image of some keyframes of each sector.
    pub(super) fn image_sizes(&self, of: impl Fn(&ChosenKeyframe) -> bool) -> Vec<Vec<[u64; 2]>> {
        let sizes = |cameras: &Vec<CameraKeyframes<'_>>| {
            let of_camera = |all: &CameraKeyframes<'_>| {
                let size = [&all.camera.left, &all.camera.right]
                    .map(|model| u64::from(model.width) * u64::from(model.height));
                let count = all.keyframes.iter().filter(|keyframe| of(keyframe)).count();
                std::iter::repeat_n(size, count)
            };
            cameras.iter().flat_map(of_camera).collect()
        };
        self.sectors.iter().map(sizes).collect()
    }

    /// Decodes the images of a sector.
    ///
    /// # Errors
    /// Those of the session and of the inputs. Frames that cannot be read are losses.
    pub(super) fn images(&self, sector: usize) -> Result<Images, StageError> {
        let is_inside = |chosen: &ChosenKeyframe| self.plan.is_inside(sector, chosen.number);
        let cameras = &self.sectors[sector];
        Images::read(self.work, self.inputs, cameras, &is_inside, &mut |done| {
            let done = self.before(sector) + READ_STEPS * done as u64;
            self.work.progress(done, self.before(self.plan.len()));
        })
    }

    /// Decodes the held-out images of a sector once more.
    ///
    /// # Errors
    /// As [`Self::images`].
    pub(super) fn held_out(&self, sector: usize) -> Result<HeldOutImages, StageError> {
        let cameras = self.sectors[sector].iter();
        let cameras: Vec<_> = cameras.map(|of| of.of(|k| k.is_held_out)).collect();
        let images = Images::read(self.work, self.inputs, &cameras, &|_| false, &mut |_| {})?;
        Ok(HeldOutImages {
            numbers: images.found.held_out,
            views: images.held_out,
        })
    }

    /// Shows the progress of the training of a sector.
    pub(super) fn progress(&self, sector: usize, now: fit::Progress) {
        let read = READ_STEPS * keyframes(&self.sectors[sector]);
        let done = self.before(sector) + read + now.steps as u64;
        self.work.progress(done, self.before(self.plan.len()));
        let psnr = now
            .psnr_db
            .map_or(String::new(), |db| format!(", {db:.1} dB held out"));
        let of = match self.plan.len() {
            1 => String::new(),
            count => format!("sector {sector} of {count}: "),
        };
        self.work
            .status(&format!("{of}{} Gaussians{psnr}", now.splats));
    }

    /// Progress before a sector.
    fn before(&self, sector: usize) -> u64 {
        let steps = self.inputs.config.train.steps as u64;
        let of = |cameras: &Vec<CameraKeyframes<'_>>| steps + READ_STEPS * keyframes(cameras);
        self.sectors[..sector].iter().map(of).sum()
    }

    /// What the bundle records of a view by its number, as if it trained the scene.
    pub(super) fn record(&self, view: usize) -> SplatView {
        let (camera, chosen) = &self.keyframes[view / 2];
        let eye = match view % 2 {
            0 => Eye::Left,
            _ => Eye::Right,
        };
        self.makers[*camera].record(eye, chosen)
    }
}

fn keyframes(cameras: &[CameraKeyframes<'_>]) -> u64 {
    let counts = cameras.iter().map(|of| of.keyframes.len());
    counts.sum::<usize>() as u64
}
