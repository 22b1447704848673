//! Intervals of a line where something was observed.

/// Marks along a line, in bins of a centimetre.
#[derive(Clone, Debug, Default)]
pub(super) struct Runs {
    bins: std::collections::BTreeSet<i32>,
}

/// Length of a bin, m.
pub(super) const BIN_M: f64 = 0.01;

impl Runs {
    pub(super) fn mark(&mut self, along_m: f64) {
        self.bins.insert((along_m / BIN_M).floor() as i32);
    }

    pub(super) fn both(&self, other: &Self) -> Self {
        Self {
            bins: self.bins.intersection(&other.bins).copied().collect(),
        }
    }

    /// Intervals of at least a length that are marked but for gaps; at least half of each is.
    pub(super) fn intervals(&self, min_length_m: f64, max_gap_m: f64) -> Vec<[f64; 2]> {
        let max_gap = (max_gap_m / BIN_M) as i32;
        let mut found = Vec::new();
        let mut run: Option<[i32; 3]> = None;
        let mut close = |run: Option<[i32; 3]>| {
            let Some([from, to, count]) = run else {
                return;
            };
            let bins = to + 1 - from;
            if f64::from(bins) * BIN_M >= min_length_m && 2 * count >= bins {
                found.push([from, to + 1].map(|bin| f64::from(bin) * BIN_M));
            }
        };
        for bin in &self.bins {
            match &mut run {
                Some([_, to, count]) if bin - *to <= max_gap => (*to, *count) = (*bin, *count + 1),
                _ => {
                    close(run);
                    run = Some([*bin, *bin, 1]);
                }
            }
        }
        close(run);
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_split_intervals() {
        let mut runs = Runs::default();
        for i in (0..50).chain(55..80).chain(120..125) {
            runs.mark(0.01 * f64::from(i) + 0.005);
        }
        assert_eq!(runs.intervals(0.1, 0.1), [[0.0, 0.8]]);
        assert_eq!(runs.intervals(0.1, 0.02), [[0.0, 0.5], [0.55, 0.8]]);
    }
}
