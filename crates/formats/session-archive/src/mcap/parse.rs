//! Parsing, total on any bytes: every input gives a record or a [`ParseError`]; nothing panics,
//! and nothing is allocated that the input does not hold. Checksums are the caller's business,
//! except that [`Chunk::verify`] is here.

use std::collections::BTreeMap;

use super::{RECORD_HEADER, op};

/// Why bytes are not the record they claim to be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ParseError {
    /// The record says that it is longer than what is left.
    #[error("record of {needed} bytes where {left} are left")]
    Truncated {
        /// Bytes that the record would need.
        needed: u64,
        /// Bytes that are there.
        left: u64,
    },
    /// The body of a record does not follow its layout.
    #[error("record with opcode {opcode:#04x}: {what}")]
    Malformed {
        /// The record's opcode.
        opcode: u8,
        /// What does not fit.
        what: &'static str,
    },
    /// A chunk is compressed; this profile never is.
    #[error("chunk compressed with {0:?}, which this reader does not read")]
    Compressed(String),
    /// A record of another kind than the expected one.
    #[error("record with opcode {found:#04x} where {expected:#04x} is expected")]
    Unexpected {
        /// The opcode found.
        found: u8,
        /// The opcode that belongs there.
        expected: u8,
    },
}

/// One parsed record; large parts are borrowed.
#[derive(Clone, Debug, PartialEq, Eq)]
#[expect(
    missing_docs,
    reason = "each variant is the record of that name in the MCAP specification"
)]
pub enum Record<'a> {
    Header(Header),
    Footer(Footer),
    Schema(SchemaRecord<'a>),
    Channel(Channel),
    Message(Message<'a>),
    Chunk(Chunk<'a>),
    MessageIndex(MessageIndex),
    ChunkIndex(ChunkIndex),
    Attachment(Attachment<'a>),
    AttachmentIndex(AttachmentIndex),
    Statistics(Statistics),
    Metadata(Metadata),
    MetadataIndex(MetadataIndex),
    SummaryOffset(SummaryOffset),
    DataEnd { data_section_crc: u32 },
    Unknown { opcode: u8, body: &'a [u8] },
}

macro_rules! plain {
    ($($(#[$doc:meta])+ $name:ident $(<$life:lifetime>)? { $($field:ident: $type:ty),* $(,)? })*) => {
        $(
            $(#[$doc])+
            #[derive(Clone, Debug, PartialEq, Eq)]
            #[allow(missing_docs)]
            pub struct $name $(<$life>)? { $(pub $field: $type),* }
        )*
    };
}

plain! {
    /// Who wrote the file, by which profile.
    Header { profile: String, library: String }
    /// Where the summary is and its checksum (0 = none).
    Footer { summary_start: u64, summary_offset_start: u64, summary_crc: u32 }
    /// A schema; `id` 0 is not allowed.
    SchemaRecord<'a> { id: u16, name: &'a str, encoding: &'a str, data: &'a [u8] }
    /// A channel; `schema_id` 0 means none.
    Channel {
        id: u16,
        schema_id: u16,
        topic: String,
        message_encoding: String,
        metadata: BTreeMap<String, String>,
    }
    /// A message; times in ns.
    Message<'a> { channel_id: u16, sequence: u32, log_time: u64, publish_time: u64, data: &'a [u8] }
    /// A chunk that is not compressed: `records` are its bytes, not yet verified.
    Chunk<'a> {
        message_start_time: u64,
        message_end_time: u64,
        uncompressed_size: u64,
        uncompressed_crc: u32,
        records: &'a [u8],
    }
    /// A chunk of any writer as it lies in the file: `records` may be compressed, a checksum of 0
    /// means that there is none.
    PackedChunk<'a> {
        message_start_time: u64,
        message_end_time: u64,
        uncompressed_size: u64,
        uncompressed_crc: u32,
        compression: &'a str,
        records: &'a [u8],
    }
    /// Log time and offset (within the chunk's records) of one channel's messages in a chunk.
    MessageIndex { channel_id: u16, records: Vec<(u64, u64)> }
    /// Where a chunk is; offsets from the start of the file.
    ChunkIndex {
        message_start_time: u64,
        message_end_time: u64,
        chunk_start_offset: u64,
        chunk_length: u64,
        message_index_offsets: BTreeMap<u16, u64>,
        message_index_length: u64,
        compression: String,
        compressed_size: u64,
        uncompressed_size: u64,
    }
    /// A file within the file.
    Attachment<'a> {
        log_time: u64,
        create_time: u64,
        name: String,
        media_type: String,
        data: &'a [u8],
        crc: u32,
    }
    /// Where an attachment is.
    AttachmentIndex {
        offset: u64,
        length: u64,
        log_time: u64,
        create_time: u64,
        data_size: u64,
        name: String,
        media_type: String,
    }
    /// Counts over the whole file.
    Statistics {
        message_count: u64,
        schema_count: u16,
        channel_count: u32,
        attachment_count: u32,
        metadata_count: u32,
        chunk_count: u32,
        message_start_time: u64,
        message_end_time: u64,
        channel_message_counts: BTreeMap<u16, u64>,
    }
    /// Named strings.
    Metadata { name: String, metadata: BTreeMap<String, String> }
    /// Where a metadata record is.
    MetadataIndex { offset: u64, length: u64, name: String }
    /// Where the records of one opcode are in the summary.
    SummaryOffset { group_opcode: u8, group_start: u64, group_length: u64 }
}

impl<'a> Record<'a> {
    /// The record at the start of `bytes`, and what follows it.
    ///
    /// # Errors
    /// The bytes do not start with a whole, well-formed record.
    pub fn split(bytes: &'a [u8]) -> Result<(Self, &'a [u8]), ParseError> {
        let (opcode, body, rest) = frame(bytes)?;
        Ok((Self::parse(opcode, body)?, rest))
    }

    /// The record with this opcode and body.
    ///
    /// # Errors
    /// The body does not follow the layout of its opcode.
    pub fn parse(opcode: u8, body: &'a [u8]) -> Result<Self, ParseError> {
        let mut r = Reader { opcode, left: body };
        let record = match opcode {
            op::HEADER => Self::Header(Header {
                profile: r.string()?,
                library: r.string()?,
            }),
            op::FOOTER => Self::Footer(Footer {
                summary_start: r.u64()?,
                summary_offset_start: r.u64()?,
                summary_crc: r.u32()?,
            }),
            op::SCHEMA => Self::Schema(SchemaRecord {
                id: r.u16()?,
                name: r.str()?,
                encoding: r.str()?,
                data: r.bytes32()?,
            }),
            op::CHANNEL => Self::Channel(Channel {
                id: r.u16()?,
                schema_id: r.u16()?,
                topic: r.string()?,
                message_encoding: r.string()?,
                metadata: r.string_map()?,
            }),
            op::MESSAGE => Self::Message(Message {
                channel_id: r.u16()?,
                sequence: r.u32()?,
                log_time: r.u64()?,
                publish_time: r.u64()?,
                data: std::mem::take(&mut r.left),
            }),
            op::CHUNK => Self::Chunk(r.chunk()?),
            op::MESSAGE_INDEX => {
                let channel_id = r.u16()?;
                let entries = r.bytes32()?;
                if entries.len() % 16 != 0 {
                    return Err(r.malformed("index entries are not 16 bytes each"));
                }
                let records = entries
                    .chunks_exact(16)
                    .map(|e| (le_u64(&e[..8]), le_u64(&e[8..])))
                    .collect();
                Self::MessageIndex(MessageIndex {
                    channel_id,
                    records,
                })
            }
            op::CHUNK_INDEX => Self::ChunkIndex(ChunkIndex {
                message_start_time: r.u64()?,
                message_end_time: r.u64()?,
                chunk_start_offset: r.u64()?,
                chunk_length: r.u64()?,
                message_index_offsets: r.u16_map()?,
                message_index_length: r.u64()?,
                compression: r.string()?,
                compressed_size: r.u64()?,
                uncompressed_size: r.u64()?,
            }),
            op::ATTACHMENT => Self::Attachment(Attachment {
                log_time: r.u64()?,
                create_time: r.u64()?,
                name: r.string()?,
                media_type: r.string()?,
                data: r.bytes64()?,
                crc: r.u32()?,
            }),
            op::ATTACHMENT_INDEX => Self::AttachmentIndex(AttachmentIndex {
                offset: r.u64()?,
                length: r.u64()?,
                log_time: r.u64()?,
                create_time: r.u64()?,
                data_size: r.u64()?,
                name: r.string()?,
                media_type: r.string()?,
            }),
            op::STATISTICS => Self::Statistics(Statistics {
                message_count: r.u64()?,
                schema_count: r.u16()?,
                channel_count: r.u32()?,
                attachment_count: r.u32()?,
                metadata_count: r.u32()?,
                chunk_count: r.u32()?,
                message_start_time: r.u64()?,
                message_end_time: r.u64()?,
                channel_message_counts: r.u16_map()?,
            }),
            op::METADATA => Self::Metadata(Metadata {
                name: r.string()?,
                metadata: r.string_map()?,
            }),
            op::METADATA_INDEX => Self::MetadataIndex(MetadataIndex {
                offset: r.u64()?,
                length: r.u64()?,
                name: r.string()?,
            }),
            op::SUMMARY_OFFSET => Self::SummaryOffset(SummaryOffset {
                group_opcode: r.u8()?,
                group_start: r.u64()?,
                group_length: r.u64()?,
            }),
            op::DATA_END => Self::DataEnd {
                data_section_crc: r.u32()?,
            },
            opcode => Self::Unknown { opcode, body },
        };
        // What a later version of MCAP appends to a record is skipped, as its specification asks.
        Ok(record)
    }

    /// The record's opcode.
    pub fn opcode(&self) -> u8 {
        match self {
            Self::Header(_) => op::HEADER,
            Self::Footer(_) => op::FOOTER,
            Self::Schema(_) => op::SCHEMA,
            Self::Channel(_) => op::CHANNEL,
            Self::Message(_) => op::MESSAGE,
            Self::Chunk(_) => op::CHUNK,
            Self::MessageIndex(_) => op::MESSAGE_INDEX,
            Self::ChunkIndex(_) => op::CHUNK_INDEX,
            Self::Attachment(_) => op::ATTACHMENT,
            Self::AttachmentIndex(_) => op::ATTACHMENT_INDEX,
            Self::Statistics(_) => op::STATISTICS,
            Self::Metadata(_) => op::METADATA,
            Self::MetadataIndex(_) => op::METADATA_INDEX,
            Self::SummaryOffset(_) => op::SUMMARY_OFFSET,
            Self::DataEnd { .. } => op::DATA_END,
            Self::Unknown { opcode, .. } => *opcode,
        }
    }
}

impl<'a> PackedChunk<'a> {
    /// The chunk with this record body.
    ///
    /// # Errors
    /// The body does not follow the layout of chunks.
    pub fn parse(body: &'a [u8]) -> Result<Self, ParseError> {
        let mut reader = Reader {
            opcode: op::CHUNK,
            left: body,
        };
        reader.packed_chunk()
    }
}

impl<'a> Chunk<'a> {
    /// Whether the records match the chunk's checksum. A stored checksum of 0 is compared like
    /// any other: our writer always stores one.
    pub fn verify(&self) -> bool {
        crc32fast::hash(self.records) == self.uncompressed_crc
    }

    /// The records in the chunk; ends after the first that is malformed.
    pub fn iter(&self) -> RecordIter<'a> {
        RecordIter { left: self.records }
    }

    /// The messages in the chunk.
    pub fn messages(&self) -> Messages<'a> {
        Messages {
            records: self.iter(),
        }
    }
}

