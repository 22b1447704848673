//! Charts of `terrain`, drawn from its report.

use charts::{Axis, Chart, Series};
use serde_json::{Map, Value};

use crate::stamp;

const WIDTH: u32 = 760;
const HEIGHT: u32 = 420;

/// Names and texts of all charts that there are results for.
pub(super) fn draw(report: &Map<String, Value>) -> Vec<(String, String)> {
    let mut files = Vec::new();
    for (part, found) in report {
        let drawn = match part.as_str() {
            "walks" => vec![
                ("heights", heights(found)),
                ("edges", edges(found)),
                ("parts", parts(found)),
            ],
            "voxels" => vec![
                ("voxels-error", voxel_errors(found)),
                ("voxels-time", voxel_times(found)),
                ("voxels-memory", voxel_memory(found)),
            ],
            "open3d" => vec![("open3d", open3d(found))],
            _ => Vec::new(),
        };
        let foot = stamp::source(&found["stamp"]);
        for (name, chart) in drawn {
            let svg = chart.footnote(&foot).to_svg(WIDTH, HEIGHT);
            files.push((format!("terrain-{name}.svg"), svg));
        }
    }
    files
}

/// A number by its path.
fn number(of: &Value, path: &str) -> f64 {
    let found = path.split('.').fold(of, |of, key| &of[key]);
    found.as_f64().unwrap_or(f64::NAN)
}

/// A quantile of a path; none if it has no errors.
fn quantile(of: &Value, path: &str, key: &str) -> f64 {
    match number(of, &format!("{path}.count")) > 0.0 {
        true => number(of, &format!("{path}.{key}")),
        false => f64::NAN,
    }
}

fn rows(found: &Value) -> &[Value] {
    found.as_array().map_or(&[], Vec::as_slice)
}

/// Scene, light if it is not day, and columns if they are not 672.
fn short_name(row: &Value) -> String {
    let text = |key: &str| row[key].as_str().unwrap_or("?");
    let night = if text("light") == "day" { "" } else { " night" };
    let size = match row["columns"].as_u64() {
        Some(672) | None => String::new(),
        Some(_) => " 720p".to_owned(),
    };
    format!("{}{night}{size}", text("scene"))
}

fn of_depth<'a>(found: &'a Value, depth: &str) -> Vec<&'a Value> {
    rows(&found["rows"])
        .iter()
        .filter(|row| row["depth"] == depth)
        .collect()
}

/// A category per walk, and a series per measure.
fn by_walk(found: &Value, chart: Chart, measures: &[(&str, &str, &str)]) -> Chart {
    let mut stereo = of_depth(found, "stereo");
    // Scenes without steps have no errors of edges.
    stereo.retain(|row| {
        measures
            .iter()
            .any(|(_, _, path)| number(row, &format!("{path}.count")) > 0.0)
    });
    let names: Vec<String> = stereo.iter().map(|row| short_name(row)).collect();
    let chart = chart.x_axis(Axis::categories("", names.clone()));
    measures.iter().fold(chart, |chart, (name, depth, path)| {
        let own = of_depth(found, depth);
        let value = |name: &String| {
            let row = own.iter().find(|row| short_name(row) == *name);
            row.map_or(f64::NAN, |row| quantile(row, path, "p95_mm"))
        };
        let values = names.iter().enumerate();
        chart.series(Series::scatter(
            name,
            values.map(|(k, name)| (k as f64, value(name))),
        ))
    })
}

fn heights(found: &Value) -> Chart {
    let chart = Chart::new("Height errors under soles")
        .subtitle("95th percentile; simulated walks with true poses; 672x376 but where 720p")
        .y_axis(Axis::linear("height error", "mm").include(0.0));
    let measures = [
        ("distance field", "stereo", "scores.field_height"),
        ("mesh", "stereo", "scores.mesh_height"),
        ("maps", "stereo", "scores.map_height"),
        ("mesh, true depth", "true depth", "scores.mesh_height"),
        ("maps, true depth", "true depth", "scores.map_height"),
    ];
    by_walk(found, chart, &measures).hline(10.0, "goal")
}

fn edges(found: &Value) -> Chart {
    let chart = Chart::new("Errors of step edges")
        .subtitle("95th percentile of the edges found; stereo, true poses")
        .y_axis(Axis::linear("error", "mm").include(0.0));
    let measures = [
        ("height of the riser", "stereo", "scores.edges.riser"),
        ("position, going up", "stereo", "scores.edges.up"),
        ("position, going down", "stereo", "scores.edges.down"),
    ];
    by_walk(found, chart, &measures)
        .hline(3.0, "riser at 720p")
        .hline(6.0, "riser at 672")
        .hline(10.0, "position, up")
        .hline(15.0, "position, down")
}

