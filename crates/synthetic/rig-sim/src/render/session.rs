//! A walk as a session archive, as a recorder without faults would write it.
//!
//! Contract: frames and samples are numbered by their index in the walk, their times are the true
//! ones, and so is the clock map: timing metadata is exact. Losses of a faulty device are gaps with
//! a cause. Images are encoded lossily; the same walk gives the same bytes on any number of
//! threads. The walk begins at [`BEGIN`] of the recording machine's clock.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use cad_transforms::rig::Rig;
use camera_models::{CameraInfo, Eye};
use session_archive::manifest::{self, Stop};
use session_archive::record::paws::clock_map::{Model, Piece};
use session_archive::record::paws::event::Kind as EventKind;
use session_archive::record::paws::frame_set::Member;
use session_archive::record::paws::gap::Cause;
use session_archive::record::{
    CameraCalibration, ClockMap, Event, Frame, FrameSet, FrameTransform, FrameTransforms, Gap,
    ImuBatch, timestamp,
};
use session_archive::storage::DiskStorage;
use session_archive::time::{CivilTime, HostTime, NS_PER_S, TickLength};
use session_archive::writer::{DEFAULT_CHUNK_NS, SessionSpec, SessionWriter, WriteError};
use video::{AccessUnit, PixelFormat, RawImage};

use super::special;
use crate::device::clock::DeviceClock;
use crate::device::{Delivery, Device, DeviceFrame, DeviceImu, Loss, Stream};
use crate::faults::{Faults, Kind};
use crate::film::{ELEMENT, Film, FilmError};
use crate::random;
use crate::simulation::{Simulation, seconds};

/// Begin of the walk on the recording machine's clock; not 0, so that nothing is before 0.
pub const BEGIN: HostTime = HostTime(NS_PER_S);
/// Civil time at that instant: 2026-01-01T00:00:00Z.
const CIVIL: CivilTime = CivilTime(1_767_225_600 * NS_PER_S);
/// Maximum time span of an IMU batch, ns.
const BATCH_NS: i64 = 100_000_000;
/// Maximum number of queued deliveries of a camera: bounds memory.
const MAX_QUEUED_DELIVERIES: usize = 64;

/// Error of writing a session.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The images could not be encoded.
    #[error(transparent)]
    Film(#[from] FilmError),
    /// The archive could not be written.
    #[error("writing a simulated session")]
    Write(#[from] WriteError),
    /// A clock fault contradicts the exact clock map: record such a walk with `pawsd`.
    #[error(
        "writing a simulated session: found a fault of kind {0}, expected none that disturbs a clock"
    )]
    Clock(&'static str),
}

/// Output of one camera's thread, in the order of arrival.
enum Item {
    Frame(Box<DeviceFrame>, AccessUnit),
    Imu(DeviceImu),
    /// The device disconnected at this time, ns.
    Disconnected(i64),
    /// Losses before the next delivery, at this time, ns.
    Losses(Vec<Loss>, i64),
    Failed(FilmError),
}

impl Item {
    fn arrival_ns(&self) -> i64 {
        match self {
            Self::Frame(frame, _) => frame.arrival_ns,
            Self::Imu(sample) => sample.arrival_ns,
            Self::Disconnected(at_ns) | Self::Losses(_, at_ns) => *at_ns,
            Self::Failed(_) => 0,
        }
    }
}

/// Writes the session into a new folder. `done` is called after each stereo frame, from any thread.
///
/// # Errors
/// [`SessionError`].
pub fn write(
    simulation: &Arc<Simulation>,
    rig: &Rig,
    rig_text: &str,
    faults: &Faults,
    folder: &Path,
    done: &(dyn Fn() + Sync),
) -> Result<(), SessionError> {
    for fault in faults.list.iter().filter(|f| f.strength != 0.0) {
        if let Kind::ClockStep | Kind::ClockDrift | Kind::TickWrap = fault.kind {
            return Err(SessionError::Clock(fault.kind.name()));
        }
    }
    let devices: Vec<Device> = (0..simulation.cameras().len())
        .map(|i| Device::rendered(simulation, i, faults.of(&simulation.cameras()[i].name)))
        .collect();
    let mut archive = Archive::create(simulation, rig, rig_text, &devices, folder)?;
    thread::scope(|scope| {
        let mut streams = Vec::new();
        for device in devices {
            let (sender, receiver) = sync_channel(MAX_QUEUED_DELIVERIES);
            scope.spawn(move || deliver(device, simulation, &sender, done));
            streams.push(receiver);
        }
        archive.fill(&streams)
    })?;
    archive.close()
}

