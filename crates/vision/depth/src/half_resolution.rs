//! Matching at reduced resolution: half the rows cost half the time, half of both sides an eighth.
//!
//! Contract: the images are downsampled and matched, and the map is upsampled to their size:
//! bilinear between four neighbors on one surface, nearest neighbor elsewhere. Objects with fewer
//! than about ten remaining pixels are lost, and edges have a resolution of two pixels along the
//! halved sides.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::band::Band;
use crate::config::Config;
use crate::error::DepthError;
use crate::map::DisparityMap;
use crate::matcher::{MatchStats, Matcher, PairProperties};
use imaging::ImageView;

/// Downsampling before matching.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Downsample {
    /// Half the rows: the disparity resolution is unchanged.
    Rows,
    /// Half the rows and half the columns.
    Both,
}

/// Matcher of downsampled images.
#[derive(Debug)]
pub(crate) struct HalfResolution {
    /// Divisors of columns and rows.
    by: [usize; 2],
    pub(crate) matcher: Matcher,
    small: [Vec<u8>; 2],
}

/// Maximum disparity difference of a neighbor on the surface of a pixel, px of the downsampled
/// image.
const MAX_STEP_PX: f32 = 1.0;

impl HalfResolution {
    /// For images of `width` x `height` pixels. Sigmas of the configuration are px of these images,
    /// and are converted; all other fields apply unchanged.
    ///
    /// # Errors
    /// [`DepthError::Config`], also if the images are too small to be halved.
    pub(crate) fn new(
        config: Config,
        downsample: Downsample,
        width: usize,
        height: usize,
    ) -> Result<Self, DepthError> {
        let by = match downsample {
            Downsample::Rows => [1, 2],
            Downsample::Both => [2, 2],
        };
        let config = Config {
            downsample: None,
            // A speckle of the same extent has fewer pixels.
            min_speckle_px: config.min_speckle_px / (by[0] * by[1]),
            max_sigma_px: config.max_sigma_px / by[0] as f32,
            column_offset_sigma_px: config.column_offset_sigma_px / by[0] as f32,
            ..config
        };
        Ok(Self {
            by,
            matcher: Matcher::new(config, width / by[0], height / by[1])?,
            small: [Vec::new(), Vec::new()],
        })
    }

    /// Matches an aligned pair of the size of the map. The statistics are given for its rows.
    pub(crate) fn run(
        &mut self,
        left: &ImageView<'_>,
        right: &ImageView<'_>,
        band: &Band,
        properties: PairProperties,
        (map, stats): (&mut DisparityMap, &mut MatchStats),
    ) -> Result<(), DepthError> {
        let by = self.by;
        // Noise of the averaged pixels. Estimated from the downsampled image, fine texture would
        // count as noise.
        let averaged = ((by[0] * by[1]) as f64).sqrt();
        let of_means = PairProperties {
            noise: properties.noise.map(|noise| noise / averaged),
            // Only the sigma of the column offset depends on it, which is px of columns.
            row_offset_px: properties.row_offset_px / by[0] as f64,
        };
        let [a, b] = &mut self.small;
        rayon::join(|| shrink(left, by, a), || shrink(right, by, b));
        let [width, height] = [map.width / by[0], map.height / by[1]];
        let left = ImageView::packed(width, height, &self.small[0])?;
        let right = ImageView::packed(width, height, &self.small[1])?;
        let band = half_band(band, by, height)?;
        self.matcher.match_aligned(&left, &right, &band, of_means)?;
        enlarge(self.matcher.map(), by, map);
        let found = self.matcher.stats();
        (stats.noise, stats.row_offset_px) = (properties.noise, properties.row_offset_px);
        stats.is_noisy = found.is_noisy;
        stats.smoothing = found.smoothing;
        let columns = by[0] as u32;
        let of = |y: usize| found.at_end[(y / by[1]).min(height - 1)].map(|count| count * columns);
        stats.at_end = (0..map.height).map(of).collect();
        Ok(())
    }
}

/// Band of the downsampled images: the union of the ranges of the two rows that form one.
fn half_band(band: &Band, by: [usize; 2], height: usize) -> Result<Band, DepthError> {
    let rows: Vec<[i32; 2]> = (0..height)
        .map(|y| {
            let pair = [band.row(2 * y), band.row(2 * y + 1)];
            let low = pair[0][0].min(pair[1][0]);
            let high = pair[0][1].max(pair[1][1]);
            match by[0] {
                1 => [low, high],
                _ => [low.div_euclid(2), (high + 1).div_euclid(2)],
            }
        })
        .collect();
    Band::rows(&rows)
}

