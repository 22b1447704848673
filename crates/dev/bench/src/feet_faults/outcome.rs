//! Outcome of a point: what is stated of a walk against the truth, see [`super`].

use std::collections::BTreeSet;

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
/// Ratio of such an error to that without a fault from which on it is due to the fault.
const LARGER: f64 = 1.1;
/// Share of poses of which a component is outside with right covariances.
const USUAL_SHARE: f64 = 0.016;
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
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Statements {
    pub(super) count: usize,
    pub(super) outside: usize,
    pub(super) largest: f64,
    pub(super) largest_sigmas: f64,
    /// Which are outside: times or numbers that are the same on the same walk.
    #[serde(skip)]
    outside_at: BTreeSet<(usize, i64)>,
}

impl Statements {
    /// Adds one by its errors and their sigmas; `size` is that of its error, m or s, and `at` says
    /// which one it is.
    pub(super) fn add(&mut self, at: (usize, i64), errors: &[(f64, f64)], size: f64) {
        let ratios = errors.iter().map(|(error, sigma)| error.abs() / sigma);
        // NaN is no error within its sigma.
        let is_outside = ratios.clone().any(|ratio| ratio.is_nan() || ratio > SIGMAS);
        self.count += 1;
        self.outside += usize::from(is_outside);
        if is_outside {
            self.outside_at.insert(at);
        }
        self.largest = self.largest.max(size);
        self.largest_sigmas = ratios.fold(self.largest_sigmas, f64::max);
    }

    /// Number of these that are outside and are not so without a fault; of another walk, those
    /// beyond the share of `clean`.
    fn excess(&self, clean: &Self, is_same_walk: bool) -> usize {
        if is_same_walk {
            return self.outside_at.difference(&clean.outside_at).count();
        }
        let share = clean.outside as f64 / clean.count.max(1) as f64;
        let usual = (share * self.count as f64).round() as usize;
        self.outside.saturating_sub(usual)
    }

    fn plus(&self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            outside: self.outside + other.outside,
            largest: self.largest.max(other.largest),
            largest_sigmas: self.largest_sigmas.max(other.largest_sigmas),
            outside_at: self.outside_at.union(&other.outside_at).copied().collect(),
        }
    }
}

/// What is stated of one foot.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct FootScores {
    /// Poses that are not lost, and those that are.
    pub(super) poses: Statements,
    pub(super) lost: usize,
    /// Contacts: place along the sole, and height.
    pub(super) places: Statements,
    pub(super) heights: Statements,
    /// Heel strike, foot flat, heel off and toe off.
    pub(super) events: [Statements; 4],
    /// True contacts that were found, and those that were not.
    pub(super) found: usize,
    pub(super) missed: usize,
    /// Contacts while the foot has none.
    pub(super) invented: usize,
}

impl FootScores {
    /// Times of all events.
    pub(super) fn all_events(&self) -> Statements {
        let none = Statements::default();
        self.events.iter().fold(none, |sum, own| sum.plus(own))
    }

    fn kinds(&self) -> [Statements; 4] {
        let [poses, places, heights] = [&self.poses, &self.places, &self.heights];
        [
            poses.clone(),
            places.clone(),
            heights.clone(),
            self.all_events(),
        ]
    }

    fn plus(&self, other: &Self) -> Self {
        Self {
            poses: self.poses.plus(&other.poses),
            lost: self.lost + other.lost,
            places: self.places.plus(&other.places),
            heights: self.heights.plus(&other.heights),
            events: [0, 1, 2, 3].map(|k: usize| self.events[k].plus(&other.events[k])),
            found: self.found + other.found,
            missed: self.missed + other.missed,
            invented: self.invented + other.invented,
        }
    }

    fn is_wrong(&self, clean: &Self, is_same_walk: bool) -> bool {
        let usual = (USUAL_SHARE * self.poses.count as f64).ceil() as usize;
        let allowed = [usual, 0, 0, 0];
        let kinds = self.kinds().into_iter().zip(clean.kinds()).zip(allowed);
        let mut excess =
            kinds.map(|((own, clean), allowed)| own.excess(&clean, is_same_walk) > allowed);
        self.invented > clean.invented || excess.any(|is_more| is_more)
    }

