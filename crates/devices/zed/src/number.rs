//! Numbers for samples that come without one.
//!
//! The report has no counter of samples, so a lost one shows only as a hole in the device's ticks.
//! [`Numbers`] learns the period from the ticks and numbers each sample so that the holes are in
//! the numbers too: a gap of about k periods makes the number jump by k. Pure; time comes in with
//! the sample.
//!
//! * *Early.* The rate is not assumed. Until it is known a gap is measured against the smallest
//!   that several others support, so a sample lost among the very first may go unseen.
//! * *Losses* leave numbers right while among sixteen gaps there is a single one. A long hole is as
//!   exact as the period, some parts in 1e5 after a minute.
//! * *A rate that rises* is followed after five gaps. *One that falls* looks like losses until none
//!   of the last sixteen gaps is an old one: up to sixteen samples are then reported lost that
//!   never were.
//! * *A clock that steps* (the device restarted, or the ticks are wrong) tells nothing of what
//!   was lost: the number goes on by host time, and [`SampleNumber::stepped`] says so. A late
//!   arrival is no step, an arrival before its time is.
//! * *A repeated sample* is a step by one.

use crate::report::{TICKS_PER_S, ticks_ns};

/// Gaps from which the period is taken.
const RECENT: usize = 16;
/// Samples after which an anchor makes room for the next.
const ANCHOR: u64 = 1 << 15;
/// A sample that arrives so much before its time shows that the clock has stepped, ns.
const EARLY_NS: i64 = 1_000_000_000;
/// Host and device clock rates differ by less than one part in this number.
const CLOCKS_AGREE: i64 = 2_000;

/// What became of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleNumber {
    /// The sample's number; it only grows.
    pub number: u64,
    /// Samples that are missing before it: the numbers left out.
    pub lost: u64,
    /// The device's clock has stepped, so `lost` is by host time.
    pub stepped: bool,
}

/// Numbers the samples of one device. See the [module](self).
#[derive(Clone, Debug, Default)]
pub struct Numbers {
    newest: Option<Newest>,
    gaps: Vec<u64>,
    /// Where the next gap goes in `gaps` once it is full.
    oldest_gap: usize,
    /// The gap of one period, ticks, as it is taken to be.
    base: Option<u64>,
    anchors: [Place; 2],
    /// Host time of the device's zero as seen by the fastest arrival lately, ns.
    least_offset: i64,
}

#[derive(Clone, Copy, Debug, Default)]
struct Place {
    ticks: u64,
    number: u64,
}

#[derive(Clone, Copy, Debug)]
struct Newest {
    place: Place,
    host_ns: i64,
}

impl Numbers {
    /// Numbers that begin at 0 with a rate that is not known.
    pub fn new() -> Self {
        Self::default()
    }

    /// Numbers the sample with these ticks that arrived at `host_ns`.
    pub fn number(&mut self, ticks: u64, host_ns: i64) -> SampleNumber {
        let offset = host_ns.saturating_sub(ticks_ns(ticks).unwrap_or(i64::MAX));
        let Some(newest) = self.newest else {
            self.begin(Place { ticks, number: 0 }, host_ns, offset);
            return SampleNumber {
                number: 0,
                lost: 0,
                stepped: false,
            };
        };
        let waited = host_ns.saturating_sub(newest.host_ns).max(0);
        let least = self.least_offset.saturating_add(waited / CLOCKS_AGREE);
        let stepped = ticks <= newest.place.ticks || offset < least.saturating_sub(EARLY_NS);
        let jump = if stepped {
            let ticks = u128::from(waited.unsigned_abs()) * 2 / 78_125;
            self.periods(u64::try_from(ticks).unwrap_or(u64::MAX))
        } else {
            let gap = ticks - newest.place.ticks;
            self.learn(gap, newest.place);
            self.periods(gap)
        };
        let place = Place {
            ticks,
            number: newest.place.number.saturating_add(jump),
        };
        if stepped {
            self.begin(place, host_ns, offset);
        } else {
            self.newest = Some(Newest { place, host_ns });
            self.least_offset = least.min(offset);
            if place.number - self.anchors[1].number >= ANCHOR {
                self.anchors = [self.anchors[1], place];
            }
        }
        SampleNumber {
            number: place.number,
            lost: jump - 1,
            stepped,
        }
    }

    /// Samples per second of the device's clock, once two samples have come.
    pub fn rate_hz(&self) -> Option<f64> {
        let (ticks, samples) = self.period()?;
        Some(samples as f64 * TICKS_PER_S as f64 / ticks as f64)
    }

