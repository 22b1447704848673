//! Reading one segment from front to back, through damage.
//!
//! [`Scan`] yields verified chunks and what lies between them. It is total: on any bytes it ends,
//! yields only chunks whose checksum holds, and names every range it could not use. Behind damage
//! it looks for the next place where a chunk with a matching checksum starts. Memory is one
//! chunk, and never more than the file holds.

use std::collections::VecDeque;
use std::io;
use std::ops::Range;
use std::sync::Arc;

use bytes::Bytes;

use crate::mcap::{self, CHUNK_PREFIX, MAGIC, RECORD_HEADER, Record, op};
use crate::storage::ReadAt;
use crate::writer::MAX_CHUNK_BYTES;

/// A chunk may be this much larger than [`MAX_CHUNK_BYTES`]: the record that filled it, and its
/// framing.
pub(crate) const CHUNK_LIMIT: u64 = 2 * MAX_CHUNK_BYTES as u64 + 4096;
/// The header is small; a longer one is damage.
const RECORD_LIMIT: u64 = 1 << 20;
/// Bytes searched at a time for the next chunk.
const WINDOW: usize = 1 << 16;
/// A file whose last bytes are this many zeros was made longer and then not written; no record
/// ends so, because the time before an offset in a message index is not zero.
const TORN: u64 = 16;
/// Bytes of the footer record.
const FOOTER: u64 = RECORD_HEADER as u64 + 20;
/// A summary covers at most a minute, so it is small; a longer one is damage.
const SUMMARY_LIMIT: u64 = 16 << 20;

/// Why a range of a segment cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DamageKind {
    /// The file ends inside a record, or in zeros where a record should end: it was cut off while
    /// being written.
    CutOff,
    /// A chunk whose content does not match its checksum.
    Checksum,
    /// Bytes that are no record of this profile.
    NoRecord,
    /// The file does not begin with MCAP's magic bytes.
    Magic,
    /// A chunk whose header contradicts its (verified) content; the content was used.
    Header,
    /// The checksum over all of the file before the summary does not match.
    DataChecksum,
    /// The summary or the footer is damaged; it is not needed.
    Summary,
    /// The file is whole, but not as long as the manifest says: it is another one.
    Length,
    /// The head names another session or another number, or the number is far beyond the others'.
    /// It is not used.
    Foreign,
    /// A message that no recorder can have written, although its chunk's checksum holds: on a
    /// channel that the session does not have, with a negative log time, or with a log time that
    /// is not that of its frame or sample. It is not used, and neither is the other half of a
    /// frame.
    Impossible,
}

/// A range of bytes of a segment that cannot be used, and why.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Damage {
    /// Bytes of the file.
    pub bytes: Range<u64>,
    /// Why.
    pub kind: DamageKind,
}

/// A chunk whose checksum holds.
#[derive(Clone, Debug)]
pub struct VerifiedChunk {
    /// Where its record starts in the file.
    pub offset: u64,
    /// Length of its record; its message indexes follow.
    pub length: u64,
    /// The records in it.
    pub records: Bytes,
}

impl VerifiedChunk {
    /// The messages in it, in the order written.
    pub fn messages(&self) -> mcap::Messages<'_> {
        self.view().messages()
    }

    /// The records in it, in the order written.
    pub fn iter(&self) -> mcap::RecordIter<'_> {
        self.view().iter()
    }

    fn view(&self) -> mcap::Chunk<'_> {
        mcap::Chunk {
            message_start_time: 0,
            message_end_time: 0,
            uncompressed_size: self.records.len() as u64,
            uncompressed_crc: 0,
            records: &self.records,
        }
    }
}

/// An item of a scan.
#[derive(Clone, Debug)]
pub enum Item {
    /// A chunk whose checksum holds.
    Chunk(VerifiedChunk),
    /// Bytes that cannot be used.
    Damage(Damage),
}

/// How a segment ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// With its summary, all checksums right.
    Clean,
    /// Without a summary: the recorder was cut off, or gave the segment up.
    Open,
}

