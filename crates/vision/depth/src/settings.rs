//! Settings and presets of the matcher.

use crate::aggregation::{Paths, Penalties};
use crate::census::Census;
use crate::error::DepthError;
use crate::half_resolution::Downsample;
use crate::lanes::Level;

/// Matching cost and smoothness of one noise class.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Matching {
    /// Census window.
    pub census: Census,
    /// Limit of the gray-level cost, in units of two gray levels; one census bit costs 1.
    pub max_gray_cost: u8,
    /// Smoothness penalties.
    pub penalties: Penalties,
    /// Whether both images are smoothed before matching.
    pub smooth: bool,
}

/// Settings of a matcher.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Downsampling before matching, if any.
    pub downsample: Option<Downsample>,
    /// Matching of images with little noise.
    pub clear: Matching,
    /// Matching of noisy images.
    pub noisy: Matching,
    /// Minimum standard deviation of the noise for an image to count as noisy, gray levels.
    pub min_noise: f64,
    /// Aggregation paths.
    pub paths: Paths,
    /// Maximum disparity difference between the left and the right image, px. Compare OpenCV SGBM
    /// `disp12MaxDiff`.
    pub max_lr_difference_px: u16,
    /// Minimum margin by which the second-best non-adjacent cost exceeds the best one, percent.
    /// Compare OpenCV SGBM `uniquenessRatio`.
    pub uniqueness_percent: u16,
    /// Whether a 3x3 median filter is applied.
    pub median: bool,
    /// Minimum size of a connected region, pixels; smaller ones are removed. Compare OpenCV SGBM
    /// `speckleWindowSize`.
    pub min_speckle_px: usize,
    /// Maximum disparity difference of neighbors in one region, px. Compare OpenCV SGBM
    /// `speckleRange`.
    pub speckle_step_px: f32,
    /// Minimum correlation of the two images around a pixel and its match. For pure noise it is
    /// within 0.08 of 0.
    pub min_correlation: f32,
    /// Maximum sigma, px; disparities with a larger one are removed.
    pub max_sigma_px: f32,
    /// Instruction set; `None` for the most capable one of the processor.
    pub level: Option<Level>,
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

impl Settings {
    /// The settings of a preset.
    pub fn preset(preset: Preset) -> Self {
        let (downsample, census, paths) = match preset {
            Preset::Fast => (Some(Downsample::Rows), Census::Full5x5, Paths::Three),
            Preset::Balanced => (None, Census::Full5x5, Paths::Eight),
            Preset::Accurate => (None, Census::Full7x7, Paths::Eight),
        };
        Self {
            downsample,
            clear: Matching {
                census,
                max_gray_cost: 8,
                penalties: Penalties::for_costs_up_to(census.bits() + 8),
                smooth: false,
            },
            noisy: Matching {
                census: Census::Opposite9x7,
                max_gray_cost: 8,
                penalties: Penalties::for_costs_up_to(Census::Opposite9x7.bits() + 8),
                smooth: true,
            },
            min_noise: 1.4,
            paths,
            max_lr_difference_px: 1,
            uniqueness_percent: 0,
            median: true,
            min_speckle_px: 100,
            speckle_step_px: 1.5,
            min_correlation: 0.25,
            max_sigma_px: 6.0,
            level: None,
        }
    }

    pub(crate) fn validate(&self) -> Result<(), DepthError> {
        let invalid = |what, found: String, expected: String| {
            Err(DepthError::Settings {
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
        // NaN is rejected too.
        let numbers = [
            ("the speckle step", self.speckle_step_px),
            ("the maximum sigma", self.max_sigma_px),
        ];
        match numbers
            .into_iter()
            .find(|(_, value)| value.is_nan() || *value < 0.0)
        {
            None => Ok(()),
            Some((what, value)) => invalid(what, value.to_string(), "0 px or more".to_owned()),
        }
    }
}

/// Maximum path cost: costs are bytes, and 255 means an invalid disparity.
const MAX_COST: u32 = 254;

impl Penalties {
    /// Penalties in proportion to the maximum matching cost. The proportions gave the best results
    /// on `docs/benchmarks/depth.json`.
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
