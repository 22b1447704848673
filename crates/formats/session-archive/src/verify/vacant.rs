//! Which numbers of a session are vacant: what is saved of a damaged chunk may take these and no
//! others, so that no fault comes into the copy that the source does not have.

use std::collections::BTreeMap;

use super::numbers::Numbers;
use super::ranges::Ranges;

/// By stream, the numbers that are taken.
#[derive(Default)]
pub(crate) struct Vacant(BTreeMap<String, StreamNumbers>);

#[derive(Default)]
struct StreamNumbers {
    /// By samples of sound chunks that are in order.
    in_order: Ranges,
    /// By any sample.
    present: Ranges,
    /// By gap records.
    gaps: Ranges,
}

impl Vacant {
    /// Of a session of which every sound chunk was read.
    pub(super) fn new(streams: &BTreeMap<String, Numbers>) -> Self {
        let taken = |numbers: &Numbers| StreamNumbers {
            in_order: numbers.in_order().collect(),
            present: numbers.present().collect(),
            gaps: numbers.gaps.iter().copied().collect(),
        };
        let streams = streams.iter();
        Self(streams.map(|(name, n)| (name.clone(), taken(n))).collect())
    }

    /// Whether these numbers, in order themselves, can come behind `newest` in this stream: none
    /// of them is taken, and everything in order behind them remains so.
    pub(super) fn fits(&self, name: &str, newest: Option<u64>, numbers: &Numbers) -> bool {
        let none = StreamNumbers::default();
        let taken = self.0.get(name).unwrap_or(&none);
        let samples_fit = numbers.present().all(|range| {
            Some(range.0) > newest && !taken.present.overlaps(range) && !taken.gaps.overlaps(range)
        });
        let own: Ranges = numbers.present().collect();
        let is_missing = |range| !taken.present.overlaps(range) && !own.overlaps(range);
        let gaps_fit = numbers.gaps.iter().all(|range| is_missing(*range));
        let behind = newest.map_or(0, |newest| newest.saturating_add(1));
        let last = numbers.newest();
        let passes_none = last.is_none_or(|last| !taken.in_order.overlaps((behind, last)));
        samples_fit && gaps_fit && passes_none
    }

    /// These numbers are no longer vacant.
    pub(super) fn take(&mut self, name: &str, numbers: &Numbers) {
        let taken = self.0.entry(name.to_owned()).or_default();
        for range in numbers.present() {
            taken.present.insert(range);
        }
        for range in &numbers.gaps {
            taken.gaps.insert(*range);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::HostTime;

    fn stream(runs: &[(u64, u64)], gaps: &[(u64, u64)]) -> Numbers {
        let mut n = Numbers::default();
        for &(first, last) in runs {
            n.samples(first, last - first + 1, HostTime(0), HostTime(0));
        }
        n.gaps = gaps.to_vec();
        n
    }

    #[test]
    fn what_fits_is_behind_the_newest_and_before_the_next_in_order() {
        // 5 to 9 came out of order, last.
        let sound = stream(&[(0, 4), (10, 14), (20, 29), (5, 9)], &[(16, 16)]);
        let mut vacant = Vacant::new(&BTreeMap::from([("feet".to_owned(), sound)]));
        let fits = |vacant: &Vacant, newest, runs: &[_], gaps: &[_]| {
            vacant.fits("feet", newest, &stream(runs, gaps))
        };
        assert!(fits(&vacant, Some(14), &[(15, 15), (17, 19)], &[]));
        assert!(fits(&vacant, Some(29), &[(30, 40)], &[(41, 41)]));
        // Below the newest, over the next, over a gap record, over what comes out of order.
        assert!(!fits(&vacant, Some(14), &[(14, 15)], &[]));
        assert!(!fits(&vacant, Some(14), &[(17, 20)], &[]));
        assert!(!fits(&vacant, Some(14), &[(30, 31)], &[]));
        assert!(!fits(&vacant, Some(14), &[(15, 17)], &[]));
        assert!(!fits(&vacant, None, &[(0, 0)], &[]));
        assert!(!fits(&vacant, Some(4), &[(5, 6)], &[]));
        // Its own gap records, over samples of others and over its own.
        assert!(!fits(&vacant, Some(14), &[], &[(8, 8)]));
        assert!(!fits(&vacant, Some(14), &[(15, 15)], &[(15, 15)]));
        // What was saved is taken as well.
        vacant.take("feet", &stream(&[(17, 18)], &[(19, 19)]));
        assert!(!fits(&vacant, Some(18), &[(19, 19)], &[]));
        assert!(!fits(&vacant, Some(18), &[], &[(18, 18)]));
        assert!(vacant.fits("other", None, &stream(&[(0, 3)], &[])));
    }
}
