//! `odometry_monte_carlo`: whether stated covariances are right if calibrations are as uncertain as
//! they state.
//!
//! Simulated cameras are mounted exactly as calibrated, so that what a covariance contains of the
//! calibration is missing from the errors. Here nominal calibrations deviate by errors that are
//! drawn from the priors of the estimator (normal, of every camera): rotation and translation
//! between camera and body, rotation of the right eye, baseline, focal length and principal point.
//! The decentering is not drawn. Calibrations state their covariance, or none. NEES is over its
//! dimensions and all tracked poses of all walks: 1 is right, above is overconfident.
//!
//! Images are in the folder that `PAWS_WALKS` or `--walks` names.

use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use harness::tracking;
use nalgebra::Vector6;
use odometry::{Config, Preset, Rig};
use scene_bundle::Trajectory;
use serde::Serialize;
use serde_json::{Value, json};

use super::calibration::RIGS;
use super::options::Options;
use super::results;
use super::run::Job;
use crate::sync::Random;
use crate::{stamp, trajectory_errors};

/// Walks; the factor on observations across cameras was chosen on those of seed 61, nothing on
/// those of 81.
const WALKS: [&str; 6] = [
    "pavement-day-61-20",
    "corridor-day-61-20",
    "stairs-day-61-20",
    "pavement-day-81-20",
    "room-day-81-20",
    "plaza-day-81-20",
];
/// Draws per walk and rig.
const DRAWS: u64 = 3;

/// Deviations of a rig from the priors.
struct Draw {
    random: Random,
    config: Config,
    is_covariance_stated: bool,
}

/// One draw on one walk with one rig.
#[derive(Clone, Debug, Serialize)]
struct Point {
    walk: String,
    rig: &'static str,
    is_covariance_stated: bool,
    draw: u64,
    causal: Value,
    refined: Value,
}

/// Runs the benchmark: `[--quick] [--only stated,unstated] [--name WALK,...] [--walks DIR]
/// [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args, &["stated", "unstated"])?;
    let mut points = Vec::new();
    for (number, walk) in options.walks_or(&WALKS).into_iter().enumerate() {
        for (k, (rig, cameras, with_imu)) in RIGS.into_iter().enumerate() {
            for part in &options.parts {
                let is_covariance_stated = part == "stated";
                for draw in 0..if options.quick { 1 } else { DRAWS } {
                    let mut job = Job::whole(&walk, "balanced", true);
                    job.cameras = cameras.iter().map(|name| (*name).to_owned()).collect();
                    job.with_imu = with_imu;
                    let drawn = Draw {
                        random: Random((number as u64 * 100 + k as u64) * 100 + draw),
                        config: Config::preset(Preset::Balanced),
                        is_covariance_stated,
                    };
                    let [causal, refined] = track(&job, drawn, &options)?;
                    let point = Point {
                        walk: walk.clone(),
                        rig,
                        is_covariance_stated,
                        draw,
                        causal,
                        refined,
                    };
                    println!("{}", point.line());
                    points.push(point);
                }
            }
        }
        if options.quick {
            break;
        }
    }
    let report = json!({
        "benchmark": "odometry_monte_carlo",
        "stamp": stamp::stamp("odometry_monte_carlo", args)?,
        "groups": groups(&points),
        "points": points,
    });
    for group in report["groups"].as_array().into_iter().flatten() {
        println!("{group}");
    }
    results::write(
        &options.out,
        vec![(
            "odometry_monte_carlo.json".to_owned(),
            format!("{report:#}\n"),
        )],
    )
}

fn track(job: &Job, mut draw: Draw, options: &Options) -> Result<[Value; 2]> {
    let config = draw.config;
    let mut applied = Ok(());
    let sequence = job.sequence(&options.walks)?;
    let sequence = sequence.with_nominal_rig(|rig| applied = draw.apply(rig));
    applied?;
    let truth = tracking::truth(&sequence)?;
    let tracking = tracking::track(&sequence, config, true)?;
    let of = |trajectory: &Trajectory| trajectory_errors::errors(trajectory, &truth);
    let causal = of(tracking.causal());
    let refined = tracking.refine()?.context("mapping is in use")?;
    Ok([causal, of(&refined.trajectory)])
}

