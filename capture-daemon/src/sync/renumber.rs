//! A device's counter as increasing numbers, for devices that restart their counters or let them
//! wrap.

/// Maximum decrease of a late number. With more, the device has restarted its counter.
const MAX_REORDER: u64 = 64;
/// Number of consecutive numbers behind the newest that indicate a restart.
const MIN_RESTART_RUN: u32 = 4;
/// Maximum increase of a number by loss, which would have lasted for hours. With more, the number
/// is wrong or the counter was restarted.
const MAX_COUNTER_JUMP: u64 = 1 << 20;

/// Unwraps a device's counter into increasing numbers, whatever the device does to it.
///
/// A *late or repeated* number comes out unchanged, not above the newest. After a *restart* the
/// numbers continue right behind the newest, because the number of missing samples is unknown.
#[derive(Clone, Debug, Default)]
pub struct Renumber {
    bits: Option<u8>,
    newest: Option<Numbers>,
    /// The last number that decreased, and the length of that run.
    behind: Option<(u64, u32)>,
}

/// The device's number and the stream's.
#[derive(Clone, Copy, Debug)]
struct Numbers {
    raw: u64,
    ours: u64,
}

/// A number returned by [`Renumber`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleNumber {
    /// The stream's number.
    pub number: u64,
    /// The device restarted its counter: the number of samples missing here is unknown.
    pub restarted: bool,
    /// Late or repeated: not above the newest.
    pub late: bool,
}

impl Renumber {
    /// For a counter of `bits` bits (`None`: it never wraps). A wrap is detected if fewer than half
    /// of the range is lost.
    pub fn new(bits: Option<u8>) -> Self {
        Self {
            bits: bits.filter(|b| (1..64).contains(b)),
            ..Self::default()
        }
    }

    /// The stream's number for the device's number.
    pub fn number(&mut self, raw: u64) -> SampleNumber {
        let Some(newest) = self.newest else {
            return self.advance(raw, raw, false);
        };
        let ahead = raw.wrapping_sub(newest.raw);
        let ahead = self.bits.map_or(ahead, |bits| ahead & ((1 << bits) - 1));
        let modulus = self.bits.map_or(0, |bits| 1 << bits);
        let back = u64::wrapping_sub(modulus, ahead);
        if ahead != 0 && ahead <= MAX_COUNTER_JUMP && (modulus == 0 || ahead < modulus / 2) {
            return self.advance(raw, newest.ours.saturating_add(ahead), false);
        }
        if ahead == 0 || back < MAX_REORDER {
            let run = match self.behind {
                Some((last, run)) if raw == last.wrapping_add(1) => run + 1,
                _ => 1,
            };
            self.behind = Some((raw, run));
            if run < MIN_RESTART_RUN {
                let back = if ahead == 0 { 0 } else { back };
                let number = newest.ours.saturating_sub(back);
                return SampleNumber {
                    number,
                    restarted: false,
                    late: true,
                };
            }
        }
        self.advance(raw, newest.ours.saturating_add(1), true)
    }

    /// The stream's number of the newest sample.
    pub fn newest(&self) -> Option<u64> {
        self.newest.map(|n| n.ours)
    }

    /// The stream's number of the first sample from a reconnected device that missed about `missed`
    /// samples. A counter that continued is accepted, any other has restarted.
    pub fn resume(&mut self, raw: u64, missed: u64) -> u64 {
        let Some(newest) = self.newest else {
            return self.advance(raw, raw, false).number;
        };
        let skipped = raw.checked_sub(newest.raw.saturating_add(1));
        let is_likely = |n: &u64| n.abs_diff(missed) <= 2 + missed / 10;
        let skipped = skipped.filter(is_likely).unwrap_or(missed);
        let ours = newest.ours.saturating_add(skipped).saturating_add(1);
        self.advance(raw, ours, false).number
    }

    fn advance(&mut self, raw: u64, ours: u64, restarted: bool) -> SampleNumber {
        self.newest = Some(Numbers { raw, ours });
        self.behind = None;
        SampleNumber {
            number: ours,
            restarted,
            late: false,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Passes raw numbers in; returns the numbers, restarts negated.
    fn renumbered(bits: Option<u8>, raw: &[u64]) -> Vec<i64> {
        let mut numbers = Renumber::new(bits);
        let number = |&raw| {
            let SampleNumber {
                number, restarted, ..
            } = numbers.number(raw);
            if restarted {
                -(number as i64)
            } else {
                number as i64
            }
        };
        raw.iter().map(number).collect()
    }

    #[test]
    fn counters_wrap_and_restart() {
        let restart = renumbered(None, &[1000, 998, 1001, 0, 3, 4]);
        assert_eq!(restart, [1000, 998, 1001, -1002, 1005, 1006]);
        let early_restart = renumbered(None, &[29, 30, 0, 1, 2, 3, 4, 6]);
        assert_eq!(early_restart, [29, 30, 0, 1, 2, -31, 32, 34]);
        let wrong_number = renumbered(None, &[7, 8, 1 << 40, 9, 10]);
        assert_eq!(wrong_number, [7, 8, -9, -10, 11]);
        let repeated = renumbered(None, &[7, 8, 8, 8, 8, 8, 9]);
        assert_eq!(repeated, [7, 8, 8, 8, 8, 8, 9]);
        let wrap = renumbered(Some(8), &[250, 255, 2, 254, 3]);
        assert_eq!(wrap, [250, 255, 258, 254, 259]);
        let wide_wrap = renumbered(Some(32), &[u64::from(u32::MAX), 0, 1]);
        assert_eq!(wide_wrap, [(1 << 32) - 1, 1 << 32, (1 << 32) + 1]);
        let end = renumbered(None, &[u64::MAX, 0, 1]);
        assert_eq!(end.len(), 3, "no overflow");
    }

    #[test]
    fn plausible_counter_is_accepted_after_a_disconnect() {
        let resumed = |raw, missed| {
            let mut numbers = Renumber::new(None);
            numbers.number(1000);
            let first = numbers.resume(raw, missed);
            assert_eq!(numbers.number(raw + 1).number, first + 1);
            first
        };
        assert_eq!(resumed(0, 400), 1401, "counter restarted");
        assert_eq!(
            resumed(1400, 400),
            1400,
            "went on, one less than by the clock"
        );
        assert_eq!(
            resumed(1002, 400),
            1401,
            "a new count that is ahead by chance"
        );
        assert_eq!(resumed(0, 0), 1001);
    }

    proptest! {
        /// New numbers only increase, whatever the device counts.
        #[test]
        fn new_numbers_are_monotonic(
            bits in prop::option::of(0_u8..=64),
            raw in prop::collection::vec(prop_oneof![0_u64..300, any::<u64>()], 1..200),
        ) {
            let mut numbers = Renumber::new(bits);
            let mut newest = None;
            for raw in raw {
                let SampleNumber { number, restarted, late } = numbers.number(raw);
                if let Some(newest) = newest {
                    prop_assert!(!restarted || number == u64::saturating_add(newest, 1));
                    prop_assert!(late == (number <= newest) || newest == u64::MAX);
                }
                newest = newest.max(Some(number));
            }
        }
    }
}
