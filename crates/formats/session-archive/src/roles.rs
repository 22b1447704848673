//! What each channel of a session carries, as far as messages can be held against each other.

use std::collections::BTreeMap;

use bytes::Bytes;

use crate::manifest::Manifest;
use crate::record::{CompressedVideo, Frame, FrameSet, ImuBatch, Protobuf, Record};
use crate::time::NS_PER_S;
use crate::writer::MAX_SEGMENT_NS;

/// What a channel carries, with the position of its camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    Video(usize),
    Frame(usize),
    Imu,
    FrameSet,
    /// A message without a time of its own, or of a schema that is not known here.
    Other,
}

/// The roles of the channels in a manifest.
#[derive(Clone, Debug)]
pub(crate) struct Roles(BTreeMap<u16, Role>);

impl Roles {
    pub(crate) fn new(manifest: &Manifest) -> Self {
        let camera = |of: &str| manifest.cameras.iter().position(|c| c.name == of);
        let role = |schema: &str, of: &str| match schema {
            name if name == CompressedVideo::SCHEMA.name => camera(of).map(Role::Video),
            name if name == Frame::SCHEMA.name => camera(of).map(Role::Frame),
            name if name == ImuBatch::SCHEMA.name => Some(Role::Imu),
            name if name == FrameSet::SCHEMA.name => Some(Role::FrameSet),
            _ => None,
        };
        let streams = manifest.streams.iter();
        Self(
            streams
                .map(|s| (s.id, role(&s.schema, &s.of).unwrap_or(Role::Other)))
                .collect(),
        )
    }

    /// The role of a channel; `None` if the session has no such channel.
    pub(crate) fn of(&self, channel: u16) -> Option<Role> {
        self.0.get(&channel).copied()
    }
}

impl Role {
    /// Whether this log time, ns, can be that of a message with this payload: not negative, and by
    /// the time in the message itself, where it has one and can be decoded. That of a frame record
    /// and of an access unit is the log time, because the writer takes one for the other. The
    /// recorder gives both times of batches and frame sets, which are within a segment of each other.
    pub(crate) fn is_possible(self, log_time: u64, data: Bytes) -> bool {
        let Ok(log) = i64::try_from(log_time) else {
            return false;
        };
        let own = self.own_time(data);
        own.is_none_or(|own| own.abs_diff(log) <= self.tolerance_ns())
    }

    fn tolerance_ns(self) -> u64 {
        match self {
            Self::Video(_) | Self::Frame(_) => 0,
            Self::Imu | Self::FrameSet | Self::Other => MAX_SEGMENT_NS.unsigned_abs(),
        }
    }

    /// The time in the message itself, ns.
    fn own_time(self, data: Bytes) -> Option<i64> {
        match self {
            Self::Video(_) => {
                let stamp = CompressedVideo::decode(data).ok()?.timestamp?;
                let seconds = stamp.seconds.checked_mul(NS_PER_S)?;
                seconds.checked_add(stamp.nanos.into())
            }
            Self::Frame(_) => Some(Frame::decode(data).ok()?.time),
            Self::Imu => ImuBatch::decode(data).ok()?.times.first().copied(),
            Self::FrameSet => Some(FrameSet::decode(data).ok()?.time),
            Self::Other => None,
        }
    }
}
