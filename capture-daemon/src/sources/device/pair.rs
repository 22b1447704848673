//! Two cameras, one for each eye, without a common trigger.
//!
//! Contract: each camera runs as if it were alone ([`camera::run`]), on a thread of its own; their
//! frames are paired by the driver's timestamps, which are on one clock
//! ([`pairing`](crate::sources::pairing)). A frame has the number, the time and the timestamp of
//! the left one, and contains the delay of the right one. The cameras are not synchronized: a left
//! frame without a right one within the limit is dropped with that reason, right frames without a
//! left one are counted in a notice about once a minute and at the end. *A timestamp that does not
//! increase* gives a dropped frame. *While one camera is disconnected* the other's frames are
//! neither recorded nor counted: the missed frames are reported by the disconnected camera. *While
//! pixels are not needed* pairs are formed all the same and only counted and timed; so is a pair of
//! which one image has no pixels.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

use session_archive::record::paws::gap::Cause;
use session_archive::time::HostTime;
use video::RawImage;
use video::capture::Eye;
use video::raw_image::side_by_side;

use super::camera;
use crate::config::V4l2Config;
use crate::sources::pairing::{ImagePairer, PairingOutput, TimedImage, alone};
use crate::sources::{
    DevicePart, Disconnect, DroppedFrame, FrameArrival, Notice, RawFrame, Sample, Sink,
};

/// Interval between notices about right frames without a left one, ns.
const REPORT_INTERVAL_NS: i64 = 60_000_000_000;

/// A frame of one eye; without its pixels if they were not needed.
type EyeFrame = RawFrame<Option<RawImage>>;

/// Delivers pairs until the sink requests the end.
///
/// # Errors
/// The system provides no thread.
pub(super) fn run(
    [left, right]: [&V4l2Config; 2],
    within_ns: i64,
    sink: &dyn Sink,
) -> std::io::Result<()> {
    let joiner = StereoJoiner::new(within_ns, sink);
    std::thread::scope(|scope| {
        std::thread::Builder::new()
            .name("right eye".to_owned())
            .spawn_scoped(scope, || camera::run(right, None, &joiner.eye(Eye::Right)))?;
        camera::run(left, None, &joiner.eye(Eye::Left));
        Ok::<(), std::io::Error>(())
    })?;
    joiner.finish();
    Ok(())
}

/// Joins the samples of two cameras: each camera puts its samples into the sink of its eye, and
/// pairs are forwarded to one sink. Frames without a partner are dropped with the reason, or
/// counted.
pub struct StereoJoiner<'a> {
    sink: &'a dyn Sink,
    state: Mutex<State>,
}

struct State {
    pairs: ImagePairer<EyeFrame>,
    /// Unusable left frames that wait for those before them.
    bad: VecDeque<DroppedFrame>,
    /// By eye.
    disconnected: [bool; 2],
    newest_ns: [Option<i64>; 2],
    /// Number of right frames without a left one since the last notice, and the time of that
    /// notice.
    without_left: u64,
    reported: Option<HostTime>,
}

/// See [`StereoJoiner::eye`].
struct EyeSink<'a> {
    joiner: &'a StereoJoiner<'a>,
    eye: Eye,
}

impl<'a> StereoJoiner<'a> {
    /// Forwards pairs to `sink`; images whose timestamps differ by more than `within_ns` are no
    /// pair.
    pub fn new(within_ns: i64, sink: &'a dyn Sink) -> Self {
        Self {
            sink,
            state: Mutex::new(State {
                pairs: ImagePairer::new(within_ns),
                bad: VecDeque::new(),
                disconnected: [false; 2],
                newest_ns: [None; 2],
                without_left: 0,
                reported: None,
            }),
        }
    }

