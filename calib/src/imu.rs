//! `paws calib imu`: the noise of a session's IMUs, from a recording at rest.
//!
//! Each IMU gives a table per axis, Kalibr's `imu.yaml` as `NAME-noise.yaml`, two plots, and a
//! section of `imu-noise.json` and `imu-noise.html`. An IMU that moved, or was not recorded for
//! long enough, has no YAML file, and the exit code is 1; what the recording does not determine is
//! reported and never filled in. Damage on disk ends with 3.

mod document;
mod page;
mod plots;
mod result;
mod table;

use anyhow::{Result, ensure};
use calib::imu_noise::{BridgingConfig, Config, Series, Severity, measure};
use clap::Args;
use console_output::{Console, Outcome, text};
use session_access::{SessionFolder, open};
use session_input::imu::recording::{self, ImuRecording};

use self::result::{DOCUMENT, ImuResult, files_of};
use crate::results::Output;

/// The report.
pub(crate) const PAGE: &str = "imu-noise.html";

/// Options of `paws calib imu`.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct Options {
    /// Only this IMU, as in `feet/imu`
    #[arg(long, value_name = "NAME")]
    pub(crate) imu: Option<String>,
}

/// Measures the noise of the IMUs of a session.
///
/// # Errors
/// The session cannot be read or has no such IMU, an output file exists already, or it cannot be
/// written.
pub(crate) fn run(
    session: &SessionFolder,
    options: &Options,
    output: &Output,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let reader = open(&session.folder)?;
    let names: Vec<&str> = reader
        .manifest()
        .imus
        .iter()
        .map(|i| i.name.as_str())
        .collect();
    let selected = |name: &str| options.imu.as_deref().is_none_or(|imu| imu == name);
    ensure!(
        names.iter().any(|name| selected(name)),
        "looking for the IMU {:?}: the session has {}: {}",
        options.imu.as_deref().unwrap_or("any"),
        if names.is_empty() {
            "none".to_owned()
        } else {
            names.join(", ")
        },
        session.folder.display()
    );
    let mut possible_files = vec![DOCUMENT.to_owned(), PAGE.to_owned()];
    possible_files.extend(
        names
            .iter()
            .filter(|n| selected(n))
            .flat_map(|n| files_of(n)),
    );
    let results = output.prepare(output.folder(session)?, possible_files)?;
    let read = {
        let progress = console.progress("reading", reader.bytes()?);
        recording::read(&reader, selected, |bytes| progress.add(bytes))?
    };
    let mut all = Vec::new();
    {
        // Progress counts bytes of values.
        let size = |imu: &ImuRecording| 48 * imu.samples.len() as u64;
        let config = Config::default();
        let progress = console.progress("measuring", read.imus.iter().map(size).sum());
        for recording in read.imus {
            let bytes = size(&recording);
            let found = measure(&series(&recording, &config.bridging), &config);
            progress.add(bytes);
            all.push(ImuResult { recording, found });
        }
    }
    let manifest = reader.manifest();
    let mut files = vec![
        (DOCUMENT.to_owned(), document::json(manifest, &all)?),
        (PAGE.to_owned(), page::html(manifest, &all).into_bytes()),
    ];
    for imu in &all {
        if imu.found.is_rejected() {
            continue;
        }
        let [noise, gyro, accel] = imu.files();
        let yaml = imu.found.kalibr_yaml(
            &format!("/{}", imu.recording.name),
            &document::origin(manifest, imu),
        );
        files.push((noise, yaml.into_bytes()));
        for (sensor, name) in [gyro, accel].into_iter().enumerate() {
            files.push((name, plots::sensor(imu, sensor).into_bytes()));
        }
    }
    for imu in &all {
        print(imu, console)?;
    }
    results.write(&files, console)?;
    let refused = all.iter().any(|imu| imu.found.is_rejected());
    if read.damaged > 0 {
        let damaged = text::count(read.damaged, "damaged place");
        console.line(format!("{damaged} of the session left out"))?;
    }
    Ok(match (refused, read.damaged) {
        (true, _) => Outcome::Failed,
        (false, 0) => Outcome::Fine,
        (false, _) => Outcome::Loss,
    })
}

/// Input of the estimator. Times are of the sensor's clock if that is monotonic, else of the
/// host's.
fn series(imu: &ImuRecording, config: &BridgingConfig) -> Series {
    let samples = &imu.samples;
    let runs = imu.continuous_runs();
    let forward = runs.iter().all(|run| {
        let pairs = samples[run.clone()].windows(2);
        pairs.into_iter().all(|w| w[1].ticks > w[0].ticks)
    });
    let first = samples.first();
    let times = samples.iter().map(|s| {
        let first = first.unwrap_or(s);
        let ticks = s.ticks.checked_sub(first.ticks);
        let own = ticks.filter(|_| forward).and_then(|d| imu.tick.ns(d));
        own.unwrap_or(s.time_ns.saturating_sub(first.time_ns)) as f64 * 1e-9
    });
    let axis = |k: usize| {
        let values = samples.iter().map(|s| {
            if k < 3 {
                s.gyro_rad_s[k]
            } else {
                s.accel_m_s2[k - 3]
            }
        });
        values.collect()
    };
    let temperatures = samples.iter().map(|s| s.temperature_c.unwrap_or(f32::NAN));
    let known = samples.iter().any(|s| s.temperature_c.is_some());
    Series {
        nominal_rate_hz: imu.rate_hz,
        times_s: times.collect(),
        axes: [0, 1, 2, 3, 4, 5].map(axis),
        temperature_c: if known {
            temperatures.collect()
        } else {
            Vec::new()
        },
        runs,
        ..Series::default()
    }
    .bridged(config)
}

/// Prints the table and the remarks of one IMU.
fn print(imu: &ImuResult, console: &mut Console<'_>) -> Result<()> {
    let found = &imu.found;
    console.line(format!("{}: {}", imu.recording.name, table::summary(imu)))?;
    for remark in &found.findings {
        let word = match remark.severity {
            Severity::Note => "note",
            Severity::Warn => "WARN",
            Severity::Fail => "REFUSED",
        };
        console.line(format!("  {word}  {}: {}", remark.kind, remark.text))?;
    }
    for line in table::lines(found) {
        console.line(format!("  {line}"))?;
    }
    Ok(())
}
