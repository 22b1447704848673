//! Depth images as this crate takes them: a rectified view with its pose in the world.

use cad_transforms::RigidTransform;

use crate::error::TerrainError;

/// What a pixel may be used for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PixelClass {
    /// A surface of the static scene: fused.
    #[default]
    Static,
    /// Not known to be static: it only shows that the space before it is free.
    Unknown,
    /// Of a moving object, of the wearer or of shoes: not used.
    Excluded,
}

/// Motion of a view while its rows are exposed one after another, to first order in time.
///
/// The default is a global shutter, or a view at rest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RowMotion {
    /// Exposure of the topmost row after the time of the view's pose, s; negative if before.
    pub first_s: f64,
    /// Exposure of each row after that of the row above, s.
    pub row_s: f64,
    /// Velocity of the view in its own axes, m/s.
    pub velocity: [f64; 3],
    /// Angular rate of the view in its own axes, rad/s.
    pub angular_rate: [f64; 3],
}

/// A depth image of a rectified view: x right, y down, z along the optical axis.
///
/// Images are row-major. A pixel without depth is NaN or 0.
#[derive(Clone, Copy, Debug)]
pub struct DepthView<'a> {
    /// Columns and rows.
    pub size: [usize; 2],
    /// Focal lengths along columns and rows, px.
    pub focal_px: [f64; 2],
    /// Principal point, px; the center of the topmost left pixel is (0, 0).
    pub center_px: [f64; 2],
    /// Pose at time 0 of [`RowMotion`].
    pub world_from_view: RigidTransform,
    /// Rolling shutter.
    pub row_motion: RowMotion,
    /// One standard deviation of the position of the view relative to other views, m.
    pub pose_sigma_m: f64,
    /// Depths along the optical axis, m.
    pub depth_m: &'a [f32],
    /// One standard deviation of each depth, m.
    pub sigma_m: &'a [f32],
    /// Colors of the pixels, RGB.
    pub color: Option<&'a [[u8; 3]]>,
    /// Uses of the pixels; without, all are [`PixelClass::Static`].
    pub classes: Option<&'a [PixelClass]>,
}

/// A rigid transform in a form that is fast to apply.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pose {
    rows: [f64; 9],
    translation: [f64; 3],
}

impl Pose {
    pub(crate) fn new(transform: &RigidTransform) -> Self {
        Self {
            rows: transform.rotation_rows(),
            translation: transform.translation_m(),
        }
    }

    pub(crate) fn rotate(&self, v: [f64; 3]) -> [f64; 3] {
        let r = &self.rows;
        [0, 3, 6].map(|k| r[k] * v[0] + r[k + 1] * v[1] + r[k + 2] * v[2])
    }

    pub(crate) fn apply(&self, x: [f64; 3]) -> [f64; 3] {
        let rotated = self.rotate(x);
        [0, 1, 2].map(|k| rotated[k] + self.translation[k])
    }
}

impl RowMotion {
    /// Point of a row, in the view at time 0.
    pub fn at_pose(&self, row: f64, x: [f64; 3]) -> [f64; 3] {
        self.compensate(row, x, 1.0)
    }

    /// Point of the view at time 0, in the view of a row.
    pub fn at_row(&self, row: f64, x: [f64; 3]) -> [f64; 3] {
        self.compensate(row, x, -1.0)
    }

    /// Velocity of a point at rest in the world relative to the view, with opposite sign, m/s.
    pub(crate) fn speed_at(&self, x: [f64; 3]) -> [f64; 3] {
        let (v, w) = (&self.velocity, &self.angular_rate);
        [
            v[0] + w[1] * x[2] - w[2] * x[1],
            v[1] + w[2] * x[0] - w[0] * x[2],
            v[2] + w[0] * x[1] - w[1] * x[0],
        ]
    }

    /// Exposure of a row against time 0, s.
    pub(crate) fn time_s(&self, row: f64) -> f64 {
        self.first_s + self.row_s * row
    }

    fn compensate(&self, row: f64, x: [f64; 3], sign: f64) -> [f64; 3] {
        let time = sign * self.time_s(row);
        let speed = self.speed_at(x);
        [0, 1, 2].map(|k| x[k] + time * speed[k])
    }
}

