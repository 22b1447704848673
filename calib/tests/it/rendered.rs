//! Sessions of the simulated rig, rendered and encoded, for tests of `paws-calib`.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use cad_transforms::Rig;
use rig_sim::calibration_error::CalibrationError;
use rig_sim::faults::Faults;
use rig_sim::render::{Job, render_session};
use rig_sim::simulation::{Settings, Simulation};

const RIG: &str = include_str!("../../../cad-transforms/rigs/example.toml");

/// Writes a session of the example rig with this deviation; returns the ground-truth rig.
pub(crate) fn write(folder: &Path, settings: &Settings, deviation: &CalibrationError) -> Rig {
    let rig = Rig::parse(RIG).unwrap();
    let simulation = Simulation::new(settings, &rig).unwrap();
    let simulation = simulation.with_calibration_error(&rig, deviation).unwrap();
    let truth = Rig::parse(&simulation.true_rig_toml(&rig)).unwrap();
    let job = Job {
        rig: &rig,
        rig_text: RIG,
        session: true,
        faults: &Faults::default(),
        truth: false,
        threads: 2,
    };
    render_session(&Arc::new(simulation), &job, folder, &|| {}).unwrap();
    truth
}

/// Exit code of `paws-calib`, and what it printed.
pub(crate) fn calib(arguments: &[&str]) -> (Option<i32>, String) {
    let run = Command::new(env!("CARGO_BIN_EXE_paws-calib"))
        .args(arguments)
        .output()
        .unwrap();
    let text = [run.stdout, run.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    (run.status.code(), text.concat())
}
