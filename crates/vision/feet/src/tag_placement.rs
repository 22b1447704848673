//! Placement of the tag of a shoe, and its changes, from the ground below the foot at rest.
//!
//! A tag that is glued higher or askew puts all soles at rest above the ground or tilts them, alike
//! in all contacts. One that slips does so from some contact on. Contract: medians, so that single
//! contacts on a stone or an edge do not count; sigmas are of the scatter of the contacts, with a
//! floor for what they have in common. A change is reported only between two times in each of which
//! the foot was at rest often enough.

use crate::config::PlacementConfig;

/// A foot at rest relative to the ground below it, and to its course. What is not known is `None`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RestSample {
    /// Time of the contact, s.
    pub time_s: f64,
    /// Height of the sole above the ground, m.
    pub height_m: Option<f64>,
    /// Tilt of the sole relative to the ground about the foot's x and y axes, rad.
    pub tilt_rad: [Option<f64>; 2],
    /// Angle from the direction of travel to the foot's, counter-clockwise from above, rad.
    pub heading_rad: Option<f64>,
}

/// A number and its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The number, in m, rad or s.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

impl Estimate {
    /// The same without a part that is known.
    pub(crate) fn minus(self, part: f64) -> Self {
        Self {
            value: self.value - part,
            ..self
        }
    }
}

/// Error of the placement of a tag, as far as the ground determines it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlacementError {
    /// By which soles are too high, m.
    pub height_m: Option<Estimate>,
    /// By which they are tilted about the foot's x and y axes, rad.
    pub tilt_rad: [Option<Estimate>; 2],
}

/// What of a tag's placement changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Height of the sole above the ground.
    Height,
    /// Tilt about the foot's x axis.
    Roll,
    /// Tilt about the foot's y axis.
    Pitch,
    /// Direction of the foot relative to its course.
    Heading,
}

impl Quantity {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Height, Self::Roll, Self::Pitch, Self::Heading];

    fn of(self, sample: &RestSample) -> Option<f64> {
        match self {
            Self::Height => sample.height_m,
            Self::Roll => sample.tilt_rad[0],
            Self::Pitch => sample.tilt_rad[1],
            Self::Heading => sample.heading_rad,
        }
    }
}

/// A change of a tag's placement during the walk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slip {
    /// Between two contacts: the time of the second one, s.
    pub time_s: f64,
    /// What changed.
    pub quantity: Quantity,
    /// By how much, m or rad.
    pub change: Estimate,
}

impl PlacementConfig {
    fn floor(&self, quantity: Quantity) -> f64 {
        match quantity {
            Quantity::Height => self.height_floor_m,
            Quantity::Roll | Quantity::Pitch => self.tilt_floor_rad,
            Quantity::Heading => self.heading_floor_rad,
        }
    }

    fn shared(&self, quantity: Quantity) -> f64 {
        match quantity {
            Quantity::Height => self.shared_height_m,
            _ => self.shared_tilt_rad,
        }
    }

    fn min_slip(&self, quantity: Quantity) -> f64 {
        match quantity {
            Quantity::Height => self.min_height_slip_m,
            Quantity::Roll | Quantity::Pitch => self.min_tilt_slip_rad,
            Quantity::Heading => self.min_heading_slip_rad,
        }
    }
}

/// Error of the placement by all contacts of a foot.
///
/// ```
/// use feet::PlacementConfig;
/// use feet::tag_placement::{RestSample, placement_error};
///
/// // A tag 6 mm too high, on ground that is uneven by 2 mm.
/// let uneven = [2e-3, -2e-3, 0.0, 1e-3, -1e-3, 2e-3, 0.0, -2e-3];
/// let sample = |(k, uneven): (usize, &f64)| RestSample {
///     time_s: k as f64,
///     height_m: Some(6e-3 + uneven),
///     ..RestSample::default()
/// };
/// let samples: Vec<RestSample> = uneven.iter().enumerate().map(sample).collect();
/// let height = placement_error(&samples, &PlacementConfig::default()).height_m;
/// let height = height.expect("eight contacts");
/// assert!((height.value - 6e-3).abs() < 1e-3 && height.sigma < 3e-3);
/// ```
pub fn placement_error(samples: &[RestSample], config: &PlacementConfig) -> PlacementError {
    error_of(samples, config.min_contacts, config)
}

/// The same of fewer contacts, which tell gross errors only.
pub fn gross_placement_error(samples: &[RestSample], config: &PlacementConfig) -> PlacementError {
    error_of(samples, config.min_gross_contacts, config)
}

