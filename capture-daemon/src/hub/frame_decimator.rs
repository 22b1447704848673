//! Selection of the frames that are dropped when the frame rate is halved.
//!
//! Contract: cameras that expose simultaneously drop the same instants, whatever their frame
//! numbers are, so that the remaining frames still form complete frame sets. The grid follows the
//! actual frame rate. A missing or late frame does not affect the frames after it.

use session_archive::time::HostTime;

/// Newest instant whose frames were kept, for cameras that expose simultaneously.
#[derive(Debug, Default)]
pub(super) struct FrameDecimator {
    kept: Option<HostTime>,
}

impl FrameDecimator {
    /// Whether the frame of this time is kept.
    pub(super) fn is_kept(&mut self, time: HostTime, period_ns: i64) -> bool {
        let Some(kept) = self.kept else {
            self.kept = Some(time);
            return true;
        };
        let period_ns = period_ns.max(1);
        let periods = time
            .since(kept)
            .saturating_add(period_ns / 2)
            .div_euclid(period_ns);
        let is_kept = periods % 2 == 0;
        if is_kept && periods > 0 {
            self.kept = Some(time);
        }
        is_kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: i64 = 33_333_333;

    #[test]
    fn cameras_of_one_trigger_keep_the_same_instants() {
        let mut decimator = FrameDecimator::default();
        let mut kept = 0;
        // 0.1 % slower than nominal, for ten minutes, the second camera three frames late.
        let at = |n: i64| HostTime(5_000_000_000 + n * (PERIOD_NS + PERIOD_NS / 1000));
        let mut first = Vec::new();
        for n in 0..18_000 {
            // Some frames are missing.
            if n % 50 != 7 {
                first.push((n, decimator.is_kept(at(n), PERIOD_NS)));
            }
            if n >= 3 {
                let is_kept = decimator.is_kept(at(n - 3) + 200_000, PERIOD_NS);
                let other = first.iter().rev().find(|(number, _)| *number == n - 3);
                assert!(other.is_none_or(|(_, other)| *other == is_kept), "{n}");
                kept += u32::from(is_kept);
            }
        }
        assert!((8_990..=9_010).contains(&kept), "{kept}");
    }
}
