//! The same bodies on the same ground in both engines: `rapier3d` in process and MuJoCo.
//!
//! A box, a ball, a lying capsule and a stand with four feet fall from 10 cm on a plane, a tread, a
//! ramp of 10 degrees and a height layer of waves, and are thrown down on the plane at 5 m/s, with
//! time steps from 0.5 to 16 ms. What rolls falls on level ground alone.
//!
//! The Go2 stands in its default pose in MuJoCo, on a plane of MuJoCo, on the plane and on a tread.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use cad_transforms::RigidTransform;
use scene_bundle::outputs::collision::{Collision, ConvexPart, HeightLayer, PartKind};
use scene_bundle::outputs::grid::Grid;
use serde_json::{Value, json};
use simulation::{BodiesConfig, Body, BodyShape, RigidBodies};

use super::model;
use super::stand;
use super::values::entries;
use crate::{meter, python};

pub(super) const SCRIPT: &str = "sim_physics/bodies.py";
/// Time steps, ms. The first is the standard that others are compared with.
const STEPS_MS: [f64; 6] = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0];
const DURATION_S: f64 = 3.0;
const DROP_M: f64 = 0.1;
const FRICTION: f64 = 1.0;
const RISE_M: f64 = 0.17;
const RAMP_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// A body over a ground.
pub(super) struct Case {
    place: &'static str,
    body: &'static str,
    fall: &'static str,
    shapes: Vec<(BodyShape, [f64; 3])>,
    mass_kg: f64,
    position_m: [f64; 3],
    velocity_m_s: [f64; 3],
    /// Height of its origin above its sole, m.
    sole_m: f64,
    /// Height of its origin at rest, m; `None` where the ground is not level.
    rest_m: Option<f64>,
}

/// A row for each case, engine and time step; models of the ground are written to a folder.
///
/// # Errors
/// No interpreter with MuJoCo, or an I/O error.
pub(super) fn bodies(folder: &Path) -> Result<Vec<Value>> {
    let mut models: Vec<(&str, Collision, PathBuf)> = Vec::new();
    for (name, ground) in grounds() {
        let exported = model::exported(&ground, folder, name)?;
        models.push((name, ground, exported));
    }
    let cases = cases();
    let all = cases
        .iter()
        .flat_map(|case| STEPS_MS.map(|step_ms| (case, step_ms)));
    let all: Vec<(&Case, f64)> = all.collect();
    let ground_of = |case: &Case| {
        let found = models.iter().find(|(name, ..)| *name == case.ground());
        found.with_context(|| format!("no ground {}", case.ground()))
    };
    let mut jobs = Vec::new();
    for (case, step_ms) in &all {
        jobs.push(case.to_json(&ground_of(case)?.2, 1e-3 * step_ms)?);
    }
    let answer = python::ask_in(python::PHYSICS, SCRIPT, &json!({ "jobs": jobs }))?;
    let answered = entries(&answer["jobs"]).len();
    ensure!(
        answered == all.len(),
        "{answered} answers to {} jobs",
        all.len()
    );
    let mut rows = Vec::new();
    for ((case, step_ms), found) in all.iter().zip(entries(&answer["jobs"])) {
        let own = case.run(&ground_of(case)?.1, 1e-3 * step_ms)?;
        for (engine, found) in [("rapier", &own), ("mujoco", found)] {
            rows.push(json!({
                "place": case.place,
                "body": case.body,
                "fall": case.fall,
                "engine": engine,
                "step_ms": step_ms,
                "rest": case.rest(found),
                "cpu_us_per_step": found["cpu_us_per_step"],
            }));
        }
    }
    for row in &mut rows {
        row["mujoco"] = answer["mujoco"].clone();
    }
    compare(&mut rows);
    rows.extend(stand::go2(&ground_of(&cases[0])?.2, 2.0 * RISE_M)?);
    println!("{:#}", Value::Array(rows.clone()));
    Ok(rows)
}

/// Adds to each row how far it is from MuJoCo with the shortest step.
fn compare(rows: &mut [Value]) {
    let standards: Vec<Value> = rows
        .iter()
        .filter(|row| row["engine"] == "mujoco" && row["step_ms"] == STEPS_MS[0])
        .cloned()
        .collect();
    for row in rows {
        let is_same = |own: &&Value| ["place", "body", "fall"].iter().all(|k| own[*k] == row[*k]);
        let Some(standard) = standards.iter().find(is_same) else {
            continue;
        };
        let difference = |key: &str| {
            let of = |row: &Value| row["rest"][key].as_f64().unwrap_or(f64::NAN);
            (of(row) - of(standard)).abs()
        };
        row["from_mujoco"] = json!({
            "height_mm": difference("height_mm"),
            "tilt_deg": difference("tilt_deg"),
            "slip_mm": difference("slip_mm"),
        });
    }
}

