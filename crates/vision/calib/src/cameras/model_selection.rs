//! Selection of the lens model.
//!
//! Contract: every model is fitted to the same views. Models are compared by cross-validation with
//! four folds. Of the models whose held-out error is equivalent to the best one's, the one with the
//! lowest BIC is taken (Schwarz 1978). Equivalent means: at most one standard error of the
//! difference above it, over views (after the rule of Breiman and others 1984), or a twentieth. A
//! model that folds inside the image is not taken. Both eyes of a camera get the same model.
//!
//! The factory's model is kept unless another predicts better: the prior of its file on
//! coefficients that the views do not constrain is better than dropping them, because tangential
//! terms, principal point and the rotation between the eyes compensate each other.

use camera_models::{CameraModel, Distortion, Lens};

use super::config::Config;
use super::initialization::{PosedPoints, factory_priors, fit, weak_priors, with_distortion};
use crate::adjust::{Prior, locate};

/// Remark on models whose distortion is not monotonic up to the image corner.
const FOLDS_INSIDE_IMAGE: &str = "folds inside the image";

/// Result of one model.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Model name.
    pub model: &'static str,
    /// Number of coefficients, per eye.
    pub coefficients: usize,
    /// RMS residual of all views, px.
    pub rms_px: f64,
    /// RMS residual of held-out views, px; `None` if it was not computed.
    pub held_out_px: Option<f64>,
    /// Bayesian information criterion, minus that of the best model.
    pub bic: f64,
    /// Reason for dropping the model.
    pub remark: Option<&'static str>,
}

/// Model selection for one camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// All models, simplest first.
    pub candidates: Vec<Candidate>,
    /// Index of the selected model.
    pub chosen: usize,
}

/// A lens with its priors.
#[derive(Clone, Debug)]
pub(super) struct SelectedLens {
    pub(super) model: CameraModel,
    pub(super) priors: Vec<Prior>,
}

/// Views of one eye for the model selection.
pub(super) struct EyeViews<'a> {
    pub(super) start: CameraModel,
    pub(super) factory: Option<&'a CameraModel>,
    pub(super) views: Vec<PosedPoints>,
}

/// A model fitted to the eyes of one camera.
struct FittedModel {
    eyes: Vec<SelectedLens>,
    poses: Vec<Vec<PosedPoints>>,
    square_sum: f64,
    corners: usize,
}

/// All models, simplest first, each as close to a pinhole as it can be.
fn all() -> [Distortion; 8] {
    let (k1, k2, k3, k4, k5, k6, p1, p2) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    [
        Distortion::None,
        Distortion::Radial2 { k1, k2 },
        Distortion::Eucm {
            alpha: 0.3,
            beta: 1.0,
        },
        Distortion::DoubleSphere {
            xi: 0.0,
            alpha: 0.3,
        },
        Distortion::RadTan4 { k1, k2, p1, p2 },
        Distortion::KannalaBrandt4 {
            k1: 1.0 / 3.0,
            k2: 2.0 / 15.0,
            k3,
            k4,
        },
        Distortion::RadTan5 { k1, k2, p1, p2, k3 },
        Distortion::Rational8 {
            k1,
            k2,
            p1,
            p2,
            k3,
            k4,
            k5,
            k6,
        },
    ]
}

/// Views that the initial lens model explains as well as the others; a view with a wrong pose would
/// outweigh the differences between models.
fn without_outliers(eye: &EyeViews<'_>, config: &Config) -> Vec<PosedPoints> {
    let priors = weak_priors(&eye.start, &config.priors.any_lens);
    let Some((model, _, poses)) = fit(&eye.start, &priors, &eye.views, &config.solver) else {
        return eye.views.clone();
    };
    let locate_config = &config.poses.locate;
    let misses: Vec<f64> = eye
        .views
        .iter()
        .zip(&poses)
        .map(|((_, points), pose)| {
            locate(&model, points, pose, locate_config).map_or(f64::INFINITY, |l| l.1)
        })
        .collect();
    let mut sorted = misses.clone();
    sorted.sort_by(f64::total_cmp);
    let limit = config.model_selection.outlier_view_ratio
        * sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let posed = eye.views.iter().zip(poses).zip(misses);
    posed
        .filter(|(_, miss)| *miss <= limit)
        .map(|(((_, points), pose), _)| (pose, points.clone()))
        .collect()
}

