//! Progress over bytes, with rate and remaining time: a bar on a terminal, a line every few seconds
//! elsewhere. Any thread may add to it. It never fails and never blocks.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use charts::si;
use indicatif::{ProgressBar, ProgressStyle};

use crate::clock::Clock;

/// Minimum interval between lines.
const LINE_INTERVAL: Duration = Duration::from_secs(5);

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Show {
    /// Not at all.
    Nothing,
    /// A line every few seconds, if standard error is no terminal.
    Lines,
    /// A bar.
    Bar,
}

/// Progress of one job.
pub struct Progress(Option<Kind>);

enum Kind {
    Bar(ProgressBar),
    Lines(Lines),
}

struct Lines {
    label: String,
    total: u64,
    done: AtomicU64,
    clock: Clock,
    start: Duration,
    /// When the next line is due, ms after the start.
    due_ms: AtomicU64,
}

impl Progress {
    /// Hidden progress.
    pub const fn hidden() -> Self {
        Self(None)
    }

    /// Progress over `total` bytes.
    pub fn bytes(label: &str, total: u64, show: Show, clock: Clock) -> Self {
        Self(match show {
            Show::Nothing => None,
            Show::Lines => Some(Kind::Lines(Lines {
                label: label.to_owned(),
                total,
                done: AtomicU64::new(0),
                clock,
                start: (clock.monotonic)(),
                due_ms: AtomicU64::new(LINE_INTERVAL.as_millis() as u64),
            })),
            Show::Bar => {
                let style = ProgressStyle::with_template(
                    "{prefix} {bar:30} {percent:>3} %  {decimal_bytes} of {decimal_total_bytes}  \
                     {decimal_bytes_per_sec}  {eta} left",
                );
                let bar = ProgressBar::new(total).with_prefix(label.to_owned());
                Some(Kind::Bar(match style {
                    Ok(style) => bar.with_style(style),
                    Err(_) => bar,
                }))
            }
        })
    }

    /// Adds finished bytes.
    pub fn add(&self, bytes: u64) {
        match &self.0 {
            None => {}
            Some(Kind::Bar(bar)) => bar.inc(bytes),
            Some(Kind::Lines(lines)) => lines.add(bytes),
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(Kind::Bar(bar)) = &self.0 {
            bar.finish_and_clear();
        }
    }
}

impl Lines {
    fn add(&self, bytes: u64) {
        let done = self.done.fetch_add(bytes, Ordering::Relaxed) + bytes;
        // Messages may be small; the clock is read once per MiB.
        if done >> 20 == (done - bytes) >> 20 {
            return;
        }
        let elapsed = (self.clock.monotonic)().saturating_sub(self.start);
        let now_ms = elapsed.as_millis() as u64;
        let due = self.due_ms.load(Ordering::Relaxed);
        let next = now_ms + LINE_INTERVAL.as_millis() as u64;
        let ours = now_ms >= due
            && self
                .due_ms
                .compare_exchange(due, next, Ordering::Relaxed, Ordering::Relaxed)
                .is_ok();
        if ours {
            command_line::complain!("{}", self.line(done, elapsed));
        }
    }

    fn line(&self, done: u64, elapsed: Duration) -> String {
        let rate = done as f64 / elapsed.as_secs_f64().max(1e-3);
        let left = self.total.saturating_sub(done) as f64 / rate.max(1.0);
        format!(
            "{}: {:.0} %, {} of {}, {}, {left:.0} s left",
            self.label,
            100.0 * done as f64 / self.total.max(1) as f64,
            si(done as f64, "B"),
            si(self.total as f64, "B"),
            si(rate, "B/s"),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_line_has_fraction_rate_and_remaining_time() {
        let lines = Lines {
            label: "import".to_owned(),
            total: 2_000_000_000,
            done: AtomicU64::new(0),
            clock: Clock::STILL,
            start: Duration::ZERO,
            due_ms: AtomicU64::new(0),
        };
        assert_eq!(
            lines.line(500_000_000, Duration::from_secs(1)),
            "import: 25 %, 500 MB of 2 GB, 500 MB/s, 3 s left"
        );
    }
}
