//! `feet_faults`: contacts and poses of the feet under faults.
//!
//! The stages `tags` and `feet` run on short simulated walks, on level ground and on stairs, with
//! faults of camera, device, shoes, gait and inputs at rising strength ([`faults`]). Outcomes of a
//! point:
//!
//! - *silently wrong*: of the feet that no loss names, more poses, places or heights of contacts, or
//!   times of events are more than 3 of their stated sigmas wrong than by the share of the same walk
//!   without a fault (rounded to whole ones), or there are more contacts while a foot has none than
//!   on that walk. A loss that names no foot, but tags or the camera, names both;
//! - *flagged*: not silently wrong, and a loss is reported, or more contacts are missed or more than
//!   1 % more poses lost than without a fault, or an error is within its sigmas but large: more than
//!   10 cm of a contact, 25 cm of a pose, 0.2 s of an event;
//! - *ok*: neither.
//!
//! A pose counts if one of its six components is outside, a place if one of its two is; axes are
//! those of the foot. With right covariances that happens for 1.6 % of the poses, 0.5 % of the
//! places and 0.3 % of heights and events, and errors of neighbors are correlated, so that a few
//! false alarms occur. Walks with other seeds and no fault, beside the same reference, show how
//! many.
//!
//! Errors are in the frame of the rig, so that errors of the trajectory do not count by themselves.
//! Poses of the rig are true ones, unless the fault is one of them. The ground is that of stereo
//! depth on the same walk ([`ground`]), with none on the walks with another gait. Losses are those
//! of the stages; gaps that the recording reports do not count as one.
//!
//! Faults of light, shoes and gait are rendered; those of the device and of inputs are applied to
//! images of the walk without a fault, which are kept in memory.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, Result, bail};
use rig_sim::faults::Faults;
use rig_sim::simulation::{Simulation, StereoFrame};
use scene_bundle::outputs::terrain::TerrainMesh;
use serde::Serialize;
use serde_json::{Value, json};

use self::device::delivered;
use self::faults::{Injection, SWEEPS, Sweep};
use self::inputs::Inputs;
use self::outcome::{FootScores, Outcome, outcome};
use self::scores::Truth;
use self::walks::{LONG_S, OTHERS, SHORT_S, WALKS, Walk};
use crate::odometry::results;
use crate::stamp;

mod charts;
mod device;
mod faults;
mod ground;
mod inputs;
mod outcome;
mod scores;
mod stages;
mod walks;

/// Name of points without a fault.
const NO_FAULT: &str = "no fault";
/// Name, unit and strength of these points.
const NO_FAULT_POINT: (&str, &str, f64) = (NO_FAULT, "", 0.0);

/// One fault on one walk.
#[derive(Clone, Debug, Serialize)]
struct Point {
    walk: &'static str,
    fault: &'static str,
    unit: &'static str,
    strength: f64,
    seconds: f64,
    outcome: Outcome,
    /// Losses that the stages report.
    losses: Vec<String>,
    detections: usize,
    /// Of the left and the right foot.
    feet: [FootScores; 2],
}

struct Options {
    quick: bool,
    only: Option<String>,
    out: PathBuf,
}

impl Options {
    fn parse(args: &[String]) -> Result<Self> {
        let quick = args.iter().any(|argument| argument == "--quick");
        let mut options = Self {
            quick,
            only: None,
            out: PathBuf::from(match quick {
                true => "target/trial",
                false => "docs/benchmarks",
            }),
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            match argument.as_str() {
                "--quick" => {}
                "--only" => {
                    options.only = Some(rest.next().context("--only needs faults")?.clone());
                }
                "--out" => options.out = rest.next().context("--out needs a folder")?.into(),
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --only FAULT,... or --out DIR"
                ),
            }
        }
        Ok(options)
    }

    fn takes(&self, name: &str) -> bool {
        let listed = |only: &String| only.split(',').any(|own| own == name);
        self.only.as_ref().is_none_or(listed)
    }

    /// All strengths, or the least and the largest.
    fn strengths(&self, all: &[f64]) -> Vec<f64> {
        match (self.quick, all) {
            (true, [first, .., last]) => vec![*first, *last],
            _ => all.to_vec(),
        }
    }
}

