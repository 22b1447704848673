//! Bridging of small gaps.
//!
//! A single dropped sample now and then would cut a long recording into runs too short for long
//! averages. A short gap that is a whole number of periods is filled with the mean of the second
//! around it; the noise missing in the fill is no more than its fraction of the samples.

use super::config::BridgingConfig;
use super::series::{Finding, Series, Severity};

impl Series {
    /// The series with its small gaps filled, and a finding about it; unchanged if there are none
    /// or too many.
    #[must_use]
    pub fn bridged(self, config: &BridgingConfig) -> Self {
        let Some(fills) = self.fills(config) else {
            return self;
        };
        let missing: usize = fills.iter().map(|fill| fill.1).sum();
        let n = self.times_s.len() + missing;
        let mut filled = Self {
            nominal_rate_hz: self.nominal_rate_hz,
            times_s: Vec::with_capacity(n),
            temperature_c: Vec::with_capacity(n),
            axes: [(); 6].map(|()| Vec::with_capacity(n)),
            runs: Vec::new(),
            bridged: self.bridged,
        };
        let half = (0.5 * self.nominal_rate_hz).ceil() as usize;
        let mut start = 0;
        for (i, run) in self.runs.iter().enumerate() {
            filled.times_s.extend(&self.times_s[run.clone()]);
            for (to, from) in filled.axes.iter_mut().zip(&self.axes) {
                to.extend(&from[run.clone()]);
            }
            if !self.temperature_c.is_empty() {
                filled
                    .temperature_c
                    .extend(&self.temperature_c[run.clone()]);
            }
            let Some(&(_, missing)) = fills.iter().find(|fill| fill.0 == i) else {
                filled.runs.push(start..filled.times_s.len());
                start = filled.times_s.len();
                continue;
            };
            let (before, after) = (run.end - 1, self.runs[i + 1].start);
            let from = self.times_s[before];
            let step = (self.times_s[after] - from) / (missing + 1) as f64;
            filled
                .times_s
                .extend((1..=missing).map(|k| from + k as f64 * step));
            let around = [
                run.end.saturating_sub(half).max(run.start)..run.end,
                after..(after + half).min(self.runs[i + 1].end),
            ];
            for (to, values) in filled.axes.iter_mut().zip(&self.axes) {
                let near = || around.iter().flat_map(|range| &values[range.clone()]);
                let mean = near().sum::<f64>() / near().count() as f64;
                to.extend(std::iter::repeat_n(mean, missing));
            }
            if !self.temperature_c.is_empty() {
                let last = self.temperature_c[before];
                filled
                    .temperature_c
                    .extend(std::iter::repeat_n(last, missing));
            }
        }
        let gaps = match fills.len() {
            1 => "1 short gap".to_owned(),
            n => format!("{n} short gaps"),
        };
        filled.bridged.push(Finding {
            severity: Severity::Note,
            kind: "bridged",
            text: format!("{gaps} of {missing} samples in all filled with the mean around"),
        });
        filled
    }

    /// Runs followed by a small gap, with the number of missing samples.
    fn fills(&self, config: &BridgingConfig) -> Option<Vec<(usize, usize)>> {
        let mut steps: Vec<f64> = self
            .runs
            .iter()
            .filter(|run| run.len() > 1)
            .map(|run| {
                (self.times_s[run.end - 1] - self.times_s[run.start]) / (run.len() - 1) as f64
            })
            .collect();
        steps.sort_by(f64::total_cmp);
        let period = *steps.get(steps.len() / 2)?;
        let mut fills = Vec::new();
        for (i, pair) in self.runs.windows(2).enumerate() {
            let gap = self.times_s[pair[1].start] - self.times_s[pair[0].end - 1];
            let periods = gap / period;
            let on_grid =
                (periods - periods.round()).abs() < config.max_grid_deviation && periods >= 1.5;
            if on_grid && gap <= config.max_gap_s.max(1.5 * period) + period {
                fills.push((i, periods.round() as usize - 1));
            }
        }
        let missing: usize = fills.iter().map(|fill| fill.1).sum();
        let few = missing as f64 <= config.max_filled_ratio * self.times_s.len() as f64;
        (missing > 0 && few).then_some(fills)
    }
}
