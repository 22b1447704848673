//! The report of a collision shape: where it holds a foot that the truth does not hold, how deep
//! true soles are in it, its slopes and step edges against the true ones, and what a step of the
//! engines costs with it, over the number of its parts; and whether the engines have the heights of
//! its faces.
//!
//! A foot is a disc of 4 cm. It is held at the greatest height of a surface under nine of its
//! points. Places are cells of 2 cm with true ground within 0.6 m of a footprint: where feet go.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use nalgebra::Vector2;
use scene_bundle::outputs::collision::{Collision, PartKind};
use serde_json::{Value, json};
use simulation::{BodiesConfig, RigidBodies};

use super::bodies;
use super::model;
use super::normals::{angle_deg, angles};
use super::probe::Probe;
use super::step_edges::step_edges;
use super::values::{CONTACT_GOAL_MM, FALSE_SUPPORT_GOAL, FEET_REACH_M, LEVEL_M, entries, modules};
use crate::python;
use crate::terrain::parts;
use crate::terrain::scores::Quantiles;
use crate::terrain::surface::Surface;
use crate::terrain::truth::Truth;

const SCRIPT: &str = "sim_physics/shape.py";
/// Radius of a foot, m.
const FOOT_M: f64 = 0.02;
/// Edge of the cells of places, m.
const CELL_M: f64 = 0.02;
/// A foot that finds no true surface this near is held by nothing, m.
const SUPPORT_M: f64 = 0.03;
/// Time step of the bodies that measure the engines, s.
const STEP_S: f64 = 0.002;
/// Points of soles that are probed in the engines, at most.
const PROBES: usize = 4000;

/// The report of a walk: a row for each number of parts, the heights in both engines for the
/// default, and the knee. Models are written to a folder.
///
/// # Errors
/// No interpreter with MuJoCo, or an I/O error.
pub(super) fn report(surface: &Surface, truth: &Truth<'_>, folder: &Path) -> Result<Value> {
    let places = places(truth);
    let middle = truth.footprints.get(truth.footprints.len() / 2);
    let middle = middle.context("no footprints")?.middle;
    let stand = bodies::stand_at(middle).context("no stand")?;
    let mut rows = Vec::new();
    let (mut jobs, mut own_us) = (Vec::new(), Vec::new());
    for (number, config) in parts::configs().enumerate() {
        let shape = model::with_config(surface, &config);
        let name = format!("shape-{number}");
        let (exported, lost) = model::exported_in_part(&shape, folder, &name)?;
        jobs.push(stand.to_json(&exported, STEP_S)?);
        own_us.push(stand.run(&shape, STEP_S)?["cpu_us_per_step"].clone());
        let probe = Probe::new(&shape);
        let ground = shape
            .parts
            .iter()
            .filter(|part| part.kind != PartKind::Obstacle);
        rows.push(json!({
            "uncovered_share": config.max_uncovered_share,
            "parts": ground.count(),
            "geoms": shape.parts.len() + shape.layers.len(),
            "flat": lost.len(),
            "parts_per_100_m2": shape.report.parts_per_100_m2,
            "feet": feet(&probe, truth, &places),
            "penetration": penetration(&probe, truth),
            "normals": slopes(&probe, truth, &places),
            "step_edges": step_edges(&probe, truth),
        }));
    }
    let answer = python::ask_in(python::PHYSICS, bodies::SCRIPT, &json!({ "jobs": jobs }))?;
    let answered = entries(&answer["jobs"]);
    ensure!(answered.len() == rows.len(), "{} answers", answered.len());
    for ((row, own_us), found) in rows.iter_mut().zip(own_us).zip(answered) {
        row["step_us"] = json!({ "rapier": own_us, "mujoco": found["cpu_us_per_step"] });
    }
    let shape = model::reconstructed(surface);
    let exported = model::exported(&shape, folder, "shape-default")?;
    let report = json!({
        "places": places.len(),
        "engines": engines(&shape, truth, &exported)?,
        "knee": knee(&rows),
        "rows": rows,
    });
    println!("{report:#}");
    Ok(report)
}

/// Places with true ground: x, y and its height, m.
fn places(truth: &Truth<'_>) -> Vec<[f64; 3]> {
    let cells = truth.cells(CELL_M, FEET_REACH_M).into_iter();
    let on_ground = cells.filter_map(|[x, y, z]| {
        let height = truth.ground([x, y, z], LEVEL_M)?;
        ((height - z).abs() < LEVEL_M).then_some([x, y, height])
    });
    on_ground.collect()
}

/// The middle of a foot and eight points of its border.
fn disc([x, y]: [f64; 2]) -> [Vector2<f64>; 9] {
    std::array::from_fn(|k| {
        let angle = std::f64::consts::FRAC_PI_4 * k as f64;
        let radius = if k == 8 { 0.0 } else { FOOT_M };
        Vector2::new(x + radius * libm::cos(angle), y + radius * libm::sin(angle))
    })
}

