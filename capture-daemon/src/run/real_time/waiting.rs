//! Waiting for a time of the real clock.

use std::time::Duration;

use session_archive::time::HostTime;

use super::shared::Shared;
use crate::clock::Clock as _;

/// Maximum wait before a thread checks whether the end was requested, and the recorder whether a
/// session is closed.
pub(super) const POLL_TIMEOUT: Duration = Duration::from_millis(20);

/// Sleeps until a time; false if the end came first.
pub(super) fn wait_until(time: HostTime, shared: &Shared) -> bool {
    loop {
        let left = time - shared.clock.now();
        if shared.ending.is_set() {
            return false;
        }
        if left <= 0 {
            return true;
        }
        #[expect(
            clippy::disallowed_methods,
            reason = "this is the clock of the replayed devices"
        )]
        std::thread::sleep(Duration::from_nanos(left as u64).min(POLL_TIMEOUT));
    }
}

/// Time from `now` until `then`; zero if it has passed.
pub(super) fn span(now: HostTime, then: HostTime) -> Duration {
    Duration::from_nanos(then.since(now).max(0) as u64)
}