/// Records one after the other; ends after the first that is malformed.
#[derive(Clone, Debug)]
pub struct RecordIter<'a> {
    left: &'a [u8],
}

impl<'a> RecordIter<'a> {
    /// Iterates over `bytes`, which start with a record.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { left: bytes }
    }

    /// Bytes not yet consumed.
    pub fn remaining(&self) -> usize {
        self.left.len()
    }
}

impl<'a> Iterator for RecordIter<'a> {
    type Item = Result<Record<'a>, ParseError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.left.is_empty() {
            return None;
        }
        match Record::split(self.left) {
            Ok((record, rest)) => {
                self.left = rest;
                Some(Ok(record))
            }
            Err(e) => {
                self.left = &[];
                Some(Err(e))
            }
        }
    }
}

/// Messages of a chunk, other records skipped; ends after the first malformed record.
#[derive(Clone, Debug)]
pub struct Messages<'a> {
    records: RecordIter<'a>,
}

impl<'a> Iterator for Messages<'a> {
    type Item = Result<Message<'a>, ParseError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            match self.records.next()? {
                Ok(Record::Message(m)) => return Some(Ok(m)),
                Ok(_) => {}
                Err(e) => return Some(Err(e)),
            }
        }
    }
}

/// Opcode, body and rest of the record at the start of `bytes`.
fn frame(bytes: &[u8]) -> Result<(u8, &[u8], &[u8]), ParseError> {
    let left = bytes.len() as u64;
    if bytes.len() < RECORD_HEADER {
        return Err(ParseError::Truncated {
            needed: RECORD_HEADER as u64,
            left,
        });
    }
    let length = le_u64(&bytes[1..RECORD_HEADER]);
    let needed = length.saturating_add(RECORD_HEADER as u64);
    if needed > left {
        return Err(ParseError::Truncated { needed, left });
    }
    let (body, rest) = bytes[RECORD_HEADER..].split_at(length as usize);
    Ok((bytes[0], body, rest))
}

