//! What was found in a session, and whether it is sound.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::scan::{Damage, DamageKind};
use crate::time::HostTime;

/// Consecutive samples that are missing without a gap record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LostSamples {
    /// The stream, as gap records name it.
    pub stream: String,
    /// First missing number.
    pub first: u64,
    /// Last missing number.
    pub last: u64,
    /// Time of the sample before.
    pub after: HostTime,
    /// Time of the sample behind.
    pub before: HostTime,
}

/// What is known of one numbered stream.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StreamReport {
    /// First number: of a sample, in a gap record, or by the manifest.
    pub first: u64,
    /// Last number: of a sample, in a gap record, or by the manifest.
    pub last: u64,
    /// Numbers of which a sample is present.
    pub samples: u64,
    /// Samples missing by gap records.
    pub gaps: u64,
    /// Samples missing without a gap record.
    pub lost: u64,
    /// Samples whose number or a later one was there before: twice, or out of order.
    pub repeated: u64,
    /// Samples that are present although a gap record says that they are missing.
    pub contradicted: u64,
    /// Frames whose access unit is missing or does not match its checksum.
    pub bad_payloads: u64,
    /// Time of the first sample.
    pub start: HostTime,
    /// Time of the last sample. Samples that a cut has taken are later.
    pub end: HostTime,
}

impl StreamReport {
    /// Samples that should be there: every number from the first to the last.
    pub fn expected(&self) -> u64 {
        if self.samples == 0 && self.gaps == 0 && self.lost == 0 {
            0
        } else {
            (self.last - self.first).saturating_add(1)
        }
    }
}

/// Damage in one segment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SegmentDamage {
    /// The segment.
    pub segment: u32,
    /// Range and cause.
    #[serde(flatten)]
    pub damage: Damage,
}

/// Everything found in a session.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Report {
    /// The session's identifier.
    pub session_id: String,
    /// Why the manifest had to be rebuilt, if it had to.
    pub manifest_note: Option<String>,
    /// Whether the recorder closed the session.
    pub closed: bool,
    /// Bytes of the segments.
    pub bytes: u64,
    /// Messages that can be read.
    pub messages: u64,
    /// Segments that are not there.
    pub missing_segments: Vec<u32>,
    /// Files of `rig/` that are not there or not what the manifest says, by name.
    pub bad_rig_files: Vec<String>,
    /// Bytes that cannot be used.
    pub damage: Vec<SegmentDamage>,
    /// Messages that are not what their schema says.
    pub undecodable: u64,
    /// The numbered streams: cameras and IMUs.
    pub streams: BTreeMap<String, StreamReport>,
    /// Samples missing without a gap record, by time.
    pub lost: Vec<LostSamples>,
    /// Segments that ended without a summary although nothing is damaged: cut off, or given up.
    pub open_segments: Vec<u32>,
}

impl Report {
    /// Whether only the end is missing, as after a power cut: nothing else is wrong with it.
    pub fn is_only_cut_off(&self) -> bool {
        let last = self.damage.iter().map(|d| d.segment).max();
        let mut closed = self.clone();
        closed.closed = true;
        closed
            .damage
            .retain(|d| d.damage.kind != DamageKind::CutOff || Some(d.segment) != last);
        !self.closed && closed.is_sound()
    }

    /// Whether everything that was recorded is there and accounted for. Loss that the recorder
    /// noted does not make a session unsound; an unclosed one is not sound.
    pub fn is_sound(&self) -> bool {
        self.closed
            && self.manifest_note.is_none()
            && self.missing_segments.is_empty()
            && self.bad_rig_files.is_empty()
            && self.damage.is_empty()
            && self.undecodable == 0
            && self.lost.is_empty()
            && self
                .streams
                .values()
                .all(|s| s.repeated == 0 && s.contradicted == 0 && s.bad_payloads == 0)
    }
}