    /// Time from one sample to the next by the device's clock, ns, once two samples have come.
    pub fn period_ns(&self) -> Option<i64> {
        let (ticks, samples) = self.period()?;
        i64::try_from(u128::from(ticks) * 78_125 / (2 * u128::from(samples))).ok()
    }

    fn begin(&mut self, place: Place, host_ns: i64, offset: i64) {
        self.newest = Some(Newest { place, host_ns });
        self.anchors = [place; 2];
        self.least_offset = offset;
    }

    fn learn(&mut self, gap: u64, before: Place) {
        if self.gaps.len() < RECENT {
            self.gaps.push(gap);
        } else {
            self.gaps[self.oldest_gap] = gap;
            self.oldest_gap = (self.oldest_gap + 1) % RECENT;
        }
        let supported = self.supported();
        let holds =
            |base: u64| supported > Some(base) && self.gaps.iter().any(|&g| is_near(g, base));
        if !self.base.is_some_and(holds) {
            self.base = supported;
        }
        // A mean that is not near the gaps is that of another rate.
        if let (Some(base), Some(mean)) = (self.base, self.mean())
            && !is_near(mean, base)
        {
            self.anchors = [before; 2];
        }
    }

    /// The period in ticks, as ticks per samples.
    fn period(&self) -> Option<(u64, u64)> {
        self.span().or_else(|| Some((self.base?, 1)))
    }

    /// Ticks and samples since the older anchor.
    fn span(&self) -> Option<(u64, u64)> {
        let (newest, anchor) = (self.newest?.place, self.anchors[0]);
        let samples = newest.number - anchor.number;
        (samples > 0).then(|| (newest.ticks - anchor.ticks, samples))
    }

    fn mean(&self) -> Option<u64> {
        let (ticks, samples) = self.span()?;
        Some((ticks + samples / 2) / samples)
    }

    /// The smallest gap that enough others are near to.
    fn supported(&self) -> Option<u64> {
        let enough = 1 + self.gaps.len() / 4;
        let support = |gap: u64| self.gaps.iter().filter(|&&g| is_near(g, gap)).count();
        let supported = self.gaps.iter().copied().filter(|&g| support(g) >= enough);
        supported.min().or(self.gaps.iter().copied().min())
    }

    /// How many periods a gap is, at least one.
    fn periods(&self, gap: u64) -> u64 {
        let (ticks, samples) = self.period().map_or((1, 0), |(t, s)| (t, s));
        let twice = 2 * u128::from(gap) * u128::from(samples) + u128::from(ticks);
        let periods = twice / (2 * u128::from(ticks).max(1));
        u64::try_from(periods).unwrap_or(u64::MAX).max(1)
    }
}

