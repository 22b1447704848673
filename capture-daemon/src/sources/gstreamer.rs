//! A camera behind GStreamer elements, with the IMU of a ZED's microcontroller if it has one.
//!
//! Contract: frames carry the numbers and times that [`video::capture`] determines, on the host
//! clock; the uncertainty of the times follows from the element ([`video::capture::policy`]).
//! Frames of one stream go to the encoder in the camera's own buffers, without a copy; those of two
//! eyes are joined. *A disconnected camera*, or a chain that fails or ends, is reported once and
//! restarted every few seconds. *A chain that cannot be built* ends the source. Tested with
//! GStreamer's own test source and with `v4l2src` in a virtual machine, never on a Jetson.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use session_archive::record::paws::gap;
use session_archive::time::{HostTime, TickLength};
use v4l2::hotplug::Watch;
use video::capture::{CaptureError, Cause, Content, Delivery, Eye, LostFrames, policy};
use video::{Capture, CaptureEvent, CaptureSettings, CapturedFrame};

use super::device::{
    FrameSyncTracker, beside_imu, imu_info, lock, no_thread, report_disconnect, wait,
};
use super::{
    CameraInfo, DevicePart, DroppedFrame, FrameArrival, Live, RawFrame, Sample, Sink, SourceError,
    SourceInfo, TimestampRelation,
};
use crate::clock::{Clock as _, RealClock};
use crate::config::GstreamerConfig;
use crate::error_chain::with_causes;

/// Maximum wait before the end is checked.
const POLL_TIMEOUT: Duration = Duration::from_millis(100);
/// Delay before a failed chain is restarted, unless a device appears.
const RETRY: Duration = Duration::from_secs(3);

/// A camera behind GStreamer elements. See the module.
pub struct Gstreamer {
    info: SourceInfo,
    config: GstreamerConfig,
}

impl Gstreamer {
    /// The camera of these settings, which need not be present yet.
    pub fn new(config: &GstreamerConfig) -> Self {
        let worth = worth(&config.chain);
        let camera = CameraInfo {
            width: config.width,
            height: config.height,
            rate_hz: config.rate_hz,
            tick: TickLength::NANOSECOND,
            tick_bits: None,
            number_bits: None,
            colour: true,
            still: false,
            stamped: Some(TimestampRelation {
                latency_ns: worth.latency_ns,
                sigma_ns: worth.sigma_ns,
            }),
        };
        let eyes = config.right_chain.as_ref().map_or("", |_| ", two eyes");
        // One line, whatever its line breaks.
        let chain: Vec<&str> = config.chain.split_whitespace().collect();
        Self {
            info: SourceInfo {
                description: format!("GStreamer: {}{eyes}", chain.join(" ")),
                camera,
                imu: config.imu.as_ref().map(|imu| imu_info(imu.rate_hz)),
                calibration_files: Vec::new(),
            },
            config: config.clone(),
        }
    }

    fn settings(&self) -> CaptureSettings {
        let config = &self.config;
        CaptureSettings {
            right_chain: config.right_chain.clone(),
            // Two eyes are joined in memory; one stream remains in its camera's buffers.
            delivery: match config.right_chain {
                Some(_) => Delivery::Images,
                None => Delivery::Native,
            },
            start_delay: Duration::from_nanos(config.start_after_ns.unsigned_abs()),
            ..CaptureSettings::new(&config.chain, config.width, config.height, config.rate_hz)
        }
    }

    /// Whether the chain can be built on this machine.
    ///
    /// # Errors
    /// The reason why it cannot.
    pub fn check(&self) -> Result<(), CaptureError> {
        video::capture::check(&self.settings())
    }
}

/// Timestamp policy of the first known element of a chain.
fn worth(chain: &str) -> policy::Policy {
    let mut words = chain.split_whitespace();
    words
        .find_map(|word| policy::ROWS.iter().find(|row| row.element == word))
        .map_or(policy::UNKNOWN, |row| row.policy)
}

impl Live for Gstreamer {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn run(self: Box<Self>, sink: &dyn Sink) -> Result<(), SourceError> {
        let frames =
            |sync_tracker: Option<&Mutex<FrameSyncTracker>>| self.frames(sync_tracker, sink);
        match beside_imu(self.config.imu.as_ref(), sink, frames) {
            Ok(ended) => ended,
            Err(error) => Err(self.unusable(no_thread(&error))),
        }
    }
}