fn error_of(samples: &[RestSample], least: f64, config: &PlacementConfig) -> PlacementError {
    let estimate = |quantity: Quantity| {
        let values = samples.iter().filter_map(|sample| quantity.of(sample));
        let values: Vec<f64> = values.collect();
        (values.len() as f64 >= least).then(|| {
            let own = robust_mean(&values, config.floor(quantity));
            Estimate {
                // Errors that all contacts share are not in their scatter.
                sigma: own.sigma.hypot(config.shared(quantity)),
                ..own
            }
        })
    };
    PlacementError {
        height_m: estimate(Quantity::Height),
        tilt_rad: [estimate(Quantity::Roll), estimate(Quantity::Pitch)],
    }
}

/// A place where a foot was at rest, and when.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestPlace {
    /// Time of the contact, s.
    pub time_s: f64,
    /// Position in the world, m.
    pub position: [f64; 3],
}

/// Whether the tags of the left and the right shoe are exchanged: steps of the left foot lie to the
/// right of the line from the step of the other foot before to that after it, and vice versa.
/// Places are those of the left and of the right foot, by time.
pub fn are_exchanged(places: [&[RestPlace]; 2], config: &PlacementConfig) -> bool {
    let mut offsets_m = Vec::new();
    for (own, other, side) in [(0, 1, 1.0), (1, 0, -1.0)] {
        for place in places[own] {
            let after = places[other].partition_point(|p| p.time_s < place.time_s);
            let before = after.checked_sub(1).and_then(|k| places[other].get(k));
            let (Some(a), Some(b)) = (before, places[other].get(after)) else {
                continue;
            };
            let from = |k: usize| b.position[k] - a.position[k];
            let away = |k: usize| place.position[k] - a.position[k];
            let length = from(0).hypot(from(1));
            if length > config.min_stride_m {
                offsets_m.push(side * (from(0) * away(1) - from(1) * away(0)) / length);
            }
        }
    }
    offsets_m.len() as f64 >= config.min_contacts && median(offsets_m) < -config.min_offset_m
}

/// The most significant change of the placement, if there is one.
pub fn slip(samples: &[RestSample], config: &PlacementConfig) -> Option<Slip> {
    let changes = Quantity::ALL.into_iter().filter_map(|quantity| {
        let known = samples.iter();
        let known = known.filter_map(|own| Some((own.time_s, quantity.of(own)?)));
        largest_change(&known.collect::<Vec<_>>(), quantity, config)
    });
    let significance = |slip: &Slip| slip.change.value.abs() / slip.change.sigma;
    changes.max_by(|a, b| significance(a).total_cmp(&significance(b)))
}

/// The change at the time that leaves the least deviations from the medians before and after it.
fn largest_change(
    known: &[(f64, f64)],
    quantity: Quantity,
    config: &PlacementConfig,
) -> Option<Slip> {
    let least = config.min_contacts as usize;
    let values: Vec<f64> = known.iter().map(|(_, value)| *value).collect();
    let splits = least..=known.len().checked_sub(least)?;
    let deviations = |split: usize| -> Vec<f64> {
        let (before, after) = values.split_at(split);
        let from_median = |part: &[f64]| -> Vec<f64> {
            let middle = median(part.to_vec());
            part.iter().map(|own| (own - middle).abs()).collect()
        };
        [from_median(before), from_median(after)].concat()
    };
    let sum = |split: &usize| deviations(*split).iter().sum::<f64>();
    let split = splits.min_by(|a, b| sum(a).total_cmp(&sum(b)))?;
    let (before, after) = values.split_at(split);
    // The scatter is that of both parts: that of a few contacts alone may be too small.
    let scatter = scatter(deviations(split).into_iter(), config.floor(quantity));
    let count = 1.0 / before.len() as f64 + 1.0 / after.len() as f64;
    let value = median(after.to_vec()) - median(before.to_vec());
    let sigma = MEDIAN_SIGMA * scatter * count.sqrt();
    let is_change =
        value.abs() > config.slip_sigmas * sigma && value.abs() > config.min_slip(quantity);
    is_change.then_some(Slip {
        time_s: known[split].0,
        quantity,
        change: Estimate { value, sigma },
    })
}

/// Standard deviation of the median of a normal distribution, relative to that of the mean: the
/// square root of pi / 2.
const MEDIAN_SIGMA: f64 = 1.2533;

/// Median with its standard deviation. `floor` is the least standard deviation of a value.
fn robust_mean(values: &[f64], floor: f64) -> Estimate {
    let value = median(values.to_vec());
    let scatter = scatter(values.iter().map(|own| own - value), floor);
    Estimate {
        value,
        sigma: MEDIAN_SIGMA * scatter / (values.len() as f64).sqrt(),
    }
}

