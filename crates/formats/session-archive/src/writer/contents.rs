//! What is in a chunk of our own: read back from its bytes, so that the writer keeps no second
//! account of it.

use std::collections::BTreeMap;

use crate::manifest::{Extent, Stream};
use crate::mcap::{Chunk, Message, Record as McapRecord};
use crate::record::{CompressedVideo, Frame, FrameSet, Gap, ImuBatch, Protobuf, Record};
use crate::time::HostTime;

/// Earliest and latest log time in a chunk.
pub(super) fn chunk_bounds(bytes: &[u8]) -> (HostTime, HostTime) {
    parsed_chunk(bytes).map_or((HostTime(0), HostTime(0)), |c| {
        (
            HostTime(c.message_start_time as i64),
            HostTime(c.message_end_time as i64),
        )
    })
}

/// The messages in a chunk of our own.
pub(super) fn messages(bytes: &[u8]) -> impl Iterator<Item = Message<'_>> {
    parsed_chunk(bytes)
        .into_iter()
        .flat_map(|chunk| chunk.messages().flatten())
}

/// The stream of a message.
pub(super) fn stream_of<'a>(streams: &'a [Stream], message: &Message<'_>) -> Option<&'a Stream> {
    streams.iter().find(|s| s.id == message.channel_id)
}

/// Whether a stream holds samples, which are numbered and may be large, and not metadata about
/// them.
pub(super) fn is_sampled(stream: &Stream) -> bool {
    [
        CompressedVideo::SCHEMA.name,
        Frame::SCHEMA.name,
        ImuBatch::SCHEMA.name,
    ]
    .contains(&stream.schema.as_str())
}

/// Stream and extent of every message in a chunk that holds numbered samples.
pub(super) fn samples<'a>(
    bytes: &'a [u8],
    streams: &'a [Stream],
) -> impl Iterator<Item = (String, Extent)> + 'a {
    messages(bytes).filter_map(|m| {
        let stream = stream_of(streams, &m)?;
        let (first, last, start, end) = if stream.schema == Frame::SCHEMA.name {
            let frame = Frame::decode(m.data).ok()?;
            (frame.number, frame.number, frame.time, frame.time)
        } else if stream.schema == ImuBatch::SCHEMA.name {
            let batch = ImuBatch::decode(m.data).ok()?;
            let first = batch.first_number;
            let more = batch.times.len().checked_sub(1)? as u64;
            (
                first,
                first.saturating_add(more),
                *batch.times.first()?,
                *batch.times.last()?,
            )
        } else {
            return None;
        };
        let extent = Extent {
            first,
            last,
            start: HostTime(start),
            end: HostTime(end),
        };
        Some((stream.of.clone(), extent))
    })
}

/// Stream and extent of every gap record in a chunk.
pub(super) fn gaps<'a>(
    bytes: &'a [u8],
    streams: &'a [Stream],
) -> impl Iterator<Item = (String, Extent)> + 'a {
    messages(bytes).filter_map(|m| {
        if stream_of(streams, &m)?.schema != Gap::SCHEMA.name {
            return None;
        }
        let gap = Gap::decode(m.data).ok()?;
        let time = HostTime(m.log_time as i64);
        let extent = Extent {
            first: gap.first,
            last: gap.last,
            start: time,
            end: time,
        };
        Some((gap.stream, extent))
    })
}

/// Camera and number of the frames that a message names, if it is a frame set.
pub(super) fn members(
    stream: &Stream,
    message: &Message<'_>,
) -> impl Iterator<Item = (String, u64)> + use<> {
    let set = (stream.schema == FrameSet::SCHEMA.name)
        .then(|| FrameSet::decode(message.data).ok())
        .flatten();
    let members = set.map(|set| set.members).unwrap_or_default();
    members.into_iter().map(|m| (m.camera, m.number))
}

/// The samples of each stream, neighbours taken together.
pub(super) fn runs(
    samples: impl Iterator<Item = (String, Extent)>,
) -> BTreeMap<String, Vec<Extent>> {
    let mut runs: BTreeMap<String, Vec<Extent>> = BTreeMap::new();
    for (name, sample) in samples {
        let runs = runs.entry(name).or_default();
        match runs.last_mut() {
            Some(run) if run.last.checked_add(1) == Some(sample.first) => run.cover(sample),
            _ => runs.push(sample),
        }
    }
    runs
}

/// One extent for each stream.
pub(super) fn extents(parts: impl Iterator<Item = (String, Extent)>) -> BTreeMap<String, Extent> {
    let mut whole = BTreeMap::new();
    for (name, part) in parts {
        whole.entry(name).or_insert(part).cover(part);
    }
    whole
}

fn parsed_chunk(bytes: &[u8]) -> Option<Chunk<'_>> {
    match McapRecord::split(bytes) {
        Ok((McapRecord::Chunk(chunk), _)) => Some(chunk),
        _ => None,
    }
}
