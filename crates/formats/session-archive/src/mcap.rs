//! MCAP bytes, without I/O: the same code serves the writer, the reader, recovery, the fuzzer
//! and the tests.
//!
//! The format is the one at <https://mcap.dev/spec>. We write it ourselves, and not through the
//! `mcap` crate, for three things that the crate does not offer: a chunk is one contiguous buffer
//! that reaches the disk in one write; recovery copies verified chunks byte for byte instead of
//! signing them again; and parsing never allocates what a header merely claims. The crate and the
//! official Python package read what we write in tests (`docs/decisions/0002-own-mcap-bytes.md`).

mod encode;
mod parse;

pub use encode::{ChunkBuilder, SegmentEncoder, sealed_chunk};
pub use parse::{
    Attachment, AttachmentIndex, Channel, Chunk, ChunkIndex, Footer, Header, Message, MessageIndex,
    Messages, Metadata, MetadataIndex, PackedChunk, ParseError, Record, RecordIter, SchemaRecord,
    Statistics, SummaryOffset,
};

/// First and last eight bytes of every file.
pub const MAGIC: [u8; 8] = [0x89, b'M', b'C', b'A', b'P', 0x30, b'\r', b'\n'];

/// Bytes of a record before its body: opcode and length.
pub const RECORD_HEADER: usize = 9;

/// Bytes of a chunk record before the records in it, when the chunk is not compressed.
pub const CHUNK_PREFIX: usize = RECORD_HEADER + 8 + 8 + 8 + 4 + 4 + 8;

/// Opcodes of the records.
pub mod op {
    #![allow(missing_docs)]
    pub const HEADER: u8 = 0x01;
    pub const FOOTER: u8 = 0x02;
    pub const SCHEMA: u8 = 0x03;
    pub const CHANNEL: u8 = 0x04;
    pub const MESSAGE: u8 = 0x05;
    pub const CHUNK: u8 = 0x06;
    pub const MESSAGE_INDEX: u8 = 0x07;
    pub const CHUNK_INDEX: u8 = 0x08;
    pub const ATTACHMENT: u8 = 0x09;
    pub const ATTACHMENT_INDEX: u8 = 0x0A;
    pub const STATISTICS: u8 = 0x0B;
    pub const METADATA: u8 = 0x0C;
    pub const METADATA_INDEX: u8 = 0x0D;
    pub const SUMMARY_OFFSET: u8 = 0x0E;
    pub const DATA_END: u8 = 0x0F;
}
