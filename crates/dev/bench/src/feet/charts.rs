//! Charts of the results.

use charts::{Axis, Chart, Series};

use super::row::Row;

const SIZE: [u32; 2] = [900, 400];

/// Goals of a rig: contact, mm; heel strike, toe off, ms.
const GOALS: [(&str, [Option<f64>; 3]); 2] = [
    ("example", [Some(15.0), Some(25.0), None]),
    ("recommended", [Some(10.0), Some(20.0), Some(40.0)]),
];
/// Goal of hidden swings, RMS, mm, and of the recall by day, %.
const SWING_GOAL_MM: f64 = 30.0;
const RECALL_GOAL: f64 = 99.0;

/// Name and SVG of every chart.
pub(super) fn draw(rows: &[Row]) -> Vec<(String, String)> {
    let sources = sources(rows);
    let charts = [
        ("recall", recall(rows)),
        ("contacts", contacts(rows)),
        (
            "strikes",
            events(rows, "Heel strikes", 1, |row| row.gait.strike_ms[1]),
        ),
        (
            "toe-offs",
            events(rows, "Toe offs", 2, |row| row.gait.toe_off_ms[1]),
        ),
        ("swings", swings(rows)),
        ("sigmas", sigmas(rows)),
    ];
    let svg = |(name, chart): (&str, Chart)| {
        let chart = chart.footnote(&sources);
        (format!("feet-{name}.svg"), chart.to_svg(SIZE[0], SIZE[1]))
    };
    charts.into_iter().map(svg).collect()
}

/// Where the results of each rig are from: they may be of different runs.
fn sources(rows: &[Row]) -> String {
    let measured = GOALS.iter().filter(|(rig, _)| has(rows, rig));
    let parts = measured.map(|(rig, _)| {
        let own = rows.iter().filter(|row| row.rig == *rig);
        let mut sources: Vec<&str> = own.map(|row| row.source.as_str()).collect();
        sources.dedup();
        format!("{rig}: {}", sources.join(", "))
    });
    parts.collect::<Vec<_>>().join("; ")
}

/// Walks on the horizontal axis, and bars for each rig.
fn by_walk(rows: &[Row], chart: Chart, value: &dyn Fn(&Row) -> f64) -> Chart {
    let mut walks: Vec<&str> = Vec::new();
    for row in rows.iter().filter(|row| row.tags.is_some()) {
        if !walks.contains(&row.walk.as_str()) {
            walks.push(&row.walk);
        }
    }
    let names = walks.iter().map(|walk| {
        let is_held_out = rows.iter().any(|row| row.walk == *walk && row.is_held_out);
        match is_held_out {
            true => format!("{walk} *"),
            false => (*walk).to_owned(),
        }
    });
    let chart = chart.x_axis(Axis::categories("", names));
    let measured = GOALS.iter().filter(|(rig, _)| has(rows, rig));
    measured.fold(chart, |chart, (rig, _)| {
        let of = |walk: &&str| {
            let row = rows.iter().find(|row| row.walk == *walk && row.rig == *rig);
            row.map_or(f64::NAN, value)
        };
        chart.series(Series::bars(rig, walks.iter().map(of)))
    })
}

/// Whether a rig was measured.
fn has(rows: &[Row], rig: &str) -> bool {
    rows.iter().any(|row| row.rig == rig)
}

const BY_JOINT_ANGLES: &str = "*: wearers who walk by joint angles";

fn recall(rows: &[Row]) -> Chart {
    let chart = Chart::new("Shoe tags found")
        .subtitle(&format!(
            "of tags that are whole and visible in both eyes where the foot was seen within 0.15 s; \
             {BY_JOINT_ANGLES}"
        ))
        .y_axis(Axis::linear("found", "%").include(90.0).include(100.0))
        .hline(RECALL_GOAL, "goal by day");
    by_walk(rows, chart, &|row| {
        let tags = row.tags.as_ref();
        tags.map_or(f64::NAN, |tags| {
            100.0 * tags.found_predicted as f64 / tags.predicted.max(1) as f64
        })
    })
}

fn contacts(rows: &[Row]) -> Chart {
    let chart = Chart::new("Where feet stand")
        .subtitle(&format!(
            "error of the middle of the sole in the camera, 95th percentile; {BY_JOINT_ANGLES}"
        ))
        .y_axis(Axis::linear("error", "mm").include(0.0));
    let chart = with_goals(rows, chart, 0);
    by_walk(rows, chart, &|row| row.gait.contact_mm[1])
}

fn events(rows: &[Row], title: &str, goal: usize, value: impl Fn(&Row) -> f64) -> Chart {
    let chart = Chart::new(title)
        .subtitle(&format!(
            "error of their times, 95th percentile; {BY_JOINT_ANGLES}"
        ))
        .y_axis(Axis::linear("error", "ms").include(0.0));
    by_walk(rows, with_goals(rows, chart, goal), &value)
}

fn with_goals(rows: &[Row], chart: Chart, which: usize) -> Chart {
    let measured = GOALS.iter().filter(|(rig, _)| has(rows, rig));
    measured.fold(chart, |chart, (rig, goals)| match goals[which] {
        Some(goal) => chart.hline(goal, &format!("goal, {rig}")),
        None => chart,
    })
}

fn swings(rows: &[Row]) -> Chart {
    let chart = Chart::new("Feet between contacts where no frame shows them")
        .subtitle(&format!(
            "error of the middle of the sole, RMS; {BY_JOINT_ANGLES}"
        ))
        .y_axis(Axis::linear("error", "mm").include(0.0))
        .hline(SWING_GOAL_MM, "goal");
    by_walk(rows, chart, &|row| row.gait.bridged_mm[2])
}

fn sigmas(rows: &[Row]) -> Chart {
    let chart = Chart::new("Feet where no frame shows them: errors within two stated sigmas")
        .subtitle(&format!("along each axis; {BY_JOINT_ANGLES}"))
        .y_axis(Axis::linear("within", "%").include(0.0).include(100.0))
        .hline(95.0, "95 %");
    by_walk(rows, chart, &|row| 100.0 * row.gait.bridged_within)
}
