//! Detection of stale (frozen or torn) images.
//!
//! A frozen camera repeats its last image under new timestamps; an image that is read while being
//! written is torn: new at the top, the previous one at the bottom. Contract: bottom rows that
//! equal those of the previous image, although the body has moved so far since then that they must
//! differ, are stale. At rest images may be equal.

use crate::backend::observation::Camera;
use crate::backend::state::State;
use crate::config::StaleImageConfig;
use imaging::{Level, Pyramid};

/// Pyramid level on which rows are compared.
const COMPARED_LEVEL: usize = 1;

/// Last fresh image with the state of the body at its time.
#[derive(Clone, Debug)]
pub(crate) struct StaleImageDetector {
    level: Level,
    state: State,
}

impl StaleImageDetector {
    /// Takes the next image and the approximate current state. Returns the number of fresh rows
    /// from the top: normally all, and 0 for a repeated image.
    pub(crate) fn count_fresh_rows(
        config: &StaleImageConfig,
        last: &mut Option<Self>,
        image: &Pyramid,
        now: &State,
        camera: &Camera,
    ) -> usize {
        let all = image.levels.first().map_or(0, |level| level.height);
        let at = COMPARED_LEVEL.min(image.levels.len().saturating_sub(1));
        let Some(level) = image.levels.get(at) else {
            return all;
        };
        let mut fresh = all;
        if let Some(last) = last {
            let same = last.same_rows(config, level);
            if same >= config.min_same_rows.min(level.height) {
                let rotation = last.state.rotation.angle_to(&now.rotation);
                let translation = (last.state.position - now.position).norm();
                let px =
                    camera.left.model().fx * (rotation + translation / config.assumed_distance_m);
                let is_whole = same == level.height;
                if px > config.min_motion_px {
                    let rows = level.height - same;
                    fresh = rows.saturating_sub(config.margin_rows) << at;
                }
                if is_whole {
                    // The reference keeps its state: a frozen camera that moves slowly is detected
                    // later.
                    return fresh;
                }
            }
        }
        *last = Some(Self {
            level: level.clone(),
            state: *now,
        });
        fresh
    }

    /// Number of equal rows from the bottom.
    fn same_rows(&self, config: &StaleImageConfig, level: &Level) -> usize {
        if (self.level.width, self.level.height) != (level.width, level.height) {
            return 0;
        }
        let width = level.width.max(1);
        let rows = level.data.chunks_exact(width);
        let before = self.level.data.chunks_exact(width);
        let both = rows.rev().zip(before.rev());
        both.take_while(|(row, before)| {
            let pixels = row.iter().zip(*before);
            let difference: u64 = pixels.map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
            (difference as f64) < config.max_mean_difference * width as f64
        })
        .count()
    }
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;
    use imaging::ImageView;
    use nalgebra::Vector3;

    use super::*;
    use crate::test_rig;

    fn camera() -> Camera {
        Camera::new(&test_rig::stereo(0.1), &RigidTransform::identity())
    }

    /// First row of the lower part of a test image.
    const TORN_ROW: usize = 70;

    fn image(above: usize, below: usize) -> Pyramid {
        let pixels: Vec<u8> = (0..160 * 120)
            .map(|i| {
                let from = if i / 160 < TORN_ROW { above } else { below };
                ((i % 160 + from) * 37 / 8 + i / 160 * 11 / 4) as u8
            })
            .collect();
        Pyramid::new(
            &Default::default(),
            &ImageView::new(160, 120, 160, &pixels).expect("an image"),
        )
    }

    const ALL: usize = 120;

    fn at(x_m: f64) -> State {
        State {
            position: Vector3::new(x_m, 0.0, 0.0),
            ..State::at_rest(0)
        }
    }

    #[test]
    fn frozen_image_is_rejected_while_the_rig_moves() {
        let camera = camera();
        let mut last = None;
        let mut count_fresh_rows = |from: usize, x_m: f64| {
            StaleImageDetector::count_fresh_rows(
                &Default::default(),
                &mut last,
                &image(from, from),
                &at(x_m),
                &camera,
            )
        };
        assert_eq!(count_fresh_rows(0, 0.0), ALL);
        // At rest images may be equal.
        assert_eq!(count_fresh_rows(0, 0.01), ALL);
        assert_eq!(count_fresh_rows(9, 0.5), ALL);
        // While the camera is frozen.
        assert_eq!(count_fresh_rows(9, 0.7), 0);
        assert_eq!(count_fresh_rows(9, 1.4), 0);
        assert_eq!(count_fresh_rows(12, 1.5), ALL);
    }

    #[test]
    fn frozen_image_of_a_slow_rig_is_detected_later() {
        let camera = camera();
        let mut last = None;
        let steps = (0..20).map(|k| {
            let x_m = 0.02 * f64::from(k);
            StaleImageDetector::count_fresh_rows(
                &Default::default(),
                &mut last,
                &image(0, 0),
                &at(x_m),
                &camera,
            )
        });
        let fresh: Vec<usize> = steps.collect();
        assert_eq!((fresh[1], fresh[19]), (ALL, 0));
    }

    #[test]
    fn upper_part_of_a_torn_image_is_fresh() {
        let camera = camera();
        let mut last = None;
        StaleImageDetector::count_fresh_rows(
            &Default::default(),
            &mut last,
            &image(0, 0),
            &at(0.0),
            &camera,
        );
        let fresh = StaleImageDetector::count_fresh_rows(
            &Default::default(),
            &mut last,
            &image(9, 0),
            &at(0.5),
            &camera,
        );
        assert!((TORN_ROW - 24..TORN_ROW).contains(&fresh), "{fresh}");
        // The next image is torn at the same row and equals the last one below it.
        let fresh = StaleImageDetector::count_fresh_rows(
            &Default::default(),
            &mut last,
            &image(18, 0),
            &at(1.0),
            &camera,
        );
        assert!((TORN_ROW - 24..TORN_ROW).contains(&fresh), "{fresh}");
        assert_eq!(
            StaleImageDetector::count_fresh_rows(
                &Default::default(),
                &mut last,
                &image(27, 27),
                &at(1.5),
                &camera
            ),
            ALL
        );
    }
}
