//! A button that plays a script on a time of its own.

use std::collections::VecDeque;
use std::io;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::{Button, Edge, Next, Port};
use crate::wait::{Waker, wait};
use crate::{Clock, DeviceError};

/// A time that stands still until a script moves it. Clones are the same time.
#[derive(Clone, Debug, Default)]
pub(crate) struct Time(Arc<AtomicI64>);

impl Time {
    /// Now, nanoseconds.
    pub(crate) fn now_ns(&self) -> i64 {
        self.0.load(Ordering::SeqCst)
    }

    /// Later. It never goes back.
    pub(crate) fn advance_to(&self, at_ns: i64) {
        self.0.fetch_max(at_ns, Ordering::SeqCst);
    }

    /// As a clock.
    pub(crate) fn clock(&self) -> Clock {
        let time = self.clone();
        Arc::new(move || time.now_ns())
    }
}

/// What happens to a scripted button.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Step {
    /// It goes down or up.
    Edge(Edge),
    /// It is unplugged.
    Gone {
        /// When.
        at_ns: i64,
    },
    /// It is plugged in.
    Back {
        /// When.
        at_ns: i64,
    },
}

impl Step {
    fn at_ns(self) -> i64 {
        match self {
            Self::Edge(edge) => edge.at_ns,
            Self::Gone { at_ns } | Self::Back { at_ns } => at_ns,
        }
    }
}

/// A port and its button, which move [`Time`] to each step as somebody waits for it. After the last
/// step time passes to the end of each wait; a wait for ever, or for a return that does not come,
/// is a real one.
#[derive(Clone, Debug)]
pub(crate) struct ScriptedButton {
    time: Time,
    steps: Arc<Mutex<VecDeque<Step>>>,
}

impl ScriptedButton {
    /// Plays `steps`, which are in order of time, on `time`.
    pub(crate) fn new(time: Time, steps: impl IntoIterator<Item = Step>) -> Self {
        Self {
            time,
            steps: Arc::new(Mutex::new(steps.into_iter().collect())),
        }
    }

    fn steps(&self) -> MutexGuard<'_, VecDeque<Step>> {
        self.steps.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn peek(&self) -> Option<Step> {
        self.steps().front().copied()
    }

    /// The next step, if it comes within the wait.
    fn step(&self, timeout: Option<Duration>) -> Option<Step> {
        let mut steps = self.steps();
        let end = timeout.map_or(i64::MAX, |t| {
            let span = i64::try_from(t.as_nanos()).unwrap_or(i64::MAX);
            self.time.now_ns().saturating_add(span)
        });
        match steps.front() {
            Some(step) if step.at_ns() <= end => {
                self.time.advance_to(step.at_ns());
                steps.pop_front()
            }
            _ => {
                if timeout.is_some() {
                    self.time.advance_to(end);
                }
                None
            }
        }
    }
}

impl Port for ScriptedButton {
    fn open(&mut self) -> Result<Box<dyn Button>, DeviceError> {
        if let Some(Step::Back { at_ns }) = self.peek() {
            if at_ns > self.time.now_ns() {
                return Err(DeviceError::NotFound {
                    what: "scripted button".into(),
                    expected: "it to come back".into(),
                });
            }
            self.step(None);
        }
        Ok(Box::new(self.clone()))
    }

    fn wait(&mut self, timeout: Duration, waker: &Waker) -> io::Result<Next> {
        let Some(next) = self.peek() else {
            wait(&[], waker, None)?;
            return Ok(Next::Called);
        };
        // The step itself is left for `open` to take.
        let span = i64::try_from(timeout.as_nanos()).unwrap_or(i64::MAX);
        let end = self.time.now_ns().saturating_add(span);
        self.time.advance_to(next.at_ns().min(end));
        Ok(Next::Time)
    }
}

impl Button for ScriptedButton {
    fn next(&mut self, timeout: Option<Duration>, waker: &Waker) -> Result<Next, DeviceError> {
        match self.step(timeout) {
            Some(Step::Edge(edge)) => Ok(Next::Edge(edge)),
            Some(Step::Gone { .. }) => Err(DeviceError::Gone {
                what: "scripted button".into(),
            }),
            Some(Step::Back { .. }) => Ok(Next::Time),
            None if timeout.is_some() => Ok(Next::Time),
            None => {
                let what = "scripted button";
                wait(&[], waker, None)
                    .map_err(|e| DeviceError::from_io("waiting for", what, "", e))?;
                Ok(Next::Called)
            }
        }
    }

    fn is_debounced(&self) -> bool {
        false
    }

    fn describe(&self) -> &str {
        "scripted button"
    }
}