/// Downsamples by averaging two rows, or 2x2 pixels.
fn shrink(image: &ImageView<'_>, by: [usize; 2], small: &mut Vec<u8>) {
    let (width, height) = (image.width() / by[0], image.height() / by[1]);
    small.resize(width * height, 0);
    for (y, to) in small.chunks_exact_mut(width.max(1)).enumerate() {
        let (upper, lower) = (image.row(2 * y), image.row(2 * y + 1));
        if by[0] == 1 {
            for (to, (a, b)) in to.iter_mut().zip(upper.iter().zip(lower)) {
                *to = (u16::from(*a) + u16::from(*b)).div_ceil(2) as u8;
            }
            continue;
        }
        let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
        for (to, (a, b)) in to.iter_mut().zip(pairs) {
            let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
            *to = ((sum + 2) / 4) as u8;
        }
    }
}

/// Upsamples a map; if columns were halved, disparities are doubled.
fn enlarge(small: &DisparityMap, by: [usize; 2], map: &mut DisparityMap) {
    let longer = by[0] as f32;
    let parents_of_columns: Vec<[usize; 2]> = (0..map.width)
        .map(|x| parents(x, by[0], small.width))
        .collect();
    let rows = map.disparity.par_chunks_exact_mut(map.width);
    let rows = rows.zip(map.sigma.par_chunks_exact_mut(map.width));
    rows.enumerate().for_each(|(y, (disparities, sigmas))| {
        let rows = parents(y, by[1], small.height).map(|row| row * small.width);
        let [row, other_row] = rows.map(|from| &small.disparity[from..from + small.width]);
        let of_row = &small.sigma[rows[0]..rows[0] + small.width];
        let to = disparities.iter_mut().zip(sigmas);
        for ((disparity, sigma), [column, other]) in to.zip(&parents_of_columns) {
            let own = row[*column];
            let near = [row[*other], other_row[*column], other_row[*other]];
            // False for NaN.
            let is_whole = near.iter().all(|d| (d - own).abs() <= MAX_STEP_PX);
            let value = match is_whole {
                true => 0.5625 * own + 0.1875 * (near[0] + near[1]) + 0.0625 * near[2],
                false => own,
            };
            *disparity = longer * value;
            *sigma = longer * of_row[*column];
        }
    });
}

