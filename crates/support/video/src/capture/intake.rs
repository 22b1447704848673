//! Between the threads of the cameras and the one that takes frames: a short queue.
//!
//! Contract: a camera's thread never waits here. When the queue is full the new frame is dropped
//! and counted, and reported as [`super::LostFrames`] in front of the next one. After the end
//! nothing is taken any more; what was queued before comes out first.

use std::collections::VecDeque;
use std::fmt;
use std::sync::{Condvar, Mutex};
use std::time::Duration;

use super::feed::Arrival;
use super::number::Numbering;
use super::pair::{Eye, Half, Pairing, PairingOutput};
use super::{CaptureEvent, Cause, Counts, HostClock, LostFrames};
use crate::pipeline::{Failure, lock, wait_while};

/// A frame that has arrived, not yet converted.
#[derive(Debug)]
pub(super) struct ArrivedFrame {
    pub(super) number: u64,
    pub(super) repeated: bool,
    pub(super) host_time_ns: i64,
    pub(super) arrival: Arrival,
}

/// An item of the queue.
#[derive(Debug)]
pub(super) enum Item {
    Frame(ArrivedFrame),
    /// Left and right.
    Eyes(ArrivedFrame, ArrivedFrame),
    Lost(LostFrames),
    End(CaptureEvent),
}

/// Input side of one chain.
pub(super) struct Port {
    /// Which eye, if there are two chains.
    pub(super) eye: Option<Eye>,
    pub(super) numbering: Mutex<Numbering>,
}

pub(super) struct Intake {
    clock: HostClock,
    /// Frames, or pairs, that may wait.
    limit: usize,
    state: Mutex<State>,
    changed: Condvar,
}

impl fmt::Debug for Intake {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Intake")
            .field("state", &self.state)
            .finish_non_exhaustive()
    }
}

#[derive(Debug)]
struct State {
    items: VecDeque<Item>,
    /// Of those, frames.
    frames: usize,
    pairing: Pairing<ArrivedFrame>,
    counts: Counts,
    /// Lost since the last frame that was queued.
    lost: VecDeque<LostFrames>,
    end: Option<CaptureEvent>,
    abandoned: bool,
}

impl Intake {
    pub(super) fn new(clock: HostClock, limit: usize, rate_hz: f64) -> Intake {
        Intake {
            clock,
            limit,
            state: Mutex::new(State {
                items: VecDeque::new(),
                frames: 0,
                pairing: Pairing::new(rate_hz),
                counts: Counts::default(),
                lost: VecDeque::new(),
                end: None,
                abandoned: false,
            }),
            changed: Condvar::new(),
        }
    }

    pub(super) fn now(&self) -> i64 {
        (self.clock)()
    }

    /// A frame has come through `port`, at `host_ns`.
    pub(super) fn arrived(&self, port: &Port, host_ns: i64, arrival: Result<Arrival, String>) {
        let arrival = match arrival {
            Ok(arrival) => arrival,
            Err(reason) => return self.end(CaptureEvent::failed("the chain", reason)),
        };
        let numbered = lock(&port.numbering).next(arrival.clock_time_ns, arrival.offset);
        let arrived = ArrivedFrame {
            number: numbered.number,
            repeated: numbered.repeated,
            host_time_ns: host_ns,
            arrival,
        };
        let mut state = lock(&self.state);
        if state.end.is_some() || state.abandoned {
            return;
        }
        state.counts.missing += numbered.missing;
        state.counts.repeated += u64::from(numbered.repeated);
        match port.eye {
            None => {
                let number = arrived.number;
                state.queue(Item::Frame(arrived), number, self.limit);
            }
            Some(eye) => {
                let half = Half {
                    number: arrived.number,
                    time_ns: arrived.arrival.clock_time_ns,
                    frame: arrived,
                };
                let mut pairs = Vec::new();
                state
                    .pairing
                    .push(eye, half, &mut |paired| pairs.push(paired));
                pairs
                    .into_iter()
                    .for_each(|paired| state.paired(paired, self.limit));
            }
        }
        drop(state);
        self.changed.notify_all();
    }

