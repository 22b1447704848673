//! The log of all writes to a disk, as dm-log-writes keeps it, and the disks that a power cut may
//! leave.
//!
//! The kernel writes an entry once the write is *stable*: a plain write when a later flush has
//! ended, a forced one (FUA) when it has ended itself. So the entries in front of a place in the
//! log are a disk whose cache was lost there; and of the plain writes from there up to the next
//! flush, a real disk may hold any part, which is a *torn* cache. A mark is put in by a program and
//! stands behind everything that was stable when it was put in. Discarded sectors read as zeros
//! afterwards.
//!
//! Layout (Documentation/admin-guide/device-mapper/log-writes.rst and drivers/md/dm-log-writes.c of
//! Linux): one sector with magic, version, number of entries and sector size; then for each entry a
//! sector with its place, length, flags and length of its mark, which follows in the same sector,
//! and then its data. All little-endian.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt as _;
use std::path::Path;

use anyhow::{Context as _, Result, ensure};

use crate::image;
use crate::random::Random;

/// "jsfwrhj" of dm-log-writes.
const MAGIC: u64 = 0x006a_7366_7773_6872;
const VERSION: u64 = 1;
/// Bytes of an entry in front of its mark.
const ENTRY: usize = 32;
const FLUSH: u64 = 1;
const DISCARD: u64 = 4;
const MARK: u64 = 8;

/// What an entry did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Wrote the log's bytes from this offset on.
    Write(u64),
    /// Discarded.
    Discard,
    /// A program's mark.
    Mark(String),
}

/// One entry.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// First sector.
    pub sector: u64,
    /// How many.
    pub sectors: u64,
    /// Whether the disk's cache was flushed before it.
    pub flush: bool,
    /// What it did.
    pub action: Action,
}

/// A log, opened.
#[derive(Debug)]
pub struct WriteLog {
    file: File,
    sector_bytes: u64,
    entries: Vec<Entry>,
}

/// How a cache is torn.
#[derive(Clone, Copy, Debug)]
pub struct Torn {
    /// Decides which parts were written: each with probability one half.
    pub seed: u64,
    /// What the disk writes whole, bytes.
    pub grain: u64,
}

impl WriteLog {
    /// Reads what the log consists of.
    ///
    /// # Errors
    /// It cannot be read, or is not a log.
    pub fn open(path: &Path) -> Result<Self> {
        let reading = || format!("reading the log of writes {}", path.display());
        let file = File::open(path).with_context(reading)?;
        let mut head = [0; ENTRY];
        file.read_exact_at(&mut head, 0).with_context(reading)?;
        let (magic, version) = (word(&head, 0), word(&head, 1));
        ensure!(
            (magic, version) == (MAGIC, VERSION),
            "reading a log of writes: it begins with {magic:#x} and version {version}, expected {MAGIC:#x} and {VERSION}: {}",
            path.display()
        );
        let count = word(&head, 2);
        let sector_bytes = word(&head, 3) & 0xffff_ffff;
        ensure!(
            sector_bytes.is_power_of_two() && (512..=65536).contains(&sector_bytes),
            "reading a log of writes: its sectors have {sector_bytes} bytes, expected a power of two from 512: {}",
            path.display()
        );
        let mut entries = Vec::new();
        let mut at = sector_bytes;
        for _ in 0..count {
            let (entry, next) = entry(&file, at, sector_bytes).with_context(reading)?;
            entries.push(entry);
            at = next;
        }
        Ok(Self {
            file,
            sector_bytes,
            entries,
        })
    }

    /// Its entries.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Its marks with their places.
    pub fn marks(&self) -> impl Iterator<Item = (usize, &str)> {
        let entries = self.entries.iter().enumerate();
        entries.filter_map(|(i, entry)| match &entry.action {
            Action::Mark(text) => Some((i, text.as_str())),
            _ => None,
        })
    }

