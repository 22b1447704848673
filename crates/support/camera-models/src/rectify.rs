//! Stereo rectification: rotates a pair so that corresponding points share a row.
//!
//! Contract: both rectified images belong to one pinhole camera without distortion, the right one
//! displaced along x, so that a point of depth `z` has the disparity `f B / z`. Each eye is rotated
//! by half of the rotation between them, then both by the smallest rotation that aligns the
//! baseline with x (after Bouguet, as in OpenCV's `stereoRectify`), so that the images change as
//! little as possible. Field of view and focal length are selected by [`View`].
//!
//! [`Rectification::map`] gives for every rectified pixel the position in the source image, as
//! `f32`, within [`Map::BOUND_PX`] of the exact one; [`Rectification::exact_map`] is its reference
//! implementation. [`Remap`] applies a map to 8-bit images. Rectified pixels without a source are
//! NaN in a map and get a fill value in an image.

use cad_transforms::{RigidTransform, so3};
use nalgebra::{UnitQuaternion, Vector3};

use crate::camera::{CameraModel, Distortion};
use crate::lens::Lens;
use crate::stereo::{Eye, Provenance, StereoCalibration};

mod map;
mod remap;
#[cfg(test)]
mod tests;

pub use map::Map;
pub use remap::{Remap, remap_exact};

/// Field of view of the rectified images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum View {
    /// Every pixel of both source images, up to 75 degrees off the new axis: the borders may be
    /// empty.
    All,
    /// The largest view in which every pixel of both rectified images has a source.
    Filled,
    /// This focal length, pixels, centred as [`View::Filled`].
    Focal(f64),
}

/// A rectified pair.
///
/// The same point in both images of a pair whose right eye is rotated, and its distance from the
/// disparity:
///
/// ```
/// # use cad_transforms::RigidTransform;
/// # use camera_models::{CameraModel, Distortion, Eye, Lens, StereoCalibration};
/// # use camera_models::rectify::{Rectification, View};
/// # use camera_models::Provenance;
///
/// let distortion = Distortion::RadTan4 { k1: -0.1, k2: 0.01, p1: 0.0, p2: 0.0 };
/// let model = CameraModel::new((640, 480), [500.0, 500.0, 319.5, 239.5], distortion);
/// let stereo = StereoCalibration {
///     left: model,
///     right: model,
///     right_from_left: RigidTransform::from_rotation_vector([0.02, -0.01, 0.03], [-0.063, 0.001, 0.0])?,
///     imu: None,
/// #     provenance: Provenance { format: None, files: Vec::new(), part: None },
/// };
/// let rectified = Rectification::new(&stereo, View::Filled)?;
///
/// let in_left = [0.1, -0.2, 1.5];
/// let lens = Lens::new(&model);
/// let old = [lens.project(in_left), lens.project(stereo.right_from_left.apply(in_left))];
/// let left = rectified.new_pixel(Eye::Left, old[0].ok_or("outside")?).ok_or("outside")?;
/// let right = rectified.new_pixel(Eye::Right, old[1].ok_or("outside")?).ok_or("outside")?;
/// assert!((left[1] - right[1]).abs() < 1e-6); // one row
/// let depth_m = rectified.camera.fx * rectified.baseline_m / (left[0] - right[0]);
/// let expected = rectified.rectified_from_left.rotate(in_left)[2];
/// assert!((depth_m - expected).abs() < 1e-6, "{depth_m} m");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Rectification {
    /// The camera model of both rectified images.
    pub camera: CameraModel,
    /// Rotates points from the left optical frame into the rectified one; no translation.
    pub rectified_from_left: RigidTransform,
    /// The same for the right one.
    pub rectified_from_right: RigidTransform,
    /// Baseline, metres.
    pub baseline_m: f64,
    lenses: [Lens; 2],
}

/// Reasons for a failed rectification.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RectifyError {
    /// The right camera is not beside the left one.
    #[error(
        "rectifying: the right camera lies {angle_deg:.0} degrees off the left one's x axis, expected at most 45"
    )]
    NotBeside {
        /// Angle between x and the baseline, degrees.
        angle_deg: f64,
    },
    /// The two have no common field of view.
    #[error("rectifying: the two images do not overlap on the rectified plane")]
    NothingInCommon,
    /// Invalid size or focal length.
    #[error(
        "rectifying: found a size of {width}x{height} and a focal length of {focal}, expected both above 0"
    )]
    Impossible {
        /// Requested width, pixels.
        width: u32,
        /// Requested height, pixels.
        height: u32,
        /// Focal length, pixels.
        focal: f64,
    },
}

/// Maximum angle off the new axis for [`View::All`]: an image on a plane grows without bound.
const MAX_ANGLE_RAD: f64 = 75.0 * std::f64::consts::PI / 180.0;
/// Points along one side of a tested rectangle, and of the grid over an image.
const SIDE: usize = 96;

