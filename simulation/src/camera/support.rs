//! Samples of the support map: how good images are at a distance and angle from recorded ones.

use crate::error::SimulationError;
use crate::reference_poses::{ReferencePoses, SupportSample};
use crate::scene::Sector;

/// PSNR of the held-out images of a sector, by the distance and angle to the nearest image with
/// which its Gaussians were trained. Held-out images lie between those of the training, so that
/// they say little about views farther than a step from the path.
///
/// # Errors
/// [`SimulationError::Scene`] for a sector that has no views of a training.
pub fn support_samples(sector: &Sector) -> Result<Vec<SupportSample>, SimulationError> {
    let views = &sector.recording.views;
    let is_training = |psnr_db: &Option<f64>| psnr_db.is_none();
    let training = views
        .iter()
        .filter(|view| is_training(&view.held_out_psnr_db));
    let training: Vec<_> = training.map(|view| view.world_from_camera).collect();
    if training.is_empty() {
        return Err(SimulationError::Scene {
            place: format!("views of sector {}", sector.name),
            found: "none of the training".to_owned(),
            expected: "the views of output splats".to_owned(),
        });
    }
    let references = ReferencePoses::new(training)?;
    let samples = views.iter().filter_map(|view| {
        let psnr_db = view.held_out_psnr_db?;
        let deviation = references.nearest(&view.world_from_camera);
        Some(SupportSample {
            distance_m: deviation.distance_m,
            angle_rad: deviation.angle_rad,
            psnr_db,
        })
    });
    Ok(samples.collect())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::testing::SyntheticScene;

    #[test]
    fn held_out_views_are_compared_with_those_of_the_training_only() {
        let scene = SyntheticScene::kerb(0.1).unwrap().scene;
        let mut sector = scene.sectors[0].clone();
        let mut recording = (*sector.recording).clone();
        // Views are 0.1 m apart on a straight line; every eighth one is held out.
        for (number, view) in recording.views.iter_mut().enumerate() {
            if number % 8 == 4 {
                view.held_out_psnr_db = Some(20.0 + number as f64);
            }
        }
        sector.recording = Arc::new(recording);
        let samples = support_samples(&sector).unwrap();
        assert_eq!(samples.len(), (sector.recording.views.len() + 3) / 8);
        for (number, sample) in samples.iter().enumerate() {
            assert_eq!(sample.psnr_db, 24.0 + 8.0 * number as f64);
            // At the kerb itself the neighbor may be higher.
            assert!((0.09..0.15).contains(&sample.distance_m), "{sample:?}");
            assert!(sample.angle_rad < 1e-6);
        }
        let recording = Arc::make_mut(&mut sector.recording);
        recording.views.clear();
        let error = support_samples(&sector).unwrap_err().to_string();
        assert!(error.contains("views of sector kerb"), "{error}");
    }
}
