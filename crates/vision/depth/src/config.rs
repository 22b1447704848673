//! Configuration and presets of the matcher.

use estimator_config::config;
use serde::{Deserialize, Serialize};

use crate::aggregation::{Paths, Penalties};
use crate::census::Census;
use crate::error::DepthError;
use crate::half_resolution::Downsample;
use crate::lanes::Level;

config! {
    /// Configuration of a matcher. The default is [`Preset::Balanced`]. The constants of the sigma
    /// model are in [`crate::sigma`]: they are valid only together with its fitted tables.
    ///
    /// Where a field names no source, its value was chosen on Motorcycle (Middlebury 2014) and on
    /// simulated walks (`cargo xtask bench depth`).
    pub struct Config {
        /// Downsampling before matching, if any. Saves time at the cost of detail.
        pub downsample: Option<Downsample> = None,
        /// Minimum root mean square row offset of a pair that is corrected before matching, px.
        /// Lower resamples images that are aligned, which blurs them.
        pub min_row_offset_px: f64 = 0.05,
        /// Matching of images with little noise.
        pub clear: Matching = Matching::clear(Census::Full5x5),
        /// Matching of noisy images.
        pub noisy: Matching = Matching::noisy(),
        /// Minimum standard deviation of the noise for an image to count as noisy, gray levels.
        /// Lower blurs edges of clear images, higher matches noise.
        pub min_noise: f64 = 1.2,
        /// Standard deviations of the noise from which on images are smoothed before matching, and
        /// from which on with the whole binomial kernel; between them in proportion. Gray levels.
        pub smoothed_noise: [f64; 2] = [0.9, 1.5],
        /// Aggregation paths. Eight take 1.6 times as long as three.
        pub paths: Paths = Paths::Eight,
        /// Maximum disparity difference between the left and the right image for a pixel to be
        /// consistent, px. Compare OpenCV SGBM `disp12MaxDiff`. Others need a region with
        /// consistent pixels, and get larger sigmas.
        pub max_lr_difference_px: u8 = 1,
        /// Minimum margin by which the second-best non-adjacent cost exceeds the best one, percent.
        /// Compare OpenCV SGBM `uniquenessRatio`. 0 leaves ambiguity to the sigma.
        pub uniqueness_percent: u16 = 0,
        /// Whether a 3x3 median filter is applied.
        pub median: bool = true,
        /// Minimum number of consistent pixels of a connected region; smaller ones are removed.
        /// Compare OpenCV SGBM `speckleWindowSize`.
        pub min_speckle_px: usize = 100,
        /// Maximum disparity difference of neighbors in one region, px. Compare OpenCV SGBM
        /// `speckleRange`.
        pub speckle_step_px: f32 = 1.5,
        /// Minimum correlation of the two images around a pixel and its match. For pure noise it is
        /// within 0.08 of 0. Lower keeps matches of noise, with large sigmas.
        pub min_correlation: f32 = 0.0,
        /// Half the side of the window in which planes are fitted to the disparities, 1 to 64 px;
        /// `None` for no fit. Larger averages more, and takes more time with its square.
        pub plane_radius_px: Option<usize> = None,
        /// Maximum disparity difference within a window for a pixel to count for its plane, px.
        pub max_plane_step_px: f32 = 1.5,
        /// Maximum sigma, px; disparities with a larger one are removed. Most of those near the
        /// default are right; users compare the sigma with the disparity.
        pub max_sigma_px: f32 = 32.0,
        /// Standard deviation of what a pair does not show, px: an offset of its disparities by an
        /// error of the rectification along rows. It is added to the sigma in quadrature.
        pub column_offset_sigma_px: f32 = 0.05,
        /// Additional standard deviation, relative to the root mean square row offset of the
        /// pair: a rectification that is wrong across rows is wrong along them too.
        pub column_offset_ratio: f32 = 0.25,
        /// Bands around a predicted disparity.
        pub band: BandConfig = BandConfig::default(),
        /// Instruction set; `None` for the most capable one of the processor. The result is the
        /// same.
        #[serde(skip)]
        pub level: Option<Level> = None,
    }

    /// Safety margin of a band around the planned disparities. The default is for walking speed at
    /// 15 frames per second. Less needs additional runs, more searches more.
    pub struct Margin {
        /// Margin at either end, px.
        pub px: i32 = 3,
        /// Additional margin as a fraction of the disparity.
        pub ratio: f64 = 0.1,
        /// Number of rows above and below whose disparities a row must also contain.
        pub rows: usize = 8,
    }

    /// The band around the predicted disparity: its margin, and when it was too narrow and is
    /// widened. `cargo xtask bench depth` measures the searched share against lost matches.
    pub struct BandConfig {
        /// Safety margin around the predicted disparities.
        pub margin: Margin = Margin::default(),
        /// Minimum fraction of the pixels of a block of 8 rows at an end of the band for it to
        /// count as clipped. Lower searches more, higher loses near objects that come into view.
        pub min_clipped_ratio: f64 = 0.02,
        /// Widening of a clipped band, px.
        pub widen_px: i32 = 16,
        /// Maximum number of additional runs; the last one searches the full range.
        pub max_reruns: u32 = 3,
    }
}

