//! Planned faults, each with a kind, a strength and a schedule.
//!
//! Contract: a fault acts from `from_s` and, if its kind has a duration, until `to_s`, seconds
//! since the beginning of the walk, on one camera (with its IMU) or on all, or on one foot of the
//! wearer or on both ([`Subject`]). With strength 0 it has no effect: the output is byte-identical.
//! The affected frames follow from the seed and the frame's index alone. Faults of different kinds
//! act together; of the same kind, the strongest at the time applies, except for clock steps and
//! drifts, which add up.

use crate::random;
use crate::walker::Side;

mod file;
mod kind;
mod schedules;

pub use self::file::FaultError;
pub use self::kind::{FaultDuration, Kind, Subject};

/// A fault.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// Kind.
    pub kind: Kind,
    /// Strength, in the unit of the kind: [`Kind::unit`].
    pub strength: f64,
    /// Begin, s since the beginning of the walk.
    pub from_s: f64,
    /// End, s; infinite for a permanent fault. Ignored for kinds that happen at one instant.
    pub to_s: f64,
    /// Affected camera; `None` for all. Ignored for kinds that act on the wearer.
    pub camera: Option<String>,
    /// Affected foot; `None` for both. Ignored for kinds that do not act on a foot.
    pub foot: Option<Side>,
}

/// All planned faults.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Faults {
    /// In any order.
    pub list: Vec<Fault>,
    /// Seed that selects the affected frames.
    pub seed: u64,
}

/// Faults of the wearer: his shoes, their tags, and how he moves.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WearerFaults {
    list: Vec<Fault>,
    seed: u64,
}

/// Faults of one camera and its IMU.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraFaults {
    list: Vec<Fault>,
    seed: u64,
}

impl Faults {
    /// Faults of one camera.
    pub fn of(&self, camera: &str) -> CameraFaults {
        let concerns = |f: &&Fault| {
            f.kind.subject() == Subject::Camera
                && f.camera.as_deref().is_none_or(|name| name == camera)
        };
        // Cameras lose different frames.
        let name = camera.bytes().fold(0, |sum: u64, byte| {
            sum.wrapping_mul(31).wrapping_add(u64::from(byte))
        });
        CameraFaults {
            list: self.list.iter().filter(concerns).cloned().collect(),
            seed: random::bits(self.seed, random::FAULT, name),
        }
    }

    /// Faults of the wearer.
    pub fn of_wearer(&self) -> WearerFaults {
        let concerns = |f: &&Fault| f.kind.subject() != Subject::Camera && f.strength != 0.0;
        let list: Vec<Fault> = self.list.iter().filter(concerns).cloned().collect();
        // Without faults equal, whatever the seed.
        let seed = if list.is_empty() { 0 } else { self.seed };
        WearerFaults { list, seed }
    }
}

impl WearerFaults {
    /// Faults of a kind on a foot.
    pub(crate) fn of_foot(&self, kind: Kind, side: Side) -> impl Iterator<Item = &Fault> {
        let concerns = move |f: &&Fault| f.kind == kind && f.foot.is_none_or(|foot| foot == side);
        self.list.iter().filter(concerns)
    }

    /// The strongest fault of a kind with duration that acts on a foot at a time, s; 0 for none.
    pub(crate) fn strength(&self, kind: Kind, side: Side, time_s: f64) -> f64 {
        let acting = self.of_foot(kind, side).filter(|f| f.acts_at(time_s));
        acting.map(|f| f.strength).fold(0.0, f64::max)
    }

    /// Times, s, and heights, m, of jumps, in the order of time.
    pub(crate) fn jumps(&self) -> Vec<(f64, f64)> {
        let jumps = self.list.iter().filter(|f| f.kind == Kind::Jump);
        let mut jumps: Vec<(f64, f64)> = jumps.map(|f| (f.from_s, f.strength)).collect();
        jumps.sort_by(|a, b| a.0.total_cmp(&b.0));
        jumps
    }

    /// Seed for the random numbers of these faults.
    pub(crate) fn seed(&self) -> u64 {
        self.seed
    }
}

impl CameraFaults {
    /// Strength of a fault with duration at a time, s; 0 for none.
    pub fn strength(&self, kind: Kind, time_s: f64) -> f64 {
        let acting = self.of_kind(kind).filter(|f| f.acts_at(time_s));
        acting.map(|f| f.strength).fold(0.0, f64::max)
    }

    /// Whether a fault whose strength is a fraction of frames affects the frame of this number.
    pub fn hits(&self, kind: Kind, number: u64, time_s: f64) -> bool {
        let draw = || random::uniform(self.seed, random::FAULT + 1 + kind as u64, number);
        let share = self.strength(kind, time_s);
        share > 0.0 && draw() < share
    }

    /// All faults of a kind with nonzero strength.
    pub(crate) fn of_kind(&self, kind: Kind) -> impl Iterator<Item = &Fault> {
        let is_it = move |f: &&Fault| f.kind == kind && f.strength != 0.0;
        self.list.iter().filter(is_it)
    }

    /// Whether a fault whose strength is its duration in seconds acts at this time.
    pub(crate) fn is_during(&self, kind: Kind, time_s: f64) -> bool {
        self.of_kind(kind)
            .any(|f| (f.from_s..f.from_s + f.strength).contains(&time_s))
    }

    /// Seed for further random numbers of faults of a kind.
    pub(crate) fn seed(&self) -> u64 {
        self.seed
    }
}

impl Fault {
    pub(crate) fn acts_at(&self, time_s: f64) -> bool {
        (self.from_s..self.to_s).contains(&time_s)
    }

    /// Time for which the fault has acted before `time_s`, s.
    pub(crate) fn acted_s(&self, time_s: f64) -> f64 {
        (time_s.min(self.to_s) - self.from_s).max(0.0)
    }
}

#[cfg(test)]
mod tests;
