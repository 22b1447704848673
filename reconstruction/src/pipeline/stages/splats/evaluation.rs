//! Held-out images compared with the scene as it is stored: a sector with what is around it.

use camera_models::Eye;
use scene_bundle::outputs::splats::SplatView;
use splats::{Background, Cells, Evaluation, Plane, Renderer, Scene, SplatError, Splats};

use super::comparison::{self, Comparison};
use super::config::SplatsConfig;
use super::images::HeldOutImages;
use super::output_sectors::{OutputSector, SectorBox};
use super::sector_result::SectorResult;
use crate::pipeline::StageError;
use crate::pipeline::stages::networks::Networks;

/// Quality in the held-out images of all sectors.
#[derive(Debug, Default)]
pub(super) struct HeldOutResult {
    /// Numbers of the views, sector by sector.
    pub(super) views: Vec<usize>,
    /// Of these views. The error of depth of several sectors is the mean of theirs, weighted by
    /// their numbers of views.
    pub(super) evaluation: Evaluation,
    /// LPIPS of these views; empty without a network for it.
    pub(super) lpips: Vec<f64>,
    /// Some of them beside the recorded images.
    pub(super) comparisons: Vec<Comparison>,
}

/// Trained sectors before their common background.
pub(super) struct Whole<'a> {
    pub(super) cells: &'a Cells,
    pub(super) sectors: &'a [SectorResult],
    /// Those with Gaussians.
    pub(super) kept: &'a [OutputSector<'a>],
    pub(super) background: &'a Background,
    pub(super) config: &'a SplatsConfig,
    pub(super) networks: &'a Networks,
}

impl Whole<'_> {
    /// Compares the held-out images of all sectors. `read` gives those of a sector, `record` what
    /// the bundle records of a view.
    ///
    /// # Errors
    /// Those of the images, also if they are not those of the training; [`SplatError`].
    pub(super) fn evaluate(
        &self,
        read: &mut dyn FnMut(usize) -> Result<HeldOutImages, StageError>,
        record: &dyn Fn(usize) -> SplatView,
    ) -> Result<HeldOutResult, StageError> {
        let renderer = Renderer::new(self.config.render)?;
        let mut result = HeldOutResult::default();
        let mut comparisons = Vec::new();
        let (mut depth_errors, mut known_depth_errors) = (Vec::new(), Vec::new());
        for (sector, trained) in self.sectors.iter().enumerate() {
            let numbers = &trained.found.held_out;
            if numbers.is_empty() {
                continue;
            }
            let images = read(sector)?;
            check_numbers(numbers, &images.numbers, record)?;
            let views = images.views;
            let scene = self.scene_around(sector)?;
            let of_sector = Evaluation::new(&renderer, &scene, &views);
            let records: Vec<SplatView> = numbers.iter().map(|number| record(*number)).collect();
            for k in comparison::medians(&records, &of_sector.psnr_db) {
                comparisons.push(Comparison {
                    view: numbers[k],
                    camera: records[k].camera.clone(),
                    psnr_db: of_sector.psnr_db[k],
                    png: comparison::png(&renderer, &scene, &views[k])?,
                });
            }
            if self.networks.has_lpips() {
                for view in &views {
                    let lpips = comparison::lpips(self.networks, &renderer, &scene, view)?;
                    result.lpips.extend(lpips);
                }
            }
            let weight = views.len() as f64;
            depth_errors.push([of_sector.depth_error, weight]);
            known_depth_errors.push([of_sector.known_depth_error, weight]);
            result.views.extend(numbers);
            result.evaluation.psnr_db.extend(of_sector.psnr_db);
            result.evaluation.ssim.extend(of_sector.ssim);
        }
        result.evaluation.depth_error = weighted_mean(&depth_errors);
        result.evaluation.known_depth_error = weighted_mean(&known_depth_errors);
        result.comparisons = comparison::of_each_camera(comparisons);
        Ok(result)
    }

    /// What is drawn of the stored scene in a sector: all Gaussians up to a distance of its box, as
    /// the simulation shows them. A cell without Gaussians has no box: that distance of the cell.
    fn scene_around(&self, cell: usize) -> Result<Scene, SplatError> {
        let (Some(first), Some(all)) = (self.kept.first(), SectorBox::around(self.kept)) else {
            return Ok(Scene {
                splats: Splats::empty(0)?,
                background: self.background.clone(),
            });
        };
        let own = self.kept.iter().find(|of| of.cell == cell);
        let bounds = own.map_or_else(|| all.above(self.cells.bounds(cell)), |of| of.bounds);
        let reach = bounds.widened(self.config.sectors.view_reach_m);
        let degree = first.part.splats.degree();
        let mut planes = vec![Vec::new(); Plane::count(degree)];
        for OutputSector { part, .. } in self.kept {
            let near = reach.indices(&part.splats);
            for (plane, of_part) in planes.iter_mut().zip(part.splats.planes()) {
                plane.extend(near.iter().map(|index| of_part[*index]));
            }
        }
        Ok(Scene {
            splats: Splats::from_planes(degree, planes)?,
            background: self.background.clone(),
        })
    }
}

/// Compares numbers of held-out images, in order, with those of the training: images are read
/// again, and a session may have changed in between.
fn check_numbers(
    expected: &[usize],
    found: &[usize],
    record: &dyn Fn(usize) -> SplatView,
) -> Result<(), StageError> {
    let same = expected.iter().zip(found).take_while(|(a, b)| a == b);
    let first = same.count();
    let (number, found, expected) = match (expected.get(first), found.get(first)) {
        (None, None) => return Ok(()),
        (Some(of), Some(other)) if other < of => (*other, "an image", "none"),
        (Some(of), _) => (*of, "none that can be used", "an image"),
        (None, Some(other)) => (*other, "an image", "none"),
    };
    let SplatView {
        camera, eye, frame, ..
    } = record(number);
    let eye = match eye {
        Eye::Left => "left",
        Eye::Right => "right",
    };
    Err(format!(
        "held-out {eye} image of camera {camera}, frame {frame}: found {found} after the training, \
         expected {expected} as at its start"
    )
    .into())
}

/// Mean of those of some values that are known, by weights; that of one value keeps its bits.
fn weighted_mean(values: &[[f64; 2]]) -> f64 {
    let known: Vec<&[f64; 2]> = values
        .iter()
        .filter(|[value, _]| value.is_finite())
        .collect();
    if let [[value, _]] = known[..] {
        return *value;
    }
    let weights: f64 = known.iter().map(|[_, weight]| weight).sum();
    let sum: f64 = known.iter().map(|[value, weight]| value * weight).sum();
    sum / weights
}

#[cfg(test)]
mod tests;