/// Scans one segment. Ends after the last byte that counts.
///
/// ```
/// use std::sync::Arc;
///
/// use session_archive::scan::{DamageKind, End, Item, Scan};
///
/// # let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/v1/segments/000000.mcap");
/// let mut bytes = std::fs::read(path)?;
/// bytes.truncate(bytes.len() / 2); // as a power cut leaves it
///
/// let mut scan = Scan::new(Arc::new(bytes), None, 0)?;
/// let (mut chunks, mut damage) = (0, Vec::new());
/// while let Some(item) = scan.next_item()? {
///     match item {
///         Item::Chunk(_) => chunks += 1,
///         Item::Damage(found) => damage.push(found.kind),
///     }
/// }
/// assert!(chunks >= 1);
/// assert_eq!(damage, [DamageKind::CutOff]);
/// assert_eq!(scan.end(), Some(End::Open));
/// # Ok::<(), std::io::Error>(())
/// ```
pub struct Scan {
    file: Arc<dyn ReadAt>,
    limit: u64,
    /// Bytes that should be there by what the recorder noted.
    expected: u64,
    position: u64,
    /// Over everything so far; none once a range was skipped and it cannot match any more.
    data_crc: Option<crc32fast::Hasher>,
    pending: VecDeque<Item>,
    end: Option<End>,
    /// Bytes that the search for chunks may still checksum: each byte a few times at most, so
    /// that crafted headers cannot make the search quadratic.
    search_budget: u64,
    /// What [`Self::footer`] found, once it has looked.
    footer: Option<Option<u64>>,
}

impl Scan {
    /// Scans the first `limit` bytes of `file` (all of it, without a limit). If it is shorter
    /// than `expected`, the rest is reported as cut off.
    ///
    /// # Errors
    /// The file system reports an I/O error.
    pub fn new(file: Arc<dyn ReadAt>, limit: Option<u64>, expected: u64) -> io::Result<Self> {
        let len = file.len()?;
        let limit = limit.map_or(len, |l| l.min(len));
        Ok(Self {
            file,
            limit,
            expected,
            position: 0,
            data_crc: Some(crc32fast::Hasher::new()),
            pending: VecDeque::new(),
            end: None,
            search_budget: limit.saturating_mul(4).saturating_add(WINDOW as u64),
            footer: None,
        })
    }

    /// How the segment ended; known once the scan has.
    pub fn end(&self) -> Option<End> {
        self.end
    }

    /// Where the scan is, bytes.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// The next item; none at the end.
    ///
    /// # Errors
    /// The file system reports an I/O error. What the file holds is never an error.
    pub fn next_item(&mut self) -> io::Result<Option<Item>> {
        if self.position == 0 && self.limit > 0 {
            self.magic()?;
        }
        loop {
            if let Some(item) = self.pending.pop_front() {
                return Ok(Some(item));
            }
            if self.end.is_some() {
                return Ok(None);
            }
            self.step()?;
        }
    }

    /// Consumes one record, or one damaged range: queues what it gives.
    fn step(&mut self) -> io::Result<()> {
        let at = self.position;
        let left = self.limit - at;
        if left == 0 {
            self.end = Some(End::Open);
            if self.limit < self.expected {
                self.report(self.limit..self.expected, DamageKind::CutOff);
            }
            return Ok(());
        }
        if left < RECORD_HEADER as u64 {
            return self.skip(at, DamageKind::CutOff);
        }
        let mut head = [0; RECORD_HEADER];
        self.file.read_exact_at(&mut head, at)?;
        let (opcode, length) = (head[0], le_u64(&head[1..]));
        if !belongs(opcode, length, at) {
            return self.skip(at, DamageKind::NoRecord);
        }
        let whole = length + RECORD_HEADER as u64;
        if whole > left {
            return self.skip(at, DamageKind::CutOff);
        }
        let bytes = self.read(at, whole)?;
        match Record::split(&bytes) {
            Ok((Record::Chunk(chunk), _)) => {
                if !chunk.verify() {
                    return self.skip_chunk(at, whole);
                }
                let Some(bounds) = bounds(&chunk) else {
                    return self.skip(at, DamageKind::NoRecord);
                };
                if (chunk.message_start_time, chunk.message_end_time) != bounds {
                    self.report(at..at + whole, DamageKind::Header);
                }
                self.count(&bytes);
                let records = bytes.slice(CHUNK_PREFIX..);
                let chunk = VerifiedChunk {
                    offset: at,
                    length: whole,
                    records,
                };
                self.pending.push_back(Item::Chunk(chunk));
                self.position = at + whole;
                Ok(())
            }
            Ok((Record::DataEnd { data_section_crc }, _)) => self.finish(at, data_section_crc),
            Ok((Record::MessageIndex(index), _))
                if 6 + 16 * index.records.len() as u64 != length =>
            {
                self.skip(at, DamageKind::NoRecord)
            }
            Ok((Record::Header(_) | Record::MessageIndex(_), _)) => {
                self.count(&bytes);
                self.position = at + whole;
                Ok(())
            }
            _ => self.skip(at, DamageKind::NoRecord),
        }
    }

