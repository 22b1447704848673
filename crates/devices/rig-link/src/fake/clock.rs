//! A clock that stands still until a test advances it.

use std::collections::BTreeMap;
use std::future::Future;
use std::pin::Pin;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use crate::clock::{Clock, Sleeping};

/// Maximum time until the server starts a timer; reached only if it never does.
const PATIENCE: Duration = Duration::from_secs(600);

/// A clock that stands still until [`Self::advance`] or [`Self::expire`]. Copies are the same
/// clock.
#[derive(Clone, Debug, Default)]
pub struct ManualClock(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    timers: Mutex<Timers>,
    /// A timer has started, ended or was dropped.
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Timers {
    now: Duration,
    next: u64,
    /// Those being waited for: when they end, and who waits.
    running: BTreeMap<u64, (Duration, Waker)>,
    /// Number of those whose end was seen by who waited.
    expired: usize,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Timers> {
        self.timers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for a change until `done`.
    ///
    /// # Panics
    /// It never happens.
    fn wait_until(&self, what: &str, mut done: impl FnMut(&mut Timers) -> bool) {
        let guard = self.lock();
        let waited = self
            .changed
            .wait_timeout_while(guard, PATIENCE, |timers| !done(timers));
        let (guard, timed_out) = waited.unwrap_or_else(PoisonError::into_inner);
        drop(guard);
        assert!(!timed_out.timed_out(), "waited in vain for {what}");
    }
}

impl Timers {
    /// Moves the time forward and wakes who waits for a time up to then.
    fn advance_to(&mut self, now: Duration) {
        self.now = self.now.max(now);
        for (due, waker) in self.running.values() {
            if *due <= self.now {
                waker.wake_by_ref();
            }
        }
    }
}

impl ManualClock {
    /// A clock at zero.
    pub fn new() -> Self {
        Self::default()
    }

    /// Moves the time forward.
    pub fn advance(&self, by: Duration) {
        let mut timers = self.0.lock();
        let now = timers.now + by;
        timers.advance_to(now);
    }

    /// Waits until at least this number of timers run.
    ///
    /// # Panics
    /// They do not start.
    pub fn wait_for_timers(&self, count: usize) {
        self.0
            .wait_until("timers", |timers| timers.running.len() >= count);
    }

    /// Moves the time from the end of one timer to the next, including timers that start meanwhile,
    /// until this number of them has ended.
    ///
    /// # Panics
    /// Fewer timers start.
    pub fn expire(&self, count: usize) {
        let goal = self.0.lock().expired + count;
        self.0.wait_until("the end of timers", |timers| {
            if timers.expired >= goal {
                return true;
            }
            if let Some(next) = timers.running.values().map(|(due, _)| *due).min() {
                timers.advance_to(next);
            }
            false
        });
    }
}

impl Clock for ManualClock {
    fn now(&self) -> Duration {
        self.0.lock().now
    }

    fn sleep(&self, time: Duration) -> Sleeping {
        let mut timers = self.0.lock();
        timers.next += 1;
        Box::pin(Timer {
            clock: self.0.clone(),
            number: timers.next,
            due: timers.now + time,
        })
    }
}

struct Timer {
    clock: Arc<Shared>,
    number: u64,
    due: Duration,
}

impl Future for Timer {
    type Output = ();

    fn poll(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<()> {
        let mut timers = self.clock.lock();
        let is_over = timers.now >= self.due;
        if is_over {
            timers.running.remove(&self.number);
            timers.expired += 1;
        } else {
            let waiting = (self.due, context.waker().clone());
            timers.running.insert(self.number, waiting);
        }
        self.clock.changed.notify_all();
        if is_over {
            Poll::Ready(())
        } else {
            Poll::Pending
        }
    }
}

impl Drop for Timer {
    fn drop(&mut self) {
        self.clock.lock().running.remove(&self.number);
        self.clock.changed.notify_all();
    }
}
