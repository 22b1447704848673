//! Encoding: chunks, and the frame of a file around them.
//!
//! Both builders are deterministic: the same calls give the same bytes, whatever the history of
//! the process. Recovery relies on it to reproduce what a clean close would have written.

use std::collections::BTreeMap;

use crc32fast::Hasher;

use super::{CHUNK_PREFIX, MAGIC, RECORD_HEADER, op};
use crate::mcap::parse::{Chunk, ChunkIndex, ParseError, Record, RecordIter};
use crate::record::Schema;

/// Appends one record: opcode, length, and the body that `body` writes.
fn record(out: &mut Vec<u8>, opcode: u8, body: impl FnOnce(&mut Vec<u8>)) {
    out.push(opcode);
    let length_at = out.len();
    out.extend([0; 8]);
    body(out);
    let length = (out.len() - length_at - 8) as u64;
    out[length_at..length_at + 8].copy_from_slice(&length.to_le_bytes());
}

fn string(out: &mut Vec<u8>, s: &str) {
    out.extend((s.len() as u32).to_le_bytes());
    out.extend(s.as_bytes());
}

fn schema_record(out: &mut Vec<u8>, id: u16, name: &str, data: &[u8]) {
    record(out, op::SCHEMA, |b| {
        b.extend(id.to_le_bytes());
        string(b, name);
        string(b, "protobuf");
        b.extend((data.len() as u32).to_le_bytes());
        b.extend(data);
    });
}

fn channel_record(out: &mut Vec<u8>, c: &ChannelEntry) {
    record(out, op::CHANNEL, |b| {
        b.extend(c.id.to_le_bytes());
        b.extend(c.schema_id.to_le_bytes());
        string(b, &c.topic);
        string(b, "protobuf");
        let bytes: usize = c.metadata.iter().map(|(k, v)| 8 + k.len() + v.len()).sum();
        b.extend((bytes as u32).to_le_bytes());
        for (k, v) in &c.metadata {
            string(b, k);
            string(b, v);
        }
    });
}

#[derive(Clone, Debug)]
struct ChannelEntry {
    id: u16,
    schema_id: u16,
    topic: String,
    metadata: BTreeMap<String, String>,
}

/// One chunk under construction: message records appended to one buffer, which ends as the chunk
/// record with its message indexes behind it, ready for one write.
///
/// ```
/// use session_archive::mcap::{ChunkBuilder, Record};
///
/// let mut chunk = ChunkBuilder::default();
/// chunk.message(7, 0, 1_000, 1_200, |out| out.extend_from_slice(b"payload"));
/// assert_eq!((chunk.messages(), chunk.start_time()), (1, Some(1_000)));
///
/// let bytes = chunk.finish();
/// let (Record::Chunk(read), _indexes) = Record::split(&bytes)? else {
///     panic!("not a chunk");
/// };
/// assert!(read.verify());
/// let messages: Vec<_> = read.messages().collect::<Result<_, _>>()?;
/// assert_eq!((messages[0].channel_id, messages[0].data), (7, &b"payload"[..]));
/// # Ok::<(), session_archive::mcap::ParseError>(())
/// ```
#[derive(Debug)]
pub struct ChunkBuilder {
    buf: Vec<u8>,
    /// Over the records so far: each is hashed while it is still in the processor's cache.
    crc: Hasher,
    /// Per channel: log time and offset of each message within the chunk's records.
    index: Index,
    bounds: Option<(u64, u64)>,
    messages: u64,
}

impl Default for ChunkBuilder {
    fn default() -> Self {
        Self {
            buf: vec![0; CHUNK_PREFIX],
            crc: Hasher::new(),
            index: BTreeMap::new(),
            bounds: None,
            messages: 0,
        }
    }
}

impl ChunkBuilder {
    /// Whether nothing was put in yet.
    pub fn is_empty(&self) -> bool {
        self.buf.len() == CHUNK_PREFIX
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.buf.len()
    }

    /// Messages held.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Earliest log time held, ns.
    pub fn start_time(&self) -> Option<u64> {
        self.bounds.map(|(start, _)| start)
    }

    /// Appends a schema record.
    pub fn schema(&mut self, id: u16, schema: &Schema) {
        self.add(|buf| schema_record(buf, id, schema.name, schema.descriptor_set));
    }

    /// Appends a channel record; the schema must come before it.
    pub fn channel(
        &mut self,
        id: u16,
        schema_id: u16,
        topic: &str,
        metadata: &BTreeMap<String, String>,
    ) {
        let entry = ChannelEntry {
            id,
            schema_id,
            topic: topic.to_owned(),
            metadata: metadata.clone(),
        };
        self.add(|buf| channel_record(buf, &entry));
    }

