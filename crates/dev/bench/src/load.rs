//! A generated recording: three stereo cameras at 30 Hz (two triggered together, one free) with an
//! IMU each, in virtual time; and the storages that it is written to.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use session_archive::manifest::{Camera, Imu, Stop};
use session_archive::record::{Frame, ImuBatch};
use session_archive::storage::{DiskStorage, ReadAt, Storage, WriteFile};
use session_archive::time::{CivilTime, HostTime, NS_PER_S, TickLength};
use session_archive::writer::{SessionSpec, SessionWriter, WriteError};

pub(crate) const CAMERAS: [&str; 3] = ["left_shoulder", "right_shoulder", "feet"];
/// Frame period, and phases of the cameras, ns.
const PERIOD: i64 = 33_333_333;
const PHASES: [i64; 3] = [0, 0, 11_000_000];
/// IMU samples per batch of a tenth of a second.
const BATCH: i64 = 40;
pub(crate) const BATCH_NS: i64 = 100_000_000;

/// When the recording begins.
pub(crate) const START: HostTime = HostTime(1_000_000_000_000);

pub(crate) fn spec(chunk_ns: i64) -> SessionSpec {
    let camera = |name: &str| Camera {
        name: name.to_owned(),
        width: 2560,
        height: 720,
        codec: "h264".to_owned(),
        colour: "yuv420".to_owned(),
        rate_hz: 30.0,
        tick: TickLength::NANOSECOND,
        trigger: None,
        source: "made up".to_owned(),
        encoder: "none".to_owned(),
    };
    let imu = |name: &str| Imu {
        name: format!("{name}/imu"),
        rate_hz: 400.0,
        tick: TickLength::ZED_MINI,
        source: "made up".to_owned(),
        noise: None,
    };
    SessionSpec {
        session_id: "0192aa00-0000-7000-8000-0000000000be".to_owned(),
        name: "benchmark".to_owned(),
        software: "bench".to_owned(),
        started: START,
        // A library files sessions by date.
        started_civil: CivilTime(1_790_000_000 * NS_PER_S),
        chunk_ns,
        cameras: CAMERAS.iter().map(|n| camera(n)).collect(),
        imus: CAMERAS.iter().map(|n| imu(n)).collect(),
        rig: Vec::new(),
    }
}

/// One thing that arrives.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Arrival {
    /// Camera, number, time of the frame, whether it is a key frame.
    Frame(usize, u64, HostTime, bool),
    /// IMU, number of the first sample, time of the first sample.
    Imu(usize, u64, HostTime),
}

impl Arrival {
    /// The stream and the log time.
    pub(crate) fn place(&self) -> (usize, HostTime) {
        match *self {
            Self::Frame(camera, _, time, _) => (camera, time),
            Self::Imu(imu, _, time) => (CAMERAS.len() + imu, time),
        }
    }
}

/// Everything that arrives within `seconds`, in order; key frames at chunk boundaries.
pub(crate) fn arrivals(seconds: f64, chunk_ns: i64) -> impl Iterator<Item = Arrival> {
    let end = (seconds * 1e9) as i64;
    let mut epochs = [i64::MIN; 3];
    (0..)
        .map_while(move |n| {
            let t = n * PERIOD;
            (t < end).then(|| {
                let mut now = Vec::new();
                for imu in 0..CAMERAS.len() {
                    // The batches that were complete by now and not before.
                    let (from, to) = ((t - PERIOD).div_euclid(BATCH_NS), t.div_euclid(BATCH_NS));
                    for batch in (from..to).filter(|b| *b >= 0) {
                        let first = (batch * BATCH) as u64;
                        now.push(Arrival::Imu(imu, first, START + batch * BATCH_NS));
                    }
                }
                for (camera, epoch) in epochs.iter_mut().enumerate() {
                    let time = START + t + PHASES[camera];
                    let this = time.0.div_euclid(chunk_ns);
                    now.push(Arrival::Frame(camera, n as u64, time, this != *epoch));
                    *epoch = this;
                }
                now
            })
        })
        .flatten()
}

/// Access units to choose from: incompressible bytes.
pub(crate) fn units(from: usize, to: usize) -> Vec<Vec<u8>> {
    let mut noise = Noise::new();
    (0..61)
        .map(|_| {
            let bytes = from + noise.next() as usize % (to - from + 1);
            noise.bytes(bytes)
        })
        .collect()
}

/// Xorshift (Marsaglia 2003), always from the same seed.
pub(crate) struct Noise(u64);

impl Noise {
    pub(crate) fn new() -> Self {
        Self(0x9E37_79B9_7F4A_7C15)
    }

    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    pub(crate) fn bytes(&mut self, count: usize) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(count + 8);
        while bytes.len() < count {
            bytes.extend(self.next().to_le_bytes());
        }
        bytes.truncate(count);
        bytes
    }
}