impl Case {
    /// Name of the ground that the place is on.
    fn ground(&self) -> &'static str {
        match self.place {
            "plane" | "tread" => "stairs",
            other => other,
        }
    }

    /// For the script.
    pub(super) fn to_json(&self, model: &Path, step_s: f64) -> Result<Value> {
        let mut shapes = Vec::new();
        for (shape, position_m) in &self.shapes {
            let (kind, size_m) = match shape {
                BodyShape::Box { half_m } => ("box", half_m.to_vec()),
                BodyShape::Ball { radius_m } => ("ball", vec![*radius_m]),
                BodyShape::Capsule { half_m, radius_m } => ("capsule", vec![*radius_m, *half_m]),
            };
            shapes.push(json!({ "type": kind, "size_m": size_m, "position_m": position_m }));
        }
        Ok(json!({
            "model": model,
            "shapes": shapes,
            "mass_kg": self.mass_kg,
            "position_m": self.position_m,
            "velocity_m_s": self.velocity_m_s,
            "step_s": step_s,
            "duration_s": DURATION_S,
            "friction": FRICTION,
        }))
    }

    /// The same in process, with the same answer as the script.
    pub(super) fn run(&self, ground: &Collision, step_s: f64) -> Result<Value> {
        let mut config = BodiesConfig::default();
        config.step_s = step_s;
        config.friction = FRICTION;
        let mut world = RigidBodies::new(ground, config)?;
        let (first, _) = self.shapes[0];
        let mut body = Body::new(first, self.mass_kg, self.position_m)?;
        body.velocity_m_s = self.velocity_m_s;
        body.shapes.clear();
        for (shape, position_m) in &self.shapes {
            // Capsules lie along x.
            let rotation = match shape {
                BodyShape::Capsule { .. } => [0.0, std::f64::consts::FRAC_PI_2, 0.0],
                _ => [0.0; 3],
            };
            let place = RigidTransform::from_rotation_vector(rotation, *position_m)?;
            body.shapes.push((*shape, place));
        }
        let body = world.add(&body)?;
        let steps = (DURATION_S / step_s).round() as usize;
        let mut lowest_m = f64::INFINITY;
        // A body that sleeps costs nothing: the steps before are counted.
        let (mut awake, mut took) = (0, 0.0);
        let before = meter::thread_cpu_s();
        for step in 0..steps {
            world.step()?;
            let state = world.state(body)?;
            lowest_m = lowest_m.min(state.world_from_body.translation_m()[2]);
            if !state.is_asleep {
                (awake, took) = (step + 1, meter::thread_cpu_s() - before);
            }
        }
        let pose = world.state(body)?.world_from_body;
        Ok(json!({
            "position_m": pose.translation_m(),
            "up": pose.rotate([0.0, 0.0, 1.0]),
            "lowest_m": lowest_m,
            "cpu_us_per_step": 1e6 * took / f64::from(awake.max(1) as u32),
        }))
    }

    /// Where it rests: its height, the tilt of its z axis, how far the middle of its sole is from
    /// below where it was dropped, and how far it sank in below its rest.
    fn rest(&self, found: &Value) -> Value {
        let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
        let at = |key: &str, k: usize| number(&found[key][k]);
        // What is round has its sole below its middle, however it is rotated; on level ground that
        // is as far away as the middle.
        let sole_m = |k: usize| match self.body {
            "ball" | "capsule" => at("position_m", k),
            _ => at("position_m", k) - self.sole_m * at("up", k),
        };
        let away = |k: usize| sole_m(k) - self.position_m[k];
        let height_m = at("position_m", 2);
        json!({
            "height_mm": 1e3 * height_m,
            "height_error_mm": self.rest_m.map(|rest_m| 1e3 * (height_m - rest_m)),
            "tilt_deg": at("up", 2).clamp(-1.0, 1.0).acos().to_degrees(),
            "slip_mm": 1e3 * f64::hypot(away(0), away(1)),
            "sink_mm": 1e3 * (height_m - number(&found["lowest_m"])).max(0.0),
        })
    }
}

/// A stand of 4 kg with four feet, dropped from 10 cm above a place.
pub(super) fn stand_at([x, y, z]: [f64; 3]) -> Option<Case> {
    let mut stand = cases().into_iter().find(|case| case.body == "stand")?;
    stand.position_m = [x, y, z + stand.sole_m + DROP_M];
    Some(stand)
}

