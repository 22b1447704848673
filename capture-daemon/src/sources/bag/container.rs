//! Access to foreign MCAP files: a scan of every message, and random access to any of them by its
//! location.
//!
//! Contract: [`Container::scan`] reads a file from its beginning, one record in memory at a time,
//! and needs no index or summary, so a truncated recording is read up to the cut. Chunks may be
//! compressed with zstd; a chunk with a wrong checksum is skipped and noted. *Sizes* in a file are
//! compared with its remaining length and with [`MAX_RECORD_BYTES`] before anything is allocated.
//! *Only plain files* are opened. *With [`Extent::Head`]* nothing behind the end of the head is
//! read, and a record that extends beyond it is ignored.

use std::collections::HashMap;
use std::fs::File;
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use session_archive::mcap::{
    Channel, MAGIC, Message, PackedChunk, ParseError, RECORD_HEADER, Record, RecordIter, op,
};

use super::error::BagError;
use crate::sources::{Extent, HEAD_BYTES};

/// Maximum size of a record, and of an unpacked chunk, bytes: twice an image of the maximum size.
const MAX_RECORD_BYTES: u64 = 512 << 20;

/// Maximum number of unpacked chunks kept: left and right images of one instant may be in different
/// ones.
const MAX_UNPACKED_CHUNKS: usize = 2;

/// Location of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RecordLocation {
    /// Beginning of the chunk, or of the message if it is in no chunk.
    record: u64,
    /// Beginning of the message's record in the unpacked chunk.
    inside: Option<usize>,
}

/// An open file.
pub(super) struct Container {
    path: PathBuf,
    file: File,
    /// Length of the part that is read.
    length: u64,
    /// Whether the file continues there.
    continues: bool,
    /// By the beginning of the chunk, the newest last.
    unpacked: Vec<(u64, Arc<Vec<u8>>)>,
}

/// Result of the scan, besides messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct ScanResult {
    /// Number of chunks with a wrong checksum or that cannot be unpacked.
    pub(super) damaged: u64,
    /// Byte at which the file ends or becomes invalid.
    pub(super) cut_at: Option<u64>,
    /// The part to be read ends before the file does.
    pub(super) is_head: bool,
}

/// A channel: its topic, the name of its schema, and the encoding of its messages.
#[derive(Clone, Debug)]
pub(super) struct Topic {
    pub(super) name: String,
    pub(super) schema: String,
    pub(super) encoding: String,
}

