//! Which pictures are left out where every other one is to be.
//!
//! Contract: cameras that expose together leave out the same instants, whatever their numbers are, so that what is
//! kept of them still makes whole frame sets. The grid follows the rate that they really have. A picture that
//! does not come, or comes late, changes nothing for those behind it.

use session_archive::time::HostTime;

/// The newest instant of which pictures were kept, by cameras that expose together.
#[derive(Debug, Default)]
pub(super) struct FrameDecimator {
    kept: Option<HostTime>,
}

impl FrameDecimator {
    /// Whether a picture of this time is kept.
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
        // One in a thousand slower than they should be, for ten minutes, the second one three pictures late.
        let at = |n: i64| HostTime(5_000_000_000 + n * (PERIOD_NS + PERIOD_NS / 1000));
        let mut first = Vec::new();
        for n in 0..18_000 {
            // Now and then one does not come.
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