/// Runs the benchmark: `[--quick] [--only FAULT,...] [--out DIR]`. A quick run has the least and
/// the largest strength on one walk.
///
/// # Errors
/// Bad arguments, or an I/O error. Outcomes are a result and no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args)?;
    let stamp = stamp::stamp("feet_faults", args)?;
    let mut points = Vec::new();
    let walks = if options.quick { &WALKS[..1] } else { &WALKS };
    for walk in walks {
        let (reference, clean) = Reference::new(walk)?;
        for point in clean {
            add(&mut points, point);
        }
        // What needs no rendering first.
        let mut sweeps: Vec<&Sweep> = SWEEPS.iter().collect();
        sweeps.retain(|own| options.takes(own.name) && own.applies_to(walk));
        sweeps.sort_by_key(|own| own.injection.is_rendered());
        for sweep in sweeps {
            for strength in options.strengths(sweep.strengths) {
                add(&mut points, reference.point(sweep, strength)?);
                write(&points, &stamp, &options.out)?;
            }
        }
        for other in OTHERS.iter().filter(|own| own.name == walk.name) {
            if options.takes(NO_FAULT) {
                add(&mut points, reference.other(other)?);
            }
        }
    }
    write(&points, &stamp, &options.out)
}

/// Writes the points so far.
fn write(points: &[Point], stamp: &Value, out: &Path) -> Result<()> {
    let count = |outcome| points.iter().filter(|p| p.outcome == outcome).count();
    let [ok, flagged, wrong] = Outcome::ALL.map(count);
    println!("{ok} ok, {flagged} flagged, {wrong} silently wrong");
    let report = json!({
        "benchmark": "feet_faults",
        "stamp": stamp,
        "ok": ok,
        "flagged": flagged,
        "silently_wrong": wrong,
        "points": points,
    });
    let mut files = vec![("feet_faults.json".to_owned(), format!("{report:#}\n"))];
    files.extend(charts::draw(points, &stamp::line(stamp)));
    results::write(out, files)
}

fn add(points: &mut Vec<Point>, point: Point) {
    let both = point.feet.map(|foot| {
        let outside = [foot.poses, foot.places, foot.heights, foot.events];
        let outside = outside.map(|own| format!("{}/{}", own.outside, own.count));
        format!(
            "poses, places, heights, events outside {}, lost {}, found {}, missed {}, invented {}, \
             place {:.3} m {:.1} sigmas, height {:.3} m, event {:.3} s",
            outside.join(" "),
            foot.lost,
            foot.found,
            foot.missed,
            foot.invented,
            foot.places.largest,
            foot.places.largest_sigmas,
            foot.heights.largest,
            foot.events.largest,
        )
    });
    println!(
        "{:9} {:20} {:7} {:13} {} detections\n    left  {}\n    right {}",
        point.walk,
        point.fault,
        point.strength,
        format!("{:?}", point.outcome),
        point.detections,
        both[0],
        both[1],
    );
    for loss in &point.losses {
        println!("    loss: {loss}");
    }
    points.push(point);
}

/// A walk without a fault.
struct Reference {
    walk: Walk,
    simulation: Arc<Simulation>,
    frames: Vec<Arc<StereoFrame>>,
    ground: TerrainMesh,
    /// Of its first part and of all.
    short: [FootScores; 2],
    long: [FootScores; 2],
}

impl Reference {
    /// With its points without a fault.
    fn new(walk: &Walk) -> Result<(Self, [Point; 2])> {
        let simulation = walk.simulation(&Faults::default(), None)?;
        let mut reference = Self {
            walk: *walk,
            frames: walk.render(&simulation, &Faults::default(), LONG_S)?,
            ground: ground::ground(walk)?,
            simulation,
            short: [FootScores::default(); 2],
            long: [FootScores::default(); 2],
        };
        let of = |length_s: f64| {
            let inputs = reference.inputs(length_s)?;
            let scored = evaluate(
                walk,
                &reference.simulation,
                &inputs,
                &reference.ground,
                length_s,
            )?;
            let clean = scored.0;
            Ok::<_, anyhow::Error>(point(walk, NO_FAULT_POINT, length_s, scored, &clean))
        };
        let points = [of(SHORT_S)?, of(LONG_S)?];
        [reference.short, reference.long] = [points[0].feet, points[1].feet];
        Ok((reference, points))
    }

