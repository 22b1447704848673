//! Initial lens.
//!
//! Contract: the factory's lens if there is one. Otherwise pinholes with focal lengths over the
//! usual range are tried, each with its poses, and the best is refined as a radial-tangential lens
//! and as a fisheye; the better one is returned. Lenses over 150 degrees wide need a factory file.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};

use super::config::{Config, FactoryPriorConfig, LensPriorConfig};
use super::points::single_lens_problem;
use crate::adjust::{self, LensBlock, Point, Prior, solve};
use crate::pnp;

/// A view of a target: its pose and its points.
pub(super) type PosedPoints = (RigidTransform, Vec<Point>);

/// Poses of the views that a lens explains, in their order.
pub(super) fn poses(
    model: &CameraModel,
    views: &[Vec<Point>],
    config: &pnp::Config,
) -> Vec<Option<pnp::PlanarPose>> {
    let pieces = crate::adjust::in_chunks(views.len(), |range| {
        views[range]
            .iter()
            .map(|points| pnp::planar(model, points, config))
            .collect::<Vec<_>>()
    });
    pieces.into_iter().flatten().collect()
}

/// A lens from views alone, and its median RMS residual, px. `None` if nothing fits.
pub(super) fn initial_lens(
    size: (u32, u32),
    views: &[Vec<Point>],
    config: &Config,
) -> Option<(CameraModel, f64)> {
    let most = config.initialization.max_views;
    let mut by_points: Vec<&Vec<Point>> = views.iter().collect();
    by_points.sort_by_key(|points| std::cmp::Reverse(points.len()));
    // Every n-th of the fuller half, so that they are spread over the recording.
    by_points.truncate((by_points.len() / 2).max(most));
    let step = by_points.len().div_ceil(most);
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
    let tried = config.initialization.focal_lengths.iter().filter_map(|&f| {
        let model = pinhole(f);
        let found: Vec<Option<pnp::PlanarPose>> = poses(&model, &few, &config.poses);
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
        fit(
            &model,
            &weak_priors(&model, &config.priors.any_lens),
            &posed,
            &config.solver,
        )
    });
    fits.min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(model, rms, _)| (model, rms))
}

/// Fits a lens and poses to posed views: the lens, RMS residual in px, and the poses.
pub(super) fn fit(
    start: &CameraModel,
    priors: &[Prior],
    views: &[PosedPoints],
    config: &adjust::Config,
) -> Option<(CameraModel, f64, Vec<RigidTransform>)> {
    let lens = LensBlock {
        name: String::new(),
        model: *start,
        priors: priors.to_vec(),
    };
    let solution = solve(&single_lens_problem(lens, views), &config.approximate()).ok()?;
    let rms = solution.rms_px(|_| true);
    let model = solution.problem.lenses[0].model;
    Some((model, rms, solution.problem.instants))
}

/// Weak priors for any lens: approximate focal length, principal point near the image centre, and
/// the usual range of the coefficients.
pub(super) fn weak_priors(model: &CameraModel, config: &LensPriorConfig) -> Vec<Prior> {
    let near = |mean: f64, sigma: f64| Prior::Near { mean, sigma };
    let width = f64::from(model.width);
    let mut priors = vec![
        near(model.fx, config.focal_length_ratio * model.fx),
        near(model.fy, config.focal_length_ratio * model.fy),
        near(0.5 * (width - 1.0), config.principal_point_ratio * width),
        near(
            0.5 * (f64::from(model.height) - 1.0),
            config.principal_point_ratio * width,
        ),
    ];
    let fisheye = matches!(model.distortion, Distortion::KannalaBrandt4 { .. });
    let names = model.distortion.coefficient_names();
    priors.extend(names.iter().map(|name| match *name {
        "p1" | "p2" => near(0.0, config.tangential),
        "xi" => near(0.0, config.xi),
        "alpha" => near(config.alpha[0], config.alpha[1]),
        "beta" => near(config.beta[0], config.beta[1]),
        _ if fisheye => near(0.0, config.fisheye),
        _ => near(0.0, config.radial),
    }));
    priors
}

/// Priors about a factory file.
pub(super) fn factory_priors(factory: &CameraModel, config: &FactoryPriorConfig) -> Vec<Prior> {
    let parameters = factory.parameters().into_iter().enumerate();
    let names = factory.parameter_names();
    parameters
        .map(|(k, mean)| {
            let sigma = match names[k] {
                "fx" | "fy" => config.focal_length_ratio * mean,
                "cx" | "cy" => config.principal_point_ratio * f64::from(factory.width),
                "p1" | "p2" => config.tangential,
                "k1" => config.radial[0],
                "k2" => config.radial[1],
                "k3" => config.radial[2],
                _ => config.other,
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
