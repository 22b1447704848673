//! Random fault schedules for the whole daemon in virtual time: checks that every session ends
//! valid, with every loss accounted for by its true cause.
//!
//! The devices are those of `rig-sim`, with images without rendering cost. A device is a function
//! of its seed, so a second instance gives afterwards the true arrivals and losses with their
//! causes.

use std::ops::Range;
use std::panic::resume_unwind;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

use anyhow::{Context as _, Result, ensure};
use cad_transforms::rig::Rig as RigFile;
use capture_daemon::run::{StopFlag, build, record_built};
use capture_daemon::sources::simulated::SimulatedCamera;
use capture_daemon::sources::{AnySource, Source};
use capture_daemon::sync::clock::ClockConfig;
use rig_sim::camera::Quality;
use rig_sim::camera::sensor::Exposure;
use rig_sim::device::{Delivery, Device, Loss, Stream};
use rig_sim::faults::{Faults, Kind};
use rig_sim::imu::ImuModel;
use rig_sim::scene::{Kind as Place, Lighting};
use rig_sim::simulation::{FrameSource, Settings, Simulation, StereoFrame};
use session_archive::record::paws::gap::Cause;
use session_archive::time::HostTime;
use session_archive::verify::verify;

use crate::contents::{self, Contents};
use crate::rig::{CAMERAS, Rig, in_virtual_time};

/// Kinds of faults: all that do not affect images only.
pub const KINDS: [Kind; 12] = [
    Kind::Dropped,
    Kind::Late,
    Kind::Duplicated,
    Kind::Frozen,
    Kind::Torn,
    Kind::LatencyBurst,
    Kind::ClockStep,
    Kind::ClockDrift,
    Kind::TickWrap,
    Kind::Disconnect,
    Kind::ImuGap,
    Kind::ImuClipping,
];

/// The walk to which all schedules are applied.
pub struct Exam {
    walk: Arc<Simulation>,
    seconds: f64,
}

/// Result of a schedule.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    /// Frames and samples that arrived and are stored.
    pub stored: u64,
    /// Lost frames and samples that are in a gap record with the true cause.
    pub accounted: u64,
    /// Number of stored ones whose time is marked as unreliable.
    pub unreliable: u64,
}

impl Tally {
    fn add(&mut self, other: &Self) {
        self.stored += other.stored;
        self.accounted += other.accounted;
        self.unreliable += other.unreliable;
    }
}

const RATE_HZ: f64 = 5.0;
const IMU_RATE_HZ: f64 = 50.0;
const RIG: &str = include_str!("../../../../cad-transforms/rigs/example.toml");

impl Exam {
    /// Sessions of `seconds`.
    ///
    /// # Errors
    /// The walk cannot be prepared.
    pub fn new(seconds: f64) -> Result<Self> {
        let settings = Settings {
            kind: Place::Corridor,
            lighting: Lighting::Day,
            seed: 1,
            seconds,
            rate_hz: RATE_HZ,
            width: 32,
            height: 32,
            quality: Quality::FAST,
        };
        let rig = RigFile::parse(RIG)?;
        let slow = ImuModel {
            rate_hz: IMU_RATE_HZ,
            ..ImuModel::ZED_MINI
        };
        let walk = Simulation::new(&settings, &rig)?.with_imus(slow, &rig)?;
        Ok(Self {
            walk: Arc::new(walk),
            seconds,
        })
    }

