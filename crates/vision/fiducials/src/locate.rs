//! Where a tag of known identity is in an image, near a plane: also where blur hides its bits.
//!
//! A detector of quadrilaterals needs edges, which motion by a cell and more takes away. Here the
//! orientation of the tag and its motion are approximately known, and its place is not: the printed
//! pattern, blurred as its motion says, is correlated with all places of a region.

use std::ops::Range;

use cad_transforms::RigidTransform;
use estimator_config::config;
use nalgebra::Vector3;

use crate::blur::Blur;
use crate::tag::Tag;
use crate::template::Template;
use crate::view::{Motion, View, pixel_axes};

config! {
    /// Configuration of [`locate`].
    pub struct LocateConfig {
        /// Pixels per cell in which places are compared at last, at least: finer ones are joined.
        pub px_per_cell: f64 = 1.2,
        /// Number of places that are compared so: the best ones of a search in pixels of twice that
        /// size.
        pub candidates: usize = 60,
        /// Minimum correlation with the pattern.
        pub min_correlation: f64 = 0.6,
        /// Minimum standard deviation of the gray levels that are compared.
        pub min_deviation_levels: f64 = 5.0,
        /// Blur of lens and sensor, px.
        pub blur_px: f64 = 0.7,
    }
}

/// A place of a tag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Takes points of the tag to the reference frame, in the orientation that it was searched in.
    pub reference_from_tag: RigidTransform,
    /// Correlation with the pattern.
    pub correlation: f64,
}

/// The place of a tag in one image that correlates best with its pattern; `None` if none does well.
///
/// `starts` are approximate poses; the tag is searched up to `reach_m` around each of them in the
/// plane through it with this normal, both in the reference frame, in the orientation of the start.
/// The pattern is that at the start: it may be wrong by a tenth of the distance of the tag.
pub fn locate(
    view: &View<'_>,
    tag: &Tag,
    starts: &[RigidTransform],
    motion: &Motion,
    (normal, reach_m): ([f64; 3], f64),
    config: &LocateConfig,
) -> Option<Place> {
    let of_start = |start: &RigidTransform| {
        let axes = pixel_axes(view, start, motion)?.map(|axis| axis.map(|v| v / tag.cell_m()));
        let [x, y] = axes;
        let px_per_cell = 1.0 / (x[0] * y[1] - x[1] * y[0]).abs().max(1e-9).sqrt();
        let factor = ((px_per_cell / config.px_per_cell) as usize).max(1);
        let around = |factor: usize| {
            let joined_px = ((factor * factor - 1) as f64 / 12.0).sqrt();
            let blur = Blur::new(view, tag, start, motion, config.blur_px.hypot(joined_px))?;
            let kernel = Kernel::new(tag, &blur, &axes, factor)?;
            Some((kernel, Region::around(view, start, reach_m, factor)?))
        };
        let (coarse_kernel, coarse) = around(2 * factor)?;
        let (kernel, region) = around(factor)?;
        let (pixel, correlation) = (coarse.candidates(&coarse_kernel, config).into_iter())
            .filter_map(|pixel| region.best_near(&kernel, pixel, config))
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        let reference_from_tag = at_pixel(view, start, normal, pixel)?;
        Some(Place {
            reference_from_tag,
            correlation,
        })
    };
    let places = starts.iter().filter_map(of_start);
    let good = places.filter(|place| place.correlation > config.min_correlation);
    good.max_by(|a, b| a.correlation.total_cmp(&b.correlation))
}

/// A pose moved in a plane to where a pixel shows its origin.
fn at_pixel(
    view: &View<'_>,
    start: &RigidTransform,
    normal: [f64; 3],
    pixel: [f64; 2],
) -> Option<RigidTransform> {
    let reference_from_eye = view.eye_from_reference.inverse();
    let ray = reference_from_eye.rotation() * Vector3::from(view.lens.unproject(pixel)?);
    let eye = reference_from_eye.translation();
    let normal = Vector3::from(normal);
    let slope = normal.dot(&ray);
    if slope.abs() < 1e-3 {
        return None;
    }
    let distance = normal.dot(&(start.translation() - eye)) / slope;
    let moved = eye + ray * distance - start.translation();
    let moved = RigidTransform::from_translation_m(moved.into()).ok()?;
    (distance > 0.0).then_some(moved * *start)
}

/// The pattern of a tag in joined pixels, minus its mean.
struct Kernel {
    rows: Vec<KernelRow>,
    count: f32,
    /// Sum of the squares.
    squares: f32,
}

