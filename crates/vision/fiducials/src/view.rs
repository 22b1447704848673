//! Images in which a tag is looked for, and where their pixels meet its plane.

use cad_transforms::{RigidTransform, so3};
use camera_models::Lens;
use imaging::ImageView;
use nalgebra::{Matrix3, Vector3};

use crate::tag::Tag;

/// An image of one eye, in a reference frame in which the eyes are at rest.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The image as recorded.
    pub image: ImageView<'a>,
    /// Its lens.
    pub lens: &'a Lens,
    /// Takes points of the reference frame to the eye, m.
    pub eye_from_reference: RigidTransform,
    /// Time from row to row, s; 0 for a global shutter.
    pub line_s: f64,
    /// Exposure of a row, s; 0 if unknown.
    pub exposure_s: f64,
}

impl View<'_> {
    /// Time of a row after the middle one, s.
    pub(crate) fn row_s(&self, row: usize) -> f64 {
        self.line_s * (row as f64 - 0.5 * (self.image.height() as f64 - 1.0))
    }
}

/// Motion of a tag in the reference frame at the middle row of the images.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Velocity of its middle, m/s.
    pub linear: [f64; 3],
    /// Angular rate, rad/s.
    pub angular: [f64; 3],
}

/// A tag as an eye sees it in one row: rays of the eye in the frame of the tag.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RowPose {
    tag_from_eye: Matrix3<f64>,
    /// The eye in the frame of the tag, m.
    eye_in_tag: Vector3<f64>,
}

/// The poses of a tag in the rows of an eye, over rows in which it hardly turns.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RowPoses {
    first: RowPose,
    first_row: f64,
    /// Change per row.
    tag_from_eye: Matrix3<f64>,
    eye_in_tag: Vector3<f64>,
}

impl RowPoses {
    /// From the poses in two rows: between them matrices are interpolated, which is wrong by the
    /// square of the rotation from one to the other, less than 1e-4.
    pub(crate) fn new(
        view: &View<'_>,
        reference_from_tag: &RigidTransform,
        motion: &Motion,
        [first_row, last_row]: [usize; 2],
    ) -> Self {
        let at = |row| RowPose::new(view, reference_from_tag, motion, view.row_s(row));
        let first = at(first_row);
        let is_still = *motion == Motion::default() || view.line_s == 0.0;
        let (tag_from_eye, eye_in_tag) = match is_still || first_row == last_row {
            true => (Matrix3::zeros(), Vector3::zeros()),
            false => {
                let last = at(last_row);
                let share = 1.0 / (last_row as f64 - first_row as f64);
                (
                    (last.tag_from_eye - first.tag_from_eye) * share,
                    (last.eye_in_tag - first.eye_in_tag) * share,
                )
            }
        };
        Self {
            first,
            first_row: first_row as f64,
            tag_from_eye,
            eye_in_tag,
        }
    }

    /// Rays of the eye in the frame of the tag, and the eye there, in the first row.
    pub(crate) fn first(&self) -> (&Matrix3<f64>, &Vector3<f64>) {
        (&self.first.tag_from_eye, &self.first.eye_in_tag)
    }

    /// Change of these per row.
    pub(crate) fn by_row(&self) -> (&Matrix3<f64>, &Vector3<f64>) {
        (&self.tag_from_eye, &self.eye_in_tag)
    }

    /// The first row.
    pub(crate) fn first_row(&self) -> f64 {
        self.first_row
    }

    /// The pose in a row.
    #[cfg(test)]
    pub(crate) fn at(&self, row: usize) -> RowPose {
        let rows = row as f64 - self.first_row;
        RowPose {
            tag_from_eye: self.first.tag_from_eye + self.tag_from_eye * rows,
            eye_in_tag: self.first.eye_in_tag + self.eye_in_tag * rows,
        }
    }
}

/// Where a ray meets the plane of a tag.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlanePoint {
    /// Place on the plane, m.
    pub(crate) at: [f64; 2],
    /// Slope of the ray in the frame of the tag: x and y per z.
    #[cfg(test)]
    pub(crate) slope: [f64; 2],
}

