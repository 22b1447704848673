//! `feet_faults`: contacts and poses of the feet under faults.
//!
//! The stages `tags` and `feet` run on short simulated walks, on level ground and on stairs, with
//! faults of camera, device, shoes, gait and inputs at rising strength ([`faults`]). Outcomes of a
//! point:
//!
//! - *silently wrong*: of the feet that no loss names, a place or height of a contact or a time of
//!   an event is more than 3 of its stated sigmas wrong and is not so on the same walk without the
//!   fault, or more than 1.6 % of the poses are, or there are more contacts while a foot has none
//!   than on that walk. A loss that names no foot, but tags or the camera, names both; one that is
//!   reported without the fault, with whatever numbers, names none;
//! - *flagged*: not silently wrong, and a loss is reported, or more contacts are missed or more
//!   than 1 % more poses lost than without a fault, or an error is within its sigmas but large:
//!   10 cm of a contact, 25 cm of a pose, 0.2 s of an event, and a tenth larger than without;
//! - *ok*: neither.
//!
//! A pose counts if one of its six components is outside, which with right covariances happens for
//! 1.6 % of them; a place if one of its two is. Axes are those of the foot. Where the fault changes
//! the steps, numbers are compared instead, beyond the share without a fault. Noise that differs
//! takes single errors across their limit, so that a few false alarms occur; walks with other seeds
//! and no fault, compared like that, show how many. What is outside without any fault is in the
//! points without one.
//!
//! Errors are in the frame of the rig, so that errors of the trajectory do not count by themselves.
//! Poses of the rig are true ones, unless the fault is one of them. The ground is that of stereo
//! depth on the same walk ([`ground`]). Losses are those of the stages; gaps that the recording
//! reports do not count.
//!
//! Faults of light, shoes and gait are rendered; those of the device and of inputs are applied to
//! images of the walk without a fault, which are kept in memory.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, Result, bail};
use rig_sim::faults::Faults;
use rig_sim::simulation::{Simulation, StereoFrame};
use scene_bundle::outputs::terrain::TerrainMesh;
use serde_json::{Value, json};

use self::device::delivered;
use self::faults::{Injection, SWEEPS, Sweep};
use self::inputs::Inputs;
use self::outcome::{Clean, FootScores, Outcome};
use self::point::{NO_FAULT, NO_FAULT_POINT, Point, point};
use self::scores::Truth;
use self::walks::{OTHERS, SHORT_S, WALKS, Walk};
use crate::odometry::results;
use crate::stamp;

mod charts;
mod device;
mod faults;
mod ground;
mod inputs;
mod outcome;
mod point;
mod scores;
mod stages;
mod walks;

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
    let mut references = Vec::new();
    for walk in walks {
        let (reference, clean) = Reference::new(walk)?;
        clean.into_iter().for_each(|point| add(&mut points, point));
        references.push(reference);
    }
    // What needs no rendering first, then the largest strengths.
    let mut jobs: Vec<(usize, usize, &Reference, &Sweep)> = Vec::new();
    for reference in &references {
        for sweep in SWEEPS.iter().filter(|own| options.takes(own.name)) {
            if sweep.applies_to(&reference.walk) {
                let count = options.strengths(sweep.strengths).len();
                jobs.extend((0..count).map(|place| (count - 1 - place, place, reference, sweep)));
            }
        }
    }
    jobs.sort_by_key(|(from_last, _, _, sweep)| {
        let is_rendered = sweep.injection.is_rendered();
        (is_rendered, if is_rendered { *from_last } else { 0 })
    });
    for (_, place, reference, sweep) in jobs {
        let strength = options.strengths(sweep.strengths)[place];
        add(&mut points, reference.point(sweep, strength)?);
        write(&points, &stamp, &options.out)?;
    }
    for other in OTHERS.iter().filter(|_| options.takes(NO_FAULT)) {
        let mut own = references.iter();
        if let Some(reference) = own.find(|own| own.walk.name == other.name) {
            add(&mut points, reference.other(other)?);
        }
    }
    write(&points, &stamp, &options.out)
}

/// Writes the points so far.
fn write(points: &[Point], stamp: &Value, out: &Path) -> Result<()> {
    let mut points = points.to_vec();
    points.sort_by(|a, b| a.place().partial_cmp(&b.place()).unwrap_or(Ordering::Equal));
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
    files.extend(charts::draw(&points, &stamp::line(stamp)));
    results::write(out, files)
}