/// Renders and encodes the deliveries of a device.
fn deliver(
    mut device: Device,
    simulation: &Simulation,
    to: &SyncSender<Item>,
    done: &(dyn Fn() + Sync),
) {
    let settings = simulation.settings();
    let size = [2 * settings.width, settings.height];
    let keys = (2.0 * seconds(DEFAULT_CHUNK_NS) * settings.rate_hz).ceil() as u32;
    let mut chunk = None;
    let mut film = None;
    let (mut newest, mut reported) = (None, 0);
    loop {
        let delivery = device.deliver();
        let lost = &device.losses()[reported..];
        if !lost.is_empty() {
            reported += lost.len();
            let at_ns = match &delivery {
                Some(Delivery::Frame(frame)) => frame.arrival_ns,
                Some(Delivery::Imu(sample)) => sample.arrival_ns,
                Some(Delivery::Disconnected(at_ns)) => *at_ns,
                None => (settings.seconds * 1e9) as i64,
            };
            let _ = to.send(Item::Losses(lost.to_vec(), at_ns));
        }
        let item = match delivery {
            None => return,
            Some(Delivery::Disconnected(at_ns)) => Item::Disconnected(at_ns),
            Some(Delivery::Imu(sample)) => Item::Imu(sample),
            // A duplicate.
            Some(Delivery::Frame(frame)) if newest == Some(frame.index) => continue,
            Some(Delivery::Frame(frame)) => {
                newest = Some(frame.index);
                let time = (BEGIN + frame.taken_ns).ns();
                let of = time.div_euclid(DEFAULT_CHUNK_NS);
                let key = chunk.replace(of) != Some(of);
                done();
                let film = match &mut film {
                    Some(film) => Ok(film),
                    none => Film::new(size, settings.rate_hz, keys).map(|new| none.insert(new)),
                };
                match film.and_then(|film| encode(film, time, &frame, key)) {
                    Ok(unit) => Item::Frame(Box::new(frame), unit),
                    Err(error) => Item::Failed(error),
                }
            }
        };
        // The receiver is dropped if the session has failed.
        if to.send(item).is_err() {
            return;
        }
    }
}

fn encode(
    film: &mut Film,
    time: i64,
    frame: &DeviceFrame,
    key: bool,
) -> Result<AccessUnit, FilmError> {
    let shown = &frame.image;
    let (width, height) = (shown.width as u32, shown.height as u32);
    let image = RawImage::new(width, height, PixelFormat::I420, shown.i420.clone())?;
    film.encode(time, &image, key)
}

/// The session being written.
struct Archive<'a> {
    simulation: &'a Simulation,
    writer: SessionWriter,
    /// Clocks of each camera and its IMU.
    clocks: Vec<[DeviceClock; 2]>,
    /// Number of clock maps so far, per camera.
    versions: Vec<u32>,
    batches: Vec<ImuBatch>,
    /// Times of disconnection of each device, ns since the beginning of the walk.
    disconnects: Vec<Vec<(i64, i64)>>,
    /// Per frame index, the cameras whose frame arrived and those whose frame was lost.
    sets: BTreeMap<u64, (Vec<usize>, Vec<usize>)>,
    /// Number of frame sets written.
    set: u64,
}