/// Matching cost and smoothness of one noise class.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Matching {
    /// Census window. A larger one is more distinctive, and blurs edges.
    pub census: Census,
    /// Limit of the gray-level cost, in units of two gray levels; one census bit costs 1.
    pub max_gray_cost: u8,
    /// Smoothness penalties.
    pub penalties: Penalties,
}

impl Matching {
    fn clear(census: Census) -> Self {
        Self {
            census,
            max_gray_cost: 8,
            penalties: Penalties::for_costs_up_to(census.bits() + 8),
        }
    }

    fn noisy() -> Self {
        Self::clear(Census::Opposite9x7)
    }
}

/// Points on the curve of accuracy against time (`docs/reference/depth.md`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// Real time on few cores.
    Fast,
    /// Between `Fast` and `Accurate`.
    Balanced,
    /// Best accuracy.
    Accurate,
}

impl Preset {
    /// All presets, the fastest first.
    pub const ALL: [Self; 3] = [Self::Fast, Self::Balanced, Self::Accurate];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Balanced => "balanced",
            Self::Accurate => "accurate",
        }
    }
}

impl Config {
    /// The configuration of a preset.
    ///
    /// ```
    /// use depth::{Config, Matcher, Preset};
    ///
    /// let mut config = Config::preset(Preset::Accurate);
    /// assert!(config.downsample.is_none());
    /// assert_eq!(Preset::ALL.map(Preset::name), ["fast", "balanced", "accurate"]);
    ///
    /// // A preset is a start; invalid values are errors.
    /// config.max_sigma_px = f32::NAN;
    /// assert!(Matcher::new(config, 128, 48).is_err());
    /// ```
    pub fn preset(preset: Preset) -> Self {
        let mut config = Self::default();
        match preset {
            Preset::Fast => {
                config.downsample = Some(Downsample::Rows);
                config.paths = Paths::Three;
            }
            Preset::Balanced => {}
            Preset::Accurate => config.plane_radius_px = Some(4),
        }
        config
    }

    pub(crate) fn validate(&self) -> Result<(), DepthError> {
        let invalid = |what, found: String, expected: String| {
            Err(DepthError::Config {
                what,
                found,
                expected,
            })
        };
        for matching in [&self.clear, &self.noisy] {
            let penalties = &matching.penalties;
            let most = u32::from(matching.census.bits()) + u32::from(matching.max_gray_cost);
            if most + u32::from(penalties.large) > MAX_COST {
                return invalid(
                    "the large penalty",
                    penalties.large.to_string(),
                    format!("at most {MAX_COST} minus the maximum matching cost {most}"),
                );
            }
            if penalties.min_large > penalties.large || penalties.small > penalties.large {
                return invalid(
                    "the large penalty",
                    penalties.large.to_string(),
                    "not below the small penalty and its own lower limit".to_owned(),
                );
            }
        }
        let [from, whole] = self.smoothed_noise;
        // NaN is rejected too.
        if !(0.0 <= from && from < whole) {
            return invalid(
                "the noise of smoothed images",
                format!("{from} to {whole}"),
                "two increasing values, 0 or more".to_owned(),
            );
        }
        if let Some(radius_px) = self.plane_radius_px
            && !(1..=MAX_PLANE_RADIUS_PX).contains(&radius_px)
        {
            return invalid(
                "the radius of planes",
                format!("{radius_px} px"),
                format!("1 to {MAX_PLANE_RADIUS_PX} px, or no planes"),
            );
        }
        let numbers = [
            Number::new("the minimum row offset", self.min_row_offset_px, " px"),
            Number::new("the minimum noise", self.min_noise, " gray levels"),
            Number::new("the speckle step", self.speckle_step_px, " px"),
            Number::new("the maximum step of planes", self.max_plane_step_px, " px"),
            Number::new("the maximum sigma", self.max_sigma_px, " px"),
            Number::new(
                "the sigma of the column offset",
                self.column_offset_sigma_px,
                " px",
            ),
            Number::new(
                "the ratio of the column offset",
                self.column_offset_ratio,
                "",
            ),
        ];
        match numbers.into_iter().find(|number| !number.is_valid) {
            None => Ok(()),
            Some(Number {
                what, found, unit, ..
            }) => invalid(what, format!("{found}{unit}"), format!("0{unit} or more")),
        }
    }
}

