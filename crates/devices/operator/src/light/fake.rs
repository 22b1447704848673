//! A light that remembers what it showed.

use std::io;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use super::Light;
use crate::pattern::LightState;

/// A light whose states can be received elsewhere.
#[derive(Debug)]
pub(crate) struct RecordingLight {
    shown: SyncSender<LightState>,
    /// How many of the next calls fail.
    failures: usize,
}

impl RecordingLight {
    /// A light that fails the first `failures` times, and what it showed, failures included. Holds
    /// 1024 states that nobody has received; more are an error.
    pub(crate) fn new(failures: usize) -> (Self, Receiver<LightState>) {
        let (shown, looks) = sync_channel(1024);
        (Self { shown, failures }, looks)
    }
}

impl Light for RecordingLight {
    fn show(&mut self, state: LightState) -> io::Result<()> {
        self.shown.try_send(state).map_err(io::Error::other)?;
        if self.failures > 0 {
            self.failures -= 1;
            return Err(io::Error::other("scripted failure"));
        }
        Ok(())
    }

    fn describe(&self) -> &str {
        "recorded light"
    }
}
