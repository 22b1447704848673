//! One message of a session.

use bytes::Bytes;

use crate::mcap;
use crate::record::Record;
use crate::scan::VerifiedChunk;
use crate::time::HostTime;

/// One message of a session.
#[derive(Clone, Debug)]
pub struct Message {
    /// Segment that it is in.
    pub segment: u32,
    /// Where its chunk starts in the segment's file.
    pub chunk_offset: u64,
    /// Where its payload starts within the chunk's records.
    pub payload_offset: u32,
    /// Channel.
    pub stream: u16,
    /// Sequence number within the channel; the low 32 bits of the frame number for video.
    pub sequence: u32,
    /// Log time.
    pub time: HostTime,
    /// Publish time.
    pub published: HostTime,
    /// The protobuf message.
    pub data: Bytes,
}

impl Message {
    /// A message in the records of a chunk.
    pub(crate) fn of_chunk(segment: u32, chunk: &VerifiedChunk, m: &mcap::Message<'_>) -> Self {
        let payload_offset = m.data.as_ptr() as usize - chunk.records.as_ptr() as usize;
        Self {
            segment,
            chunk_offset: chunk.offset,
            payload_offset: payload_offset as u32,
            stream: m.channel_id,
            sequence: m.sequence,
            time: HostTime(m.log_time as i64),
            published: HostTime(m.publish_time as i64),
            data: chunk.records.slice_ref(m.data),
        }
    }

    /// The messages of a chunk, in the order written.
    pub(crate) fn all(segment: u32, chunk: &VerifiedChunk) -> impl Iterator<Item = Self> + '_ {
        let messages = chunk.messages().map_while(Result::ok);
        messages.map(move |m| Self::of_chunk(segment, chunk, &m))
    }

    /// The payload as a message of type `R`.
    ///
    /// # Errors
    /// The bytes are no such message.
    pub fn decode<R: Record>(&self) -> Result<R, prost::DecodeError> {
        R::decode(self.data.clone())
    }
}
