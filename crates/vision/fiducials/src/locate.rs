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
use crate::vectors;
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
    let searches: Vec<Search<'_>> = starts
        .iter()
        .filter_map(|start| Search::new(view, tag, start, motion, reach_m, config))
        .collect();
    // The best candidates of all starts.
    let mut candidates: Vec<(usize, Candidate)> = searches
        .iter()
        .enumerate()
        .flat_map(|(n, search)| {
            let own = search.coarse.candidates(&search.coarse_kernel, config);
            own.into_iter().map(move |candidate| (n, candidate))
        })
        .collect();
    candidates.sort_by(|a, b| b.1.correlation.total_cmp(&a.1.correlation));
    candidates.truncate(config.candidates);
    let refined = candidates.iter().filter_map(|(n, candidate)| {
        let Search { region, kernel, .. } = &searches[*n];
        Some((*n, region.best_near(kernel, candidate.pixel, config)?))
    });
    let (n, best) = refined.max_by(|a, b| a.1.correlation.total_cmp(&b.1.correlation))?;
    let correlation = f64::from(best.correlation);
    if correlation <= config.min_correlation {
        return None;
    }
    Some(Place {
        reference_from_tag: at_pixel(view, searches[n].start, normal, best.pixel)?,
        correlation,
    })
}

/// A search around one start: in pixels of the least size, and of twice that.
struct Search<'s> {
    start: &'s RigidTransform,
    kernel: Kernel,
    region: Region,
    coarse_kernel: Kernel,
    coarse: Region,
}

impl<'s> Search<'s> {
    fn new(
        view: &View<'_>,
        tag: &Tag,
        start: &'s RigidTransform,
        motion: &Motion,
        reach_m: f64,
        config: &LocateConfig,
    ) -> Option<Self> {
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
        Some(Self {
            start,
            kernel,
            region,
            coarse_kernel,
            coarse,
        })
    }
}

/// A pixel of the image at which the pattern may be.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    pixel: [f64; 2],
    correlation: f32,
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
    fn candidates(&self, kernel: &Kernel, config: &LocateConfig) -> Vec<Candidate> {
        let Some([columns, rows]) = self.places(kernel) else {
            return Vec::new();
        };
        if columns.is_empty() {
            return Vec::new();
        }
        // The best place of each square of places.
        const SQUARE: usize = 3;
        let width = (columns.end - columns.start) as usize;
        let mut correlations = vec![0.0; width];
        let mut best: Vec<(f32, [isize; 2])> = Vec::new();
        let mut found = Vec::new();
        for (n, row) in rows.clone().enumerate() {
            self.correlate::<32>(kernel, (&columns, row), config, &mut correlations);
            if n % SQUARE == 0 {
                best.clear();
                best.resize(width.div_ceil(SQUARE), (f32::NEG_INFINITY, [0, 0]));
            }
            for (best, (k, part)) in best.iter_mut().zip(correlations.chunks(SQUARE).enumerate()) {
                for (n, correlation) in part.iter().enumerate() {
                    if *correlation > best.0 {
                        let column = columns.start + (k * SQUARE + n) as isize;
                        *best = (*correlation, [column, row]);
                    }
                }
            }
            if n % SQUARE == SQUARE - 1 || row + 1 == rows.end {
                let some = best.iter().filter(|(correlation, _)| *correlation > 0.0);
                found.extend(some.map(|(correlation, at)| Candidate {
                    pixel: self.pixel(*at),
                    correlation: *correlation,
                }));
            }
        }
        found
    }

    /// The pixel near another one at which the pattern correlates best, and its correlation.
    fn best_near(
        &self,
        kernel: &Kernel,
        near: [f64; 2],
        config: &LocateConfig,
    ) -> Option<Candidate> {
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
        let (columns, rows) = (near(column, &columns), near(row, &rows));
        if columns.is_empty() {
            return None;
        }
        let mut correlations = vec![0.0; (columns.end - columns.start) as usize];
        let mut best: Option<(f32, [isize; 2])> = None;
        for row in rows {
            self.correlate::<8>(kernel, (&columns, row), config, &mut correlations);
            for (column, correlation) in columns.clone().zip(&correlations) {
                if best.is_none_or(|best| *correlation > best.0) {
                    best = Some((*correlation, [column, row]));
                }
            }
        }
        let (correlation, at) = best?;
        Some(Candidate {
            pixel: self.pixel(at),
            correlation,
        })
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

    /// Correlations at consecutive columns of a row of places.
    fn correlate<const COLUMNS: usize>(
        &self,
        kernel: &Kernel,
        (columns, row): (&Range<isize>, isize),
        config: &LocateConfig,
        correlations: &mut [f32],
    ) {
        vectors::run(Correlate::<'_, COLUMNS> {
            region: self,
            kernel,
            first: [columns.start, row],
            least: (config.min_deviation_levels * config.min_deviation_levels) as f32,
            correlations,
        });
    }
}

/// See [`Region::correlate`]: this number of columns is computed together.
struct Correlate<'k, const COLUMNS: usize> {
    region: &'k Region,
    kernel: &'k Kernel,
    first: [isize; 2],
    least: f32,
    correlations: &'k mut [f32],
}

impl<const COLUMNS: usize> vectors::Kernel for Correlate<'_, COLUMNS> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let [first, row] = self.first;
        let mut at = first;
        for part in self.correlations.chunks_mut(COLUMNS) {
            // What lies beyond the last column is read where the image has it, and not used.
            let (mut products, mut sums, mut squares) =
                ([0.0_f32; COLUMNS], [0.0_f32; COLUMNS], [0.0_f32; COLUMNS]);
            for own in &self.kernel.rows {
                let row = (row + own.row) as usize;
                let begin = (at + own.column) as usize;
                let width = self.region.size[0];
                let levels = &self.region.levels[row * width + begin..];
                for (k, value) in own.values.iter().enumerate() {
                    match levels[k..].first_chunk::<COLUMNS>() {
                        Some(levels) => {
                            for n in 0..COLUMNS {
                                products[n] += value * levels[n];
                            }
                        }
                        None => {
                            for n in 0..part.len() {
                                products[n] += value * levels[k + n];
                            }
                        }
                    }
                }
                let ends = &self.region.sums[row * (width + 1) + begin..];
                let count = own.values.len();
                for n in 0..part.len() {
                    let ([a, aa], [b, bb]) = (ends[n], ends[n + count]);
                    sums[n] += b - a;
                    squares[n] += bb - aa;
                }
            }
            let count = self.kernel.count;
            for (n, correlation) in part.iter_mut().enumerate() {
                let spread = squares[n] - sums[n] * sums[n] / count;
                *correlation = match spread > self.least * count {
                    true => products[n] / (spread * self.kernel.squares).sqrt(),
                    false => 0.0,
                };
            }
            at += COLUMNS as isize;
        }
    }
}

#[cfg(test)]
mod tests;
