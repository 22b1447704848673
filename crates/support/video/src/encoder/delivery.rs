//! Between the encoder's threads and its owner: which frames are inside, whether what comes out
//! is what went in, and the one failure.
//!
//! Contract: the callback sees access units in the order of the frames, then at most one failure,
//! then nothing. A waiting owner is woken by every access unit, by the end and by the failure.

use std::collections::{HashSet, VecDeque};
use std::fmt;
use std::sync::{Condvar, Mutex};
use std::time::Duration;

use bytes::Bytes;
use gstreamer as gst;
use gstreamer::prelude::*;

use super::{AccessUnit, EncoderEvent, OnOutput};
use crate::pipeline::{lock, wait_while};
use crate::{Codec, annexb};

/// Maximum difference of an encoder's time from the frame's own (drivers count microseconds). The
/// frame's own time is what comes out.
const TIME_SLACK_NS: u64 = 1_000;

/// What the pushing thread and the encoder's threads share.
pub(super) struct Shared {
    codec: Codec,
    pub(super) state: Mutex<State>,
    pub(super) changed: Condvar,
    /// Where both are needed, locked before `state`.
    on_output: Mutex<OnOutput>,
}

/// A frame inside the encoder.
#[derive(Debug, Clone, Copy)]
pub(super) struct Inside {
    /// The time that its buffer carries, ns.
    pub(super) stamp_ns: i64,
    /// The time that its access unit is to have, ns.
    pub(super) pts_ns: i64,
}

#[derive(Debug, Default)]
pub(super) struct State {
    /// The frames inside, oldest first.
    pub(super) in_flight: VecDeque<Inside>,
    /// Stamps of frames to be made key frames by signal.
    pub(super) to_force: HashSet<i64>,
    /// Access units delivered so far.
    pub(super) delivered: u64,
    pub(super) ended: bool,
    pub(super) failure: Option<String>,
}

impl fmt::Debug for Shared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Shared")
            .field("state", &self.state)
            .finish_non_exhaustive()
    }
}

impl Shared {
    pub(super) fn new(codec: Codec, on_output: OnOutput) -> Shared {
        let on_output = Mutex::new(on_output);
        Shared {
            codec,
            state: Mutex::default(),
            changed: Condvar::new(),
            on_output,
        }
    }

    /// Ends everything: the reason is reported once, later events are swallowed.
    pub(super) fn fail(&self, reason: String) {
        {
            let mut state = lock(&self.state);
            if state.failure.is_some() {
                return;
            }
            state.failure = Some(reason.clone());
        }
        self.changed.notify_all();
        (lock(&self.on_output))(EncoderEvent::Failed(reason));
    }

    /// Delivers one sample of the encoder. `Err` stops the pipeline quietly: the failure has been
    /// reported.
    pub(super) fn deliver(&self, sample: &gst::Sample) -> Result<gst::FlowSuccess, gst::FlowError> {
        let unit = match self.access_unit(sample) {
            Ok(unit) => unit,
            Err(reason) => {
                self.fail(reason);
                return Err(gst::FlowError::Flushing);
            }
        };
        {
            let mut on_output = lock(&self.on_output);
            if lock(&self.state).failure.is_some() {
                return Err(gst::FlowError::Flushing);
            }
            on_output(EncoderEvent::AccessUnit(unit));
        }
        let mut state = lock(&self.state);
        state.in_flight.pop_front();
        state.delivered += 1;
        drop(state);
        self.changed.notify_all();
        Ok(gst::FlowSuccess::Ok)
    }

    /// Checks that `sample` is the access unit of the oldest frame inside.
    fn access_unit(&self, sample: &gst::Sample) -> Result<AccessUnit, String> {
        let buffer = sample
            .buffer()
            .ok_or("it gave an access unit without data")?;
        let data = buffer.map_readable().map_err(|error| error.to_string())?;
        let data = Bytes::copy_from_slice(&data);
        // x264enc and x265enc shift the buffer's own time by 1000 hours (to have room for
        // negative decoding times) and say so in the segment; the running time is what went in.
        let running = sample
            .segment()
            .and_then(|segment| segment.downcast_ref::<gst::ClockTime>())
            .and_then(|segment| segment.to_running_time(buffer.pts()?))
            .ok_or("it gave an access unit without a time")?
            .nseconds();
        let oldest = lock(&self.state).in_flight.front().copied();
        let Inside { stamp_ns, pts_ns } =
            oldest.ok_or_else(|| format!("it gave one access unit too many, at {running} ns"))?;
        if running.abs_diff(stamp_ns as u64) > TIME_SLACK_NS {
            return Err(format!(
                "it gave an access unit for {running} ns, expected the one of the frame at \
                 {stamp_ns} ns"
            ));
        }
        let key = annexb::is_key(self.codec, &data);
        if key && !annexb::has_parameter_sets(self.codec, &data) {
            return Err(format!(
                "its key frame at {pts_ns} ns has no parameter sets"
            ));
        }
        Ok(AccessUnit { pts_ns, data, key })
    }