    fn add(&mut self, write: impl FnOnce(&mut Vec<u8>)) {
        let at = self.buf.len();
        write(&mut self.buf);
        self.crc.update(&self.buf[at..]);
    }

    /// Appends a message whose payload `body` writes. Times in ns.
    pub fn message(
        &mut self,
        channel: u16,
        sequence: u32,
        log_time: u64,
        publish_time: u64,
        body: impl FnOnce(&mut Vec<u8>),
    ) {
        let offset = (self.buf.len() - CHUNK_PREFIX) as u64;
        self.add(|buf| {
            record(buf, op::MESSAGE, |b| {
                b.extend(channel.to_le_bytes());
                b.extend(sequence.to_le_bytes());
                b.extend(log_time.to_le_bytes());
                b.extend(publish_time.to_le_bytes());
                body(b);
            });
        });
        self.note(channel, log_time, offset);
    }

    fn note(&mut self, channel: u16, log_time: u64, offset: u64) {
        self.index
            .entry(channel)
            .or_default()
            .push((log_time, offset));
        self.messages += 1;
        self.bounds = Some(match self.bounds {
            None => (log_time, log_time),
            Some((start, end)) => (start.min(log_time), end.max(log_time)),
        });
    }

    /// Closes the chunk: the bytes of the chunk record and its message indexes. The builder is
    /// empty afterwards and keeps no memory; [`Self::recycle`] gives a buffer back.
    pub fn finish(&mut self) -> Vec<u8> {
        let mut done = std::mem::take(self);
        let buf = &mut done.buf;
        let (start, end) = done.bounds.unwrap_or((0, 0));
        let size = (buf.len() - CHUNK_PREFIX) as u64;
        let crc = done.crc.finalize();
        let mut prefix = Vec::with_capacity(CHUNK_PREFIX);
        prefix.push(op::CHUNK);
        prefix.extend(((CHUNK_PREFIX - RECORD_HEADER) as u64 + size).to_le_bytes());
        prefix.extend(start.to_le_bytes());
        prefix.extend(end.to_le_bytes());
        prefix.extend(size.to_le_bytes());
        prefix.extend(crc.to_le_bytes());
        string(&mut prefix, "");
        prefix.extend(size.to_le_bytes());
        buf[..CHUNK_PREFIX].copy_from_slice(&prefix);
        message_indexes(buf, &done.index);
        done.buf
    }

    /// Hands a finished chunk's buffer back, so that the next chunk does not allocate.
    pub fn recycle(&mut self, mut buf: Vec<u8>) {
        if self.is_empty() && buf.capacity() > self.buf.capacity() {
            buf.truncate(CHUNK_PREFIX);
            self.buf = buf;
        }
    }
}

/// Log time and offset of each message, per channel.
type Index = BTreeMap<u16, Vec<(u64, u64)>>;

/// Appends a message index record per channel.
fn message_indexes(out: &mut Vec<u8>, index: &Index) {
    for (channel, entries) in index {
        record(out, op::MESSAGE_INDEX, |b| {
            b.extend(channel.to_le_bytes());
            b.extend((entries.len() as u32 * 16).to_le_bytes());
            for (time, offset) in entries {
                b.extend(time.to_le_bytes());
                b.extend(offset.to_le_bytes());
            }
        });
    }
}

/// The bytes that [`ChunkBuilder::finish`] gave for a chunk, from its (verified) records alone.
pub fn sealed_chunk(records: &[u8]) -> Vec<u8> {
    let mut builder = ChunkBuilder::default();
    builder.add(|buf| buf.extend_from_slice(records));
    let mut iter = RecordIter::new(records);
    loop {
        let offset = (records.len() - iter.remaining()) as u64;
        match iter.next() {
            Some(Ok(Record::Message(m))) => builder.note(m.channel_id, m.log_time, offset),
            Some(Ok(_)) => {}
            Some(Err(_)) | None => break,
        }
    }
    builder.finish()
}