    /// Runs the schedules of these seeds on all processors, in folders below `out`. Returns the sum
    /// of the valid results, and the seeds of all others with their errors.
    pub fn run_all(&self, seeds: Range<u64>, out: &Path) -> (Tally, Vec<(u64, anyhow::Error)>) {
        let next = AtomicU64::new(seeds.start);
        let work = || {
            let (mut tally, mut failures) = (Tally::default(), Vec::new());
            loop {
                let seed = next.fetch_add(1, Ordering::Relaxed);
                if seed >= seeds.end {
                    return (tally, failures);
                }
                match self.run(seed, out) {
                    Ok(of_one) => tally.add(&of_one),
                    Err(error) => failures.push((seed, error)),
                }
            }
        };
        let threads = thread::available_parallelism().map_or(1, usize::from);
        let (mut tally, mut failures) = (Tally::default(), Vec::new());
        thread::scope(|scope| {
            let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
            for worker in workers {
                let (of_worker, failed) =
                    worker.join().unwrap_or_else(|panic| resume_unwind(panic));
                tally.add(&of_worker);
                failures.extend(failed);
            }
        });
        failures.sort_by_key(|(seed, _)| *seed);
        (tally, failures)
    }

    /// Records with the schedule of a seed, in a folder below `out`, and checks the session.
    ///
    /// # Errors
    /// A check fails; the error contains the seed and the schedule.
    pub fn run(&self, seed: u64, out: &Path) -> Result<Tally> {
        let faults = Faults::random(seed, &KINDS, &CAMERAS, self.seconds);
        let folder = tempfile::tempdir_in(out).context("creating a folder")?;
        self.examine(&faults, folder.path())
            .with_context(|| format!("schedule of seed {seed}:\n{}", faults.to_toml()))
    }

    fn device(&self, camera: usize, faults: &Faults) -> Device {
        let of = faults.of(CAMERAS[camera]);
        Device::new(&self.walk, self.position(camera), of, Box::new(PlainImages))
    }

    /// Index of a camera in the walk.
    fn position(&self, camera: usize) -> usize {
        let mut cameras = self.walk.cameras().iter();
        let position = cameras.position(|c| c.name == CAMERAS[camera]);
        position.expect("the example rig has the three cameras")
    }

    fn examine(&self, faults: &Faults, folder: &Path) -> Result<Tally> {
        let synthetic = Rig {
            width: 128,
            rate_hz: RATE_HZ,
            imu_rate_hz: IMU_RATE_HZ,
            ..Rig::small(CAMERAS.len())
        };
        let mut begin = HostTime(0);
        let building = |start| {
            begin = start;
            // Configurations of synthetic cameras, sources and clocks of simulated ones.
            let mut built = build(&synthetic.config(folder)?, start)?;
            for camera in 0..CAMERAS.len() {
                let device = self.device(camera, faults);
                let source =
                    SimulatedCamera::of_device(&self.walk, self.position(camera), device, start);
                let info = source.info().clone();
                let setup = &mut built.cameras[camera];
                setup.clock = clock(setup.clock, info.camera.tick, info.camera.tick_bits);
                built.setup.cameras[camera].tick = info.camera.tick;
                if let (Some(imu), Some(of)) = (&mut setup.imu, info.imu) {
                    imu.clock = clock(imu.clock, of.tick, of.tick_bits);
                    built.setup.imus[camera].tick = of.tick;
                    imu.info = of;
                }
                setup.encoder.width = info.camera.width;
                setup.encoder.height = info.camera.height;
                built.setup.cameras[camera].width = info.camera.width;
                built.setup.cameras[camera].height = info.camera.height;
                built.sources[camera] = AnySource::Scheduled(Box::new(source));
            }
            Ok(built)
        };
        let options = in_virtual_time(self.seconds, folder);
        let finished = record_built(building, &options, &StopFlag::new(), Box::new(|_| {}))?;
        ensure!(
            finished.error.is_none(),
            "the recording failed: {finished:?}"
        );
        let report = verify(&contents::open(&finished.session)?, |_| {})?;
        ensure!(report.is_sound(), "the session is not valid: {report:?}");
        let contents = Contents::read(&finished.session)?;
        let mut tally = Tally::default();
        for (camera, name) in CAMERAS.into_iter().enumerate() {
            let mut twin = self.device(camera, faults);
            let arrived: Vec<Delivery> = std::iter::from_fn(|| twin.deliver()).collect();
            for (stream, name) in [
                (Stream::Frames, name.to_owned()),
                (Stream::Imu, format!("{name}/imu")),
            ] {
                let truth = Truth::of(stream, &arrived, twin.losses(), begin, self.seconds);
                let found = StreamContent::of(&contents, &name);
                truth
                    .compare(&found, &mut tally)
                    .with_context(|| format!("stream {name}"))?;
            }
        }
        Ok(tally)
    }
}

