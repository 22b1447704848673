//! The hub joins all samples: times, frozen and silent streams, batches, and the encoders.
//!
//! It receives samples in the order of arrival and delivers [`Outgoing`] items. It owns no thread
//! and reads no clock. *Early*: a stream's first sample already has a time, with a conservative
//! sigma. *Late or repeated* samples are rejected before anything depends on them, and counted in a
//! notice. *At a gap*: numbers are passed on unchanged; the recorder turns missing ones into gap
//! records. *When a stream falls silent or its image freezes*: an alarm, within two periods and a
//! second, and another item when it is over. *When a device disconnects*: an alarm until it
//! reconnects. Samples missed meanwhile are dropped with that cause; their number comes from the
//! device's counter if that continued, and from the nominal rate if it restarted. *At the end*:
//! [`Hub::finish`] delivers everything inside.

use std::sync::Arc;
use std::time::Duration;

use machine::ladder::Mitigations;
use session_archive::record::ImuBatch;
use session_archive::record::paws::gap::Cause;
use session_archive::time::{HostTime, NS_PER_S};
use video::encoder::Preset;

use crate::encode::{CameraEncoder, EffortReduction, EncoderOutput, RemainingFrames};
use crate::encoding::Encoding;
use crate::preview::Previews;
use crate::sources::{DevicePart, Disconnect, DroppedFrame, Sample};
use crate::sync::renumber::Renumber;

mod camera_state;
mod frame_decimator;
mod frames;
mod imu_batches;
mod imu_state;
mod load_shedding;
mod outgoing;
mod setup;
mod stream_clock;
mod stream_monitor;

pub use self::outgoing::{Out, Outgoing, StreamHealth};
pub use self::setup::{CameraSetup, ImuSetup};
pub use self::stream_monitor::TICK_NS;

use self::camera_state::CameraState;
use self::frame_decimator::FrameDecimator;
use self::imu_state::{ImuState, MAX_BATCH_NS, flush};
use self::load_shedding::{LoadShedder, Step};
use self::stream_clock::StreamClock;
use self::stream_monitor::StreamMonitor;

/// Maximum number of bytes of raw frames that wait before the encoders of all cameras together:
/// seven seconds at 3 x 1344x376 and 15 Hz.
pub(crate) const MAX_WAITING_BYTES: usize = 256 << 20;
/// Source of alarms about encoders that are too slow.
const ENCODERS: &str = "encoders";
/// Maximum time for draining an encoder at the end.
pub(crate) const FINISH_LIMIT: Duration = Duration::from_secs(5);
/// Cause detail of frames that were received during a recording and not encoded before its end.
const NOT_STORED: &str = "not through the encoder when the session was closed";

/// Alarm text for a disconnected device, with the reason.
fn disconnect_text(detail: &str) -> String {
    format!("the device is disconnected ({detail})")
}

/// The hub.
pub struct Hub {
    cameras: Vec<CameraState>,
    imus: Vec<ImuState>,
    out: Out,
    encoding: Encoding,
    waits: bool,
    health_at: Option<HostTime>,
    previews: Option<Arc<Previews>>,
    mitigations: Mitigations,
    load_shedder: LoadShedder,
    /// Text of the active alarm about encoders that are too slow.
    load_shedding_alarm: Option<String>,
    /// Fill of the queue before the hub, 0 to 1.
    inbox_fill: f64,
    /// Nobody stores frames.
    is_idle: bool,
    /// Start of the present recording. Frames that arrived before it are not encoded.
    storing_since: HostTime,
}

