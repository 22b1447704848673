//! One stream of events: its counter unwrapped, its holes counted, its newest events held.

use std::collections::VecDeque;

use super::config::FrameSyncConfig;
use super::line::{Line, Point};

/// What a count says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CountCheck {
    /// It goes on.
    Fits,
    /// It has restarted, or no longer counts the same events.
    Slipped,
}

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct Track {
    config: FrameSyncConfig,
    points: VecDeque<Point>,
    /// The newest count, as delivered and unwrapped.
    newest: Option<(u32, i64)>,
    /// Where events are expected, and the maximum deviation, ns.
    expected: Option<(Line, f64)>,
    /// Consecutive events beyond the maximum deviation.
    off: u32,
    seen: u64,
    missed: u64,
}

impl Track {
    /// Nothing seen yet.
    pub(super) fn new(config: &FrameSyncConfig) -> Self {
        Self {
            config: *config,
            points: VecDeque::new(),
            newest: None,
            expected: None,
            off: 0,
            seen: 0,
            missed: 0,
        }
    }

    /// Takes a count, and when its event was if it is known.
    pub(super) fn count(&mut self, count: u32, time: Option<i64>) -> CountCheck {
        let Some((before, unwrapped)) = self.newest else {
            // What was counted before is not a loss, nor is an event whose count was not seen to
            // change.
            self.newest = Some((count, i64::from(count)));
            if let Some(y) = time {
                self.seen += 1;
                let n = i64::from(count);
                self.points.push_back(Point { n, y });
            }
            return CountCheck::Fits;
        };
        let ahead = count.wrapping_sub(before);
        if ahead == 0 {
            return CountCheck::Fits;
        }
        if ahead > self.config.max_count_step {
            return CountCheck::Slipped;
        }
        let n = unwrapped + i64::from(ahead);
        self.newest = Some((count, n));
        self.missed += u64::from(ahead) - u64::from(time.is_some());
        let Some(y) = time else {
            return CountCheck::Fits;
        };
        self.seen += 1;
        if let Some((line, far)) = &self.expected {
            let is_off = line.above(y, n as f64).abs() > *far;
            self.off = if is_off { self.off + 1 } else { 0 };
            if self.off >= self.config.max_outliers {
                return CountCheck::Slipped;
            }
        }
        self.points.push_back(Point { n, y });
        if self.points.len() > self.config.window {
            self.points.pop_front();
        }
        CountCheck::Fits
    }

    /// Events are expected on this line, give or take `far` ns.
    pub(super) fn expect(&mut self, line: Line, far: f64) {
        self.expected = Some((line, far));
    }

    /// Forgets all but what was counted.
    pub(super) fn clear(&mut self) {
        *self = Self {
            seen: self.seen,
            missed: self.missed,
            ..Self::new(&self.config)
        };
    }

    /// The events that are held, in order.
    pub(super) fn points(&self) -> &VecDeque<Point> {
        &self.points
    }

    pub(super) fn seen(&self) -> u64 {
        self.seen
    }

    pub(super) fn missed(&self) -> u64 {
        self.missed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counters_wrap_and_holes_are_counted() {
        let mut track = Track::new(&FrameSyncConfig::default());
        for (k, count) in [u32::MAX - 1, u32::MAX, 1, 2, 5].into_iter().enumerate() {
            assert_eq!(track.count(count, Some(k as i64)), CountCheck::Fits);
        }
        let n: Vec<i64> = track
            .points()
            .iter()
            .map(|p| p.n - i64::from(u32::MAX))
            .collect();
        assert_eq!(n, [-1, 0, 2, 3, 6]);
        assert_eq!((track.seen(), track.missed()), (5, 3));
        // A count without its event, then the same count again.
        track.count(6, None);
        track.count(6, None);
        assert_eq!((track.seen(), track.missed()), (5, 4));
        assert_eq!(track.count(0, Some(9)), CountCheck::Slipped);
    }
}
