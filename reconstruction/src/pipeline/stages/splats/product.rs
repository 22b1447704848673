//! From a trained scene to the output `splats`.

use scene_bundle::outputs::splats::{
    HeldOut, SplatBackground, SplatCheck, SplatContent, SplatCoverage, SplatCoverageContent,
    SplatObserved, SplatScene, SplatSector, SplatSpaceBlock, SplatTraining, SplatView, write,
};
use scene_bundle::{BundleError, Draft};
use splats::{Background, Coverage, GrowthCheck, Plane, Renderer, Splats, TrainingView};

use super::config::SplatsConfig;
use super::fit::Fit;
use crate::pipeline::StageError;

/// Width up to which comparisons are reduced, px.
const COMPARISON_WIDTH: u32 = 360;

/// Names of the settings and of the model of exposures.
#[derive(Clone, Copy, Debug)]
pub(super) struct Names {
    pub(super) preset: &'static str,
    pub(super) exposure_model: &'static str,
}

/// Records of the views: those of the training, and held-out ones beside their images.
pub(super) struct Views<'a> {
    pub(super) records: Vec<SplatView>,
    /// Index of each held-out view among the records.
    pub(super) held_out: &'a [usize],
    pub(super) held_out_views: &'a [TrainingView],
}

/// Writes a trained scene as one sector.
pub(super) fn write_fit(
    draft: &Draft,
    fit: &Fit,
    mut views: Views<'_>,
    names: Names,
    config: &SplatsConfig,
) -> Result<(), StageError> {
    let evaluation = &fit.report.evaluation;
    let results = evaluation.psnr_db.iter().zip(&evaluation.ssim);
    for (index, (psnr_db, ssim)) in views.held_out.iter().zip(results) {
        views.records[*index].held_out = Some(HeldOut {
            psnr_db: *psnr_db,
            ssim: *ssim,
        });
    }
    let comparisons = comparisons(fit, &views, config)?;
    let splats = &fit.scene.splats;
    let trained = (0..views.records.len()).filter(|k| views.records[*k].held_out.is_none());
    let [min_m, max_m] = bounds(splats);
    let sector = SplatSector {
        min_m,
        max_m,
        count: splats.len(),
        file: String::new(),
        blake3: String::new(),
        views: trained.collect(),
        neighbors: Vec::new(),
    };
    let (background, sky) = match &fit.scene.background {
        Background::Constant(color) => (SplatBackground::Constant(*color), &[][..]),
        Background::Sky(sky) => (SplatBackground::Sky { size: sky.size() }, sky.texels()),
    };
    let depth_error = evaluation.depth_error;
    let scene = SplatScene {
        degree: splats.degree(),
        compensated: config.render.compensate,
        background,
        sectors: vec![sector],
        views: views.records,
        training: SplatTraining {
            preset: names.preset.to_owned(),
            seed: config.seed,
            steps: config.train.steps,
            start_count: fit.start_count,
            exposure_model: names.exposure_model.to_owned(),
            depth_error: depth_error.is_finite().then_some(depth_error),
            checks: fit.report.checks.iter().map(check).collect(),
        },
        coverage: Some(SplatCoverage {
            voxel_m: fit.coverage.space().voxel_m(),
            range_m: fit.coverage.space().range_m(),
            sky_texels: fit.coverage.sky().size(),
        }),
    };
    let content = SplatContent {
        sectors: std::slice::from_ref(splats),
        sky,
        comparisons: &comparisons,
        coverage: Some(&coverage(&fit.coverage)),
    };
    Ok(write(draft, &scene, &content)?)
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

/// What was seen, of one sector.
fn coverage(of: &Coverage) -> SplatCoverageContent {
    let seen = of.gaussians().iter().map(|seen| SplatObserved {
        instants: seen.instants,
        directions: seen.directions.0,
        finest_m: seen.finest_m,
        color_error: seen.color_error,
        depth_error: seen.depth_error,
    });
    let space = of.space().blocks();
    SplatCoverageContent {
        gaussians: vec![seen.collect()],
        space: space
            .map(|(index, voxels)| SplatSpaceBlock { index, voxels })
            .collect(),
        sky: of.sky().texels().to_vec(),
    }
}

/// Box around the means.
fn bounds(splats: &Splats) -> [[f64; 3]; 2] {
    let along = |of: fn(f32, f32) -> f32| {
        [0, 1, 2].map(|k| {
            let means = splats.planes()[Plane::POSITION + k].iter().copied();
            f64::from(means.reduce(of).unwrap_or(0.0))
        })
    };
    [along(f32::min), along(f32::max)]
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

/// Of each camera the held-out left image with the median PSNR, as recorded and as rendered.
fn comparisons(
    fit: &Fit,
    views: &Views<'_>,
    config: &SplatsConfig,
) -> Result<Vec<(usize, Vec<u8>)>, StageError> {
    let renderer = Renderer::new(config.render)?;
    let psnr_db = &fit.report.evaluation.psnr_db;
    let mut cameras: Vec<&str> = Vec::new();
    for index in views.held_out {
        let camera = views.records[*index].camera.as_str();
        if !cameras.contains(&camera) {
            cameras.push(camera);
        }
    }
    let mut comparisons = Vec::new();
    for camera in cameras {
        let is_of = |k: &usize| {
            let record = &views.records[views.held_out[*k]];
            record.camera == camera && record.eye == camera_models::Eye::Left
        };
        let mut of_camera: Vec<usize> = (0..views.held_out.len()).filter(is_of).collect();
        of_camera.sort_by(|a, b| psnr_db[*a].total_cmp(&psnr_db[*b]).then(a.cmp(b)));
        let Some(chosen) = of_camera.get(of_camera.len() / 2) else {
            continue;
        };
        let view = &views.held_out_views[*chosen];
        let factor = view.camera.model().width.div_ceil(COMPARISON_WIDTH);
        let view = view.reduced(factor)?;
        let image = renderer.render(&fit.scene, &view.camera, &view.exposure);
        let model = view.camera.model();
        let (width, height) = (model.width as usize, model.height as usize);
        let mut rgb = Vec::with_capacity(6 * width * height);
        for row in 0..height {
            rgb.extend(&view.rgb[3 * row * width..3 * (row + 1) * width]);
            for pixel in row * width..(row + 1) * width {
                let value = |plane: &Vec<f32>| libm::roundf(255.0 * plane[pixel]) as u8;
                rgb.extend(image.rgb.each_ref().map(value));
            }
        }
        comparisons.push((views.held_out[*chosen], png([2 * width, height], &rgb)?));
    }
    Ok(comparisons)
}

fn png([width, height]: [usize; 2], rgb: &[u8]) -> Result<Vec<u8>, png::EncodingError> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(rgb)?;
    writer.finish()?;
    Ok(file)
}
