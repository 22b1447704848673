//! Checks of a configuration against the machine, for `pawsd check`.
//!
//! Contract: inspects everything and stops at nothing, so that one run reports all problems. It
//! finds whatever would keep a recording from starting here and now, for the user who runs it:
//! folder and space, socket, page with its address and token, rig, absent cameras, encoders. It
//! records nothing and leaves nothing behind, but it occupies the encoders for some seconds, which
//! would disturb a simultaneous recording. Of bags, lists and text files it reads at most 1 MiB
//! each, of images the header; only GStreamer reads of a video file what it needs for two images.
//! Each part is announced before it begins (see [`crate::announce`]).

use std::collections::BTreeMap;
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::UnixStream;
use std::path::Path;

use cad_transforms::rig::Rig;

use crate::announce::step;
use crate::config::{Config, DEFAULT_SOCKET};
use crate::disk;
use crate::error_chain::with_causes;
use crate::run::choose_encoder;
use crate::sources::SourceInfo;
use crate::sources::walks::Walks;

mod device;
mod folder;
mod page;
mod report;
mod source;

pub use self::report::{Finding, Level};

use self::folder::writable;
use self::report::Report;
use self::source::source;

/// Checks everything that `config` needs from this machine.
pub fn check(config: &Config) -> Vec<Finding> {
    let mut report = Report::default();
    step("checking folder, space, socket and page");
    out(config, &mut report);
    let daemon_answers = socket(config, &mut report);
    page::check(config, daemon_answers, &mut report);
    rig(config, &mut report);
    triggers(config, &mut report);
    let mut cameras = Vec::new();
    // Problems of the file were reported above.
    let rig = config.rig.as_deref().and_then(|path| Rig::read(path).ok());
    let mut walks = Walks::default();
    for camera in &config.cameras {
        step(format_args!("checking camera {}", camera.name));
        report.about = format!("camera {}", camera.name);
        cameras.extend(source(camera, rig.as_ref(), &mut walks, &mut report));
    }
    report.findings.extend(usb_budget(config));
    report.about = "encoder".to_owned();
    step("trying encoders, which takes some seconds");
    encoders(config, &cameras, &mut report);
    report.findings
}

/// Whether the cameras of a configuration, as far as they are connected, fit on their USB
/// controllers.
pub fn usb_budget(config: &Config) -> Vec<Finding> {
    let findings = device::usb_budget(config).into_iter();
    findings
        .map(|(level, message)| Finding {
            level,
            about: "usb".to_owned(),
            message,
        })
        .collect()
}

fn out(config: &Config, report: &mut Report) {
    report.about = "session".to_owned();
    let Some(out) = &config.session.out else {
        report.warning("out is not set; `pawsd run` needs it, `pawsd record` takes --out");
        return;
    };
    // An absent folder is created by the first recording.
    let Some(folder) = out.ancestors().find(|folder| folder.exists()) else {
        report.error(format!("no parent folder exists: {}", out.display()));
        return;
    };
    match writable(folder) {
        Err(error) => report.error(format!(
            "sessions cannot be written: {error}: {}",
            folder.display()
        )),
        Ok(()) if folder == out => report.ok(format!("sessions go to {}", out.display())),
        Ok(()) => report.ok(format!(
            "sessions go to {}, which will be created",
            out.display()
        )),
    }

    report.about = "disk".to_owned();
    let reserve = config.disk.reserve_bytes;
    let gb = |bytes: u64| format!("{:.1} GB", bytes as f64 / 1e9);
    match disk::free_bytes(folder) {
        Err(error) => report.error(format!(
            "reading the free space: {error}: {}",
            folder.display()
        )),
        Ok(free) if free < reserve.saturating_add(disk::START_MARGIN_BYTES) => {
            report.error(format!(
                "{} free, expected at least {}: the reserve of {} and room to begin: {}",
                gb(free),
                gb(reserve.saturating_add(disk::START_MARGIN_BYTES)),
                gb(reserve),
                folder.display()
            ))
        }
        Ok(free) if free < reserve.saturating_mul(2) => {
            report.warning(format!(
                "only {} free, a recording ends at {}: {}",
                gb(free),
                gb(reserve),
                folder.display()
            ));
        }
        Ok(free) => report.ok(format!(
            "{} free, a recording ends at {}",
            gb(free),
            gb(reserve)
        )),
    }
}

/// Returns whether a daemon answers at the socket.
fn socket(config: &Config, report: &mut Report) -> bool {
    report.about = "control".to_owned();
    let socket = &config.control.socket;
    let folder = socket.parent().unwrap_or(Path::new("/"));
    let answers = UnixStream::connect(socket).is_ok();
    let kind = std::fs::symlink_metadata(socket).map(|data| data.file_type());
    if answers {
        report.warning(format!("a daemon answers already: {}", socket.display()));
    } else if kind.is_ok_and(|kind| !kind.is_socket()) {
        report.error(format!(
            "a file that is not a socket exists at its path; remove it, or configure another path: {}",
            socket.display()
        ));
    } else if socket == Path::new(DEFAULT_SOCKET) && !folder.exists() {
        // systemd creates this folder when it starts the daemon, and `pawsd record` does not need
        // it.
        report.warning(format!(
            "only the service makes the folder of its socket; `pawsd run` by hand needs [control] socket elsewhere: {}",
            folder.display()
        ));
    } else if let Err(error) = writable(folder) {
        report.error(format!(
            "`pawsd run` could not make its socket: {error}; name another place in [control]: {}",
            folder.display()
        ));
    } else {
        report.ok(format!("the socket will be {}", socket.display()));
    }
    answers
}

fn rig(config: &Config, report: &mut Report) {
    report.about = "rig".to_owned();
    let Some(path) = &config.rig else {
        report.warning(format!(
            "no rig file: sessions will not tell how the cameras are placed; `{}` makes one of boards alone: \
             file = \"calibration/rig.toml\" in [rig]",
            command_line::remedy::CALIBRATE
        ));
        return;
    };
    match Rig::read(path) {
        Err(error) => report.error(with_causes(&error)),
        Ok(rig) => {
            let known = rig.cameras();
            report.ok(format!(
                "{:?} with {}: {}",
                rig.name(),
                known.join(", "),
                path.display()
            ));
            for camera in config
                .cameras
                .iter()
                .filter(|camera| !known.contains(&camera.name.as_str()))
            {
                report.warning(format!(
                    "{} is not in it: sessions will not tell how it is placed",
                    camera.name
                ));
            }
        }
    }
}

fn triggers(config: &Config, report: &mut Report) {
    report.about = "trigger".to_owned();
    let mut members: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for camera in &config.cameras {
        if let Some(trigger) = &camera.trigger {
            members.entry(trigger).or_default().push(&camera.name);
        }
    }
    for (trigger, cameras) in members {
        match cameras.as_slice() {
            [only] => report.warning(format!(
                "{trigger} has {only} alone; the cameras of one trigger name the same"
            )),
            several => report.ok(format!("{trigger} exposes {} together", several.join(", "))),
        }
    }
}

/// Selects the encoder of the cameras as a run does.
fn encoders(config: &Config, cameras: &[SourceInfo], report: &mut Report) {
    if cameras.is_empty() {
        return;
    }
    match choose_encoder(config, cameras.iter().map(|info| &info.camera)) {
        Err(reason) => report.error(format!("{reason:#}")),
        Ok(chosen) => report.ok(format!(
            "{chosen}, for {:.1} million pixels per second",
            1e-6 * chosen.pixels_per_s
        )),
    }
}

#[cfg(test)]
mod tests;
