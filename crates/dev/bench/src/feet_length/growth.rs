//! Growth of cost over the thirds of the longest walk.

use serde::Serialize;

use super::runs::{IMAGES, PLAIN, Run};
use super::stage_run::{Minute, StageCost};
use crate::meter::median;

/// Maximum ratio of the costs of a minute in the last and in the first third.
pub(super) const MAX_GROWTH: f64 = 1.10;
/// First minutes that are not compared: the map is built in them.
const WARMUP_MINUTES: usize = 2;

/// Growth of a stage's cost.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Growth {
    pub(super) stage: &'static str,
    pub(super) source: &'static str,
    /// Processor time for a minute of each third, s.
    pub(super) cpu_s_per_minute: [f64; 3],
    pub(super) last_third_over_first: f64,
    pub(super) last_third_over_second: f64,
    /// Memory in each third, MB: while it is read, or the peak of a walk that ends there.
    pub(super) memory_mb: [f64; 3],
    pub(super) last_memory_over_first: f64,
    time_within_limit: bool,
    memory_within_limit: bool,
}

impl Growth {
    fn new(stage: &'static str, source: &'static str, cpu: [f64; 3], memory: [f64; 3]) -> Self {
        let last_memory_over_first = memory[2] / memory[0];
        let last_third_over_first = cpu[2] / cpu[0];
        Self {
            stage,
            source,
            cpu_s_per_minute: cpu,
            last_third_over_first,
            last_third_over_second: cpu[2] / cpu[1],
            memory_mb: memory,
            last_memory_over_first,
            time_within_limit: last_third_over_first <= MAX_GROWTH,
            memory_within_limit: last_memory_over_first <= MAX_GROWTH,
        }
    }
}

/// Growth of all stages; see the module of the benchmark.
pub(super) fn growth(runs: &[Run]) -> Vec<Growth> {
    let longest = |source: &str| runs.iter().rfind(|run| run.source == source);
    let by_minute = |stage, source| {
        let minutes = &longest(source)?.stage(stage)?.minutes;
        Some(of_minutes(stage, source, minutes))
    };
    let lengths: Vec<&Run> = runs.iter().filter(|run| run.source == PLAIN).collect();
    let by_length = |stage| of_lengths(stage, &lengths);
    let all = [
        by_minute("tags", IMAGES),
        by_minute("terrain", PLAIN),
        by_minute("terrain", IMAGES),
        by_length("feet"),
        by_length("maps"),
    ];
    all.into_iter().flatten().collect()
}

/// Medians of the minutes of each third.
fn of_minutes(stage: &'static str, source: &'static str, minutes: &[Minute]) -> Growth {
    let used = &minutes[WARMUP_MINUTES.min(minutes.len().saturating_sub(1))..];
    let third = |k: usize| &used[k * used.len() / 3..((k + 1) * used.len() / 3).max(1)];
    let of = |of: fn(&Minute) -> f64| [0, 1, 2].map(|k| median(third(k).iter().map(of)));
    Growth::new(stage, source, of(|own| own.cpu_s), of(|own| own.memory_mb))
}

/// Differences of the last three lengths, which are equally long.
fn of_lengths(stage: &'static str, runs: &[&Run]) -> Option<Growth> {
    let [.., first, second, last] = runs else {
        return None;
    };
    let costs = [first, second, last].map(|run| run.stage(stage));
    let [Some(a), Some(b), Some(c)]: [Option<&StageCost>; 3] = costs else {
        return None;
    };
    let third = f64::from(first.minutes);
    let cpu = [a.cpu_s, b.cpu_s - a.cpu_s, c.cpu_s - b.cpu_s].map(|cpu| cpu / third);
    Some(Growth::new(
        stage,
        PLAIN,
        cpu,
        [a.peak_mb, b.peak_mb, c.peak_mb],
    ))
}

#[cfg(test)]
mod tests {
    use super::super::map_size::MapSize;
    use super::*;

    #[test]
    fn a_third_costs_the_difference_of_two_walks() {
        let run = |minutes, cpu_s, peak_mb| Run {
            source: PLAIN.to_owned(),
            minutes,
            keyframes: 0,
            detections: 0,
            stages: vec![StageCost {
                stage: "feet".to_owned(),
                cpu_s,
                wall_s: 0.0,
                peak_mb,
                minutes: Vec::new(),
            }],
            map: MapSize::default(),
        };
        let runs = [
            run(5, 9.0, 1.0),
            run(10, 20.0, 10.0),
            run(20, 50.0, 10.0),
            run(30, 90.0, 12.0),
        ];
        let [own] = &growth(&runs)[..] else {
            panic!("one stage")
        };
        assert_eq!(own.cpu_s_per_minute, [2.0, 3.0, 4.0]);
        assert_eq!(
            (own.last_third_over_first, own.last_memory_over_first),
            (2.0, 1.2)
        );
        assert!(!own.time_within_limit && !own.memory_within_limit);
    }

    #[test]
    fn minutes_count_by_thirds_without_the_first_ones() {
        let minute = |cpu_s| Minute {
            cpu_s,
            memory_mb: 10.0,
            ..Minute::default()
        };
        let costs = [90.0, 80.0, 1.0, 1.0, 9.0, 2.0, 2.0, 2.0, 1.1, 1.1, 1.1];
        let own = of_minutes("terrain", PLAIN, &costs.map(minute));
        assert_eq!(own.cpu_s_per_minute, [1.0, 2.0, 1.1]);
        assert!(own.time_within_limit && own.memory_within_limit);
    }
}