/// Whether two gaps are of one period: within an eighth and two ticks.
///
/// Ticks err by one, so of two gaps of one period one is two ticks short and the other two long at
/// worst.
fn is_near(gap: u64, other: u64) -> bool {
    gap.abs_diff(other) <= other / 8 + 2
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Many losses, and among sixteen gaps the single ones are all two ticks long, where the
    /// shortest was two short.
    #[test]
    fn single_gaps_that_err_the_other_way_are_of_the_same_period() {
        let mut numbers = Numbers::new();
        let mut ticks = 1_000_000;
        let mut number = |gap: u64| {
            ticks += gap;
            let host = 5_000_000_000 + ticks_ns(ticks).expect("in range");
            numbers.number(ticks, host).lost
        };
        for gap in [22, 26, 22, 26, 24, 22, 26, 25, 24, 25] {
            assert_eq!(number(gap), 0);
        }
        for gap in [
            49, 26, 49, 49, 26, 48, 49, 49, 49, 49, 26, 49, 49, 26, 49, 49,
        ]
        .repeat(3)
        {
            assert_eq!(number(gap), u64::from(gap > 40), "a gap of {gap}");
        }
    }

    /// Samples of a device: (true number, ticks, arrival). `period` in 1/16 ticks; ticks err by
    /// one.
    fn device(period: u64, count: u64, jitter: &[i8], lost: &[bool]) -> Vec<(u64, u64, i64)> {
        let sample = |n: u64| {
            let jitter = i64::from(jitter[n as usize % jitter.len()].signum());
            let ticks = (1_000_000 + n * period / 16).saturating_add_signed(jitter);
            let host = 5_000_000_000 + ticks_ns(ticks).expect("in range");
            (n, ticks, host)
        };
        (0..count)
            .filter(|&n| n < 8 || !lost[n as usize % lost.len()])
            .map(sample)
            .collect()
    }

    proptest! {
        /// Whatever the rate, a jitter of a tick and random losses leave every number right.
        #[test]
        fn lost_samples_are_left_out_of_the_numbers(
            period in 16 * 20_u64..16 * 260,
            jitter in prop::collection::vec(-1_i8..=1, 97),
            lost in prop::collection::vec(prop::bool::weighted(0.3), 1009),
        ) {
            let mut numbers = Numbers::new();
            let mut left_out = 0;
            for (n, ticks, host) in device(period, 3000, &jitter, &lost) {
                let numbered = numbers.number(ticks, host);
                prop_assert_eq!((numbered.number, numbered.stepped), (n, false), "at {}", n);
                left_out += numbered.lost;
            }
            let rate = numbers.rate_hz().expect("known");
            let expected = 25_600.0 * 16.0 / period as f64;
            prop_assert!((rate / expected - 1.0).abs() < 1e-3, "{} {}", rate, expected);
            let newest = numbers.newest.expect("some").place.number;
            prop_assert_eq!(left_out + device(period, 3000, &jitter, &lost).len() as u64, newest + 1);
        }

        /// Numbers only grow, whatever the device says.
        #[test]
        fn numbers_only_grow(samples in prop::collection::vec((any::<u64>(), any::<i64>()), 1..200)) {
            let mut numbers = Numbers::new();
            let mut newest = None;
            for (ticks, host) in samples {
                let n = numbers.number(ticks, host).number;
                prop_assert!(Some(n) > newest || n == u64::MAX);
                newest = Some(n);
            }
        }
    }

    /// Feeds samples `range` of a device with this period, ticks; what was numbered last, and lost
    /// in all.
    fn feed(
        numbers: &mut Numbers,
        range: std::ops::Range<u64>,
        period: u64,
        from: u64,
    ) -> (u64, u64) {
        let mut lost = 0;
        let mut last = 0;
        for n in range {
            let ticks = from + n * period;
            let numbered = numbers.number(ticks, ticks_ns(ticks).expect("in range"));
            lost += numbered.lost;
            last = numbered.number;
        }
        (last, lost)
    }

    #[test]
    fn a_hole_of_a_minute_is_counted_to_the_sample() {
        let mut numbers = Numbers::new();
        feed(&mut numbers, 0..48_000, 32, 0);
        let (last, lost) = feed(&mut numbers, 96_000..96_001, 32, 0);
        assert_eq!((last, lost), (96_000, 48_000));
    }

    #[test]
    fn a_rate_that_rises_is_no_loss_and_one_that_falls_soon_none() {
        let mut numbers = Numbers::new();
        let (_, lost) = feed(&mut numbers, 0..1000, 64, 0);
        assert_eq!(lost, 0);
        let (_, lost) = feed(&mut numbers, 1..1000, 32, 999 * 64);
        assert_eq!(lost, 0);
        assert!((numbers.rate_hz().expect("known") - 800.0).abs() < 1.0);
        let (_, lost) = feed(&mut numbers, 1..1000, 64, 999 * 96);
        assert!((1..=16).contains(&lost), "{lost}");
        assert!((numbers.rate_hz().expect("known") - 400.0).abs() < 1.0);
    }

    #[test]
    fn a_device_that_begins_anew_goes_on_by_host_time() {
        let mut numbers = Numbers::new();
        feed(&mut numbers, 0..800, 32, 1 << 30);
        let before = ticks_ns((1 << 30) + 799 * 32).expect("in range");
        let again = numbers.number(77, before + 2_000_000_000);
        assert!(again.stepped);
        assert_eq!(again.lost, 1599);
        let next = numbers.number(77 + 32, before + 2_001_250_000);
        assert_eq!((next.number, next.stepped), (again.number + 1, false));
    }

    #[test]
    fn a_wild_tick_does_not_run_away_with_the_numbers() {
        let mut numbers = Numbers::new();
        feed(&mut numbers, 0..800, 32, 0);
        let host = ticks_ns(800 * 32).expect("in range");
        let wild = numbers.number(1 << 47, host);
        assert_eq!((wild.lost, wild.stepped), (0, true));
        let next = numbers.number(801 * 32, host + 1_250_000);
        assert_eq!((next.lost, next.stepped), (0, true));
    }

    /// A reader that was held up finds what the kernel kept for it, then a hole: no step, whatever
    /// the arrivals.
    #[test]
    fn a_late_reader_sees_a_hole_and_no_step() {
        let mut numbers = Numbers::new();
        feed(&mut numbers, 0..800, 32, 0);
        let late = ticks_ns(800 * 32).expect("in range") + 3_000_000_000;
        for n in 800..864 {
            let numbered = numbers.number(n * 32, late);
            assert_eq!((numbered.lost, numbered.stepped), (0, false));
        }
        let numbered = numbers.number(3200 * 32, late + 1_000_000);
        assert_eq!((numbered.lost, numbered.stepped), (3200 - 864, false));
    }
}