    fn magic(&mut self) -> io::Result<()> {
        let n = self.limit.min(MAGIC.len() as u64);
        let bytes = self.read(0, n)?;
        if bytes[..] == MAGIC {
            self.count(&bytes);
            self.position = n;
            return Ok(());
        }
        if MAGIC.starts_with(&bytes) {
            self.report(0..n, DamageKind::CutOff);
            self.position = n;
            return Ok(());
        }
        self.report(0..n, DamageKind::Magic);
        self.data_crc = None;
        self.position = n;
        Ok(())
    }

    /// The end of the data section: checks what can be checked of the whole file.
    fn finish(&mut self, at: u64, stored: u32) -> io::Result<()> {
        let summary_at = at + (RECORD_HEADER + 4) as u64;
        let intact = self.data_crc.take().map(crc32fast::Hasher::finalize);
        if intact.is_some_and(|crc| crc != stored) {
            self.report(0..summary_at, DamageKind::DataChecksum);
        }
        let clean = match self.footer()? {
            Some(start) => start == summary_at,
            None => false,
        };
        if !clean {
            let kind = match self.is_cut(summary_at)? {
                true => DamageKind::CutOff,
                false => DamageKind::Summary,
            };
            self.report(summary_at..self.limit, kind);
        }
        self.position = self.limit;
        self.end = Some(if clean { End::Clean } else { End::Open });
        Ok(())
    }

    /// Whether a summary that begins at `at` ends before its last byte.
    fn is_cut(&self, mut at: u64) -> io::Result<bool> {
        if self.limit - at > SUMMARY_LIMIT {
            return Ok(false);
        }
        let mut head = [0; RECORD_HEADER];
        while self.limit - at >= RECORD_HEADER as u64 {
            self.file.read_exact_at(&mut head, at)?;
            let end = le_u64(&head[1..]).saturating_add(at + RECORD_HEADER as u64);
            if head[0] == op::FOOTER && end.saturating_add(MAGIC.len() as u64) <= self.limit {
                return Ok(false);
            }
            if end > self.limit || head[0] == 0 {
                return Ok(true);
            }
            at = end;
        }
        Ok(true)
    }

    /// Start of the summary by the footer, if footer and summary are as they were written.
    fn footer(&mut self) -> io::Result<Option<u64>> {
        if let Some(known) = self.footer {
            return Ok(known);
        }
        let found = self.find_footer()?;
        self.footer = Some(found);
        Ok(found)
    }

    fn find_footer(&self) -> io::Result<Option<u64>> {
        let tail = FOOTER + MAGIC.len() as u64;
        if self.limit < tail {
            return Ok(None);
        }
        let bytes = self.read(self.limit - tail, tail)?;
        let Ok((Record::Footer(footer), rest)) = Record::split(&bytes) else {
            return Ok(None);
        };
        let summary = footer.summary_start..self.limit - MAGIC.len() as u64 - 4;
        if rest != MAGIC
            || summary.start > summary.end
            || summary.end - summary.start > SUMMARY_LIMIT
        {
            return Ok(None);
        }
        let covered = self.read(summary.start, summary.end - summary.start)?;
        let matches = crc32fast::hash(&covered) == footer.summary_crc;
        Ok(matches.then_some(footer.summary_start))
    }

    /// A chunk does not match its checksum. Its length is used if a record follows it.
    fn skip_chunk(&mut self, at: u64, whole: u64) -> io::Result<()> {
        let after = at + whole;
        let left = self.limit - after;
        let mut head = [0; RECORD_HEADER];
        let framed = left >= RECORD_HEADER as u64 && {
            self.file.read_exact_at(&mut head, after)?;
            let length = le_u64(&head[1..]);
            belongs(head[0], length, after) && length <= left - RECORD_HEADER as u64
        };
        if !framed {
            return self.skip(at, DamageKind::Checksum);
        }
        self.report(at..after, DamageKind::Checksum);
        self.data_crc = None;
        self.position = after;
        Ok(())
    }

    /// Nothing readable at `at`: goes on where the next chunk with a matching checksum starts, or
    /// at the data end, or ends.
    fn skip(&mut self, at: u64, kind: DamageKind) -> io::Result<()> {
        self.data_crc = None;
        let data_end = self
            .footer()?
            .map(|s| s.saturating_sub((RECORD_HEADER + 4) as u64));
        let until = data_end.filter(|d| *d > at).unwrap_or(self.limit);
        let next = self.find_chunk(at + 1, until)?.unwrap_or(until);
        // Only what reaches the end was cut off; a length that points beyond it from the middle
        // of the file is a wrong length.
        let kind = match kind {
            DamageKind::CutOff if next < self.limit => DamageKind::NoRecord,
            _ if next == self.limit && self.ends_in_zeros(at)? => DamageKind::CutOff,
            kind => kind,
        };
        self.report(at..next, kind);
        self.position = next;
        Ok(())
    }