/// A number of the configuration that must be 0 or more.
struct Number {
    what: &'static str,
    is_valid: bool,
    found: String,
    /// With a space before it; empty for a ratio.
    unit: &'static str,
}

impl Number {
    fn new<T: PartialOrd + Default + ToString>(
        what: &'static str,
        value: T,
        unit: &'static str,
    ) -> Self {
        Self {
            what,
            // False for NaN.
            is_valid: value >= T::default(),
            found: value.to_string(),
            unit,
        }
    }
}

/// Maximum radius of the window of a plane, px: the sums over a window are in single precision.
const MAX_PLANE_RADIUS_PX: usize = 64;

/// Maximum path cost: costs are bytes, and 255 means an invalid disparity.
const MAX_COST: u32 = 254;

impl Penalties {
    /// Penalties in proportion to the maximum matching cost. The proportions gave the best results
    /// on `docs/benchmarks/depth.json`.
    ///
    /// ```
    /// use depth::{Census, Penalties};
    ///
    /// // One census bit costs 1.
    /// let of_bits = Penalties::for_costs_up_to(Census::Full5x5.bits());
    /// let of_more = Penalties::for_costs_up_to(Census::Full7x7.bits());
    /// assert!(of_bits.small < of_bits.large);
    /// assert!(of_bits.large < of_more.large);
    /// ```
    pub fn for_costs_up_to(most: u8) -> Self {
        let share = |percent: u32| (u32::from(most) * percent / 100).min(190) as u8;
        Self {
            small: share(45),
            large: share(200),
            slope: (share(200) / 25).max(1),
            min_large: share(50),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_numbers_are_errors_in_their_units() {
        let check = |change: fn(&mut Config), expected: &str| {
            let mut config = Config::default();
            change(&mut config);
            let error = config.validate().expect_err(expected).to_string();
            assert_eq!(error, format!("configuring a matcher: {expected}"));
        };
        check(
            |c| c.max_plane_step_px = f32::NAN,
            "the maximum step of planes is NaN px, expected 0 px or more",
        );
        check(
            |c| c.max_plane_step_px = -0.1,
            "the maximum step of planes is -0.1 px, expected 0 px or more",
        );
        check(
            |c| c.min_row_offset_px = f64::NAN,
            "the minimum row offset is NaN px, expected 0 px or more",
        );
        check(
            |c| c.min_noise = -1.0,
            "the minimum noise is -1 gray levels, expected 0 gray levels or more",
        );
        check(
            |c| c.column_offset_ratio = -0.25,
            "the ratio of the column offset is -0.25, expected 0 or more",
        );
        check(
            |c| c.max_sigma_px = -2.0,
            "the maximum sigma is -2 px, expected 0 px or more",
        );
        for radius_px in [0, 65, usize::MAX] {
            let mut config = Config::preset(Preset::Accurate);
            config.plane_radius_px = Some(radius_px);
            let error = config.validate().expect_err("an invalid radius");
            assert_eq!(
                error.to_string(),
                format!(
                    "configuring a matcher: the radius of planes is {radius_px} px, \
                     expected 1 to 64 px, or no planes"
                )
            );
        }
        // Limits that nothing exceeds are valid.
        let mut config = Config::preset(Preset::Accurate);
        (config.min_noise, config.min_row_offset_px) = (f64::INFINITY, f64::INFINITY);
        (config.plane_radius_px, config.max_plane_step_px) = (Some(64), 0.0);
        assert_eq!(config.validate(), Ok(()));
        for preset in Preset::ALL {
            assert_eq!(Config::preset(preset).validate(), Ok(()));
        }
    }
}
