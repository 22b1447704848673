//! Draws one of everything, with synthetic numbers:
//! `cargo run -p charts --example gallery -- FOLDER`.

use charts::{Axis, Bins, Cell, Chart, Page, Series, Span, Table, Timeline, Verdict};
use std::{env, fs, path::PathBuf};

/// A small generator, so that the gallery is the same everywhere.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

fn main() -> std::io::Result<()> {
    let folder = PathBuf::from(env::args().nth(1).unwrap_or_else(|| "gallery".into()));
    fs::create_dir_all(&folder)?;
    let mut page = Page::new("Gallery & health report of session <0192>")
        .verdict(Verdict::Warn)
        .text("Synthetic numbers that show what the charts look like, in the order of a health report.")
        .table(&checks())
        .finding(Verdict::Warn, "left_shoulder lost 41 frames in 3 gaps; the longest took 1.2 s.");
    for (name, section, svg) in images() {
        fs::write(folder.join(format!("{name}.svg")), &svg)?;
        page = page.section(section).figure(
            &svg,
            &format!("{name}.svg, {} kB", svg.len().div_ceil(1000)),
        );
    }
    fs::write(folder.join("index.html"), page.to_html())
}

fn checks() -> Table {
    let n = Cell::number;
    Table::new(["check", "stream", "value", "limit", "verdict"])
        .row([
            "frames lost".into(),
            "left_shoulder".into(),
            n("0.038 %"),
            n("0.1 %"),
            Verdict::Pass.into(),
        ])
        .row([
            "longest gap".into(),
            "left_shoulder".into(),
            n("1.20 s"),
            n("0.50 s"),
            Verdict::Warn.into(),
        ])
        .row([
            "misalignment".into(),
            "feet & <all>".into(),
            n("41.7 ms"),
            n("10.0 ms"),
            Verdict::Fail.into(),
        ])
}

