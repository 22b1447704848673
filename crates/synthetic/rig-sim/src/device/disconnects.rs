//! Connection periods of a device.

use crate::faults::{CameraFaults, Kind};

/// Time spans in which a device is disconnected: ascending, disjoint, not adjacent.
#[derive(Clone, Debug)]
pub(super) struct Disconnects {
    /// Begin and end, ns since the beginning of the walk.
    spans: Vec<(i64, i64)>,
    reported: usize,
}

impl Disconnects {
    pub(super) fn of(faults: &CameraFaults) -> Self {
        let span = |from_s: f64, seconds: f64| {
            let from = (from_s * 1e9) as i64;
            (from, from + (seconds * 1e9) as i64)
        };
        let planned = faults.of_kind(Kind::Disconnect);
        let mut all: Vec<_> = planned.map(|f| span(f.from_s, f.strength)).collect();
        all.sort_unstable();
        let mut spans: Vec<(i64, i64)> = Vec::new();
        for (from, to) in all {
            match spans.last_mut() {
                Some(last) if from <= last.1 => last.1 = last.1.max(to),
                _ => spans.push((from, to)),
            }
        }
        Self { spans, reported: 0 }
    }

    /// Connection epoch at a time, from 0; `None` while disconnected.
    pub(super) fn epoch(&self, time_ns: i64) -> Option<usize> {
        let over = self.spans.partition_point(|(_, to)| *to <= time_ns);
        match self.spans.get(over) {
            Some((from, _)) if *from <= time_ns => None,
            _ => Some(over),
        }
    }

    pub(super) fn spans(&self) -> &[(i64, i64)] {
        &self.spans
    }

    /// Begin of an epoch, ns.
    pub(super) fn began(&self, epoch: usize) -> i64 {
        match epoch {
            0 => 0,
            _ => self.spans[epoch - 1].1,
        }
    }

    /// Next disconnection, reported once, if it precedes the arrival at `before_ns` or nothing
    /// arrives any more.
    pub(super) fn next_before(&mut self, before_ns: Option<i64>) -> Option<i64> {
        let (from, _) = *self.spans.get(self.reported)?;
        // A delivery in that nanosecond is lost.
        if before_ns.is_some_and(|before| before < from) {
            return None;
        }
        self.reported += 1;
        Some(from)
    }
}
