//! `cargo xtask bench NAME`: runs a benchmark in release mode and gives every chart it drew a PNG
//! beside the SVG, for places that show no SVG.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::{Context, Result};

use crate::process::{self, cargo, command, root};
use crate::setup::{self, Purpose};
use crate::test::python;

/// Benchmarks beside OpenCV.
const WITH_OPENCV: [&str; 5] = ["calib", "depth", "odometry", "rectify", "sim_pictures"];

/// Runs the benchmarks one after the other. The first that fails ends the run, after its charts
/// and those of the ones before it have been converted into PNG.
pub(crate) fn run(install: bool, names: &[&str], arguments: &[OsString]) -> Result<()> {
    let mut purposes = vec![Purpose::Build, Purpose::Video, Purpose::Pictures];
    let needs_python = names.iter().any(|name| WITH_OPENCV.contains(name));
    if needs_python {
        purposes.push(Purpose::Interoperability);
    }
    if names.contains(&"power_cuts") || names.contains(&"vm_cost") {
        purposes.push(Purpose::Machines);
    }
    setup::system_packages(&purposes, install)?;
    let python = match needs_python {
        true => Some(python::interpreter()?),
        false => None,
    };
    let folder = root()?.join("docs/benchmarks");
    for name in names {
        let before = charts(&folder)?;
        let mut command = cargo()?;
        command
            .args(["run", "--release", "--locked", "--package", "bench", "--"])
            .arg(name)
            .args(arguments);
        if let Some(data) = process::data_folder()? {
            command.env("PAWS_DATA", data);
        }
        if let Some(python) = &python {
            command.env("PAWS_PYTHON", python);
        }
        println!("\n== bench {name}");
        let result = process::run(&mut command);
        for (chart, changed) in charts(&folder)? {
            if before.get(&chart) != Some(&changed) {
                to_png(&chart)?;
            }
        }
        result?;
    }
    Ok(())
}

/// The SVG files in the folder with the time of their last change; none where there is no folder.
fn charts(folder: &Path) -> Result<BTreeMap<PathBuf, SystemTime>> {
    let mut found = BTreeMap::new();
    if !folder.exists() {
        return Ok(found);
    }
    let reading = || format!("reading the folder of the charts {}", folder.display());
    for entry in std::fs::read_dir(folder).with_context(reading)? {
        let entry = entry.with_context(reading)?;
        let path = entry.path();
        if path.extension().is_some_and(|extension| extension == "svg") {
            let changed = entry.metadata().and_then(|data| data.modified());
            found.insert(path, changed.with_context(reading)?);
        }
    }
    Ok(found)
}

fn to_png(chart: &Path) -> Result<()> {
    let picture = chart.with_extension("png");
    let mut convert = command("rsvg-convert")?;
    convert.arg("--output").arg(&picture).arg(chart);
    process::run(&mut convert)
        .with_context(|| format!("turning a chart into PNG {}", chart.display()))?;
    println!("image: {}", picture.display());
    Ok(())
}
