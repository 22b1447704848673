//! Whether a picture is a new one.
//!
//! A camera that hangs gives its last picture again and again, with new times. Contract: a picture that is the same as the one before,
//! although the body has moved so far meanwhile that it cannot be, is none. At rest pictures may well be the same.

use crate::pyramid::Pyramid;
use crate::sight::Camera;
use crate::state::State;

/// Two pictures are the same when their pixels differ by less than this in the mean, grey levels. Encoders leave traces.
const SAME: f64 = 0.05;
/// By how much what is seen must have moved, px.
const MOVED_PX: f64 = 1.5;
/// At this distance, m: what is seen by a person who walks is rarely farther in all of a picture.
const AT_M: f64 = 5.0;

/// A picture that was new, and where the body was.
#[derive(Clone, Debug)]
pub(crate) struct Shown {
    /// The coarsest level.
    pixels: Vec<u8>,
    state: State,
}

impl Shown {
    /// Takes a picture that was taken about where the body is now; false if it is not a new one.
    pub(crate) fn take(
        last: &mut Option<Self>,
        picture: &Pyramid,
        now: &State,
        camera: &Camera,
    ) -> bool {
        let Some(level) = picture.levels.last() else {
            return true;
        };
        if let Some(last) = last {
            let turned = last.state.turn.angle_to(&now.turn);
            let moved = (last.state.position - now.position).norm();
            let px = camera.left.model().fx * (turned + moved / AT_M);
            if px > MOVED_PX && last.is_same(&level.data) {
                return false;
            }
        }
        *last = Some(Self {
            pixels: level.data.clone(),
            state: *now,
        });
        true
    }

    fn is_same(&self, pixels: &[u8]) -> bool {
        let both = self.pixels.iter().zip(pixels);
        let sum: u64 = both.map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        self.pixels.len() == pixels.len() && (sum as f64) < SAME * pixels.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;
    use calib::verify::Grey;
    use calib::{CameraModel, Distortion};
    use nalgebra::Vector3;

    use super::*;
    use crate::rig::StereoCamera;

    fn camera() -> Camera {
        let lens = CameraModel {
            width: 160,
            height: 120,
            fx: 100.0,
            fy: 100.0,
            cx: 79.5,
            cy: 59.5,
            distortion: Distortion::None,
        };
        let camera = StereoCamera {
            name: "front".to_owned(),
            left: lens,
            right: lens,
            rig_from_left: RigidTransform::identity(),
            right_from_left: RigidTransform::from_translation_m([-0.1, 0.0, 0.0]).expect("finite"),
            line_s: 0.0,
        };
        Camera::new(&camera, &RigidTransform::identity())
    }

    fn picture(from: usize) -> Pyramid {
        let pixels: Vec<u8> = (0..160 * 120)
            .map(|i| ((i % 160 + from) * 37 / 8 + i / 160 * 11 / 4) as u8)
            .collect();
        Pyramid::new(&Grey::new(160, 120, 160, &pixels).expect("a picture"))
    }

    #[test]
    fn the_same_picture_from_elsewhere_is_not_new() {
        let camera = camera();
        let at = |x_m: f64| State {
            position: Vector3::new(x_m, 0.0, 0.0),
            ..State::at_rest(0)
        };
        let mut last = None;
        let mut take =
            |from: usize, x_m: f64| Shown::take(&mut last, &picture(from), &at(x_m), &camera);
        assert!(take(0, 0.0));
        // At rest it may be the same.
        assert!(take(0, 0.01));
        assert!(take(9, 0.5));
        // As long as the camera hangs.
        assert!(!take(9, 0.7));
        assert!(!take(9, 1.4));
        assert!(take(12, 1.5));
    }
}
