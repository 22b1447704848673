//! Starts, replacements and ends of the encoders of one camera.

use std::sync::{Arc, Condvar, Mutex};

use session_archive::time::HostTime;
use video::encoder::{Input, Preset};
use video::{EncodeError, Encoder, EncoderSettings};

use super::CameraEncoder;
use super::delivery::{
    CHANGE_TIMEOUT, ENDED_EARLY, EncoderShared, State, deliver, end, report_undelivered,
};
use super::running::{Effort, FAILURE_RESET_NS, Running};

/// Delay before the restart after the second failure in a row; doubled after each further one.
pub(super) const RETRY_NS: i64 = 1_000_000_000;
/// Maximum delay between two restarts.
const MAX_RETRY_NS: i64 = 32 * RETRY_NS;
/// Reduction of the encoding quality under load, dB: about half of the bits.
const DEGRADED_QUALITY_DROP_DB: f64 = 4.0;
/// Minimum quality under load, dB.
const MIN_QUALITY_DB: f64 = 30.0;

impl CameraEncoder {
    /// Starts an encoder. It delivers nothing until everything of the encoder `before` it is
    /// reported.
    pub(super) fn start(
        &mut self,
        image: Input<'_>,
        before: Option<Arc<EncoderShared>>,
        now: HostTime,
    ) -> Result<(), EncodeError> {
        self.started = now;
        let effort = self.effort();
        let settings = EncoderSettings {
            quality_db: effort.quality_db,
            preset: effort.preset,
            ..self.settings.clone()
        };
        let shared = Arc::new(EncoderShared {
            state: Mutex::new(State {
                before,
                ..State::default()
            }),
            changed: Condvar::new(),
        });
        let (sink, of_output) = (self.sink.clone(), shared.clone());
        let on_output = Box::new(move |event| deliver(event, &of_output, &sink));
        let encoder = match image {
            Input::RawImage(_) => Encoder::start(&settings, on_output)?,
            Input::Native(frame) => Encoder::start_native(&settings, frame.format(), on_output)?,
        };
        self.running = Some(Running {
            encoder,
            shared,
            effort,
        });
        self.delivered = 0;
        self.last_progress = now;
        self.epoch = None;
        Ok(())
    }

    /// Current target settings of the encoder.
    pub(super) fn effort(&self) -> Effort {
        Effort {
            quality_db: match self.reduction.quality {
                true => (self.settings.quality_db - DEGRADED_QUALITY_DROP_DB).max(MIN_QUALITY_DB),
                false => self.settings.quality_db,
            },
            preset: match self.reduction.preset {
                true => Preset::Ultrafast,
                false => self.settings.preset,
            },
        }
    }

    /// To be called when a chunk, and with it a key frame, begins. An encoder that needs other
    /// settings and cannot change them is replaced. The old one delivers its frames on a thread of
    /// its own, because other cameras' frames are waiting.
    pub(super) fn follow_effort(&mut self, image: Input<'_>, now: HostTime) {
        let target = self.effort();
        let Some(running) = &mut self.running else {
            return;
        };
        if running.effort == target {
            return;
        }
        let set = match running.effort.preset == target.preset {
            true => running.encoder.set_quality(target.quality_db),
            false => Ok(false),
        };
        running.effort = target;
        match set {
            Ok(true) => {}
            Ok(false) => {
                let Some(running) = self.running.take() else {
                    return;
                };
                let (shared, sink) = (running.shared.clone(), self.sink.clone());
                self.end_in_background(move || {
                    end(running.encoder, &running.shared, &sink, CHANGE_TIMEOUT);
                });
                if let Err(error) = self.start(image, Some(shared.clone()), now) {
                    log::warn!("starting {} again: {error}", self.settings.element);
                    report_undelivered(&shared, &self.sink, ENDED_EARLY);
                    self.failed(now);
                }
            }
            Err(error) => self.replace(&error.to_string(), now),
        }
    }

    /// Abandons the encoder and reports the frames inside; the next frame starts another one.
    pub(super) fn replace(&mut self, reason: &str, now: HostTime) {
        let Some(Running {
            encoder, shared, ..
        }) = self.running.take()
        else {
            return;
        };
        log::warn!("{} is given up: {reason}", self.settings.element);
        self.failed(now);
        report_undelivered(&shared, &self.sink, reason);
        self.end_in_background(move || drop(encoder));
        self.last_progress = now;
        self.key_frame_requested = true;
    }

    /// Ends an encoder on a thread of its own: a stuck encoder takes seconds, and this thread
    /// serves other cameras.
    pub(super) fn end_in_background(&mut self, end: impl FnOnce() + Send + 'static) {
        let name = "encoder-end".to_owned();
        // Without a thread the closure is dropped here, which ends the encoder.
        self.ending
            .extend(std::thread::Builder::new().name(name).spawn(end));
    }

    /// Counts a failure and delays the next start.
    pub(super) fn failed(&mut self, now: HostTime) {
        if now.since(self.started) > FAILURE_RESET_NS {
            self.failures = 0;
        }
        let pause = match self.failures {
            0 => 0,
            before => (RETRY_NS << (before - 1).min(10)).min(MAX_RETRY_NS),
        };
        self.failures += 1;
        self.retry_at = now + pause;
    }
}
