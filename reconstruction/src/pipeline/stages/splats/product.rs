//! From trained sectors to the output `splats`.

use std::collections::BTreeSet;

use cad_transforms::RigidTransform;
use scene_bundle::outputs::splats::{
    HeldOut, SplatBackground, SplatCheck, SplatContent, SplatCoverage, SplatCoverageContent,
    SplatNeighbor, SplatObservation, SplatScene, SplatSector, SplatSpaceBlock, SplatTraining,
    SplatView, write,
};
use scene_bundle::{BundleError, Draft};
use splats::{Background, Coverage, GrowthCheck, ObservedSpace, Part};

use super::config::SplatsConfig;
use super::evaluation::{HeldOutResult, Whole};
use super::output_sectors::OutputSector;
use crate::pipeline::StageError;

/// Names of the settings and of the model of exposures.
#[derive(Clone, Copy, Debug)]
pub(super) struct Names {
    pub(super) preset: &'static str,
    pub(super) exposure_model: &'static str,
}

/// Writes the sectors with Gaussians. `record` gives what the bundle records of a view by its
/// number.
pub(super) fn write_sectors(
    draft: &Draft,
    whole: &Whole<'_>,
    held_out: &HeldOutResult,
    record: &dyn Fn(usize) -> SplatView,
    names: Names,
) -> Result<(), StageError> {
    let config = whole.config;
    let kept = whole.kept;
    let Some(first) = kept.first() else {
        return Ok(write_empty(draft, names, config)?);
    };
    let trained = kept.iter().flat_map(|sector| sector.training);
    let numbers: BTreeSet<usize> = trained.chain(&held_out.views).copied().collect();
    let numbers: Vec<usize> = numbers.into_iter().collect();
    let index = |number: &usize| numbers.partition_point(|other| other < number);
    let mut views: Vec<SplatView> = numbers.iter().map(|number| record(*number)).collect();
    let evaluation = &held_out.evaluation;
    let results = evaluation.psnr_db.iter().zip(&evaluation.ssim);
    for (k, (number, (psnr_db, ssim))) in held_out.views.iter().zip(results).enumerate() {
        views[index(number)].held_out = Some(HeldOut {
            psnr_db: *psnr_db,
            ssim: *ssim,
            lpips: held_out.lpips.get(k).copied(),
        });
    }
    let (background, sky) = match whole.background {
        Background::Constant(color) => (SplatBackground::Constant(*color), &[][..]),
        Background::Sky(sky) => (SplatBackground::Sky { size: sky.size() }, sky.texels()),
    };
    let parts: Vec<&Part> = kept.iter().map(|sector| sector.part).collect();
    let checks = parts.iter().flat_map(|part| &part.checks).map(check);
    let depth_error = evaluation.depth_error;
    let coverage = &first.part.coverage;
    let scene = SplatScene {
        degree: first.part.splats.degree(),
        compensated: config.render.compensate,
        background,
        sectors: sectors(kept, &index),
        views,
        training: SplatTraining {
            preset: names.preset.to_owned(),
            seed: config.seed,
            steps: config.train.steps,
            start_count: parts.iter().map(|part| part.start_count).sum(),
            exposure_model: names.exposure_model.to_owned(),
            depth_error: depth_error.is_finite().then_some(depth_error),
            checks: checks.collect(),
        },
        coverage: Some(SplatCoverage {
            voxel_m: coverage.space().voxel_m(),
            range_m: coverage.space().range_m(),
            sky_texels: coverage.sky().size(),
        }),
    };
    let comparisons = held_out.comparisons.iter();
    let comparisons: Vec<(usize, Vec<u8>)> = comparisons
        .map(|of| (index(&of.view), of.png.clone()))
        .collect();
    let content = SplatContent {
        sectors: &parts.iter().map(|p| p.splats.clone()).collect::<Vec<_>>(),
        sky,
        comparisons: &comparisons,
        coverage: Some(&seen(&parts)),
    };
    Ok(write(draft, &scene, &content)?)
}

/// Records of sectors.
fn sectors(kept: &[OutputSector<'_>], index: &dyn Fn(&usize) -> usize) -> Vec<SplatSector> {
    let neighbors = |sector: usize| -> Vec<SplatNeighbor> {
        let others = (0..kept.len()).filter(|other| *other != sector);
        let near = others.filter(|other| kept[sector].bounds.touches(&kept[*other].bounds));
        near.map(|sector| SplatNeighbor {
            sector,
            neighbor_from_sector: RigidTransform::identity(),
        })
        .collect()
    };
    let sector = |(number, of): (usize, &OutputSector<'_>)| SplatSector {
        min_m: of.bounds.min_m,
        max_m: of.bounds.max_m,
        count: of.part.splats.len(),
        file: String::new(),
        blake3: String::new(),
        views: of.training.iter().map(index).collect(),
        neighbors: neighbors(number),
    };
    kept.iter().enumerate().map(sector).collect()
}

/// Writes a scene of nothing, where nothing can be trained.
pub(super) fn write_empty(
    draft: &Draft,
    names: Names,
    config: &SplatsConfig,
) -> Result<(), BundleError> {
    let scene = SplatScene {
        degree: 0,
        compensated: config.render.compensate,
        background: SplatBackground::Constant([0.0; 3]),
        sectors: Vec::new(),
        views: Vec::new(),
        training: SplatTraining {
            preset: names.preset.to_owned(),
            seed: config.seed,
            exposure_model: names.exposure_model.to_owned(),
            ..SplatTraining::default()
        },
        coverage: None,
    };
    write(draft, &scene, &SplatContent::default())
}

/// What was seen: of the Gaussians by those who trained them, of space and sky by all.
fn seen(parts: &[&Part]) -> SplatCoverageContent {
    let mut content = SplatCoverageContent::default();
    let mut all: Option<(ObservedSpace, Vec<bool>)> = None;
    for Part { coverage, .. } in parts {
        content.gaussians.push(observed(coverage));
        match &mut all {
            None => all = Some((coverage.space().clone(), coverage.sky().texels().to_vec())),
            Some((space, sky)) => {
                space.insert_all(coverage.space());
                for (seen, more) in sky.iter_mut().zip(coverage.sky().texels()) {
                    *seen |= more;
                }
            }
        }
    }
    if let Some((space, sky)) = all {
        let blocks = space.blocks();
        content.space = blocks
            .map(|(index, voxels)| SplatSpaceBlock { index, voxels })
            .collect();
        content.sky = sky;
    }
    content
}

fn observed(coverage: &Coverage) -> Vec<SplatObservation> {
    let seen = coverage.gaussians().iter().map(|seen| SplatObservation {
        instants: seen.instants,
        directions: seen.directions.0,
        finest_m: seen.finest_m,
        color_error: seen.color_error,
        depth_error: seen.depth_error,
    });
    seen.collect()
}

fn check(of: &GrowthCheck) -> SplatCheck {
    SplatCheck {
        step: of.step,
        counts: of.splats,
        psnr_db: of.psnr_db,
        gain_db: of.gain_db,
        upper_gain_db: of.upper_gain_db,
        continues: of.continues,
    }
}
