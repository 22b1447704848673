//! Gait of one wearer: how people differ, and how much successive steps of one person vary.
//!
//! Figures are of healthy adults: cadence at a speed by Grieve's power law (1968) and, for other
//! heights, by dynamic similarity (Alexander and Jayes 1983); the share of stance falls with speed
//! (Kirtley et al. 1985); toe clearance at mid-swing is 19 ± 5 mm (Moosabhoy and Gard 2006).

use super::curves::running_share;
use crate::random;

/// Body height of the wearer whose limbs have the lengths of [`crate::scene::wearer`], m.
const REFERENCE_HEIGHT_M: f64 = 1.755;
/// Streams of one person's numbers and of each step's.
const PERSON: u64 = random::WALK + 0x20;
const STEP: u64 = random::WALK + 0x21;
/// Draws are cut here, in standard deviations: nobody limps.
const LIMIT: f64 = 2.5;

/// What is typical of one wearer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaitProfile {
    seed: u64,
    /// Body height, m.
    pub height_m: f64,
    /// Steps per second relative to the mean of people of this height.
    pub cadence_ratio: f64,
    /// Share of stance in a stride, minus its mean at the same speed.
    pub duty_offset: f64,
    /// Angle by which the left and the right foot point outwards, rad.
    pub toe_out_rad: [f64; 2],
    /// Distance of the feet from the line walked along, m.
    pub half_step_width_m: f64,
    /// Pitch of the foot at heel strike at a usual speed, rad; negative: toe up.
    pub strike_pitch_rad: f64,
    /// Pitch of the foot at toe-off at a usual speed, rad.
    pub off_pitch_rad: f64,
    /// Smallest height of the toe above flat ground in the middle of a swing, m.
    pub toe_clearance_m: f64,
    /// Height of the trousers' hem above the sole, m.
    pub hem_m: f64,
}

/// What differs from one step to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepVariation {
    /// Duration of the step relative to its mean.
    pub duration_ratio: f64,
    /// Displacement of the foothold forward and outward, m.
    pub place_m: [f64; 2],
    /// Additional angle outward, rad.
    pub toe_out_rad: f64,
    /// Additional pitch at heel strike and toe-off, rad, at a usual speed.
    pub pitch_rad: [f64; 2],
    /// Toe clearance relative to its mean.
    pub clearance_ratio: f64,
    /// Shift of the horizontal speed of the foot to later times, as a ratio of the swing.
    pub delay: f64,
}

impl GaitProfile {
    /// The person that a seed draws.
    pub fn draw(seed: u64) -> Self {
        let around = |index: u64, mean: f64, sigma: f64| {
            mean + sigma * random::bell(seed, PERSON, index).clamp(-LIMIT, LIMIT)
        };
        Self {
            seed,
            height_m: around(0, 1.72, 0.09),
            cadence_ratio: around(1, 1.0, 0.04),
            duty_offset: around(2, 0.0, 0.015),
            toe_out_rad: [around(3, 0.12, 0.06), around(4, 0.12, 0.06)],
            half_step_width_m: around(5, 0.075, 0.01),
            strike_pitch_rad: around(6, -0.33, 0.05),
            off_pitch_rad: around(7, 0.85, 0.08),
            toe_clearance_m: around(8, 0.019, 0.004),
            hem_m: around(9, 0.08, 0.01),
        }
    }

    /// Lengths relative to those of [`crate::scene::wearer`].
    pub(crate) fn scale(&self) -> f64 {
        self.height_m / REFERENCE_HEIGHT_M
    }

    /// Steps per second at a speed, m/s.
    pub(crate) fn cadence(&self, speed: f64) -> f64 {
        // Speeds scale with the root of lengths, frequencies with its inverse.
        let root = self.scale().sqrt();
        let walking = 1.87 / root * libm::pow((speed / root).max(0.3) / 1.35, 0.42);
        // Cadence of running, at any speed.
        let running = 2.6 / root;
        self.cadence_ratio * (walking + (running - walking) * running_share(speed))
    }

    /// Share of stance in a stride at a speed, m/s.
    pub(crate) fn duty(&self, speed: f64) -> f64 {
        let walking = 0.642 - 0.035 * speed + self.duty_offset;
        walking + (0.36 - walking) * running_share(speed)
    }

    /// Variation of one of the wearer's steps.
    pub(crate) fn step(&self, number: u64) -> StepVariation {
        let of = |index: u64, sigma: f64| {
            let drawn = random::bell(self.seed, STEP, 16 * number + index);
            sigma * drawn.clamp(-LIMIT, LIMIT)
        };
        StepVariation {
            duration_ratio: 1.0 + of(0, 0.015),
            place_m: [of(1, 0.015), of(2, 0.01)],
            toe_out_rad: of(3, 0.03),
            pitch_rad: [of(4, 0.04), of(5, 0.04)],
            clearance_ratio: 1.0 + of(6, 0.15),
            delay: of(7, 0.02),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn people_differ_and_have_the_stated_means() {
        let people: Vec<GaitProfile> = (0..400).map(GaitProfile::draw).collect();
        let statistics = |of: fn(&GaitProfile) -> f64| {
            let count = people.len() as f64;
            let mean = people.iter().map(of).sum::<f64>() / count;
            let squares = people.iter().map(|p| (of(p) - mean).powi(2));
            (mean, (squares.sum::<f64>() / count).sqrt())
        };
        let (height, sigma) = statistics(|p| p.height_m);
        assert!((height - 1.72).abs() < 0.02 && (sigma - 0.09).abs() < 0.01);
        let (clearance, sigma) = statistics(|p| p.toe_clearance_m);
        assert!((clearance - 0.019).abs() < 0.001 && (sigma - 0.004).abs() < 0.001);
        let (cadence, sigma) = statistics(|p| p.cadence(1.35));
        assert!(
            (cadence - 1.9).abs() < 0.05 && sigma > 0.05,
            "{cadence} {sigma}"
        );
        let (duty, _) = statistics(|p| p.duty(1.35));
        assert!((duty - 0.595).abs() < 0.01, "{duty}");
    }

    #[test]
    fn short_people_step_faster() {
        let of = |height_m: f64| GaitProfile {
            height_m,
            ..GaitProfile::draw(1)
        };
        assert!(of(1.5).cadence(1.3) > 1.05 * of(1.9).cadence(1.3));
    }
}
