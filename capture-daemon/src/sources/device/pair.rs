//! Two cameras, one for each eye, that expose each by itself.
//!
//! Contract: each camera is run as if it were alone ([`camera::run`]), on a thread of its own; their frames are paired by
//! the driver's time stamps, which are of one clock ([`pairing`](crate::sources::pairing)). A frame has the number, the time
//! and the stamp of the left one, and says by how much later the right one was taken. Nothing synchronises the two: a left
//! frame without a right one near enough is lost with that reason, right ones without a left one are counted in a notice
//! about once a minute and at the end. *A stamp that does not rise* makes a lost frame. *While one camera is gone* the other's
//! frames are neither recorded nor counted: what is missed is told by the camera that is gone. *While pixels are not wanted*
//! pairs are found all the same and are only counted and timed; so is one of which an eye came without them.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

use session_archive::record::paws::gap::Cause;
use session_archive::time::HostTime;
use video::Picture;
use video::capture::Eye;
use video::picture::side_by_side;

use super::camera;
use crate::config::V4l2Config;
use crate::sources::pairing::{Half, Paired, Pairs, alone};
use crate::sources::{Gone, Lost, Notice, Part, RawFrame, Sample, Seen, Sink};

/// Right frames without a left one are told of this often, ns.
const TELL_NS: i64 = 60_000_000_000;

/// A frame of one eye; without its pixels where nobody wanted them.
type EyeFrame = RawFrame<Option<Picture>>;

/// Delivers pairs until the sink says that it is to end.
///
/// # Errors
/// The system gives no thread.
pub(super) fn run(
    [left, right]: [&V4l2Config; 2],
    within_ns: i64,
    sink: &dyn Sink,
) -> std::io::Result<()> {
    let joined = Joined::new(within_ns, sink);
    std::thread::scope(|scope| {
        std::thread::Builder::new()
            .name("right eye".to_owned())
            .spawn_scoped(scope, || camera::run(right, None, &joined.eye(Eye::Right)))?;
        camera::run(left, None, &joined.eye(Eye::Left));
        Ok::<(), std::io::Error>(())
    })?;
    joined.finish();
    Ok(())
}

/// Joins what two cameras deliver: each puts its samples into the sink of its eye, and pairs go on to one sink. What has no
/// partner is lost with the reason, or counted.
pub struct Joined<'a> {
    sink: &'a dyn Sink,
    state: Mutex<State>,
}

struct State {
    pairs: Pairs<EyeFrame>,
    /// Left frames that cannot be used and wait for those before them.
    bad: VecDeque<Lost>,
    /// By eye.
    gone: [bool; 2],
    newest_ns: [Option<i64>; 2],
    /// Right frames without a left one that nobody was told of, and when that was.
    without_left: u64,
    told: Option<HostTime>,
}

/// See [`Joined::eye`].
struct EyeSink<'a> {
    joined: &'a Joined<'a>,
    eye: Eye,
}

impl<'a> Joined<'a> {
    /// Hands pairs on to `sink`; images that are further apart than `within_ns` by their stamps are none.
    pub fn new(within_ns: i64, sink: &'a dyn Sink) -> Self {
        Self {
            sink,
            state: Mutex::new(State {
                pairs: Pairs::new(within_ns),
                bad: VecDeque::new(),
                gone: [false; 2],
                newest_ns: [None; 2],
                without_left: 0,
                told: None,
            }),
        }
    }

