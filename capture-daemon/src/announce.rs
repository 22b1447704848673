//! Steps that a person at a terminal waits for.
//!
//! Contract: every step that may take longer than a second is announced before it begins. A step is
//! a record of the logger with the target [`STEP`] and the level `info`: `pawsd` prints it as a
//! plain line, the journal stores it, `-q` suppresses it, and a program that uses this library
//! decides for itself.

use std::fmt::Display;

use crate::status::{State, Status};

/// Target of the log records.
pub const STEP: &str = "pawsd::step";

/// Announces a step.
pub fn step(text: impl Display) {
    log::info!(target: STEP, "{text}");
}

/// Announces which cameras have not delivered their first frame, and each camera when it does.
#[derive(Debug)]
pub struct FirstFrames {
    /// Cameras that have not delivered a frame, in the order of the configuration.
    pending: Vec<String>,
}

impl FirstFrames {
    /// Starts waiting for these cameras and announces it.
    pub fn wait(cameras: Vec<String>) -> Self {
        step(format_args!(
            "waiting for the first frames of {}",
            cameras.join(", ")
        ));
        Self { pending: cameras }
    }

    /// Announces the cameras that have delivered their first frame since the last call.
    pub fn update(&mut self, status: &Status) {
        for name in self.take_arrived(status) {
            match self.pending.as_slice() {
                [] => step(format_args!("{name} delivers")),
                rest => step(format_args!(
                    "{name} delivers; waiting for {}",
                    rest.join(", ")
                )),
            }
        }
    }

    fn take_arrived(&mut self, status: &Status) -> Vec<String> {
        // Counts are updated once a second; the state changes immediately.
        let all = status.state == State::Armed;
        let delivers = |name: &String| {
            let mut streams = status.streams.iter();
            all || streams.any(|stream| stream.name == *name && stream.received > 0)
        };
        let take_arrived = self.pending.iter().filter(|name| delivers(name)).cloned();
        let take_arrived: Vec<String> = take_arrived.collect();
        self.pending.retain(|name| !take_arrived.contains(name));
        take_arrived
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_camera_is_reported_once() {
        let status = |feet: u64, left: u64| -> Status {
            serde_json::from_value(serde_json::json!({
                "state": "idle", "seconds": 0, "alarms": [], "encoders": [],
                "streams": [stream("feet", feet), stream("feet/imu", 9), stream("left", left)],
            }))
            .expect("a status")
        };
        let mut first_frames = FirstFrames::wait(vec!["feet".to_owned(), "left".to_owned()]);
        assert_eq!(first_frames.take_arrived(&status(0, 0)), [""; 0]);
        assert_eq!(first_frames.take_arrived(&status(0, 2)), ["left"]);
        assert_eq!(first_frames.take_arrived(&status(1, 3)), ["feet"]);
        assert_eq!(first_frames.take_arrived(&status(2, 4)), [""; 0]);
        let mut first_frames = FirstFrames::wait(vec!["feet".to_owned()]);
        let armed = Status {
            state: State::Armed,
            ..status(0, 0)
        };
        assert_eq!(first_frames.take_arrived(&armed), ["feet"]);
    }

    fn stream(name: &str, received: u64) -> serde_json::Value {
        serde_json::json!({
            "name": name, "rate_hz": 0.0, "received": received, "stored": 0, "missing": 0,
            "silent": false, "frozen": false,
        })
    }
}