impl Hub {
    /// Creates a hub for these cameras. With `waits`, every frame is waited for until it is
    /// encoded: for virtual time. `chunk_ns` is the archive's chunk length; `encoding` has a
    /// counter for each camera.
    pub fn new(
        setups: Vec<CameraSetup>,
        chunk_ns: i64,
        waits: bool,
        encoding: &Encoding,
        out: &Out,
    ) -> Self {
        let mut cameras: Vec<CameraState> = Vec::new();
        let mut imus = Vec::new();
        let capacity = MAX_WAITING_BYTES / setups.len().max(1);
        let has_preset = |setup: &CameraSetup| {
            setup.encoder.element == "x264enc" && setup.encoder.preset > Preset::Ultrafast
        };
        let load_shedder = LoadShedder::new(setups.iter().any(has_preset), setups.len());
        for (camera, setup) in setups.into_iter().enumerate() {
            let (forward, name) = (out.clone(), setup.name.clone());
            let counters = encoding.clone();
            let sink = Arc::new(move |encoded| {
                forward(match encoded {
                    EncoderOutput::Frame { frame, unit, key } => Outgoing::Frame {
                        camera,
                        frame,
                        unit,
                        key,
                    },
                    EncoderOutput::Dropped {
                        at,
                        first,
                        last,
                        cause,
                        detail,
                    } => Outgoing::Dropped {
                        at,
                        stream: name.clone(),
                        first,
                        last,
                        cause,
                        detail,
                    },
                });
                counters.end(camera);
            });
            let imu = setup.imu.clone().map(|imu| {
                imus.push(ImuState {
                    position: imus.len(),
                    numbers: Renumber::new(imu.number_bits),
                    clock: StreamClock::new(&imu.name, imu.clock, None),
                    monitor: StreamMonitor::new(imu.info.rate_hz),
                    batch: ImuBatch::default(),
                    batch_since: HostTime::MIN,
                    disconnect_alarm: None,
                    frame_sync: None,
                    setup: imu,
                });
                imus.len() - 1
            });
            let is_same = |other: &CameraState| {
                setup.trigger.is_some() && other.setup.trigger == setup.trigger
            };
            cameras.push(CameraState {
                together_with: cameras.iter().position(is_same).unwrap_or(camera),
                decimator: FrameDecimator::default(),
                encoder: CameraEncoder::new(setup.encoder.clone(), chunk_ns, capacity, sink),
                numbers: Renumber::new(setup.number_bits),
                clock: StreamClock::new(&setup.name, setup.clock, setup.stamped),
                monitor: StreamMonitor::new(setup.rate_hz),
                imu,
                digest: None,
                changed: HostTime::MIN,
                frozen_alarm: false,
                encoder_alarm: false,
                disconnect_alarm: None,
                setup,
            });
        }
        Self {
            cameras,
            imus,
            out: out.clone(),
            encoding: encoding.clone(),
            waits,
            health_at: None,
            previews: None,
            mitigations: Mitigations::default(),
            load_shedder,
            load_shedding_alarm: None,
            inbox_fill: 0.0,
            is_idle: false,
            storing_since: HostTime::MIN,
        }
    }

    /// Stores the newest images in `previews` from now on.
    pub fn show(&mut self, previews: Arc<Previews>) {
        self.previews = Some(previews);
    }

    /// Applies these measures against overload of the machine from now on.
    pub fn set_mitigations(&mut self, mitigations: Mitigations) {
        if mitigations != self.mitigations {
            self.mitigations = mitigations;
            self.ease();
        }
    }

    /// With `is_idle`, encodes nothing, because nobody stores frames: they are timed, counted and
    /// previewed, and queued frames are dropped. Encoding resumes with a key frame among the frames
    /// that arrived after `since`, the start of the recording; most frames that arrived before it
    /// and are passed in later have no pixels.
    pub fn idle(&mut self, is_idle: bool, since: HostTime) {
        if is_idle == self.is_idle {
            return;
        }
        self.is_idle = is_idle;
        self.storing_since = since;
        for camera in &mut self.cameras {
            camera.encoder.request_key();
            if is_idle {
                // Otherwise the next recording would begin with it.
                camera.encoder.drop_waiting(Cause::Late, NOT_STORED);
            }
        }
    }

    /// Sets the fill of the queue before the hub, 0 to 1: frames in it have not reached an
    /// encoder's queue.
    pub fn set_inbox_fill(&mut self, fill: f64) {
        self.inbox_fill = fill;
    }

    /// Reduces the encoders' effort as far as the state of the machine and of the queues requires.
    fn ease(&mut self) {
        let reduction = EffortReduction {
            preset: self.load_shedder.has(Step::Preset),
            quality: self.load_shedder.has(Step::Quality) || self.mitigations.lower_bitrate,
        };
        for camera in &mut self.cameras {
            camera.encoder.reduce_effort(reduction);
        }
    }

