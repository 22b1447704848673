//! Walks by name, `PLACE-LIGHT-SEED-SECONDS`: `plaza-low-sun-7-60`.

use anyhow::{Context as _, Result};
use rig_sim::scene::{Kind, Lighting};

use super::WalkSettings;

/// Walks for tuning: every scene, and every lighting at least once.
pub const TUNING: [&str; 8] = [
    "pavement-day-1-60",
    "stairs-day-1-60",
    "trail-day-1-60",
    "corridor-day-1-60",
    "plaza-day-1-60",
    "room-day-1-60",
    "pavement-low-sun-2-60",
    "corridor-flicker-2-60",
];

/// Walks for evaluation, not for tuning: other seeds are other scenes.
pub const EXAM: [&str; 8] = [
    "pavement-day-11-60",
    "stairs-day-11-60",
    "trail-day-11-60",
    "corridor-day-11-60",
    "plaza-day-11-60",
    "room-day-11-60",
    "plaza-night-12-60",
    "trail-low-sun-12-60",
];

/// Walks for the evaluation of odometry: 100 to 300 m each, all scenes, by day and at night, with a
/// low sun and flickering lamps. Not for tuning: other seeds are other scenes.
pub const ODOMETRY_EXAM: [&str; 10] = [
    "pavement-day-21-110",
    "room-day-21-140",
    "stairs-day-21-140",
    "corridor-day-21-110",
    "plaza-night-22-110",
    "trail-low-sun-22-110",
    "plaza-day-21-110",
    "trail-day-21-110",
    "corridor-flicker-22-110",
    "pavement-night-22-110",
];

/// The settings of a name; other settings are those of [`WalkSettings::new`].
///
/// # Errors
/// The name is not valid.
pub fn settings(name: &str) -> Result<WalkSettings> {
    let parsed = || {
        let kind = Kind::ALL.into_iter().find(|k| name.starts_with(k.name()))?;
        let rest = name[kind.name().len()..].strip_prefix('-')?;
        let light = Lighting::ALL
            .into_iter()
            .find(|t| rest.starts_with(t.name()))?;
        let rest = rest[light.name().len()..].strip_prefix('-')?;
        let (seed, seconds) = rest.split_once('-')?;
        let (seed, seconds) = (seed.parse().ok()?, seconds.parse().ok()?);
        Some(WalkSettings::new(kind, light, seed, seconds))
    };
    parsed().with_context(|| {
        format!(
            "found a walk {name:?}, expected PLACE-LIGHT-SEED-SECONDS, for example {}",
            TUNING[0]
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_valid_and_evaluation_walks_differ_from_tuning_walks() {
        let seed = |name: &&str| settings(name).expect("a walk's name").seed;
        let tuned: Vec<u64> = TUNING.iter().map(seed).collect();
        for name in EXAM.iter().chain(&ODOMETRY_EXAM) {
            assert!(!tuned.contains(&seed(name)), "{name}");
        }
        for kind in Kind::ALL {
            let own = |name: &&str| settings(name).is_ok_and(|s| s.kind == kind);
            assert!(ODOMETRY_EXAM.iter().any(own), "{kind:?}");
        }
        assert!(settings("attic-day-1-60").is_err());
    }
}
