//! One camera as an ASL folder.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use super::{Job, RenderError, at, tables, write, yaml};
use crate::camera::Truth;
use crate::png_file;
use crate::scene::surface::Class;
use crate::simulation::{Pictures, Simulation};

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
    let mut folders = EYES.to_vec();
    if job.truth {
        sensor(
            "depth0",
            &yaml::truth(
                &camera.name,
                "depth",
                "mm along the optical axis, 0 for none or more than 65535",
            ),
        )?;
        sensor("class0", &yaml::truth(&camera.name, "class", &classes()))?;
        folders.extend(["depth0", "class0"]);
    }
    for name in &folders {
        let data = root.join(name).join("data");
        fs::create_dir(&data).map_err(at(&data))?;
    }

    let mut list = PICTURES.to_owned();
    let faults = job.faults.of(&camera.name);
    let mut pictures = simulation.pictures(number).with_faults(faults);
    while let Some(frame) = pictures.next() {
        let name = format!("{}.png", frame.time_ns);
        let size = [frame.width / 2, frame.height];
        for (k, eye) in EYES.into_iter().enumerate() {
            let path = root.join(eye).join("data").join(&name);
            png_file::grey8(&path, size, &frame.grey(k)).map_err(at(&path))?;
        }
        if job.truth {
            save_truth(&mut pictures, frame.time_ns, &root, &name, size)?;
        }
        // Writing to a string does not fail.
        let _ = writeln!(list, "{},{name}", frame.time_ns);
        done();
    }
    for name in &folders {
        write(&root.join(name).join("data.csv"), &list)?;
    }
    Ok(())
}

fn save_truth(
    pictures: &mut Pictures,
    time_ns: i64,
    root: &Path,
    name: &str,
    size: [usize; 2],
) -> Result<(), RenderError> {
    let Truth { depth, class, .. } = pictures.truth(0, time_ns);
    let path = root.join("depth0/data").join(name);
    png_file::grey16(&path, size, depth.into_iter().map(millimetres)).map_err(at(&path))?;
    let path = root.join("class0/data").join(name);
    let classes: Vec<u8> = class.into_iter().map(|class| class as u8).collect();
    png_file::grey8(&path, size, &classes).map_err(at(&path))
}

/// 0 where there is nothing, or nothing as near as the format can say.
fn millimetres(depth_m: f32) -> u16 {
    let mm = (f64::from(depth_m) * 1000.0).round();
    match (1.0..=65_535.0).contains(&mm) {
        true => mm as u16,
        false => 0,
    }
}

/// `0 sky, 1 pavement, …`
fn classes() -> String {
    let names = Class::ALL.map(|class| format!("{} {}", class as u8, class.name()));
    names.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_that_cannot_be_said_is_none() {
        let cases = [
            (1.2345, 1235),
            (0.0004, 0),
            (65.535, 65_535),
            (65.536, 0),
            (f32::INFINITY, 0),
            (f32::NAN, 0),
            (-1.0, 0),
        ];
        for (depth_m, expected) in cases {
            assert_eq!(millimetres(depth_m), expected, "{depth_m}");
        }
    }
}
