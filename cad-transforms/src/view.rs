//! Field of view of a camera: the pyramid of its image.
//!
//! Contract: plain geometry in the optical frame (x right, y down, z forward). This crate knows
//! nothing of lenses; a caller that has a calibration gives tangents. A lens that bends straight
//! lines sees a little more than the pyramid of its camera matrix, so a point inside is in the
//! image, and one just outside may be too.

use crate::transform::RigidTransform;

/// A field of view as the tangents of the angles from the optical axis to the image's edges, each
/// above 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldOfView {
    /// To the left edge.
    pub left: f64,
    /// To the right edge.
    pub right: f64,
    /// To the upper edge.
    pub up: f64,
    /// To the lower edge.
    pub down: f64,
}

impl FieldOfView {
    /// Even to both sides: whole angles, degrees, each between 0 and 180. `None` for others.
    pub(crate) fn from_degrees(horizontal: f64, vertical: f64) -> Option<Self> {
        let half = |angle: f64| {
            let possible = angle > 0.0 && angle < 180.0;
            possible.then(|| (0.5 * angle).to_radians().tan())
        };
        let (x, y) = (half(horizontal)?, half(vertical)?);
        Some(Self {
            left: x,
            right: x,
            up: y,
            down: y,
        })
    }

    /// Of a camera matrix and an image of this size in pixels, integers being the pixels' centres.
    /// `None` where the centre is outside the image or a number is not finite.
    pub fn from_pinhole(size: [u32; 2], focal: [f64; 2], centre: [f64; 2]) -> Option<Self> {
        let edge = |axis: usize| {
            let low = (centre[axis] + 0.5) / focal[axis];
            let high = (f64::from(size[axis]) - 0.5 - centre[axis]) / focal[axis];
            let possible = |v: f64| v.is_finite() && v > 0.0;
            (possible(low) && possible(high)).then_some([low, high])
        };
        let ([left, right], [up, down]) = (edge(0)?, edge(1)?);
        Some(Self {
            left,
            right,
            up,
            down,
        })
    }

    /// Angle of the point outside the nearest edge, rad, below 0 for a point inside; `None` behind
    /// the camera.
    pub fn beyond(&self, [x, y, z]: [f64; 3]) -> Option<f64> {
        let over = |v: f64, low: f64, high: f64| {
            let angle = (v / z).atan();
            (angle - high.atan()).max(-angle - low.atan())
        };
        (z > 0.0).then(|| over(x, self.left, self.right).max(over(y, self.up, self.down)))
    }

    /// Directions to the corners at a depth of 1: upper left, upper right, lower right, lower left.
    pub fn corners(&self) -> [[f64; 3]; 4] {
        [
            [-self.left, -self.up, 1.0],
            [self.right, -self.up, 1.0],
            [self.right, self.down, 1.0],
            [-self.left, self.down, 1.0],
        ]
    }

    /// Where the corners' rays meet the level plane at height `z_m` of frame `b`, if all four do:
    /// in `b`.
    pub fn on_level(&self, b_from_camera: &RigidTransform, z_m: f64) -> Option<[[f64; 3]; 4]> {
        let eye = b_from_camera.translation_m();
        let mut corners = [[0.0; 3]; 4];
        for (corner, ray) in corners.iter_mut().zip(self.corners()) {
            let ray = b_from_camera.rotate(ray);
            let along = (z_m - eye[2]) / ray[2];
            if !(along.is_finite() && along > 0.0) {
                return None;
            }
            *corner = std::array::from_fn(|i| eye[i] + along * ray[i]);
        }
        Some(corners)
    }

    /// Whole angles, horizontal and vertical, degrees.
    pub fn degrees(&self) -> [f64; 2] {
        let whole = |a: f64, b: f64| (a.atan() + b.atan()).to_degrees();
        [whole(self.left, self.right), whole(self.up, self.down)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_are_where_they_should_be() {
        let view = FieldOfView::from_degrees(90.0, 60.0).unwrap();
        assert!(view.beyond([0.99, 0.5, 1.0]).unwrap() < 0.0);
        assert!(view.beyond([1.01, 0.5, 1.0]).unwrap() > 0.0);
        assert!(view.beyond([0.0, 0.6, 1.0]).unwrap() > 0.0);
        assert_eq!(view.beyond([0.0, 0.0, -1.0]), None);
        let beyond = view
            .beyond([2.0, 0.0, 2.0 / 50_f64.to_radians().tan() * 1.0])
            .unwrap();
        assert!((beyond.to_degrees() - 5.0).abs() < 1e-9, "{beyond}");
        assert!((view.degrees()[1] - 60.0).abs() < 1e-12);
        // The edge of the first pixel is half a pixel before its centre.
        let view = FieldOfView::from_pinhole([100, 50], [50.0, 50.0], [49.5, 24.5]).unwrap();
        assert_eq!(
            [view.left, view.right, view.up, view.down],
            [1.0, 1.0, 0.5, 0.5]
        );
        assert!(FieldOfView::from_pinhole([100, 50], [50.0, 0.0], [49.5, 24.5]).is_none());
        assert!(FieldOfView::from_degrees(180.0, 20.0).is_none());
    }

    #[test]
    fn the_image_on_the_ground() {
        // 2 m up, looking straight down, the image's right along y.
        let world_from_camera = RigidTransform::from_rotation_rows(
            [0., 1., 0., 1., 0., 0., 0., 0., -1.],
            [0.5, 0.0, 2.0],
        )
        .unwrap();
        let view = FieldOfView::from_degrees(90.0, 90.0).unwrap();
        let corners = view.on_level(&world_from_camera, 0.0).unwrap();
        assert!(
            (corners[0][0] + 1.5).abs() < 1e-12 && (corners[0][1] + 2.0).abs() < 1e-12,
            "{corners:?}"
        );
        let up = RigidTransform::from_translation_m([0.0, 0.0, 2.0]).unwrap();
        assert!(view.on_level(&up, 0.0).is_none());
    }
}
