//! MCAP files that are no segment of a session: what they are, for messages.
//!
//! Contract: [`identify`] reads the header and the summary and nothing between them, allocates at
//! most what the file holds and 16 MiB, and takes any bytes. Nothing is checked but what is stated:
//! magic, header, and the summary's checksum.

use std::collections::BTreeMap;
use std::fmt;
use std::io;

use crate::mcap::{MAGIC, RECORD_HEADER, Record, RecordIter, op};
use crate::storage::ReadAt;

/// Channels that are listed by name.
const LISTED: usize = 6;
/// Longest header that is read.
const HEADER_LIMIT: u64 = 1 << 20;
/// Longest summary that is read.
const SUMMARY_LIMIT: u64 = 16 << 20;
/// Bytes of the footer record and the magic behind it.
const TAIL: u64 = RECORD_HEADER as u64 + 20 + MAGIC.len() as u64;

/// What an MCAP file says of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct McapFile {
    /// The profile of its header; may be empty.
    pub profile: String,
    /// The program that wrote it, by its header.
    pub library: String,
    /// Number of messages and the channels with their schemas, by topic; `None` if the file has no
    /// intact summary, as one that was cut off.
    pub summary: Option<McapSummary>,
}

/// What the summary of an MCAP file says.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct McapSummary {
    /// Number of messages; `None` without statistics.
    pub messages: Option<u64>,
    /// Topic and name of the schema of each channel, by topic.
    pub channels: Vec<(String, String)>,
}

/// What a file is if it begins as an MCAP file; `None` for any other.
///
/// ```
/// use session_archive::foreign::identify;
/// use session_archive::mcap::SegmentEncoder;
///
/// let (encoder, mut file) = SegmentEncoder::start("ros2", "rosbag2 0.26");
/// file.extend(encoder.finish());
/// let found = identify(&file)?.ok_or("no MCAP")?;
/// assert_eq!((&found.profile[..], &found.library[..]), ("ros2", "rosbag2 0.26"));
/// assert_eq!(identify(&b"something else, and long enough".to_vec())?, None);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The file system reports an I/O error.
pub fn identify(file: &dyn ReadAt) -> io::Result<Option<McapFile>> {
    let length = file.len()?;
    let head_at = MAGIC.len() as u64;
    let body_at = head_at + RECORD_HEADER as u64;
    if length < body_at {
        return Ok(None);
    }
    let start = read(file, 0, body_at)?;
    let size = start[head_at as usize + 1..].iter().rev();
    let size = size.fold(0_u64, |size, byte| (size << 8) | u64::from(*byte));
    let is_mcap = start.starts_with(&MAGIC) && start[head_at as usize] == op::HEADER;
    if !is_mcap || size > HEADER_LIMIT.min(length - body_at) {
        return Ok(None);
    }
    let body = read(file, body_at, size)?;
    let Ok(Record::Header(header)) = Record::parse(op::HEADER, &body) else {
        return Ok(None);
    };
    Ok(Some(McapFile {
        profile: header.profile,
        library: header.library,
        summary: summary(file, length)?,
    }))
}

fn summary(file: &dyn ReadAt, length: u64) -> io::Result<Option<McapSummary>> {
    if length < TAIL {
        return Ok(None);
    }
    let tail = read(file, length - TAIL, TAIL)?;
    let Ok((Record::Footer(footer), rest)) = Record::split(&tail) else {
        return Ok(None);
    };
    // The checksum covers the summary and the footer up to the checksum itself.
    let end = length - MAGIC.len() as u64 - 4;
    let size = end.checked_sub(footer.summary_start);
    let Some(size) = size.filter(|size| footer.summary_start > 0 && *size <= SUMMARY_LIMIT) else {
        return Ok(None);
    };
    let covered = read(file, footer.summary_start, size)?;
    if rest != MAGIC || ![0, crc32fast::hash(&covered)].contains(&footer.summary_crc) {
        return Ok(None);
    }
    let mut found = McapSummary::default();
    let mut schemas = BTreeMap::new();
    for record in RecordIter::new(&covered).map_while(Result::ok) {
        match record {
            Record::Schema(schema) => {
                schemas.insert(schema.id, schema.name.to_owned());
            }
            Record::Channel(channel) => {
                let schema = schemas.get(&channel.schema_id).cloned();
                found
                    .channels
                    .push((channel.topic, schema.unwrap_or_default()));
            }
            Record::Statistics(statistics) => found.messages = Some(statistics.message_count),
            _ => {}
        }
    }
    found.channels.sort();
    Ok(Some(found))
}

fn read(file: &dyn ReadAt, at: u64, n: u64) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; usize::try_from(n).map_err(io::Error::other)?];
    file.read_exact_at(&mut bytes, at)?;
    Ok(bytes)
}

impl fmt::Display for McapFile {
    /// Texts of the file are quoted, so that none of them controls a terminal.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "an MCAP file of the profile {:?}, written by {:?}",
            self.profile, self.library
        )?;
        let Some(summary) = &self.summary else {
            return f.write_str(", without an intact summary");
        };
        if let Some(messages) = summary.messages {
            let plural = if messages == 1 { "" } else { "s" };
            write!(f, ", {messages} message{plural}")?;
        }
        let count = summary.channels.len();
        write!(f, ", {count} channel{}", if count == 1 { "" } else { "s" })?;
        for (k, (topic, schema)) in summary.channels.iter().take(LISTED).enumerate() {
            let separator = if k == 0 { ":" } else { "," };
            write!(f, "{separator} {topic:?} of {schema:?}")?;
        }
        if count > LISTED {
            write!(f, " and {} more", count - LISTED)?;
        }
        Ok(())
    }
}
