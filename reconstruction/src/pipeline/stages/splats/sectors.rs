//! The training of one sector after the other.
//!
//! Contract: a sector depends on its own images alone. One whose training is complete is kept in
//! its file until the output is committed, and not trained again by a run with the same settings
//! and inputs.

use serde::{Deserialize, Serialize};
use splats::{CellBox, Cells, Part, SplatError, TrainingView};

use super::checkpoint::{CheckpointFile, CheckpointFiles};
use super::config::SplatsConfig;
use super::fit::{self, On};
use super::images::{Found, Images};
use crate::pipeline::StageError;

/// What the trainings of all sectors share.
pub(super) struct Sectors<'a> {
    pub(super) cells: &'a Cells,
    pub(super) config: &'a SplatsConfig,
    pub(super) checkpoints: &'a CheckpointFiles,
}

/// A sector after its training.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TrainedSector {
    pub(super) found: Found,
    /// At least one Gaussian; `None` where nothing could be trained or none is in the cell.
    pub(super) part: Option<Part>,
    /// Why the processor took over from the device.
    pub(super) fell_back: Option<String>,
}

/// What is text in the file of a complete sector.
#[derive(Serialize, Deserialize)]
struct Head {
    found: Found,
    has_part: bool,
    fell_back: Option<String>,
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
    ) -> Result<(Vec<TrainedSector>, Option<Vec<TrainingView>>), StageError> {
        let count = self.cells.count();
        let (mut all, mut held_out) = (Vec::with_capacity(count), None);
        for sector in 0..count {
            let file = self.checkpoints.of(sector, self.cells);
            if let Some(complete) = TrainedSector::read(&file) {
                all.push(complete);
                continue;
            }
            let images = read(sector)?;
            let mut trained = TrainedSector {
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
        trained: &mut TrainedSector,
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

impl TrainedSector {
    /// Whether there are enough images; a loss if there are some, but too few.
    fn can_train(&mut self, min_images: usize) -> bool {
        let usable = self.found.training.len() + self.found.held_out.len();
        if usable >= min_images && !self.found.training.is_empty() {
            return true;
        }
        if self.found.all > 0 {
            self.found.losses.push(format!(
                "{usable} of {} images can be used to train a scene of Gaussians, expected at \
                 least {min_images}",
                self.found.all
            ));
        }
        false
    }

    fn name_losses(&mut self, sector: usize, count: usize) {
        for loss in &mut self.found.losses {
            *loss = format!("sector {sector} of {count}: {loss}");
        }
    }

    /// Of a sector whose training is complete.
    fn read(file: &CheckpointFile) -> Option<Self> {
        let bytes = file.read_complete()?;
        match Self::from_bytes(&bytes) {
            Ok(trained) => Some(trained),
            Err(error) => {
                file.discarded(&error.to_string());
                None
            }
        }
    }

    /// The length of a text, the text, and the part if there is one.
    fn to_bytes(&self) -> Result<Vec<u8>, StageError> {
        let head = serde_json::to_vec(&Head {
            found: self.found.clone(),
            has_part: self.part.is_some(),
            fell_back: self.fell_back.clone(),
        })?;
        let mut bytes = (head.len() as u64).to_le_bytes().to_vec();
        bytes.extend(head);
        if let Some(part) = &self.part {
            bytes.extend(part.to_bytes()?);
        }
        Ok(bytes)
    }

    fn from_bytes(bytes: &[u8]) -> Result<Self, StageError> {
        let broken = || SplatError::Checkpoint {
            reason: "it ends early".to_owned(),
        };
        let (length, rest) = bytes.split_first_chunk().ok_or_else(broken)?;
        let length = usize::try_from(u64::from_le_bytes(*length)).unwrap_or(usize::MAX);
        let (head, part) = rest.split_at_checked(length).ok_or_else(broken)?;
        let head: Head = serde_json::from_slice(head)?;
        Ok(Self {
            found: head.found,
            part: match head.has_part {
                true => Some(Part::from_bytes(part)?),
                false => None,
            },
            fell_back: head.fell_back,
        })
    }
}

#[cfg(test)]
mod tests;