impl RowPose {
    /// The pose of a tag in an eye, `time_s` after the middle row.
    pub(crate) fn new(
        view: &View<'_>,
        reference_from_tag: &RigidTransform,
        motion: &Motion,
        time_s: f64,
    ) -> Self {
        let turn = so3::exp(Vector3::from(motion.angular) * time_s);
        let rotation = view.eye_from_reference.rotation() * turn * reference_from_tag.rotation();
        let moved = reference_from_tag.translation() + Vector3::from(motion.linear) * time_s;
        let at = Vector3::from(view.eye_from_reference.apply(moved.into()));
        let tag_from_eye = rotation.inverse().to_rotation_matrix().into_inner();
        Self {
            tag_from_eye,
            eye_in_tag: -(tag_from_eye * at),
        }
    }

    /// Where a ray of the eye meets the plane; `None` if the tag is seen from behind.
    pub(crate) fn meet(&self, ray: &Vector3<f64>) -> Option<PlanePoint> {
        let ray = self.tag_from_eye * ray;
        // The eye is on the side of negative z.
        if ray.z <= 1e-9 || self.eye_in_tag.z >= 0.0 {
            return None;
        }
        let slope = [ray.x / ray.z, ray.y / ray.z];
        let at = [0, 1].map(|k| self.eye_in_tag[k] - self.eye_in_tag.z * slope[k]);
        Some(PlanePoint {
            at,
            #[cfg(test)]
            slope,
        })
    }

    /// Velocity at which a fixed ray moves over the middle of the tag, m/s.
    pub(crate) fn drift(&self, motion: &Motion, view: &View<'_>) -> [f64; 2] {
        let rotation = self.tag_from_eye * view.eye_from_reference.rotation().to_rotation_matrix();
        let linear = rotation * Vector3::from(motion.linear);
        let slope = [0, 1].map(|k| self.eye_in_tag[k] / self.eye_in_tag.z);
        [0, 1].map(|k| linear.z * slope[k] - linear[k])
    }
}

/// Derivatives of a place on the plane by a small motion of the tag in its own frame: rotation,
/// then translation. The batches of a fit have their own.
#[cfg(test)]
pub(crate) fn by_motion(point: &PlanePoint) -> [[f64; 6]; 2] {
    let ([a, b], [u, v]) = (point.at, point.slope);
    [
        [b * u, -a * u, b, -1.0, 0.0, u],
        [b * v, -a * v, -a, 0.0, -1.0, v],
    ]
}

/// Rays of the pixels of a rectangle, from a coarse grid: lenses are smooth.
#[derive(Clone, Debug)]
pub(crate) struct Rays {
    nodes: Vec<[f64; 2]>,
    columns: usize,
    top: usize,
}

/// Pixels between nodes of the grid.
const NODE_PX: usize = 8;

impl Rays {
    /// Rays of the pixels from `(left, top)` over a size; `None` if the lens does not cover them.
    pub(crate) fn new(lens: &Lens, [left, top]: [usize; 2], size: [usize; 2]) -> Option<Self> {
        let [columns, rows] = size.map(|size| size.div_ceil(NODE_PX) + 1);
        let mut nodes = Vec::with_capacity(columns * rows);
        for j in 0..rows {
            for i in 0..columns {
                let pixel = [(left + i * NODE_PX) as f64, (top + j * NODE_PX) as f64];
                let [x, y, z] = lens.unproject(pixel).filter(|ray| ray[2] > 0.05)?;
                nodes.push([x / z, y / z]);
            }
        }
        Some(Self {
            nodes,
            columns,
            top,
        })
    }

    /// Calls `each` with the rays of the pixels of a row, of length 1 along the optical axis.
    pub(crate) fn for_row(&self, row: usize, width: usize, mut each: impl FnMut([f32; 2])) {
        let down = row - self.top;
        let (j, t) = (down / NODE_PX, (down % NODE_PX) as f64 / NODE_PX as f64);
        let node = |i: usize| {
            let [above, below] = [j, j + 1].map(|j| self.nodes[j * self.columns + i]);
            [0, 1].map(|k| (above[k] * (1.0 - t) + below[k] * t) as f32)
        };
        let mut left = node(0);
        let mut column = 0;
        for i in 1..self.columns {
            let right = node(i);
            let step = [0, 1].map(|k| (right[k] - left[k]) / NODE_PX as f32);
            for n in 0..NODE_PX.min(width - column) {
                each([0, 1].map(|k| left[k] + step[k] * n as f32));
            }
            left = right;
            column = (column + NODE_PX).min(width);
        }
    }
}

