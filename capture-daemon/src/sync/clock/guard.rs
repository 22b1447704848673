//! Monotonic times of one stream.

use session_archive::time::HostTime;

use super::map::MappedTime;

/// Keeps the mapped times of one stream strictly increasing while its map is being refined.
///
/// A refined map may put a new sample before the time that an older version gave to the previous
/// one, by about the old sigma. The guard then puts the new sample 1 ns after the previous one,
/// increases its sigma by the correction and flags it if the correction is more than a sigma: it
/// never moves a time silently, and it delays nothing. A sample whose tick is not beyond the last
/// one's passes unchanged, because it really is older.
#[derive(Clone, Debug, Default)]
pub struct MonotoneGuard {
    last: Option<(i64, HostTime)>,
}

impl MonotoneGuard {
    /// The mapped time of the next sample, corrected if necessary.
    pub fn pass(&mut self, ticks: i64, mut mapped: MappedTime) -> MappedTime {
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

    /// The device clock stepped: ticks restart, times still only increase.
    pub fn step(&mut self) {
        if let Some((ticks, _)) = &mut self.last {
            *ticks = i64::MIN;
        }
    }
}