/// Selects the model for the eyes of one camera. `None` if nothing fits.
pub(super) fn select_model(
    eyes: &[EyeViews<'_>],
    config: &Config,
) -> Option<(Choice, Vec<SelectedLens>)> {
    let without_outliers = eyes.iter().map(|eye| EyeViews {
        views: without_outliers(eye, config),
        ..*eye
    });
    let eyes: &[EyeViews<'_>] = &without_outliers.collect::<Vec<_>>();
    let factory = eyes[0].factory.map(|model| model.distortion);
    let models: Vec<Distortion> = match factory {
        Some(factory) if !config.choose_lens => vec![factory],
        _ => all().to_vec(),
    };
    let fitted: Vec<Option<FittedModel>> =
        models.iter().map(|m| fit_model(eyes, *m, config)).collect();
    let rms = |t: &FittedModel| (t.square_sum / t.corners.max(1) as f64).sqrt();
    let best_rms = fitted.iter().flatten().map(rms).min_by(f64::total_cmp)?;
    let bic = |t: &FittedModel, coefficients: usize| {
        let parameters = eyes.len() * (4 + coefficients);
        // The noise is that of the model with the smallest residuals.
        let per_axis = 0.5 * best_rms * best_rms;
        t.square_sum / per_axis + parameters as f64 * (2.0 * t.corners as f64).ln()
    };
    let mut candidates = Vec::new();
    let mut errors: Vec<Option<Vec<f64>>> = Vec::new();
    for (model, fitted) in models.iter().zip(&fitted) {
        let coefficients = model.coefficient_names().len();
        let (remark, held_out) = match fitted {
            None => (Some("could not be fitted"), None),
            Some(t)
                if models.len() > 1 && rms(t) > config.model_selection.max_rms_ratio * best_rms =>
            {
                (Some("larger residuals than the best model"), None)
            }
            Some(t) if !t.eyes.iter().all(|e| Lens::new(&e.model).covers_image()) => {
                (Some(FOLDS_INSIDE_IMAGE), None)
            }
            Some(t) => match held_out(t, config) {
                Some(errors) => (None, Some(errors)),
                None => (Some("too few views to hold any out"), None),
            },
        };
        let mean_square = held_out.as_ref().map(|e| mean(e));
        candidates.push(Candidate {
            model: model.name(),
            coefficients,
            rms_px: fitted.as_ref().map_or(f64::INFINITY, rms),
            held_out_px: mean_square.map(f64::sqrt),
            bic: fitted
                .as_ref()
                .map_or(f64::INFINITY, |t| bic(t, coefficients)),
            remark,
        });
        errors.push(held_out);
    }
    let least = candidates
        .iter()
        .map(|c| c.bic)
        .fold(f64::INFINITY, f64::min);
    candidates.iter_mut().for_each(|c| c.bic -= least);
    let best = (0..candidates.len())
        .filter(|&i| errors[i].is_some())
        .min_by(|&a, &b| {
            candidates[a]
                .held_out_px
                .partial_cmp(&candidates[b].held_out_px)
                .expect("finite")
        });
    let lowest_bic = |among: &mut dyn Iterator<Item = usize>| {
        among.min_by(|&a, &b| candidates[a].bic.total_cmp(&candidates[b].bic))
    };
    let chosen = match best {
        // With too few views for cross-validation, BIC alone; models that fold come last.
        None => {
            let fitted = |i: &usize| fitted[*i].is_some();
            let flat = |i: &usize| fitted(i) && candidates[*i].remark != Some(FOLDS_INSIDE_IMAGE);
            let all = 0..candidates.len();
            lowest_bic(&mut all.clone().filter(flat)).or(lowest_bic(&mut all.filter(fitted)))?
        }
        Some(best) => {
            let reference = errors[best].as_ref().expect("the best has some");
            let near = |i: &usize| {
                errors[*i].as_ref().is_some_and(|e| {
                    is_equivalent(e, reference, config.model_selection.equivalent_ratio)
                })
            };
            let factory = models
                .iter()
                .position(|m| Some(m.name()) == factory.map(|f| f.name()));
            match factory.filter(|i| near(i)) {
                Some(factory) => factory,
                None => lowest_bic(&mut (0..candidates.len()).filter(near))?,
            }
        }
    };
    let eyes = fitted.into_iter().nth(chosen)??.eyes;
    Some((Choice { candidates, chosen }, eyes))
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Whether errors are equivalent to the best ones, view by view.
fn is_equivalent(errors: &[f64], best: &[f64], equivalent_ratio: f64) -> bool {
    let differences: Vec<f64> = errors.iter().zip(best).map(|(a, b)| a - b).collect();
    let (n, mean_of) = (differences.len() as f64, mean(&differences));
    let squares = differences.iter().map(|d| (d - mean_of).powi(2));
    let variance = squares.sum::<f64>() / (n - 1.0).max(1.0);
    mean_of <= (variance / n).sqrt() || mean_of <= equivalent_ratio * mean(best)
}

/// Fits a model to every eye.
fn fit_model(
    eyes: &[EyeViews<'_>],
    distortion: Distortion,
    config: &Config,
) -> Option<FittedModel> {
    let mut fitted = FittedModel {
        eyes: Vec::new(),
        poses: Vec::new(),
        square_sum: 0.0,
        corners: 0,
    };
    for eye in eyes {
        let same = |model: &&CameraModel| model.distortion.name() == distortion.name();
        let (start, priors) = match eye.factory.filter(same) {
            Some(factory) => (
                *factory,
                factory_priors(factory, &config.priors.factory_lens),
            ),
            None => {
                let own = eye.start.distortion.name() == distortion.name();
                let start = match own {
                    true => eye.start,
                    false => with_distortion(&eye.start, distortion),
                };
                (start, weak_priors(&start, &config.priors.any_lens))
            }
        };
        let (model, rms, poses) = fit(&start, &priors, &eye.views, &config.solver)?;
        let corners: usize = eye.views.iter().map(|(_, points)| points.len()).sum();
        fitted.square_sum += rms * rms * corners as f64;
        fitted.corners += corners;
        let posed = poses.into_iter().zip(&eye.views);
        fitted.poses.push(
            posed
                .map(|(pose, (_, points))| (pose, points.clone()))
                .collect(),
        );
        fitted.eyes.push(SelectedLens { model, priors });
    }
    Some(fitted)
}

/// Held-out error: mean squared residual of every view under a lens that was fitted without it, in
/// the order of eyes and folds; `None` with too few views or if a fit fails.
fn held_out(fitted: &FittedModel, config: &Config) -> Option<Vec<f64>> {
    let count = config.model_selection.folds;
    let mut errors = Vec::new();
    for (eye, views) in fitted.eyes.iter().zip(&fitted.poses) {
        if views.len() < 2 * count {
            return None;
        }
        let folds = crate::adjust::in_chunks(count, |folds| {
            folds
                .map(|fold| one_fold(eye, views, fold, config))
                .collect::<Vec<_>>()
        });
        for fold in folds.into_iter().flatten() {
            errors.extend(fold?);
        }
    }
    Some(errors)
}

fn one_fold(
    eye: &SelectedLens,
    views: &[PosedPoints],
    fold: usize,
    config: &Config,
) -> Option<Vec<f64>> {
    let folds = config.model_selection.folds;
    let part = |inside: bool| {
        let numbered = views.iter().enumerate();
        let chosen = numbered.filter(move |(i, _)| (i % folds == fold) == inside);
        chosen
            .map(|(_, view)| view.clone())
            .collect::<Vec<PosedPoints>>()
    };
    let (model, ..) = fit(&eye.model, &eye.priors, &part(false), &config.solver)?;
    let errors = part(true).into_iter().map(|(pose, points)| {
        let (_, rms) = locate(&model, &points, &pose, &config.poses.locate).ok()?;
        Some(rms * rms)
    });
    errors.collect()
}
