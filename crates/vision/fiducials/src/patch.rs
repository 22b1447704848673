//! Pixels of an eye near a tag.

use cad_transforms::RigidTransform;
use nalgebra::Vector3;

use crate::blur::Blur;
use crate::config::Config;
use crate::tag::Tag;
use crate::view::{Motion, PlanePoint, Rays, RowPose, RowPoses, View, pixel_area, window};

/// Distance of the pixels that count from what is around the tag, in sigmas of the blur, besides
/// half of the motion during the exposure.
const AROUND_SIGMAS: f64 = 2.0;
/// Columns by which the pixels that count move from row to row where not all do.
const COLUMNS_PER_ROW: usize = 3;
/// Minimum extent of these pixels beyond the black square, cells.
const MIN_AROUND_CELLS: f64 = -1.5;
/// Pixels around a tag that a window has, and that it must have for a pose.
const MARGIN_PX: f64 = 5.0;
const MIN_MARGIN_PX: f64 = 1.0;

/// Pixels of an eye that count.
#[derive(Clone, Debug)]
pub(crate) struct Patch<'a> {
    /// Index of the view.
    pub(crate) eye: usize,
    pub(crate) view: View<'a>,
    pub(crate) pixels: Vec<Pixel>,
}

/// A pixel and its ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pixel {
    /// Ray of length 1 along the optical axis.
    pub(crate) ray: Vector3<f64>,
    pub(crate) row: usize,
    pub(crate) level: f64,
}

/// What of a tag counts in an eye.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Selection {
    /// Blur of lens and sensor, px.
    pub(crate) blur_px: f64,
    /// Cells, row by row with margins, that something hides.
    pub(crate) is_hidden: Vec<bool>,
}

impl Selection {
    /// Everything.
    pub(crate) fn all(tag: &Tag, config: &Config) -> Self {
        Self {
            blur_px: config.blur_px,
            is_hidden: vec![false; tag.cells() * tag.cells()],
        }
    }
}

/// The cell at a place of the plane, row by row with margins.
pub(crate) fn cell_at(tag: &Tag, at: [f64; 2]) -> Option<usize> {
    let inside = 0.0..tag.cells() as f64;
    let [x, y] = at.map(|v| v / tag.cell_m() + tag.half_cells());
    (inside.contains(&x) && inside.contains(&y)).then(|| y as usize * tag.cells() + x as usize)
}

/// Pixels of an eye around a tag.
#[derive(Clone, Debug)]
pub(crate) struct Window<'a> {
    /// Index of the view.
    pub(crate) eye: usize,
    pub(crate) view: View<'a>,
    from: [usize; 2],
    size: [usize; 2],
    pixels: Vec<Pixel>,
}

impl<'a> Window<'a> {
    /// The pixels around a tag; `None` where it is not in the image.
    pub(crate) fn new(
        (eye, view): (usize, &View<'a>),
        tag: &Tag,
        pose: &RigidTransform,
    ) -> Option<Self> {
        let (from, size) = window(view, tag, pose, MARGIN_PX)?;
        let rays = Rays::new(view.lens, from, size)?;
        let mut pixels = Vec::with_capacity(size[0] * size[1]);
        for row in from[1]..from[1] + size[1] {
            let levels = &view.image.row(row)[from[0]..][..size[0]];
            for (column, level) in (from[0]..).zip(levels) {
                let ray = rays.at(column, row);
                let level = f64::from(*level);
                pixels.push(Pixel { ray, row, level });
            }
        }
        Some(Self {
            eye,
            view: *view,
            from,
            size,
            pixels,
        })
    }

    /// Whether the tag in another pose is in here as far as it is in the image.
    pub(crate) fn covers(&self, tag: &Tag, pose: &RigidTransform) -> bool {
        let Some((from, size)) = window(&self.view, tag, pose, MIN_MARGIN_PX) else {
            return true;
        };
        let is_inside =
            |k: usize| self.from[k] <= from[k] && from[k] + size[k] <= self.from[k] + self.size[k];
        is_inside(0) && is_inside(1)
    }

    /// Calls `each` with every pixel that meets the plane of a tag, the index of its column, and
    /// where it does.
    pub(crate) fn for_each(
        &self,
        pose: &RigidTransform,
        motion: &Motion,
        mut each: impl FnMut(&Pixel, usize, &PlanePoint),
    ) {
        let ends = [self.from[1], self.from[1] + self.size[1] - 1];
        let poses = RowPoses::new(&self.view, pose, motion, ends);
        for row in self.pixels.chunks_exact(self.size[0]) {
            let row_pose = poses.at(row[0].row);
            for (column, pixel) in row.iter().enumerate() {
                if let Some(point) = row_pose.meet(&pixel.ray) {
                    each(pixel, column, &point);
                }
            }
        }
    }
}

impl<'a> Patch<'a> {
    /// The pixels of a window that show a tag; `None` if they are too few.
    pub(crate) fn new(
        window: &Window<'a>,
        tag: &Tag,
        pose: &RigidTransform,
        motion: &Motion,
        selection: &Selection,
        config: &Config,
    ) -> Option<Self> {
        let view = &window.view;
        let area = pixel_area(view, tag, pose, motion)?;
        let most = Blur::new(view, tag, pose, motion, selection.blur_px)?
            .reach_cells(AROUND_SIGMAS)
            .map(|reach| (1.0 - reach).max(MIN_AROUND_CELLS))
            .map(|around| (tag.half_square_cells() + around) * tag.cell_m());
        let expected = 4.0 * most[0] * most[1] / area;
        // Of a large tag, pixels that are evenly spread.
        let stride = ((expected / config.max_pixels as f64).ceil() as usize).max(1);
        let mut pixels = Vec::new();
        window.for_each(pose, motion, |pixel, column, point| {
            let counts = (column + COLUMNS_PER_ROW * pixel.row).is_multiple_of(stride)
                && point.at.iter().zip(most).all(|(v, most)| v.abs() < most)
                && cell_at(tag, point.at).is_some_and(|cell| !selection.is_hidden[cell]);
            if counts {
                pixels.push(*pixel);
            }
        });
        let is_enough = (stride * pixels.len()) as f64 > config.min_share * expected;
        is_enough.then_some(Self {
            eye: window.eye,
            view: *view,
            pixels,
        })
    }

    /// Calls `each` with every pixel and the pose of its row.
    pub(crate) fn for_each(
        &self,
        pose: &RigidTransform,
        motion: &Motion,
        mut each: impl FnMut(&Pixel, &RowPose),
    ) {
        let [Some(first), Some(last)] = [self.pixels.first(), self.pixels.last()] else {
            return;
        };
        let poses = RowPoses::new(&self.view, pose, motion, [first.row, last.row]);
        let mut row = first.row;
        let mut row_pose = poses.at(row);
        for pixel in &self.pixels {
            if pixel.row != row {
                row = pixel.row;
                row_pose = poses.at(row);
            }
            each(pixel, &row_pose);
        }
    }
}
