//! Stereo matcher: from two rectified images to a disparity map.

use rayon::prelude::*;

use crate::aggregation::{Aggregation, NONE, Range, Weights};
use crate::band::Band;
use crate::config::Config;
use crate::consistency::Winners;
use crate::correlation::{Correlation, LocalStats};
use crate::error::DepthError;
use crate::half_resolution::HalfResolution;
use crate::lanes::Level;
use crate::map::DisparityMap;
use crate::median::median;
use crate::noise;
use crate::sigma::{Evidence, Model};
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
    smoothed: [Vec<u8>; 2],
    consistent: Vec<f32>,
    speckle_filter: SpeckleFilter,
    local_stats: LocalStats,
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
    /// Whether the image was matched as a noisy one.
    pub is_noisy: bool,
    /// Number of pixels of each row whose winning disparity is at the lower and at the upper end of
    /// the band of the row.
    pub at_end: Vec<[u32; 2]>,
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
            smoothed: [Vec::new(), Vec::new()],
            consistent: Vec::new(),
            speckle_filter: SpeckleFilter::default(),
            local_stats: LocalStats::default(),
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
    /// // The sigma of a pixel follows from its evidence alone.
    /// let pixel = 24 * 128 + 80;
    /// let evidence = matcher.evidence()[pixel];
    /// assert_eq!(matcher.map().sigma[pixel], Model::of(config.paths).sigma_px(&evidence));
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
        let noise = noise::estimate(left);
        match &mut self.half_resolution {
            None => self.run_through(left, right, band, noise)?,
            Some(half_resolution) => {
                let to = (&mut self.map, &mut self.stats);
                half_resolution.run(left, right, band, noise, to)?;
            }
        }
        Ok(&self.map)
    }

    /// Matches a pair of the correct size. `noise` is the standard deviation of the image noise,
    /// gray levels.
    pub(crate) fn run_through(
        &mut self,
        left: &ImageView<'_>,
        right: &ImageView<'_>,
        band: &Band,
        noise: Option<f64>,
    ) -> Result<(), DepthError> {
        self.stats.noise = noise;
        self.aggregate(left, right, band)?;
        self.check_consistency(band);
        self.assign_sigma(left, right);
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
        if !matching.smooth {
            self.aggregation
                .run(self.level, weights, [left, right], range);
            return Ok(());
        }
        let [of_left, of_right] = &mut self.smoothed;
        rayon::join(
            || noise::smooth(left, of_left),
            || noise::smooth(right, of_right),
        );
        let (width, height) = (self.map.width, self.map.height);
        let left = ImageView::packed(width, height, of_left)?;
        let right = ImageView::packed(width, height, of_right)?;
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
            max_lr_difference_px: self.config.max_lr_difference_px,
            uniqueness_percent: self.config.uniqueness_percent,
        };
        winners_of_both.left_right_check(&mut self.consistent);
        if self.config.median {
            median(self.level, width, &self.consistent, &mut self.map.disparity);
        } else {
            self.map.disparity.clone_from(&self.consistent);
        }
        let (step, least) = (self.config.speckle_step_px, self.config.min_speckle_px);
        self.speckle_filter
            .remove(width, &mut self.map.disparity, step, least);
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
        self.local_stats.compute(width, &self.map.disparity);
        self.correlation.compute(left, right, &self.map.disparity);
        let config = &self.config;
        let stores_evidence = self.stores_evidence;
        let rows = self.map.disparity.par_chunks_exact_mut(width);
        let rows = rows.zip(self.map.sigma.par_chunks_exact_mut(width));
        let rows = rows.zip(self.aggregation.winners.par_chunks_exact(width));
        let (near, correlation, model) =
            (&self.local_stats.near, &self.correlation.near, &self.model);
        rows.enumerate()
            .for_each(|(y, ((disparities, sigmas), winners))| {
                for x in 0..width {
                    sigmas[x] = f32::NAN;
                    if disparities[x].is_nan() {
                        continue;
                    }
                    let evidence = Evidence::new(config.paths, &winners[x], near.at(x, y));
                    let sigma = model.sigma_px(&evidence);
                    let is_correlated = correlation.at(x, y) >= config.min_correlation;
                    if !is_correlated || (sigma > config.max_sigma_px && !stores_evidence) {
                        disparities[x] = f32::NAN;
                    } else {
                        sigmas[x] = sigma;
                    }
                }
            });
        self.evidence.clear();
        if stores_evidence {
            let winners = self.aggregation.winners.iter().enumerate();
            let of =
                |(i, winner)| Evidence::new(config.paths, winner, near.at(i % width, i / width));
            self.evidence.extend(winners.map(of));
        }
    }
}
