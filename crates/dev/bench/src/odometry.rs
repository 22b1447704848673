//! `odometry`: pose errors and cost.
//!
//! 1. `kitti`: 30 stereo pairs of a drive, without IMU: drift at the end.
//! 2. `euroc`: a second of standing still with an IMU: biases, gravity direction, creep of the
//!    pose.
//! 3. `walks`: ten simulated walks of 100 to 300 m (`harness::sequences::named::ODOMETRY_EXAM`) in
//!    `balanced`. Causal and refined poses are in separate tables; each row has error, time per
//!    stereo pair, peak memory and completion, and the worst run is named.
//! 4. `presets`: the same walks in `fast` and `accurate`.
//! 5. `settings`: presets, and features, keyframes and iterations one at a time, on the first 40 s
//!    of four of the walks.
//! 6. `cameras`: one, two and three stereo cameras, with and without IMU, on the first 60 s of six,
//!    one in each scene.
//! 7. `mounts`: a camera with a calibration error of up to 4 degrees, on the first 40 s of two.
//!
//! Each run is a process of its own with two threads, so that its peak memory is its own; memory in
//! use before odometry starts (mostly the simulated world) is subtracted. Reading images is not
//! timed. Runs with bundle adjustment are run twice, once without storing keyframes: both must give
//! the same poses to the bit, and the shorter time counts. Processor time is given beside wall
//! time, since it depends less on the load; the machine's load is in each row.
//!
//! Images of walks are rendered once, at the quality for tests, into the folder that `PAWS_WALKS`
//! or `--walks` names (default `target/walks`; 2.5 GB each). Results are merged into what the
//! output folder holds: a run replaces the one of the same walk and settings, so that parts can be
//! run separately.

use anyhow::Result;

pub(crate) mod calibration;
mod charts;
pub(crate) mod encoding;
pub(crate) mod faults;
mod figures;
pub(crate) mod length;
pub(crate) mod monte_carlo;
mod options;
mod plain;
mod real;
pub(crate) mod results;
pub(crate) mod run;
pub(crate) mod scale;
mod settings;
mod stereo_deviation;
mod sweeps;
mod table;
mod test_walks;

use crate::stamp;
use options::Options;
use results::Results;

/// The parts, in order.
const PARTS: [&str; 7] = [
    "kitti", "euroc", "walks", "presets", "settings", "cameras", "mounts",
];

/// Runs the benchmark: `[--quick] [--only PART,...] [--name WALK,...] [--walks DIR] [--out DIR]`.
///
/// # Errors
/// Bad arguments, images that cannot be read, an I/O error, or runs that differ. A missed target is
/// a result and no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    if let Some(answer) = run::answer(args) {
        return answer;
    }
    let options = Options::parse(args, &PARTS)?;
    let mut results = Results::read(&options.out)?;
    results.stamp = stamp::stamp("odometry", args)?;
    for part in &options.parts {
        match part.as_str() {
            "kitti" => {
                if let Some(found) = real::kitti()? {
                    results.kitti = Some(found);
                    (results.sources).insert(part.clone(), stamp::source(&results.stamp));
                }
            }
            "euroc" => {
                if let Some(found) = real::euroc()? {
                    results.euroc = Some(found);
                    (results.sources).insert(part.clone(), stamp::source(&results.stamp));
                }
            }
            "walks" => test_walks::walks(&options, &["balanced"], &mut results)?,
            "presets" => test_walks::walks(&options, &["fast", "accurate"], &mut results)?,
            "settings" => sweeps::settings(&options, &mut results)?,
            "mounts" => sweeps::mounts(&options, &mut results)?,
            _ => sweeps::cameras(&options, &mut results)?,
        }
        // Results so far are kept if a later part fails.
        results.write(&options.out)?;
    }
    Ok(())
}
