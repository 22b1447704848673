//! Sets of numbers as ranges, first and last number included.

use std::collections::BTreeMap;

/// Sorted, disjoint ranges that cover the same numbers.
pub(crate) fn union(mut ranges: Vec<(u64, u64)>) -> Vec<(u64, u64)> {
    ranges.retain(|(a, b)| a <= b);
    ranges.sort_unstable();
    let mut out: Vec<(u64, u64)> = Vec::new();
    for (a, b) in ranges {
        match out.last_mut() {
            Some(last) if a <= last.1.saturating_add(1) => last.1 = last.1.max(b),
            _ => out.push((a, b)),
        }
    }
    out
}

/// What of `range` is in none of the sorted, disjoint `covers`.
pub(super) fn subtract(range: (u64, u64), covers: &[(u64, u64)]) -> Vec<(u64, u64)> {
    let (mut from, to) = range;
    let mut out = Vec::new();
    let start = covers.partition_point(|c| c.1 < from);
    for &(a, b) in &covers[start..] {
        if a > to {
            break;
        }
        if a > from {
            out.push((from, a - 1));
        }
        from = b.saturating_add(1);
        if from > to || b == u64::MAX {
            return out;
        }
    }
    if from <= to {
        out.push((from, to));
    }
    out
}

/// A set of numbers that grows.
#[derive(Clone, Debug, Default)]
pub(super) struct Ranges(BTreeMap<u64, u64>);

impl Ranges {
    pub(super) fn insert(&mut self, (mut first, mut last): (u64, u64)) {
        if first > last {
            return;
        }
        while let Some((&a, &b)) = self.0.range(..=last).next_back()
            && b >= first
        {
            self.0.remove(&a);
            (first, last) = (first.min(a), last.max(b));
        }
        self.0.insert(first, last);
    }

    /// Whether any number of the range is in the set.
    pub(super) fn overlaps(&self, (first, last): (u64, u64)) -> bool {
        let below = self.0.range(..=last).next_back();
        below.is_some_and(|(_, b)| *b >= first)
    }
}

impl FromIterator<(u64, u64)> for Ranges {
    fn from_iter<I: IntoIterator<Item = (u64, u64)>>(ranges: I) -> Self {
        let mut set = Self::default();
        for range in ranges {
            set.insert(range);
        }
        set
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges() {
        assert_eq!(
            union(vec![(5, 7), (1, 2), (3, 3), (9, 8)]),
            [(1, 3), (5, 7)]
        );
        let covers = [(1, 3), (5, 7)];
        assert_eq!(subtract((0, 9), &covers), [(0, 0), (4, 4), (8, 9)]);
        assert_eq!(subtract((1, 7), &covers), [(4, 4)]);
        assert_eq!(subtract((2, 3), &covers), []);
        assert_eq!(subtract((8, 8), &covers), [(8, 8)]);
        assert_eq!(subtract((0, u64::MAX), &[(3, u64::MAX)]), [(0, 2)]);
    }

    #[test]
    fn a_growing_set_holds_what_was_inserted() {
        let inserted = [
            (40, 44),
            (10, 12),
            (11, 20),
            (60, 50),
            (43, 50),
            (20, 22),
            (0, 0),
        ];
        let set: Ranges = inserted.into_iter().collect();
        for n in 0..70 {
            let is_in = inserted.iter().any(|&(a, b)| (a..=b).contains(&n));
            assert_eq!(set.overlaps((n, n)), is_in, "{n}");
        }
        assert!(set.overlaps((1, 10)) && set.overlaps((22, 39)) && set.overlaps((0, u64::MAX)));
        assert!(!set.overlaps((23, 39)) && !set.overlaps((51, u64::MAX)));
    }
}
