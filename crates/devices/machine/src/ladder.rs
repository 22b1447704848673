//! The degradation ladder: measures for when heat, power, disk or time become scarce, each taken
//! early enough to help and released late enough not to oscillate.
//!
//! Contract: [`Ladder::reading`] is pure but for what it remembers. It is handed what the other
//! modules found, about once a second, and returns what changed, with the reason in words. A rung
//! is entered when its reading has been beyond the threshold for its dwell time, and left when the
//! reading has been better than a second, easier threshold for much longer. Of the last
//! [`READINGS`] the middle one counts, so that a single glitch does nothing. A missing reading is
//! no news for [`STALE_NS`]; then its sensor counts as absent, and the steps that it had requested
//! are released. More pressure never leads to a lower step.
//!
//! Each cause goes only as far as helps against it (the table is in `ladder/limits.rs`):
//!
//! - **Heat** lowers the preview, then the frame rate, and stops just before the kernel would
//!   switch off. It skips the bitrate, which hardly changes what an encoder computes.
//! - **Throttling** lowers the preview only: it is the machine's own remedy. If it leaves too
//!   little for the encoders, their queues say so.
//! - **Encoder overload** lowers preview, bitrate, frame rate, and never stops: frames dropped on a
//!   regular grid are better than at random, and either is better than none.
//! - **Battery** and **supply** warn, lower the preview and stop before the machine goes dark. The
//!   cameras and the processor draw nearly the same at a lower rate: the walk would get a minute
//!   longer and all of it worse.
//! - **Disk** lowers the bitrate, then stops. The preview is not stored, and frames left out never
//!   come back, while a lower bitrate doubles what is left.
//!
//! A step that relieves its own cause immediately (all that is done for an encoder, the bitrate for
//! the disk) is kept until the next recording begins: that a measure works is no sign that it is no
//! longer needed.

use serde::Serialize;

use crate::battery::Power;
use crate::disk::DiskState;
use crate::thermal::Heat;

mod limits;
mod rung;
mod words;

use limits::Quantity;
pub use limits::{Limits, LimitsError};
use rung::Rung;
pub use rung::{READINGS, STALE_NS};

/// A step of the ladder; each notifies the operator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Step {
    /// Nothing is scarce.
    #[default]
    Normal,
    /// Tell the operator.
    Warn,
    /// Show fewer or no live frames.
    LowerPreview,
    /// Encode with fewer bits.
    LowerBitrate,
    /// Record fewer frames per second.
    LowerFrameRate,
    /// End the recording, whole, while that is still possible; start none.
    StopCleanly,
}

/// What can be scarce.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// Temperature.
    Heat,
    /// The machine has slowed itself.
    Throttling,
    /// Batteries.
    Battery,
    /// Voltage of the input.
    Supply,
    /// Space for recordings.
    Disk,
    /// Frames wait for the encoder.
    Encoder,
}

/// One look at everything. What is not known is `None`.
#[derive(Clone, Debug, Default)]
pub struct Pressure {
    /// Heat.
    pub heat: Option<Heat>,
    /// Power.
    pub power: Option<Power>,
    /// Disk.
    pub disk: Option<DiskState>,
    /// How full the fullest queue to an encoder is, 0 to 1: at 1 frames are dropped.
    pub encoder_fill: Option<f64>,
}

/// A change, to be recorded as an event.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Change {
    /// When, `CLOCK_MONOTONIC`, ns.
    pub at_ns: i64,
    /// Why.
    pub cause: Cause,
    /// The step that this cause requested before.
    pub from: Step,
    /// The step that it asks for now.
    pub to: Step,
    /// For people: `disk: 4 min left at 6.1 MB/s; bitrate lowered`.
    pub text: String,
}

/// What is to be done now. Each stands alone: a full disk lowers the bitrate and leaves the
/// preview.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Mitigations {
    /// The operator is notified.
    pub warn: bool,
    /// Show fewer or no live frames.
    pub lower_preview: bool,
    /// Encode with fewer bits.
    pub lower_bitrate: bool,
    /// Record fewer frames per second.
    pub lower_frame_rate: bool,
    /// End the recording and start none.
    pub stop: bool,
}

/// The ladder.
#[derive(Clone, Debug)]
pub struct Ladder {
    rungs: Vec<Rung>,
    limits: Limits,
    last: Pressure,
}

impl Default for Ladder {
    /// A ladder with the usual limits.
    fn default() -> Self {
        let limits = Limits::default();
        Self {
            rungs: limits.rungs(),
            limits,
            last: Pressure::default(),
        }
    }
}

impl Ladder {
    /// A ladder on which nothing is scarce yet.
    ///
    /// # Errors
    /// The limits contradict each other.
    pub fn new(limits: Limits) -> Result<Self, LimitsError> {
        limits.check()?;
        Ok(Self {
            rungs: limits.rungs(),
            limits,
            last: Pressure::default(),
        })
    }

    /// The pressure at `at_ns`, which does not go back; what it changes.
    pub fn reading(&mut self, at_ns: i64, pressure: &Pressure) -> Vec<Change> {
        let before = self.causes();
        for rung in &mut self.rungs {
            rung.reading(at_ns, rung.quantity.of(pressure));
        }
        self.last = pressure.clone();
        self.changes(at_ns, &before)
    }

    /// A recording begins: bitrate and frame rate are tried as configured again.
    pub fn begin_recording(&mut self, at_ns: i64) -> Vec<Change> {
        let before = self.causes();
        for rung in &mut self.rungs {
            rung.begin_recording();
        }
        self.changes(at_ns, &before)
    }

    /// The highest step that any cause asks for.
    pub fn step(&self) -> Step {
        self.entered()
            .map(|rung| rung.step)
            .max()
            .unwrap_or_default()
    }

    /// What is to be done.
    pub fn mitigations(&self) -> Mitigations {
        let any = |step| self.entered().any(|rung| rung.step == step);
        Mitigations {
            warn: self.step() > Step::Normal,
            lower_preview: any(Step::LowerPreview),
            lower_bitrate: any(Step::LowerBitrate),
            lower_frame_rate: any(Step::LowerFrameRate),
            stop: any(Step::StopCleanly),
        }
    }

    /// What is scarce now, each with its step and in words.
    pub fn reasons(&self) -> Vec<(Cause, Step, String)> {
        let tight = self.causes().into_iter().filter(|(_, s)| *s > Step::Normal);
        tight
            .map(|(cause, step)| {
                let text = words::say(cause, &self.last, &self.limits);
                (cause, step, text)
            })
            .collect()
    }

    fn entered(&self) -> impl Iterator<Item = &Rung> {
        self.rungs.iter().filter(|rung| rung.is_entered())
    }

    /// Every cause with its step.
    fn causes(&self) -> Vec<(Cause, Step)> {
        let step_of = |cause| {
            let of_cause = self.entered().filter(|r| r.quantity.cause() == cause);
            of_cause.map(|rung| rung.step).max().unwrap_or_default()
        };
        use Cause::*;
        [Heat, Throttling, Battery, Supply, Disk, Encoder]
            .map(|cause| (cause, step_of(cause)))
            .into()
    }

    fn changes(&self, at_ns: i64, before: &[(Cause, Step)]) -> Vec<Change> {
        let now = self.causes();
        let changed = before.iter().zip(&now).filter(|(from, to)| from != to);
        changed
            .map(|(&(cause, from), &(_, to))| Change {
                at_ns,
                cause,
                from,
                to,
                text: words::tell(cause, from, to, &self.last, &self.limits),
            })
            .collect()
    }
}

#[cfg(test)]
mod tests;