fn clock(
    known: ClockConfig,
    tick: session_archive::time::TickLength,
    tick_bits: Option<u8>,
) -> ClockConfig {
    ClockConfig {
        tick_bits,
        latency_ns: known.latency_ns,
        latency_sigma_ns: known.latency_sigma_ns,
        ..ClockConfig::new(tick)
    }
}

/// Uniform gray images; consecutive ones differ.
struct PlainImages;

impl FrameSource for PlainImages {
    fn render_frame(&mut self, number: u64, time_ns: i64) -> StereoFrame {
        let (width, height) = (64, 32);
        StereoFrame {
            number,
            time_ns,
            exposure: Exposure {
                seconds: 1e-3,
                gain: 1.0,
            },
            width,
            height,
            i420: vec![(16 + 7 * number % 200) as u8; width * height * 3 / 2],
        }
    }
}

/// Ground truth of one stream, in the order of measurement.
struct Truth {
    /// Times of measurement and arrival of everything that arrived before the end, and whether it
    /// repeats the previous content.
    arrived: Vec<(HostTime, HostTime, bool)>,
    /// Time of measurement and cause of everything that never arrived.
    lost: Vec<(HostTime, Kind)>,
    /// Times of disconnection.
    disconnected: Vec<HostTime>,
    period_ns: f64,
}

/// Content of a session for one stream.
struct StreamContent {
    stored: Vec<StoredItem>,
    /// First, last, cause.
    gaps: Vec<(u64, u64, i32)>,
}

/// A frame or sample in a session.
struct StoredItem {
    number: u64,
    arrival: HostTime,
    time: HostTime,
    sigma_ns: u64,
    unreliable: bool,
    frozen: bool,
}

/// Time of a disconnection, ns since the beginning of the walk.
fn disconnected_at(delivery: &Delivery) -> Option<i64> {
    match delivery {
        Delivery::Disconnected(at_ns) => Some(*at_ns),
        _ => None,
    }
}

impl Truth {
    fn of(
        stream: Stream,
        arrived: &[Delivery],
        losses: &[Loss],
        begin: HostTime,
        seconds: f64,
    ) -> Self {
        let end = begin + (seconds * 1e9) as i64;
        let mut known: Vec<(HostTime, HostTime, bool)> = Vec::new();
        let mut shown: &[u8] = &[];
        for delivery in arrived {
            let (taken_ns, arrival_ns, frozen) = match (delivery, stream) {
                (Delivery::Frame(f), Stream::Frames) => {
                    let before = std::mem::replace(&mut shown, &f.image.i420);
                    (f.taken_ns, f.arrival_ns, before == shown)
                }
                (Delivery::Imu(s), Stream::Imu) => (s.taken_ns, s.arrival_ns, false),
                _ => continue,
            };
            let (taken, arrival) = (begin + taken_ns, begin + arrival_ns);
            // A duplicated frame is one frame.
            let again = known.last().is_some_and(|last| last.0 == taken);
            if arrival < end && !again {
                known.push((taken, arrival, frozen));
            }
        }
        let rate_hz = match stream {
            Stream::Frames => RATE_HZ,
            Stream::Imu => IMU_RATE_HZ,
        };
        let of_stream = losses.iter().filter(|l| l.stream == stream);
        Self {
            arrived: known,
            lost: of_stream.map(|l| (begin + l.taken_ns, l.cause)).collect(),
            disconnected: arrived
                .iter()
                .filter_map(disconnected_at)
                .map(|ns| begin + ns)
                .collect(),
            period_ns: 1e9 / rate_hz,
        }
    }

