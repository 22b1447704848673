//! Stereo matcher: from two rectified images to a disparity map.

use rayon::prelude::*;

use crate::aggregation::{Aggregation, NONE, Range, Weights};
use crate::band::Band;
use crate::config::Config;
use crate::consistency::Winners;
use crate::correlation::{Cells, Correlation, LocalStats};
use crate::error::DepthError;
use crate::half_resolution::HalfResolution;
use crate::lanes::Level;
use crate::map::DisparityMap;
use crate::median::median;
use crate::noise;
use crate::planes::{PlaneBuffers, Planes};
use crate::row_alignment::RowAlignment;
use crate::sigma::{Evidence, Model};
use crate::smoothing::smooth;
use crate::speckle::SpeckleFilter;
use imaging::ImageView;

/// Matches pairs of one size and reuses its buffers from pair to pair.
///
/// The same pair gives the same map, whatever pairs were matched before, on any number of threads.
#[derive(Debug)]
pub struct Matcher {
    config: Config,
    level: Level,
    /// Matcher of the downsampled images, if configured.
    half_resolution: Option<Box<HalfResolution>>,
    model: Model,
    aggregation: Aggregation,
    row_alignment: RowAlignment,
    smoothed: [Vec<u8>; 2],
    candidates: Vec<f32>,
    lr_differences: Vec<u8>,
    consistent: Vec<f32>,
    speckle_filter: SpeckleFilter,
    local_stats: LocalStats,
    /// Logarithms of the sigma model by neighborhood.
    neighborhood_logs: Cells<f32>,
    plane_buffers: PlaneBuffers,
    correlation: Correlation,
    evidence: Vec<Evidence>,
    stores_evidence: bool,
    map: DisparityMap,
    stats: MatchStats,
}

/// Statistics of one matched pair.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MatchStats {
    /// Standard deviation of the image noise, gray levels; absent if no block is well exposed.
    pub noise: Option<f64>,
    /// Root mean square row offset of the pair that was corrected, px; 0 where none is significant.
    pub row_offset_px: f64,
    /// Whether the image was matched as a noisy one.
    pub is_noisy: bool,
    /// Smoothing of the images before matching: 0 for none, 1 for the binomial kernel.
    pub smoothing: f64,
    /// Number of pixels of each row whose winning disparity is at the lower and at the upper end of
    /// the band of the row.
    pub at_end: Vec<[u32; 2]>,
}

/// Noise and row offset of a pair, which are estimated before it is matched.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PairProperties {
    /// Standard deviation of the noise, gray levels.
    pub(crate) noise: Option<f64>,
    /// Root mean square row offset that was corrected, px.
    pub(crate) row_offset_px: f64,
}

impl Matcher {
    /// A matcher for images of `width` x `height` pixels.
    ///
    /// # Errors
    /// [`DepthError::Config`].
    pub fn new(config: Config, width: usize, height: usize) -> Result<Self, DepthError> {
        config.validate()?;
        if width == 0 || height == 0 {
            return Err(DepthError::Config {
                what: "the image size",
                found: format!("{width} x {height}"),
                expected: "at least 1 x 1".to_owned(),
            });
        }
        let half_resolution = config
            .downsample
            .map(|downsample| HalfResolution::new(config, downsample, width, height));
        Ok(Self {
            half_resolution: half_resolution.transpose()?.map(Box::new),
            config,
            level: config.level.unwrap_or_else(Level::best),
            model: *Model::of(config.paths),
            aggregation: Aggregation::default(),
            row_alignment: RowAlignment::default(),
            smoothed: [Vec::new(), Vec::new()],
            candidates: Vec::new(),
            lr_differences: Vec::new(),
            consistent: Vec::new(),
            speckle_filter: SpeckleFilter::default(),
            local_stats: LocalStats::default(),
            neighborhood_logs: Cells::default(),
            plane_buffers: PlaneBuffers::default(),
            correlation: Correlation::default(),
            evidence: Vec::new(),
            stores_evidence: false,
            map: DisparityMap {
                width,
                height,
                disparity: vec![f32::NAN; width * height],
                sigma: vec![f32::NAN; width * height],
            },
            stats: MatchStats::default(),
        })
    }

    /// Replaces the sigma model of the preset.
    #[must_use]
    pub fn with_model(mut self, model: Model) -> Self {
        self.model = model;
        if let Some(half_resolution) = &mut self.half_resolution {
            half_resolution.matcher.model = model;
        }
        self
    }

