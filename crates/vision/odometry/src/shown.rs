//! How much of a picture is new.
//!
//! A camera that hangs gives its last picture again and again, with new times; one that is read while it is being written gives a picture
//! that is torn: new above, the last one below. Contract: rows at the bottom that are the same as in the picture before, although
//! the body has moved so far since that picture came that they cannot be, are not new. At rest pictures may well be the same.

use crate::pyramid::{Level, Pyramid};
use crate::sight::Camera;
use crate::state::State;

/// Two rows are the same when their pixels differ by less than this in the mean, grey levels. Encoders leave traces.
const SAME: f64 = 0.05;
/// Level on which rows are compared, and rows of it that a filter has mixed or a patch reaches over.
const LEVEL: usize = 1;
const MIXED: usize = 8;
/// Fewer rows that are the same are nothing: they may be black, or chance.
const FEWEST: usize = 8;
/// By how much what is seen must have moved, px.
const MOVED_PX: f64 = 1.5;
/// At this distance, m: what is seen by a person who walks is rarely farther in all of a picture.
const AT_M: f64 = 5.0;

/// A picture, and where the body was when it came.
#[derive(Clone, Debug)]
pub(crate) struct Shown {
    level: Level,
    state: State,
}

impl Shown {
    /// Takes a picture that was taken about where the body is now. Gives how many of its rows, from the top, are new: all
    /// as a rule, none if it is the last picture.
    pub(crate) fn take(
        last: &mut Option<Self>,
        picture: &Pyramid,
        now: &State,
        camera: &Camera,
    ) -> usize {
        let all = picture.levels.first().map_or(0, |level| level.height);
        let at = LEVEL.min(picture.levels.len().saturating_sub(1));
        let Some(level) = picture.levels.get(at) else {
            return all;
        };
        let mut fresh = all;
        if let Some(last) = last {
            let same = last.same_rows(level);
            if same >= FEWEST.min(level.height) {
                let turned = last.state.turn.angle_to(&now.turn);
                let moved = (last.state.position - now.position).norm();
                let px = camera.left.model().fx * (turned + moved / AT_M);
                let is_whole = same == level.height;
                if px > MOVED_PX {
                    let rows = level.height - same;
                    fresh = rows.saturating_sub(MIXED) << at;
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
            let off: u64 = pixels.map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
            (off as f64) < SAME * width as f64
        })
        .count()
    }
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;
    use calib::verify::Grey;
    use nalgebra::Vector3;

    use super::*;
    use crate::made;

    fn camera() -> Camera {
        Camera::new(&made::stereo(0.1), &RigidTransform::identity())
    }

    /// The row below which it may show something else.
    const TORN: usize = 70;

    fn picture(above: usize, below: usize) -> Pyramid {
        let pixels: Vec<u8> = (0..160 * 120)
            .map(|i| {
                let from = if i / 160 < TORN { above } else { below };
                ((i % 160 + from) * 37 / 8 + i / 160 * 11 / 4) as u8
            })
            .collect();
        Pyramid::new(&Grey::new(160, 120, 160, &pixels).expect("a picture"))
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
        let mut take =
            |from: usize, x_m: f64| Shown::take(&mut last, &picture(from, from), &at(x_m), &camera);
        assert_eq!(take(0, 0.0), ALL);
        // At rest it may be the same.
        assert_eq!(take(0, 0.01), ALL);
        assert_eq!(take(9, 0.5), ALL);
        // As long as the camera hangs.
        assert_eq!(take(9, 0.7), 0);
        assert_eq!(take(9, 1.4), 0);
        assert_eq!(take(12, 1.5), ALL);
    }

    #[test]
    fn a_camera_that_hangs_and_moves_slowly_is_found_out_later() {
        let camera = camera();
        let mut last = None;
        let steps = (0..20).map(|k| {
            let x_m = 0.02 * f64::from(k);
            Shown::take(&mut last, &picture(0, 0), &at(x_m), &camera)
        });
        let fresh: Vec<usize> = steps.collect();
        assert_eq!((fresh[1], fresh[19]), (ALL, 0));
    }

    #[test]
    fn of_a_torn_picture_the_upper_part_is_new() {
        let camera = camera();
        let mut last = None;
        Shown::take(&mut last, &picture(0, 0), &at(0.0), &camera);
        let fresh = Shown::take(&mut last, &picture(9, 0), &at(0.5), &camera);
        assert!((TORN - 24..TORN).contains(&fresh), "{fresh}");
        // The next one is torn at the same row, from there on as the last.
        let fresh = Shown::take(&mut last, &picture(18, 0), &at(1.0), &camera);
        assert!((TORN - 24..TORN).contains(&fresh), "{fresh}");
        assert_eq!(
            Shown::take(&mut last, &picture(27, 27), &at(1.5), &camera),
            ALL
        );
    }
}
