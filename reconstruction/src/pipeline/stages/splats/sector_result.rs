//! What the training of a sector leaves, and its file between two runs.
//!
//! Contract: what is read from a file can have been written by the training of the sector: its
//! views are of the plan, its Gaussians of the cell, and sizes and degrees of the configuration.

use serde::{Deserialize, Serialize};
use splats::{Background, Cells, Part, Plane, SplatError};

use super::checkpoint::CheckpointFile;
use super::config::SplatsConfig;
use super::images::ImageSummary;
use crate::pipeline::StageError;

/// A sector after its training.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SectorResult {
    pub(super) found: ImageSummary,
    /// At least one Gaussian; `None` where nothing could be trained or none is in the cell.
    pub(super) part: Option<Part>,
    /// Why the processor took over from the device.
    pub(super) fell_back: Option<String>,
}

/// Numbers of the views of a sector, in order, whether they can be used or not.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct SectorViews {
    pub(super) training: Vec<usize>,
    pub(super) held_out: Vec<usize>,
}

/// What a trained sector is compared with.
pub(super) struct SectorSpec<'a> {
    pub(super) sector: usize,
    pub(super) cells: &'a Cells,
    pub(super) views: &'a SectorViews,
    pub(super) config: &'a SplatsConfig,
}

/// What is text in the file of a complete sector.
#[derive(Serialize, Deserialize)]
struct Head {
    found: ImageSummary,
    has_part: bool,
    fell_back: Option<String>,
}

impl SectorResult {
    /// Whether there are enough images; a loss if there are some, but too few.
    pub(super) fn can_train(&mut self, min_images: usize) -> bool {
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

    /// Names the sector in its losses.
    pub(super) fn name_losses(&mut self, sector: usize, count: usize) {
        for loss in &mut self.found.losses {
            *loss = format!("sector {sector} of {count}: {loss}");
        }
    }

    /// Of a sector whose training is complete. What cannot be of it is discarded with a warning.
    pub(super) fn read(file: &CheckpointFile, expected: &SectorSpec<'_>) -> Option<Self> {
        let bytes = file.read_complete()?;
        let trained = Self::from_bytes(&bytes).and_then(|trained| {
            expected.check(&trained)?;
            Ok(trained)
        });
        match trained {
            Ok(trained) => Some(trained),
            Err(error) => {
                file.discarded(&error.to_string());
                None
            }
        }
    }

    /// The length of a text, the text, and the part if there is one.
    pub(super) fn to_bytes(&self) -> Result<Vec<u8>, StageError> {
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

impl SectorSpec<'_> {
    /// Compares a sector with what is expected of it.
    ///
    /// # Errors
    /// [`SplatError::Checkpoint`] with what was found.
    fn check(&self, trained: &SectorResult) -> Result<(), SplatError> {
        let ImageSummary {
            training, held_out, ..
        } = &trained.found;
        check_views("training", training, &self.views.training)?;
        check_views("held-out", held_out, &self.views.held_out)?;
        let Some(part) = &trained.part else {
            return Ok(());
        };
        if training.is_empty() || part.splats.is_empty() {
            let found = format!("{} of {} views", part.splats.len(), training.len());
            return Err(unexpected("Gaussians", found, "at least one of each"));
        }
        let sky = match &part.background {
            Background::Sky(sky) => sky.size(),
            Background::Constant(_) => 0,
        };
        let (space, config) = (part.coverage.space(), &self.config.coverage);
        let found = Sizes {
            degree: part.splats.degree(),
            sky,
            seen_sky: part.coverage.sky().size(),
            space_m: [space.voxel_m(), space.range_m()],
        };
        let expected = Sizes {
            // Trainings of one or two steps may end below it, and are repeated then.
            degree: self.config.train.degree,
            sky: self.config.sky_texels,
            seen_sky: config.sky_texels,
            space_m: [config.voxel_m, config.range_m],
        };
        if found != expected {
            return Err(unexpected(
                "sizes",
                format!("{found:?}"),
                &format!("{expected:?}"),
            ));
        }
        let [x, y, z] = [0, 1, 2].map(|k| &part.splats.planes()[Plane::POSITION + k]);
        for ((x, y), z) in x.iter().zip(y).zip(z) {
            let mean = [x, y, z].map(|v| f64::from(*v));
            // Finite: others are no Gaussians.
            if self.cells.cell_of(mean) != self.sector {
                let found = format!("{mean:?} m");
                return Err(unexpected("mean of a Gaussian", found, "one in its cell"));
            }
        }
        Ok(())
    }
}

/// What all sectors have in common.
#[derive(Debug, PartialEq)]
struct Sizes {
    degree: usize,
    /// Texels along an edge, of the background and of the sky that was seen.
    sky: usize,
    seen_sky: usize,
    /// Edge of a voxel and length of rays.
    space_m: [f32; 2],
}

/// Compares numbers of views with those that a sector has.
fn check_views(what: &str, found: &[usize], all: &[usize]) -> Result<(), SplatError> {
    let is_of = |number: &usize| all.binary_search(number).is_ok();
    if found.iter().all(is_of) && found.is_sorted_by(|a, b| a < b) {
        return Ok(());
    }
    Err(unexpected(
        &format!("{what} views"),
        format!("{found:?}"),
        &format!("some of {all:?} in this order"),
    ))
}

fn unexpected(what: &str, found: String, expected: &str) -> SplatError {
    SplatError::Checkpoint {
        reason: format!("{what}: found {found}, expected {expected}"),
    }
}

#[cfg(test)]
mod tests;
