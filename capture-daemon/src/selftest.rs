//! `pawsd selftest`: all first checks of new hardware, in one report to send back.
//!
//! Contract: inspects the machine, the connected devices and the configuration, then makes one
//! short recording and checks every byte of it. A failed step is reported, and the next one is run.
//! The recording is retained only if something is wrong with it. The report is plain text, to be
//! read by people and sent by mail.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use machine::{Roots, battery, clock, thermal};
use session_archive::reader::{Entry, SessionReader};
use session_archive::record::{Health, Record as _};
use session_archive::storage::DiskStorage;
use session_archive::verify::verify;

use crate::check::{Level, check};
use crate::config::Config;
use crate::devices;
use crate::error_chain::with_causes;
use crate::run::{self, RecordOptions, StopFlag};

/// Result of the self test.
#[derive(Clone, Debug)]
pub struct Report {
    /// The whole report.
    pub text: String,
    /// Failures, one line each; empty if there are none.
    pub failures: Vec<String>,
}

/// Runs all steps. Sessions are created in `folder`, with a length of `seconds`.
pub fn run(config: &Config, folder: &Path, seconds: f64, stop: &StopFlag) -> Report {
    let mut report = Writer::default();
    report.part("Machine");
    machine(&mut report);
    report.part("Devices");
    let inventory = devices::inventory();
    report.lines(&inventory.to_string());
    for camera in &inventory.cameras {
        for problem in &camera.problems {
            report.failures.push(format!("{}: {problem}", camera.path));
        }
    }
    report.part("HID devices of ZED cameras");
    for imu in &inventory.imus {
        report.line(&descriptor(&imu.path));
    }
    report.part("Encoders");
    for element in video::encoder::known_elements() {
        let trial = video::discover::trial(element, 1344, 376);
        report.line(&match trial {
            Ok(trial) => format!("{element}: {:.0} frames/s", trial.frames_per_s),
            Err(reason) => format!("{element}: {reason}"),
        });
    }
    report.part("Configuration");
    for finding in check(config) {
        report.line(&finding.to_string());
        if finding.level == Level::Error {
            report.failures.push(finding.to_string());
        }
    }
    report.part(&format!("Recording of {seconds} s"));
    record(config, folder, seconds, stop, &mut report);
    report.part("Result");
    if report.failures.is_empty() {
        report.line("everything that was tried works");
    }
    for failure in report.failures.clone() {
        report.line(&format!("FAILED {failure}"));
    }
    Report {
        text: report.text,
        failures: report.failures,
    }
}

#[derive(Default)]
struct Writer {
    text: String,
    failures: Vec<String>,
}

impl Writer {
    fn part(&mut self, title: &str) {
        let _ = write!(self.text, "\n== {title}\n\n");
    }

    fn line(&mut self, line: &str) {
        self.text.push_str(line);
        self.text.push('\n');
    }

    fn lines(&mut self, text: &str) {
        text.lines().for_each(|line| self.line(line));
    }

    fn fail(&mut self, what: String) {
        self.line(&format!("! {what}"));
        self.failures.push(what);
    }
}

fn machine(report: &mut Writer) {
    let read = |path: &str| fs::read_to_string(path).unwrap_or_default();
    report.line(read("/proc/version").trim());
    report.line(&format!(
        "pawsd {}, {}",
        env!("CARGO_PKG_VERSION"),
        video::version()
    ));
    // The model of a Jetson ends with a zero byte.
    let model = read("/proc/device-tree/model");
    let name = read("/etc/os-release");
    let name = name.lines().find_map(|l| l.strip_prefix("PRETTY_NAME="));
    for line in [
        model.trim_end_matches('\0'),
        name.unwrap_or_default(),
        read("/etc/nv_tegra_release").trim(),
    ] {
        if !line.is_empty() {
            report.line(line);
        }
    }
    let roots = Roots::default();
    let heat = thermal::Thermometer::new().judge(&thermal::Readings::read(&roots));
    let power = battery::judge(&battery::Readings::read(&roots), None);
    for line in [
        serde_json::to_string(&heat),
        serde_json::to_string(&power),
        serde_json::to_string(&clock::read()),
        serde_json::to_string(&clock::discipline(&roots)),
    ]
    .into_iter()
    .flatten()
    {
        report.line(&line);
    }
}

