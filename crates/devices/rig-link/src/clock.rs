//! The time of the server's limits, passed in, so that tests reach a limit without a pause.

use std::fmt::Debug;
use std::future::{Future, poll_fn};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use hyper::rt;

/// A future that ends at a time of a [`Clock`].
pub type Sleeping = Pin<Box<dyn Future<Output = ()> + Send + Sync>>;

/// A monotonic clock with timers.
pub trait Clock: Debug + Send + Sync {
    /// Time since an origin that does not change.
    fn now(&self) -> Duration;

    /// Ends when this time has passed. Needs the runtime of the server.
    fn sleep(&self, time: Duration) -> Sleeping;
}

/// The clock of this machine.
#[derive(Clone, Copy, Debug)]
pub struct RealClock {
    origin: tokio::time::Instant,
}

impl Default for RealClock {
    fn default() -> Self {
        Self {
            origin: tokio::time::Instant::now(),
        }
    }
}

impl Clock for RealClock {
    fn now(&self) -> Duration {
        self.origin.elapsed()
    }

    fn sleep(&self, time: Duration) -> Sleeping {
        Box::pin(tokio::time::sleep(time))
    }
}

/// The limit passed before the work was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the time limit passed")]
pub(crate) struct Elapsed;

/// The result of `work`, if it is there within `limit`.
pub(crate) async fn timeout<T>(
    clock: &dyn Clock,
    limit: Duration,
    work: impl Future<Output = T>,
) -> Result<T, Elapsed> {
    let mut work = std::pin::pin!(work);
    let mut limit = clock.sleep(limit);
    poll_fn(|context| {
        if let Poll::Ready(done) = work.as_mut().poll(context) {
            return Poll::Ready(Ok(done));
        }
        limit.as_mut().poll(context).map(|()| Err(Elapsed))
    })
    .await
}

/// A [`Clock`] as the timer of hyper.
#[derive(Debug)]
pub(crate) struct HyperTimer {
    clock: Arc<dyn Clock>,
    /// Any instant, and the clock's time that it stands for.
    base: (Instant, Duration),
}

impl HyperTimer {
    #[expect(
        clippy::disallowed_methods,
        reason = "only the difference of two instants counts, and both come from the clock"
    )]
    pub(crate) fn new(clock: Arc<dyn Clock>) -> Self {
        let base = (Instant::now(), clock.now());
        Self { clock, base }
    }
}

impl rt::Timer for HyperTimer {
    fn sleep(&self, duration: Duration) -> Pin<Box<dyn rt::Sleep>> {
        Box::pin(HyperSleep(self.clock.sleep(duration)))
    }

    fn sleep_until(&self, deadline: Instant) -> Pin<Box<dyn rt::Sleep>> {
        self.sleep(deadline.saturating_duration_since(self.now()))
    }

    fn now(&self) -> Instant {
        let (instant, time) = self.base;
        instant + self.clock.now().saturating_sub(time)
    }
}

struct HyperSleep(Sleeping);

impl Future for HyperSleep {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<()> {
        self.0.as_mut().poll(context)
    }
}

impl rt::Sleep for HyperSleep {}
