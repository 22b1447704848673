//! Charts of `feet_length`.

use charts::{Axis, Chart, Series};

use super::runs::{IMAGES, PLAIN, Run};
use super::stage_run::{Minute, StageCost};

/// Names and texts of all charts.
pub(super) fn draw(runs: &[Run], stamp: &str) -> Vec<(String, String)> {
    let subtitle = "rounds of a plaza, feet camera alone; plain data at 224x126, images at 672x376";
    let chart = |title: &str| {
        let axis = Axis::log("minute of the walk, or its length", "min");
        Chart::new(title).subtitle(subtitle).x_axis(axis)
    };
    let time = chart("Processor time for a minute of walking")
        .y_axis(Axis::log("processor time of all threads", "s/min"))
        .series(by_minute(runs, "tags", IMAGES, |own| own.cpu_s).slot(0))
        .series(by_minute(runs, "terrain", PLAIN, |own| own.cpu_s).slot(1))
        .series(by_minute(runs, "terrain", IMAGES, |own| own.cpu_s).slot(2));
    let per_minute = |run: &Run, cost: &StageCost| cost.cpu_s / f64::from(run.minutes);
    let time = time
        .series(by_length(runs, "feet", per_minute).slot(3))
        .series(by_length(runs, "maps", per_minute).slot(4));
    let memory = chart("Memory")
        .y_axis(Axis::log("memory of the stage", "MB"))
        .series(by_minute(runs, "tags", IMAGES, |own| own.memory_mb).slot(0))
        .series(by_minute(runs, "terrain", PLAIN, |own| own.memory_mb).slot(1))
        .series(by_minute(runs, "terrain", IMAGES, |own| own.memory_mb).slot(2))
        .series(by_length(runs, "feet", |_, cost| cost.peak_mb).slot(3))
        .series(by_length(runs, "maps", |_, cost| cost.peak_mb).slot(4));
    let blocks = runs.iter().rfind(|run| run.source == PLAIN);
    let memory = match blocks {
        Some(run) => memory.hline(run.map.blocks_mb, "blocks of voxels, plain data"),
        None => memory,
    };
    [("time", time), ("memory", memory)]
        .map(|(name, chart)| {
            let svg = chart.footnote(stamp).to_svg(760, 420);
            (format!("feet_length-{name}.svg"), svg)
        })
        .to_vec()
}

/// Each minute of the longest walk.
fn by_minute(runs: &[Run], stage: &str, source: &str, of: fn(&Minute) -> f64) -> Series {
    let run = runs.iter().rfind(|run| run.source == source);
    let minutes = run
        .and_then(|run| run.stage(stage))
        .map(|own| &own.minutes[..]);
    let points = (1..).zip(minutes.unwrap_or_default());
    let points = points.map(|(minute, own)| (f64::from(minute), of(own)));
    Series::line(&format!("{stage}, {source}"), points)
}

/// Whole walks of plain data.
fn by_length(runs: &[Run], stage: &str, of: impl Fn(&Run, &StageCost) -> f64) -> Series {
    let own = runs.iter().filter(|run| run.source == PLAIN);
    let costs = own.filter_map(|run| Some((run, run.stage(stage)?)));
    let points = costs.map(|(run, cost)| (f64::from(run.minutes), of(run, cost)));
    Series::line(&format!("{stage}, {PLAIN}, whole walks"), points)
}
