//! Charts of the results.

use charts::{Axis, Chart, Series};

use super::curve::Point;
use super::daemon::Share;
use super::material::Clip;

const WIDTH: u32 = 720;

/// Name and SVG of every chart.
pub(super) fn draw(
    clips: &[Clip],
    points: &[Point],
    share: Option<&Share>,
    stamp: &str,
) -> Vec<(String, String)> {
    let mut charts = Vec::new();
    for clip in clips {
        let image = &clip.images[0];
        let subtitle = format!(
            "{}: {}, {}x{} at {} Hz; labels: quality target, dB",
            clip.name,
            clip.shows,
            image.width,
            image.height,
            (clip.rate_hz * 100.0).round() / 100.0
        );
        let chart = |title: &str, x: Axis, of: &dyn Fn(&Point) -> f64| {
            let chart = Chart::new(title)
                .subtitle(&subtitle)
                .x_axis(x)
                .y_axis(Axis::linear("luma PSNR, mean", "dB"))
                .footnote(stamp);
            let place = |point: &Point| (of(point), point.psnr_db);
            let label = |point: &Point| point.target_db.to_string();
            by_encoder(chart, points, |p| p.clip == clip.name, &place, &label).to_svg(WIDTH, 400)
        };
        charts.push((
            format!("bitrate-{}", clip.name),
            chart(
                "Quality against bit rate",
                Axis::log("bit rate", "Mbit/s"),
                &|p| p.mbit_s,
            ),
        ));
        charts.push((
            format!("cpu-{}", clip.name),
            chart(
                "Quality against processor time",
                Axis::log("CPU time per stereo frame", "ms"),
                &|p| p.cpu_ms,
            ),
        ));
    }
    charts.push(("target".to_owned(), target(points, stamp)));
    charts.extend(share.map(|share| ("daemon".to_owned(), daemon(share, stamp))));
    charts
}

/// A line for each encoder, the same color in every chart.
fn by_encoder(
    chart: Chart,
    points: &[Point],
    which: impl Fn(&Point) -> bool,
    place: &dyn Fn(&Point) -> (f64, f64),
    label: &dyn Fn(&Point) -> String,
) -> Chart {
    let mut elements: Vec<&str> = points.iter().map(|point| point.element).collect();
    elements.dedup();
    elements
        .iter()
        .enumerate()
        .fold(chart, |chart, (slot, element)| {
            let chosen = || points.iter().filter(|p| p.element == *element && which(p));
            let labels = chosen().map(label);
            let line = Series::line(element, chosen().map(place)).slot(slot);
            chart.series(line.labels(labels))
        })
}

/// Quality against its target, on the clip with the lowest quality.
fn target(points: &[Point], stamp: &str) -> String {
    let chart = Chart::new("Quality minus quality target")
        .subtitle(
            "mean luma PSNR minus target, on the clip with the lowest; below zero misses the target",
        )
        .x_axis(Axis::linear("quality target", "dB"))
        .y_axis(Axis::linear("quality minus target", "dB").include(0.0))
        .hline(0.0, "target")
        .footnote(stamp);
    let beyond = |point: &Point| point.psnr_db - point.target_db;
    let is_least = |point: &Point| {
        let same = |p: &&Point| p.element == point.element && p.target_db == point.target_db;
        points
            .iter()
            .filter(same)
            .all(|p| beyond(p) >= beyond(point))
    };
    by_encoder(
        chart,
        points,
        is_least,
        &|p| (p.target_db, beyond(p)),
        &|p| p.clip.to_owned(),
    )
    .to_svg(WIDTH, 320)
}

fn daemon(share: &Share, stamp: &str) -> String {
    let names = [
        "recording daemon",
        "bare gst-launch-1.0",
        "of it, reading images",
    ];
    let subtitle = format!(
        "three cameras, x264enc at 42 dB, in real time, written to a disk; the daemon takes {:.3} \
         times the bare pipeline's",
        share.ratio()
    );
    Chart::new("Overhead of the daemon over its encoders")
        .subtitle(&subtitle)
        .x_axis(Axis::categories("", names))
        .y_axis(Axis::linear("CPU time per stereo frame", "ms").include(0.0))
        .series(Series::bars(
            "",
            [share.daemon_ms(), share.bare_ms(), share.reading_ms],
        ))
        .footnote(stamp)
        .to_svg(WIDTH, 320)
}
