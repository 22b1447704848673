//! What can go wrong, by what the caller can do about it.

use std::path::PathBuf;

/// An error of the simulators. After one, everything that existed before the call is unchanged.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SimulationError {
    /// A scene that cannot be opened or used: missing or damaged files, contradictions.
    #[error("{place}: found {found}, expected {expected}")]
    Scene {
        /// Which scene, sector, file or edge.
        place: String,
        /// What is there.
        found: String,
        /// What a scene needs there.
        expected: String,
    },
    /// A scene bundle that could not be read.
    #[error("the scene {path} could not be read")]
    Bundle {
        /// The bundle.
        path: PathBuf,
        /// Why.
        #[source]
        source: scene_bundle::BundleError,
    },
    /// A setting that is out of its range.
    #[error("{name}: found {found}, expected {expected}")]
    Setting {
        /// Name of the setting.
        name: String,
        /// Its value.
        found: String,
        /// Allowed values.
        expected: String,
    },
    /// An action that is not finite or has another shape; no environment moved.
    #[error("action of environment {environment}: found {found}, expected {expected}")]
    Action {
        /// Index of the environment.
        environment: usize,
        /// What was given.
        found: String,
        /// What an action is.
        expected: String,
    },
    /// No start could be found; counts tell which condition excluded how many candidates.
    #[error("no start found in {tries} tries: {reasons}")]
    Start {
        /// Candidates that were tried.
        tries: usize,
        /// Conditions with the number of candidates that each excluded.
        reasons: String,
    },
    /// Memory that is allowed is less than what one view needs.
    #[error("{needed} bytes are needed for {place}, {allowed} are allowed")]
    Budget {
        /// What needs them.
        place: String,
        /// Bytes needed.
        needed: u64,
        /// Bytes allowed.
        allowed: u64,
    },
    /// A call out of order, such as a step before the first reset.
    #[error("{0}")]
    State(String),
    /// A snapshot that belongs to another scene or configuration, or is damaged.
    #[error("snapshot: found {found}, expected {expected}")]
    Snapshot {
        /// What was read.
        found: String,
        /// What a snapshot for this world has.
        expected: String,
    },
}

/// Refuses a setting that is not a positive number.
pub(crate) fn check_positive(name: &str, value: f64) -> Result<(), SimulationError> {
    check_range(
        name,
        value,
        [f64::MIN_POSITIVE, f64::MAX],
        "a positive number",
    )
}

/// Refuses a setting outside of a range, ends included, or not finite.
pub(crate) fn check_range(
    name: &str,
    value: f64,
    [low, high]: [f64; 2],
    expected: &str,
) -> Result<(), SimulationError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(SimulationError::Setting {
        name: name.to_owned(),
        found: value.to_string(),
        expected: expected.to_owned(),
    })
}
