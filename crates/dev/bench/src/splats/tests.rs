use rig_sim::scene::{Kind, Lighting};
use splats::TrainingView;

use super::exam::Exam;
use super::fit;
use super::views::{Part, ViewOptions, WalkViews};
use crate::terrain::walks::Walk;

/// PSNR of an image against another one where both are usable, dB.
fn psnr_db(a: &TrainingView, b: &TrainingView) -> f64 {
    let usable = |k: usize| a.mask.get(k / 3).copied().unwrap_or(true);
    let pairs = a.rgb.iter().zip(&b.rgb).enumerate();
    let squares = pairs.filter(|(k, _)| usable(*k));
    let squares = squares.map(|(_, (a, b))| f64::from(a.abs_diff(*b)).powi(2));
    let (sum, count) = squares.fold((0.0, 0), |(sum, count), s| (sum + s, count + 1));
    10.0 * libm::log10(255.0 * 255.0 * f64::from(count) / sum)
}

/// No benchmark uses it.
const WALK: Walk = Walk {
    kind: Kind::Pavement,
    light: Lighting::Day,
    seed: 909,
    span_s: [3.0, 7.0],
    size: [128, 72],
};

#[test]
fn truth_is_what_was_recorded_without_noise() {
    let views = WalkViews::load(WALK.prepare().unwrap(), "-views").unwrap();
    assert!(views.instants(Part::Validation) > 0 && views.instants(Part::Training) > 5);
    let options = ViewOptions {
        right_images: false,
        ..ViewOptions::STAGE
    };
    let recorded = views.recorded(Part::Validation, &options).unwrap();
    let truth = views.truth(Part::Validation, &options).unwrap();
    assert_eq!(recorded.len(), truth.len());
    for (recorded, truth) in recorded.iter().zip(&truth) {
        let db = psnr_db(recorded, &truth.view);
        assert!(db > 26.0, "camera {}: {db} dB", truth.camera);
        let pairs = recorded.depth_m.iter().zip(&truth.view.depth_m);
        let errors = pairs.filter(|(a, b)| a.is_finite() && b.is_finite());
        let mut errors: Vec<f32> = errors.map(|(a, b)| (a - b).abs() / b).collect();
        errors.sort_by(f32::total_cmp);
        // At 128 columns a twentieth of a pixel of disparity is a tenth of 5 m.
        let median = errors[errors.len() / 2];
        assert!(median < 0.2, "camera {}: {median}", truth.camera);
    }
    // A pose of its own gives the same image, but for the rolling shutter.
    let (camera, frame, pose) = views.poses(Part::Validation).unwrap()[0];
    let still = views.truth_at(camera, frame, &pose, &options).unwrap();
    assert!(psnr_db(&still.view, &truth[0].view) > 30.0);
}

#[test]
fn a_short_training_renders_held_out_instants() {
    let exam = Exam::new(WALK.prepare().unwrap(), "-exam", 1).unwrap();
    let mut scores = Vec::new();
    for steps in [1, 60] {
        let mut config = fit::config("balanced", Some(steps)).unwrap();
        // Full size from the first step on: the images are small.
        (config.train.quarter_until, config.train.full_from) = (0.0, 0.0);
        let options = ViewOptions::STAGE;
        let row = exam.run("", "balanced", &config, &options).unwrap();
        assert!(row["error"].is_null(), "{row}");
        // So few steps leave a scene transparent: most pixels are holes, which are errors of 1.
        let depth_error = |name: &str| row["instants"][name].as_f64().unwrap();
        let known = depth_error("known_depth_error");
        assert!(known < 0.2, "{row}");
        assert!(depth_error("depth_error") > known, "{row}");
        assert!(row["off_path"].as_array().unwrap().len() > 2, "{row}");
        scores.push(row["instants"]["psnr_db"].as_f64().unwrap());
    }
    assert!(
        scores[1] > scores[0] + 0.5 && scores[1] > 15.0,
        "{scores:?}"
    );
}
