//! Condition of a session.

use std::fmt;

use serde::{Deserialize, Serialize};
use session_archive::manifest::State;
use session_archive::verify::Report;

/// Condition of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Condition {
    /// Closed, and complete.
    Ok,
    /// The recorder was cut off; complete up to the cut.
    Unclosed,
    /// Something that was recorded is missing or cannot be read.
    Damaged,
    /// An undamaged recovered copy of a session that was unclosed or damaged.
    Recovered,
    /// Not verified yet.
    Unverified,
}

impl Condition {
    /// The condition from the `state` of the manifest and the verification `report`.
    pub fn of(state: State, report: &Report) -> Self {
        if report.is_sound() {
            match state {
                State::Recovered => Self::Recovered,
                _ => Self::Ok,
            }
        } else if report.is_only_cut_off() {
            Self::Unclosed
        } else {
            Self::Damaged
        }
    }

    /// Whether recovery would improve the session.
    pub fn needs_recovery(self) -> bool {
        matches!(self, Self::Unclosed | Self::Damaged)
    }

    /// Name in the catalogue.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Unclosed => "unclosed",
            Self::Damaged => "damaged",
            Self::Recovered => "recovered",
            Self::Unverified => "unverified",
        }
    }

    /// Parses the name in the catalogue; an unknown name is [`Self::Unverified`].
    pub fn from_word(word: &str) -> Self {
        [Self::Ok, Self::Unclosed, Self::Damaged, Self::Recovered]
            .into_iter()
            .find(|c| c.as_str() == word)
            .unwrap_or(Self::Unverified)
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use session_archive::scan::{Damage, DamageKind};
    use session_archive::verify::SegmentDamage;

    use super::*;

    #[test]
    fn cut_and_damage_are_different_conditions() {
        let damage = |segment, kind| SegmentDamage {
            segment,
            damage: Damage {
                bytes: 10..20,
                kind,
            },
        };
        let check = |closed, damage: &[SegmentDamage], state, expected| {
            let report = Report {
                closed,
                damage: damage.to_vec(),
                ..Report::default()
            };
            assert_eq!(Condition::of(state, &report), expected, "{report:?}");
        };
        check(true, &[], State::Closed, Condition::Ok);
        check(true, &[], State::Recovered, Condition::Recovered);
        check(false, &[], State::Recording, Condition::Unclosed);
        let cut = damage(3, DamageKind::CutOff);
        check(
            false,
            std::slice::from_ref(&cut),
            State::Recording,
            Condition::Unclosed,
        );
        check(
            true,
            std::slice::from_ref(&cut),
            State::Closed,
            Condition::Damaged,
        );
        check(
            false,
            &[damage(1, DamageKind::CutOff), cut.clone()],
            State::Recording,
            Condition::Damaged,
        );
        check(
            false,
            &[damage(3, DamageKind::Checksum)],
            State::Recording,
            Condition::Damaged,
        );
    }
}