/// Consecutive values of a row, from an offset to the middle on.
struct KernelRow {
    row: isize,
    column: isize,
    values: Vec<f32>,
}

impl Kernel {
    /// `axes` are the motions on the tag by a pixel to the right and one down, cells; the blur is
    /// that in joined pixels.
    fn new(tag: &Tag, blur: &Blur, [x, y]: &[[f64; 2]; 2], factor: usize) -> Option<Self> {
        let template = Template::new(tag, blur);
        let area = (x[0] * y[1] - x[1] * y[0]).abs();
        if area <= 0.0 {
            return None;
        }
        let px_per_cell = 1.0 / area.sqrt();
        let reach = (1.5 * tag.half_cells() * px_per_cell / factor as f64).ceil() as isize;
        let half = tag.half_cells();
        let step = factor as f64;
        let value = |row: isize, column: isize| {
            let [u, v] = [column as f64 * step, row as f64 * step];
            let place = [0, 1].map(|k| x[k] * u + y[k] * v);
            let is_inside = place.iter().all(|v| v.abs() < half);
            is_inside.then(|| template.at(place).value as f32)
        };
        let mut rows = Vec::new();
        for row in -reach..=reach {
            let columns = -reach..=reach;
            let inside: Vec<(isize, f32)> = columns
                .filter_map(|column| Some((column, value(row, column)?)))
                .collect();
            if let Some((column, _)) = inside.first() {
                rows.push(KernelRow {
                    row,
                    column: *column,
                    values: inside.iter().map(|(_, value)| *value).collect(),
                });
            }
        }
        let all = || rows.iter().flat_map(|row| row.values.iter().copied());
        let count = all().count() as f32;
        let mean = all().sum::<f32>() / count.max(1.0);
        let squares = all().map(|v| (v - mean) * (v - mean)).sum();
        for row in &mut rows {
            for value in &mut row.values {
                *value -= mean;
            }
        }
        (squares > 0.0).then_some(Self {
            rows,
            count,
            squares,
        })
    }
}

/// A part of an image, in joined pixels.
struct Region {
    /// First pixel of the image, and the number of pixels that are joined along a side.
    from: [usize; 2],
    factor: usize,
    size: [usize; 2],
    levels: Vec<f32>,
    /// Sums of levels and of their squares from the begin of each row on.
    sums: Vec<[f32; 2]>,
}

impl Region {
    /// The part of an image around a pose.
    fn around(
        view: &View<'_>,
        start: &RigidTransform,
        reach_m: f64,
        factor: usize,
    ) -> Option<Self> {
        let at = view.eye_from_reference.apply(start.translation_m());
        if at[2] < 0.1 {
            return None;
        }
        let middle = view.lens.project(at)?;
        let reach = reach_m / at[2] * view.lens.model().fx;
        let image = [view.image.width(), view.image.height()];
        let mut from = [0; 2];
        let mut size = [0; 2];
        for k in 0..2 {
            let first = (middle[k] - reach).max(0.0);
            let last = (middle[k] + reach).min(image[k] as f64);
            if last - first < (4 * factor) as f64 {
                return None;
            }
            from[k] = first as usize;
            size[k] = (last as usize - from[k]) / factor;
        }
        let mut levels = Vec::with_capacity(size[0] * size[1]);
        let share = 1.0 / (factor * factor) as f32;
        for row in 0..size[1] {
            let rows = (0..factor).map(|k| view.image.row(from[1] + row * factor + k));
            let rows: Vec<&[u8]> = rows
                .map(|row| &row[from[0]..from[0] + size[0] * factor])
                .collect();
            levels.extend((0..size[0]).map(|column| {
                let part = column * factor..(column + 1) * factor;
                let sum =
                    |row: &&[u8]| row[part.clone()].iter().map(|v| u32::from(*v)).sum::<u32>();
                share * rows.iter().map(sum).sum::<u32>() as f32
            }));
        }
        let sums = levels.chunks_exact(size[0]).flat_map(|row| {
            let mut sums = [0.0; 2];
            let next = row.iter().map(move |v| {
                sums = [sums[0] + v, sums[1] + v * v];
                sums
            });
            std::iter::once([0.0; 2]).chain(next)
        });
        Some(Self {
            from,
            factor,
            size,
            sums: sums.collect(),
            levels,
        })
    }