    /// Updates the load shedding from the fill of the queues.
    fn update_load_shedding(&mut self, now: HostTime) {
        let encoders = self.cameras.iter_mut().map(|camera| &mut camera.encoder);
        let fills = encoders.map(CameraEncoder::take_fill);
        let fill = fills.fold(self.inbox_fill, f64::max);
        if !self.load_shedder.update(now, fill) {
            return;
        }
        self.ease();
        let text = self.load_shedder.last().map(|step| {
            format!(
                "the machine is too slow to encode everything: {}",
                step.text()
            )
        });
        if let Some(over) = std::mem::replace(&mut self.load_shedding_alarm, text) {
            self.report_load_shedding(over, false, now);
        }
        if let Some(text) = self.load_shedding_alarm.clone() {
            self.report_load_shedding(text, true, now);
        }
    }

    fn report_load_shedding(&self, text: String, active: bool, at: HostTime) {
        let stream = ENCODERS.to_owned();
        (self.out)(Outgoing::Alarm {
            at,
            text,
            stream,
            active,
        });
    }

    /// Takes the next sample of a camera's source.
    pub fn sample(&mut self, camera: usize, sample: Sample, now: HostTime) {
        for camera in &mut self.cameras {
            camera.encoder.feed(now);
        }
        match sample {
            Sample::Arrival(frame_arrival) => self.frame_arrival(camera, &frame_arrival, now),
            Sample::Frame(frame) => self.frame(camera, frame, now),
            Sample::Native(frame) => self.frame(camera, frame, now),
            Sample::Imu(sample) => self.imu(camera, &sample, now),
            Sample::Disconnected(disconnect) => self.disconnect(camera, &disconnect),
            Sample::Dropped(unusable_frame) => self.unusable_frame(camera, unusable_frame, now),
            Sample::Notice(notice) => (self.out)(Outgoing::Notice {
                at: notice.host_time,
                text: format!("{}: {}", self.name(camera, notice.part), notice.text),
                stream: self.name(camera, notice.part).to_owned(),
            }),
            Sample::FrameSync(sync) => {
                if let Some(imu) = self.cameras[camera].imu {
                    let imu = &mut self.imus[imu];
                    let time = imu.clock.time_of(sync.ticks);
                    imu.frame_sync = time.map(|time| (sync, time - sync.stamp));
                }
            }
        }
    }

    fn name(&self, camera: usize, part: DevicePart) -> &str {
        let camera = &self.cameras[camera];
        match (part, camera.imu) {
            (DevicePart::Imu, Some(imu)) => &self.imus[imu].setup.name,
            _ => &camera.setup.name,
        }
    }

    fn disconnect(&mut self, camera: usize, disconnect: &Disconnect) {
        let camera = &mut self.cameras[camera];
        let has_camera = disconnect.part != DevicePart::Imu;
        if has_camera {
            camera.monitor.note_disconnect(disconnect);
            if camera.disconnect_alarm.is_none() {
                let what = disconnect_text(&disconnect.detail);
                camera.alarm(&what, true, disconnect.host_time, &self.out);
                camera.disconnect_alarm = Some(what);
            }
        }
        if let (Some(imu), DevicePart::Imu | DevicePart::Both) = (camera.imu, disconnect.part) {
            let imu = &mut self.imus[imu];
            flush(imu, &self.out);
            imu.monitor.note_disconnect(disconnect);
            // One alarm covers both devices.
            if !has_camera && imu.disconnect_alarm.is_none() {
                let what = disconnect_text(&disconnect.detail);
                imu.alarm(&what, true, disconnect.host_time, &self.out);
                imu.disconnect_alarm = Some(what);
            }
        }
    }

    /// A frame of this camera arrived, at this time and with the device's number, and was dropped
    /// before the hub because too many are queued.
    pub fn dropped(&mut self, camera: usize, number: u64, at: HostTime, now: HostTime) {
        let unusable_frame = DroppedFrame {
            number,
            host_time: at,
            cause: Cause::EncoderOverload,
            detail: "the machine is too slow: too many raw frames are waiting".to_owned(),
        };
        self.unusable_frame(camera, unusable_frame, now);
    }

    /// A camera's source has failed and will deliver no more samples.
    pub fn source_failed(&self, camera: usize, error: &str, now: HostTime) {
        (self.out)(Outgoing::Alarm {
            at: now,
            text: error.to_owned(),
            stream: self.cameras[camera].setup.name.clone(),
            active: true,
        });
    }

