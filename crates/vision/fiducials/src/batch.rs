//! Pixels in batches of single precision, and where these meet the plane of a tag.
//!
//! Contract: single precision is wrong by less than 1e-4 cells of a tag within 3 m.

use crate::view::RowPoses;

/// Pixels of a batch.
pub(crate) const BATCH: usize = 32;

/// A number for each pixel of a batch.
pub(crate) type Lane = [f32; BATCH];

/// Pixels: rays of length 1 along the optical axis, row of the image, gray level.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PixelBatch {
    pub(crate) x: Lane,
    pub(crate) y: Lane,
    pub(crate) row: Lane,
    pub(crate) level: Lane,
}

/// A pixel, as in a [`PixelBatch`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pixel {
    pub(crate) ray: [f32; 2],
    pub(crate) row: f32,
    pub(crate) level: f32,
}

/// Pixels in order of rows. Those of the last batch beyond their number equal one of the others.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pixels {
    pub(crate) count: usize,
    pub(crate) batches: Vec<PixelBatch>,
}

impl Pixels {
    pub(crate) fn with_capacity(count: usize) -> Self {
        Self {
            count: 0,
            batches: Vec::with_capacity(count.div_ceil(BATCH)),
        }
    }

    pub(crate) fn push(&mut self, pixel: Pixel) {
        let n = self.count % BATCH;
        self.count += 1;
        if n == 0 {
            self.batches.push(PixelBatch {
                x: [pixel.ray[0]; BATCH],
                y: [pixel.ray[1]; BATCH],
                row: [pixel.row; BATCH],
                level: [pixel.level; BATCH],
            });
        } else if let Some(batch) = self.batches.last_mut() {
            batch.x[n] = pixel.ray[0];
            batch.y[n] = pixel.ray[1];
            batch.row[n] = pixel.row;
            batch.level[n] = pixel.level;
        }
    }

    /// First and last row; `None` without pixels.
    pub(crate) fn rows(&self) -> Option<[usize; 2]> {
        let (first, last) = (self.batches.first()?, self.batches.last()?);
        let last = last.row[(self.count - 1) % BATCH];
        Some([first.row[0] as usize, last as usize])
    }

    /// Number of pixels of a batch.
    pub(crate) fn count_of(&self, batch: usize) -> usize {
        (self.count - batch * BATCH).min(BATCH)
    }
}

impl PixelBatch {
    pub(crate) fn pixel(&self, n: usize) -> Pixel {
        Pixel {
            ray: [self.x[n], self.y[n]],
            row: self.row[n],
            level: self.level[n],
        }
    }
}

/// Where pixels meet the plane of a tag, cells about its middle, and the slopes of their rays in
/// the frame of the tag: x and y per z.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlaneBatch {
    pub(crate) x: Lane,
    pub(crate) y: Lane,
    pub(crate) slope_x: Lane,
    pub(crate) slope_y: Lane,
}

impl PlaneBatch {
    pub(crate) const ZERO: Self = Self {
        x: [0.0; BATCH],
        y: [0.0; BATCH],
        slope_x: [0.0; BATCH],
        slope_y: [0.0; BATCH],
    };
}

/// The plane of a tag as an eye sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plane {
    /// Rays of the eye in the frame of the tag, and the eye there, cells.
    tag_from_eye: [[f32; 3]; 3],
    eye: [f32; 3],
    /// Change of both per row after the first one.
    by_row: ([[f32; 3]; 3], [f32; 3]),
    first_row: f32,
}

impl Plane {
    /// For cells of this size.
    pub(crate) fn new(poses: &RowPoses, cell_m: f64) -> Self {
        let rows = |m: &nalgebra::Matrix3<f64>| {
            std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)] as f32))
        };
        let cells = |v: &nalgebra::Vector3<f64>| std::array::from_fn(|i| (v[i] / cell_m) as f32);
        let (rotation, eye) = poses.first();
        let (rotation_by_row, eye_by_row) = poses.by_row();
        Self {
            tag_from_eye: rows(rotation),
            eye: cells(eye),
            by_row: (rows(rotation_by_row), cells(eye_by_row)),
            first_row: poses.first_row() as f32,
        }
    }

    /// Whether the eye is in front of the tag.
    pub(crate) fn shows_front(&self) -> bool {
        self.eye[2] < 0.0
    }

    /// Where a batch meets the plane; false if one of its pixels does not show the front.
    #[inline(always)]
    pub(crate) fn meet(&self, pixels: &PixelBatch, to: &mut PlaneBatch) -> bool {
        let (m, e, (dm, de)) = (&self.tag_from_eye, &self.eye, &self.by_row);
        let mut behind = 0_u32;
        for k in 0..BATCH {
            let (x, y) = (pixels.x[k], pixels.y[k]);
            let rows = pixels.row[k] - self.first_row;
            let ray_x = (m[0][0] + dm[0][0] * rows) * x
                + (m[0][1] + dm[0][1] * rows) * y
                + (m[0][2] + dm[0][2] * rows);
            let ray_y = (m[1][0] + dm[1][0] * rows) * x
                + (m[1][1] + dm[1][1] * rows) * y
                + (m[1][2] + dm[1][2] * rows);
            let ray_z = (m[2][0] + dm[2][0] * rows) * x
                + (m[2][1] + dm[2][1] * rows) * y
                + (m[2][2] + dm[2][2] * rows);
            let eye_z = e[2] + de[2] * rows;
            // The eye is on the side of negative z.
            behind += u32::from(ray_z <= 1e-6) | u32::from(eye_z >= 0.0);
            let by_z = 1.0 / ray_z;
            let (slope_x, slope_y) = (ray_x * by_z, ray_y * by_z);
            to.slope_x[k] = slope_x;
            to.slope_y[k] = slope_y;
            to.x[k] = (e[0] + de[0] * rows) - eye_z * slope_x;
            to.y[k] = (e[1] + de[1] * rows) - eye_z * slope_y;
        }
        behind == 0
    }
}
