//! A part of an image in joined pixels, and the correlation of a pattern with all its places.

use std::ops::Range;

use cad_transforms::RigidTransform;
use estimator_config::config;

use crate::blur::Blur;
use crate::tag::Tag;
use crate::template::Template;
use crate::view::View;

config! {
    /// Configuration of [`locate`](crate::locate()).
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

/// A pixel of the image at which the pattern may be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub(super) pixel: [f64; 2],
    pub(super) correlation: f32,
}

/// The pattern of a tag in joined pixels, minus its mean.
pub(super) struct Kernel {
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
    pub(super) fn new(
        tag: &Tag,
        blur: &Blur,
        [x, y]: &[[f64; 2]; 2],
        factor: usize,
    ) -> Option<Self> {
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

/// A rectangle of an image around a place: corners, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Frame {
    from: [usize; 2],
    to: [usize; 2],
}

impl Frame {
    /// Distance of two rectangles up to which one is taken for the other, as a share of its side.
    const NEAR_SHARE: f64 = 0.05;

    /// The part of an image up to a distance from a pose; `None` if it is behind the eye.
    pub(super) fn around(view: &View<'_>, start: &RigidTransform, reach_m: f64) -> Option<Self> {
        let at = view.eye_from_reference.apply(start.translation_m());
        if at[2] < 0.1 {
            return None;
        }
        let middle = view.lens.project(at)?;
        let reach = reach_m / at[2] * view.lens.model().fx;
        let image = [view.image.width(), view.image.height()];
        Some(Self {
            from: [0, 1].map(|k: usize| (middle[k] - reach).max(0.0) as usize),
            to: [0, 1].map(|k| (middle[k] + reach).clamp(0.0, image[k] as f64) as usize),
        })
    }

    pub(super) fn is_near(&self, other: &Self) -> bool {
        (0..2).all(|k| {
            let most = Self::NEAR_SHARE * (self.to[k] as f64 - self.from[k] as f64);
            let apart = self.from[k].abs_diff(other.from[k]);
            (apart.max(self.to[k].abs_diff(other.to[k])) as f64) < most
        })
    }
}

/// A part of an image, in joined pixels.
pub(super) struct Region {
    pub(super) frame: Frame,
    /// First pixel of the image, and the number of pixels that are joined along a side.
    from: [usize; 2],
    pub(super) factor: usize,
    size: [usize; 2],
    levels: Vec<f32>,
    /// Sums of levels and of their squares from the begin of each row on.
    sums: Vec<[f32; 2]>,
}

impl Region {
    /// A rectangle of an image; `None` if it is smaller than four joined pixels.
    pub(super) fn new(view: &View<'_>, frame: &Frame, factor: usize) -> Option<Self> {
        let mut size = [0; 2];
        for k in 0..2 {
            size[k] = frame.to[k].saturating_sub(frame.from[k]) / factor;
        }
        if size.iter().any(|size| *size < 4) {
            return None;
        }
        let from = frame.from;
        let mut levels = Vec::with_capacity(size[0] * size[1]);
        let share = 1.0 / (factor * factor) as f32;
        let mut columns = vec![0_u32; size[0] * factor];
        for row in 0..size[1] {
            columns.fill(0);
            for k in 0..factor {
                let pixels = &view.image.row(from[1] + row * factor + k)[from[0]..];
                for (sum, pixel) in columns.iter_mut().zip(pixels) {
                    *sum += u32::from(*pixel);
                }
            }
            let joined = columns.chunks_exact(factor);
            levels.extend(joined.map(|part| share * part.iter().sum::<u32>() as f32));
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
            frame: *frame,
            from,
            factor,
            size,
            sums: sums.collect(),
            levels,
        })
    }

    /// The pixels of the image at which the pattern correlates best, the best one of some around
    /// each.
    pub(super) fn candidates(&self, kernel: &Kernel, config: &LocateConfig) -> Vec<Candidate> {
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
    pub(super) fn best_near(
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
        simd_dispatch::run(Correlate::<'_, COLUMNS> {
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

impl<const COLUMNS: usize> simd_dispatch::Kernel for Correlate<'_, COLUMNS> {
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
