//! Bytes per second and processor seconds per gigabyte, written and read.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Read};
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use mcap::read::{Options, RawMessageStream};
use mcap::records::MessageHeader;
use serde_json::{Value, json};
use session_archive::layout;
use session_archive::reader::{Entry, SessionReader};
use session_archive::record::Protobuf;
use session_archive::storage::DiskStorage;
use session_archive::verify::verify;
use session_archive::writer::{DEFAULT_CHUNK_NS, SessionWriter};

use super::Plan;
use crate::load::{self, Arrival, CAMERAS, CountingStorage, Destination};
use crate::meter::{Timing, median, timed};

/// One method of writing or reading.
pub(super) struct Rate {
    pub(super) name: &'static str,
    /// Bytes of access units, which is what counts.
    payload: u64,
    syncs: u64,
    runs: Vec<Timing>,
}

impl Rate {
    fn new(name: &'static str) -> Self {
        Self {
            name,
            payload: 0,
            syncs: 0,
            runs: Vec::new(),
        }
    }

    /// Bytes per second, the median of the runs.
    pub(super) fn bytes_per_s(&self) -> f64 {
        self.payload as f64 / median(self.runs.iter().map(|t| t.wall_s))
    }

    /// Processor seconds per 10^9 bytes, the median of the runs.
    pub(super) fn cpu_s_per_gb(&self) -> f64 {
        median(self.runs.iter().map(|t| t.cpu_s)) / self.payload as f64 * 1e9
    }

    fn json(&self) -> Value {
        let rate = |t: &Timing| self.payload as f64 / t.wall_s;
        json!({
            "name": self.name,
            "bytes_per_s": self.bytes_per_s(),
            "cpu_s_per_gb": self.cpu_s_per_gb(),
            "payload_bytes": self.payload,
            "syncs": self.syncs,
            "runs_bytes_per_s": self.runs.iter().map(rate).collect::<Vec<_>>(),
        })
    }
}

pub(super) struct Rates {
    pub(super) write: Vec<Rate>,
    pub(super) read: Vec<Rate>,
}

impl Rates {
    /// Our rate over the `mcap` crate's, both into the page cache.
    pub(super) fn write_ratio(&self) -> f64 {
        self.write[0].bytes_per_s() / self.write[1].bytes_per_s()
    }

    pub(super) fn json(&self) -> Value {
        let json = |rates: &[Rate]| rates.iter().map(Rate::json).collect::<Vec<_>>();
        json!({
            "write": json(&self.write),
            "read": json(&self.read),
            "write_ratio_to_mcap_crate": self.write_ratio(),
        })
    }
}

pub(super) fn measure(plan: &Plan, disk: &Path) -> Result<Rates> {
    let units = load::units(60_000, 100_000);
    let arrivals: Vec<Arrival> = load::arrivals(plan.write_s, DEFAULT_CHUNK_NS).collect();
    let mut write = [
        Rate::new("page cache"),
        Rate::new("mcap crate"),
        Rate::new("into nothing"),
        Rate::new("disk, synced"),
    ];
    let mut read = [
        Rate::new("entries"),
        Rate::new("verify"),
        Rate::new("mcap crate"),
    ];
    // Holds a segment for the crate, which takes its input as one slice: refilled, never
    // reallocated.
    let mut segment = Vec::new();
    for _ in 0..plan.repetitions {
        let modes = [
            Some(Destination::PageCache),
            None,
            Some(Destination::Nothing),
            Some(Destination::Disk),
        ];
        for (rate, mode) in write.iter_mut().zip(modes) {
            // Twice, and the first run does not count: a change in the sizes of the writes makes
            // the kernel find other pages, which on a virtual machine may cost more than the
            // writing.
            for warm in [false, true] {
                let folder = tempfile::tempdir_in(disk).context("making a folder to write to")?;
                let session = DiskStorage::new(folder.path().join("session"));
                match mode {
                    Some(to) => write_session(rate, session.clone(), to, &arrivals, &units)?,
                    None => write_mcap(rate, &folder.path().join("peer"), &arrivals, &units)?,
                }
                if !warm {
                    rate.runs.pop();
                }
                if mode == Some(Destination::PageCache) && warm {
                    read_all(&mut read, &session, rate, &mut segment)?;
                }
            }
        }
    }
    let rates = Rates {
        write: write.into(),
        read: read.into(),
    };
    for (kind, rates) in [("write", &rates.write), ("read", &rates.read)] {
        for r in rates {
            let (mb, cpu) = (r.bytes_per_s() / 1e6, r.cpu_s_per_gb());
            println!("{kind:6} {:24} {mb:8.0} MB/s {cpu:6.2} CPU s/GB", r.name);
        }
    }
    println!(
        "written at {:.2} times the mcap crate's rate",
        rates.write_ratio()
    );
    Ok(rates)
}

