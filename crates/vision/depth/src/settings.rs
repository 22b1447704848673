//! How much trouble a depth map is worth.

use crate::aggregation::{Paths, Penalties};
use crate::census::Census;
use crate::error::DepthError;
use crate::half_resolution::Downsample;
use crate::lanes::Level;

/// How a pair of pictures is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Matching {
    /// Which pixels are compared.
    pub census: Census,
    /// Most that the difference of grey levels may cost, in half levels; a bit of census costs 1.
    pub max_gray_cost: u8,
    /// Costs of the way from pixel to pixel.
    pub penalties: Penalties,
    /// Whether both pictures are smoothed first.
    pub smooth: bool,
}

/// See the fields.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Whether pictures are made smaller first.
    pub downsample: Option<Downsample>,
    /// For pictures with little noise.
    pub clear: Matching,
    /// For the others.
    pub noisy: Matching,
    /// Standard deviation of noise from which on pictures are noisy, grey levels.
    pub min_noise: f64,
    /// Which paths lead to a pixel.
    pub paths: Paths,
    /// How far the winners of the two pictures may be apart, px.
    pub max_lr_difference_px: u16,
    /// How much less the cost of a disparity must be than that of others that are not beside it, percent.
    pub uniqueness_percent: u16,
    /// Whether each disparity becomes the median of it and its neighbours.
    pub median: bool,
    /// Islands of less pixels than this are absent.
    pub min_speckle_px: usize,
    /// Neighbours of one island differ by at most this, px.
    pub speckle_step_px: f32,
    /// Correlation that the two pictures must have around a pixel and where it leads to. Of noise it is 0.08 either way.
    pub min_correlation: f32,
    /// What has a larger sigma is absent, px.
    pub max_sigma_px: f32,
    /// The instructions to use; none for the best that there are.
    pub level: Option<Level>,
}

/// Points on the curve of accuracy against time (`docs/depth.md`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// In real time, on few cores.
    Fast,
    /// Between the two.
    Balanced,
    /// As good as it gets.
    Accurate,
}

impl Preset {
    /// All of them, the fastest first.
    pub const ALL: [Self; 3] = [Self::Fast, Self::Balanced, Self::Accurate];

    /// As the command line calls it.
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
                    format!("at most {MAX_COST} with costs of up to {most}"),
                );
            }
            if penalties.min_large > penalties.large || penalties.small > penalties.large {
                return invalid(
                    "the large penalty",
                    penalties.large.to_string(),
                    "no less than the small one and than its least".to_owned(),
                );
            }
        }
        // Not a number is in no range.
        let numbers = [
            ("the step within islands", self.speckle_step_px),
            ("the largest sigma", self.max_sigma_px),
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

/// Costs along a path are bytes, of which 255 means that it cannot be.
const MAX_COST: u32 = 254;

impl Penalties {
    /// In the proportion to the greatest cost that has been found best on `docs/benchmarks/depth.json`.
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