fn add(points: &mut Vec<Point>, point: Point) {
    let both = point.feet.each_ref().map(|foot| {
        let events = foot.all_events();
        let outside = [&foot.poses, &foot.places, &foot.heights, &events];
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
            events.largest,
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
    /// What is stated of its first part and of all.
    short: Clean,
    long: Clean,
}

impl Reference {
    /// With its points without a fault.
    fn new(walk: &Walk) -> Result<(Self, [Point; 2])> {
        let simulation = walk.simulation(&Faults::default(), None)?;
        let mut reference = Self {
            walk: *walk,
            frames: walk.render(&simulation, &Faults::default(), walk.long_s)?,
            ground: ground::ground(walk)?,
            simulation,
            short: Clean::default(),
            long: Clean::default(),
        };
        let of = |length_s: f64| {
            let inputs = reference.inputs(length_s)?;
            let simulation = &reference.simulation;
            let (scores, found) = evaluate(walk, simulation, &inputs, &reference.ground, length_s)?;
            // Any loss is a false one.
            let clean = Clean {
                feet: scores.clone(),
                losses: Vec::new(),
            };
            let clean = (&clean, true);
            Ok::<_, anyhow::Error>(point(walk, NO_FAULT_POINT, length_s, &scores, found, clean))
        };
        let points = [of(SHORT_S)?, of(walk.long_s)?];
        [reference.short, reference.long] = points.each_ref().map(|own| Clean {
            feet: own.feet.clone(),
            losses: own.losses.clone(),
        });
        Ok((reference, points))
    }

    /// Inputs without a fault.
    fn inputs(&self, length_s: f64) -> Result<Inputs> {
        let count = self.walk.numbers(length_s).count();
        let frames = self.frames[..count].to_vec();
        inputs(&self.walk, &self.simulation, frames, length_s)
    }

    /// Another walk without a fault.
    fn other(&self, walk: &Walk) -> Result<Point> {
        let (simulation, inputs) = rendered(walk, &Faults::default(), None, SHORT_S)?;
        let ground = ground::ground(walk)?;
        let (scores, found) = evaluate(walk, &simulation, &inputs, &ground, SHORT_S)?;
        let clean = Clean {
            feet: self.short.feet.clone(),
            losses: Vec::new(),
        };
        let clean = (&clean, false);
        Ok(point(walk, NO_FAULT_POINT, SHORT_S, &scores, found, clean))
    }

    fn point(&self, sweep: &Sweep, strength: f64) -> Result<Point> {
        let walk = match sweep.injection {
            Injection::Gait(other) => other,
            _ => self.walk,
        };
        let length_s = sweep.length_s(&walk);
        let faults = sweep.faults(&walk, strength);
        let kept = || self.simulation.clone();
        let (simulation, inputs) = match sweep.injection {
            Injection::Input(edit) => (kept(), self.inputs(length_s)?.edited(edit, strength)?),
            Injection::Device(_) => {
                let mut inputs = self.inputs(length_s)?;
                inputs.frames = delivered(&self.simulation, &inputs.frames, &faults)?;
                (kept(), inputs)
            }
            Injection::Exposure => rendered(&walk, &faults, Some(1e-3 * strength), length_s)?,
            _ => rendered(&walk, &faults, None, length_s)?,
        };
        let (scores, found) = evaluate(&walk, &simulation, &inputs, &self.ground, length_s)?;
        let scores_of = match length_s == SHORT_S {
            true => &self.short,
            false => &self.long,
        };
        let clean = (scores_of, sweep.injection.is_same_walk());
        let fault = (sweep.name, sweep.unit, strength);
        Ok(point(&walk, fault, length_s, &scores, found, clean))
    }
}

/// A walk that is rendered with faults.
fn rendered(
    walk: &Walk,
    faults: &Faults,
    exposure_s: Option<f64>,
    length_s: f64,
) -> Result<(Arc<Simulation>, Inputs)> {
    let simulation = walk.simulation(faults, exposure_s)?;
    let frames = walk.render(&simulation, faults, length_s)?;
    let inputs = inputs(walk, &simulation, frames, length_s)?;
    Ok((simulation, inputs))
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
) -> Result<([FootScores; 2], stages::StageOutputs)> {
    let found = stages::run(inputs, ground)?;
    let truth = Truth {
        simulation,
        span_s: [walk.begin_s, walk.begin_s + length_s],
    };
    Ok((truth.scores(&found, &inputs.trajectory)?, found))
}

#[cfg(test)]
mod tests;