impl Rectification {
    /// Rectifies to images of the left one's size.
    ///
    /// # Errors
    /// [`RectifyError`].
    pub fn new(stereo: &StereoCalibration, view: View) -> Result<Self, RectifyError> {
        Self::with_size(stereo, view, [stereo.left.width, stereo.left.height])
    }

    /// Rectifies to images of another size.
    ///
    /// # Errors
    /// [`RectifyError`].
    pub fn with_size(
        stereo: &StereoCalibration,
        view: View,
        [width, height]: [u32; 2],
    ) -> Result<Self, RectifyError> {
        let (rectified_from_left, rectified_from_right) = rotations(stereo)?;
        let mut rectification = Self {
            camera: CameraModel {
                width,
                height,
                fx: 1.0,
                fy: 1.0,
                cx: 0.0,
                cy: 0.0,
                distortion: Distortion::None,
            },
            rectified_from_left,
            rectified_from_right,
            baseline_m: stereo.baseline_m(),
            lenses: [Lens::new(&stereo.left), Lens::new(&stereo.right)],
        };
        let (centre, focal) = match view {
            View::All => rectification.all(),
            View::Filled => rectification.filled(),
            View::Focal(focal) => rectification.middle().map(|centre| (centre, focal)),
        }
        .ok_or(RectifyError::NothingInCommon)?;
        if width < 2 || height < 2 || !(focal > 0.0 && focal.is_finite()) {
            return Err(RectifyError::Impossible {
                width,
                height,
                focal,
            });
        }
        let camera = &mut rectification.camera;
        (camera.fx, camera.fy) = (focal, focal);
        camera.cx = 0.5 * (f64::from(width) - 1.0) - focal * centre[0];
        camera.cy = 0.5 * (f64::from(height) - 1.0) - focal * centre[1];
        Ok(rectification)
    }

    /// The rectified pair.
    pub fn stereo(&self) -> StereoCalibration {
        StereoCalibration {
            left: self.camera,
            right: self.camera,
            right_from_left: RigidTransform::from_translation_m([-self.baseline_m, 0.0, 0.0])
                .expect("a baseline is finite"),
            imu: None,
            provenance: Provenance {
                format: None,
                files: Vec::new(),
                part: None,
            },
        }
    }

    /// 3x4 projection matrix of the left camera in the rectified frame, row-major.
    pub fn left_projection(&self) -> [f64; 12] {
        let c = &self.camera;
        [
            c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0,
        ]
    }

    /// The same for the right one; entry 3 is `-fx` times the baseline.
    pub fn right_projection(&self) -> [f64; 12] {
        let mut p = self.left_projection();
        p[3] = -self.camera.fx * self.baseline_m;
        p
    }

    /// Source pixel of a rectified pixel; `None` outside the domain of the lens.
    pub fn old_pixel(&self, eye: Eye, new: [f64; 2]) -> Option<[f64; 2]> {
        let c = &self.camera;
        self.on_old(eye, [(new[0] - c.cx) / c.fx, (new[1] - c.cy) / c.fy])
    }

    /// Rectified pixel of a source pixel; `None` behind the rectified plane or without a direction.
    pub fn new_pixel(&self, eye: Eye, old: [f64; 2]) -> Option<[f64; 2]> {
        let [x, y] = self.on_plane(eye, old)?;
        let c = &self.camera;
        Some([c.fx * x + c.cx, c.fy * y + c.cy])
    }

    /// Source positions of all rectified pixels.
    pub fn map(&self, eye: Eye) -> Map {
        let c = &self.camera;
        Map::interpolated(c.width, c.height, |new| self.old_pixel(eye, new))
    }

    /// The same, every position computed exactly.
    pub fn exact_map(&self, eye: Eye) -> Map {
        let c = &self.camera;
        Map::exact(c.width, c.height, |new| self.old_pixel(eye, new))
    }

    fn turn(&self, eye: Eye) -> (&RigidTransform, &Lens) {
        match eye {
            Eye::Left => (&self.rectified_from_left, &self.lenses[0]),
            Eye::Right => (&self.rectified_from_right, &self.lenses[1]),
        }
    }

    /// From the rectified plane z = 1 to a source pixel.
    fn on_old(&self, eye: Eye, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let (turn, lens) = self.turn(eye);
        let direction = turn.rotation().inverse() * Vector3::new(x, y, 1.0);
        lens.project(direction.into())
    }

    /// From a source pixel to the rectified plane z = 1.
    fn on_plane(&self, eye: Eye, old: [f64; 2]) -> Option<[f64; 2]> {
        let (turn, lens) = self.turn(eye);
        let [x, y, z] = turn.rotate(lens.unproject(old)?);
        (z > 0.0).then(|| [x / z, y / z])
    }

    /// Whether a point of the plane is inside both source images.
    fn both_see(&self, point: [f64; 2]) -> bool {
        [Eye::Left, Eye::Right].into_iter().all(|eye| {
            let (_, lens) = self.turn(eye);
            let m = lens.model();
            let inside = |c: f64, size: u32| c >= 0.0 && c <= f64::from(size) - 1.0;
            self.on_old(eye, point)
                .is_some_and(|[x, y]| inside(x, m.width) && inside(y, m.height))
        })
    }