impl Container {
    pub(super) fn open(path: &Path, extent: Extent) -> Result<Self, BagError> {
        let read = |source| BagError::Read {
            path: path.to_owned(),
            source,
        };
        let file = plain_file::open(path).map_err(read)?;
        let whole = file.metadata().map_err(read)?.len();
        let length = match extent {
            Extent::Whole => whole,
            Extent::Head => whole.min(HEAD_BYTES),
        };
        let mut head = [0; 16];
        let known = length.min(head.len() as u64) as usize;
        file.read_exact_at(&mut head[..known], 0).map_err(read)?;
        check_magic(path, &head)?;
        Ok(Self {
            path: path.to_owned(),
            file,
            length,
            continues: length < whole,
            unpacked: Vec::new(),
        })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Calls `each` with every message, in the order of the file.
    pub(super) fn scan(
        &mut self,
        mut each: impl FnMut(&Topic, &Message<'_>, RecordLocation),
    ) -> Result<ScanResult, BagError> {
        let mut scanned = ScanResult::default();
        let mut schemas: HashMap<u16, String> = HashMap::new();
        let mut topics: HashMap<u16, Topic> = HashMap::new();
        let mut take = |record: Record<'_>, location: RecordLocation| match record {
            Record::Schema(schema) => {
                schemas.insert(schema.id, schema.name.to_owned());
            }
            Record::Channel(channel) => {
                topics.insert(channel.id, topic(&schemas, channel));
            }
            Record::Message(message) => {
                if let Some(topic) = topics.get(&message.channel_id) {
                    each(topic, &message, location);
                }
            }
            _ => {}
        };
        let mut at = MAGIC.len() as u64;
        loop {
            let (opcode, body) = match self.header(at) {
                Ok(Some(header)) => header,
                Ok(None) if self.continues => {
                    scanned.is_head = true;
                    return Ok(scanned);
                }
                Ok(None) => {
                    scanned.cut_at = Some(at);
                    return Ok(scanned);
                }
                Err(source) => return Err(self.failed(source)),
            };
            let after = at + RECORD_HEADER as u64 + body;
            match opcode {
                op::DATA_END | op::FOOTER => return Ok(scanned),
                op::CHUNK => match self.unpack(at, body)? {
                    Some(records) => {
                        let mut iter = RecordIter::new(&records);
                        loop {
                            let inside = Some(records.len() - iter.remaining());
                            match iter.next() {
                                Some(Ok(record)) => {
                                    take(record, RecordLocation { record: at, inside })
                                }
                                Some(Err(_)) => {
                                    scanned.damaged += 1;
                                    break;
                                }
                                None => break,
                            }
                        }
                    }
                    None => scanned.damaged += 1,
                },
                op::SCHEMA | op::CHANNEL | op::MESSAGE => {
                    let bytes = self.read(at + RECORD_HEADER as u64, body)?;
                    let record =
                        Record::parse(opcode, &bytes).map_err(|source| BagError::Damaged {
                            path: self.path.clone(),
                            at,
                            source,
                        })?;
                    let inside = None;
                    take(record, RecordLocation { record: at, inside });
                }
                _ => {}
            }
            at = after;
        }
    }

    /// The payload of the message at a location returned by the scan.
    pub(super) fn load(&mut self, location: RecordLocation) -> Result<Vec<u8>, BagError> {
        let damaged = |path: &Path, source| BagError::Damaged {
            path: path.to_owned(),
            at: location.record,
            source,
        };
        let changed = ParseError::Malformed {
            opcode: op::MESSAGE,
            what: "the file has changed since it was opened",
        };
        let header = self.header(location.record).map_err(|e| self.failed(e))?;
        let Some((opcode, body)) = header else {
            return Err(damaged(&self.path, changed));
        };
        let (records, from) = match location.inside {
            Some(inside) => match self.unpack(location.record, body)? {
                Some(records) => (records, inside),
                None => return Err(damaged(&self.path, changed)),
            },
            None => {
                let bytes = self.read(location.record + RECORD_HEADER as u64, body)?;
                return match Record::parse(opcode, &bytes) {
                    Ok(Record::Message(message)) => Ok(message.data.to_vec()),
                    Ok(_) => Err(damaged(&self.path, changed)),
                    Err(source) => Err(damaged(&self.path, source)),
                };
            }
        };
        match Record::split(records.get(from..).unwrap_or_default()) {
            Ok((Record::Message(message), _)) => Ok(message.data.to_vec()),
            Ok(_) => Err(damaged(&self.path, changed)),
            Err(source) => Err(damaged(&self.path, source)),
        }
    }

    /// Opcode and length of the record at `at`; `None` if the file ends before the record does, or
    /// the record claims to be larger than the maximum.
    fn header(&self, at: u64) -> Result<Option<(u8, u64)>, std::io::Error> {
        let mut header = [0; RECORD_HEADER];
        if at.saturating_add(RECORD_HEADER as u64) > self.length {
            return Ok(None);
        }
        self.file.read_exact_at(&mut header, at)?;
        let [opcode, length @ ..] = header;
        let length = u64::from_le_bytes(length);
        let end = at
            .saturating_add(RECORD_HEADER as u64)
            .saturating_add(length);
        Ok((end <= self.length).then_some((opcode, length)))
    }

    fn read(&self, at: u64, length: u64) -> Result<Vec<u8>, BagError> {
        if length > MAX_RECORD_BYTES {
            return Err(BagError::Damaged {
                path: self.path.clone(),
                at,
                source: ParseError::Malformed {
                    opcode: 0,
                    what: "the record is larger than 512 MiB",
                },
            });
        }
        let mut bytes = vec![0; length as usize];
        self.file
            .read_exact_at(&mut bytes, at)
            .map_err(|e| self.failed(e))?;
        Ok(bytes)
    }

    /// The records of the chunk at `at`; `None` if it is damaged.
    fn unpack(&mut self, at: u64, body: u64) -> Result<Option<Arc<Vec<u8>>>, BagError> {
        if let Some((_, records)) = self.unpacked.iter().find(|(location, _)| *location == at) {
            return Ok(Some(records.clone()));
        }
        let bytes = self.read(at + RECORD_HEADER as u64, body)?;
        let Ok(chunk) = PackedChunk::parse(&bytes) else {
            return Ok(None);
        };
        if chunk.uncompressed_size > MAX_RECORD_BYTES {
            return Ok(None);
        }
        let records = match chunk.compression {
            "" => chunk.records.to_vec(),
            "zstd" => {
                let size = chunk.uncompressed_size as usize;
                match zstd::bulk::decompress(chunk.records, size) {
                    Ok(records) => records,
                    Err(_) => return Ok(None),
                }
            }
            other => {
                return Err(BagError::Compression {
                    path: self.path.clone(),
                    compression: other.to_owned(),
                });
            }
        };
        let crc = chunk.uncompressed_crc;
        let is_whole = records.len() as u64 == chunk.uncompressed_size
            // Writers may omit the checksum.
            && (crc == 0 || crc == crc32fast::hash(&records));
        if !is_whole {
            return Ok(None);
        }
        let records = Arc::new(records);
        if self.unpacked.len() == MAX_UNPACKED_CHUNKS {
            self.unpacked.remove(0);
        }
        self.unpacked.push((at, records.clone()));
        Ok(Some(records))
    }

    fn failed(&self, source: std::io::Error) -> BagError {
        BagError::Read {
            path: self.path.clone(),
            source,
        }
    }
}

fn topic(schemas: &HashMap<u16, String>, channel: Channel) -> Topic {
    Topic {
        schema: schemas.get(&channel.schema_id).cloned().unwrap_or_default(),
        name: channel.topic,
        encoding: channel.message_encoding,
    }
}

/// Detects the file type by its first bytes, and names the conversion to MCAP.
fn check_magic(path: &Path, head: &[u8]) -> Result<(), BagError> {
    let (found, remedy) = if head.starts_with(&MAGIC) {
        return Ok(());
    } else if head.starts_with(b"SQLite format 3") {
        super::SQLITE
    } else if head.starts_with(b"#ROSBAG V2.0") {
        (
            "a bag of ROS 1",
            "convert it with `rosbags-convert --src IN.bag --dst OUT --dst-storage mcap`",
        )
    } else if head.starts_with(&[0x28, 0xb5, 0x2f, 0xfd]) {
        (
            "a file that is compressed as a whole",
            "unpack it with `zstd -d FILE`",
        )
    } else {
        (
            "a file of another kind",
            "see docs/reference/sources.md for what can be replayed",
        )
    };
    Err(BagError::Storage {
        path: path.to_owned(),
        found,
        remedy,
    })
}