fn parts(found: &Value) -> Chart {
    let chart = Chart::new("Convex parts: height error under soles against their number")
        .subtitle("collision surface against the true ground; the default is marked")
        .x_axis(Axis::log("parts per 100 m²", ""))
        .y_axis(Axis::linear("95th percentile", "mm").include(0.0));
    let curves = of_depth(found, "stereo").into_iter().map(|row| {
        let points = rows(&row["parts"]).iter();
        let at = |own: &Value| {
            (
                number(own, "parts_per_100_m2"),
                quantile(own, "sole_height", "p95_mm"),
            )
        };
        let label = |own: &Value| match (number(own, "uncovered_share") - 0.25).abs() < 1e-9 {
            true => "default",
            false => "",
        };
        let labels: Vec<&str> = points.clone().map(label).collect();
        Series::line(&short_name(row), points.map(at)).labels(labels)
    });
    curves
        .fold(chart, Chart::series)
        .hline(10.0, "goal")
        .vline(500.0, "goal")
}

/// A line per walk and measure over the size of voxels.
fn over_voxels(found: &Value, chart: Chart, measures: &[(&str, &str)]) -> Chart {
    let chart = chart.x_axis(Axis::linear("edge of a voxel", "cm").include(0.0));
    let lines = rows(&found["rows"]).iter().flat_map(|row| {
        let walk = row["walk"].as_str().unwrap_or("?");
        let mut words = walk.split('-');
        let scene = words.next().unwrap_or("?");
        let size = words.next_back().unwrap_or("?");
        measures.iter().map(move |(name, path)| {
            let points = rows(&row["curve"]).iter();
            let value = |own: &Value| match path.split_once('.') {
                Some((errors, key)) => quantile(own, errors, key),
                None => number(own, path),
            };
            let at = |own: &Value| (100.0 * number(own, "voxel_m"), value(own));
            let name = match name.is_empty() {
                true => format!("{scene} {size}"),
                false => format!("{scene} {size}, {name}"),
            };
            Series::line(&name, points.map(at))
        })
    });
    lines
        .fold(chart, Chart::series)
        .vline(100.0 * number(&found["rows"][0], "chosen_m"), "chosen")
}

fn voxel_errors(found: &Value) -> Chart {
    let chart = Chart::new("Errors against the size of voxels")
        .subtitle("95th percentiles; mesh within 0.6 m of footprints, heights of risers")
        .y_axis(Axis::linear("error", "mm").include(0.0));
    let measures = [("mesh", "near_height.p95_mm"), ("risers", "riser.p95_mm")];
    over_voxels(found, chart, &measures)
}

fn voxel_times(found: &Value) -> Chart {
    let chart = Chart::new("Processor time of a keyframe against the size of voxels")
        .subtitle("all threads, without decoding: fusion, and the second pass for the planes")
        .y_axis(Axis::log("processor time of a keyframe", "ms"));
    over_voxels(
        found,
        chart,
        &[("fusion", "fusion_cpu_ms"), ("planes", "refinement_cpu_ms")],
    )
}

fn voxel_memory(found: &Value) -> Chart {
    let chart = Chart::new("Memory of the distance field against the size of voxels")
        .subtitle("walks of 10 to 20 s")
        .y_axis(Axis::log("memory", "MB"));
    over_voxels(found, chart, &[("", "mbytes")])
}

fn open3d(found: &Value) -> Chart {
    let all = rows(&found["rows"]);
    let mut names: Vec<&str> = Vec::new();
    for row in all {
        let name = row["name"].as_str().unwrap_or("?");
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let version = found["rows"][0]["open3d"].as_str().unwrap_or("?");
    let chart = Chart::new("Mesh of the distance field: height error against processor time")
        .subtitle(&format!(
            "the same depth maps of simulated walks, 2 cm voxels, two threads; Open3D {version}"
        ))
        .x_axis(Axis::log(
            "processor time of the fusion of a keyframe",
            "ms",
        ))
        .y_axis(Axis::linear("95th percentile within 0.6 m of footprints", "mm").include(0.0));
    let series = names.iter().map(|name| {
        let own: Vec<&Value> = all
            .iter()
            .filter(|row| row["name"] == *name && row["walk"] != "kitchen")
            .collect();
        let labels: Vec<&str> = own
            .iter()
            .map(|row| {
                row["walk"]
                    .as_str()
                    .and_then(|f| f.split('-').next())
                    .unwrap_or("?")
            })
            .collect();
        let at = |row: &&Value| (number(row, "ms.cpu_ms"), number(row, "near_height.p95_mm"));
        Series::scatter(name, own.iter().map(at)).labels(labels)
    });
    series.fold(chart, Chart::series)
}
