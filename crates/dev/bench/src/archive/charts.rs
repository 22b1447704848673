//! Charts of the results.

use charts::{Axis, Chart, Series};

use super::loss::Loss;
use super::stop::Stopping;
use super::throughput::{Rate, Rates};
use super::{STOP_LIMIT_S, TARGET};

const WIDTH: u32 = 720;

/// Name and SVG of every chart.
pub(super) fn draw(
    rates: &Rates,
    losses: &[Loss],
    stops: &[Stopping],
    stamp: &str,
) -> Vec<(String, String)> {
    let charts = [
        (
            "write",
            throughput("Writing a session", &rates.write, true, stamp),
        ),
        (
            "read",
            throughput("Reading a session back", &rates.read, false, stamp),
        ),
        ("cpu", cpu(rates, stamp)),
        ("loss", loss(losses, stamp)),
        ("overhead", overhead(losses, stamp)),
        ("stop", stop(stops, stamp)),
    ];
    charts
        .into_iter()
        .map(|(name, chart)| (format!("archive-{name}.svg"), chart.to_svg(WIDTH, 340)))
        .collect()
}

fn throughput(title: &str, rates: &[Rate], write: bool, stamp: &str) -> Chart {
    let gb = rates.iter().map(|r| r.bytes_per_s() / 1e9);
    let chart = Chart::new(title)
        .subtitle(if write {
            "three cameras, 60 to 100 kB per access unit, chunks of half a second; \
             the mcap crate writes into the page cache"
        } else {
            "the same session, from the page cache, all checksums checked"
        })
        .x_axis(Axis::categories("", rates.iter().map(|r| r.name)))
        .y_axis(Axis::linear("access units", "GB/s").include(0.0))
        .series(Series::bars("", gb))
        .footnote(stamp);
    if write {
        chart.hline(TARGET / 1e9, "target, page cache")
    } else {
        chart
    }
}

fn cpu(rates: &Rates, stamp: &str) -> Chart {
    let all = || {
        rates
            .write
            .iter()
            .zip(["write: "; 9])
            .chain(rates.read.iter().zip(["read: "; 9]))
    };
    Chart::new("Processor time of writing and reading")
        .subtitle("the kernel's part included")
        .x_axis(Axis::categories(
            "",
            all().map(|(r, kind)| format!("{kind}{}", r.name)),
        ))
        .y_axis(Axis::linear("CPU seconds per GB", "s").include(0.0))
        .series(Series::bars("", all().map(|(r, _)| r.cpu_s_per_gb())))
        .footnote(stamp)
}

fn loss(losses: &[Loss], stamp: &str) -> Chart {
    let line = |name: &str, of: fn(&Loss) -> f64| {
        Series::line(name, losses.iter().map(|l| (l.chunk_s, of(l))))
    };
    Chart::new("Loss by a power cut")
        .subtitle(
            "from the last sample on disk to the last one that had arrived at the writer, \
             per stream and cut",
        )
        .x_axis(Axis::linear("chunk length", "s").include(0.0))
        .y_axis(Axis::linear("lost", "s").include(0.0))
        .hline(1.0, "bound")
        .series(line("cameras, most", |l| l.max_s))
        .series(line("cameras, half of the cuts", |l| l.median_s))
        .series(line("IMUs, most", |l| l.imu_max_s))
        .footnote(stamp)
}

fn overhead(losses: &[Loss], stamp: &str) -> Chart {
    Chart::new("Overhead of chunks")
        .subtitle(
            "bytes on disk beyond the access units of 60 to 100 kB; most of it is IMU samples",
        )
        .x_axis(Axis::linear("chunk length", "s").include(0.0))
        .y_axis(Axis::linear("more bytes", "%").include(0.0))
        .series(Series::line(
            "",
            losses.iter().map(|l| (l.chunk_s, 100.0 * l.overhead)),
        ))
        .footnote(stamp)
}

fn stop(stops: &[Stopping], stamp: &str) -> Chart {
    let points = stops
        .iter()
        .flat_map(|s| s.stops_s.iter().map(|t| (s.session_s / 60.0, 1e3 * t)));
    Chart::new("Time to close a session's files")
        .subtitle("the last chunk, the summary and the manifest, synced; time is virtual, the disk is real")
        .x_axis(Axis::log("length of the session", "min"))
        .y_axis(Axis::linear("close", "ms").include(0.0))
        .hline(1e3 * STOP_LIMIT_S, "limit for stopping")
        .series(Series::scatter("", points))
        .footnote(stamp)
}
