use super::*;
use crate::reference::Random;

/// Evidence of a distinct match on a dense surface.
const CLEAR: Evidence = Evidence {
    second_best_margin: 4.0,
    cost_slope: 2.0,
    disparity_range_px: 0.5,
    density: 1.0,
    lr_difference_px: 0.0,
    correlation: 0.95,
};

/// Heavy-tailed errors whose scale depends on two components of the evidence: one in twenty is more
/// than three times the median.
fn samples(random: &mut Random, count: usize) -> Vec<Sample> {
    (0..count)
        .map(|_| {
            let mut part = || random.below(1_000_000) as f32 / 1e6;
            let evidence = Evidence {
                second_best_margin: 5.0 * part(),
                cost_slope: 3.0 * part(),
                disparity_range_px: 0.0,
                density: part(),
                ..Evidence::default()
            };
            let error_px = error(&evidence, part());
            Sample { evidence, error_px }
        })
        .collect()
}

/// Quantile of the error; `part` is from 0 to 1.
fn error(evidence: &Evidence, part: f32) -> f32 {
    let size = if evidence.second_best_margin < 1.0 {
        2.0
    } else {
        0.5
    };
    let more = if evidence.density < 0.3 { 4.0 } else { 1.0 };
    size * more * ((1.0 - part).powf(-0.5) - 1.0)
}

/// Fraction of errors within two sigma, among the samples that fulfill a condition.
fn coverage(model: &Model, samples: &[Sample], of: impl Fn(&Evidence) -> bool) -> f64 {
    let chosen: Vec<&Sample> = samples.iter().filter(|s| of(&s.evidence)).collect();
    assert!(chosen.len() > 1000);
    let is_in = |s: &&&Sample| s.error_px <= 2.0 * model.sigma_px(&s.evidence);
    chosen.iter().filter(is_in).count() as f64 / chosen.len() as f64
}

#[test]
fn fitted_model_covers_unseen_samples() {
    let mut random = Random(51);
    let model = Model::fit(&samples(&mut random, 80_000)).unwrap();
    let others = samples(&mut random, 80_000);
    assert!((0.945..0.955).contains(&coverage(&model, &others, |_| true)));
    let parts: [fn(&Evidence) -> bool; 4] = [
        |e| e.second_best_margin < 0.9 && e.density < 0.25,
        |e| e.second_best_margin < 0.9 && e.density > 0.35,
        |e| e.second_best_margin > 1.1 && e.density < 0.25,
        |e| e.second_best_margin > 1.1 && e.density > 0.35,
    ];
    for part in parts {
        let share = coverage(&model, &others, part);
        assert!((0.93..0.97).contains(&share), "{share}");
    }
    let clear = Evidence {
        second_best_margin: 4.0,
        cost_slope: 2.0,
        disparity_range_px: 0.0,
        density: 0.9,
        ..Evidence::default()
    };
    for evidence in [
        clear,
        Evidence {
            density: 0.1,
            ..clear
        },
    ] {
        let sigma = f64::from(model.sigma_px(&evidence));
        let expected = 0.5 * f64::from(error(&evidence, 0.95));
        assert!((sigma / expected - 1.0).abs() < 0.1, "{sigma} {expected}");
    }
}

#[test]
fn too_few_samples_give_no_model() {
    assert_eq!(Model::fit(&samples(&mut Random(52), 100)), None);
}

#[test]
fn infinite_range_gives_a_finite_sigma() {
    // Infinite ranges occur in neighborhoods without a disparity.
    let model = Model::fit(&samples(&mut Random(53), 60_000)).unwrap();
    let evidence = Evidence {
        second_best_margin: 0.0,
        cost_slope: 0.0,
        disparity_range_px: f32::NEG_INFINITY,
        density: 0.0,
        ..Evidence::default()
    };
    assert!(model.sigma_px(&evidence).is_finite());
}

#[test]
fn preset_models_separate_good_from_bad_evidence() {
    let bad = Evidence {
        second_best_margin: 0.1,
        cost_slope: 0.1,
        disparity_range_px: 5.0,
        density: 0.2,
        lr_difference_px: 8.0,
        correlation: 0.2,
    };
    for paths in [Paths::Three, Paths::Eight] {
        let model = Model::of(paths);
        assert!(model.sigma_px(&CLEAR) < 0.4, "{}", model.sigma_px(&CLEAR));
        assert!(model.sigma_px(&bad) > 3.0, "{}", model.sigma_px(&bad));
    }
}

#[test]
fn unknown_evidence_gives_a_large_sigma() {
    let model = Model::of(Paths::Eight);
    for unknown in [
        Evidence {
            disparity_range_px: f32::NAN,
            ..CLEAR
        },
        Evidence {
            density: f32::NAN,
            ..CLEAR
        },
    ] {
        let ratio = model.sigma_px(&unknown) / model.sigma_px(&CLEAR);
        assert!(ratio > 1.5, "{ratio}");
    }
}
