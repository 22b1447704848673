//! What can be saved of a chunk whose checksum does not hold.
//!
//! Most bytes of a chunk are access units, and each has its own CRC-32 and length in the frame
//! record in front of it. The checksum of the chunk is computed again with these in place of the
//! units' bytes (a CRC of joined bytes follows from the CRCs and lengths of its parts). If the
//! result is the stored checksum, then all bytes outside of the access units are as they were
//! written, the CRCs of the units among them, and damage is only in the units whose own CRC does
//! not hold. Those frames are left out, and everything else is proved sound by the same 32 bits
//! that prove a whole chunk.
//!
//! If any other byte is damaged (framing, frame records, IMU batches, the checksum itself), nothing
//! of the chunk is proved, also not a frame whose own CRC holds: its number and its times would be
//! unchecked. Then nothing is saved.

use std::collections::BTreeMap;
use std::ops::Range;

use bytes::Bytes;
use crc32fast::Hasher;

use crate::impossible::without;
use crate::mcap::{CHUNK_PREFIX, Record, RecordIter};
use crate::record::{CompressedVideo, Frame, Protobuf};
use crate::roles::{Role, Roles};
use crate::scan::VerifiedChunk;

/// What is proved sound of the damaged chunk record at the start of `bytes`, which is at `offset`
/// of its file: its records without the damaged frames. `None` if nothing is.
pub(crate) fn salvage(bytes: &Bytes, offset: u64, roles: &Roles) -> Option<VerifiedChunk> {
    let (Record::Chunk(chunk), rest) = Record::split(bytes).ok()? else {
        return None;
    };
    let length = bytes.len() - rest.len();
    let records = bytes.slice(CHUNK_PREFIX..length);
    let damaged = damaged_frames(&records, chunk.uncompressed_crc, roles)?;
    Some(VerifiedChunk {
        offset,
        length: length as u64,
        records: without(&records, &damaged),
    })
}

/// Where the records of damaged frames are, if nothing else is damaged.
fn damaged_frames(records: &Bytes, stored_crc: u32, roles: &Roles) -> Option<Vec<Range<usize>>> {
    let base = records.as_ptr() as usize;
    let mut crc = Hasher::new();
    let mut hashed = 0;
    let mut damaged = Vec::new();
    let mut waiting: BTreeMap<usize, (Range<usize>, Frame)> = BTreeMap::new();
    let mut iter = RecordIter::new(records);
    while iter.remaining() > 0 {
        let start = records.len() - iter.remaining();
        let record = iter.next()?.ok()?;
        let range = start..records.len() - iter.remaining();
        let Record::Message(m) = record else {
            continue;
        };
        match roles.of(m.channel_id)? {
            Role::Frame(camera) => {
                waiting.insert(camera, (range, Frame::decode(m.data).ok()?));
            }
            Role::Video(camera) => {
                let (of_frame, frame) = waiting.remove(&camera)?;
                let unit = CompressedVideo::decode(records.slice_ref(m.data))
                    .ok()?
                    .data;
                if frame.payload_bytes as usize != unit.len() {
                    return None;
                }
                if unit.is_empty() {
                    continue;
                }
                let at = unit.as_ptr() as usize - base;
                crc.update(&records[hashed..at]);
                let length = unit.len() as u64;
                crc.combine(&Hasher::new_with_initial_len(frame.payload_crc32, length));
                hashed = at + unit.len();
                if crc32fast::hash(&unit) != frame.payload_crc32 {
                    damaged.extend([of_frame, range]);
                }
            }
            _ => {}
        }
    }
    crc.update(&records[hashed..]);
    damaged.sort_by_key(|range| range.start);
    (crc.finalize() == stored_crc).then_some(damaged)
}
