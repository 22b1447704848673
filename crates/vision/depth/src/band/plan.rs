//! Plans the disparity band of a pair from prior knowledge of the scene.
//!
//! There are three sources: coarse matching of the pair itself ([`Probe`]), the disparity map of
//! the previous pair, and the ground plane. A [`Plan`] takes the disparity range of each source row
//! by row and builds a band that contains all of them with a margin. A source only adds disparities
//! and never removes any.

use crate::band::Band;
use crate::config::{Config, Margin, Preset};
use crate::error::DepthError;
use crate::map::{DisparityMap, Geometry};
use crate::matcher::Matcher;
use imaging::ImageView;

/// A plane: all points `p` with `normal . p = distance_m`, in the left optical frame (x right, y
/// down, z forward).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Unit normal.
    pub normal: [f64; 3],
    /// Distance from the origin, m.
    pub distance_m: f64,
}

/// Block height, rows: bands change only at multiples of it, because every change costs time.
const BLOCK_ROWS: usize = 8;

/// Disparity range that each row needs.
///
/// ```
/// use depth::band::plan::Plan;
/// use depth::{Band, Margin};
///
/// let mut plan = Plan::new(&Band::full(0, 64, 32)?);
/// for row in 0..16 {
///     plan.add(row, [20, 24]);
/// }
/// let band = plan.finish(&Margin::default())?;
/// assert!(band.row(0)[0] <= 17 && band.row(0)[1] >= 27);
/// assert!(band.row(0)[1] < 63);
/// // No prior knowledge of the lower rows: the full range.
/// assert_eq!(band.row(31), [0, 63]);
/// # Ok::<(), depth::DepthError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    full: Band,
    rows: Vec<Option<[i32; 2]>>,
}

impl Plan {
    /// A plan without prior knowledge. `full` is the full search range.
    pub fn new(full: &Band) -> Self {
        Self {
            full: full.clone(),
            rows: vec![None; full.height()],
        }
    }

    /// Adds an inclusive range of disparities to a row, px. Rows beyond the last one are ignored.
    pub fn add(&mut self, y: usize, [low, high]: [i32; 2]) {
        if let Some(row) = self.rows.get_mut(y) {
            let [a, b] = row.unwrap_or([low, high]);
            *row = Some([a.min(low), b.max(high)]);
        }
    }

    /// Adds the disparities of a map of the same size.
    pub fn add_map(&mut self, map: &DisparityMap) {
        self.add_scaled(map, 1);
    }

    /// Adds the disparities of a map that is smaller by the factor `scale`.
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

    /// Adds the disparities of a plane where it is in front of the cameras; `width` is the number
    /// of image columns.
    ///
    /// ```
    /// use depth::band::plan::{Plan, Plane};
    /// use depth::{Band, Geometry, Margin};
    ///
    /// // The floor, 1.4 m below a camera that looks straight ahead.
    /// let floor = Plane { normal: [0.0, 1.0, 0.0], distance_m: 1.4 };
    /// let geometry = Geometry { focal_px: 50.0, center: [31.5, 23.5], baseline_m: 0.5, offset_px: 0.0 };
    /// let mut plan = Plan::new(&Band::full(0, 64, 48)?);
    /// plan.add_plane(&geometry, 64, &floor);
    /// let mut margin = Margin::default();
    /// margin.rows = 0;
    /// let band = plan.finish(&margin)?;
    /// // The lowest row shows it at 3 m, a disparity of 8.4 px; above the horizon nothing is known.
    /// assert!(band.row(47)[0] <= 8 && band.row(47)[1] >= 8 && band.row(47)[1] < 20);
    /// assert_eq!(band.row(0), [0, 63]);
    /// # Ok::<(), depth::DepthError>(())
    /// ```
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

    /// Builds the band with a margin. Rows without prior knowledge get the full range.
    ///
    /// # Errors
    /// Those that the full band would give as well.
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

/// Coarse matching of a pair over all disparities, at a quarter of its width and height. It costs
/// about 1/64 of the full resolution and finds objects larger than about a dozen pixels, also those
/// that were not in the previous pair.
#[derive(Debug)]
pub struct Probe {
    matcher: Matcher,
    small: [Vec<u8>; 2],
    size: [usize; 2],
    band: Band,
}

/// Downsampling factor in both directions.
const SCALE: usize = 4;
/// Minimum side of the downsampled image, px.
const MIN_SIDE_PX: usize = 16;

impl Probe {
    /// For images of `width` columns with the rows and disparities of `full`. `None` if the images
    /// are too small for coarse matching.
    ///
    /// # Errors
    /// Those that the full band would give as well.
    pub fn new(full: &Band, width: usize) -> Result<Option<Self>, DepthError> {
        let size = [width / SCALE, full.height() / SCALE];
        if size[0] < MIN_SIDE_PX || size[1] < MIN_SIDE_PX {
            return Ok(None);
        }
        let scale = SCALE as i32;
        let first = full.first().div_euclid(scale);
        let last = (full.first() + full.count() as i32).div_euclid(scale) + 1;
        // Small objects matter here and holes do not, so that disparity jumps are cheap. This is
        // the same for every preset of the matcher: a sixteenth of the pixels costs little.
        let mut config = Config {
            min_speckle_px: 4,
            ..Config::preset(Preset::Balanced)
        };
        for matching in [&mut config.clear, &mut config.noisy] {
            let penalties = &mut matching.penalties;
            penalties.small /= 2;
            penalties.large /= 2;
            penalties.min_large /= 2;
        }
        Ok(Some(Self {
            matcher: Matcher::new(config, size[0], size[1])?,
            small: [Vec::new(), Vec::new()],
            size,
            band: Band::full(first, (last - first + 1) as usize, size[1])?,
        }))
    }

    /// Adds the disparities found in a pair to a plan.
    ///
    /// # Errors
    /// [`DepthError::Size`] if the sizes of the images differ from each other or from the
    /// configured size.
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
            ImageView::packed(size(p)[0], size(p)[1], &self.small[eye])
        };
        let (left, right) = (small(left, 0)?, small(right, 1)?);
        let map = self.matcher.run(&left, &right, &self.band)?;
        debug_assert_eq!([map.width, map.height], self.size);
        // A coarse disparity is accurate to about one coarse pixel.
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

/// Downsamples by averaging 4x4 pixels.
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
