//! Times of one stream that only grow.

use session_archive::time::HostTime;

use super::map::Mapped;

/// Keeps the mapped times of one stream strictly increasing while its map is being refined.
///
/// A refined map may place a new sample before the time that an older version gave to the
/// previous one, by about the old sigma. The guard then puts the new sample 1 ns after the
/// previous one, widens its sigma by the shift and flags it if the shift is more than a sigma: it
/// never moves a time in silence, and it holds nothing back. A sample whose tick is not beyond
/// the last one's is let through as it is: it really is older.
#[derive(Clone, Debug, Default)]
pub struct MonotoneGuard {
    last: Option<(i64, HostTime)>,
}

impl MonotoneGuard {
    /// The mapped time of the next sample, moved if it must be.
    pub fn pass(&mut self, ticks: i64, mut mapped: Mapped) -> Mapped {
        if let Some((last_ticks, last_time)) = self.last {
            if ticks <= last_ticks {
                return mapped;
            }
            let shift = (last_time + 1).since(mapped.time);
            if shift > 0 {
                mapped.time = last_time + 1;
                mapped.flagged |= shift as u64 > mapped.sigma_ns;
                mapped.sigma_ns = mapped.sigma_ns.saturating_add(shift as u64);
            }
        }
        self.last = Some((ticks, mapped.time));
        mapped
    }

    /// The device clock stepped: ticks count anew, times still only grow.
    pub fn step(&mut self) {
        if let Some((ticks, _)) = &mut self.last {
            *ticks = i64::MIN;
        }
    }
}
