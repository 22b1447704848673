//! Charts of `feet_length`.

use charts::{Axis, Chart, Series};

use super::{Run, STAGES, StageCost};

/// Names and texts of all charts.
pub(super) fn draw(runs: &[Run], stamp: &str) -> Vec<(String, String)> {
    let subtitle = "rounds of a plaza, feet camera alone; plain data at 336x188, images at 672x376";
    let x_axis = || Axis::log("length of the walk", "min");
    let points = |source: &str, stage: &str, of: &dyn Fn(&Run, &StageCost) -> f64| {
        let own = runs.iter().filter(|run| run.source == source);
        let costs = own.filter_map(|run| Some((run, run.stage(stage)?)));
        let point = |(run, cost): (&Run, &StageCost)| (f64::from(run.minutes), of(run, cost));
        costs.map(point).collect::<Vec<(f64, f64)>>()
    };
    let with_stages = |mut chart: Chart, of: &dyn Fn(&Run, &StageCost) -> f64| {
        for source in ["plain data", "images"] {
            for (slot, stage) in STAGES.into_iter().enumerate() {
                let points = points(source, stage, of);
                let name = format!("{stage}, {source}");
                if points.is_empty() {
                    continue;
                }
                let series = match source {
                    "images" => Series::scatter(&name, points),
                    _ => Series::line(&name, points),
                };
                chart = chart.series(series.slot(slot));
            }
        }
        chart
    };
    let chart = |title: &str| Chart::new(title).subtitle(subtitle).x_axis(x_axis());
    let time = chart("Processor time for a minute of walking")
        .y_axis(Axis::log("processor time of all threads", "s/min"));
    let time = with_stages(time, &|run, cost| cost.cpu_s / f64::from(run.minutes));
    let memory = chart("Peak memory").y_axis(Axis::log("memory of the stage", "MB"));
    let memory = with_stages(memory, &|_, cost| cost.peak_mb);
    let blocks = runs.iter().filter(|run| run.source == "plain data");
    let blocks = blocks.map(|run| (f64::from(run.minutes), run.map.blocks_mb));
    let memory = memory.series(Series::line("blocks of voxels, plain data", blocks).slot(4));
    [("time", time), ("memory", memory)]
        .map(|(name, chart)| {
            let svg = chart.footnote(stamp).to_svg(760, 400);
            (format!("feet_length-{name}.svg"), svg)
        })
        .to_vec()
}