impl Gstreamer {
    fn frames(
        &self,
        sync_tracker: Option<&Mutex<FrameSyncTracker>>,
        sink: &dyn Sink,
    ) -> Result<(), SourceError> {
        let settings = self.settings();
        let mut reported = None;
        while !sink.is_ending() {
            let before = Watch::new(["/dev"]);
            let reason = match Capture::start(&settings, Arc::new(host_clock)) {
                Ok(capture) => self.read(capture, sync_tracker, sink, &mut reported),
                Err(error) => return Err(self.unusable(with_causes(&error))),
            };
            report_disconnect(&mut reported, DevicePart::Camera, reason, sink);
            if let Some(sync_tracker) = sync_tracker {
                lock(sync_tracker).restart();
            }
            wait(before, RETRY, sink);
        }
        Ok(())
    }

    /// Delivers frames until the chain ends; returns the reason.
    fn read(
        &self,
        mut capture: Capture,
        sync_tracker: Option<&Mutex<FrameSyncTracker>>,
        sink: &dyn Sink,
        reported: &mut Option<String>,
    ) -> String {
        while !sink.is_ending() {
            match capture.next(POLL_TIMEOUT) {
                None => {}
                Some(CaptureEvent::Frame(frame)) => {
                    *reported = None;
                    if let Some(sync_tracker) = sync_tracker {
                        let (stamp, arrival) =
                            (HostTime(frame.clock_time_ns), HostTime(frame.host_time_ns));
                        // The counter of the driver, which wraps.
                        let tied = lock(sync_tracker).frame(frame.number as u32, stamp, arrival);
                        if let Some(sync) = tied {
                            sink.put(Sample::FrameSync(sync));
                        }
                    }
                    if sink.pixels_needed() {
                        sink.put(sample(frame));
                    } else {
                        sink.put(Sample::Arrival(FrameArrival {
                            number: frame.number,
                            device_ticks: frame.clock_time_ns,
                            host_time: HostTime(frame.host_time_ns),
                        }));
                    }
                }
                Some(CaptureEvent::Lost(lost)) => report_dropped(&lost, sink),
                Some(
                    CaptureEvent::Gone { element, reason }
                    | CaptureEvent::Failed { element, reason },
                ) => return format!("{element}: {reason}"),
                Some(CaptureEvent::Ended) => return "the chain has come to its end".to_owned(),
            }
        }
        "the daemon ends".to_owned()
    }

    fn unusable(&self, what: String) -> SourceError {
        SourceError::Unusable {
            source_name: self.info.description.clone(),
            what,
        }
    }
}

/// The capture reads the time on the camera's own thread.
fn host_clock() -> i64 {
    RealClock.now().0
}

fn sample(frame: CapturedFrame) -> Sample {
    fn raw<P>(frame: &CapturedFrame, image: P) -> RawFrame<P> {
        RawFrame {
            number: frame.number,
            device_ticks: frame.clock_time_ns,
            kernel_time: None,
            host_time: HostTime(frame.host_time_ns),
            exposure_ns: None,
            eyes_apart_ns: frame.eyes_apart_ns,
            image,
        }
    }
    match frame.content.clone() {
        Content::RawImage(image) => Sample::Frame(raw(&frame, image)),
        Content::Native(native) => Sample::Native(raw(&frame, native)),
    }
}

