//! What a power cut takes, against the chunk length, and what chunks cost.

use std::sync::Arc;

use anyhow::Result;
use serde_json::{Value, json};
use session_archive::reader::{Entry, SessionReader};
use session_archive::storage::{CrashKind, DiskStorage, FaultStorage};
use session_archive::time::HostTime;
use session_archive::writer::SessionWriter;

use super::Plan;
use crate::load::{self, Arrival, BATCH_NS, CAMERAS, CountingStorage, Destination};
use crate::meter::quantile;

/// Chunk lengths, ms.
const CHUNKS_MS: [i64; 8] = [100, 200, 300, 400, 500, 600, 800, 1000];
/// Streams that are numbered: three cameras, three IMUs.
const STREAMS: usize = 2 * CAMERAS.len();

/// What cuts took with one chunk length.
pub(super) struct Loss {
    pub(super) chunk_s: f64,
    /// From the last frame on disk to the last one that had arrived, per cut and camera, s.
    pub(super) median_s: f64,
    p99_s: f64,
    pub(super) max_s: f64,
    /// The same of the IMUs, the samples that wait for their batch included.
    pub(super) imu_max_s: f64,
    /// Bytes on disk beyond the access units, as a share of them, at 60 to 100 kB per unit.
    pub(super) overhead: f64,
    syncs_per_s: f64,
}

impl Loss {
    pub(super) fn json(&self) -> Value {
        json!({
            "chunk_s": self.chunk_s,
            "camera_lost_s": {
                "median": self.median_s, "p99": self.p99_s, "max": self.max_s,
            },
            "imu_lost_s": { "max": self.imu_max_s },
            "overhead": self.overhead,
            "syncs_per_s": self.syncs_per_s,
        })
    }
}

pub(super) fn measure(plan: &Plan) -> Result<Vec<Loss>> {
    let small = load::units(50, 90);
    let large = load::units(60_000, 100_000);
    let mut losses = Vec::new();
    for chunk_ms in CHUNKS_MS {
        let chunk_ns = chunk_ms * 1_000_000;
        let arrivals: Vec<Arrival> = load::arrivals(plan.loss_s, chunk_ns).collect();
        let (cameras, imus) = cut(&arrivals, chunk_ns, plan.cuts, &small)?;
        let (overhead, syncs) = cost(&arrivals, chunk_ns, &large)?;
        let loss = Loss {
            chunk_s: chunk_ns as f64 / 1e9,
            median_s: quantile(&cameras, 0.5),
            p99_s: quantile(&cameras, 0.99),
            max_s: quantile(&cameras, 1.0),
            imu_max_s: quantile(&imus, 1.0),
            overhead,
            syncs_per_s: syncs as f64 / plan.loss_s,
        };
        println!(
            "chunk {:.1} s: cameras lose {:.3} s (median), {:.3} s (most); {:.2} % more bytes",
            loss.chunk_s,
            loss.median_s,
            loss.max_s,
            100.0 * loss.overhead
        );
        losses.push(loss);
    }
    Ok(losses)
}

/// Cuts the power at instants spread at random over the recording; the spans lost by cameras and
/// by IMUs, ascending.
fn cut(
    arrivals: &[Arrival],
    chunk_ns: i64,
    cuts: usize,
    units: &[Vec<u8>],
) -> Result<(Vec<f64>, Vec<f64>)> {
    let disk = FaultStorage::new();
    let mut writer = SessionWriter::create(Arc::new(disk.clone()), load::spec(chunk_ns))?;
    // Once every stream has something on disk. Multiples of the golden ratio: as even as can be,
    // and in step with nothing.
    let settled = |a: &Arrival| a.place().1 > load::START + 2_000_000_000;
    let warm = arrivals.iter().position(settled).unwrap_or(0);
    let mut instants: Vec<usize> = (0..cuts)
        .map(|i| (i as f64 * 0.618_033_988_749_895).fract())
        .map(|f| warm + (f * (arrivals.len() - warm) as f64) as usize)
        .collect();
    instants.sort_unstable();
    let mut instants = instants.into_iter().peekable();
    let mut arrived = [load::START; STREAMS];
    let mut now = load::START;
    let (mut cameras, mut imus) = (Vec::new(), Vec::new());
    for (i, arrival) in arrivals.iter().enumerate() {
        load::put(&mut writer, arrival, units)?;
        let (stream, time) = arrival.place();
        arrived[stream] = time;
        now = now.max(time);
        while instants.next_if(|at| *at <= i).is_some() {
            let held = held(&disk.crash(CrashKind::UnsyncedDropped))?;
            for (stream, (arrived, held)) in arrived.iter().zip(held).enumerate() {
                if stream < CAMERAS.len() {
                    cameras.push((*arrived - held) as f64 / 1e9);
                } else {
                    // Samples arrive all the time and wait here until their batch is full.
                    imus.push((now - held - BATCH_NS).max(0) as f64 / 1e9);
                }
            }
        }
    }
    cameras.sort_by(f64::total_cmp);
    imus.sort_by(f64::total_cmp);
    Ok((cameras, imus))
}

/// Log time of the last message of every numbered stream on a disk; an IMU's is that of the first
/// sample of a batch.
fn held(disk: &FaultStorage) -> Result<[HostTime; STREAMS]> {
    let reader = SessionReader::open(Arc::new(disk.clone()))?;
    let mut newest = [load::START; STREAMS];
    for entry in reader.entries() {
        let Entry::Message(m) = entry? else { continue };
        let Some(stream) = reader.stream(m.stream) else {
            continue;
        };
        let camera = CAMERAS
            .iter()
            .position(|c| stream.topic == format!("/{c}/frames"));
        let imu = CAMERAS
            .iter()
            .position(|c| stream.topic == format!("/{c}/imu/samples"));
        if let Some(at) = camera.or(imu.map(|i| i + CAMERAS.len())) {
            newest[at] = newest[at].max(m.time);
        }
    }
    Ok(newest)
}

/// Bytes beyond the access units as a share of them, and syncs.
fn cost(arrivals: &[Arrival], chunk_ns: i64, units: &[Vec<u8>]) -> Result<(f64, u64)> {
    let folder = tempfile::tempdir()?;
    let (storage, counts) =
        CountingStorage::new(DiskStorage::new(folder.path()), Destination::Nothing);
    let mut writer = SessionWriter::create(storage, load::spec(chunk_ns))?;
    let mut payload = 0;
    for arrival in arrivals {
        payload += load::put(&mut writer, arrival, units)? as u64;
    }
    writer.close(load::stop(load::START))?;
    Ok((counts.bytes() as f64 / payload as f64 - 1.0, counts.syncs()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_that_wait_for_their_batch_are_lost_too() {
        const CHUNK_NS: i64 = 500_000_000;
        let arrivals: Vec<Arrival> = load::arrivals(6.0, CHUNK_NS).collect();
        let (cameras, imus) = cut(&arrivals, CHUNK_NS, 300, &load::units(50, 90)).unwrap();
        // A chunk, which closes with the next key frame; whole batches alone would be 0.5 s.
        let most = [&cameras, &imus].map(|lost| quantile(lost, 1.0));
        assert!(most.iter().all(|m| (0.52..0.55).contains(m)), "{most:?}");
    }
}