impl<'a> Archive<'a> {
    fn create(
        simulation: &'a Simulation,
        rig: &Rig,
        rig_text: &str,
        devices: &[Device],
        folder: &Path,
    ) -> Result<Self, SessionError> {
        let settings = simulation.settings();
        let mut files = Vec::new();
        if simulation.has_calibration() {
            files.push(("rig.toml".to_owned(), rig_text.as_bytes().to_vec()));
        }
        let of_kind = special::files(simulation, rig).into_iter();
        files.extend(of_kind.map(|(name, text)| (name, text.into_bytes())));
        for device in devices {
            for (name, text) in device.truth(BEGIN.ns()) {
                if files.iter().all(|(known, _)| *known != name) {
                    files.push((name, text.into_bytes()));
                }
            }
        }
        let source = |name: &str| {
            let (kind, lighting) = (settings.kind.name(), settings.lighting.name());
            format!(
                "simulated {name}, {kind}, {lighting}, seed {}",
                settings.seed
            )
        };
        let cameras = simulation.cameras().iter().zip(devices);
        let cameras = cameras.map(|(camera, device)| manifest::Camera {
            name: camera.name.clone(),
            width: 2 * settings.width,
            height: settings.height,
            codec: codec().to_owned(),
            colour: "yuv420".to_owned(),
            rate_hz: settings.rate_hz,
            tick: device.clocks()[0].tick(),
            trigger: Some("walk".to_owned()),
            source: source(&camera.name),
            encoder: ELEMENT.to_owned(),
        });
        let imus = simulation.cameras().iter().zip(simulation.imus());
        let imus = imus
            .zip(devices)
            .map(|((camera, imu), device)| manifest::Imu {
                name: format!("{}/imu", camera.name),
                rate_hz: imu.imu.model().rate_hz,
                tick: device.clocks()[1].tick(),
                source: source(&camera.name),
                noise: None,
            });
        let id =
            [0, 1].map(|k| random::bits(settings.seed, random::DEVICE + 0x20, k).to_be_bytes());
        let mut bytes = [0; 16];
        bytes[..8].copy_from_slice(&id[0]);
        bytes[8..].copy_from_slice(&id[1]);
        let spec = SessionSpec {
            session_id: uuid::Builder::from_custom_bytes(bytes)
                .into_uuid()
                .to_string(),
            name: format!(
                "{} {} {}",
                settings.kind.name(),
                settings.lighting.name(),
                settings.seed
            ),
            software: concat!("paws-rig-sim ", env!("CARGO_PKG_VERSION")).to_owned(),
            started: BEGIN,
            started_civil: CIVIL,
            chunk_ns: DEFAULT_CHUNK_NS,
            cameras: cameras.collect(),
            imus: imus.collect(),
            rig: files,
        };
        let writer = SessionWriter::create(Arc::new(DiskStorage::new(folder)), spec)?;
        let count = devices.len();
        let mut archive = Self {
            simulation,
            writer,
            clocks: devices.iter().map(|d| d.clocks().clone()).collect(),
            versions: vec![0; count],
            batches: vec![ImuBatch::default(); count],
            disconnects: devices.iter().map(|d| d.disconnects().to_vec()).collect(),
            sets: BTreeMap::new(),
            set: 0,
        };
        archive.event(EventKind::Start, BEGIN)?;
        if simulation.has_calibration() {
            archive.statics(rig)?;
        }
        for camera in 0..count {
            archive.clock_maps(camera, 0, 0)?;
        }
        Ok(archive)
    }

