//! What goes wrong on purpose: faults, each of a kind, a strength and a schedule.
//!
//! Contract: a fault acts from `from_s` on, and, where its kind lasts, until `to_s`, seconds since the
//! beginning of the walk, on one camera (with its IMU) or on all. With strength 0 it does nothing at all: the
//! same bytes come out as without it. Which of many frames are hit follows from the seed and the frame's
//! number alone. Faults of different kinds act together; of one kind, the strongest at the time counts,
//! but for steps and drifts of clocks, which add up.

use crate::random;

mod file;
mod kind;
mod schedules;

pub use self::file::FaultError;
pub use self::kind::{FaultDuration, Kind};

/// Something that goes wrong.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// What.
    pub kind: Kind,
    /// How much, in the unit of the kind: [`Kind::unit`].
    pub strength: f64,
    /// When it begins, s since the beginning of the walk.
    pub from_s: f64,
    /// When it is over, s; infinite for what stays. Means nothing to kinds that happen at one instant.
    pub to_s: f64,
    /// Camera that it concerns; none for all.
    pub camera: Option<String>,
}

/// Everything that goes wrong.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Faults {
    /// In no order.
    pub list: Vec<Fault>,
    /// Chooses which frames are hit.
    pub seed: u64,
}

/// What goes wrong with one camera and its IMU.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraFaults {
    list: Vec<Fault>,
    seed: u64,
}

impl Faults {
    /// Those of a camera.
    pub fn of(&self, camera: &str) -> CameraFaults {
        let concerns = |f: &&Fault| f.camera.as_deref().is_none_or(|name| name == camera);
        // Two cameras do not lose the same frames.
        let name = camera.bytes().fold(0, |sum: u64, byte| {
            sum.wrapping_mul(31).wrapping_add(u64::from(byte))
        });
        CameraFaults {
            list: self.list.iter().filter(concerns).cloned().collect(),
            seed: random::bits(self.seed, random::FAULT, name),
        }
    }
}

impl CameraFaults {
    /// Strength of a lasting fault at a time, s; 0 for none.
    pub fn strength(&self, kind: Kind, time_s: f64) -> f64 {
        let acting = self.of_kind(kind).filter(|f| f.acts_at(time_s));
        acting.map(|f| f.strength).fold(0.0, f64::max)
    }

    /// Whether a fault whose strength is a share hits the frame of this number.
    pub fn hits(&self, kind: Kind, number: u64, time_s: f64) -> bool {
        let draw = || random::uniform(self.seed, random::FAULT + 1 + kind as u64, number);
        let share = self.strength(kind, time_s);
        share > 0.0 && draw() < share
    }

    /// All faults of a kind that do something.
    pub fn of_kind(&self, kind: Kind) -> impl Iterator<Item = &Fault> {
        let is_it = move |f: &&Fault| f.kind == kind && f.strength != 0.0;
        self.list.iter().filter(is_it)
    }

    /// Whether at this time a fault that lasts for as many seconds as it is strong has begun and is not over.
    pub fn is_during(&self, kind: Kind, time_s: f64) -> bool {
        self.of_kind(kind)
            .any(|f| (f.from_s..f.from_s + f.strength).contains(&time_s))
    }

    /// For other random numbers about faults of a kind.
    pub(crate) fn seed(&self) -> u64 {
        self.seed
    }
}

impl Fault {
    fn acts_at(&self, time_s: f64) -> bool {
        (self.from_s..self.to_s).contains(&time_s)
    }

    /// How much of the time before `time_s` the fault has acted, s.
    pub fn acted_s(&self, time_s: f64) -> f64 {
        (time_s.min(self.to_s) - self.from_s).max(0.0)
    }
}

#[cfg(test)]
mod tests;