fn images() -> Vec<(&'static str, &'static str, String)> {
    let mut noise = Noise(7);
    let hour = 3600 * 30;
    let times: Vec<f64> = (0..hour).map(|i| i as f64 / 30.0).collect();

    let mut intervals = |centre: f64, spread: f64| -> Vec<f64> {
        (0..hour)
            .map(|_| {
                centre + spread * noise.normal() + if noise.uniform() < 2e-4 { centre } else { 0.0 }
            })
            .collect()
    };
    let (left, right, feet) = (
        intervals(33.3, 0.25),
        intervals(33.4, 0.5),
        intervals(66.7, 0.8),
    );
    let rates = Chart::new("Frame rate")
        .subtitle("frames per second, over 10 s")
        .x_axis(Axis::time("time in session"))
        .y_axis(Axis::linear("rate", "Hz").include(0.0))
        .series(Series::steps(
            "left_shoulder",
            (0..360).map(|i| (f64::from(i) * 10.0, if i == 120 { 18.2 } else { 30.0 })),
        ))
        .series(Series::steps(
            "right_shoulder",
            (0..360).map(|i| (f64::from(i) * 10.0, 29.9 - f64::from(i % 7) * 0.05)),
        ))
        .series(Series::steps(
            "feet",
            (0..360).map(|i| {
                (
                    f64::from(i) * 10.0,
                    if (200..215).contains(&i) { 0.0 } else { 15.0 },
                )
            }),
        ))
        .vline(2000.0, "feet silent")
        .to_svg(720, 280);

    let gap = |from: f64, to: f64| Span { from, to, kind: 2 };
    let whole = Span {
        from: 0.0,
        to: 3600.0,
        kind: 0,
    };
    let many = (0..100_000).map(|i| Span {
        from: f64::from(i) * 0.036,
        to: f64::from(i) * 0.036 + 0.02,
        kind: (i / 7000 % 3) as usize,
    });
    let timeline = Timeline::new("Streams and gaps", Axis::time("time in session"))
        .subtitle("what is shorter than a pixel is drawn one pixel wide")
        .kinds(["present", "late", "gap", "damaged"])
        .row(
            "left_shoulder/video",
            "3 gaps, 1.9 s",
            [
                whole,
                gap(1200.0, 1201.2),
                gap(1900.0, 1900.4),
                gap(1901.0, 1901.3),
            ],
        )
        .row("right_shoulder/video", "", [whole])
        .row("feet/video", "1 gap, 150 s", [whole, gap(2000.0, 2150.0)])
        .row("feet/imu", "100 000 events", many)
        .row(
            "a stream with a very long name & more/video",
            "damaged 12 s",
            [
                whole,
                Span {
                    from: 3000.0,
                    to: 3012.0,
                    kind: 3,
                },
            ],
        )
        .mark(0.0, "start")
        .mark(1195.0, "mark: kitchen")
        .mark(1215.0, "mark: stairs")
        .mark(3599.0, "stop")
        .to_svg(720);

    let histogram = Chart::new("Interval between frames")
        .x_axis(Axis::linear("interval", "ms"))
        .y_axis(Axis::log("frames", ""))
        .series(Series::histogram(
            "left_shoulder",
            left.clone(),
            Bins::Width(1.0),
        ))
        .series(Series::histogram(
            "right_shoulder",
            right.iter().copied().chain([f64::NAN]),
            Bins::Width(1.0),
        ))
        .series(Series::histogram(
            "feet",
            feet.iter().copied(),
            Bins::Width(1.0),
        ))
        .vline(33.333, "30 Hz")
        .vline(66.667, "15 Hz")
        .to_svg(720, 280);

    let interval_line = Chart::new("Interval between frames, in time")
        .x_axis(Axis::time("time in session"))
        .y_axis(Axis::linear("interval", "ms"))
        .series(Series::line(
            "left_shoulder",
            times.iter().copied().zip(left.iter().copied()),
        ))
        .series(Series::line(
            "right_shoulder",
            times.iter().copied().zip(right.iter().map(|v| v - 10.0)),
        ))
        .hline(50.0, "limit: 1.5 periods")
        .to_svg(720, 280);

    let sync = Chart::new("Sync error of frame sets")
        .subtitle("time of the free-running camera minus time of the triggered pair; 108 000 sets")
        .x_axis(Axis::time("time in session"))
        .y_axis(Axis::linear("error", "ms"))
        .hline(-5.0, "accepted from")
        .hline(5.0, "accepted to")
        .series(Series::scatter(
            "feet − left_shoulder",
            times
                .iter()
                .enumerate()
                .map(|(i, t)| (*t, 1.5 * (t / 300.0).sin() + (left[i] - 33.3) * 2.0)),
        ))
        .to_svg(720, 280);

    let rate_distortion = |name: &str, shift: f64, gain: f64| {
        let points = [2.0, 4.0, 8.0, 16.0, 32.0]
            .map(|mbit: f64| (mbit * shift, 33.0 + gain * mbit.log2() * 2.2));
        Series::line(name, points).labels(["q 36", "q 30", "q 26", "q 22", "q 18"])
    };
    let encoders = Chart::new("Quality against bitrate")
        .subtitle(
            "KITTI_sequence_1, side by side, 2484×376 at 10 Hz; higher and further left is better",
        )
        .x_axis(Axis::log("bitrate", "Mbit/s"))
        .y_axis(Axis::linear("PSNR", "dB"))
        .series(rate_distortion("x264enc, veryfast", 1.0, 1.0))
        .series(rate_distortion("x265enc, fast", 0.7, 1.06))
        .series(rate_distortion("vah265enc", 1.15, 0.97))
        .hline(40.0, "required")
        .footnote("synthetic numbers; here stand machine, commit and command")
        .to_svg(720, 400);

    let point = |name: &str, cost: f64, error: f64, slot: usize| {
        Series::scatter(name, [(cost, error)])
            .labels([name])
            .slot(slot)
    };
    let tradeoff = Chart::new("Clock map: error against cost")
        .subtitle(
            "p99 of the mapped time after 10 s with 1 ms exponential jitter; lower left is better",
        )
        .x_axis(Axis::log("cost per sample", "ns"))
        .y_axis(Axis::log("p99 error", "us"))
        .series(point("arrival stamps", 1.1, 4600.0, 6))
        .series(point("least squares", 25.0, 1100.0, 1))
        .series(point("published method", 31.0, 1300.0, 3))
        .series(
            Series::line(
                "lower envelope (ours)",
                [(42.0, 90.0), (110.0, 61.0), (1900.0, 58.0)],
            )
            .labels(["fast", "balanced", "accurate"])
            .slot(0),
        )
        .hline(100.0, "target")
        .footnote("synthetic numbers")
        .to_svg(720, 400);

    let throughput = Chart::new("Archive: throughput by message size")
        .x_axis(Axis::categories("", ["1 kB", "16 kB", "256 kB", "4 MB"]))
        .y_axis(Axis::linear("throughput", "GB/s"))
        .series(Series::bars("ours, with sync", [0.31, 0.9, 1.41, 1.52]))
        .series(Series::bars("ours, page cache", [0.55, 1.6, 2.41, 2.6]))
        .series(Series::bars("bare mcap crate", [0.61, 1.7, 2.5, f64::NAN]))
        .hline(1.0, "required in the page cache")
        .footnote("synthetic numbers")
        .to_svg(720, 320);

    let slanted = Chart::new("One series, long names")
        .x_axis(Axis::categories(
            "source",
            [
                "EuRoC V1_01 easy",
                "KITTI sequence 1",
                "desk pair, looping",
                "a name that is far too long to be shown whole",
                "x264 < 1 & \"2\"",
                "six",
                "seven",
                "eight",
            ],
        ))
        .y_axis(Axis::linear("difference", "%"))
        .series(Series::bars(
            "",
            [1.0, -2.5, 4.0, 3.3, -0.7, 0.0, 2.0, 1.25],
        ))
        .to_svg(720, 320);

    let strength = Chart::new("Error against jitter")
        .subtitle("median of 200 runs")
        .x_axis(Axis::log("latency jitter", "ms"))
        .y_axis(Axis::log("error", "ms"))
        .series(
            Series::line(
                "median",
                (0..21).map(|i| {
                    (
                        0.1 * 10f64.powf(f64::from(i) / 10.0),
                        0.008 * 1.3f64.powi(i),
                    )
                }),
            )
            .slot(0),
        )
        .series(
            Series::scatter(
                "flagged",
                [(5.0, 1.9), (8.0, 3.0), (9.0, f64::INFINITY), (10.0, 0.0)],
            )
            .slot(1),
        )
        .to_svg(720, 300);

    let narrow = Chart::new("A chart in a narrow place with a title that needs a second line")
        .x_axis(Axis::time("time"))
        .y_axis(Axis::linear("disk", "GB"))
        .series(Series::line(
            "free space of the recording disk",
            (0..600).map(|i| (f64::from(i), 500.0 - f64::from(i) * 0.03)),
        ))
        .to_svg(320, 240);

    let nothing = Chart::new("Temperature")
        .x_axis(Axis::time("time in session"))
        .y_axis(Axis::linear("temperature", "°C"))
        .series(Series::line("soc", []))
        .to_svg(720, 200);

    vec![
        ("rates", "Rates", rates),
        ("timeline", "Gaps", timeline),
        ("histogram", "Intervals", histogram),
        ("interval-line", "Intervals in time", interval_line),
        ("sync", "Sync", sync),
        ("encoders", "Encoders", encoders),
        ("tradeoff", "Speed against accuracy", tradeoff),
        ("throughput", "Throughput", throughput),
        ("slanted", "Long names", slanted),
        ("strength", "Where it fails", strength),
        ("narrow", "Narrow", narrow),
        ("nothing", "No data", nothing),
        (
            "no-rows",
            "No rows",
            Timeline::new("Nothing recorded", Axis::time("time"))
                .kinds(["present"])
                .to_svg(720),
        ),
    ]
}