    /// Where the camera of one eye puts its samples.
    pub fn eye(&'a self, eye: Eye) -> impl Sink + 'a {
        EyeSink { joined: self, eye }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn frame(&self, eye: Eye, frame: EyeFrame) {
        let mut state = self.lock();
        let [own, other] = positions(eye);
        state.gone[own] = false;
        if state.gone[other] {
            return;
        }
        let time_ns = frame.device_ticks;
        if state.newest_ns[own].is_some_and(|newest| time_ns <= newest) {
            let detail = "its time stamp is not after that of the one before".to_owned();
            return state.unusable(
                eye,
                Lost {
                    number: frame.number,
                    host_time: frame.host_time,
                    cause: Cause::Device,
                    detail,
                },
            );
        }
        state.newest_ns[own] = Some(time_ns);
        let mut paired = Vec::new();
        let half = Half { time_ns, of: frame };
        state.pairs.push(eye, half, |one| paired.push(one));
        for one in paired {
            state.hand_on(one, self.sink);
        }
    }

    fn lost(&self, eye: Eye, lost: Lost) {
        let mut state = self.lock();
        let [own, other] = positions(eye);
        state.gone[own] = false;
        if !state.gone[other] {
            state.unusable(eye, lost);
        }
    }

    fn gone(&self, eye: Eye, gone: Gone) {
        let mut state = self.lock();
        let within_ns = state.pairs.within_ns();
        state.gone[positions(eye)[0]] = true;
        // Its counter and its stamps may begin again, and what waits has no partner any more.
        state.pairs = Pairs::new(within_ns);
        state.newest_ns = [None; 2];
        state.bad.clear();
        self.sink.put(Sample::Gone(Gone {
            part: Part::Camera,
            detail: format!("{}: {}", name(eye), gone.detail),
            ..gone
        }));
    }

    /// Hands on what still waits for a partner, when both cameras have ended.
    pub fn finish(&self) {
        let mut state = self.lock();
        let mut paired = Vec::new();
        state.pairs.finish(|one| paired.push(one));
        for one in paired {
            state.hand_on(one, self.sink);
        }
        state.bad_before(u64::MAX, self.sink);
        state.tell_without_left(self.sink);
    }
}

impl State {
    /// A frame of this eye cannot be used.
    fn unusable(&mut self, eye: Eye, lost: Lost) {
        match eye {
            Eye::Left => self.bad.push_back(lost),
            // The left one is alone then.
            Eye::Right => {}
        }
    }

    fn hand_on(&mut self, paired: Paired<EyeFrame>, sink: &dyn Sink) {
        match paired {
            Paired::Both(left, right) => {
                let apart_ns = right.time_ns - left.time_ns;
                let (left, right) = (left.of, right.of);
                self.bad_before(left.number, sink);
                let host_time = left.host_time.max(right.host_time);
                let (Some(of_left), Some(of_right)) = (&left.picture, &right.picture) else {
                    return sink.put(Sample::Seen(Seen {
                        number: left.number,
                        device_ticks: left.device_ticks,
                        host_time,
                    }));
                };
                match side_by_side(of_left, of_right) {
                    Ok(picture) => sink.put(Sample::Frame(RawFrame {
                        number: left.number,
                        device_ticks: left.device_ticks,
                        kernel_time: left.kernel_time,
                        host_time,
                        exposure_ns: left.exposure_ns,
                        eyes_apart_ns: Some(apart_ns),
                        picture,
                    })),
                    Err(error) => sink.put(lost(&left, error.to_string())),
                }
            }
            Paired::Alone(Eye::Left, left) => {
                self.bad_before(left.of.number, sink);
                sink.put(lost(&left.of, alone(Eye::Left, self.pairs.within_ns())));
            }
            Paired::Alone(Eye::Right, right) => {
                self.without_left += 1;
                let now = right.of.host_time;
                let told = *self.told.get_or_insert(now);
                if now.since(told) >= TELL_NS {
                    self.told = Some(now);
                    self.tell_without_left(sink);
                }
            }
        }
    }

    /// Says of unusable left frames before `number` that they are lost.
    fn bad_before(&mut self, number: u64, sink: &dyn Sink) {
        // A counter that has begun again is not compared with what was before: that was thrown away.
        while let Some(bad) = self.bad.pop_front_if(|bad| bad.number < number) {
            sink.put(Sample::Lost(bad));
        }
    }

    fn tell_without_left(&mut self, sink: &dyn Sink) {
        let count = std::mem::take(&mut self.without_left);
        if count > 0 {
            sink.put(Sample::Notice(Notice {
                host_time: sink.now(),
                part: Part::Camera,
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
        self.joined.sink.now()
    }

    fn put(&self, sample: Sample) {
        match sample {
            Sample::Frame(frame) => self.joined.frame(self.eye, with_pixels(frame)),
            Sample::Seen(seen) => self.joined.frame(self.eye, without_pixels(seen)),
            Sample::Lost(lost) => self.joined.lost(self.eye, lost),
            Sample::Gone(gone) => self.joined.gone(self.eye, gone),
            Sample::Notice(notice) => self.joined.sink.put(Sample::Notice(Notice {
                text: format!("{}: {}", name(self.eye), notice.text),
                ..notice
            })),
            // Cameras of the kernel's give no others.
            Sample::Native(_) | Sample::Imu(_) | Sample::FrameSync(_) => {}
        }
    }

    fn wants_pixels(&self) -> bool {
        self.joined.sink.wants_pixels()
    }

    fn is_ending(&self) -> bool {
        self.joined.sink.is_ending()
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
        picture: Some(frame.picture),
    }
}

fn without_pixels(seen: Seen) -> EyeFrame {
    EyeFrame {
        number: seen.number,
        device_ticks: seen.device_ticks,
        kernel_time: None,
        host_time: seen.host_time,
        exposure_ns: None,
        eyes_apart_ns: None,
        picture: None,
    }
}

fn lost(frame: &EyeFrame, detail: String) -> Sample {
    Sample::Lost(Lost {
        number: frame.number,
        host_time: frame.host_time,
        cause: Cause::Device,
        detail,
    })
}

#[cfg(test)]
mod tests;