    fn name(&self, camera: usize) -> &'a str {
        &self.simulation.cameras()[camera].name
    }

    fn event(&mut self, kind: EventKind, at: HostTime) -> Result<(), WriteError> {
        let event = Event {
            kind: kind.into(),
            source: "simulation".to_owned(),
            text: String::new(),
        };
        self.writer.append("", at, at, &event)
    }

    /// Extrinsics and intrinsics.
    fn statics(&mut self, rig: &Rig) -> Result<(), WriteError> {
        let transforms = rig.edges().iter().map(|edge| {
            FrameTransform::placing(
                edge.child.as_str(),
                edge.parent.as_str(),
                edge.parent_from_child.translation_m(),
                edge.parent_from_child.rotation_wxyz(),
                BEGIN,
            )
        });
        let transforms = FrameTransforms {
            transforms: transforms.collect(),
        };
        self.writer.append("", BEGIN, BEGIN, &transforms)?;
        for camera in 0..self.clocks.len() {
            let stereo = self.simulation.calibration(camera);
            for (eye, which) in [("left", Eye::Left), ("right", Eye::Right)] {
                let info = CameraInfo::of(&stereo, which);
                let frame = format!("{}/{eye}", self.name(camera));
                let record = CameraCalibration {
                    timestamp: Some(timestamp(BEGIN)),
                    frame_id: frame.clone(),
                    width: info.width,
                    height: info.height,
                    distortion_model: info.distortion_model.to_owned(),
                    d: info.d,
                    k: info.k.to_vec(),
                    r: info.r.to_vec(),
                    p: info.p.to_vec(),
                };
                self.writer.append(&frame, BEGIN, BEGIN, &record)?;
            }
        }
        Ok(())
    }

    /// Clock maps of a camera in a connection epoch that began `on_ns` after the beginning of the
    /// walk.
    fn clock_maps(&mut self, camera: usize, epoch: u32, on_ns: i64) -> Result<(), WriteError> {
        self.versions[camera] = epoch + 1;
        for (k, stream) in ["", "/imu"].into_iter().enumerate() {
            let clock = &self.clocks[camera][k];
            let TickLength { num, den } = clock.tick();
            let at = BEGIN + on_ns;
            let ticks = match epoch {
                0 => clock.ticks(on_ns),
                _ => clock.ticks_since(on_ns, on_ns),
            };
            let name = format!("{}{stream}", self.name(camera));
            let map = ClockMap {
                clock: name.clone(),
                version: epoch + 1,
                tick_num: num,
                tick_den: den,
                model: Model::Affine.into(),
                pieces: vec![Piece {
                    ticks_from: ticks,
                    ticks_ref: ticks,
                    host_ref: at.ns(),
                    rate_ppb: clock.host_rate_ppb(),
                    sigma_ns: 0,
                    rate_sigma_ppb: 0.0,
                }],
                epoch,
                ticks_to: i64::MAX,
                ..ClockMap::default()
            };
            self.writer.append(&name, at, at, &map)?;
        }
        Ok(())
    }

    /// Merges the deliveries of all cameras by arrival time until all have ended.
    fn fill(&mut self, streams: &[Receiver<Item>]) -> Result<(), SessionError> {
        let mut heads: Vec<Option<Item>> = Vec::new();
        for (camera, stream) in streams.iter().enumerate() {
            let head = self.head(camera, stream)?;
            heads.push(head);
        }
        loop {
            let arrivals = heads.iter().enumerate();
            let arrivals = arrivals.filter_map(|(i, item)| Some((item.as_ref()?.arrival_ns(), i)));
            let Some((_, camera)) = arrivals.min() else {
                return Ok(());
            };
            let following = self.head(camera, &streams[camera])?;
            match std::mem::replace(&mut heads[camera], following) {
                Some(Item::Frame(frame, unit)) => self.frame(camera, &frame, &unit)?,
                Some(Item::Imu(sample)) => self.sample(camera, &sample)?,
                Some(Item::Losses(losses, _)) => self.lost(camera, &losses)?,
                Some(Item::Disconnected(_) | Item::Failed(_)) | None => {}
            }
        }
    }

    /// Next delivery of a camera; `None` at its end.
    fn head(
        &mut self,
        camera: usize,
        stream: &Receiver<Item>,
    ) -> Result<Option<Item>, SessionError> {
        match stream.recv() {
            Ok(Item::Failed(error)) => Err(error.into()),
            Ok(item) => Ok(Some(item)),
            Err(_) => {
                self.flush(camera)?;
                Ok(None)
            }
        }
    }

    fn frame(
        &mut self,
        camera: usize,
        frame: &DeviceFrame,
        unit: &AccessUnit,
    ) -> Result<(), WriteError> {
        self.record_reconnect(camera, frame.taken_ns)?;
        let time = BEGIN + frame.taken_ns;
        let record = Frame {
            number: frame.index,
            device_ticks: frame.ticks,
            host_time: (BEGIN + frame.arrival_ns).ns(),
            time: time.ns(),
            exposure_ns: Some((frame.image.exposure.seconds * 1e9) as u32),
            clock_map: self.versions[camera],
            ..Frame::default()
        };
        let name = self.name(camera);
        self.writer
            .append_frame(name, record, &unit.data, unit.key)?;
        self.sets.entry(frame.index).or_default().0.push(camera);
        self.complete_sets()
    }

    fn sample(&mut self, camera: usize, sample: &DeviceImu) -> Result<(), WriteError> {
        self.record_reconnect(camera, sample.taken_ns)?;
        let batch = &self.batches[camera];
        let time = (BEGIN + sample.taken_ns).ns();
        let full = match batch.times.first() {
            Some(first) => {
                time - first >= BATCH_NS
                    || batch.first_number + batch.times.len() as u64 != sample.index
            }
            None => true,
        };
        if full {
            self.flush(camera)?;
            let [gyro_scale, accel_scale] = self.simulation.imus()[camera].imu.model().count;
            self.batches[camera] = ImuBatch {
                first_number: sample.index,
                clock_map: self.versions[camera],
                gyro_scale,
                accel_scale,
                temperature_scale_c: 0.01,
                ..ImuBatch::default()
            };
        }
        let batch = &mut self.batches[camera];
        if sample.frame_sync {
            batch.frame_sync.push(batch.times.len() as u32);
        }
        batch.device_ticks.push(sample.ticks);
        batch.host_times.push((BEGIN + sample.arrival_ns).ns());
        batch.times.push(time);
        batch.gyro_counts.extend(sample.gyro.map(i32::from));
        batch.accel_counts.extend(sample.accel.map(i32::from));
        batch.temperature_counts.push(sample.temperature.into());
        Ok(())
    }

    /// Writes the pending IMU samples.
    fn flush(&mut self, camera: usize) -> Result<(), WriteError> {
        let batch = std::mem::take(&mut self.batches[camera]);
        let (Some(first), Some(last)) = (batch.times.first(), batch.host_times.last()) else {
            return Ok(());
        };
        let name = format!("{}/imu", self.name(camera));
        let (first, last) = (HostTime(*first), HostTime(*last));
        self.writer.append(&name, first, last, &batch)
    }

    /// The first measurement after a reconnection needs a new clock map.
    fn record_reconnect(&mut self, camera: usize, taken_ns: i64) -> Result<(), WriteError> {
        let spans = self.disconnects[camera].iter();
        let over: Vec<i64> = spans
            .map(|(_, to)| *to)
            .filter(|to| *to <= taken_ns)
            .collect();
        let epoch = over.len() as u32;
        match over.last() {
            Some(on_ns) if self.versions[camera] <= epoch => {
                self.flush(camera)?;
                self.clock_maps(camera, epoch, *on_ns)
            }
            _ => Ok(()),
        }
    }

    /// Writes gaps for losses, one record per run of the same cause.
    fn lost(&mut self, camera: usize, losses: &[Loss]) -> Result<(), WriteError> {
        let follows =
            |a: &Loss, b: &Loss| (a.stream, a.cause, a.index + 1) == (b.stream, b.cause, b.index);
        for stream in [Stream::Frames, Stream::Imu] {
            let of: Vec<Loss> = losses
                .iter()
                .filter(|l| l.stream == stream)
                .copied()
                .collect();
            for run in of.chunk_by(follows) {
                let (first, last) = (run[0], run[run.len() - 1]);
                let (name, cause) = (self.name(camera), first.cause);
                let gap = Gap {
                    stream: match stream {
                        Stream::Frames => name.to_owned(),
                        Stream::Imu => format!("{name}/imu"),
                    },
                    first: first.index,
                    last: last.index,
                    cause: match cause {
                        Kind::Disconnect => Cause::Disconnected,
                        _ => Cause::Device,
                    }
                    .into(),
                    time_before: None,
                    time_after: None,
                    detail: format!("simulated: {}", cause.name()),
                };
                let at = BEGIN + first.taken_ns;
                self.writer.append("", at, at, &gap)?;
            }
            if stream == Stream::Frames {
                for loss in of {
                    self.sets.entry(loss.index).or_default().1.push(camera);
                }
            }
        }
        self.complete_sets()
    }

    /// Writes the frame sets of which every camera's frame has arrived or is lost.
    fn complete_sets(&mut self) -> Result<(), WriteError> {
        let cameras = self.clocks.len();
        while let Some(entry) = self.sets.first_entry() {
            if entry.get().0.len() + entry.get().1.len() < cameras {
                break;
            }
            let (index, (mut there, mut missing)) = entry.remove_entry();
            there.sort_unstable();
            missing.sort_unstable();
            if there.is_empty() {
                continue;
            }
            let time = BEGIN + self.simulation.settings().frame_ns(index);
            let members = there.iter().map(|camera| Member {
                camera: self.name(*camera).to_owned(),
                number: index,
                time: time.ns(),
            });
            let set = FrameSet {
                number: self.set,
                time: time.ns(),
                members: members.collect(),
                missing: missing.iter().map(|c| self.name(*c).to_owned()).collect(),
            };
            self.set += 1;
            self.writer.append("", time, time, &set)?;
        }
        Ok(())
    }

    fn close(mut self) -> Result<(), SessionError> {
        let end = BEGIN + (self.simulation.settings().seconds * 1e9) as i64;
        self.event(EventKind::Stop, end)?;
        let stop = Stop {
            at: end,
            reason: "the walk has ended".to_owned(),
        };
        self.writer.close(stop)?;
        Ok(())
    }
}

/// Codec name in the archive.
fn codec() -> &'static str {
    let codec = video::encoder::element_codec(ELEMENT).expect("an encoder of the video crate");
    codec.foxglove_format()
}