/// Shares of places at which the shape holds a foot and the truth does not, and the other way
/// around, and heights where both do.
fn feet(probe: &Probe, truth: &Truth<'_>, places: &[[f64; 3]]) -> Value {
    let (mut extra, mut lacking, mut holes) = (0, 0, 0);
    let mut errors = Vec::new();
    for [x, y, ground] in places {
        let disc = disc([*x, *y]);
        let heights = |height: &dyn Fn(Vector2<f64>) -> Option<f64>| {
            disc.iter().filter_map(|at| height(*at)).reduce(f64::max)
        };
        let held = heights(&|at| Some(probe.highest(at, *ground, LEVEL_M)?.0));
        let Some(held) = held else {
            holes += 1;
            continue;
        };
        let is_there = disc.iter().any(|at| {
            let mut surfaces = truth.surfaces([at.x, at.y]);
            surfaces.any(|height| (height - held).abs() <= SUPPORT_M)
        });
        let true_height = heights(&|at| {
            let found = truth.ground([at.x, at.y, *ground], LEVEL_M)?;
            ((found - ground).abs() < LEVEL_M).then_some(found)
        });
        let error = held - true_height.unwrap_or(*ground);
        if !is_there {
            extra += 1;
        } else if error < -SUPPORT_M {
            lacking += 1;
        } else {
            errors.push(error);
        }
    }
    let share = |count: i32| f64::from(count) / places.len().max(1) as f64;
    json!({
        "false_support_share": share(extra),
        "missing_support_share": share(lacking),
        "hole_share": share(holes),
        "height": Quantiles::of(errors),
    })
}

/// Angles between the slopes of the shape and of the truth under feet.
fn slopes(probe: &Probe, truth: &Truth<'_>, places: &[[f64; 3]]) -> Value {
    let angle = |[x, y, ground]: &[f64; 3]| {
        let found = |at| Some(probe.highest(at, *ground, LEVEL_M)?.0);
        let expected = |at: Vector2<f64>| truth.ground([at.x, at.y, *ground], LEVEL_M);
        angle_deg(&disc([*x, *y]), found, expected)
    };
    angles(places.iter().filter_map(angle).collect())
}

/// How deep the true sole of each footprint is in the shape, at its deepest point.
fn penetration(probe: &Probe, truth: &Truth<'_>) -> Quantiles {
    let deepest = truth.footprints.iter().filter_map(|print| {
        let depths = print.ground.iter().filter_map(|[x, y, z]| {
            let (height, _) = probe.highest(Vector2::new(*x, *y), *z, LEVEL_M)?;
            Some((height - z).max(0.0))
        });
        depths.reduce(f64::max)
    });
    Quantiles::of(deepest)
}

/// Heights under points of soles in both engines against those of the faces.
fn engines(shape: &Collision, truth: &Truth<'_>, model: &Path) -> Result<Value> {
    let probe = Probe::new(shape);
    let soles: Vec<[f64; 3]> = truth
        .footprints
        .iter()
        .flat_map(|print| print.ground.clone())
        .collect();
    let every = soles.len().div_ceil(PROBES).max(1);
    let mut world = RigidBodies::new(shape, BodiesConfig::default())?;
    world.step()?;
    let (mut places, mut faces, mut rapier) = (Vec::new(), Vec::new(), Vec::new());
    let mut inside = 0;
    for [x, y, z] in soles.into_iter().step_by(every) {
        // From above whatever the sole stands on, and below what is over its head.
        let from = [x, y, z + LEVEL_M];
        let Some((height, _)) = probe.highest(Vector2::new(x, y), z, LEVEL_M) else {
            continue;
        };
        let found = world.ground_m(from, 2.0 * LEVEL_M);
        if found == Some(from[2]) {
            inside += 1;
            continue;
        }
        places.push(from);
        faces.push(height);
        rapier.push(found);
    }
    let question = json!({ "modules": modules(), "model": model, "from": places });
    let answer = python::ask_in(python::PHYSICS, SCRIPT, &question)?;
    let mujoco: Vec<Option<f64>> = entries(&answer["heights"])
        .iter()
        .map(Value::as_f64)
        .collect();
    ensure!(mujoco.len() == faces.len(), "{} heights", mujoco.len());
    let compared = |found: &[Option<f64>]| {
        let errors = found
            .iter()
            .zip(&faces)
            .filter_map(|(own, face)| Some((*own)? - face));
        json!({
            "difference": Quantiles::of(errors),
            "none": found.iter().filter(|own| own.is_none()).count(),
        })
    };
    Ok(json!({
        "places": faces.len(),
        "inside_of_parts": inside,
        "rapier": compared(&rapier),
        "mujoco": compared(&mujoco),
    }))
}

/// The fewest parts with which soles are within a centimetre at 95 % and false support is within
/// its goal.
fn knee(rows: &[Value]) -> Value {
    let number = |row: &Value, path: [&str; 2]| row[path[0]][path[1]].as_f64();
    let is_fine = |row: &&Value| {
        let height = row["feet"]["height"]["p95_mm"].as_f64();
        let share = number(row, ["feet", "false_support_share"]);
        height.is_some_and(|mm| mm <= CONTACT_GOAL_MM)
            && share.is_some_and(|share| share <= FALSE_SUPPORT_GOAL)
    };
    let fine = rows.iter().filter(is_fine);
    let fewest = fine.min_by_key(|row| row["parts"].as_u64());
    fewest.map_or(Value::Null, |row| row["parts"].clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_foot_has_points_on_its_border() {
        let disc = disc([1.0, 2.0]);
        let middle = Vector2::new(1.0, 2.0);
        assert_eq!(disc[8], middle);
        assert!(
            disc[..8]
                .iter()
                .all(|at| ((at - middle).norm() - FOOT_M).abs() < 1e-12)
        );
    }

    #[test]
    fn the_knee_has_the_fewest_parts_of_those_that_are_fine() {
        let row = |parts: u64, p95_mm: f64, share: f64| json!({ "parts": parts, "feet": { "false_support_share": share, "height": { "p95_mm": p95_mm } } });
        let rows = [
            row(900, 4.0, 5e-4),
            row(500, 8.0, 9e-4),
            row(300, 8.0, 2e-3),
            row(100, 20.0, 1e-4),
        ];
        assert_eq!(knee(&rows), json!(500));
        assert_eq!(knee(&rows[2..]), Value::Null);
    }
}