    /// The queue to the recorder was full and a frame of this camera was dropped behind its
    /// encoder: the next frame must be a key frame.
    pub fn request_key(&mut self, camera: usize) {
        self.cameras[camera].encoder.request_key();
    }

    /// Supervises encoders, alarms and health; to be called every [`TICK_NS`].
    pub fn tick(&mut self, now: HostTime) {
        for camera in &mut self.cameras {
            camera.encoder.tick(now);
            camera.note_encoder(now, &self.out);
            let name = &camera.setup.name;
            camera.monitor.check(name, now, &self.out);
            camera
                .monitor
                .report_absent(&camera.numbers, now, name, &self.out);
        }
        for imu in &mut self.imus {
            let name = &imu.setup.name;
            imu.monitor.check(name, now, &self.out);
            imu.monitor
                .report_absent(&imu.numbers, now, name, &self.out);
            if !imu.batch.times.is_empty() && now.since(imu.batch_since) >= MAX_BATCH_NS {
                flush(imu, &self.out);
            }
        }
        // If every frame is waited for, none is queued.
        if !self.waits {
            self.update_load_shedding(now);
        }
        match self.health_at {
            None => {
                self.health_at = Some(now);
                let cameras = self.cameras.iter_mut().map(|c| &mut c.monitor);
                for monitor in cameras.chain(self.imus.iter_mut().map(|i| &mut i.monitor)) {
                    monitor.begin_rates();
                }
            }
            Some(since) if now.since(since) >= NS_PER_S => {
                self.health_at = Some(now);
                self.health(now, now.since(since));
            }
            Some(_) => {}
        }
    }

    /// For the end, when nothing is passed in any more: to be called until it returns that
    /// everything is encoded; then [`Self::finish`] is quick. It does not block, except that once
    /// no frame waits for an encoder, each call waits for one of the encoders to end.
    pub fn drain(&mut self, now: HostTime) -> bool {
        let mut is_waiting = false;
        for camera in &mut self.cameras {
            camera.monitor.hold();
            is_waiting |= !camera.encoder.drain(now);
        }
        for imu in &mut self.imus {
            imu.monitor.hold();
        }
        if is_waiting {
            return false;
        }
        let mut encoders = self.cameras.iter_mut().map(|camera| &mut camera.encoder);
        match encoders.find(|encoder| encoder.is_running()) {
            Some(encoder) => {
                encoder.finish(RemainingFrames::Encode, FINISH_LIMIT, now);
                false
            }
            None => true,
        }
    }

    /// Delivers everything inside; nothing may be passed in afterwards. `rest` says whether frames
    /// that still wait for an encoder are encoded.
    pub fn finish(&mut self, rest: RemainingFrames, now: HostTime) {
        for camera in &mut self.cameras {
            camera.encoder.finish(rest, FINISH_LIMIT, now);
            let name = &camera.setup.name;
            camera.monitor.end(&camera.numbers, now, name, &self.out);
        }
        for imu in &mut self.imus {
            flush(imu, &self.out);
            let name = &imu.setup.name;
            imu.monitor.end(&imu.numbers, now, name, &self.out);
        }
    }

    fn health(&mut self, at: HostTime, span_ns: i64) {
        let mut streams = Vec::new();
        for camera in &mut self.cameras {
            camera
                .monitor
                .report_rejected(at, &camera.setup.name, &self.out);
            let mut health = camera.monitor.health(&camera.setup.name, span_ns);
            // If every frame is waited for, none is queued, although the encoder's own threads may
            // still be releasing the last one.
            if !self.waits {
                health.queue_bytes = camera.encoder.queued_bytes() as u64;
            }
            health.frozen = camera.frozen_alarm;
            streams.push(health);
        }
        for imu in &mut self.imus {
            imu.monitor.report_rejected(at, &imu.setup.name, &self.out);
            let mut health = imu.monitor.health(&imu.setup.name, span_ns);
            health.frame_sync = imu.frame_sync.take();
            streams.push(health);
        }
        (self.out)(Outgoing::Health { at, streams });
    }
}

#[cfg(test)]
mod tests;
