//! The training of one sector after the other.
//!
//! Contract: a sector depends on its own images alone. One whose training is complete is kept in
//! its file until the output is committed, and not trained again by a run with the same settings
//! and inputs.

use splats::{CellBox, Cells, Part, TrainingView};

use super::checkpoint::{CheckpointFile, CheckpointFiles};
use super::config::SplatsConfig;
use super::fit::{self, On};
use super::images::Images;
use super::sector_result::{SectorResult, SectorSpec, SectorViews};
use crate::pipeline::StageError;

/// What the trainings of all sectors share.
pub(super) struct Sectors<'a> {
    pub(super) cells: &'a Cells,
    pub(super) config: &'a SplatsConfig,
    pub(super) checkpoints: &'a CheckpointFiles,
    /// Views of each sector.
    pub(super) views: &'a [SectorViews],
}

impl Sectors<'_> {
    /// Trains all sectors, or takes them from their files. `read` gives the images of a sector,
    /// `on` what runs the steps. Gives also the held-out images if there is one sector and it was
    /// trained now.
    ///
    /// # Errors
    /// Those of the images and of the training.
    pub(super) fn train(
        &self,
        read: &mut dyn FnMut(usize) -> Result<Images, StageError>,
        on: &mut dyn FnMut() -> Result<On, StageError>,
        progress: &mut dyn FnMut(usize, fit::Progress),
    ) -> Result<(Vec<SectorResult>, Option<Vec<TrainingView>>), StageError> {
        let count = self.cells.count();
        let (mut all, mut held_out) = (Vec::with_capacity(count), None);
        for sector in 0..count {
            let file = self.checkpoints.of(sector, self.cells);
            let expected = SectorSpec {
                sector,
                cells: self.cells,
                views: &self.views[sector],
                config: self.config,
            };
            if let Some(complete) = SectorResult::read(&file, &expected) {
                all.push(complete);
                continue;
            }
            let images = read(sector)?;
            let mut trained = SectorResult {
                found: images.found,
                part: None,
                fell_back: None,
            };
            if trained.can_train(self.min_images()) {
                let of_images = (images.training, images.held_out.as_slice());
                let mut progress = |now| progress(sector, now);
                self.train_one(
                    sector,
                    &mut trained,
                    of_images,
                    (&file, on()?),
                    &mut progress,
                )?;
            }
            if count > 1 {
                trained.name_losses(sector, count);
            }
            file.write_complete(&trained.to_bytes()?);
            all.push(trained);
            held_out = (count == 1).then_some(images.held_out);
        }
        Ok((all, held_out))
    }

    /// The loss of a sector that was trained for nothing.
    fn no_gaussian(&self, sector: usize) -> String {
        let CellBox { min_m, max_m } = self.cells.bounds(sector);
        format!(
            "no Gaussian of its training is in its cell, x from {:.2} to {:.2} m and y from {:.2} \
             to {:.2} m",
            min_m[0], max_m[0], min_m[1], max_m[1]
        )
    }

    fn min_images(&self) -> usize {
        let SplatsConfig {
            min_images,
            sectors,
            ..
        } = self.config;
        match self.cells.count() {
            1 => *min_images,
            _ => sectors.views.div_ceil(2).min(*min_images),
        }
    }

    fn train_one(
        &self,
        sector: usize,
        trained: &mut SectorResult,
        (training, held_out): (Vec<TrainingView>, &[TrainingView]),
        (file, on): (&CheckpointFile, On),
        progress: &mut dyn FnMut(fit::Progress),
    ) -> Result<(), StageError> {
        let Some(scene) = fit::start(&training, self.config)? else {
            let loss =
                "no keyframe has depth: there is nothing at which a scene of Gaussians can start";
            trained.found.losses.push(loss.to_owned());
            return Ok(());
        };
        let fit = fit::fit(scene, training, held_out, self.config, file, on, progress)?;
        let start = (fit.start_count, fit.checks);
        let is_inside = |mean| self.cells.cell_of(mean) == sector;
        let part = Part::cut(&fit.scene, &fit.coverage, start, is_inside);
        match part.splats.is_empty() {
            true => trained.found.losses.push(self.no_gaussian(sector)),
            false => trained.part = Some(part),
        }
        trained.fell_back = fit.fell_back;
        Ok(())
    }
}

#[cfg(test)]
mod tests;
