//! Initial lens.
//!
//! Contract: the factory's lens if there is one. Otherwise pinholes with focal lengths over the
//! usual range are tried, each with its poses, and the best is refined as a radial-tangential lens
//! and as a fisheye; the better one is returned. Lenses over 150 degrees wide need a factory file.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};

use super::points::single_lens_problem;
use crate::adjust::{LensBlock, Point, Prior, Settings, solve};
use crate::pnp;

/// Focal lengths that are tried, in image widths.
const FOCAL_LENGTHS: [f64; 9] = [0.3, 0.4, 0.52, 0.65, 0.8, 1.0, 1.3, 1.7, 2.4];
/// Maximum number of views used.
const MAX_VIEWS: usize = 12;

/// A view of a target: its pose and its points.
pub(super) type PosedPoints = (RigidTransform, Vec<Point>);

/// Poses of the views that a lens explains, in their order.
pub(super) fn poses(model: &CameraModel, views: &[Vec<Point>]) -> Vec<Option<pnp::PlanarPose>> {
    let pieces = crate::adjust::in_chunks(views.len(), |range| {
        views[range]
            .iter()
            .map(|points| pnp::planar(model, points))
            .collect::<Vec<_>>()
    });
    pieces.into_iter().flatten().collect()
}

/// A lens from views alone, and its median RMS residual, px. `None` if nothing fits.
pub(super) fn initial_lens(size: (u32, u32), views: &[Vec<Point>]) -> Option<(CameraModel, f64)> {
    let mut by_points: Vec<&Vec<Point>> = views.iter().collect();
    by_points.sort_by_key(|points| std::cmp::Reverse(points.len()));
    // Every n-th of the fuller half, so that they are spread over the recording.
    by_points.truncate((by_points.len() / 2).max(MAX_VIEWS));
    let step = by_points.len().div_ceil(MAX_VIEWS);
    let few: Vec<Vec<Point>> = by_points
        .into_iter()
        .step_by(step.max(1))
        .cloned()
        .collect();
    let pinhole = |f: f64| CameraModel {
        width: size.0,
        height: size.1,
        fx: f * f64::from(size.0),
        fy: f * f64::from(size.0),
        cx: 0.5 * f64::from(size.0 - 1),
        cy: 0.5 * f64::from(size.1 - 1),
        distortion: Distortion::None,
    };
    // Residuals are compared by their medians over views: some poses may be wrong.
    let tried = FOCAL_LENGTHS.iter().filter_map(|&f| {
        let model = pinhole(f);
        let found: Vec<Option<pnp::PlanarPose>> = poses(&model, &few);
        let mut misses: Vec<f64> = found
            .iter()
            .map(|p| p.map_or(f64::INFINITY, |p| p.rms_px))
            .collect();
        misses.sort_by(f64::total_cmp);
        let median = misses.get(misses.len() / 2).copied()?;
        median.is_finite().then_some((median, model, found))
    });
    let (_, model, found) = tried.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let posed: Vec<PosedPoints> = found
        .into_iter()
        .zip(&few)
        .filter_map(|(placed, points)| Some((placed?.eye_from_target, points.clone())))
        .collect();
    let shapes = [
        Distortion::RadTan4 {
            k1: 0.0,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
        },
        // The first terms of the tangent: a pinhole in this model.
        Distortion::KannalaBrandt4 {
            k1: 1.0 / 3.0,
            k2: 2.0 / 15.0,
            k3: 0.0,
            k4: 0.0,
        },
    ];
    let fits = shapes.into_iter().filter_map(|distortion| {
        let model = CameraModel {
            distortion,
            ..model
        };
        fit(&model, &weak_priors(&model), &posed)
    });
    fits.min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(model, rms, _)| (model, rms))
}

/// Fits a lens and poses to posed views: the lens, RMS residual in px, and the poses.
pub(super) fn fit(
    start: &CameraModel,
    priors: &[Prior],
    views: &[PosedPoints],
) -> Option<(CameraModel, f64, Vec<RigidTransform>)> {
    let lens = LensBlock {
        name: String::new(),
        model: *start,
        priors: priors.to_vec(),
    };
    let settings = Settings {
        covariance: false,
        tolerance: 1e-6,
        ..Settings::default()
    };
    let solution = solve(&single_lens_problem(lens, views), &settings).ok()?;
    let rms = solution.rms_px(|_| true);
    let model = solution.problem.lenses[0].model;
    Some((model, rms, solution.problem.instants))
}

/// Weak priors for any lens: approximate focal length, principal point near the image centre, and
/// the usual range of the coefficients.
pub(super) fn weak_priors(model: &CameraModel) -> Vec<Prior> {
    let near = |mean: f64, sigma: f64| Prior::Near { mean, sigma };
    let width = f64::from(model.width);
    let mut priors = vec![
        near(model.fx, 0.3 * model.fx),
        near(model.fy, 0.3 * model.fy),
        near(0.5 * (width - 1.0), 0.1 * width),
        near(0.5 * (f64::from(model.height) - 1.0), 0.1 * width),
    ];
    let fisheye = matches!(model.distortion, Distortion::KannalaBrandt4 { .. });
    let names = model.distortion.coefficient_names();
    priors.extend(names.iter().map(|name| match *name {
        "p1" | "p2" => near(0.0, 0.01),
        "xi" => near(0.0, 0.5),
        "alpha" => near(0.5, 0.5),
        "beta" => near(1.0, 0.7),
        _ if fisheye => near(0.0, 0.4),
        _ => near(0.0, 0.7),
    }));
    priors
}

/// Priors around a factory file: 1 % of the focal length, 1 % of the image width, and coefficients
/// by the difference of two calibrations of one camera.
pub(super) fn factory_priors(factory: &CameraModel) -> Vec<Prior> {
    let parameters = factory.parameters().into_iter().enumerate();
    let names = factory.parameter_names();
    parameters
        .map(|(k, mean)| {
            let sigma = match names[k] {
                "fx" | "fy" => 0.01 * mean,
                "cx" | "cy" => 0.01 * f64::from(factory.width),
                "p1" | "p2" => 2e-3,
                "k1" => 0.05,
                "k2" => 0.03,
                "k3" => 0.01,
                _ => 0.1,
            };
            Prior::Near { mean, sigma }
        })
        .collect()
}

/// Initial values of another model for the same lens. The poses are those of the lens.
pub(super) fn with_distortion(model: &CameraModel, distortion: Distortion) -> CameraModel {
    CameraModel {
        distortion,
        ..*model
    }
}
