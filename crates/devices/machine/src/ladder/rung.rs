//! One rung: a threshold with hysteresis and dwell times. Each stands alone, so that the ladder as
//! a whole is monotone because its rungs are.

use super::{Quantity, Step};
use crate::NS_PER_S;

/// Each reading is judged together with those before it, a fixed number in total, by the median: a
/// single glitch is never the middle, in neither direction.
pub const READINGS: usize = 3;
/// How long a reading counts when none follows it.
pub const STALE_NS: i64 = 10 * NS_PER_S;

/// When a rung that was entered is left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Leave {
    /// After the reading has been better for so long, ns.
    After(i64),
    /// When the next recording begins.
    NextRecording,
}

#[derive(Clone, Debug)]
pub(super) struct Rung {
    pub(super) quantity: Quantity,
    pub(super) step: Step,
    /// Entered when the badness is at least this much …
    pub(super) enter: f64,
    /// … for so long.
    pub(super) enter_ns: i64,
    /// Left when it is at most this much.
    pub(super) leave_at: f64,
    pub(super) leave: Leave,
    state: State,
}

#[derive(Clone, Debug, Default)]
struct State {
    is_entered: bool,
    /// Time since which it has been changing to the other side.
    since: Option<i64>,
    /// The last readings, newest last.
    readings: Vec<f64>,
    last_reading: Option<i64>,
}

impl State {
    /// What counts at `at_ns`; none while there is no news.
    fn middle(&mut self, at_ns: i64, reading: Option<f64>) -> Option<f64> {
        match reading {
            Some(reading) => {
                self.last_reading = Some(at_ns);
                if self.readings.len() == READINGS {
                    self.readings.remove(0);
                }
                self.readings.push(reading);
                let mut sorted = self.readings.clone();
                sorted.sort_by(f64::total_cmp);
                (sorted.len() == READINGS).then(|| sorted[READINGS / 2])
            }
            None if self
                .last_reading
                .is_some_and(|last| at_ns - last < STALE_NS) =>
            {
                None
            }
            // Its sensor has vanished, or never existed.
            None => {
                self.readings.clear();
                Some(f64::NEG_INFINITY)
            }
        }
    }
}

impl Rung {
    pub(super) fn new(
        quantity: Quantity,
        step: Step,
        (enter, enter_ns): (f64, i64),
        (leave_at, leave): (f64, Leave),
    ) -> Self {
        Self {
            quantity,
            step,
            enter,
            enter_ns,
            leave_at,
            leave,
            state: State::default(),
        }
    }

    pub(super) fn is_entered(&self) -> bool {
        self.state.is_entered
    }

    /// `badness` grows with the pressure.
    pub(super) fn reading(&mut self, at_ns: i64, badness: Option<f64>) {
        let state = &mut self.state;
        let Some(badness) = state.middle(at_ns, badness.filter(|b| !b.is_nan())) else {
            return;
        };
        let (crosses, dwell_ns) = match (state.is_entered, self.leave) {
            (false, _) => (badness >= self.enter, self.enter_ns),
            (true, Leave::After(ns)) => (badness <= self.leave_at, ns),
            (true, Leave::NextRecording) => (false, 0),
        };
        if !crosses {
            state.since = None;
        } else if at_ns - *state.since.get_or_insert(at_ns) >= dwell_ns {
            state.is_entered = !state.is_entered;
            state.since = None;
        }
    }

    pub(super) fn begin_recording(&mut self) {
        if self.leave == Leave::NextRecording {
            self.state = State::default();
        }
    }
}