    /// Centre of the common field of view, on the plane.
    fn middle(&self) -> Option<[f64; 2]> {
        let principal = |eye: Eye| {
            let (_, lens) = self.turn(eye);
            self.on_plane(eye, [lens.model().cx, lens.model().cy])
        };
        let (left, right) = (principal(Eye::Left)?, principal(Eye::Right)?);
        let mut centre = [0.5 * (left[0] + right[0]), 0.5 * (left[1] + right[1])];
        if !self.both_see(centre) {
            return None;
        }
        let widest = MAX_ANGLE_RAD.tan();
        for _ in 0..4 {
            for axis in 0..2 {
                let reach = |sign: f64| {
                    last(widest, |step| {
                        let mut point = centre;
                        point[axis] += sign * step;
                        self.both_see(point)
                    })
                };
                centre[axis] += 0.5 * (reach(1.0) - reach(-1.0));
            }
        }
        Some(centre)
    }

    /// Centre and focal length at which every rectified pixel has a source.
    fn filled(&self) -> Option<([f64; 2], f64)> {
        let centre = self.middle()?;
        // Half the size of the rectified image at a focal length of 1, between the outer pixel
        // centres.
        let half = [self.camera.width, self.camera.height].map(|n| 0.5 * (f64::from(n) - 1.0));
        // The field of view has no holes, so that a rectangle is filled if its edge is.
        let is_filled = |scale: f64| {
            (0..4 * SIDE).all(|i| {
                let along = 2.0 * (i % SIDE) as f64 / SIDE as f64 - 1.0;
                let [x, y] = match i / SIDE {
                    0 => [along, -1.0],
                    1 => [1.0, along],
                    2 => [-along, 1.0],
                    _ => [-1.0, -along],
                };
                self.both_see([
                    centre[0] + x * half[0] * scale,
                    centre[1] + y * half[1] * scale,
                ])
            })
        };
        let scale = last(
            MAX_ANGLE_RAD.tan() / half[0].min(half[1]).max(1.0),
            is_filled,
        );
        (scale > 0.0).then(|| (centre, 1.0 / scale))
    }

    /// Centre and focal length at which all source pixels are in the rectified images.
    fn all(&self) -> Option<([f64; 2], f64)> {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for eye in [Eye::Left, Eye::Right] {
            let (_, lens) = self.turn(eye);
            let m = *lens.model();
            for i in 0..(SIDE + 1) * (SIDE + 1) {
                let part = |i: usize, size: u32| i as f64 / SIDE as f64 * f64::from(size) - 0.5;
                let old = [
                    part(i % (SIDE + 1), m.width),
                    part(i / (SIDE + 1), m.height),
                ];
                let Some(point) = self.on_plane(eye, old) else {
                    continue;
                };
                if point[0].hypot(point[1]) > MAX_ANGLE_RAD.tan() {
                    continue;
                }
                for axis in 0..2 {
                    low[axis] = low[axis].min(point[axis]);
                    high[axis] = high[axis].max(point[axis]);
                }
            }
        }
        let (width, height) = (high[0] - low[0], high[1] - low[1]);
        (width > 0.0 && height > 0.0).then(|| {
            let c = &self.camera;
            let focal = (f64::from(c.width) / width).min(f64::from(c.height) / height);
            ([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])], focal)
        })
    }
}

/// `rectified_from_left` and `rectified_from_right`: the rotations of [`Rectification`] alone.
///
/// # Errors
/// [`RectifyError::NotBeside`].
pub fn rotations(
    stereo: &StereoCalibration,
) -> Result<(RigidTransform, RigidTransform), RectifyError> {
    let full = stereo.right_from_left.rotation();
    let half = so3::exp(0.5 * so3::log(full));
    // Position of the right camera in the left one, in the frame half-way between the two.
    let beside = -(half.inverse() * stereo.right_from_left.translation());
    let angle = beside.angle(&Vector3::x());
    let not_beside = RectifyError::NotBeside {
        angle_deg: angle.to_degrees(),
    };
    if !(beside.norm() > 0.0 && angle <= std::f64::consts::FRAC_PI_4) {
        return Err(not_beside);
    }
    let onto_x = so3::between(&beside, &Vector3::x()).ok_or(not_beside)?;
    let rigid = |q: UnitQuaternion<f64>| {
        RigidTransform::from_rotation_vector(so3::log(&q).into(), [0.0; 3])
            .expect("a rotation is finite")
    };
    Ok((rigid(onto_x * half), rigid(onto_x * half.inverse())))
}

/// The largest step up to `end` for which a monotonic property holds; to 1e-9 of `end`.
fn last(end: f64, holds: impl Fn(f64) -> bool) -> f64 {
    if holds(end) {
        return end;
    }
    let (mut good, mut bad) = (0.0, end);
    for _ in 0..30 {
        let middle = 0.5 * (good + bad);
        if holds(middle) {
            good = middle;
        } else {
            bad = middle;
        }
    }
    good
}