/// Little-endian u64 of exactly eight bytes.
fn le_u64(b: &[u8]) -> u64 {
    let mut a = [0; 8];
    a.copy_from_slice(b);
    u64::from_le_bytes(a)
}

struct Reader<'a> {
    opcode: u8,
    left: &'a [u8],
}

impl<'a> Reader<'a> {
    fn malformed(&self, what: &'static str) -> ParseError {
        ParseError::Malformed {
            opcode: self.opcode,
            what,
        }
    }

    fn take(&mut self, n: usize) -> Result<&'a [u8], ParseError> {
        if n > self.left.len() {
            return Err(self.malformed("a field runs over the end of the record"));
        }
        let (a, b) = self.left.split_at(n);
        self.left = b;
        Ok(a)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], ParseError> {
        let mut a = [0; N];
        a.copy_from_slice(self.take(N)?);
        Ok(a)
    }

    fn u8(&mut self) -> Result<u8, ParseError> {
        Ok(self.array::<1>()?[0])
    }

    fn u16(&mut self) -> Result<u16, ParseError> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, ParseError> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, ParseError> {
        self.array().map(u64::from_le_bytes)
    }

    fn bytes32(&mut self) -> Result<&'a [u8], ParseError> {
        let n = self.u32()?;
        self.take(n as usize)
    }

    fn bytes64(&mut self) -> Result<&'a [u8], ParseError> {
        let n = usize::try_from(self.u64()?)
            .map_err(|_| self.malformed("a field runs over the end of the record"))?;
        self.take(n)
    }

    fn str(&mut self) -> Result<&'a str, ParseError> {
        std::str::from_utf8(self.bytes32()?).map_err(|_| self.malformed("a string is not UTF-8"))
    }

    fn string(&mut self) -> Result<String, ParseError> {
        self.str().map(str::to_owned)
    }

    fn string_map(&mut self) -> Result<BTreeMap<String, String>, ParseError> {
        let mut inner = Reader {
            opcode: self.opcode,
            left: self.bytes32()?,
        };
        let mut map = BTreeMap::new();
        while !inner.left.is_empty() {
            map.insert(inner.string()?, inner.string()?);
        }
        Ok(map)
    }

    fn u16_map(&mut self) -> Result<BTreeMap<u16, u64>, ParseError> {
        let mut inner = Reader {
            opcode: self.opcode,
            left: self.bytes32()?,
        };
        let mut map = BTreeMap::new();
        while !inner.left.is_empty() {
            map.insert(inner.u16()?, inner.u64()?);
        }
        Ok(map)
    }

    fn chunk(&mut self) -> Result<Chunk<'a>, ParseError> {
        let packed = self.packed_chunk()?;
        if !packed.compression.is_empty() {
            return Err(ParseError::Compressed(packed.compression.to_owned()));
        }
        if packed.records.len() as u64 != packed.uncompressed_size {
            return Err(self.malformed("the chunk's two sizes differ"));
        }
        Ok(Chunk {
            message_start_time: packed.message_start_time,
            message_end_time: packed.message_end_time,
            uncompressed_size: packed.uncompressed_size,
            uncompressed_crc: packed.uncompressed_crc,
            records: packed.records,
        })
    }

    fn packed_chunk(&mut self) -> Result<PackedChunk<'a>, ParseError> {
        let chunk = PackedChunk {
            message_start_time: self.u64()?,
            message_end_time: self.u64()?,
            uncompressed_size: self.u64()?,
            uncompressed_crc: self.u32()?,
            compression: self.str()?,
            records: self.bytes64()?,
        };
        if !self.left.is_empty() {
            return Err(self.malformed("the chunk's records do not fill the chunk"));
        }
        Ok(chunk)
    }
}
