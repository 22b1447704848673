//! Ground truth of recordings of a simulated rig (FORMAT.md, `rig/truth.*`).
//!
//! A frame is matched with the ground truth by its device clock. Nothing here changes a verdict: a
//! session is validated as one without ground truth.

use std::collections::{BTreeMap, BTreeSet};

use charts::{Axis, Cell, Chart, Series, Table};
use session_archive::manifest::Manifest;
use session_archive::reader::SessionReader;
use session_archive::verify::rig_file;

use crate::session_stats::{FrameStats, SessionStats};

/// Margins of a chart, pixels: for the scale of the map.
const MARGINS: (f64, f64) = (90.0, 100.0);
/// Maximum height of the map, pixels.
const MAP_HEIGHT: f64 = 700.0;

/// Ground truth of a session.
pub(crate) struct GroundTruth {
    /// Frames of each camera, by time; empty without ground truth.
    cameras: Vec<Vec<TrueFrame>>,
    /// Footprints: whether it is the left foot, x, y, m.
    footprints: Vec<(bool, f64, f64)>,
    /// Files that could not be read.
    pub(crate) notes: Vec<String>,
}

/// Ground truth of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct TrueFrame {
    /// Device clock, ticks; `None` if the device was disconnected.
    ticks: Option<i64>,
    time: i64,
    /// Position of the rig in the world, m.
    x: f64,
    y: f64,
}

impl GroundTruth {
    /// Reads the ground truth of a session; `None` if it has none.
    pub(crate) fn read(reader: &SessionReader) -> Option<Self> {
        let manifest = reader.manifest();
        let mut truth = Self {
            cameras: Vec::new(),
            footprints: Vec::new(),
            notes: Vec::new(),
        };
        let mut any = false;
        let mut rows = |name: &str, notes: &mut Vec<String>| -> Vec<Vec<String>> {
            let Some(file) = manifest.rig.iter().find(|f| f.name == name) else {
                return Vec::new();
            };
            any = true;
            let Some(content) = rig_file(&**reader.storage(), file) else {
                notes.push(format!("rig/{name} is not there or not what it was"));
                return Vec::new();
            };
            let text = String::from_utf8_lossy(&content);
            let lines = text.lines().filter(|line| !line.starts_with('#'));
            lines
                .map(|line| line.split(',').map(str::to_owned).collect())
                .collect()
        };
        for camera in &manifest.cameras {
            let name = format!("truth.{}.csv", camera.name);
            let rows = rows(&name, &mut truth.notes);
            let frames = rows.iter().map(|row| frame(row));
            let read: Option<Vec<TrueFrame>> = frames.collect();
            if read.is_none() {
                let note = format!("rig/{name}: expected rows of ticks, time and a pose");
                truth.notes.push(note);
            }
            truth.cameras.push(read.unwrap_or_default());
        }
        for row in rows("truth.contacts.csv", &mut truth.notes) {
            truth.footprints.extend(footprint(&row));
        }
        any.then_some(truth)
    }