fn write_session(
    rate: &mut Rate,
    disk: DiskStorage,
    to: Destination,
    arrivals: &[Arrival],
    units: &[Vec<u8>],
) -> Result<()> {
    let (storage, counts) = CountingStorage::new(disk, to);
    let (payload, took) = timed(|| -> Result<u64> {
        let mut writer = SessionWriter::create(storage, load::spec(DEFAULT_CHUNK_NS))?;
        let mut payload = 0;
        for arrival in arrivals {
            payload += load::put(&mut writer, arrival, units)? as u64;
        }
        writer.close(load::stop(load::START))?;
        ensure!(writer.take_incidents().is_empty(), "the disk failed");
        Ok(payload)
    });
    rate.payload = payload?;
    rate.syncs = counts.syncs();
    rate.runs.push(took);
    Ok(())
}

/// The same payloads through the crate: access units as they are, small records as protobuf, chunks
/// of the size that ours have.
fn write_mcap(rate: &mut Rate, path: &Path, arrivals: &[Arrival], units: &[Vec<u8>]) -> Result<()> {
    let per_second = 30 * CAMERAS.len() as u64 * 80_000;
    let (payload, took) = timed(|| -> Result<u64> {
        let file = BufWriter::new(File::create(path)?);
        let mut writer = mcap::WriteOptions::new()
            .compression(None)
            .chunk_size(Some(per_second / 2))
            .create(file)?;
        let mut channels = Vec::new();
        for topic in 0..3 * CAMERAS.len() {
            channels.push(writer.add_channel(
                0,
                &topic.to_string(),
                "protobuf",
                &BTreeMap::new(),
            )?);
        }
        let mut payload = 0;
        for arrival in arrivals {
            let (of, time) = arrival.place();
            let header = |channel: usize, sequence: u64| MessageHeader {
                channel_id: channels[channel],
                sequence: sequence as u32,
                log_time: time.0 as u64,
                publish_time: time.0 as u64,
            };
            match *arrival {
                Arrival::Frame(camera, number, time, _) => {
                    let unit = &units[(number as usize * 3 + camera) % units.len()];
                    let record = load::frame(number, time).encode_to_vec();
                    writer.write_to_known_channel(&header(6 + camera, number), &record)?;
                    writer.write_to_known_channel(&header(of, number), unit)?;
                    payload += unit.len() as u64;
                }
                Arrival::Imu(_, first, time) => {
                    let record = load::batch(first, time).encode_to_vec();
                    writer.write_to_known_channel(&header(of, first), &record)?;
                }
            }
        }
        writer.finish()?;
        Ok(payload)
    });
    rate.payload = payload?;
    rate.runs.push(took);
    Ok(())
}

fn read_all(
    read: &mut [Rate; 3],
    disk: &DiskStorage,
    written: &Rate,
    segment: &mut Vec<u8>,
) -> Result<()> {
    let open = || SessionReader::open(Arc::new(disk.clone()));
    let (bytes, took) = timed(|| -> Result<u64> {
        let reader = open()?;
        let mut bytes = 0;
        for entry in reader.entries() {
            match entry? {
                Entry::Message(m) => bytes += m.data.len() as u64,
                Entry::SegmentEnd { .. } => {}
                other => anyhow::bail!("damaged: {other:?}"),
            }
        }
        Ok(bytes)
    });
    ensure!(bytes? > written.payload, "too few bytes read back");
    read[0].runs.push(took);
    let (sound, took) = timed(|| -> Result<bool> { Ok(verify(&open()?, |_| {})?.is_sound()) });
    ensure!(sound?, "not sound");
    read[1].runs.push(took);
    let numbers: Vec<u32> = open()?.segment_numbers().collect();
    // The first time the segment's memory has to be found; that run does not count.
    let mut peer = || {
        timed(|| -> Result<u64> {
            let mut bytes = 0;
            for &number in &numbers {
                segment.clear();
                File::open(disk.root().join(layout::segment(number)))?.read_to_end(segment)?;
                let checked = Options::ValidateChunkCrcs.into();
                for message in RawMessageStream::new_with_options(segment, checked)? {
                    bytes += message?.data.len() as u64;
                }
            }
            Ok(bytes)
        })
    };
    peer().0?;
    let (bytes, took) = peer();
    ensure!(
        bytes? > written.payload,
        "too few bytes read back by the crate"
    );
    read[2].runs.push(took);
    for rate in read {
        rate.payload = written.payload;
    }
    Ok(())
}
