//! Views off the path of a walk: channels of coverage beside errors against the truth.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use splats::{Camera, Coverage, CoverageImage, Image, Renderer, TrainingView};

use crate::splats::brightness;
use crate::splats::fit::{self, config};
use crate::splats::off_path::{OffPathView, off_path};
use crate::splats::views::{Part, ViewOptions, WalkViews};
use crate::terrain::walks::Walk;

/// Every which pixel of a row and column is kept.
const STEP_PX: usize = 8;
/// Seed of the views off the path.
const SEED: u64 = 26;

/// How a walk is sampled.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sampling {
    /// Steps of the training, of the preset `fast`.
    pub(crate) steps: usize,
    /// Views for each offset and angle.
    pub(crate) views: usize,
}

/// Errors of a view, and where it is.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Errors {
    pub(crate) offset_m: f64,
    pub(crate) angle_deg: f64,
    /// Against the truth without noise, at the brightness of the scene, dB.
    pub(crate) psnr_db: f64,
    /// Median over the pixels with true depth of the relative error of the median depth; 1 where
    /// none is rendered.
    pub(crate) depth_error: f64,
    /// Distance (m) and angle of the optical axes (degrees) to each pose of the training.
    pub(crate) poses: Vec<[f32; 2]>,
    /// Mean absolute error of color of the kept pixels.
    pub(crate) pixel_errors: Vec<f32>,
}

/// A view with its channels, of some pixels.
pub(crate) struct Sample {
    pub(crate) errors: Errors,
    pub(crate) channels: CoverageImage,
}

/// Samples of a walk: rendered, or read from `kept` where they are there.
///
/// # Errors
/// The walk cannot be rendered or trained, or an I/O error.
pub(crate) fn samples(walk: Walk, sampling: Sampling, kept: Option<&Path>) -> Result<Vec<Sample>> {
    let Sampling { steps, views } = sampling;
    let seconds = walk.span_s[1] - walk.span_s[0];
    let name = format!("{}-{seconds}-{steps}-{views}", walk.name());
    let path = kept.map(|folder| folder.join(name));
    if let Some(path) = path
        .as_ref()
        .filter(|path| path.with_extension("json").exists())
    {
        return read(path);
    }
    let samples = rendered(walk, sampling)?;
    if let Some(path) = path {
        write(&path, &samples)?;
    }
    Ok(samples)
}

fn rendered(walk: Walk, sampling: Sampling) -> Result<Vec<Sample>> {
    let views = WalkViews::load(walk.prepare()?, "")?;
    let options = ViewOptions::STAGE;
    let training = views.recorded(Part::Training, &options)?;
    let validation = views.recorded(Part::Validation, &options)?;
    let config = config("fast", Some(sampling.steps))?;
    let fit = fit::fit(training.clone(), &validation, &config, (&[], 1))?;
    let renderer = Renderer::new(config.render)?;
    let coverage = Coverage::gather(&renderer, &fit.scene, &training, &config.coverage)?;
    let tests = off_path(&views, sampling.views, SEED, &options)?;
    println!(
        "{}: {} views of the training, {} Gaussians, {:.2} dB in validation views, {} views off \
         the path",
        walk.name(),
        training.len(),
        fit.scene.splats.len(),
        fit::evaluate(&fit.scene, &validation, &config)?.mean_psnr_db(),
        tests.len()
    );
    let images = tests.iter().map(|test| {
        let view = &test.test.view;
        renderer.render(&fit.scene, &view.camera, &view.exposure)
    });
    let images: Vec<Image> = images.collect();
    let factors = factors(&tests, &images);
    let samples = tests.iter().zip(images).map(|(test, image)| {
        let view = &test.test.view;
        let factor = factors[test.test.camera];
        let image = brightness::scaled(image, factor);
        let channels = coverage.render(&renderer, &fit.scene, &view.camera)?;
        let kept = kept(channels.width, channels.height);
        let error = |pixel: &usize| {
            let recorded = |c: usize| f32::from(view.rgb[3 * pixel + c]) / 255.0;
            let errors =
                [0, 1, 2].map(|c| (image.rgb[c][*pixel].clamp(0.0, 1.0) - recorded(c)).abs());
            errors.iter().sum::<f32>() / 3.0 / factor as f32
        };
        Ok(Sample {
            errors: Errors {
                offset_m: test.offset_m,
                angle_deg: test.angle_deg,
                psnr_db: brightness::psnr_at_scene_db(&image, view, factor),
                depth_error: depth_error(&image.median_depth_m, &view.depth_m),
                poses: poses(&view.camera, &training),
                pixel_errors: kept.iter().map(error).collect(),
            },
            channels: thinned(&channels, &kept),
        })
    });
    samples.collect()
}