/// Rectangle of pixels around a tag with its margin: corner and size; `None` if the tag is behind
/// the eye or outside the image.
pub(crate) fn window(
    view: &View<'_>,
    tag: &Tag,
    reference_from_tag: &RigidTransform,
    around_px: f64,
) -> Option<([usize; 2], [usize; 2])> {
    let half = tag.half_cells() * tag.cell_m();
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for (x, y) in [(-half, -half), (half, -half), (half, half), (-half, half)] {
        let point = view
            .eye_from_reference
            .apply(reference_from_tag.apply([x, y, 0.0]));
        if point[2] < 0.02 {
            return None;
        }
        let pixel = view.lens.project(point)?;
        for k in 0..2 {
            low[k] = low[k].min(pixel[k] - around_px);
            high[k] = high[k].max(pixel[k] + around_px);
        }
    }
    let size = [view.image.width(), view.image.height()];
    let mut from = [0; 2];
    let mut extent = [0; 2];
    for k in 0..2 {
        let last = (size[k] - 1) as f64;
        let (a, b) = (low[k].ceil().max(0.0), high[k].floor().min(last));
        if b - a < 3.0 {
            return None;
        }
        from[k] = a as usize;
        extent[k] = (b - a) as usize + 1;
    }
    Some((from, extent))
}

/// Motion on the plane of a tag, at its middle, by a pixel to the right and one down, m.
pub(crate) fn pixel_axes(
    view: &View<'_>,
    pose: &RigidTransform,
    motion: &Motion,
) -> Option<[[f64; 2]; 2]> {
    let middle = view.eye_from_reference.apply(pose.translation_m());
    let pixel = view.lens.project(middle)?;
    let row_pose = RowPose::new(view, pose, motion, 0.0);
    let at = |dx: f64, dy: f64| {
        let ray = view.lens.unproject([pixel[0] + dx, pixel[1] + dy])?;
        Some(row_pose.meet(&Vector3::from(ray))?.at)
    };
    let [left, right, up, down] = [at(-0.5, 0.0)?, at(0.5, 0.0)?, at(0.0, -0.5)?, at(0.0, 0.5)?];
    let between = |a: [f64; 2], b: [f64; 2]| [b[0] - a[0], b[1] - a[1]];
    Some([between(left, right), between(up, down)])
}

/// Area of a pixel on the plane of a tag, m²; `None` if the tag is smaller than a pixel.
pub(crate) fn pixel_area(
    view: &View<'_>,
    tag: &Tag,
    pose: &RigidTransform,
    motion: &Motion,
) -> Option<f64> {
    let [x, y] = pixel_axes(view, pose, motion)?;
    let area = (x[0] * y[1] - x[1] * y[0]).abs();
    (area > 0.0 && area < tag.size_m * tag.size_m).then_some(area)
}

#[cfg(test)]
mod tests {
    use camera_models::{CameraModel, Distortion};

    use super::*;

    #[test]
    fn derivatives_by_motion_agree_with_differences() {
        let lens = Lens::new(&CameraModel::new(
            (640, 480),
            [500.0, 500.0, 319.5, 239.5],
            Distortion::None,
        ));
        let pixels = vec![0; 640 * 480];
        let view = View {
            image: ImageView::packed(640, 480, &pixels).expect("an image"),
            lens: &lens,
            eye_from_reference: RigidTransform::from_rotation_vector(
                [0.1, 0.2, -0.1],
                [0.1, 0.0, 0.2],
            )
            .expect("a transform"),
            line_s: 0.0,
            exposure_s: 0.0,
        };
        let pose = RigidTransform::from_rotation_vector([0.5, -0.2, 0.4], [-0.1, 0.1, 1.0])
            .expect("a transform");
        let ray = Vector3::new(0.1, 0.05, 1.0);
        let meet = |pose: &RigidTransform| {
            RowPose::new(&view, pose, &Motion::default(), 0.0)
                .meet(&ray)
                .expect("a point")
        };
        let exact = by_motion(&meet(&pose));
        let step = 1e-6;
        for k in 0..6 {
            let moved = |by: f64| {
                let mut vector = [0.0; 6];
                vector[k] = by;
                let [a, b, c, x, y, z] = vector;
                let small = RigidTransform::from_rotation_vector([a, b, c], [x, y, z]);
                meet(&(pose * small.expect("a transform"))).at
            };
            let (more, less) = (moved(step), moved(-step));
            for axis in 0..2 {
                let slope = (more[axis] - less[axis]) / (2.0 * step);
                assert!((slope - exact[axis][k]).abs() < 1e-6, "{k} {axis}");
            }
        }
    }
}