pub(crate) fn frame(number: u64, time: HostTime) -> Frame {
    Frame {
        number,
        device_ticks: time.0,
        host_time: time.0 + 20_000_000,
        time: time.0,
        sigma_ns: 50_000,
        exposure_ns: Some(8_000_000),
        clock_map: 1,
        ..Frame::default()
    }
}

pub(crate) fn batch(first: u64, time: HostTime) -> ImuBatch {
    let step = BATCH_NS / BATCH;
    let times: Vec<i64> = (0..BATCH).map(|k| time.0 + k * step).collect();
    ImuBatch {
        first_number: first,
        device_ticks: times.iter().map(|t| t / 39_063).collect(),
        host_times: times.iter().map(|t| t + 1_000_000).collect(),
        times,
        sigma_ns: 20_000,
        clock_map: 1,
        gyro_counts: (0..3 * BATCH)
            .map(|k| (k * 37 % 401) as i32 - 200)
            .collect(),
        gyro_scale: 5.3e-4,
        accel_counts: (0..3 * BATCH)
            .map(|k| (k * 53 % 801) as i32 - 400)
            .collect(),
        accel_scale: 2.4e-3,
        ..ImuBatch::default()
    }
}

/// Hands one arrival to the writer; returns the bytes of its access unit.
pub(crate) fn put(
    writer: &mut SessionWriter,
    arrival: &Arrival,
    units: &[Vec<u8>],
) -> Result<usize, WriteError> {
    match *arrival {
        Arrival::Frame(camera, number, time, key) => {
            let unit = &units[(number as usize * 3 + camera) % units.len()];
            writer.append_frame(CAMERAS[camera], frame(number, time), unit, key)?;
            Ok(unit.len())
        }
        Arrival::Imu(imu, first, time) => {
            let of = format!("{}/imu", CAMERAS[imu]);
            writer.append(&of, time, time + BATCH_NS, &batch(first, time))?;
            Ok(0)
        }
    }
}

pub(crate) fn stop(at: HostTime) -> Stop {
    Stop {
        at,
        reason: "benchmark".to_owned(),
    }
}

/// Destination of written bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Destination {
    /// Written and synced.
    Disk,
    /// Written; syncs are counted and left out.
    PageCache,
    /// Counted and forgotten.
    Nothing,
}

/// A folder that counts bytes and syncs.
pub(crate) struct CountingStorage {
    disk: DiskStorage,
    to: Destination,
    counts: Arc<Counts>,
}

#[derive(Default)]
pub(crate) struct Counts {
    bytes: AtomicU64,
    syncs: AtomicU64,
}

impl Counts {
    pub(crate) fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    pub(crate) fn syncs(&self) -> u64 {
        self.syncs.load(Ordering::Relaxed)
    }
}

impl CountingStorage {
    pub(crate) fn new(disk: DiskStorage, to: Destination) -> (Arc<Self>, Arc<Counts>) {
        let counts = Arc::<Counts>::default();
        let storage = Self {
            disk,
            to,
            counts: counts.clone(),
        };
        (Arc::new(storage), counts)
    }
}

struct CountingFile {
    file: Option<Box<dyn WriteFile>>,
    to: Destination,
    counts: Arc<Counts>,
}

impl Storage for CountingStorage {
    fn create(&self, path: &str) -> io::Result<Box<dyn WriteFile>> {
        let file = match self.to {
            Destination::Nothing => None,
            _ => Some(self.disk.create(path)?),
        };
        Ok(Box::new(CountingFile {
            file,
            to: self.to,
            counts: self.counts.clone(),
        }))
    }

    fn open(&self, path: &str) -> io::Result<Box<dyn ReadAt>> {
        self.disk.open(path)
    }

    fn list(&self, dir: &str) -> io::Result<Vec<String>> {
        self.disk.list(dir)
    }

    fn create_dir(&self, dir: &str) -> io::Result<()> {
        self.disk.create_dir(dir)
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        match self.to {
            Destination::Nothing => Ok(()),
            _ => self.disk.rename(from, to),
        }
    }

    fn remove(&self, path: &str) -> io::Result<()> {
        self.disk.remove(path)
    }

    fn sync_dir(&self, dir: &str) -> io::Result<()> {
        self.counts.syncs.fetch_add(1, Ordering::Relaxed);
        match self.to {
            Destination::Disk => self.disk.sync_dir(dir),
            _ => Ok(()),
        }
    }
}

impl WriteFile for CountingFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let n = bytes.len() as u64;
        self.counts.bytes.fetch_add(n, Ordering::Relaxed);
        self.file.as_mut().map_or(Ok(()), |file| file.append(bytes))
    }

    fn sync_data(&mut self) -> io::Result<()> {
        self.counts.syncs.fetch_add(1, Ordering::Relaxed);
        match (&mut self.file, self.to) {
            (Some(file), Destination::Disk) => file.sync_data(),
            _ => Ok(()),
        }
    }

    fn truncate(&mut self, len: u64) -> io::Result<()> {
        self.file.as_mut().map_or(Ok(()), |file| file.truncate(len))
    }
}
