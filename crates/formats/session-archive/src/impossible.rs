//! Messages that no recorder can have written, in a chunk whose checksum holds.
//!
//! A checksum shows that bytes are those that it was made of, and anyone can make one. Impossible
//! is a message
//!
//! * on a channel that the manifest does not have: 0, or a number beyond its streams;
//! * with a log time before zero, that is from 2^63 on;
//! * whose log time is not the time in the message itself: of a frame record, of an access unit
//!   (its timestamp, and the time of its frame record); of an IMU batch (first sample) and of a
//!   frame set more than a minute away, which is the length of a segment.
//!
//! A frame record and its access unit are one frame: both are left out. Events, gaps, health and
//! state have no time of their own, and a recording may pause for any time, so any other log time
//! is possible for them.

use std::collections::BTreeMap;
use std::ops::Range;

use bytes::Bytes;

use crate::mcap::{Message, Record, RecordIter};
use crate::roles::{Role, Roles};

/// Where impossible messages are in the (verified) records of a chunk, in their order; almost
/// always nothing.
pub(crate) fn impossible(records: &Bytes, roles: &Roles) -> Vec<Range<usize>> {
    let mut found = ImpossibleMessages::default();
    let mut iter = RecordIter::new(records);
    loop {
        let start = records.len() - iter.remaining();
        match iter.next() {
            Some(Ok(Record::Message(m))) => {
                let range = start..records.len() - iter.remaining();
                let role = roles.of(m.channel_id);
                let data = || records.slice_ref(m.data);
                let is_possible = role.is_some_and(|role| role.is_possible(m.log_time, data()));
                found.message(range, &m, role, is_possible);
            }
            Some(Ok(_)) => {}
            Some(Err(_)) | None => return found.finish(),
        }
    }
}

/// The records without these ranges, which are in order.
pub(crate) fn without(records: &Bytes, left_out: &[Range<usize>]) -> Bytes {
    if left_out.is_empty() {
        return records.clone();
    }
    let mut kept = Vec::with_capacity(records.len());
    let mut from = 0;
    for range in left_out {
        kept.extend_from_slice(&records[from..range.start]);
        from = range.end;
    }
    kept.extend_from_slice(&records[from..]);
    kept.into()
}

/// A frame record that waits for its access unit.
struct Waiting {
    range: Range<usize>,
    log_time: u64,
    is_possible: bool,
}

#[derive(Default)]
struct ImpossibleMessages {
    impossible: Vec<Range<usize>>,
    /// Frame records without access unit and units without record: one of the two may be among the
    /// impossible.
    single: Vec<Range<usize>>,
    waiting: BTreeMap<usize, Waiting>,
}

impl ImpossibleMessages {
    fn message(
        &mut self,
        range: Range<usize>,
        m: &Message<'_>,
        role: Option<Role>,
        is_possible: bool,
    ) {
        match role {
            Some(Role::Frame(camera)) => {
                let waiting = Waiting {
                    range,
                    log_time: m.log_time,
                    is_possible,
                };
                if let Some(earlier) = self.waiting.insert(camera, waiting) {
                    self.single(earlier);
                }
            }
            Some(Role::Video(camera)) => match self.waiting.remove(&camera) {
                Some(frame) => {
                    let agree = frame.log_time == m.log_time;
                    if !(agree && frame.is_possible && is_possible) {
                        self.impossible.extend([frame.range, range]);
                    }
                }
                None if is_possible => self.single.push(range),
                None => self.impossible.push(range),
            },
            _ if is_possible => {}
            _ => self.impossible.push(range),
        }
    }

    fn single(&mut self, frame: Waiting) {
        match frame.is_possible {
            true => self.single.push(frame.range),
            false => self.impossible.push(frame.range),
        }
    }

    fn finish(mut self) -> Vec<Range<usize>> {
        for frame in std::mem::take(&mut self.waiting).into_values() {
            self.single(frame);
        }
        if !self.impossible.is_empty() {
            self.impossible.append(&mut self.single);
        }
        self.impossible.sort_by_key(|range| range.start);
        self.impossible
    }
}
