//! `sim`: speed of the simulated cameras, and quality of their images.
//!
//! 1. Frame sets per second of all three stereo cameras, 672x376 per eye, on two threads, in each
//!    scene by day, for several qualities: from one sample per pixel to the many of the test
//!    quality. As in a source in real time: each camera's frames in order, developed, side by side,
//!    with noise.
//! 2. Their error: the difference of the same images without noise from ones averaged over many
//!    more samples. Motion blur is part of it, and the position of edges within a pixel.
//! 3. Where the time of a stereo frame goes, at the quality for real time: poses, visibility,
//!    shading, developing.
//!
//! Frame sets per second are wall time and need an idle machine; processor time depends less on the
//! load.

use std::fs;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use anyhow::{Context, Result};
use cad_transforms::rig::Rig;
use rig_sim::camera::Quality;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation};
use serde_json::{Value, json};

mod charts;
mod stages;

use crate::arguments::Arguments;
use crate::meter::{Timing, timed};
use crate::stamp;
use stages::Stages;

/// Frame sets per second that the real-time quality must reach, and the test quality.
const TARGET_FAST: f64 = 15.0;
const TARGET_ACCURATE: f64 = 2.0;
/// Threads, as the machine has cores that records in real time.
const THREADS: usize = 2;
const RIG: &str = include_str!("../../../../cad-transforms/rigs/example.toml");

/// The qualities, by name.
const QUALITIES: [(&str, Quality); 4] = [
    ("fast", Quality::FAST),
    ("1 to 4 looks", looks(1, 4)),
    ("2 to 6 looks", looks(2, 6)),
    ("accurate", Quality::ACCURATE),
];

const fn looks(samples: u32, max_samples: u32) -> Quality {
    Quality {
        samples,
        max_samples,
        noise: true,
    }
}

/// Amount of work.
struct Plan {
    kinds: &'static [Kind],
    width: u32,
    height: u32,
    /// Frame sets per quality and scene at the quality for real time; as long as that, but at least
    /// one, at others.
    sets: u64,
    /// Compared images, per scene and camera, and samples per pixel of the reference.
    instants: u32,
    looks: u32,
}

const FULL: Plan = Plan {
    kinds: &Kind::ALL,
    width: 672,
    height: 376,
    sets: 150,
    instants: 4,
    looks: 48,
};

const QUICK: Plan = Plan {
    sets: 20,
    instants: 1,
    looks: 24,
    ..FULL
};

/// One quality in one scene.
struct Point {
    quality: &'static str,
    looks: [u32; 2],
    sets_per_s: f64,
    /// Per stereo frame.
    cpu_ms: f64,
    /// RMS error of luma, gray levels.
    rms: f64,
}

/// A scene.
struct Place {
    kind: Kind,
    triangles: usize,
    points: Vec<Point>,
    stages: Stages,
}

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error. A target that is missed is a result and no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let Arguments { quick, out } = Arguments::parse(args)?;
    let plan = if quick { QUICK } else { FULL };
    let stamp = stamp::stamp("sim", args)?;
    let places = measure(&plan)?;
    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    let report = json!({
        "benchmark": "sim",
        "stamp": stamp,
        "width": plan.width,
        "height": plan.height,
        "cameras": 3,
        "threads": THREADS,
        "target_fast_sets_per_s": TARGET_FAST,
        "target_accurate_sets_per_s": TARGET_ACCURATE,
        "reference_looks": plan.looks,
        "scenes": places.iter().map(Place::json).collect::<Vec<_>>(),
    });
    let mut files = vec![("sim.json".to_owned(), format!("{report:#}\n"))];
    files.extend(charts::draw(&places, &stamp::line(&stamp)));
    for (name, text) in files {
        let path = out.join(name);
        fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
        println!("wrote {}", path.display());
    }
    Ok(())
}

fn measure(plan: &Plan) -> Result<Vec<Place>> {
    let rig = Rig::parse(RIG).context("reading the example rig")?;
    let mut places = Vec::new();
    for &kind in plan.kinds {
        let place = place(plan, kind, &rig)?;
        println!("{place}");
        places.push(place);
    }
    Ok(places)
}

fn place(plan: &Plan, kind: Kind, rig: &Rig) -> Result<Place> {
    let rate_hz = 15.0;
    let settings = Settings {
        kind,
        lighting: Lighting::Day,
        seed: 1,
        // The walker rests first: the first step follows within a second.
        seconds: (plan.sets as f64 / rate_hz).max(8.0),
        rate_hz,
        width: plan.width,
        height: plan.height,
        quality: Quality::FAST,
    };
    let mut simulation = Simulation::new(&settings, rig).context("preparing the walk")?;
    let triangles = simulation.scene().fixed.triangles.len();
    let stages = stages::measure(&simulation, plan.sets.min(30));
    let silent = |samples, max_samples| Quality {
        samples,
        max_samples,
        noise: false,
    };
    let (reference, expected) = images(simulation, silent(plan.looks, plan.looks), plan);
    simulation = reference;
    let mut points: Vec<Point> = Vec::new();
    for (name, quality) in QUALITIES {
        let (samples, most) = (quality.samples, quality.max_samples);
        let (silent, found) = images(simulation, silent(samples, most), plan);
        let loud = Arc::new(silent.with_quality(quality));
        let sets = (plan.sets / u64::from(most)).max(2);
        let took = stream(&loud, sets);
        simulation = Arc::unwrap_or_clone(loud);
        points.push(Point {
            quality: name,
            looks: [samples, most],
            sets_per_s: sets as f64 / took.wall_s,
            cpu_ms: 1e3 * took.cpu_s / (sets as f64 * simulation.cameras().len() as f64),
            rms: rms(&expected, &found),
        });
    }
    Ok(Place {
        kind,
        triangles,
        points,
        stages,
    })
}