/// Report descriptor of a HID device, because no descriptor of a real ZED Mini is published.
fn descriptor(node: &str) -> String {
    let name = Path::new(node).file_name().unwrap_or_default();
    let path = Path::new("/sys/class/hidraw")
        .join(name)
        .join("device/report_descriptor");
    match fs::read(&path) {
        Ok(bytes) => {
            let bytes: Vec<String> = bytes.iter().map(|b| format!("{b:02x}")).collect();
            format!("{node}: {}", bytes.join(" "))
        }
        Err(error) => format!("{node}: {error}: {}", path.display()),
    }
}

fn record(config: &Config, folder: &Path, seconds: f64, stop: &StopFlag, report: &mut Writer) {
    let options = RecordOptions {
        seconds,
        virtual_time: false,
        name: "selftest".to_owned(),
        out: folder.to_owned(),
    };
    let finished = match run::record(config, &options, stop, Box::new(|_| {})) {
        Ok(finished) => finished,
        Err(error) => return report.fail(format!("no recording: {error:#}")),
    };
    let before = report.failures.len();
    report.line(&format!(
        "{} samples stored, {} missing",
        finished.stored, finished.missing
    ));
    if let Some(error) = &finished.error {
        report.fail(error.clone());
    }
    for stream in &finished.absent {
        report.fail(format!("{stream} delivered nothing"));
    }
    if finished.missing > 0 {
        report.fail(format!("{} samples are missing", finished.missing));
    }
    let storage = Arc::new(DiskStorage::new(finished.session.clone()));
    match SessionReader::open(storage) {
        Err(error) => report.fail(with_causes(&error)),
        Ok(reader) => examine(config, &reader, seconds, report),
    }
    if report.failures.len() > before {
        report.line(&format!(
            "the recording is retained: {}",
            finished.session.display()
        ));
    } else if let Err(error) = fs::remove_dir_all(&finished.session) {
        report.line(&format!(
            "it could not be deleted: {error}: {}",
            finished.session.display()
        ));
    }
}

fn examine(config: &Config, reader: &SessionReader, seconds: f64, report: &mut Writer) {
    match verify(reader, |_| {}) {
        Err(error) => report.fail(with_causes(&error)),
        Ok(found) if !found.is_sound() => report.fail("the session is not sound".to_owned()),
        Ok(found) => {
            for camera in &config.cameras {
                let count = |name: &str| found.streams.get(name).map_or(0, |s| s.samples);
                let (frames, samples) =
                    (count(&camera.name), count(&format!("{}/imu", camera.name)));
                report.line(&format!(
                    "{}: {:.1} frames/s, {:.1} IMU samples/s",
                    camera.name,
                    frames as f64 / seconds,
                    samples as f64 / seconds
                ));
            }
        }
    }
    let mut newest: Option<Health> = None;
    for entry in reader.entries().flatten() {
        if let Entry::Message(message) = entry
            && is_health(reader, message.stream)
            && let Ok(health) = message.decode()
        {
            newest = Some(health);
        }
    }
    for stream in newest.into_iter().flat_map(|h| h.streams) {
        if let Some(sync) = stream.frame_sync {
            report.line(&format!(
                "{}: tied to its camera by {} frames, {} us later than it, sigma {} us, residuals {} us (p99 {} us)",
                stream.name,
                sync.pairs,
                sync.offset_ns / 1000,
                sync.sigma_ns / 1000,
                sync.residual_median_ns / 1000,
                sync.residual_p99_ns / 1000
            ));
        }
    }
}

fn is_health(reader: &SessionReader, stream: u16) -> bool {
    reader
        .stream(stream)
        .is_some_and(|stream| stream.schema == Health::SCHEMA.name)
}
