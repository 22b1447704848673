//! From what is known of a scene to the disparities that it needs.
//!
//! Three things are known before a pair is matched: what a coarse look at the pair itself finds ([`Probe`]), what was there in the pair
//! before, and where the ground is. A [`Plan`] takes the range of disparities of each, row by row, and makes a band that
//! holds all of them with a margin. Nothing takes disparities away: each source only adds its own.

use crate::band::Band;
use crate::error::DepthError;
use crate::image::ImageView;
use crate::map::{DisparityMap, Geometry};
use crate::matcher::Matcher;
use crate::settings::{Preset, Settings};

/// A plane: all points `p` with `normal . p = distance_m`, in the left optical frame (x right, y down, z forward).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Of length 1.
    pub normal: [f64; 3],
    /// m.
    pub distance_m: f64,
}

/// How much wider a band is than what is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margin {
    /// Disparities at either end, px.
    pub px: i32,
    /// The same as a share of the disparity.
    pub ratio: f64,
    /// Rows above and below that a row must hold the disparities of.
    pub rows: usize,
}

impl Margin {
    /// For walks at 15 pictures per second.
    pub const WALK: Self = Self {
        px: 3,
        ratio: 0.1,
        rows: 8,
    };
}

/// Bands change only every so many rows, at multiples of this: changes cost time.
const BLOCK_ROWS: usize = 8;

/// What each row needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    full: Band,
    rows: Vec<Option<[i32; 2]>>,
}

impl Plan {
    /// Nothing is known. `full` holds all that may be looked for.
    pub fn new(full: &Band) -> Self {
        Self {
            full: full.clone(),
            rows: vec![None; full.height()],
        }
    }

    /// A row needs these disparities, px. Rows beyond the last one are passed over.
    pub fn add(&mut self, y: usize, [low, high]: [i32; 2]) {
        if let Some(row) = self.rows.get_mut(y) {
            let [a, b] = row.unwrap_or([low, high]);
            *row = Some([a.min(low), b.max(high)]);
        }
    }

    /// All disparities of a map of the same size.
    pub fn add_map(&mut self, map: &DisparityMap) {
        self.add_scaled(map, 1);
    }

    /// Those of a map whose pixels are `scale` pixels wide.
    fn add_scaled(&mut self, map: &DisparityMap, scale: i32) {
        for (y, row) in map.disparity.chunks_exact(map.width.max(1)).enumerate() {
            let found = row.iter().filter(|d| !d.is_nan());
            let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
            for disparity in found {
                low = low.min(*disparity);
                high = high.max(*disparity);
            }
            if low <= high {
                let range = [low.floor() as i32 * scale, high.ceil() as i32 * scale];
                for k in 0..scale as usize {
                    self.add(y * scale as usize + k, range);
                }
            }
        }
    }

    /// Those of a plane, where it is before the cameras; for pictures of `width` columns.
    pub fn add_plane(&mut self, geometry: &Geometry, width: usize, plane: &Plane) {
        for y in 0..self.rows.len() {
            // Inverse depth is linear along a row.
            let [a, b] = [0.0, width as f64 - 1.0].map(|x| {
                let ray = [
                    (x - geometry.center[0]) / geometry.focal_px,
                    (y as f64 - geometry.center[1]) / geometry.focal_px,
                    1.0,
                ];
                let along: f64 = ray.iter().zip(plane.normal).map(|(r, n)| r * n).sum();
                geometry.focal_px * geometry.baseline_m * along / plane.distance_m
            });
            let (low, high) = (a.min(b).max(0.0), a.max(b));
            if high > 0.0 {
                let [low, high] = [low, high].map(|d| d - geometry.offset_px);
                self.add(y, [low.floor() as i32, high.ceil() as i32]);
            }
        }
    }

    /// The band: what rows need, with a margin. Rows of which nothing is known get all there is.
    ///
    /// # Errors
    /// None that a full band would not have given.
    pub fn finish(&self, margin: &Margin) -> Result<Band, DepthError> {
        let height = self.rows.len();
        let mut rows = Vec::with_capacity(height);
        for block in (0..height).step_by(BLOCK_ROWS) {
            let count = BLOCK_ROWS.min(height - block);
            let near = block.saturating_sub(margin.rows)..(block + count + margin.rows).min(height);
            let (mut low, mut high) = (i32::MAX, i32::MIN);
            let (mut lowest, mut highest) = (i32::MAX, i32::MIN);
            for y in near {
                let full = self.full.row(y);
                let [a, b] = self.rows[y].unwrap_or(full);
                low = low.min(a);
                high = high.max(b);
                lowest = lowest.min(full[0]);
                highest = highest.max(full[1]);
            }
            let more = |d: i32| margin.px + (f64::from(d.max(0)) * margin.ratio).ceil() as i32;
            let low = low.saturating_sub(more(low)).clamp(lowest, highest);
            let high = high.saturating_add(more(high)).clamp(lowest, highest);
            rows.extend(std::iter::repeat_n([low.min(high), high], count));
        }
        Band::rows(&rows)
    }
}