fn report_dropped(lost: &LostFrames, sink: &dyn Sink) {
    let (cause, detail) = match lost.cause {
        Cause::Overrun => (
            gap::Cause::MachineOverload,
            "they were not taken fast enough".to_owned(),
        ),
        Cause::NoPartner(eye) => (
            gap::Cause::Device,
            match eye {
                Eye::Left => "the left eye's image did not arrive".to_owned(),
                Eye::Right => "the right eye's image did not arrive".to_owned(),
            },
        ),
    };
    for number in lost.first..=lost.last {
        sink.put(Sample::Dropped(DroppedFrame {
            number,
            host_time: sink.now(),
            cause,
            detail: detail.clone(),
        }));
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::*;

    /// Stores its samples, and ends after a number of frames.
    struct RecordingSink {
        samples: Mutex<Vec<Sample>>,
        ending: AtomicBool,
        frames: usize,
    }

    impl Sink for RecordingSink {
        fn now(&self) -> HostTime {
            RealClock.now()
        }

        fn put(&self, sample: Sample) {
            let mut samples = self.samples.lock().expect("samples");
            samples.push(sample);
            let is_frame = |s: &&Sample| {
                matches!(
                    s,
                    Sample::Frame(_) | Sample::Native(_) | Sample::Disconnected(_)
                )
            };
            if samples.iter().filter(is_frame).count() >= self.frames {
                self.ending.store(true, Ordering::SeqCst);
            }
        }

        fn is_ending(&self) -> bool {
            self.ending.load(Ordering::SeqCst)
        }
    }

    fn run(chain: &str, right: Option<&str>, frames: usize) -> Result<Vec<Sample>, SourceError> {
        let config = GstreamerConfig {
            chain: chain.to_owned(),
            right_chain: right.map(str::to_owned),
            width: 64,
            height: 32,
            rate_hz: 30.0,
            start_after_ns: 0,
            imu: None,
        };
        let sink = RecordingSink {
            samples: Mutex::default(),
            ending: AtomicBool::new(false),
            frames,
        };
        Box::new(Gstreamer::new(&config)).run(&sink)?;
        Ok(sink.samples.into_inner().expect("samples"))
    }

    #[test]
    fn frames_carry_host_times() {
        let caps = "video/x-raw,format=NV12,width=64,height=32,framerate=30/1";
        let samples = run(&format!("videotestsrc is-live=true ! {caps}"), None, 5).expect("frames");
        let (mut before, mut count) = (None, 0);
        for sample in &samples {
            let frame = match sample {
                Sample::Native(frame) => frame,
                // On a busy machine this test itself may be late.
                Sample::Dropped(_) => continue,
                other => panic!("{other:?}"),
            };
            assert!(frame.device_ticks <= frame.host_time.0, "{frame:?}");
            assert!(before < Some(frame.number), "{frame:?}");
            before = Some(frame.number);
            count += 1;
        }
        assert_eq!(count, 5);
    }

    #[test]
    fn two_eyes_are_joined_into_one_frame() {
        let eye =
            "videotestsrc is-live=true ! video/x-raw,format=I420,width=32,height=32,framerate=30/1";
        let samples = run(eye, Some(eye), 3).expect("frames");
        let frames = samples.iter().filter_map(|sample| match sample {
            Sample::Frame(frame) => Some(frame.image.width),
            _ => None,
        });
        assert_eq!(frames.collect::<Vec<_>>(), [64; 3]);
    }

    #[test]
    fn ended_chain_is_reported_and_invalid_chain_is_an_error() {
        let samples = run("videotestsrc num-buffers=0 is-live=true", None, 1).expect("an end");
        assert!(
            matches!(&samples[..], [Sample::Disconnected(disconnected)] if disconnected.detail == "the chain has come to its end"),
            "{samples:?}"
        );
        let error = run("nosuchelement", None, 1)
            .expect_err("no such element")
            .to_string();
        assert!(error.contains("nosuchelement"), "{error}");
    }

    /// A slow reader is not the camera's fault, and an eye that sends nothing is not the reader's.
    #[test]
    fn dropped_frames_have_their_true_cause() {
        let sink = RecordingSink {
            samples: Mutex::default(),
            ending: AtomicBool::new(false),
            frames: 1,
        };
        for (first, last, cause) in [
            (3, 5, Cause::Overrun),
            (7, 7, Cause::NoPartner(Eye::Left)),
            (8, 8, Cause::NoPartner(Eye::Right)),
        ] {
            report_dropped(&LostFrames { first, last, cause }, &sink);
        }
        let samples = sink.samples.into_inner().expect("samples");
        let reported = samples.iter().map(|sample| match sample {
            Sample::Dropped(lost) => (lost.number, lost.cause),
            other => panic!("{other:?}"),
        });
        let (machine, device) = (gap::Cause::MachineOverload, gap::Cause::Device);
        assert_eq!(
            reported.collect::<Vec<_>>(),
            [
                (3, machine),
                (4, machine),
                (5, machine),
                (7, device),
                (8, device)
            ]
        );
    }

    #[test]
    fn first_known_element_determines_the_timestamp_policy() {
        assert_eq!(
            worth("foo ! zedsrc camera-sn=1 ! x"),
            policy::Policy::of("zedsrc")
        );
        assert_eq!(worth("foo ! bar"), policy::UNKNOWN);
    }
}