    /// Whether what begins at `at` was written in part: the file's length reached the disk before
    /// its content did.
    fn ends_in_zeros(&self, at: u64) -> io::Result<bool> {
        let from = self.limit.saturating_sub(TORN);
        Ok(from >= at && self.read(from, TORN)?.iter().all(|b| *b == 0))
    }

    /// The first place in `from..until` where a chunk with a matching checksum starts.
    fn find_chunk(&mut self, mut from: u64, until: u64) -> io::Result<Option<u64>> {
        while from + (CHUNK_PREFIX as u64) <= until {
            let n = (until - from).min(WINDOW as u64);
            let window = self.read(from, n)?;
            let starts = window.len() - (CHUNK_PREFIX - 1);
            for i in memchr(op::CHUNK, &window[..starts]) {
                let at = from + i as u64;
                if let Some(whole) = plausible_chunk(&window[i..], until - at)
                    && self.search_budget >= whole
                {
                    self.search_budget -= whole;
                    let bytes = self.read(at, whole)?;
                    if let Ok((Record::Chunk(chunk), _)) = Record::split(&bytes)
                        && chunk.verify()
                    {
                        return Ok(Some(at));
                    }
                }
            }
            from += starts as u64;
        }
        Ok(None)
    }

    fn report(&mut self, bytes: Range<u64>, kind: DamageKind) {
        self.pending.push_back(Item::Damage(Damage { bytes, kind }));
    }

    fn count(&mut self, bytes: &[u8]) {
        if let Some(crc) = &mut self.data_crc {
            crc.update(bytes);
        }
    }

    /// Reads a range that lies within the file.
    fn read(&self, at: u64, n: u64) -> io::Result<Bytes> {
        let mut bytes = vec![0; usize::try_from(n).map_err(io::Error::other)?];
        self.file.read_exact_at(&mut bytes, at)?;
        Ok(bytes.into())
    }
}

/// Whether a record of the data section can have this opcode and length at this place. Strict,
/// so that a chunk with a damaged opcode is not taken for a record that may be passed over.
fn belongs(opcode: u8, length: u64, at: u64) -> bool {
    match opcode {
        op::CHUNK => length >= (CHUNK_PREFIX - RECORD_HEADER) as u64 && length <= CHUNK_LIMIT,
        op::MESSAGE_INDEX => length % 16 == 6 && length <= CHUNK_LIMIT,
        op::HEADER => at == MAGIC.len() as u64 && length <= RECORD_LIMIT,
        op::DATA_END => length == 4,
        _ => false,
    }
}

/// Length of the chunk record at the start of `bytes` (at least a prefix long), if its sizes agree
/// with each other and fit into `left` bytes.
fn plausible_chunk(bytes: &[u8], left: u64) -> Option<u64> {
    let length = le_u64(&bytes[1..9]);
    let size = le_u64(&bytes[25..33]);
    let whole = length.checked_add(RECORD_HEADER as u64)?;
    let agree = bytes[0] == op::CHUNK
        && le_u64(&bytes[41..49]) == size
        && bytes[37..41] == [0; 4]
        && size.checked_add((CHUNK_PREFIX - RECORD_HEADER) as u64) == Some(length);
    (agree && size > 0 && length <= CHUNK_LIMIT && whole <= left).then_some(whole)
}

/// Earliest and latest log time of the messages in a chunk, zeros if there are none; nothing if
/// its content is no sequence of records, which no writer of this format leaves behind.
fn bounds(chunk: &mcap::Chunk<'_>) -> Option<(u64, u64)> {
    let mut bounds = None;
    for message in chunk.messages() {
        let t = message.ok()?.log_time;
        bounds = Some(bounds.map_or((t, t), |(a, b): (u64, u64)| (a.min(t), b.max(t))));
    }
    Some(bounds.unwrap_or((0, 0)))
}

/// Positions of `byte` in `bytes`.
fn memchr(byte: u8, bytes: &[u8]) -> impl Iterator<Item = usize> {
    bytes
        .iter()
        .enumerate()
        .filter(move |(_, b)| **b == byte)
        .map(|(i, _)| i)
}

fn le_u64(b: &[u8]) -> u64 {
    let mut a = [0; 8];
    a.copy_from_slice(b);
    u64::from_le_bytes(a)
}