/// The frame of one file: what stands before the first chunk, and the summary behind the last,
/// made from nothing but the chunks in between.
///
/// A whole file, as any reader of MCAP opens it:
///
/// ```
/// use session_archive::mcap::{ChunkBuilder, MAGIC, Record, RecordIter, SegmentEncoder};
/// use session_archive::record::{Event, Record as _};
/// # use std::collections::BTreeMap;
///
/// let (mut encoder, mut file) = SegmentEncoder::start("paws", "example");
/// let mut chunk = ChunkBuilder::default();
/// chunk.schema(1, &Event::SCHEMA);
/// chunk.channel(1, 1, "/events", &BTreeMap::new());
/// chunk.message(1, 0, 1_000, 1_000, |_| {});
/// let chunk = chunk.finish();
/// encoder.chunk(&chunk)?;
/// file.extend(chunk);
/// file.extend(encoder.finish());
///
/// let records = RecordIter::new(&file[MAGIC.len()..file.len() - MAGIC.len()]);
/// let statistics = records.flatten().find_map(|record| match record {
///     Record::Statistics(statistics) => Some(statistics),
///     _ => None,
/// });
/// assert_eq!(statistics.map(|s| (s.message_count, s.chunk_count)), Some((1, 1)));
/// # Ok::<(), session_archive::mcap::ParseError>(())
/// ```
#[derive(Clone, Debug)]
pub struct SegmentEncoder {
    position: u64,
    data_crc: Hasher,
    schemas: BTreeMap<u16, (String, Vec<u8>)>,
    channels: BTreeMap<u16, ChannelEntry>,
    chunks: Vec<ChunkIndex>,
    counts: BTreeMap<u16, u64>,
    bounds: Option<(u64, u64)>,
}

impl SegmentEncoder {
    /// A new file and the bytes that it starts with: magic and header record.
    pub fn start(profile: &str, library: &str) -> (Self, Vec<u8>) {
        let mut out = MAGIC.to_vec();
        record(&mut out, op::HEADER, |b| {
            string(b, profile);
            string(b, library);
        });
        let mut data_crc = Hasher::new();
        data_crc.update(&out);
        let encoder = Self {
            position: out.len() as u64,
            data_crc,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            chunks: Vec::new(),
            counts: BTreeMap::new(),
            bounds: None,
        };
        (encoder, out)
    }

    /// Bytes of the file so far.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Earliest and latest log time so far, ns.
    pub fn bounds(&self) -> Option<(u64, u64)> {
        self.bounds
    }

    /// Messages so far, per channel.
    pub fn counts(&self) -> &BTreeMap<u16, u64> {
        &self.counts
    }

    /// Chunks so far.
    pub fn chunk_count(&self) -> usize {
        self.chunks.len()
    }

    /// Takes note of a chunk (with its message indexes) that was put at the end of the file.
    ///
    /// # Errors
    /// The bytes are not one uncompressed chunk with its message indexes.
    pub fn chunk(&mut self, bytes: &[u8]) -> Result<(), ParseError> {
        let (first, rest) = Record::split(bytes)?;
        let Record::Chunk(chunk) = first else {
            return Err(ParseError::Unexpected {
                found: first.opcode(),
                expected: op::CHUNK,
            });
        };
        let chunk_length = (bytes.len() - rest.len()) as u64;
        let mut times: Option<(u64, u64)> = None;
        self.note_records(&chunk, &mut times)?;
        let mut message_index_offsets = BTreeMap::new();
        let mut tail = rest;
        while !tail.is_empty() {
            let offset = (bytes.len() - tail.len()) as u64;
            let (index, after) = Record::split(tail)?;
            let Record::MessageIndex(index) = index else {
                return Err(ParseError::Unexpected {
                    found: index.opcode(),
                    expected: op::MESSAGE_INDEX,
                });
            };
            message_index_offsets.insert(index.channel_id, self.position + offset);
            tail = after;
        }
        let (start, end) = times.unwrap_or((0, 0));
        if let Some((s, e)) = times {
            self.bounds = Some(self.bounds.map_or((s, e), |(a, b)| (a.min(s), b.max(e))));
        }
        self.chunks.push(ChunkIndex {
            message_start_time: start,
            message_end_time: end,
            chunk_start_offset: self.position,
            chunk_length,
            message_index_offsets,
            message_index_length: rest.len() as u64,
            compression: String::new(),
            compressed_size: chunk.records.len() as u64,
            uncompressed_size: chunk.records.len() as u64,
        });
        // The records' own checksum stands for them: they are the bulk, and were hashed before.
        let records =
            Hasher::new_with_initial_len(chunk.uncompressed_crc, chunk.records.len() as u64);
        self.data_crc.update(&bytes[..CHUNK_PREFIX]);
        self.data_crc.combine(&records);
        self.data_crc.update(rest);
        self.position += bytes.len() as u64;
        Ok(())
    }