    /// The frames of a camera with ground truth, each with its time error, ns.
    fn errors<'a>(
        &'a self,
        camera: usize,
        stats: &'a SessionStats,
    ) -> impl Iterator<Item = (&'a FrameStats, i64)> {
        let known = self.cameras[camera].iter();
        let known: BTreeMap<i64, &TrueFrame> = known.filter_map(|f| Some((f.ticks?, f))).collect();
        stats.cameras[camera].iter().filter_map(move |frame| {
            let taken = known.get(&frame.ticks)?;
            Some((frame, frame.sample.time.saturating_sub(taken.time)))
        })
    }

    /// Comparison with the recording, a row per camera.
    pub(crate) fn table(&self, manifest: &Manifest, stats: &SessionStats) -> Table {
        let mut table = Table::new([
            "Camera",
            "Taken while recording",
            "Recorded",
            "Error of their times, median",
            "Of 99 %",
            "Largest",
            "Within 3 sigma",
        ]);
        for (i, camera) in manifest.cameras.iter().enumerate() {
            let mut errors: Vec<f64> = Vec::new();
            let mut within = 0;
            for (frame, error) in self.errors(i, stats) {
                errors.push(error.unsigned_abs() as f64 * 1e-9);
                within += u64::from(error.unsigned_abs() <= frame.sigma_ns.saturating_mul(3));
            }
            errors.sort_by(f64::total_cmp);
            let span = stats.cameras[i].first().zip(stats.cameras[i].last());
            let taken = span.map_or(0, |(first, last)| {
                let near = first.sample.time.saturating_sub(1_000_000)
                    ..=last.sample.time.saturating_add(1_000_000);
                let taken = self.cameras[i].iter();
                taken.filter(|frame| near.contains(&frame.time)).count()
            });
            let at = |share: f64| match errors.len() {
                0 => Cell::from(""),
                n => Cell::number(charts::si(errors[((n - 1) as f64 * share) as usize], "s")),
            };
            let share = 100.0 * within as f64 / errors.len().max(1) as f64;
            table = table.row([
                Cell::from(camera.name.clone()),
                Cell::number(taken),
                Cell::number(errors.len()),
                at(0.5),
                at(0.99),
                at(1.0),
                Cell::number(format!("{share:.1} %")),
            ]);
        }
        table
    }

    /// Time errors of the frames.
    pub(crate) fn time_errors(&self, manifest: &Manifest, stats: &SessionStats) -> Chart {
        let start = stats.span().map_or(0, |(start, _)| start);
        let mut chart = Chart::new("Frame times against ground truth")
            .x_axis(Axis::time("time"))
            .y_axis(Axis::linear("recorded minus ground truth", "µs").include(0.0));
        for (i, camera) in manifest.cameras.iter().enumerate() {
            let points = self.errors(i, stats).map(|(frame, error)| {
                let time = frame.sample.time.saturating_sub(start) as f64 * 1e-9;
                (time, error as f64 * 1e-3)
            });
            chart = chart.series(Series::line(&camera.name, points).slot(i));
        }
        chart
    }

    /// Ground-truth trajectory from above, `width` pixels wide, with the footprints and the
    /// positions of missing frames.
    pub(crate) fn map(&self, stats: &SessionStats, width: u32) -> String {
        let (start, end) = stats.span().unwrap_or((0, 0));
        let during = |frame: &&TrueFrame| (start..=end).contains(&frame.time);
        let path: Vec<(f64, f64)> = match self.cameras.iter().find(|c| !c.is_empty()) {
            Some(frames) => frames.iter().filter(during).map(|f| (f.x, f.y)).collect(),
            None => Vec::new(),
        };
        let mut missing = Vec::new();
        for (known, frames) in self.cameras.iter().zip(&stats.cameras) {
            let recorded: BTreeSet<i64> = frames.iter().map(|f| f.ticks).collect();
            let is_lost = |f: &&TrueFrame| f.ticks.is_none_or(|ticks| !recorded.contains(&ticks));
            // Frames before the first or after the last recorded one are not missing.
            let (Some(first), Some(last)) = (frames.first(), frames.last()) else {
                continue;
            };
            let between = |f: &&TrueFrame| (first.sample.time..last.sample.time).contains(&f.time);
            let lost = known.iter().filter(is_lost).filter(between);
            missing.extend(lost.map(|frame| (frame.x, frame.y)));
        }
        let (x, y) = (Extent::of(&path, |p| p.0), Extent::of(&path, |p| p.1));
        let feet = |left: bool| {
            let near = |v: f64, e: &Extent| (e.min - 1.0..=e.max + 1.0).contains(&v);
            let prints = self.footprints.iter();
            let prints = prints.filter(move |p| p.0 == left && near(p.1, &x) && near(p.2, &y));
            prints.map(|p| (p.1, p.2)).collect::<Vec<_>>()
        };
        // Equal scale in both directions.
        let per_m = ((f64::from(width) - MARGINS.0) / x.length())
            .min((MAP_HEIGHT - MARGINS.1) / y.length());
        let height = (per_m * y.length() + MARGINS.1).ceil() as u32;
        let wide = (f64::from(width) - MARGINS.0) / per_m;
        let mut chart = Chart::new("Ground-truth trajectory, from above")
            .x_axis(axis("x", &x.widened(wide)))
            .y_axis(axis("y", &y.widened(y.length())))
            .series(Series::line("rig", path))
            .series(Series::scatter("left foot", feet(true)))
            .series(Series::scatter("right foot", feet(false)));
        if !missing.is_empty() {
            chart = chart.series(Series::scatter("a frame is missing", missing));
        }
        chart.to_svg(width, height)
    }
}

/// Range from the minimum to the maximum.
#[derive(Clone, Copy)]
struct Extent {
    min: f64,
    max: f64,
}

impl Extent {
    fn of(points: &[(f64, f64)], value: impl Fn(&(f64, f64)) -> f64) -> Self {
        let values = points.iter().map(value);
        let extent = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
            (a.min(v), b.max(v))
        });
        match extent.0 <= extent.1 {
            true => Self {
                min: extent.0,
                max: extent.1,
            },
            false => Self { min: 0.0, max: 0.0 },
        }
    }

    /// Length with margin.
    fn length(&self) -> f64 {
        (self.max - self.min) + 1.0
    }

    fn widened(&self, length: f64) -> Self {
        let middle = 0.5 * (self.min + self.max);
        Self {
            min: middle - 0.5 * length,
            max: middle + 0.5 * length,
        }
    }
}

fn axis(name: &str, extent: &Extent) -> Axis {
    let axis = Axis::linear(name, "m").include(extent.min);
    axis.include(extent.max)
}

fn frame(row: &[String]) -> Option<TrueFrame> {
    let number = |k: usize| row.get(k)?.parse::<f64>().ok().filter(|v| v.is_finite());
    let ticks = row.first()?;
    Some(TrueFrame {
        ticks: match ticks.is_empty() {
            true => None,
            false => Some(ticks.parse().ok()?),
        },
        time: row.get(1)?.parse().ok()?,
        x: number(2)?,
        y: number(3)?,
    })
}

/// Whether it is the left foot, x, y, m.
fn footprint(row: &[String]) -> Option<(bool, f64, f64)> {
    let number = |k: usize| row.get(k)?.parse::<f64>().ok().filter(|v| v.is_finite());
    Some((row.first()? == "left", number(5)?, number(6)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(text: &str) -> Vec<String> {
        text.split(',').map(str::to_owned).collect()
    }

    #[test]
    fn rows_are_parsed_or_rejected() {
        let read = frame(&row("38519494173,1000033333333,0.92,1.84,1.29,1,0,0,0"));
        let mut taken = TrueFrame {
            ticks: Some(38_519_494_173),
            time: 1_000_033_333_333,
            x: 0.92,
            y: 1.84,
        };
        assert_eq!(read, Some(taken));
        taken.ticks = None;
        assert_eq!(
            frame(&row(",1000033333333,0.92,1.84,1.29,1,0,0,0")),
            Some(taken)
        );
        assert_eq!(frame(&row("38519494173,1000033333333,0.92")), None);
        assert_eq!(frame(&row("x,1,2,3")), None);
        assert_eq!(frame(&row("1,2,NaN,3")), None);
        let print = footprint(&row("left,1,2,,,0.5,-0.25,0,1,0,0,0"));
        assert_eq!(print, Some((true, 0.5, -0.25)));
    }
}