    /// Called as a frame enters an encoder whose key frames are forced by `signal`. Waits at
    /// most `limit` for earlier frames to come out.
    pub(super) fn force_by_signal(
        &self,
        encoder: &gst::Element,
        signal: &str,
        time: Option<gst::ClockTime>,
        limit: Duration,
    ) {
        let Some(time) = time.map(|time| time.nseconds() as i64) else {
            return;
        };
        let mut state = lock(&self.state);
        if !state.to_force.remove(&time) {
            return;
        }
        // The signal hits whatever the device takes next. Bounded, in case the encoder gives a
        // frame only when the next one is there: then the key frame may be early, which the trial
        // encode notices.
        let (state, _) = wait_while(&self.changed, state, limit, |state| {
            let oldest = state.in_flight.front();
            state.failure.is_none() && oldest.is_some_and(|oldest| oldest.stamp_ns < time)
        });
        drop(state);
        encoder.emit_by_name::<()>(signal, &[]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline;
    use std::sync::Arc;
    use std::sync::mpsc::{Receiver, sync_channel};

    fn shared(in_flight: &[i64]) -> (Arc<Shared>, Receiver<EncoderEvent>) {
        pipeline::init().unwrap();
        let (send, receive) = sync_channel(10);
        let on_output: OnOutput = Box::new(move |event| send.send(event).unwrap());
        let shared = Arc::new(Shared::new(Codec::H264, on_output));
        let in_flight = in_flight.iter().map(|&pts_ns| Inside {
            stamp_ns: pts_ns,
            pts_ns,
        });
        lock(&shared.state).in_flight.extend(in_flight);
        (shared, receive)
    }

    fn sample(time: u64, data: &'static [u8]) -> gst::Sample {
        let mut buffer = gst::Buffer::from_slice(data);
        // As x264enc does it: the buffer's own time is 1000 h late, and the segment says so.
        let shift = gst::ClockTime::from_seconds(3_600_000);
        buffer
            .get_mut()
            .unwrap()
            .set_pts(gst::ClockTime::from_nseconds(time) + shift);
        let mut segment = gst::FormattedSegment::<gst::ClockTime>::new();
        segment.set_start(shift);
        gst::Sample::builder()
            .buffer(&buffer)
            .segment(&segment)
            .build()
    }

    const DELTA: &[u8] = &[0, 0, 0, 1, 0x41, 0x9a];

    #[test]
    fn the_image_s_own_time_comes_out() {
        let (shared, events) = shared(&[1_000_000_007, 2_000_000_009]);
        // A driver that counts microseconds.
        shared.deliver(&sample(1_000_000_000, DELTA)).unwrap();
        shared.deliver(&sample(2_000_000_009, DELTA)).unwrap();
        drop(shared);
        let times: Vec<i64> = events
            .iter()
            .map(|event| match event {
                EncoderEvent::AccessUnit(unit) => unit.pts_ns,
                EncoderEvent::Failed(reason) => panic!("{reason}"),
            })
            .collect();
        assert_eq!(times, [1_000_000_007, 2_000_000_009]);
    }

    #[test]
    fn wrong_access_units_are_one_failure() {
        // A frame left out, one too many, a key frame that cannot be decoded alone.
        let cases: [(&[i64], u64, &'static [u8]); 3] = [
            (&[10_000, 20_000], 20_000, DELTA),
            (&[], 10_000, DELTA),
            (&[10_000], 10_000, &[0, 0, 0, 1, 0x65, 0x88]),
        ];
        for (in_flight, time, data) in cases {
            let (shared, events) = shared(in_flight);
            assert!(shared.deliver(&sample(time, data)).is_err());
            assert!(shared.deliver(&sample(time, DELTA)).is_err());
            shared.fail("again".into());
            drop(shared);
            let events: Vec<EncoderEvent> = events.iter().collect();
            assert!(
                matches!(&events[..], [EncoderEvent::Failed(_)]),
                "{events:?}"
            );
        }
    }

    /// With an element that happens to have an action signal: the real one needs a Jetson.
    #[test]
    fn a_forcing_signal_waits_for_earlier_images() {
        let (shared, _events) = shared(&[5, 9]);
        let element = pipeline::make("splitmuxsink").unwrap();
        assert!(pipeline::has_action(&element, "split-now"));
        assert!(!pipeline::has_action(&element, "no-such-signal"));
        let (send, signals) = sync_channel(10);
        element.connect("split-now", false, move |_| {
            send.send(()).unwrap();
            None
        });
        let force = |time| {
            let time = Some(gst::ClockTime::from_nseconds(time));
            shared.force_by_signal(&element, "split-now", time, Duration::ZERO);
            signals.try_iter().count()
        };
        assert_eq!(force(5), 0, "no key frame was requested");
        lock(&shared.state).to_force.insert(9);
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| {
                let (time, limit) = (gst::ClockTime::from_nseconds(9), Duration::from_secs(60));
                shared.force_by_signal(&element, "split-now", Some(time), limit);
                lock(&shared.state)
                    .in_flight
                    .front()
                    .map(|oldest| oldest.pts_ns)
            });
            shared.deliver(&sample(5, DELTA)).unwrap();
            assert_eq!(waiting.join().unwrap(), Some(9));
        });
        assert_eq!(signals.try_iter().count(), 1);
        assert_eq!(force(9), 0, "once is enough");
    }
}
