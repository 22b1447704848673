//! Outcome of a point: what is stated of a walk against the truth, see [`super`].

use cad_transforms::RigidTransform;
use cad_transforms::rig::Foot;
use nalgebra::Vector6;
use serde::Serialize;

/// Sigmas beyond which a statement is outside.
const SIGMAS: f64 = 3.0;
/// Errors beyond which a point is not ok, however large the stated sigmas are: of a contact and of
/// a pose, m, and of an event, s.
const CONTACT_BOUND_M: f64 = 0.1;
const POSE_BOUND_M: f64 = 0.25;
const EVENT_BOUND_S: f64 = 0.2;
/// Share of the poses by which more may be lost than on the walk without a fault.
const LOST_SHARE: f64 = 0.01;

/// Outcome of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Outcome {
    Ok,
    Flagged,
    SilentlyWrong,
}

impl Outcome {
    pub(super) const ALL: [Self; 3] = [Self::Ok, Self::Flagged, Self::SilentlyWrong];
}

/// Statements of one kind: their number, how many of them are outside of their sigmas, and the
/// largest error, m or s, also in sigmas.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Statements {
    pub(super) count: usize,
    pub(super) outside: usize,
    pub(super) largest: f64,
    pub(super) largest_sigmas: f64,
}

impl Statements {
    /// Adds one by its errors and their sigmas; `size` is that of its error, m or s.
    pub(super) fn add(&mut self, errors: &[(f64, f64)], size: f64) {
        let ratios = errors.iter().map(|(error, sigma)| error.abs() / sigma);
        // NaN is no error within its sigma.
        let is_outside = ratios.clone().any(|ratio| ratio.is_nan() || ratio > SIGMAS);
        self.count += 1;
        self.outside += usize::from(is_outside);
        self.largest = self.largest.max(size);
        self.largest_sigmas = ratios.fold(self.largest_sigmas, f64::max);
    }

    fn share(&self) -> f64 {
        self.outside as f64 / self.count.max(1) as f64
    }

    /// Number of these that are outside beyond the share of `clean`.
    fn excess(&self, clean: &Self) -> usize {
        let usual = (clean.share() * self.count as f64).round() as usize;
        self.outside.saturating_sub(usual)
    }

    fn plus(&self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            outside: self.outside + other.outside,
            largest: self.largest.max(other.largest),
            largest_sigmas: self.largest_sigmas.max(other.largest_sigmas),
        }
    }
}

/// What is stated of one foot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct FootScores {
    /// Poses that are not lost, and those that are.
    pub(super) poses: Statements,
    pub(super) lost: usize,
    /// Contacts: place along the sole, height, times of events.
    pub(super) places: Statements,
    pub(super) heights: Statements,
    pub(super) events: Statements,
    /// True contacts that were found, and those that were not.
    pub(super) found: usize,
    pub(super) missed: usize,
    /// Contacts while the foot has none.
    pub(super) invented: usize,
}

impl FootScores {
    fn kinds(&self) -> [&Statements; 4] {
        [&self.poses, &self.places, &self.heights, &self.events]
    }

    fn plus(&self, other: &Self) -> Self {
        Self {
            poses: self.poses.plus(&other.poses),
            lost: self.lost + other.lost,
            places: self.places.plus(&other.places),
            heights: self.heights.plus(&other.heights),
            events: self.events.plus(&other.events),
            found: self.found + other.found,
            missed: self.missed + other.missed,
            invented: self.invented + other.invented,
        }
    }

    fn is_wrong(&self, clean: &Self) -> bool {
        let mut kinds = self.kinds().into_iter().zip(clean.kinds());
        self.invented > clean.invented || kinds.any(|(own, clean)| own.excess(clean) > 0)
    }

    /// Whether less is stated than without a fault, or with errors that are large in any case.
    fn is_less(&self, clean: &Self) -> bool {
        let lost = |own: &Self| own.lost as f64 / (own.lost + own.poses.count).max(1) as f64;
        self.missed > clean.missed
            || lost(self) > lost(clean) + LOST_SHARE
            || self.places.largest.max(self.heights.largest) > CONTACT_BOUND_M
            || self.poses.largest > POSE_BOUND_M
            || self.events.largest > EVENT_BOUND_S
    }
}

