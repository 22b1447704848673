//! The end of a session: a stop that waits for what is in transit, a discard, or a failure.

use std::io;

use session_archive::manifest::Stop;
use session_archive::record::paws::event::Kind;

use super::alarm_sources::LOSSES;
use super::session::Stopping;
use super::stop_limits::{MAX_STOP_NS, STOP_LIMIT_NS};
use super::{Recorder, describe};
use crate::error_chain::with_causes;
use crate::status::Progress;

impl Recorder {
    /// Stops: samples received before now are still stored. The session is closed [`STOP_LIMIT_NS`]
    /// later, or when nothing from before it is left in encoders and queues, by [`Self::tick`] or
    /// [`Self::handle`].
    ///
    /// # Errors
    /// Nothing is being recorded.
    pub fn stop(&mut self, source: &str) -> Result<(), String> {
        let state = self.state();
        let at = self.clock.now();
        let streams = self.delivered.len();
        let Some(session) = &mut self.session else {
            return Err(format!("nothing is being recorded; the state is {state}"));
        };
        if session.stopping.is_none() {
            session.stopping = Some(Stopping {
                at,
                reason: source.to_owned(),
                waiting: vec![true; streams],
            });
            self.event(Kind::Stop, at, source, "");
        }
        Ok(())
    }

    /// Ends a session immediately, for when nothing more can arrive.
    pub fn close_now(&mut self, source: &str) {
        if self.stop(source).is_ok() {
            self.close(None);
        }
    }

    /// Stops and deletes the session.
    pub(super) fn discard(&mut self, source: &str) -> Result<(), String> {
        let Some(mut session) = self.session.take() else {
            return Err(format!(
                "nothing is being recorded; the state is {}",
                self.state()
            ));
        };
        let path = session.path.clone();
        let ended = session.end_losses();
        drop(session);
        let now = self.clock.now();
        for (text, active) in ended {
            self.on_alarm(now, text, LOSSES, active);
        }
        log::info!("{} discarded by {source}", path.display());
        self.last_session = None;
        self.last_totals = (0.0, Vec::new());
        self.store
            .discard(&path)
            .map_err(|e| format!("deleting {}: {e}", path.display()))
    }

    /// Deletes the last session.
    pub(super) fn discard_last(&mut self, source: &str) -> Result<(), String> {
        if let Some(session) = &self.session {
            return Err(format!("still recording {}", session.path.display()));
        }
        let Some(path) = self.last_session.clone() else {
            return Err("there is no last recording that could be discarded".to_owned());
        };
        let discarded = self.store.discard(&path);
        // A session that could not be deleted can be deleted later; one that a host has removed
        // meanwhile no longer exists.
        let is_left = matches!(&discarded, Err(e) if e.kind() != io::ErrorKind::NotFound);
        if !is_left {
            self.last_session = None;
            self.last_totals = (0.0, Vec::new());
        }
        discarded.map_err(|e| format!("deleting {}: {e}", path.display()))?;
        log::info!("{} discarded by {source}", path.display());
        Ok(())
    }

    /// Whether all samples from before a stop have arrived, or the limit has passed.
    pub(super) fn is_stop_over(&self) -> bool {
        let Some(stopping) = self.session.as_ref().and_then(|s| s.stopping.as_ref()) else {
            return false;
        };
        let waited_ns = self.clock.now().since(stopping.at);
        if stopping.waiting.iter().all(|waits| !waits) || waited_ns >= MAX_STOP_NS {
            return true;
        }
        // In this order: frames are queued before they count as encoded.
        let mut cameras = 0..self.setup.cameras.len();
        let is_encoding =
            cameras.any(|camera| stopping.waiting[camera] && self.queues.encoding.is_busy(camera));
        waited_ns >= STOP_LIMIT_NS && !is_encoding && (self.queues.bytes)() == 0
    }

    /// Closes the session; after a failure, as far as the disk permits.
    pub(super) fn close(&mut self, error: Option<String>) {
        let Some(mut session) = self.session.take() else {
            return;
        };
        let now = self.clock.now();
        let stopping = session.stopping.take();
        let settled = session.settle();
        let error = error.or_else(|| settled.err().map(|e| with_causes(&e)));
        let reason = match (&error, &stopping) {
            (Some(e), _) => format!("failure: {e}"),
            (None, Some(s)) => s.reason.clone(),
            (None, None) => "closed".to_owned(),
        };
        let at = stopping.map_or(now, |s| s.at);
        let closed = session.close(Stop {
            at,
            reason: reason.clone(),
        });
        for incident in std::mem::take(&mut session.incidents) {
            let text = describe(&incident);
            log::error!("{text}");
            (self.on_progress)(Progress::Alarm { text, active: true });
        }
        let failed = error.or_else(|| closed.err().map(|e| with_causes(&e)));
        if failed.is_some() {
            session.write_off();
        }
        let seconds = session.seconds();
        self.last_totals = (
            seconds,
            session
                .streams
                .iter()
                .map(|s| (s.stored, s.missing))
                .collect(),
        );
        let stored = session.streams.iter().map(|s| s.stored).sum();
        let missing = session.streams.iter().map(|s| s.missing).sum();
        let absent = session.absent();
        let streams = session.account();
        let ended = session.end_losses();
        let path = session.path;
        if let Some(e) = &failed {
            let text = format!(
                "recording ended by a failure: {e}; {seconds:.1} s are in {}",
                path.display()
            );
            log::error!("{text}");
            self.fault = Some(text);
        }
        (self.on_progress)(Progress::Finished {
            session: path,
            reason,
            seconds,
            stored,
            missing,
            absent,
            streams,
            error: failed,
        });
        for (text, active) in ended {
            self.on_alarm(now, text, LOSSES, active);
        }
    }
}
