//! How much of a picture is new.
//!
//! A camera that hangs gives its last picture again and again, with new times; one that is read while it is being written gives a picture
//! that is torn: new above, the last one below. Contract: rows at the bottom that are the same as in the picture before, although
//! the body has moved so far since that picture came that they cannot be, are not new. At rest pictures may well be the same.

use crate::backend::observation::Camera;
use crate::backend::state::State;
use crate::frontend::pyramid::{Level, Pyramid};

/// Two rows are the same when their pixels differ by less than this in the mean, grey levels. Encoders leave traces.
const MAX_MEAN_DIFFERENCE: f64 = 0.05;
/// Level on which rows are compared, and rows of it that a filter has mixed or a patch reaches over.
const COMPARED_LEVEL: usize = 1;
const MARGIN_ROWS: usize = 8;
/// Fewer rows that are the same are nothing: they may be black, or chance.
const MIN_SAME_ROWS: usize = 8;
/// By how much what is seen must have moved, px.
const MIN_MOTION_PX: f64 = 1.5;
/// At this distance, m: what is seen by a person who walks is rarely farther in all of a picture.
const ASSUMED_DISTANCE_M: f64 = 5.0;

/// A picture, and where the body was when it came.
#[derive(Clone, Debug)]
pub(crate) struct StaleImageDetector {
    level: Level,
    state: State,
}

impl StaleImageDetector {
    /// Takes a picture that was taken about where the body is now. Gives how many of its rows, from the top, are new: all
    /// as a rule, none if it is the last picture.
    pub(crate) fn count_fresh_rows(
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
            let same = last.same_rows(level);
            if same >= MIN_SAME_ROWS.min(level.height) {
                let rotation = last.state.rotation.angle_to(&now.rotation);
                let translation = (last.state.position - now.position).norm();
                let px = camera.left.model().fx * (rotation + translation / ASSUMED_DISTANCE_M);
                let is_whole = same == level.height;
                if px > MIN_MOTION_PX {
                    let rows = level.height - same;
                    fresh = rows.saturating_sub(MARGIN_ROWS) << at;
                }
                if is_whole {
                    // It is as old as it was: a camera that moves slowly will be found out later.
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

    /// How many rows, from the bottom, are the same.
    fn same_rows(&self, level: &Level) -> usize {
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
            (difference as f64) < MAX_MEAN_DIFFERENCE * width as f64
        })
        .count()
    }
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;
    use calib::verify::ImageView;
    use nalgebra::Vector3;

    use super::*;
    use crate::test_rig;

    fn camera() -> Camera {
        Camera::new(&test_rig::stereo(0.1), &RigidTransform::identity())
    }

    /// The row below which it may show something else.
    const TORN_ROW: usize = 70;

    fn image(above: usize, below: usize) -> Pyramid {
        let pixels: Vec<u8> = (0..160 * 120)
            .map(|i| {
                let from = if i / 160 < TORN_ROW { above } else { below };
                ((i % 160 + from) * 37 / 8 + i / 160 * 11 / 4) as u8
            })
            .collect();
        Pyramid::new(&ImageView::new(160, 120, 160, &pixels).expect("a picture"))
    }

    const ALL: usize = 120;

    fn at(x_m: f64) -> State {
        State {
            position: Vector3::new(x_m, 0.0, 0.0),
            ..State::at_rest(0)
        }
    }

    #[test]
    fn the_same_picture_from_elsewhere_is_not_new() {
        let camera = camera();
        let mut last = None;
        let mut count_fresh_rows = |from: usize, x_m: f64| {
            StaleImageDetector::count_fresh_rows(&mut last, &image(from, from), &at(x_m), &camera)
        };
        assert_eq!(count_fresh_rows(0, 0.0), ALL);
        // At rest it may be the same.
        assert_eq!(count_fresh_rows(0, 0.01), ALL);
        assert_eq!(count_fresh_rows(9, 0.5), ALL);
        // As long as the camera hangs.
        assert_eq!(count_fresh_rows(9, 0.7), 0);
        assert_eq!(count_fresh_rows(9, 1.4), 0);
        assert_eq!(count_fresh_rows(12, 1.5), ALL);
    }

    #[test]
    fn a_camera_that_hangs_and_moves_slowly_is_found_out_later() {
        let camera = camera();
        let mut last = None;
        let steps = (0..20).map(|k| {
            let x_m = 0.02 * f64::from(k);
            StaleImageDetector::count_fresh_rows(&mut last, &image(0, 0), &at(x_m), &camera)
        });
        let fresh: Vec<usize> = steps.collect();
        assert_eq!((fresh[1], fresh[19]), (ALL, 0));
    }

    #[test]
    fn of_a_torn_picture_the_upper_part_is_new() {
        let camera = camera();
        let mut last = None;
        StaleImageDetector::count_fresh_rows(&mut last, &image(0, 0), &at(0.0), &camera);
        let fresh =
            StaleImageDetector::count_fresh_rows(&mut last, &image(9, 0), &at(0.5), &camera);
        assert!((TORN_ROW - 24..TORN_ROW).contains(&fresh), "{fresh}");
        // The next one is torn at the same row, from there on as the last.
        let fresh =
            StaleImageDetector::count_fresh_rows(&mut last, &image(18, 0), &at(1.0), &camera);
        assert!((TORN_ROW - 24..TORN_ROW).contains(&fresh), "{fresh}");
        assert_eq!(
            StaleImageDetector::count_fresh_rows(&mut last, &image(27, 27), &at(1.5), &camera),
            ALL
        );
    }
}