    /// Makes the disk as a cut in front of entry `at` leaves it; `base` is what it was when the log
    /// began.
    ///
    /// # Errors
    /// A file cannot be read or written.
    pub fn crash_image(
        &self,
        base: &Path,
        image: &Path,
        at: usize,
        torn: Option<Torn>,
    ) -> Result<()> {
        image::copy(base, image)?;
        let writing = || format!("making a disk after a power cut {}", image.display());
        let disk = File::options()
            .write(true)
            .open(image)
            .with_context(writing)?;
        let at = at.min(self.entries.len());
        for entry in &self.entries[..at] {
            self.replay(entry, &disk).with_context(writing)?;
        }
        if let Some(torn) = torn {
            let mut random = Random::new(torn.seed);
            let cached = self.entries[at..].iter().take_while(|entry| !entry.flush);
            for entry in cached {
                self.tear(entry, &disk, torn.grain, &mut random)
                    .with_context(writing)?;
            }
        }
        Ok(())
    }

    fn replay(&self, entry: &Entry, disk: &File) -> io::Result<()> {
        let length = entry.sectors * self.sector_bytes;
        let place = entry.sector * self.sector_bytes;
        match entry.action {
            Action::Write(from) => self.copy(from, disk, place, length),
            Action::Discard => zero(disk, place, length),
            Action::Mark(_) => Ok(()),
        }
    }

    /// Replays each grain of the disk with probability one half.
    fn tear(&self, entry: &Entry, disk: &File, grain: u64, random: &mut Random) -> io::Result<()> {
        let Action::Write(from) = entry.action else {
            return Ok(());
        };
        let place = entry.sector * self.sector_bytes;
        let end = place + entry.sectors * self.sector_bytes;
        let mut start = place;
        while start < end {
            let next = ((start / grain + 1) * grain).min(end);
            if random.next() & 1 == 1 {
                self.copy(from + (start - place), disk, start, next - start)?;
            }
            start = next;
        }
        Ok(())
    }

    fn copy(&self, from: u64, disk: &File, to: u64, length: u64) -> io::Result<()> {
        let mut bytes = vec![0; length as usize];
        self.file.read_exact_at(&mut bytes, from)?;
        disk.write_all_at(&bytes, to)
    }
}

fn zero(disk: &File, mut place: u64, length: u64) -> io::Result<()> {
    let zeros = [0; 1 << 16];
    let end = place + length;
    while place < end {
        let n = (end - place).min(zeros.len() as u64);
        disk.write_all_at(&zeros[..n as usize], place)?;
        place += n;
    }
    Ok(())
}

/// The entry at an offset, and the offset of the next.
fn entry(file: &File, at: u64, sector_bytes: u64) -> io::Result<(Entry, u64)> {
    let mut sector = vec![0; sector_bytes as usize];
    file.read_exact_at(&mut sector, at)?;
    let [place, sectors, flags, mark] = [0, 1, 2, 3].map(|i| word(&sector, i));
    let data = at + sector_bytes;
    let (action, next) = if flags & MARK != 0 {
        let end = (ENTRY as u64 + mark).min(sector_bytes) as usize;
        let text = String::from_utf8_lossy(&sector[ENTRY..end]);
        let text = text.trim_end_matches('\0').to_owned();
        (Action::Mark(text), data)
    } else if flags & DISCARD != 0 {
        (Action::Discard, data)
    } else {
        (Action::Write(data), data + sectors * sector_bytes)
    };
    let entry = Entry {
        sector: place,
        sectors,
        flush: flags & FLUSH != 0,
        action,
    };
    Ok((entry, next))
}

/// The little-endian word with this position.
fn word(bytes: &[u8], position: usize) -> u64 {
    let mut word = [0; 8];
    word.copy_from_slice(&bytes[8 * position..8 * position + 8]);
    u64::from_le_bytes(word)
}

#[cfg(test)]
mod tests;
