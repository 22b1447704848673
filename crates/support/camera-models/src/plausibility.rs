//! Limits of a plausible calibration, and the reasons for rejecting one.

use cad_transforms::RigidTransform;

use crate::note::Note;

/// Maximum distance of two sensors of one camera, metres. Beyond it the values are millimetres.
pub const MAX_BASELINE_M: f64 = 10.0;
/// Stereo baseline above which there is a note, metres.
pub(crate) const MAX_USUAL_BASELINE_M: f64 = 2.0;

/// Why a calibration is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InvalidCalibration {
    /// A required camera or pose is missing.
    #[error("{what} is missing, found {found}")]
    Missing {
        /// Missing element.
        what: String,
        /// Content found instead.
        found: String,
    },
    /// The numbers are impossible.
    #[error("{reason}")]
    Implausible {
        /// The contradiction.
        reason: String,
    },
}

/// Error text for a right eye to the left of the left one.
pub fn swapped(right_from_left: &RigidTransform) -> Option<String> {
    let [x, ..] = right_from_left.translation_m();
    (x >= 0.0).then(|| {
        format!(
            "the left camera's origin is at x = {x} m in the right camera's frame, expected below 0: are left and \
             right swapped?"
        )
    })
}

/// Error text for a sensor that is too far from the first camera to be in metres.
pub fn too_far(name: &str, from_first: &RigidTransform) -> Option<String> {
    let metres = from_first.distance_m();
    (!metres.is_finite() || metres > MAX_BASELINE_M).then(|| {
        format!("{name} is {metres} m from the first camera, expected at most {MAX_BASELINE_M}: not in metres?")
    })
}

/// Note on a very wide pair; `baseline_m` in metres.
pub fn wide(baseline_m: f64) -> Option<Note> {
    (baseline_m > MAX_USUAL_BASELINE_M).then(|| {
        Note(format!(
            "left and right are {baseline_m} m apart: is the file in metres?"
        ))
    })
}