    fn note_records(
        &mut self,
        chunk: &Chunk<'_>,
        times: &mut Option<(u64, u64)>,
    ) -> Result<(), ParseError> {
        for record in chunk.iter() {
            match record? {
                Record::Message(m) => {
                    *self.counts.entry(m.channel_id).or_default() += 1;
                    let t = m.log_time;
                    *times = Some(times.map_or((t, t), |(a, b)| (a.min(t), b.max(t))));
                }
                Record::Schema(s) => {
                    self.schemas
                        .insert(s.id, (s.name.to_owned(), s.data.to_vec()));
                }
                Record::Channel(c) => {
                    let entry = ChannelEntry {
                        id: c.id,
                        schema_id: c.schema_id,
                        topic: c.topic.clone(),
                        metadata: c.metadata.clone(),
                    };
                    self.channels.insert(c.id, entry);
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// What stands behind the last chunk: data end, summary, footer and magic.
    pub fn finish(self) -> Vec<u8> {
        let mut out = Vec::new();
        let data_crc = self.data_crc.clone().finalize();
        record(&mut out, op::DATA_END, |b| b.extend(data_crc.to_le_bytes()));
        let summary_at = out.len();
        let mut groups: Vec<(u8, usize, usize)> = Vec::new();
        let mut group = |out: &mut Vec<u8>, opcode: u8, write: &mut dyn FnMut(&mut Vec<u8>)| {
            let at = out.len();
            write(out);
            if out.len() > at {
                groups.push((opcode, at, out.len() - at));
            }
        };
        group(&mut out, op::SCHEMA, &mut |out| {
            for (id, (name, data)) in &self.schemas {
                schema_record(out, *id, name, data);
            }
        });
        group(&mut out, op::CHANNEL, &mut |out| {
            for channel in self.channels.values() {
                channel_record(out, channel);
            }
        });
        group(&mut out, op::STATISTICS, &mut |out| self.statistics(out));
        group(&mut out, op::CHUNK_INDEX, &mut |out| {
            for chunk in &self.chunks {
                chunk_index_record(out, chunk);
            }
        });
        let offsets_at = out.len();
        for (opcode, at, length) in groups {
            record(&mut out, op::SUMMARY_OFFSET, |b| {
                b.push(opcode);
                b.extend((self.position + at as u64).to_le_bytes());
                b.extend((length as u64).to_le_bytes());
            });
        }
        let mut footer = vec![op::FOOTER];
        footer.extend(20_u64.to_le_bytes());
        footer.extend((self.position + summary_at as u64).to_le_bytes());
        footer.extend((self.position + offsets_at as u64).to_le_bytes());
        out.extend(footer);
        let summary_crc = crc32fast::hash(&out[summary_at..]);
        out.extend(summary_crc.to_le_bytes());
        out.extend(MAGIC);
        out
    }

    fn statistics(&self, out: &mut Vec<u8>) {
        let (start, end) = self.bounds.unwrap_or((0, 0));
        record(out, op::STATISTICS, |b| {
            b.extend(self.counts.values().sum::<u64>().to_le_bytes());
            b.extend((self.schemas.len() as u16).to_le_bytes());
            b.extend((self.channels.len() as u32).to_le_bytes());
            b.extend(0_u32.to_le_bytes()); // attachments
            b.extend(0_u32.to_le_bytes()); // metadata
            b.extend((self.chunks.len() as u32).to_le_bytes());
            b.extend(start.to_le_bytes());
            b.extend(end.to_le_bytes());
            b.extend((self.counts.len() as u32 * 10).to_le_bytes());
            for (channel, count) in &self.counts {
                b.extend(channel.to_le_bytes());
                b.extend(count.to_le_bytes());
            }
        });
    }
}

fn chunk_index_record(out: &mut Vec<u8>, c: &ChunkIndex) {
    record(out, op::CHUNK_INDEX, |b| {
        b.extend(c.message_start_time.to_le_bytes());
        b.extend(c.message_end_time.to_le_bytes());
        b.extend(c.chunk_start_offset.to_le_bytes());
        b.extend(c.chunk_length.to_le_bytes());
        b.extend((c.message_index_offsets.len() as u32 * 10).to_le_bytes());
        for (channel, offset) in &c.message_index_offsets {
            b.extend(channel.to_le_bytes());
            b.extend(offset.to_le_bytes());
        }
        b.extend(c.message_index_length.to_le_bytes());
        string(b, &c.compression);
        b.extend(c.compressed_size.to_le_bytes());
        b.extend(c.uncompressed_size.to_le_bytes());
    });
}