fn cases() -> Vec<Case> {
    let box_ = || {
        vec![(
            BodyShape::Box {
                half_m: [0.06, 0.08, 0.05],
            },
            [0.0; 3],
        )]
    };
    let ball = || vec![(BodyShape::Ball { radius_m: 0.05 }, [0.0; 3])];
    let capsule = || {
        let shape = BodyShape::Capsule {
            half_m: 0.08,
            radius_m: 0.04,
        };
        vec![(shape, [0.0; 3])]
    };
    let stand = || {
        let trunk = BodyShape::Box {
            half_m: [0.16, 0.1, 0.02],
        };
        let foot = |x: f64, y: f64| (BodyShape::Ball { radius_m: 0.022 }, [x, y, -0.1]);
        let feet = [
            foot(0.14, 0.09),
            foot(0.14, -0.09),
            foot(-0.14, 0.09),
            foot(-0.14, -0.09),
        ];
        [(trunk, [0.0; 3])].into_iter().chain(feet).collect()
    };
    let mut all = Vec::new();
    let mut add = |name, at: [f64; 2], ground_m: f64, fall, is_level: bool| {
        let mut bodies = vec![("box", box_(), 1.0, 0.05), ("stand", stand(), 4.0, 0.122)];
        if is_level {
            bodies.push(("ball", ball(), 0.5, 0.05));
            bodies.push(("capsule", capsule(), 0.8, 0.04));
        }
        for (body, shapes, mass_kg, height_m) in bodies {
            let rest_m = ground_m + height_m;
            let down_m_s = if fall == "thrown" { -5.0 } else { 0.0 };
            all.push(Case {
                place: name,
                body,
                fall,
                shapes,
                mass_kg,
                position_m: [at[0], at[1], rest_m + DROP_M],
                velocity_m_s: [0.0, 0.0, down_m_s],
                sole_m: height_m,
                rest_m: is_level.then_some(rest_m),
            });
        }
    };
    add("plane", [-1.0, 0.2], 0.0, "dropped", true);
    add("plane", [-1.0, 0.2], 0.0, "thrown", true);
    add("tread", [0.9, -0.3], 2.0 * RISE_M, "dropped", true);
    add(
        "ramp",
        [0.3, 0.1],
        0.3 * libm::tan(RAMP_RAD),
        "dropped",
        false,
    );
    add(
        "waves",
        [0.21, -0.13],
        wave_m([0.21, -0.13]),
        "dropped",
        false,
    );
    all
}

fn grounds() -> [(&'static str, Collision); 3] {
    let slab = |from_m: [f64; 3], to_m: [f64; 3], rise_m: f64| {
        let corner = |i: usize| {
            let of = |k: usize| if i >> k & 1 == 1 { to_m[k] } else { from_m[k] };
            [of(0), of(1), of(2) + rise_m * f64::from((i & 1) as u8)]
        };
        ConvexPart {
            kind: PartKind::Ground,
            plane: None,
            vertices_m: (0..8).map(corner).collect(),
            triangles: SLAB.to_vec(),
        }
    };
    // Treads of 0.6 m: a stand of 0.3 m fits.
    let tread = |i: usize| {
        let from = 0.6 * i as f64;
        slab(
            [from, -1.5, -0.2],
            [from + 0.6, 1.0, RISE_M * (i + 1) as f64],
            0.0,
        )
    };
    let plane = slab([-5.0, -1.5, -0.2], [0.0, 1.0, 0.0], 0.0);
    let parts = |parts: Vec<ConvexPart>| Collision {
        parts,
        ..Collision::default()
    };
    let ramp = slab(
        [-2.0, -1.5, -0.2],
        [2.0, 1.0, 0.0],
        4.0 * libm::tan(RAMP_RAD),
    );
    let ramp = ConvexPart {
        vertices_m: ramp
            .vertices_m
            .iter()
            .map(|[x, y, z]| [*x, *y, z - 2.0 * libm::tan(RAMP_RAD)])
            .collect(),
        ..ramp
    };
    let grid = Grid {
        cell_m: 0.04,
        origin_m: [-1.0, -1.0],
        columns: 51,
        rows: 51,
    };
    let height = |cell: usize| {
        let index = [cell % grid.columns, cell / grid.columns];
        wave_m([0, 1].map(|k| grid.origin_m[k] + grid.cell_m * index[k] as f64)) as f32
    };
    let waves = Collision {
        layers: vec![HeightLayer {
            grid,
            heights_m: (0..grid.cells()).map(height).collect(),
        }],
        ..Collision::default()
    };
    let stairs = [plane].into_iter().chain((0..4).map(tread)).collect();
    [
        ("stairs", parts(stairs)),
        ("ramp", parts(vec![ramp])),
        ("waves", waves),
    ]
}

/// Waves of 1.5 cm, 0.9 and 0.7 m long.
fn wave_m([x, y]: [f64; 2]) -> f64 {
    let turn = std::f64::consts::TAU;
    0.015 * (libm::sin(turn * x / 0.9) + libm::cos(turn * y / 0.7 + 0.4))
}

/// Faces of a box whose corners are counted in binary, counterclockwise seen from outside.
const SLAB: [[u32; 3]; 12] = [
    [0, 2, 3],
    [0, 3, 1],
    [4, 5, 7],
    [4, 7, 6],
    [0, 1, 5],
    [0, 5, 4],
    [2, 6, 7],
    [2, 7, 3],
    [0, 4, 6],
    [0, 6, 2],
    [1, 3, 7],
    [1, 7, 5],
];