    pub(super) fn failed(&self, failure: &Failure, expected: &str) {
        let mut reason = failure.reason.clone();
        if ["not-negotiated", "not-linked"]
            .iter()
            .any(|said| reason.contains(said))
        {
            reason = format!("{reason}; expected {expected}");
        }
        self.end(if failure.device {
            CaptureEvent::Gone {
                element: failure.element.clone(),
                reason,
            }
        } else {
            CaptureEvent::failed(&failure.element, reason)
        });
    }

    pub(super) fn ended(&self) {
        self.end(CaptureEvent::Ended);
    }

    /// The pipeline would not start. If an element said why, that was reported before.
    pub(super) fn not_started(&self, reason: &str) {
        self.end(CaptureEvent::failed("the chain", reason.to_owned()));
    }

    /// The first end is the one that counts.
    fn end(&self, event: CaptureEvent) {
        let mut state = lock(&self.state);
        if state.end.is_none() {
            let mut pairs = Vec::new();
            state.pairing.finish(&mut |paired| pairs.push(paired));
            pairs
                .into_iter()
                .for_each(|paired| state.paired(paired, self.limit));
            state.tell_lost();
            state.end = Some(event);
        }
        drop(state);
        self.changed.notify_all();
    }

    /// Waits for `delay`; `false` if the owner was dropped meanwhile.
    pub(super) fn wait_to_start(&self, delay: Duration) -> bool {
        let state = lock(&self.state);
        let (state, _) = wait_while(&self.changed, state, delay, |state| !state.abandoned);
        !state.abandoned
    }

    /// The owner was dropped: nothing is accepted any more.
    pub(super) fn abandon(&self) {
        let mut state = lock(&self.state);
        state.abandoned = true;
        // Frames go back to their camera now.
        state.items.clear();
        drop(state);
        self.changed.notify_all();
    }

    pub(super) fn is_abandoned(&self) -> bool {
        lock(&self.state).abandoned
    }

    pub(super) fn counts(&self) -> Counts {
        lock(&self.state).counts
    }

    /// The next item, waiting at most `timeout` for it.
    pub(super) fn take(&self, timeout: Duration) -> Option<Item> {
        let state = lock(&self.state);
        let (mut state, _) = wait_while(&self.changed, state, timeout, |state| {
            state.items.is_empty() && state.end.is_none()
        });
        let item = state.items.pop_front();
        if let Some(Item::Frame(_) | Item::Eyes(..)) = item {
            state.frames -= 1;
            state.counts.delivered += 1;
        }
        item.or_else(|| state.end.clone().map(Item::End))
    }
}

impl State {
    /// Queues a frame, or drops it if there is no room.
    fn queue(&mut self, item: Item, number: u64, limit: usize) {
        if self.frames >= limit {
            self.counts.overrun += 1;
            self.note_lost(number, Cause::Overrun);
            return;
        }
        self.tell_lost();
        self.frames += 1;
        self.items.push_back(item);
    }

    fn paired(&mut self, paired: PairingOutput<ArrivedFrame>, limit: usize) {
        match paired {
            PairingOutput::Both(left, right) => {
                let number = left.number;
                self.queue(Item::Eyes(left.frame, right.frame), number, limit);
            }
            PairingOutput::Alone { missing, number } => {
                self.counts.unpaired += 1;
                if let Some(number) = number {
                    self.note_lost(number, Cause::NoPartner(missing));
                }
            }
        }
    }

    /// Runs of numbers are reported as one.
    fn note_lost(&mut self, number: u64, cause: Cause) {
        match self.lost.back_mut() {
            Some(lost) if lost.cause == cause && number == lost.last.wrapping_add(1) => {
                lost.last = number;
            }
            _ => self.lost.push_back(LostFrames {
                first: number,
                last: number,
                cause,
            }),
        }
        // With causes that alternate while nobody takes anything: the oldest are reported now, and
        // if even that is too much, the counts still know.
        const RUNS: usize = 64;
        if self.lost.len() > RUNS {
            self.lost.pop_front();
        }
    }

    fn tell_lost(&mut self) {
        self.items.extend(self.lost.drain(..).map(Item::Lost));
    }
}