    /// Inputs without a fault.
    fn inputs(&self, length_s: f64) -> Result<Inputs> {
        let count = self.walk.numbers(length_s).count();
        inputs(
            &self.walk,
            &self.simulation,
            self.frames[..count].to_vec(),
            length_s,
        )
    }

    /// Another walk without a fault.
    fn other(&self, walk: &Walk) -> Result<Point> {
        let simulation = walk.simulation(&Faults::default(), None)?;
        let frames = walk.render(&simulation, &Faults::default(), SHORT_S)?;
        let inputs = inputs(walk, &simulation, frames, SHORT_S)?;
        let scored = evaluate(walk, &simulation, &inputs, &ground::no_ground(), SHORT_S)?;
        Ok(point(walk, NO_FAULT_POINT, SHORT_S, scored, &self.short))
    }

    fn point(&self, sweep: &Sweep, strength: f64) -> Result<Point> {
        let (walk, length_s) = (&self.walk, sweep.length_s());
        let faults = sweep.faults(walk, strength);
        let no_ground = ground::no_ground();
        let (walk, simulation, inputs, ground) = match sweep.injection {
            Injection::Input(edit) => {
                let edited = self.inputs(length_s)?.edited(edit, strength)?;
                (*walk, self.simulation.clone(), edited, &self.ground)
            }
            Injection::Device(_) => {
                let mut inputs = self.inputs(length_s)?;
                inputs.frames = delivered(&self.simulation, &inputs.frames, &faults)?;
                (*walk, self.simulation.clone(), inputs, &self.ground)
            }
            Injection::Gait(other) => {
                let simulation = other.simulation(&faults, None)?;
                let frames = other.render(&simulation, &faults, length_s)?;
                let inputs = inputs(&other, &simulation, frames, length_s)?;
                (other, simulation, inputs, &no_ground)
            }
            Injection::Exposure | Injection::Light(_) | Injection::Wearer(..) | Injection::Slip => {
                let exposure_s = match sweep.injection {
                    Injection::Exposure => Some(1e-3 * strength),
                    _ => None,
                };
                let simulation = walk.simulation(&faults, exposure_s)?;
                let frames = walk.render(&simulation, &faults, length_s)?;
                let inputs = inputs(walk, &simulation, frames, length_s)?;
                (*walk, simulation, inputs, &self.ground)
            }
        };
        let scored = evaluate(&walk, &simulation, &inputs, ground, length_s)?;
        let clean = match length_s == SHORT_S {
            true => &self.short,
            false => &self.long,
        };
        let fault = (sweep.name, sweep.unit, strength);
        Ok(point(&walk, fault, length_s, scored, clean))
    }
}

fn point(
    walk: &Walk,
    (fault, unit, strength): (&'static str, &'static str, f64),
    seconds: f64,
    (feet, found): ([FootScores; 2], stages::Found),
    clean: &[FootScores; 2],
) -> Point {
    Point {
        walk: walk.name,
        fault,
        unit,
        strength,
        seconds,
        outcome: outcome(&feet, clean, &found.losses),
        losses: found.losses,
        detections: found.detections,
        feet,
    }
}

/// Inputs with the nominal rig and true poses.
fn inputs(
    walk: &Walk,
    simulation: &Simulation,
    frames: Vec<Arc<StereoFrame>>,
    length_s: f64,
) -> Result<Inputs> {
    Ok(Inputs {
        rig: walks::rig_model(simulation)?,
        trajectory: walk.trajectory(simulation, length_s)?,
        frames,
        time_offset_ns: 0,
        right_black_from_ns: None,
    })
}

/// Runs the stages and compares with the truth.
fn evaluate(
    walk: &Walk,
    simulation: &Simulation,
    inputs: &Inputs,
    ground: &TerrainMesh,
    length_s: f64,
) -> Result<([FootScores; 2], stages::Found)> {
    let found = stages::run(inputs, ground)?;
    let truth = Truth {
        simulation,
        span_s: [walk.begin_s, walk.begin_s + length_s],
    };
    Ok((truth.scores(&found, &inputs.trajectory)?, found))
}

#[cfg(test)]
mod tests;