    /// Stores the evidence of each pixel, to fit a model, and does not reject disparities by their
    /// sigma.
    #[must_use]
    pub fn with_evidence(mut self) -> Self {
        self.stores_evidence = true;
        if let Some(half_resolution) = &mut self.half_resolution {
            half_resolution.matcher.stores_evidence = true;
        }
        self
    }

    /// Evidence of each pixel of the last map, at the downsampled resolution if images are
    /// downsampled; empty without [`Matcher::with_evidence`].
    ///
    /// ```
    /// use depth::sigma::Model;
    /// use depth::{Band, ImageView, Matcher, Config, Preset};
    ///
    /// # // A random texture of 3 x 3 patches; the right image shows it `shift` columns further to the left.
    /// # fn pair(width: usize, height: usize, shift: usize) -> [Vec<u8>; 2] {
    /// #     let gray = |x: usize, y: usize| {
    /// #         let hash = (x / 3 * 1009 + y / 3 + 1) as u64;
    /// #         40 + (hash.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 57) as u8
    /// #     };
    /// #     [0, shift].map(|from| (0..width * height).map(|i| gray(i % width + from, i / width)).collect())
    /// # }
    /// # let [left, right] = pair(128, 48, 8);
    /// let config = Config::preset(Preset::Accurate);
    /// let mut matcher = Matcher::new(config, 128, 48)?.with_evidence();
    /// let images = [ImageView::packed(128, 48, &left)?, ImageView::packed(128, 48, &right)?];
    /// matcher.run(&images[0], &images[1], &Band::full(0, 32, 48)?)?;
    ///
    /// // The sigma of a pixel follows from its evidence and the sigma of the column offset.
    /// let pixel = 24 * 128 + 80;
    /// let evidence = matcher.evidence()[pixel];
    /// let own = Model::of(config.paths).sigma_px(&evidence);
    /// let whole = (own.powi(2) + config.column_offset_sigma_px.powi(2)).sqrt();
    /// assert_eq!(matcher.map().sigma[pixel], whole);
    /// # Ok::<(), depth::DepthError>(())
    /// ```
    pub fn evidence(&self) -> &[Evidence] {
        match &self.half_resolution {
            Some(half_resolution) => half_resolution.matcher.evidence(),
            None => &self.evidence,
        }
    }

    /// The last map; all pixels are absent before the first pair.
    pub fn map(&self) -> &DisparityMap {
        &self.map
    }

    /// Statistics of the last pair.
    pub fn stats(&self) -> &MatchStats {
        &self.stats
    }