    /// Whether less is stated than without a fault, or with errors that are large in any case.
    fn is_less(&self, clean: &Self) -> bool {
        let lost = |own: &Self| own.lost as f64 / (own.lost + own.poses.count).max(1) as f64;
        let contact = |own: &Self| own.places.largest.max(own.heights.largest);
        let event = |own: &Self| own.all_events().largest;
        self.missed > clean.missed
            || lost(self) > lost(clean) + LOST_SHARE
            || contact(self) > CONTACT_BOUND_M.max(LARGER * contact(clean))
            || self.poses.largest > POSE_BOUND_M.max(LARGER * clean.poses.largest)
            || event(self) > EVENT_BOUND_S.max(LARGER * event(clean))
    }
}

/// What is stated of a walk without a fault.
#[derive(Clone, Debug, Default)]
pub(super) struct Clean {
    pub(super) feet: [FootScores; 2],
    pub(super) losses: Vec<String>,
}

impl Clean {
    /// Those of the losses that are not among those without a fault, with whatever numbers.
    fn without_usual<'a>(&self, losses: &'a [String]) -> Vec<&'a str> {
        let text = |loss: &str| loss.replace(|c: char| c.is_ascii_digit() || "+-.".contains(c), "");
        let usual: Vec<String> = self.losses.iter().map(|own| text(own)).collect();
        let losses = losses.iter().map(String::as_str);
        losses.filter(|loss| !usual.contains(&text(loss))).collect()
    }
}

/// The outcome of what is stated of both feet, beside a walk without a fault. Losses that are
/// reported without it are no sign of it.
pub(super) fn outcome(
    own: &[FootScores; 2],
    clean: &Clean,
    is_same_walk: bool,
    losses: &[String],
) -> Outcome {
    let losses = clean.without_usual(losses);
    let clean = &clean.feet;
    let unnamed = (0..2).filter(|foot| !is_named(Foot::ALL[*foot], &losses));
    let unnamed: Vec<usize> = unnamed.collect();
    let sum = |of: &[FootScores; 2]| {
        let feet = unnamed.iter().map(|foot| &of[*foot]);
        feet.fold(FootScores::default(), |sum, foot| sum.plus(foot))
    };
    if sum(own).is_wrong(&sum(clean), is_same_walk) {
        Outcome::SilentlyWrong
    } else if !losses.is_empty() || (0..2).any(|foot| own[foot].is_less(&clean[foot])) {
        Outcome::Flagged
    } else {
        Outcome::Ok
    }
}

