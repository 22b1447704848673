//! Charts of `odometry_encoding`.

use charts::{Axis, Chart, Series};

use super::Point;
use crate::odometry::figures::Figures;

/// Names and texts of all charts.
pub(super) fn draw(points: &[Point], stamp: &str) -> Vec<(String, String)> {
    let mut files = Vec::new();
    let mut add = |name: String, chart: Chart| {
        let svg = chart.footnote(stamp).to_svg(760, 400);
        files.push((format!("odometry_encoding-{name}.svg"), svg));
    };
    let mut walks: Vec<&str> = points.iter().map(|p| p.walk).collect();
    walks.dedup();
    let percent = |figures: &Figures| figures.ate_percent.unwrap_or(f64::NAN);
    for walk in walks {
        let own: Vec<&Point> = points.iter().filter(|p| p.walk == walk).collect();
        let error = |name: &str, of: &dyn Fn(&Point) -> f64| {
            let y = Axis::linear("ATE", "% of path length").include(0.0);
            chart(
                &format!("Error against bit rate, {name} poses"),
                walk,
                &own,
                y,
                of,
            )
        };
        add(
            format!("causal-{walk}"),
            error("causal", &|p| percent(&p.causal)),
        );
        add(
            format!("adjusted-{walk}"),
            error("adjusted", &|p| percent(&p.adjusted)),
        );
        let y = Axis::linear("inliers, mean of a set", "");
        let inliers = chart("Inliers against bit rate", walk, &own, y, &|p| p.inliers);
        add(format!("inliers-{walk}"), inliers);
        let depth = |title: &str, unit: &str, of: &dyn Fn(&Point) -> f64| {
            let y = Axis::linear(unit, "% of pixels visible in both images");
            chart(title, walk, &own, y, &|p| 1e2 * of(p))
        };
        add(
            format!("depth-{walk}"),
            depth(
                "Depth absent or with an error of more than 2 px against bit rate",
                "absent or bad",
                &|p| p.depth.bad_2_of_all,
            ),
        );
        add(
            format!("density-{walk}"),
            depth("Density of depth against bit rate", "with depth", &|p| {
                p.depth.density
            }),
        );
    }
    files
}

fn chart(title: &str, walk: &str, points: &[&Point], y: Axis, of: &dyn Fn(&Point) -> f64) -> Chart {
    let mut chart = Chart::new(title)
        .subtitle(&format!(
            "{walk}, three stereo cameras of 2x672x376 at 15 Hz, balanced; labels: quality target, dB"
        ))
        .x_axis(Axis::log("bit rate of all three cameras", "Mbit/s"))
        .y_axis(y);
    let mut names: Vec<&str> = Vec::new();
    for point in points {
        if point.result.is_some() && !names.contains(&point.encoding.as_str()) {
            names.push(&point.encoding);
        }
    }
    for name in names {
        let own = points.iter().filter(|p| p.encoding == name);
        let own: Vec<_> = own
            .filter_map(|p| Some((p.result.as_ref()?.mbit_s, of(p), p.target_db?)))
            .collect();
        let labels = own.iter().map(|(_, _, db)| db.to_string());
        let line = Series::line(name, own.iter().map(|(x, y, _)| (*x, *y)));
        chart = chart.series(line.labels(labels));
    }
    let bare = points.iter().find(|p| p.result.is_none());
    match bare {
        Some(bare) => chart.hline(of(bare), "not encoded"),
        None => chart,
    }
}