    /// Configuration of the matcher.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Matches a rectified pair.
    ///
    /// # Errors
    /// [`DepthError::Size`] if an image has another size; [`DepthError::Band`] if the band has
    /// another number of rows.
    ///
    /// ```
    /// use depth::{Band, ImageView, Matcher, Config, Preset};
    ///
    /// # // A random texture of 3 x 3 patches; the right image shows it `shift` columns further to the left.
    /// # fn pair(width: usize, height: usize, shift: usize) -> [Vec<u8>; 2] {
    /// #     let gray = |x: usize, y: usize| {
    /// #         let hash = (x / 3 * 1009 + y / 3 + 1) as u64;
    /// #         40 + (hash.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 57) as u8
    /// #     };
    /// #     [0, shift].map(|from| (0..width * height).map(|i| gray(i % width + from, i / width)).collect())
    /// # }
    /// # let [left, right] = pair(128, 48, 8);
    /// let mut matcher = Matcher::new(Config::preset(Preset::Accurate), 128, 48)?;
    /// let images = [ImageView::packed(128, 48, &left)?, ImageView::packed(128, 48, &right)?];
    /// let map = matcher.run(&images[0], &images[1], &Band::full(0, 32, 48)?)?;
    /// let at_eight = map.disparity.iter().filter(|disparity| (**disparity - 8.0).abs() < 0.5).count();
    /// assert!(at_eight > 128 * 48 / 2, "{at_eight} pixels");
    /// // The first columns are not visible in the right image.
    /// assert!(map.disparity[24 * 128..24 * 128 + 4].iter().all(|disparity| disparity.is_nan()));
    /// # Ok::<(), depth::DepthError>(())
    /// ```
    ///
    /// An image of another size is an error, not a wrong map:
    ///
    /// ```
    /// use depth::{Band, ImageView, Matcher, Config, Preset};
    ///
    /// let mut matcher = Matcher::new(Config::preset(Preset::Fast), 128, 48)?;
    /// let (full, half) = ([0; 128 * 48], [0; 64 * 48]);
    /// let images = [ImageView::packed(128, 48, &full)?, ImageView::packed(64, 48, &half)?];
    /// let refused = matcher.run(&images[0], &images[1], &Band::full(0, 32, 48)?).unwrap_err();
    /// assert_eq!(
    ///     refused.to_string(),
    ///     "matching a pair: found a right image of [64, 48] pixels, expected [128, 48] (columns and rows)"
    /// );
    /// # Ok::<(), depth::DepthError>(())
    /// ```
    pub fn run(
        &mut self,
        left: &ImageView<'_>,
        right: &ImageView<'_>,
        band: &Band,
    ) -> Result<&DisparityMap, DepthError> {
        let expected = [self.map.width, self.map.height];
        for (eye, image) in [("left", left), ("right", right)] {
            let found = [image.width(), image.height()];
            if found != expected {
                return Err(DepthError::Size {
                    eye,
                    found,
                    expected,
                });
            }
        }
        if band.height() != left.height() {
            return Err(DepthError::Band {
                found: format!("{} rows", band.height()),
                expected: format!("{}, the number of image rows", left.height()),
            });
        }
        let mut rows = std::mem::take(&mut self.row_alignment);
        let offsets = rows.run([left, right], band, self.config.min_row_offset_px);
        let right = match offsets {
            None => *right,
            Some(_) => ImageView::packed(right.width(), right.height(), &rows.aligned)?,
        };
        let properties = PairProperties {
            noise: noise::estimate(left, &right, band),
            row_offset_px: offsets.map_or(0.0, |offsets| offsets.rms_px()),
        };
        match &mut self.half_resolution {
            None => self.match_aligned(left, &right, band, properties)?,
            Some(half_resolution) => {
                let to = (&mut self.map, &mut self.stats);
                half_resolution.run(left, &right, band, properties, to)?;
            }
        }
        self.row_alignment = rows;
        if let Some(offsets) = offsets {
            let width = self.map.width;
            let rows = self.map.disparity.par_chunks_exact_mut(width).enumerate();
            rows.for_each(|(row, disparities)| {
                let error = offsets.disparity_error(row) as f32;
                disparities
                    .iter_mut()
                    .for_each(|disparity| *disparity -= error);
            });
        }
        Ok(&self.map)
    }

    /// Matches a pair of the correct size whose rows are aligned.
    pub(crate) fn match_aligned(
        &mut self,
        left: &ImageView<'_>,
        right: &ImageView<'_>,
        band: &Band,
        properties: PairProperties,
    ) -> Result<(), DepthError> {
        (self.stats.noise, self.stats.row_offset_px) = (properties.noise, properties.row_offset_px);
        self.aggregate(left, right, band)?;
        self.check_consistency(band);
        self.assign_sigma(left, right);
        if let Some(radius_px) = self.config.plane_radius_px {
            let planes = Planes {
                radius_px,
                max_step_px: self.config.max_plane_step_px,
            };
            planes.fit(self.level, left, &mut self.map, &mut self.plane_buffers);
        }
        Ok(())
    }

    fn aggregate(
        &mut self,
        left: &ImageView<'_>,
        right: &ImageView<'_>,
        band: &Band,
    ) -> Result<(), DepthError> {
        let config = &self.config;
        self.stats.is_noisy = self
            .stats
            .noise
            .is_some_and(|noise| noise >= config.min_noise);
        let [from, whole] = config.smoothed_noise;
        let noise = self.stats.noise.unwrap_or(0.0);
        self.stats.smoothing = ((noise - from) / (whole - from)).clamp(0.0, 1.0);
        let matching = match self.stats.is_noisy {
            true => config.noisy,
            false => config.clear,
        };
        let weights = Weights {
            census: matching.census,
            max_gray_cost: matching.max_gray_cost,
            paths: config.paths,
            penalties: matching.penalties,
        };
        let range = Range {
            first: band.first(),
            count: band.count(),
            rows: band.lanes(),
        };
        let smoothing = self.stats.smoothing;
        let (width, height) = (self.map.width, self.map.height);
        let view = |pixels| ImageView::packed(width, height, pixels);
        let [of_left, of_right] = &mut self.smoothed;
        let [left, right] = match smoothing == 0.0 {
            true => [*left, *right],
            false => {
                rayon::join(
                    || smooth(left, smoothing, of_left),
                    || smooth(right, smoothing, of_right),
                );
                [view(of_left)?, view(of_right)?]
            }
        };
        self.aggregation
            .run(self.level, weights, [&left, &right], range);
        Ok(())
    }

