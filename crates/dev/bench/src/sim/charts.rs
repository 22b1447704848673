//! Charts of the results.

use charts::{Axis, Chart, Series};

use super::{Place, TARGET_ACCURATE, TARGET_FAST};

const WIDTH: u32 = 720;

/// Name and SVG of every chart.
pub(super) fn draw(places: &[Place], stamp: &str) -> Vec<(String, String)> {
    vec![
        (
            "sim.svg".to_owned(),
            quality(places, stamp).to_svg(WIDTH, 420),
        ),
        (
            "sim-stages.svg".to_owned(),
            stages(places, stamp).to_svg(WIDTH, 340),
        ),
    ]
}

fn quality(places: &[Place], stamp: &str) -> Chart {
    let looks = |[least, most]: [u32; 2]| match least == most {
        true => least.to_string(),
        false => format!("{least} to {most}"),
    };
    let chart = Chart::new("Quality of simulated images against speed")
        .subtitle(
            "three stereo cameras, 672x376 per eye, day, two threads; labels: samples per pixel, \
             from standing still to moving",
        )
        .x_axis(
            Axis::log("frame sets per second", "1/s")
                .include(1.0)
                .include(100.0),
        )
        .y_axis(Axis::linear("PSNR against many samples, no noise", "dB"))
        .vline(TARGET_FAST, "target, 1 look")
        .vline(TARGET_ACCURATE, "target, 4 to 12")
        .footnote(stamp);
    let series = places.iter().enumerate().map(|(i, place)| {
        let points = &place.points;
        let line = Series::line(
            place.kind.name(),
            points.iter().map(|p| (p.sets_per_s, p.psnr_db())),
        );
        // The same for all: labelled once.
        match i {
            0 => line.labels(points.iter().map(|p| looks(p.looks))),
            _ => line,
        }
    });
    series.fold(chart, Chart::series)
}

fn stages(places: &[Place], stamp: &str) -> Chart {
    let chart = Chart::new("Time of a stereo frame by stage")
        .subtitle("one sample per pixel, 2 x 672x376, mean of the cameras, one thread")
        .x_axis(Axis::categories("", places.iter().map(|p| p.kind.name())))
        .y_axis(Axis::linear("CPU time", "ms").include(0.0))
        .footnote(stamp);
    (0..4).fold(chart, |chart, stage| {
        let name = places.first().map_or("", |p| p.stages.parts()[stage].0);
        let values = places.iter().map(|p| p.stages.parts()[stage].1);
        chart.series(Series::bars(name, values))
    })
}
