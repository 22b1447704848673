//! The first chunk of a segment.

use std::collections::BTreeMap;

use crate::manifest::Stream;
use crate::mcap::ChunkBuilder;
use crate::record::{self, Protobuf, Record, Segment};
use crate::time::HostTime;

/// The first chunk of a segment: schemas, channels, who the segment is, and the state of the
/// session so far as (channel, sequence, message), so that the segment can be read alone. In a
/// chunk, because only chunks have a checksum that holds while the file still grows.
pub(crate) fn head_chunk<'a>(
    identity: &Segment,
    streams: &[Stream],
    time: HostTime,
    states: impl Iterator<Item = (u16, u32, &'a [u8])>,
) -> Vec<u8> {
    let mut head = ChunkBuilder::default();
    let log = time.0.max(0) as u64;
    for (schema, id) in record::SCHEMAS.iter().zip(1..) {
        head.schema(id, schema);
    }
    for stream in streams {
        let schema = record::SCHEMAS.iter().position(|s| s.name == stream.schema);
        let schema_id = schema.map_or(0, |i| i as u16 + 1);
        let metadata = BTreeMap::from([("of".to_owned(), stream.of.clone())]);
        head.channel(stream.id, schema_id, &stream.topic, &metadata);
    }
    let own = streams
        .iter()
        .find(|s| s.schema == Segment::SCHEMA.name)
        .map_or(1, |s| s.id);
    head.message(own, identity.number, log, log, |out| encode(identity, out));
    for (id, sequence, data) in states {
        head.message(id, sequence, log, log, |out| out.extend(data));
    }
    head.finish()
}

/// Appends a protobuf message; a `Vec` grows, so encoding into it cannot fail.
pub(super) fn encode(message: &impl Protobuf, out: &mut Vec<u8>) {
    message.encode_raw(out);
}