impl DepthView<'_> {
    /// # Errors
    /// [`TerrainError::ImageSize`] and [`TerrainError::View`].
    pub fn validate(&self) -> Result<(), TerrainError> {
        let expected = self.size[0] * self.size[1];
        let sizes = [
            ("depth", Some(self.depth_m.len())),
            ("sigma", Some(self.sigma_m.len())),
            ("color", self.color.map(<[_]>::len)),
            ("classes", self.classes.map(<[_]>::len)),
        ];
        for (what, found) in sizes {
            if let Some(found) = found.filter(|found| *found != expected) {
                return Err(TerrainError::ImageSize {
                    what,
                    found,
                    expected,
                });
            }
        }
        let view = |what, found: f64, valid: bool, expected| match valid {
            true => Ok(()),
            false => Err(TerrainError::View {
                what,
                found,
                expected,
            }),
        };
        for (what, size) in [
            ("the number of columns", self.size[0]),
            ("of rows", self.size[1]),
        ] {
            view(
                what,
                size as f64,
                (8..=16_384).contains(&size),
                "8 to 16384",
            )?;
        }
        for focal in self.focal_px {
            view(
                "a focal length",
                focal,
                focal > 0.0 && focal.is_finite(),
                "above 0 px",
            )?;
        }
        let sigma = self.pose_sigma_m;
        view(
            "the sigma of the pose",
            sigma,
            sigma >= 0.0 && sigma.is_finite(),
            "0 m or more",
        )?;
        let motion = &self.row_motion;
        let numbers = self
            .center_px
            .iter()
            .chain(&motion.velocity)
            .chain(&motion.angular_rate);
        for number in numbers.chain(&[motion.first_s, motion.row_s]) {
            view(
                "a number of the view",
                *number,
                number.is_finite(),
                "a finite number",
            )?;
        }
        Ok(())
    }

    /// Direction of a pixel in the view, with depth 1.
    pub(crate) fn ray(&self, column: f64, row: f64) -> [f64; 3] {
        [
            (column - self.center_px[0]) / self.focal_px[0],
            (row - self.center_px[1]) / self.focal_px[1],
            1.0,
        ]
    }

    /// Depth and sigma of a pixel, if it has both.
    pub(crate) fn depth(&self, pixel: usize) -> Option<(f32, f32)> {
        let (depth, sigma) = (self.depth_m[pixel], self.sigma_m[pixel]);
        // False for NaN.
        (depth > 0.0 && sigma > 0.0 && depth < f32::MAX && sigma < f32::MAX)
            .then_some((depth, sigma))
    }

    pub(crate) fn class(&self, pixel: usize) -> PixelClass {
        self.classes
            .map_or(PixelClass::Static, |classes| classes[pixel])
    }

    /// Position in the world of a pixel at a depth; the pose is that of the view.
    pub(crate) fn position(&self, pose: &Pose, column: f64, row: f64, depth: f64) -> [f64; 3] {
        let x = self.ray(column, row).map(|v| v * depth);
        pose.apply(self.row_motion.at_pose(row, x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view<'a>(depth_m: &'a [f32], sigma_m: &'a [f32]) -> DepthView<'a> {
        DepthView {
            size: [8, 8],
            focal_px: [8.0; 2],
            center_px: [3.5; 2],
            world_from_view: RigidTransform::identity(),
            row_motion: RowMotion::default(),
            pose_sigma_m: 0.0,
            depth_m,
            sigma_m,
            color: None,
            classes: None,
        }
    }

    #[test]
    fn wrong_sizes_and_numbers_are_rejected() {
        let image = [1.0; 64];
        assert_eq!(view(&image, &image).validate(), Ok(()));
        let error = view(&image, &image[1..])
            .validate()
            .unwrap_err()
            .to_string();
        assert!(error.contains("63 values of sigma, expected 64"), "{error}");
        let flat = DepthView {
            focal_px: [8.0, 0.0],
            ..view(&image, &image)
        };
        assert!(
            flat.validate()
                .unwrap_err()
                .to_string()
                .contains("focal length is 0")
        );
        let mut moving = view(&image, &image);
        moving.row_motion.row_s = f64::NAN;
        assert!(moving.validate().is_err());
    }

    #[test]
    fn rows_are_transformed_to_the_pose() {
        let motion = RowMotion {
            first_s: -0.02,
            row_s: 1e-3,
            velocity: [0.0, 0.0, 1.0],
            angular_rate: [0.0, 0.1, 0.0],
        };
        let x = [0.5, 0.2, 4.0];
        assert_eq!(motion.at_pose(20.0, x), x);
        // 20 ms later: rotated by 2 mrad, 20 mm ahead.
        let later = motion.at_pose(40.0, x);
        for (found, expected) in later.iter().zip([0.508, 0.2, 4.019]) {
            assert!((found - expected).abs() < 1e-9, "{later:?}");
        }
    }
}
