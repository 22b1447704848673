//! What `cargo xtask bench` runs: speed and accuracy, measured together, ours beside peers.
//!
//! `bench NAME [--quick] [--out DIR]` writes `NAME.json` and charts into DIR (default
//! `docs/benchmarks`). Each benchmark is one module with a `run` function.

mod archive;
mod arguments;
mod calib;
mod calib_verify;
mod camera_imu;
mod compare;
mod confidence;
mod depth;
mod encode;
mod feet;
mod feet_camera;
mod feet_faults;
mod feet_length;
mod foreign;
mod frame_sync;
mod frames_kept;
mod gtsam;
mod import;
mod kills;
mod load;
mod meter;
mod odometry;
mod power_cuts;
mod python;
mod recording;
mod rectify;
mod render_speed;
mod report;
mod resident;
mod sim;
mod sim_images;
mod sim_learn;
mod sim_physics;
mod sim_render;
mod sim_step;
mod sim_truth;
mod soak;
mod splats;
mod stamp;
mod sync;
mod tag_detectors;
mod terrain;
mod trajectory_errors;
mod vm_cost;

use std::process::ExitCode;

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let Some((name, rest)) = args.split_first() else {
        eprintln!("which benchmark? {}", names());
        return ExitCode::from(2);
    };
    let run = match name.as_str() {
        // No benchmark, so that `bench all` does not run it.
        "compare" => Some(compare::run as Run),
        name => BENCHMARKS
            .iter()
            .find(|(n, _)| *n == name)
            .map(|(_, run)| *run),
    };
    let Some(run) = run else {
        eprintln!("there is no benchmark {name:?}; there are: {}", names());
        return ExitCode::from(2);
    };
    match stamp::begin().and_then(|()| run(rest)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("bench {name}: {e:#}");
            ExitCode::FAILURE
        }
    }
}

type Run = fn(&[String]) -> anyhow::Result<()>;

/// Every benchmark: its name, and what runs it.
const BENCHMARKS: &[(&str, Run)] = &[
    ("archive", archive::run),
    ("calib", calib::run),
    ("calib_verify", calib_verify::run),
    ("camera_imu", camera_imu::run),
    ("confidence", confidence::run),
    ("depth", depth::run),
    ("encode", encode::run),
    ("feet", feet::run),
    ("feet_camera", feet_camera::run),
    ("feet_faults", feet_faults::run),
    ("feet_length", feet_length::run),
    ("foreign", foreign::run),
    ("frame_sync", frame_sync::run),
    ("frames_kept", frames_kept::run),
    ("gtsam", gtsam::run),
    ("import", import::run),
    ("kills", kills::run),
    ("odometry", odometry::run),
    ("odometry_calibration", odometry::calibration::run),
    ("odometry_encoding", odometry::encoding::run),
    ("odometry_faults", odometry::faults::run),
    ("odometry_length", odometry::length::run),
    ("odometry_monte_carlo", odometry::monte_carlo::run),
    ("odometry_scale", odometry::scale::run),
    ("power_cuts", power_cuts::run),
    ("rectify", rectify::run),
    ("render", render_speed::run),
    ("sim", sim::run),
    ("sim_images", sim_images::run),
    ("sim_learn", sim_learn::run),
    ("sim_physics", sim_physics::run),
    ("sim_render", sim_render::run),
    ("sim_step", sim_step::run),
    ("sim_truth", sim_truth::run),
    ("soak", soak::run),
    ("splats", splats::run),
    ("sync", sync::run),
    ("tag_detectors", tag_detectors::run),
    ("terrain", terrain::run),
    ("vm_cost", vm_cost::run),
];

fn names() -> String {
    let names: Vec<&str> = BENCHMARKS.iter().map(|(name, _)| *name).collect();
    names.join(", ")
}