/// Standard deviation of a normal distribution with the same median absolute deviation.
fn scatter(deviations: impl Iterator<Item = f64>, floor: f64) -> f64 {
    (1.4826 * median(deviations.map(f64::abs).collect())).max(floor)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    let [low, high] = [last / 2, last.div_ceil(2)].map(|k| values.get(k));
    0.5 * (low.copied().unwrap_or(f64::NAN) + high.copied().unwrap_or(f64::NAN))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_noise::Noise;

    /// Forty contacts: a height and a heading with scatter, with a change from the contact `slips`
    /// on.
    fn samples(seed: u64, slips: usize, height_m: f64, heading_rad: f64) -> Vec<RestSample> {
        let mut noise = Noise::new(seed);
        let mut random = move || noise.next();
        (0..40)
            .map(|k| {
                let share = if k >= slips { 1.0 } else { 0.0 };
                RestSample {
                    time_s: k as f64,
                    height_m: Some(0.002 + share * height_m + 0.003 * random()),
                    tilt_rad: [Some(0.01 * random()), None],
                    heading_rad: (k % 3 > 0).then(|| 0.1 + share * heading_rad + 0.05 * random()),
                }
            })
            .collect()
    }

    #[test]
    fn heights_and_tilts_are_within_their_sigmas() {
        let mut beyond = 0;
        for seed in 0..50 {
            let found = placement_error(&samples(seed, 40, 0.0, 0.0), &PlacementConfig::default());
            let height = found.height_m.expect("forty contacts");
            beyond += usize::from((height.value - 0.002).abs() > 2.0 * height.sigma);
            let roll = found.tilt_rad[0].expect("forty contacts");
            beyond += usize::from(roll.value.abs() > 2.0 * roll.sigma);
            assert_eq!(found.tilt_rad[1], None, "not known");
        }
        assert!(beyond <= 5, "{beyond} of 100");
    }

    #[test]
    fn a_slip_is_found_at_its_time_and_nothing_without_one() {
        let config = PlacementConfig::default();
        for seed in 0..200 {
            assert_eq!(
                slip(&samples(seed, 40, 0.0, 0.0), &config),
                None,
                "seed {seed}"
            );
        }
        for seed in 0..20 {
            let found = slip(&samples(seed, 20, 0.012, 0.0), &config).expect("12 mm");
            assert_eq!(found.quantity, Quantity::Height);
            assert!((found.time_s - 20.0).abs() <= 2.0, "{found:?}");
            assert!(
                (found.change.value - 0.012).abs() < 4.0 * found.change.sigma,
                "{found:?}"
            );
            let found = slip(&samples(seed, 20, 0.0, 0.25), &config).expect("14 degrees");
            assert_eq!(found.quantity, Quantity::Heading);
            assert!((found.time_s - 20.0).abs() <= 3.0, "{found:?}");
        }
    }

    /// A walk ahead, 0.6 m and 0.5 s per step, with feet this far to their sides, and a step to the
    /// side in the middle.
    fn places(aside_m: f64, count: usize) -> [Vec<RestPlace>; 2] {
        [1.0, -1.0].map(|side| {
            let place = |k: usize| RestPlace {
                time_s: k as f64 + if side > 0.0 { 0.0 } else { 0.5 },
                position: [
                    1.2 * k as f64 + if side > 0.0 { 0.0 } else { 0.6 },
                    side * aside_m + if k == count / 2 { 0.3 } else { 0.0 },
                    0.0,
                ],
            };
            (0..count).map(place).collect()
        })
    }

    #[test]
    fn exchanged_tags_are_found_and_narrow_gaits_are_none() {
        let config = PlacementConfig::default();
        let found = |aside_m: f64, count: usize| {
            let [left, right] = places(aside_m, count);
            are_exchanged([&left, &right], &config)
        };
        assert!(found(-0.06, 12));
        for aside_m in [0.06, 0.02, 0.0, -0.005] {
            assert!(!found(aside_m, 12), "{aside_m} m");
        }
        assert!(!found(-0.06, 3), "too few steps");
    }

    #[test]
    fn few_contacts_say_nothing() {
        let config = PlacementConfig::default();
        let few = &samples(1, 3, 0.05, 0.5)[..5];
        assert_eq!(slip(few, &config), None);
        assert_eq!(placement_error(few, &config), PlacementError::default());
        assert_eq!(placement_error(&[], &config), PlacementError::default());
    }
}
