//! The thread of a source: its samples go into the queue of the hub.

use std::sync::atomic::{AtomicI64, Ordering};

use session_archive::time::{HostTime, NS_PER_S};

use super::shared::{HubInput, INBOX_CAPACITY_BYTES, Shared};
use super::waiting::wait_until;
use crate::clock::Clock as _;
use crate::error_chain::with_causes;
use crate::realtime_priority;
use crate::sources::{AnySource, RawFrame, Sample, Sink, Source, SourceError};

/// Maximum number of frames in their cameras' own buffers in that queue, of all cameras together.
const MAX_NATIVE_FRAMES: usize = 6;
/// While nobody stores frames, one frame per this interval is previewed and checked, ns; the others
/// are only counted and timed.
const IDLE_PREVIEW_PERIOD_NS: i64 = NS_PER_S;
/// Maximum lag of a source behind its schedule, ns. With more it has to skip samples.
const MAX_LAG_NS: i64 = NS_PER_S / 2;

/// Thread of a source: passes everything to the hub.
pub(super) fn pump(i: usize, source: AnySource, shared: &Shared) {
    let hub_sink = HubSink {
        source: i,
        shared,
        shown: AtomicI64::new(i64::MIN),
    };
    let ended = match source {
        AnySource::Scheduled(source) => replay(source, &hub_sink),
        AnySource::Live(source) => {
            realtime_priority::this_thread();
            source.run(&hub_sink)
        }
    };
    let failure = ended.err().map(|error| with_causes(&error));
    let _ = shared.inbox.push_reserved(HubInput::Ended(i, failure), 0);
}

/// Waits for the arrival time of each sample.
fn replay(mut source: Box<dyn Source>, hub_sink: &HubSink<'_>) -> Result<(), SourceError> {
    loop {
        source.set_pixels_needed(hub_sink.pixels_needed());
        let Some(sample) = source.next_sample()? else {
            break;
        };
        if !wait_until(sample.host_time(), hub_sink.shared) {
            break;
        }
        let now = hub_sink.now();
        let is_behind = now.since(sample.host_time()) > MAX_LAG_NS;
        hub_sink.put(sample);
        if is_behind {
            // They follow it in the order of their numbers.
            for lost in source.skip_overdue(now) {
                hub_sink.put(Sample::Dropped(lost));
            }
        }
    }
    Ok(())
}

/// Sink of one source's samples, into the hub's queue.
struct HubSink<'a> {
    source: usize,
    shared: &'a Shared,
    /// Time of the newest frame with pixels.
    shown: AtomicI64,
}

impl Sink for HubSink<'_> {
    fn now(&self) -> HostTime {
        self.shared.clock.now()
    }

    fn pixels_needed(&self) -> bool {
        let shown = self.shown.load(Ordering::Relaxed);
        !self.shared.is_idle() || self.now().0.saturating_sub(shown) >= IDLE_PREVIEW_PERIOD_NS
    }

    fn put(&self, sample: Sample) {
        if matches!(sample, Sample::Frame(_) | Sample::Native(_)) {
            self.shown.store(self.now().0, Ordering::Relaxed);
        }
        let (i, inbox) = (self.source, &self.shared.inbox);
        // Cameras lend few of their own buffers, so the number of waiting ones is limited, however
        // small they are.
        let bytes = match &sample {
            Sample::Native(_) => sample.bytes().max(INBOX_CAPACITY_BYTES / MAX_NATIVE_FRAMES),
            _ => sample.bytes(),
        };
        // A push is rejected only at the end.
        let _ = match &sample {
            Sample::Frame(RawFrame {
                number, host_time, ..
            })
            | Sample::Native(RawFrame {
                number, host_time, ..
            }) => {
                let dropped = HubInput::Dropped(i, *number, *host_time);
                inbox
                    .try_push(HubInput::Sample(i, sample), bytes)
                    .or_else(|_| inbox.push_reserved(dropped, 0))
            }
            // Their times are already taken, and the hub gathers them anyway.
            Sample::Imu(_) | Sample::Arrival(_) => {
                inbox.push_gathered(HubInput::Sample(i, sample), bytes)
            }
            _ => inbox.push_reserved(HubInput::Sample(i, sample), bytes),
        };
    }

    fn is_ending(&self) -> bool {
        self.shared.ending.is_set()
    }
}