    /// The pixels of the image at which the pattern correlates best, the best one of some around
    /// each.
    fn candidates(&self, kernel: &Kernel, config: &LocateConfig) -> Vec<[f64; 2]> {
        let Some([columns, rows]) = self.places(kernel) else {
            return Vec::new();
        };
        // The best place of each square of places.
        const SQUARE: isize = 3;
        let mut best = Vec::new();
        for top in rows.clone().step_by(SQUARE as usize) {
            for left in columns.clone().step_by(SQUARE as usize) {
                let square = (top..(top + SQUARE).min(rows.end)).flat_map(|row| {
                    (left..(left + SQUARE).min(columns.end)).map(move |column| [column, row])
                });
                let scores = square.map(|at| (at, self.correlation(kernel, at, config)));
                best.extend(scores.max_by(|a, b| a.1.total_cmp(&b.1)));
            }
        }
        best.sort_by(|a, b| b.1.total_cmp(&a.1));
        best.truncate(config.candidates);
        best.into_iter().map(|(at, _)| self.pixel(at)).collect()
    }

    /// The pixel near another one at which the pattern correlates best, and its correlation.
    fn best_near(
        &self,
        kernel: &Kernel,
        near: [f64; 2],
        config: &LocateConfig,
    ) -> Option<([f64; 2], f64)> {
        const AROUND: isize = 2;
        let [columns, rows] = self.places(kernel)?;
        let middle = 0.5 * (self.factor as f64 - 1.0);
        let [column, row] = [0, 1].map(|k| {
            let place = (near[k] - self.from[k] as f64 - middle) / self.factor as f64;
            place.round() as isize
        });
        let near = |place: isize, of: &Range<isize>| {
            (place - AROUND).max(of.start)..(place + AROUND + 1).min(of.end)
        };
        let columns = near(column, &columns);
        let places =
            near(row, &rows).flat_map(|row| columns.clone().map(move |column| [column, row]));
        let scores = places.map(|at| (at, self.correlation(kernel, at, config)));
        let (at, correlation) = scores.max_by(|a, b| a.1.total_cmp(&b.1))?;
        Some((self.pixel(at), f64::from(correlation)))
    }

    /// Columns and rows at which the whole pattern is in the region.
    fn places(&self, kernel: &Kernel) -> Option<[Range<isize>; 2]> {
        let [width, height] = self.size.map(|size| size as isize);
        let [first, last] = [kernel.rows.first()?.row, kernel.rows.last()?.row];
        let left = kernel.rows.iter().map(|row| row.column).min()?;
        let end = |row: &KernelRow| row.column + row.values.len() as isize;
        let right = kernel.rows.iter().map(end).max()?;
        Some([-left..width - right + 1, -first..height - last])
    }

    /// The pixel of the image in the middle of a joined one.
    fn pixel(&self, at: [isize; 2]) -> [f64; 2] {
        let middle = 0.5 * (self.factor as f64 - 1.0);
        [0, 1].map(|k| self.from[k] as f64 + at[k] as f64 * self.factor as f64 + middle)
    }

    fn correlation(
        &self,
        kernel: &Kernel,
        [column, row]: [isize; 2],
        config: &LocateConfig,
    ) -> f32 {
        let least = (config.min_deviation_levels * config.min_deviation_levels) as f32;
        let (mut product, mut sum, mut squares) = (0.0, 0.0, 0.0);
        let width = self.size[0];
        for own in &kernel.rows {
            let row = (row + own.row) as usize;
            let begin = (column + own.column) as usize;
            let end = begin + own.values.len();
            let levels = &self.levels[row * width..][begin..end];
            product += dot(levels, &own.values);
            let sums = &self.sums[row * (width + 1)..];
            sum += sums[end][0] - sums[begin][0];
            squares += sums[end][1] - sums[begin][1];
        }
        let spread = squares - sum * sum / kernel.count;
        match spread > least * kernel.count {
            true => product / (spread * kernel.squares).sqrt(),
            false => 0.0,
        }
    }
}

/// Product of two rows, in parts that processors add together.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    const LANES: usize = 8;
    let mut lanes = [0.0; LANES];
    let (a_parts, b_parts) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest = a_parts.remainder().iter().zip(b_parts.remainder());
    let rest: f32 = rest.map(|(a, b)| a * b).sum();
    for (a, b) in a_parts.zip(b_parts) {
        for k in 0..LANES {
            lanes[k] += a[k] * b[k];
        }
    }
    lanes.iter().sum::<f32>() + rest
}

#[cfg(test)]
mod tests;