/// Of each camera the factor from the brightness of the scene to that of its images.
fn factors(tests: &[OffPathView], images: &[Image]) -> Vec<f64> {
    let cameras = tests.iter().map(|test| test.test.camera + 1).max();
    let of_camera = |camera: usize| {
        let own = tests.iter().zip(images);
        let own = own.filter(|(test, _)| test.test.camera == camera);
        crate::meter::median(own.map(|(test, image)| brightness::factor(image, &test.test.view)))
    };
    (0..cameras.unwrap_or(0)).map(of_camera).collect()
}

/// Pixels that are kept.
fn kept(width: usize, height: usize) -> Vec<usize> {
    let rows = (STEP_PX / 2..height).step_by(STEP_PX);
    let columns = (STEP_PX / 2..width).step_by(STEP_PX);
    rows.flat_map(|row| columns.clone().map(move |column| row * width + column))
        .collect()
}

fn thinned(of: &CoverageImage, kept: &[usize]) -> CoverageImage {
    let mut out = of.clone();
    for plane in planes(&mut out) {
        *plane = kept.iter().map(|pixel| plane[*pixel]).collect();
    }
    out
}

fn planes(of: &mut CoverageImage) -> [&mut Vec<f32>; 10] {
    [
        &mut of.alpha,
        &mut of.median_depth_m,
        &mut of.uncovered,
        &mut of.angle_rad,
        &mut of.few,
        &mut of.magnification,
        &mut of.space,
        &mut of.spread,
        &mut of.squared_error,
        &mut of.depth_error,
    ]
}

/// Median of the relative errors of depth.
fn depth_error(rendered_m: &[f32], true_m: &[f32]) -> f64 {
    let both = rendered_m
        .iter()
        .zip(true_m)
        .filter(|(_, truth)| truth.is_finite());
    let errors = both.map(|(rendered, truth)| match rendered.is_finite() {
        true => f64::from((rendered - truth).abs() / truth),
        false => 1.0,
    });
    crate::meter::median(errors)
}

fn poses(camera: &Camera, training: &[TrainingView]) -> Vec<[f32; 2]> {
    let camera_from_world = camera.camera_from_world();
    let to = training.iter().map(|view| {
        let motion = *camera_from_world * view.camera.camera_from_world().inverse();
        // Turns about the optical axis do not count.
        let along = motion.rotate([0.0, 0.0, 1.0])[2].clamp(-1.0, 1.0);
        let angle_deg = libm::acos(along).to_degrees();
        [motion.distance_m() as f32, angle_deg as f32]
    });
    to.collect()
}

fn write(path: &Path, samples: &[Sample]) -> Result<()> {
    let errors: Vec<&Errors> = samples.iter().map(|sample| &sample.errors).collect();
    let mut bytes = Vec::new();
    for sample in samples {
        for plane in planes(&mut sample.channels.clone()) {
            bytes.extend(plane.iter().flat_map(|value| value.to_le_bytes()));
        }
    }
    let folder = path.parent().context("a folder for the samples")?;
    fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
    fs::write(path.with_extension("f32"), bytes)?;
    fs::write(path.with_extension("json"), serde_json::to_vec(&errors)?)?;
    Ok(())
}

fn read(path: &Path) -> Result<Vec<Sample>> {
    let errors: Vec<Errors> = serde_json::from_slice(&fs::read(path.with_extension("json"))?)?;
    let bytes = fs::read(path.with_extension("f32"))?;
    let (values, _) = bytes.as_chunks::<4>();
    let mut values = values.iter().map(|value| f32::from_le_bytes(*value));
    let expected: usize = errors.iter().map(|own| 10 * own.pixel_errors.len()).sum();
    ensure!(
        bytes.len() == 4 * expected,
        "{} has {} bytes, expected {expected} numbers",
        path.display(),
        bytes.len()
    );
    let samples = errors.into_iter().map(|errors| {
        let mut channels = CoverageImage::default();
        for plane in planes(&mut channels) {
            *plane = values.by_ref().take(errors.pixel_errors.len()).collect();
        }
        Sample { errors, channels }
    });
    Ok(samples.collect())
}
