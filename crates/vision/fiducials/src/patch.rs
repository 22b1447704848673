//! Pixels of an eye near a tag.

use cad_transforms::RigidTransform;
use simd_dispatch::Kernel;

use crate::batch::{BATCH, Lane, Pixel, PixelBatch, Pixels, Plane, PlaneBatch};
use crate::blur::Blur;
use crate::config::Config;
use crate::tag::Tag;
use crate::view::{Motion, Rays, RowPoses, View, pixel_area, window};
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
    pub(crate) pixels: Pixels,
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

/// The cell at a place of the plane, cells about the middle, row by row with margins.
#[inline(always)]
pub(crate) fn cell_at(tag: &Tag, at: [f32; 2]) -> usize {
    let (half, last) = (tag.half_cells() as f32, tag.cells() - 1);
    let [x, y] = [(at[0] + half) as usize, (at[1] + half) as usize];
    y.min(last) * tag.cells() + x.min(last)
}

/// Pixels of an eye around a tag.
#[derive(Clone, Debug)]
pub(crate) struct Window<'a> {
    /// Index of the view.
    pub(crate) eye: usize,
    pub(crate) view: View<'a>,
    from: [usize; 2],
    size: [usize; 2],
    pixels: Pixels,
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
        let mut pixels = Pixels::with_capacity(size[0] * size[1]);
        for row in from[1]..from[1] + size[1] {
            let mut levels = view.image.row(row)[from[0]..][..size[0]].iter();
            rays.for_row(row, size[0], |ray| {
                let level = levels.next().map_or(0.0, |level| f32::from(*level));
                let row = row as f32;
                pixels.push(Pixel { ray, row, level });
            });
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

    /// Stride with which no more than a number of pixels of the tag, with its margin, remain.
    pub(crate) fn stride(&self, most: usize) -> usize {
        self.pixels.count.div_ceil(most).max(1)
    }

    /// Pixels that meet the plane of a tag nearer to its middle than some cells along both axes:
    /// every `stride`th one, evenly spread. `each` says of each of them and the place where it
    /// meets the plane, cells, whether it counts.
    pub(crate) fn near(
        &self,
        tag: &Tag,
        (pose, motion): (&RigidTransform, &Motion),
        most: [f64; 2],
        stride: usize,
        mut counts: impl FnMut([f32; 2]) -> bool,
    ) -> Pixels {
        let mut near = Pixels::with_capacity(self.pixels.count / stride);
        let plane = plane(&self.view, tag, (pose, motion), &self.pixels);
        let Some(plane) = plane.filter(Plane::shows_front) else {
            return near;
        };
        let most = most.map(|most| most as f32);
        // Columns of the window after the next pixel that counts, modulo the stride.
        let (mut column, mut phase) = (0, (COLUMNS_PER_ROW * self.from[1]) % stride);
        let (mut row_phase, mut point) = (phase, PlaneBatch::ZERO);
        for (number, pixels) in self.pixels.batches.iter().enumerate() {
            let mut is_near = [0_u32; BATCH];
            let any = simd_dispatch::run(Near {
                plane: &plane,
                pixels,
                most,
                point: &mut point,
                is_near: &mut is_near,
            });
            for k in 0..self.pixels.count_of(number) {
                let is_next = phase == 0;
                (column, phase) = (column + 1, phase + 1);
                if phase == stride {
                    phase = 0;
                }
                if column == self.size[0] {
                    column = 0;
                    row_phase = (row_phase + COLUMNS_PER_ROW) % stride;
                    phase = row_phase;
                }
                if any && is_next && is_near[k] != 0 && counts([point.x[k], point.y[k]]) {
                    near.push(pixels.pixel(k));
                }
            }
        }
        near
    }
}

/// The plane of a tag as some pixels see it; `None` without pixels.
pub(crate) fn plane(
    view: &View<'_>,
    tag: &Tag,
    (pose, motion): (&RigidTransform, &Motion),
    pixels: &Pixels,
) -> Option<Plane> {
    let poses = RowPoses::new(view, pose, motion, pixels.rows()?);
    Some(Plane::new(&poses, tag.cell_m()))
}

/// Which pixels of a batch meet a plane near its middle, and whether any do.
struct Near<'k> {
    plane: &'k Plane,
    pixels: &'k PixelBatch,
    most: [f32; 2],
    point: &'k mut PlaneBatch,
    is_near: &'k mut [u32; BATCH],
}

impl Kernel for Near<'_> {
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        self.plane.meet(self.pixels, self.point);
        let (x, y): (&Lane, &Lane) = (&self.point.x, &self.point.y);
        let mut count = 0;
        for k in 0..BATCH {
            let near = u32::from(x[k].abs() < self.most[0]) & u32::from(y[k].abs() < self.most[1]);
            self.is_near[k] = near;
            count += near;
        }
        count > 0
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
            .map(|around| tag.half_square_cells() + around);
        let expected = 4.0 * most[0] * most[1] * tag.cell_m() * tag.cell_m() / area;
        // Of a large tag, pixels that are evenly spread.
        let stride = ((expected / config.max_pixels as f64).ceil() as usize).max(1);
        let pixels = window.near(tag, (pose, motion), most, stride, |at| {
            !selection.is_hidden[cell_at(tag, at)]
        });
        let is_enough = (stride * pixels.count) as f64 > config.min_share * expected;
        is_enough.then_some(Self {
            eye: window.eye,
            view: *view,
            pixels,
        })
    }

    /// The plane of a tag as the pixels see it; `None` without pixels.
    pub(crate) fn plane(&self, tag: &Tag, pose: &RigidTransform, motion: &Motion) -> Option<Plane> {
        plane(&self.view, tag, (pose, motion), &self.pixels)
    }
}
