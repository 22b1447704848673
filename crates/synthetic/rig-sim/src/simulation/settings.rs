//! What to simulate, and what is refused.

use cad_transforms::rig::RigError;

use super::imaging::{EyeDifference, Imaging};
use crate::camera::Quality;
use crate::camera::sensor::SensorModel;
use crate::scene::{Kind, Lighting};
use crate::targets::Plan;

/// Maximum length of a walk, s: the ground truth of a whole walk is held in memory.
const MAX_LENGTH_S: f64 = 3600.0;
/// Maximum frame rate, Hz: the rolling shutter reads an image in less than this period.
const MAX_RATE_HZ: f64 = 100.0;
/// Supported image sizes, pixels per side of one eye.
const SIDE_RANGE_PX: std::ops::RangeInclusive<u32> = 16..=4096;
/// What to simulate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Scene.
    pub kind: Kind,
    /// Lighting.
    pub lighting: Lighting,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Length of the walk, s.
    pub seconds: f64,
    /// Frames per second of every camera.
    pub rate_hz: f64,
    /// Columns of one eye, even.
    pub width: u32,
    /// Rows, even.
    pub height: u32,
    /// Rendering quality.
    pub quality: Quality,
}

/// Error of preparing a simulation.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// A setting that cannot be simulated: choose another.
    #[error("preparing a simulated walk: {what} is {found}, expected {expected}")]
    Setting {
        /// Name of the setting.
        what: &'static str,
        /// Its value.
        found: String,
        /// The supported values.
        expected: String,
    },
    /// A shoe tag that cannot be drawn: use one of the first of its family.
    #[error("preparing the wearer of a simulated rig: tag {id} is on a shoe, expected 0 to {last}")]
    Tag {
        /// Id of the tag.
        id: u32,
        /// Highest id that can be drawn.
        last: usize,
    },
    /// A calibration belongs to a camera that the rig does not have, or to another image size.
    #[error("applying a calibration to a simulated camera: {0}")]
    Lenses(String),
    /// The rig file lacks an eye or the IMU of a camera: complete it.
    #[error("preparing the cameras of a simulated walk")]
    Rig(#[from] RigError),
}

impl Settings {
    pub(super) fn check(&self) -> Result<(), SimulationError> {
        let wrong = |what, found: &dyn std::fmt::Display, expected: String| {
            Err(SimulationError::Setting {
                what,
                found: found.to_string(),
                expected,
            })
        };
        // NaN is in no range.
        if !(self.seconds > 0.0 && self.seconds <= MAX_LENGTH_S) {
            let expected = format!("above 0 and at most {MAX_LENGTH_S} s");
            return wrong("the length of the walk", &self.seconds, expected);
        }
        if !(self.rate_hz > 0.0 && self.rate_hz <= MAX_RATE_HZ) {
            let expected = format!("above 0 and at most {MAX_RATE_HZ} Hz");
            return wrong("the rate of the cameras", &self.rate_hz, expected);
        }
        for (what, size) in [
            ("the width of an eye", self.width),
            ("the height", self.height),
        ] {
            if !SIDE_RANGE_PX.contains(&size) || size % 2 == 1 {
                let expected = format!(
                    "an even number of pixels from {} to {}",
                    SIDE_RANGE_PX.start(),
                    SIDE_RANGE_PX.end()
                );
                return wrong(what, &size, expected);
            }
        }
        if self.frame_count() == 0 {
            let expected = format!("at least one period of {} s", 1.0 / self.rate_hz);
            return wrong("the length of the walk", &self.seconds, expected);
        }
        Ok(())
    }

    /// Number of frames of each camera: the whole periods of the walk.
    pub fn frame_count(&self) -> u64 {
        // A length of whole periods may be slightly less in floating point.
        (self.seconds * self.rate_hz + 1e-6).floor() as u64
    }

    /// Time of frame `n`: middle of the exposure, ns.
    pub fn frame_ns(&self, n: u64) -> i64 {
        ((n as f64 + 0.5) / self.rate_hz * 1e9).round() as i64
    }
}

/// Converts nanoseconds to seconds, the argument of the motion.
pub fn seconds(time_ns: i64) -> f64 {
    time_ns as f64 * 1e-9
}

impl Plan {
    pub(super) fn check(&self) -> Result<(), SimulationError> {
        in_ranges(&[
            ("the bow of the boards, m,", self.bow_m, -0.1, 0.1),
            ("the scale error of the boards", self.scale_error, -0.2, 0.2),
        ])
    }
}

/// Checks a sensor response, its exposure excepted.
pub(super) fn check_imaging(imaging: &Imaging) -> Result<(), SimulationError> {
    let EyeDifference {
        blur_px,
        vignetting,
        gain,
    } = imaging.right_eye;
    let most_vignetting = 1.0 - SensorModel::SMALL.vignetting;
    let values = [
        ("the noise", imaging.noise, 0.0, 100.0),
        (
            "the blur of the right eye, px,",
            f64::from(blur_px),
            0.0,
            10.0,
        ),
        (
            "the vignetting of the right eye",
            f64::from(vignetting),
            0.0,
            f64::from(most_vignetting),
        ),
        ("the gain of the right eye", f64::from(gain), -0.5, 1.0),
        (
            "the codec's step",
            f64::from(imaging.codec_step),
            0.0,
            255.0,
        ),
    ];
    in_ranges(&values)
}

/// Checks values, each with its name, minimum and maximum.
pub(super) fn in_ranges(values: &[(&'static str, f64, f64, f64)]) -> Result<(), SimulationError> {
    // NaN is in no range.
    let is_wrong = |(_, found, least, most): &&(_, f64, f64, f64)| !(least..=most).contains(&found);
    match values.iter().find(is_wrong) {
        None => Ok(()),
        Some((what, found, least, most)) => Err(SimulationError::Setting {
            what,
            found: found.to_string(),
            expected: format!("{least} to {most}"),
        }),
    }
}
