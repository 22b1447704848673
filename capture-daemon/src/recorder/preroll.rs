//! Pre-roll: the last seconds, kept while nothing is recorded.

use std::collections::{BTreeMap, VecDeque};

use session_archive::record::ClockMap;
use session_archive::time::HostTime;

use super::stop_limits::MAX_STOP_NS;
use crate::hub::Outgoing;

/// Maximum size of the pre-roll, whatever its length, bytes.
pub(super) const MAX_PRE_ROLL_BYTES: usize = 256 << 20;

/// Items received in the last seconds, and the clock maps of their times.
pub(super) struct PreRoll {
    items: VecDeque<Outgoing>,
    bytes: usize,
    /// Time span kept before the newest item: the pre-roll, and the GOP in which it begins, ns.
    span_ns: i64,
    pre_roll_ns: i64,
    /// The byte limit holds less than the pre-roll.
    cut: bool,
    newest: HostTime,
    /// Maps of each clock from before the items, with their arrival: the newest, and maps replaced
    /// so recently that a sample in transit may still refer to one.
    maps: BTreeMap<String, VecDeque<(HostTime, ClockMap)>>,
}

/// Beginning of a session.
pub(super) struct Beginning {
    /// Clock maps from before the first item, the newest of each clock last.
    pub(super) maps: Vec<ClockMap>,
    /// The items, in order: for each camera from a key frame on.
    pub(super) items: Vec<Outgoing>,
}

impl PreRoll {
    pub(super) fn new(pre_roll_ns: i64, chunk_ns: i64) -> Self {
        Self {
            items: VecDeque::new(),
            bytes: 0,
            // One GOP before the pre-roll, and one more for a camera whose key frame is late.
            span_ns: pre_roll_ns + 2 * chunk_ns,
            pre_roll_ns,
            cut: false,
            newest: HostTime::MIN,
            maps: BTreeMap::new(),
        }
    }

    pub(super) fn keep(&mut self, item: Outgoing) {
        if let Some(time) = sample_time(&item) {
            self.newest = self.newest.max(time);
        }
        self.bytes += item.bytes();
        self.items.push_back(item);
        let mut full = false;
        while let Some(front) = self.items.front() {
            let old = sample_time(front).is_none_or(|t| self.newest.since(t) > self.span_ns);
            if !old && self.bytes <= MAX_PRE_ROLL_BYTES {
                break;
            }
            full |= !old;
            self.drop_oldest();
        }
        if full || self.cut {
            let oldest = self.items.front().and_then(sample_time);
            self.cut = oldest.is_none_or(|t| self.newest.since(t) < self.pre_roll_ns);
        }
    }

    fn drop_oldest(&mut self) {
        let Some(item) = self.items.pop_front() else {
            return;
        };
        self.bytes -= item.bytes();
        if let Outgoing::Clock { at, map } = item {
            self.remember(at, &map);
        }
    }

    /// Whether less than the pre-roll is kept because of the byte limit.
    pub(super) fn is_cut(&self) -> bool {
        self.cut
    }

    /// Puts back the result of [`Self::take`], for the next attempt.
    pub(super) fn put_back(&mut self, beginning: Beginning) {
        self.bytes = beginning.items.iter().map(Outgoing::bytes).sum();
        self.items = beginning.items.into();
    }

    /// Takes out the beginning of a session whose pre-roll begins at `from`. The caller has to
    /// [`Self::remember`] the clock maps among the items when the session has begun.
    pub(super) fn take(&mut self, from: HostTime, cameras: usize) -> Beginning {
        let now = from + self.pre_roll_ns;
        // Items from before a silence have not been pushed out. Encoders may lag by as much as a
        // stop waits for them.
        let limit_ns = self.span_ns + MAX_STOP_NS;
        let is_stale = |t: HostTime| now.since(t) > limit_ns;
        while self
            .items
            .front()
            .and_then(sample_time)
            .is_some_and(is_stale)
        {
            self.drop_oldest();
        }
        let newest = self.newest.max(now);
        for maps in self.maps.values_mut() {
            forget(maps, newest, self.span_ns);
        }
        let maps = self.maps.values().flatten();
        let maps = maps.map(|(_, map)| map.clone()).collect();
        let items = std::mem::take(&mut self.items);
        self.bytes = 0;
        // For each camera, the last key frame at or before `from`, or else its first.
        let mut begins: Vec<Option<u64>> = vec![None; cameras];
        for item in &items {
            if let Outgoing::Frame {
                camera,
                frame,
                key: true,
                ..
            } = item
                && (begins[*camera].is_none() || frame.time <= from.0)
            {
                begins[*camera] = Some(frame.number);
            }
        }
        let earliest = items
            .iter()
            .filter_map(|item| match item {
                Outgoing::Frame { camera, frame, .. } if begins[*camera] == Some(frame.number) => {
                    Some(HostTime(frame.time))
                }
                _ => None,
            })
            .min()
            .map_or(from, |t| t.min(from));
        let mut kept = Vec::new();
        for item in items {
            let keep = match &item {
                Outgoing::Frame { camera, frame, .. } => {
                    begins[*camera].is_some_and(|first| frame.number >= first)
                }
                Outgoing::Imu { batch, .. } => {
                    batch.times.first().is_some_and(|t| *t >= earliest.0)
                }
                Outgoing::Clock { .. } => true,
                Outgoing::Dropped { at, .. } => *at >= earliest,
                Outgoing::Alarm { .. } | Outgoing::Notice { .. } | Outgoing::Health { .. } => false,
            };
            if keep {
                kept.push(item);
            }
        }
        Beginning { maps, items: kept }
    }

    /// Stores a clock map during a recording, because the next session needs it.
    pub(super) fn remember(&mut self, at: HostTime, map: &ClockMap) {
        let maps = self.maps.entry(map.clock.clone()).or_default();
        maps.push_back((at, map.clone()));
        forget(maps, at, self.span_ns);
    }
}

/// Removes the maps that were replaced more than `span_ns` ago.
fn forget(maps: &mut VecDeque<(HostTime, ClockMap)>, now: HostTime, span_ns: i64) {
    while maps
        .get(1)
        .is_some_and(|(replaced, _)| now.since(*replaced) > span_ns)
    {
        maps.pop_front();
    }
}

fn sample_time(item: &Outgoing) -> Option<HostTime> {
    match item {
        Outgoing::Frame { frame, .. } => Some(HostTime(frame.time)),
        Outgoing::Imu { batch, .. } => batch.times.last().map(|t| HostTime(*t)),
        Outgoing::Clock { at, .. }
        | Outgoing::Alarm { at, .. }
        | Outgoing::Notice { at, .. }
        | Outgoing::Dropped { at, .. }
        | Outgoing::Health { at, .. } => Some(*at),
    }
}
