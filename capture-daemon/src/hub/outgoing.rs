//! What the hub and the encoders deliver to the recorder.

use std::sync::Arc;

use bytes::Bytes;
use session_archive::record::paws::gap::Cause;
use session_archive::record::{ClockMap as ClockMapRecord, Frame, ImuBatch};
use session_archive::time::HostTime;

use crate::sources::FrameSync;

/// Output of the hub and the encoders to the recorder.
#[derive(Debug)]
pub enum Outgoing {
    /// An encoded frame.
    Frame {
        /// Position of the camera.
        camera: usize,
        /// Its companion record.
        frame: Frame,
        /// The access unit.
        unit: Bytes,
        /// Whether the frame can be decoded on its own.
        key: bool,
    },
    /// IMU samples.
    Imu {
        /// Position of the IMU.
        imu: usize,
        /// The samples.
        batch: ImuBatch,
    },
    /// A changed clock map.
    Clock {
        /// Time of the change.
        at: HostTime,
        /// The map; it names its clock.
        map: ClockMapRecord,
    },
    /// Samples that will not be delivered.
    Dropped {
        /// Time of the first sample.
        at: HostTime,
        /// Stream, as gap records name it.
        stream: String,
        /// First number.
        first: u64,
        /// Last number.
        last: u64,
        /// Cause.
        cause: Cause,
        /// Details, for people.
        detail: String,
    },
    /// A condition that needs attention began or ended.
    Alarm {
        /// Time of the event.
        at: HostTime,
        /// The condition, with the same text at the beginning and at the end.
        text: String,
        /// The stream.
        stream: String,
        /// Whether it begins.
        active: bool,
    },
    /// An event worth recording.
    Notice {
        /// Time of the event.
        at: HostTime,
        /// The event, for people.
        text: String,
        /// The stream.
        stream: String,
    },
    /// State of the streams, once a second.
    Health {
        /// Time of the report.
        at: HostTime,
        /// Cameras first, then IMUs, in their order.
        streams: Vec<StreamHealth>,
    },
}

impl Outgoing {
    /// Size in bytes, for bounding queues.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Frame { unit, .. } => unit.len() + 256,
            Self::Imu { batch, .. } => 256 + 80 * batch.device_ticks.len(),
            _ => 256,
        }
    }
}

/// One stream in the last second.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StreamHealth {
    /// Stream, as gap records name it.
    pub name: String,
    /// Samples per second received.
    pub rate_hz: f64,
    /// Samples received since the daemon started.
    pub received: u64,
    /// Bytes waiting for the encoder.
    pub queue_bytes: u64,
    /// No sample for too long.
    pub silent: bool,
    /// The image has not changed for too long.
    pub frozen: bool,
    /// Clock relation of an IMU to its camera, if a new one was estimated, and by how many ns the
    /// IMU's times are later.
    pub frame_sync: Option<(FrameSync, i64)>,
}

/// Receiver of the hub's output; also called from the encoders' threads.
pub type Out = Arc<dyn Fn(Outgoing) + Send + Sync>;

/// An alarm of a stream begins or ends.
pub(super) fn alarm(stream: &str, what: &str, active: bool, at: HostTime, out: &Out) {
    out(Outgoing::Alarm {
        at,
        text: format!("{stream}: {what}"),
        stream: stream.to_owned(),
        active,
    });
}