/// Parent of a pixel along a side that was reduced `by` times to `count`, and the neighbor of the
/// parent on the side of the pixel, whose weight is 1/4.
fn parents(k: usize, by: usize, count: usize) -> [usize; 2] {
    let own = (k / by).min(count - 1);
    let other = match (by, k % 2) {
        (1, _) => own,
        (_, 0) => own.wrapping_sub(1),
        (_, _) => own + 1,
    };
    [own, if other < count { other } else { own }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Preset;
    use crate::reference::Random;

    const WIDTH: usize = 161;
    const HEIGHT: usize = 97;
    const SHIFT: usize = 14;

    /// Images of a wall.
    fn wall() -> [Vec<u8>; 2] {
        let mut random = Random(3);
        // Dots of 3x3 pixels: smaller ones do not survive the downsampling.
        let wide = WIDTH + SHIFT;
        let dots: Vec<u8> = (0..wide * HEIGHT)
            .map(|_| random.below(256) as u8)
            .collect();
        let at = |x: usize, y: usize| dots[(y / 3) * wide + x / 3];
        let eye = |from: usize| -> Vec<u8> {
            let all = (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y)));
            all.map(|(x, y)| at(x + from, y)).collect()
        };
        [eye(0), eye(SHIFT)]
    }

    #[test]
    fn wall_is_found_at_its_disparity() {
        let [left, right] = wall();
        let left = ImageView::packed(WIDTH, HEIGHT, &left).unwrap();
        let right = ImageView::packed(WIDTH, HEIGHT, &right).unwrap();
        let band = Band::full(0, 32, HEIGHT).unwrap();
        for downsample in [Downsample::Rows, Downsample::Both] {
            let config = Config {
                downsample: Some(downsample),
                ..Config::preset(Preset::Fast)
            };
            let mut matcher = Matcher::new(config, WIDTH, HEIGHT).unwrap();
            let map = matcher.run(&left, &right, &band).unwrap();
            // The right image does not show the first columns.
            let rows = map.disparity.chunks(WIDTH).flat_map(|row| &row[SHIFT..]);
            let found = rows.filter(|d| !d.is_nan());
            let close = found.clone().filter(|d| (**d - SHIFT as f32).abs() < 1.0);
            let (found, close) = (found.count(), close.count());
            assert!(found > WIDTH * HEIGHT * 3 / 4, "{downsample:?}: {found}");
            assert!(
                close > found * 99 / 100,
                "{downsample:?}: {close} of {found}"
            );
            let both = map.sigma.iter().zip(&map.disparity);
            assert!(both.clone().all(|(s, d)| s.is_nan() == d.is_nan()));
            assert_eq!(matcher.stats().at_end.len(), HEIGHT);
        }
    }

    #[test]
    fn sigmas_of_the_configuration_are_px_of_the_full_image() {
        let [left, right] = wall();
        let left = ImageView::packed(WIDTH, HEIGHT, &left).unwrap();
        let right = ImageView::packed(WIDTH, HEIGHT, &right).unwrap();
        let band = Band::full(0, 32, HEIGHT).unwrap();
        let sigmas = |config: Config, downsample, row_offset_px: f64| {
            let mut half_resolution =
                HalfResolution::new(config, downsample, WIDTH, HEIGHT).unwrap();
            let mut map = DisparityMap {
                width: WIDTH,
                height: HEIGHT,
                disparity: vec![0.0; WIDTH * HEIGHT],
                sigma: vec![0.0; WIDTH * HEIGHT],
            };
            let mut stats = MatchStats::default();
            let properties = PairProperties {
                noise: None,
                row_offset_px,
            };
            let to = (&mut map, &mut stats);
            half_resolution
                .run(&left, &right, &band, properties, to)
                .unwrap();
            assert_eq!(stats.row_offset_px, row_offset_px);
            map.sigma
        };
        for downsample in [Downsample::Rows, Downsample::Both] {
            let own = Config {
                column_offset_sigma_px: 0.0,
                max_sigma_px: f32::INFINITY,
                ..Config::preset(Preset::Fast)
            };
            let with_offset = Config {
                column_offset_sigma_px: 0.3,
                column_offset_ratio: 0.5,
                ..own
            };
            let offset = sigmas(with_offset, downsample, 0.8);
            let own_sigmas = sigmas(own, downsample, 0.0);
            let mut known = 0;
            for (own, whole) in own_sigmas.iter().zip(&offset) {
                assert_eq!(own.is_nan(), whole.is_nan());
                if own.is_nan() {
                    continue;
                }
                known += 1;
                let expected = (own * own + 0.3 * 0.3 + 0.4 * 0.4).sqrt();
                assert!(
                    (whole - expected).abs() < 1e-5,
                    "{downsample:?}: {whole} {expected}"
                );
            }
            assert!(known > WIDTH * HEIGHT / 2, "{downsample:?}: {known}");
            // The limit applies to the sigma of the map.
            let mut ascending: Vec<f32> = own_sigmas;
            ascending.retain(|s| !s.is_nan());
            ascending.sort_by(f32::total_cmp);
            let most = ascending[ascending.len() / 2];
            let expected = ascending.partition_point(|s| *s <= most);
            assert!(expected < known, "{downsample:?}: {expected} of {known}");
            let lower_limit = Config {
                max_sigma_px: most,
                ..own
            };
            let remaining = sigmas(lower_limit, downsample, 0.0);
            assert!(remaining.iter().all(|s| s.is_nan() || *s <= most));
            assert_eq!(remaining.iter().filter(|s| !s.is_nan()).count(), expected);
        }
    }

    #[test]
    fn upsampling_interpolates_surfaces_and_preserves_edges() {
        let small = DisparityMap {
            width: 3,
            height: 1,
            disparity: vec![4.0, 5.0, 20.0],
            sigma: vec![0.1, 0.2, 0.3],
        };
        let mut map = DisparityMap {
            width: 7,
            height: 2,
            disparity: vec![0.0; 14],
            sigma: vec![0.0; 14],
        };
        enlarge(&small, [2, 2], &mut map);
        assert_eq!(map.disparity[..7], [8.0, 8.5, 9.5, 10.0, 40.0, 40.0, 40.0]);
        assert_eq!(map.sigma[..7], [0.2, 0.2, 0.4, 0.4, 0.6, 0.6, 0.6]);
        // With half the rows alone disparities are unchanged.
        let mut map = DisparityMap {
            width: 3,
            height: 3,
            disparity: vec![0.0; 9],
            sigma: vec![0.0; 9],
        };
        enlarge(&small, [1, 2], &mut map);
        assert_eq!(map.disparity, [4.0, 5.0, 20.0].repeat(3));
    }

    #[test]
    fn image_too_small_to_be_halved_is_rejected() {
        let config = Config {
            downsample: Some(Downsample::Rows),
            ..Config::preset(Preset::Fast)
        };
        assert!(Matcher::new(config, 40, 1).is_err());
    }
}