/// The outcome of what is stated of both feet, beside the same walk without a fault.
pub(super) fn outcome(
    own: &[FootScores; 2],
    clean: &[FootScores; 2],
    losses: &[String],
) -> Outcome {
    let unnamed = (0..2).filter(|foot| !is_named(Foot::ALL[*foot], losses));
    let unnamed: Vec<usize> = unnamed.collect();
    let sum = |of: &[FootScores; 2]| {
        let feet = unnamed.iter().map(|foot| of[*foot]);
        feet.fold(FootScores::default(), |sum, foot| sum.plus(&foot))
    };
    if sum(own).is_wrong(&sum(clean)) {
        Outcome::SilentlyWrong
    } else if !losses.is_empty() || (0..2).any(|foot| own[foot].is_less(&clean[foot])) {
        Outcome::Flagged
    } else {
        Outcome::Ok
    }
}

/// Whether a loss names a foot, or what both have in common.
fn is_named(foot: Foot, losses: &[String]) -> bool {
    let names = |loss: &&String, foot: Foot| loss.starts_with(foot.as_str());
    losses
        .iter()
        .any(|loss| names(&loss, foot) || !Foot::ALL.into_iter().any(|other| names(&loss, other)))
}

/// Motion from a pose to another in the axes of the first: translation, rotation.
pub(super) fn motion(from: &RigidTransform, to: &RigidTransform) -> Vector6<f64> {
    let motion = from.inverse() * *to;
    let ([x, y, z], [a, b, c]) = (motion.translation_m(), motion.rotation_vector());
    Vector6::new(x, y, z, a, b, c)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hundred poses and ten contacts, some of which are outside.
    fn scores(poses: usize, places: usize) -> FootScores {
        let statements = |count: usize, outside: usize| {
            let mut own = Statements::default();
            (0..count).for_each(|k| {
                let error = if k < outside { 0.04 } else { 0.02 };
                own.add(&[(error, 0.01)], error);
            });
            own
        };
        FootScores {
            poses: statements(100, poses),
            places: statements(10, places),
            heights: statements(10, 0),
            events: statements(40, 0),
            found: 10,
            ..FootScores::default()
        }
    }

    #[test]
    fn errors_beyond_those_of_the_walk_without_a_fault_are_silent() {
        let clean = [scores(4, 0); 2];
        let of = |own: FootScores| outcome(&[own, clean[1]], &clean, &[]);
        assert_eq!(of(scores(4, 0)), Outcome::Ok);
        assert_eq!(of(scores(3, 1)), Outcome::SilentlyWrong);
        assert_eq!(of(scores(5, 0)), Outcome::SilentlyWrong);
        let invented = FootScores {
            invented: 1,
            ..scores(4, 0)
        };
        assert_eq!(of(invented), Outcome::SilentlyWrong);
    }

    #[test]
    fn a_loss_of_one_foot_does_not_excuse_the_other() {
        let clean = [scores(0, 0); 2];
        let wrong = scores(0, 2);
        let left = ["left_foot: its tag has slipped".to_owned()];
        let of = |own: [FootScores; 2], losses: &[String]| outcome(&own, &clean, losses);
        assert_eq!(of([wrong, clean[1]], &left), Outcome::Flagged);
        assert_eq!(of([clean[0], wrong], &left), Outcome::SilentlyWrong);
        let both = ["the tags are exchanged".to_owned()];
        assert_eq!(of([wrong, wrong], &both), Outcome::Flagged);
        assert_eq!(of(clean, &left), Outcome::Flagged);
    }

    #[test]
    fn less_than_without_a_fault_and_large_errors_are_no_ok() {
        let clean = [scores(0, 0); 2];
        let of = |own: FootScores| outcome(&[own, clean[1]], &clean, &[]);
        let missed = FootScores {
            found: 9,
            missed: 1,
            ..clean[0]
        };
        assert_eq!(of(missed), Outcome::Flagged);
        let lost = FootScores {
            lost: 5,
            ..clean[0]
        };
        assert_eq!(of(lost), Outcome::Flagged);
        let mut large = clean[0];
        large.places.add(&[(0.11, 0.1)], 0.11);
        assert_eq!(of(large), Outcome::Flagged);
        let mut unknown = clean[0];
        unknown.places.add(&[(0.01, f64::NAN)], 0.01);
        assert_eq!(of(unknown), Outcome::SilentlyWrong);
    }
}