    fn compare(&self, found: &StreamContent, tally: &mut Tally) -> Result<()> {
        let (arrived, stored) = (&self.arrived, &found.stored);
        let (came, kept) = (arrived.len(), stored.len());
        ensure!(came == kept, "{came} arrived and {kept} are stored");
        for ((taken, arrival, frozen), stored) in arrived.iter().zip(stored) {
            let kept = stored.arrival;
            ensure!(
                *arrival == kept,
                "the arrival at {arrival} is stored as {kept}"
            );
            let off_ns = (stored.time - *taken).unsigned_abs();
            ensure!(
                stored.unreliable || off_ns <= 6 * stored.sigma_ns + 1_000_000,
                "the measurement at {taken} has the time {}, with a sigma of {} ns, and is not marked as unreliable",
                stored.time,
                stored.sigma_ns
            );
            ensure!(
                stored.frozen == *frozen,
                "the frame of {taken} repeats the previous image: {frozen}, and is stored as frozen: {}",
                stored.frozen
            );
            tally.unreliable += u64::from(stored.unreliable);
        }
        tally.stored += stored.len() as u64;
        // Between each two arrivals: true losses, and the gap records.
        for (arrived, stored) in arrived.windows(2).zip(stored.windows(2)) {
            let (before, after) = (arrived[0], arrived[1]);
            let first = self.lost.partition_point(|(taken, _)| *taken < before.0);
            let end = self.lost.partition_point(|(taken, _)| *taken < after.0);
            let lost = &self.lost[first..end];
            let skipped = stored[1].number - stored[0].number - 1;
            let disconnected = self
                .disconnected
                .iter()
                .any(|at| (before.0..after.0).contains(at));
            let cause = match disconnected {
                true => Cause::Disconnected,
                false => Cause::Device,
            };
            let expected = match disconnected {
                // There is no counter while a device is disconnected: the time between arrivals
                // decides.
                true => ((after.1 - before.1) as f64 / self.period_ns).round() as u64 - 1,
                false => lost.len() as u64,
            };
            ensure!(
                skipped == expected,
                "{skipped} are missing between {} and {}, expected {expected}",
                before.0,
                after.0
            );
            for number in stored[0].number + 1..stored[1].number {
                let said = found.cause(number);
                ensure!(
                    said == Some(cause.into()),
                    "number {number} is missing after {}, and its gap has cause {said:?}, expected {cause:?}",
                    before.0
                );
            }
            tally.accounted += skipped;
        }
        Ok(())
    }
}

impl StreamContent {
    fn of(contents: &Contents, stream: &str) -> Self {
        let frames = contents.frames.get(stream).into_iter().flatten();
        let frames = frames.map(|f| StoredItem {
            number: f.record.number,
            arrival: HostTime(f.record.host_time),
            time: HostTime(f.record.time),
            sigma_ns: f.record.sigma_ns,
            unreliable: f.record.time_unreliable,
            frozen: f.record.frozen,
        });
        let samples = contents.imu.get(stream).into_iter().flatten();
        let samples = samples.map(|s| StoredItem {
            number: s.number,
            arrival: s.host_time,
            time: s.time,
            sigma_ns: s.sigma_ns,
            unreliable: s.time_unreliable,
            frozen: false,
        });
        let mut stored: Vec<StoredItem> = frames.chain(samples).collect();
        // Readers have to apply the unreliable spans of later clock maps.
        let clock = contents.clock_maps.get(stream);
        let unreliable_spans = clock
            .and_then(|maps| maps.last())
            .map_or(&[][..], |map| &map.unreliable_spans);
        for sample in &mut stored {
            let at = sample.arrival.0;
            sample.unreliable |= unreliable_spans
                .iter()
                .any(|d| (d.from..=d.to).contains(&at));
        }
        Self {
            stored,
            gaps: contents.gaps_of(stream),
        }
    }

    /// Cause of a missing number.
    fn cause(&self, number: u64) -> Option<i32> {
        let of = |(first, last, _): &&(u64, u64, i32)| (*first..=*last).contains(&number);
        self.gaps.iter().find(of).map(|gap| gap.2)
    }
}