/// Luma of both images of all cameras at a few instants of the walk.
fn images(simulation: Simulation, quality: Quality, plan: &Plan) -> (Simulation, Vec<Vec<u8>>) {
    let simulation = Arc::new(simulation.with_quality(quality));
    let mut found = Vec::new();
    for camera in 0..simulation.cameras().len() {
        let mut images = simulation.frames(camera);
        for k in 0..plan.instants {
            let part = (f64::from(k) + 0.7) / f64::from(plan.instants);
            let time_ns = (part * 1e9 * simulation.settings().seconds) as i64;
            // At the same exposure, whatever the quality.
            images.settle(time_ns);
            let frame = images.expose(u64::from(k), time_ns);
            found.push(frame.i420[..frame.width * frame.height].to_vec());
        }
    }
    (Arc::unwrap_or_clone(simulation), found)
}

/// Renders `sets` frame sets on [`THREADS`] threads. Each camera's frames come in order, and only
/// one thread works on it at a time.
fn stream(simulation: &Arc<Simulation>, sets: u64) -> Timing {
    let count = simulation.cameras().len();
    let cameras: Vec<_> = (0..count)
        .map(|camera| Mutex::new(simulation.frames(camera)))
        .collect();
    let next = AtomicUsize::new(0);
    let work = || {
        loop {
            let job = next.fetch_add(1, Ordering::Relaxed);
            if job >= sets as usize * count {
                return;
            }
            let images = &cameras[job % count];
            let frame = images.lock().unwrap_or_else(PoisonError::into_inner).next();
            std::hint::black_box(frame);
        }
    };
    let ((), took) = timed(|| {
        thread::scope(|scope| {
            for _ in 0..THREADS {
                scope.spawn(work);
            }
        });
    });
    took
}

/// Root of the mean square of the differences.
fn rms(expected: &[Vec<u8>], found: &[Vec<u8>]) -> f64 {
    let pairs = expected.iter().flatten().zip(found.iter().flatten());
    let square = |(a, b): (&u8, &u8)| (f64::from(*a) - f64::from(*b)).powi(2);
    let count = expected.iter().map(Vec::len).sum::<usize>();
    (pairs.map(square).sum::<f64>() / count as f64).sqrt()
}

impl Point {
    fn psnr_db(&self) -> f64 {
        20.0 * (255.0 / self.rms).log10()
    }

    fn json(&self) -> Value {
        json!({
            "quality": self.quality,
            "least_looks": self.looks[0],
            "most_looks": self.looks[1],
            "sets_per_s": self.sets_per_s,
            "cpu_ms_per_stereo_frame": self.cpu_ms,
            "rms_grey_levels": self.rms,
            "psnr_db": self.psnr_db(),
        })
    }
}

impl Place {
    fn json(&self) -> Value {
        json!({
            "scene": self.kind.name(),
            "triangles": self.triangles,
            "qualities": self.points.iter().map(Point::json).collect::<Vec<_>>(),
            "stages_cpu_ms_per_stereo_frame": self.stages.json(),
        })
    }
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:9} {}", self.kind.name(), self.stages)?;
        for point in &self.points {
            write!(
                f,
                "\n{:9} {:13} {:6.1} sets/s {:7.1} ms {:6.2} grey levels",
                "", point.quality, point.sets_per_s, point.cpu_ms, point.rms
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A small measurement end to end: more samples come nearer to the reference.
    #[test]
    fn more_samples_are_nearer_to_the_reference() {
        let plan = Plan {
            kinds: &[Kind::Corridor],
            width: 64,
            height: 36,
            sets: 4,
            instants: 1,
            looks: 24,
        };
        let places = measure(&plan).unwrap();
        let [place] = &places[..] else {
            panic!("one scene was requested");
        };
        let points = &place.points;
        assert_eq!(points.len(), QUALITIES.len());
        assert!(points[3].rms < 0.7 * points[0].rms, "{place}");
        assert!(
            points.iter().all(|p| p.rms > 0.0 && p.rms < 30.0),
            "{place}"
        );
        assert!(points.iter().all(|p| p.sets_per_s > 0.0 && p.cpu_ms > 0.0));
        let parts = place.stages.parts();
        assert!(parts.iter().all(|(_, ms)| *ms > 0.0), "{place}");
        let charts = charts::draw(&places, "");
        assert_eq!(charts.len(), 2);
        assert!(charts.iter().all(|(_, svg)| svg.contains("corridor")));
    }
}
