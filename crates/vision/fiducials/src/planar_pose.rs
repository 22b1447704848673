//! Pose of a square from its corners in one eye, and the other pose that looks alike.

use cad_transforms::{RigidTransform, so3};
use camera_models::Lens;
use nalgebra::{Matrix2, Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};

use crate::square::{Square, distance};
use crate::tag::Tag;

/// The two poses of a tag in an eye that agree with its corners (in the order of [`Tag::corners`])
/// near its middle, the better one first. It is exact for exact corners; for those of a small tag
/// both may be as good. `None` if the corners are no convex square, or if the lens does not cover
/// them.
///
/// From the homography and its derivative at the middle of the tag, as Collins and Bartoli (2014)
/// do: unlike its perspective terms, these are well determined for small tags.
///
/// ```
/// use boards::Dictionary;
/// use cad_transforms::RigidTransform;
/// use camera_models::{CameraModel, Distortion, Lens};
/// use fiducials::{Tag, poses_from_corners};
///
/// let model = CameraModel::new((640, 480), [500.0, 500.0, 319.5, 239.5], Distortion::None);
/// let lens = Lens::new(&model);
/// let tag = Tag::new(Dictionary::AprilTag36h11, 0, 0.08).ok_or("a tag")?;
/// let truth = RigidTransform::from_rotation_vector([0.4, -0.3, 0.1], [0.05, -0.02, 0.8])?;
/// let corners = tag.corners().map(|corner| lens.project(truth.apply(corner)).unwrap());
/// let [pose, other] = poses_from_corners(&lens, &tag, &corners).ok_or("two poses")?;
/// assert!((truth.inverse() * pose).distance_m() < 1e-9);
/// assert!((truth.inverse() * other).angle_rad() > 0.5);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn poses_from_corners(
    lens: &Lens,
    tag: &Tag,
    corners: &[[f64; 2]; 4],
) -> Option<[RigidTransform; 2]> {
    let mut rays = [Vector3::zeros(); 4];
    for (ray, pixel) in rays.iter_mut().zip(corners) {
        *ray = Vector3::from(lens.unproject(*pixel)?);
    }
    // In a frame that looks at the middle of the tag. From bottom left, bottom right, top right,
    // top left to the unit square with x to the right and y down.
    let square_in = |turn: &Rotation3<f64>| {
        let at = rays.map(|ray| turn.inverse() * ray);
        let [bottom_left, bottom_right, top_right, top_left] = at.map(|p| [p.x / p.z, p.y / p.z]);
        Square::new([top_left, top_right, bottom_right, bottom_left])
    };
    let [x, y] = square_in(&Rotation3::identity())?.at([0.5; 2]);
    let bearing = Vector3::new(x, y, 1.0).normalize();
    let turn = Rotation3::rotation_between(&Vector3::z(), &bearing)?;
    let square = square_in(&turn)?;
    let slope = |k: usize| {
        let at = |by: f64| {
            let mut place = [0.5; 2];
            place[k] += by;
            Vector2::from(square.at(place))
        };
        (at(SLOPE_STEP) - at(-SLOPE_STEP)) / (2.0 * SLOPE_STEP)
    };
    let near = Matrix2::from_columns(&[slope(0), slope(1)]);
    let scale = near.singular_values().max();
    if scale <= 0.0 {
        return None;
    }
    let near = near / scale;
    let (a, b) = (near.column(0).into_owned(), near.column(1).into_owned());
    let [height_a, height_b] = [a, b].map(|c| (1.0 - c.norm_squared()).max(0.0).sqrt());
    let height_b = if a.dot(&b) > 0.0 { -height_b } else { height_b };
    let at = bearing * (tag.size_m / scale) / bearing.dot(&(turn * Vector3::z()));
    let pose = |sign: f64| {
        let first = Vector3::new(a.x, a.y, sign * height_a);
        let second = Vector3::new(b.x, b.y, sign * height_b);
        let third = first.cross(&second);
        let rotation = turn.matrix() * Matrix3::from_columns(&[first, second, third]);
        // Heights are of unit columns up to rounding.
        let svd = rotation.svd(true, true);
        let rows = (svd.u? * svd.v_t?).transpose();
        let rows = std::array::from_fn(|i| rows.as_slice()[i]);
        RigidTransform::from_rotation_rows(rows, at.into()).ok()
    };
    let [one, two] = [pose(1.0)?, pose(-1.0)?];
    let error = |pose: &RigidTransform| {
        let distance = |(corner, pixel): ([f64; 3], &[f64; 2])| {
            let found = lens.project(pose.apply(corner));
            found.map_or(f64::INFINITY, |found| distance(found, *pixel))
        };
        tag.corners()
            .into_iter()
            .zip(corners)
            .map(distance)
            .sum::<f64>()
    };
    Some(match error(&one) <= error(&two) {
        true => [one, two],
        false => [two, one],
    })
}

/// Step of the derivative at the middle, as a share of the side.
const SLOPE_STEP: f64 = 1e-4;

/// A plane tilted the other way about a point of it, as an eye sees it: nearly the same image.
/// `None` if it faces the eye exactly.
pub fn mirrored(eye_from_plane: &RigidTransform, middle: [f64; 3]) -> Option<RigidTransform> {
    let at = Vector3::from(eye_from_plane.apply(middle));
    let bearing = at.try_normalize(0.0)?;
    let normal = Vector3::from(eye_from_plane.rotate([0.0, 0.0, 1.0]));
    let axis = bearing.cross(&normal);
    let angle = libm::atan2(axis.norm(), bearing.dot(&normal));
    let turn = so3::exp(axis.try_normalize(1e-9)? * (-2.0 * angle));
    let rotation = UnitQuaternion::new_normalize((turn * eye_from_plane.rotation()).into_inner());
    let translation = at - rotation * Vector3::from(middle);
    let q = rotation.into_inner();
    RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], translation.into()).ok()
}