    /// Converts winners to disparities: left-right check, median, speckle filter. Counts the
    /// winners at the ends of the band.
    fn check_consistency(&mut self, band: &Band) {
        let width = self.map.width;
        let winners = &self.aggregation.winners;
        let winners_of_both = Winners {
            width,
            first: band.first(),
            left: winners,
            right: &self.aggregation.right,
            uniqueness_percent: self.config.uniqueness_percent,
        };
        let (candidates, differences) = (&mut self.candidates, &mut self.lr_differences);
        winners_of_both.disparities(candidates, differences);
        let max_difference = self.config.max_lr_difference_px;
        let is_consistent = |i: usize| differences[i] <= max_difference;
        let (step, least) = (self.config.speckle_step_px, self.config.min_speckle_px);
        self.speckle_filter
            .remove(width, candidates, is_consistent, step, least);
        if self.config.median {
            median(self.level, width, candidates, &mut self.map.disparity);
        } else {
            self.map.disparity.clone_from(candidates);
        }
        let kept = self.map.disparity.par_iter().zip(&*differences);
        kept.map(
            |(disparity, difference)| match *difference <= max_difference {
                true => *disparity,
                false => f32::NAN,
            },
        )
        .collect_into_vec(&mut self.consistent);
        let rows = band.lanes().par_iter().zip(winners.par_chunks_exact(width));
        let kept = self.map.disparity.par_chunks_exact(width);
        let at_end = rows.zip(kept).map(|(([low, high], winners), kept)| {
            let mut count = [0; 2];
            for (winner, kept) in winners.iter().zip(kept) {
                if winner.lane != NONE && !kept.is_nan() {
                    count[0] += u32::from(winner.lane == *low);
                    count[1] += u32::from(winner.lane + 1 == *high);
                }
            }
            count
        });
        self.stats.at_end.clear();
        self.stats.at_end.par_extend(at_end);
    }

    /// Assigns a sigma to each disparity, and rejects disparities with a low correlation or a large
    /// sigma.
    fn assign_sigma(&mut self, left: &ImageView<'_>, right: &ImageView<'_>) {
        let width = self.map.width;
        self.local_stats.compute(width, &self.consistent);
        self.correlation.compute(left, right, &self.map.disparity);
        let config = &self.config;
        let stores_evidence = self.stores_evidence;
        let (near, correlation, model) =
            (&self.local_stats.near, &self.correlation.near, &self.model);
        let (winners, differences) = (&self.aggregation.winners, &self.lr_differences);
        self.evidence.clear();
        if stores_evidence {
            let evidence_of = |i: usize| {
                let [x, y] = [i % width, i / width];
                let (near, correlation) = (near.at(x, y), correlation.at(x, y));
                Evidence::new(config.paths, &winners[i], differences[i], near, correlation)
            };
            self.evidence.extend((0..winners.len()).map(evidence_of));
        }
        let lr_logs = model.lr_logs();
        let log = |near, correlation| model.neighborhood_log(near, correlation);
        self.neighborhood_logs.zip(near, correlation, log);
        let neighborhood_logs = &self.neighborhood_logs;
        let of_rows = config.column_offset_ratio * self.stats.row_offset_px as f32;
        let of_calibration = config.column_offset_sigma_px.powi(2) + of_rows * of_rows;
        let rows = self.map.disparity.par_chunks_exact_mut(width);
        let rows = rows.zip(self.map.sigma.par_chunks_exact_mut(width));
        rows.enumerate().for_each(|(y, (disparities, sigmas))| {
            for x in 0..width {
                sigmas[x] = f32::NAN;
                if disparities[x].is_nan() {
                    continue;
                }
                let i = y * width + x;
                let lr_log = lr_logs[usize::from(differences[i])];
                let near_log = neighborhood_logs.at(x, y);
                let own = model.sigma_in_px(config.paths, &winners[i], lr_log, near_log);
                let sigma = (own * own + of_calibration).sqrt();
                let is_correlated = correlation.at(x, y) >= config.min_correlation;
                if !is_correlated || (sigma > config.max_sigma_px && !stores_evidence) {
                    disparities[x] = f32::NAN;
                } else {
                    sigmas[x] = sigma;
                }
            }
        });
    }
}
