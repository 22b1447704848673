//! One camera as an ASL folder.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use super::truth::TruthFiles;
use super::{Job, RenderError, at, special, tables, write, yaml};
use crate::png_file;
use crate::simulation::Simulation;

const EYES: [&str; 2] = ["cam0", "cam1"];
const PICTURES: &str = "#timestamp [ns],filename\n";

/// Writes `folder/NAME/mav0`. `done` is called after each stereo frame.
pub(super) fn camera(
    simulation: &Arc<Simulation>,
    number: usize,
    job: &Job<'_>,
    folder: &Path,
    done: &(dyn Fn() + Sync),
) -> Result<(), RenderError> {
    let camera = &simulation.cameras()[number];
    let imu = &simulation.imus()[number];
    let root = folder.join(&camera.name).join("mav0");
    let sensor = |name: &str, description: &str| {
        let folder = root.join(name);
        fs::create_dir_all(&folder).map_err(at(&folder))?;
        write(&folder.join("sensor.yaml"), description)
    };
    for (k, eye) in EYES.into_iter().enumerate() {
        sensor(eye, &yaml::camera(simulation, number, k)?)?;
    }
    sensor("imu0", &yaml::imu(&camera.name, &imu.imu))?;
    write(&root.join("imu0/data.csv"), &tables::imu(simulation, imu))?;
    let state = "state_groundtruth_estimate0";
    sensor(state, &yaml::state(&camera.name))?;
    write(
        &root.join(state).join("data.csv"),
        &tables::state(simulation, imu),
    )?;
    for name in EYES {
        let data = root.join(name).join("data");
        fs::create_dir(&data).map_err(at(&data))?;
    }
    let faults = job.faults.of(&camera.name);
    let mut true_files = match job.truth {
        true => Some(TruthFiles::begin(simulation, number, &faults, &root)?),
        false => None,
    };

    if job.truth && !simulation.boards().is_empty() {
        let text = special::corners(simulation, number, &faults);
        write(&root.with_file_name("corners.csv"), &text)?;
    }

    let mut list = PICTURES.to_owned();
    let images = simulation.frames(number);
    for frame in images.with_faults(faults) {
        let name = format!("{}.png", frame.time_ns);
        let size = [frame.width / 2, frame.height];
        for (k, eye) in EYES.into_iter().enumerate() {
            let path = root.join(eye).join("data").join(&name);
            png_file::gray8(&path, size, &frame.gray(k)).map_err(at(&path))?;
        }
        if let Some(files) = &mut true_files {
            files.frame(frame.number, &name)?;
        }
        // Writing to a string does not fail.
        let _ = writeln!(list, "{},{name}", frame.time_ns);
        done();
    }
    for name in EYES {
        write(&root.join(name).join("data.csv"), &list)?;
    }
    match true_files {
        Some(files) => files.end(&list),
        None => Ok(()),
    }
}
