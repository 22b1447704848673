//! `paws calib imu`: noise of a session's IMUs.

use anyhow::Result;
use clap::Args;

use crate::calibrate::{Output, imu_samples};
use crate::console::Console;
use crate::outcome::Outcome;
use crate::target::Target;
use crate::validate::open;

/// How to do it.
#[derive(Clone, Debug, Default, Args)]
pub struct Options {
    /// Only this IMU, as in `feet/imu`
    #[arg(long, value_name = "NAME")]
    pub imu: Option<String>,
}

/// Says how much of each IMU there is.
///
/// # Errors
/// The session cannot be read.
pub fn run(
    target: &Target,
    options: &Options,
    output: &Output,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let reader = open(&target.folder)?;
    let _ = output.folder(target)?;
    let read = {
        let progress = console.progress("reading", reader.bytes()?);
        let wanted = |name: &str| options.imu.as_deref().is_none_or(|imu| imu == name);
        imu_samples::read(&reader, wanted, |bytes| progress.add(bytes))?
    };
    for imu in &read.imus {
        console.line(format!("{}: {} samples", imu.name, imu.samples.len()))?;
    }
    Ok(Outcome::Fine)
}