    /// Sink for the camera of one eye.
    pub fn eye(&'a self, eye: Eye) -> impl Sink + 'a {
        EyeSink { joiner: self, eye }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn frame(&self, eye: Eye, frame: EyeFrame) {
        let mut state = self.lock();
        let [own, other] = positions(eye);
        state.disconnected[own] = false;
        if state.disconnected[other] {
            return;
        }
        let time_ns = frame.device_ticks;
        if state.newest_ns[own].is_some_and(|newest| time_ns <= newest) {
            let detail = "its time stamp is not after that of the one before".to_owned();
            return state.unusable(
                eye,
                DroppedFrame {
                    number: frame.number,
                    host_time: frame.host_time,
                    cause: Cause::Device,
                    detail,
                },
            );
        }
        state.newest_ns[own] = Some(time_ns);
        let mut paired = Vec::new();
        let image = TimedImage { time_ns, of: frame };
        state.pairs.push(eye, image, |one| paired.push(one));
        for one in paired {
            state.forward(one, self.sink);
        }
    }

    fn lost(&self, eye: Eye, lost: DroppedFrame) {
        let mut state = self.lock();
        let [own, other] = positions(eye);
        state.disconnected[own] = false;
        if !state.disconnected[other] {
            state.unusable(eye, lost);
        }
    }

    fn disconnected(&self, eye: Eye, disconnected: Disconnect) {
        let mut state = self.lock();
        let within_ns = state.pairs.within_ns();
        state.disconnected[positions(eye)[0]] = true;
        // Its counter and its timestamps may restart, and waiting frames have no partner any more.
        state.pairs = ImagePairer::new(within_ns);
        state.newest_ns = [None; 2];
        state.bad.clear();
        self.sink.put(Sample::Disconnected(Disconnect {
            part: DevicePart::Camera,
            detail: format!("{}: {}", name(eye), disconnected.detail),
            ..disconnected
        }));
    }

    /// Forwards the frames that still wait for a partner, when both cameras have ended.
    pub fn finish(&self) {
        let mut state = self.lock();
        let mut paired = Vec::new();
        state.pairs.finish(|one| paired.push(one));
        for one in paired {
            state.forward(one, self.sink);
        }
        state.bad_before(u64::MAX, self.sink);
        state.report_without_left(self.sink);
    }
}

impl State {
    /// Handles an unusable frame of this eye.
    fn unusable(&mut self, eye: Eye, lost: DroppedFrame) {
        match eye {
            Eye::Left => self.bad.push_back(lost),
            // The left one is then unpaired.
            Eye::Right => {}
        }
    }

    fn forward(&mut self, paired: PairingOutput<EyeFrame>, sink: &dyn Sink) {
        match paired {
            PairingOutput::Both(left, right) => {
                let apart_ns = right.time_ns - left.time_ns;
                let (left, right) = (left.of, right.of);
                self.bad_before(left.number, sink);
                let host_time = left.host_time.max(right.host_time);
                let (Some(of_left), Some(of_right)) = (&left.image, &right.image) else {
                    return sink.put(Sample::Arrival(FrameArrival {
                        number: left.number,
                        device_ticks: left.device_ticks,
                        host_time,
                    }));
                };
                match side_by_side(of_left, of_right) {
                    Ok(image) => sink.put(Sample::Frame(RawFrame {
                        number: left.number,
                        device_ticks: left.device_ticks,
                        kernel_time: left.kernel_time,
                        host_time,
                        exposure_ns: left.exposure_ns,
                        eyes_apart_ns: Some(apart_ns),
                        image,
                    })),
                    Err(error) => sink.put(lost(&left, error.to_string())),
                }
            }
            PairingOutput::Unpaired(Eye::Left, left) => {
                self.bad_before(left.of.number, sink);
                sink.put(lost(&left.of, alone(Eye::Left, self.pairs.within_ns())));
            }
            PairingOutput::Unpaired(Eye::Right, right) => {
                self.without_left += 1;
                let now = right.of.host_time;
                let reported = *self.reported.get_or_insert(now);
                if now.since(reported) >= REPORT_INTERVAL_NS {
                    self.reported = Some(now);
                    self.report_without_left(sink);
                }
            }
        }
    }

    /// Reports unusable left frames before `number` as dropped.
    fn bad_before(&mut self, number: u64, sink: &dyn Sink) {
        // A restarted counter is not compared with earlier numbers: those were discarded.
        while let Some(bad) = self.bad.pop_front_if(|bad| bad.number < number) {
            sink.put(Sample::Dropped(bad));
        }
    }

    fn report_without_left(&mut self, sink: &dyn Sink) {
        let count = std::mem::take(&mut self.without_left);
        if count > 0 {
            sink.put(Sample::Notice(Notice {
                host_time: sink.now(),
                part: DevicePart::Camera,
                text: format!(
                    "{count} frames of the right camera have no left one within {:.1} ms",
                    self.pairs.within_ns() as f64 * 1e-6
                ),
            }));
        }
    }
}

impl Sink for EyeSink<'_> {
    fn now(&self) -> HostTime {
        self.joiner.sink.now()
    }

    fn put(&self, sample: Sample) {
        match sample {
            Sample::Frame(frame) => self.joiner.frame(self.eye, with_pixels(frame)),
            Sample::Arrival(seen) => self.joiner.frame(self.eye, without_pixels(seen)),
            Sample::Dropped(lost) => self.joiner.lost(self.eye, lost),
            Sample::Disconnected(disconnected) => self.joiner.disconnected(self.eye, disconnected),
            Sample::Notice(notice) => self.joiner.sink.put(Sample::Notice(Notice {
                text: format!("{}: {}", name(self.eye), notice.text),
                ..notice
            })),
            // V4L2 cameras deliver no others.
            Sample::Native(_) | Sample::Imu(_) | Sample::FrameSync(_) => {}
        }
    }

    fn pixels_needed(&self) -> bool {
        self.joiner.sink.pixels_needed()
    }

    fn is_ending(&self) -> bool {
        self.joiner.sink.is_ending()
    }
}

/// Position of an eye, and of the other one.
fn positions(eye: Eye) -> [usize; 2] {
    match eye {
        Eye::Left => [0, 1],
        Eye::Right => [1, 0],
    }
}

fn name(eye: Eye) -> &'static str {
    match eye {
        Eye::Left => "left camera",
        Eye::Right => "right camera",
    }
}

fn with_pixels(frame: RawFrame) -> EyeFrame {
    EyeFrame {
        number: frame.number,
        device_ticks: frame.device_ticks,
        kernel_time: frame.kernel_time,
        host_time: frame.host_time,
        exposure_ns: frame.exposure_ns,
        eyes_apart_ns: frame.eyes_apart_ns,
        image: Some(frame.image),
    }
}

fn without_pixels(seen: FrameArrival) -> EyeFrame {
    EyeFrame {
        number: seen.number,
        device_ticks: seen.device_ticks,
        kernel_time: None,
        host_time: seen.host_time,
        exposure_ns: None,
        eyes_apart_ns: None,
        image: None,
    }
}

fn lost(frame: &EyeFrame, detail: String) -> Sample {
    Sample::Dropped(DroppedFrame {
        number: frame.number,
        host_time: frame.host_time,
        cause: Cause::Device,
        detail,
    })
}

#[cfg(test)]
mod tests;