/// A coarse look at a pair: a quarter of its size both ways, all disparities. It takes about a sixty-fourth of the work and finds
/// whatever is larger than about a dozen pixels, wherever it came from.
#[derive(Debug)]
pub struct Probe {
    matcher: Matcher,
    small: [Vec<u8>; 2],
    size: [usize; 2],
    band: Band,
}

/// How much smaller the pictures are that are looked at.
const SCALE: usize = 4;
/// The smallest side of what is left.
const MIN_SIDE_PX: usize = 16;

impl Probe {
    /// For pictures of `width` columns, and rows and disparities of a band; none where they are too small for a coarse look.
    ///
    /// # Errors
    /// None that a full band would not have given.
    pub fn new(full: &Band, width: usize) -> Result<Option<Self>, DepthError> {
        let size = [width / SCALE, full.height() / SCALE];
        if size[0] < MIN_SIDE_PX || size[1] < MIN_SIDE_PX {
            return Ok(None);
        }
        let scale = SCALE as i32;
        let first = full.first().div_euclid(scale);
        let last = (full.first() + full.count() as i32).div_euclid(scale) + 1;
        // Little things count here, and nobody minds a hole: jumps are cheap.
        let mut settings = Settings {
            min_speckle_px: 4,
            ..Settings::preset(Preset::Balanced)
        };
        for matching in [&mut settings.clear, &mut settings.noisy] {
            let penalties = &mut matching.penalties;
            penalties.small /= 2;
            penalties.large /= 2;
            penalties.min_large /= 2;
        }
        Ok(Some(Self {
            matcher: Matcher::new(settings, size[0], size[1])?,
            small: [Vec::new(), Vec::new()],
            size,
            band: Band::full(first, (last - first + 1) as usize, size[1])?,
        }))
    }

    /// Adds what is found in a pair to a plan.
    ///
    /// # Errors
    /// [`DepthError::Size`] where the right picture has another size than the left one, or both than was said.
    pub fn search(
        &mut self,
        left: &ImageView<'_>,
        right: &ImageView<'_>,
        plan: &mut Plan,
    ) -> Result<(), DepthError> {
        for (image, small) in [left, right].into_iter().zip(&mut self.small) {
            shrink(image, small);
        }
        let size = |p: &ImageView<'_>| [p.width() / SCALE, p.height() / SCALE];
        let small = |p: &ImageView<'_>, eye: usize| {
            ImageView::new(size(p)[0], size(p)[1], &self.small[eye])
        };
        let (left, right) = (small(left, 0)?, small(right, 1)?);
        let map = self.matcher.run(&left, &right, &self.band)?;
        debug_assert_eq!([map.width, map.height], self.size);
        // A coarse pixel's disparity is right to about one coarse pixel.
        let mut near = Plan::new(&plan.full);
        near.add_scaled(map, SCALE as i32);
        for (y, row) in near.rows.iter().enumerate() {
            if let Some([low, high]) = row {
                plan.add(y, [low - SCALE as i32, high + SCALE as i32]);
            }
        }
        Ok(())
    }
}

/// Means of 4x4 pixels.
fn shrink(image: &ImageView<'_>, small: &mut Vec<u8>) {
    let (width, height) = (image.width() / SCALE, image.height() / SCALE);
    small.clear();
    small.reserve(width * height);
    let mut sums = vec![0u16; width];
    for y in 0..height {
        sums.fill(0);
        for k in 0..SCALE {
            let row = image.row(y * SCALE + k);
            for (sum, four) in sums.iter_mut().zip(row.chunks_exact(SCALE)) {
                *sum += four.iter().map(|v| u16::from(*v)).sum::<u16>();
            }
        }
        small.extend(sums.iter().map(|sum| ((sum + 8) / 16) as u8));
    }
}

#[cfg(test)]
mod tests;