impl Draw {
    /// Changes nominal calibrations. Those of cameras without a stated covariance are correlated,
    /// as the estimator assumes.
    fn apply(&mut self, rig: &mut Rig) -> Result<()> {
        let backend = self.config.backend;
        let stereo = backend.stereo;
        let of_rig: [f64; 6] = std::array::from_fn(|_| self.random.normal());
        for camera in &mut rig.cameras {
            if !self.is_covariance_stated {
                camera.covariance = None;
                camera.right_from_left_covariance = None;
            }
            let prior = backend
                .extrinsics
                .prior_covariance(camera.covariance.as_ref());
            let factor = prior.cholesky().context("a covariance")?.l();
            let motion = factor * Vector6::from_fn(|_, _| self.random.normal());
            let [x, y, z, a, b, c] = motion.into();
            let motion = RigidTransform::from_rotation_vector([a, b, c], [x, y, z])?;
            camera.rig_from_left = camera.rig_from_left * motion;
            let shared = if camera.right_from_left_covariance.is_some() {
                0.0
            } else {
                stereo.correlation
            };
            let mut normal = |component: usize| {
                shared.sqrt() * of_rig[component] + (1.0 - shared).sqrt() * self.random.normal()
            };
            let sigmas = stereo.prior_sigmas(camera);
            let [x, y, z, baseline, focal, principal_point]: [f64; 6] =
                std::array::from_fn(|k| sigmas[k] * normal(k));
            let turn = RigidTransform::from_rotation_vector([x, y, z], [0.0; 3])?;
            let of = camera.right_from_left;
            let longer = of.translation_m().map(|m| m * baseline.exp());
            camera.right_from_left = turn * RigidTransform::from_wxyz(of.rotation_wxyz(), longer)?;
            camera.right.cx += principal_point * camera.right.fx;
            camera.right.fx *= focal.exp();
            camera.right.fy *= focal.exp();
        }
        Ok(())
    }
}

impl Point {
    /// Progress line.
    fn line(&self) -> String {
        format!(
            "{} {} {} {}: causal | {} |, refined | {} |",
            self.walk,
            self.rig,
            if self.is_covariance_stated {
                "stated"
            } else {
                "unstated"
            },
            self.draw,
            trajectory_errors::columns(&self.causal),
            trajectory_errors::columns(&self.refined),
        )
    }
}

/// Means over all poses of a rig.
fn groups(points: &[Point]) -> Vec<Value> {
    let mut groups = Vec::new();
    for (rig, _, _) in RIGS {
        for is_stated in [true, false] {
            let own = points.iter();
            let own: Vec<&Point> = own
                .filter(|p| p.rig == rig && p.is_covariance_stated == is_stated)
                .collect();
            let sum = |of: fn(&Point) -> &Value, key: &str, weight: &str| -> f64 {
                let each = own.iter().map(|p| {
                    let errors = of(p);
                    let weight = errors[weight].as_f64().unwrap_or(1.0);
                    errors[key].as_f64().unwrap_or(0.0) * weight
                });
                each.sum()
            };
            let statistics = |of: fn(&Point) -> &Value| {
                let compared = sum(of, "compared", "");
                json!({
                    "nees_position": sum(of, "nees_position", "compared") / compared,
                    "nees_rotation": sum(of, "nees_rotation", "compared") / compared,
                    "silently_wrong": sum(of, "silently_wrong", ""),
                    "compared": compared,
                })
            };
            groups.push(json!({
                "rig": rig,
                "is_covariance_stated": is_stated,
                "runs": own.len(),
                "causal": statistics(|p| &p.causal),
                "refined": statistics(|p| &p.refined),
            }));
        }
    }
    groups
}