/// Whether a loss names a foot, or what both have in common.
fn is_named(foot: Foot, losses: &[&str]) -> bool {
    let names = |loss: &str, foot: Foot| loss.starts_with(foot.as_str());
    losses
        .iter()
        .any(|loss| names(loss, foot) || !Foot::ALL.into_iter().any(|other| names(loss, other)))
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

    /// A hundred poses and ten contacts of a foot, the first of which are outside.
    fn scores(foot: usize, poses: usize, places: usize) -> FootScores {
        let statements = |count: usize, outside: usize| {
            let mut own = Statements::default();
            (0..count).for_each(|k| {
                let error = if k < outside { 0.04 } else { 0.02 };
                own.add((foot, k as i64), &[(error, 0.01)], error);
            });
            own
        };
        FootScores {
            poses: statements(100, poses),
            places: statements(10, places),
            heights: statements(10, 0),
            events: [0; 4].map(|none| statements(10, none)),
            found: 10,
            ..FootScores::default()
        }
    }

    fn both(poses: usize, places: usize) -> [FootScores; 2] {
        [0, 1].map(|foot| scores(foot, poses, places))
    }

    fn clean(poses: usize, places: usize) -> Clean {
        Clean {
            feet: both(poses, places),
            losses: Vec::new(),
        }
    }

    #[test]
    fn losses_without_a_fault_are_no_sign_of_it() {
        let clean = Clean {
            losses: vec!["feet at rest move by 0.8 % of what the rig does".to_owned()],
            ..clean(0, 0)
        };
        let of =
            |places: usize, loss: &str| outcome(&both(0, places), &clean, true, &[loss.to_owned()]);
        let usual = "feet at rest move by 1.2 % of what the rig does";
        assert_eq!(of(0, usual), Outcome::Ok);
        assert_eq!(of(2, usual), Outcome::SilentlyWrong);
        assert_eq!(of(2, "the tags are exchanged"), Outcome::Flagged);
    }

    #[test]
    fn errors_beyond_those_of_the_walk_without_a_fault_are_silent() {
        let clean = clean(4, 1);
        let of = |left: FootScores| outcome(&[left, clean.feet[1].clone()], &clean, true, &[]);
        assert_eq!(of(scores(0, 4, 1)), Outcome::Ok);
        assert_eq!(of(scores(0, 4, 2)), Outcome::SilentlyWrong);
        // Four of two hundred poses may be.
        assert_eq!(of(scores(0, 8, 1)), Outcome::Ok);
        assert_eq!(of(scores(0, 9, 1)), Outcome::SilentlyWrong);
        let invented = FootScores {
            invented: 1,
            ..scores(0, 4, 1)
        };
        assert_eq!(of(invented), Outcome::SilentlyWrong);
    }

    #[test]
    fn other_contacts_than_those_without_a_fault_are_no_excuse() {
        let clean = clean(0, 2);
        let mut other = scores(0, 0, 1);
        other.places.add((0, 77), &[(0.04, 0.01)], 0.04);
        let own = [other, clean.feet[1].clone()];
        assert_eq!(outcome(&own, &clean, true, &[]), Outcome::SilentlyWrong);
        // Of another walk the number counts.
        assert_eq!(outcome(&own, &clean, false, &[]), Outcome::Ok);
        assert_eq!(
            outcome(&both(0, 3), &clean, false, &[]),
            Outcome::SilentlyWrong
        );
    }

    #[test]
    fn a_loss_of_one_foot_does_not_excuse_the_other() {
        let clean = clean(0, 0);
        let [left_wrong, right_wrong] = both(0, 2);
        let [left, right] = both(0, 0);
        let loss = ["left_foot: its tag has slipped".to_owned()];
        let of = |own: &[FootScores; 2], losses: &[String]| outcome(own, &clean, true, losses);
        assert_eq!(of(&[left_wrong, right], &loss), Outcome::Flagged);
        assert_eq!(of(&[left, right_wrong], &loss), Outcome::SilentlyWrong);
        let general = ["the tags are exchanged".to_owned()];
        assert_eq!(of(&both(0, 2), &general), Outcome::Flagged);
        assert_eq!(of(&clean.feet, &loss), Outcome::Flagged);
    }

    #[test]
    fn less_than_without_a_fault_and_large_errors_are_no_ok() {
        let clean = clean(0, 0);
        let of = |left: FootScores| outcome(&[left, clean.feet[1].clone()], &clean, true, &[]);
        let missed = FootScores {
            found: 9,
            missed: 1,
            ..scores(0, 0, 0)
        };
        assert_eq!(of(missed), Outcome::Flagged);
        let lost = FootScores {
            lost: 5,
            ..scores(0, 0, 0)
        };
        assert_eq!(of(lost), Outcome::Flagged);
        let mut large = scores(0, 0, 0);
        large.places.add((0, 50), &[(0.11, 0.1)], 0.11);
        assert_eq!(of(large), Outcome::Flagged);
        let mut unknown = scores(0, 0, 0);
        unknown.places.add((0, 50), &[(0.01, f64::NAN)], 0.01);
        assert_eq!(of(unknown), Outcome::SilentlyWrong);
    }
}
