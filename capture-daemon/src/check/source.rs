//! Whether a camera's source can be opened, and what it delivers.

use std::path::Path;

use cad_transforms::rig::Rig;
use session_archive::time::HostTime;

use super::device;
use super::report::Report;
use crate::config::{Camera, SourceConfig};
use crate::error_chain::with_causes;
use crate::sources::bag::{Bag, BagError};
use crate::sources::datasets::DatasetError;
use crate::sources::device::Device;
use crate::sources::gstreamer::Gstreamer;
use crate::sources::replay::{Replay, ReplayError};
#[cfg(feature = "simulator")]
use crate::sources::simulated::SimulatedCamera;
use crate::sources::synthetic::Synthetic;
use crate::sources::video_file::VideoReplay;
use crate::sources::walks::Walks;
use crate::sources::{Live, Source, SourceInfo};

/// What is known of a source that can be opened.
struct SourceSummary {
    info: SourceInfo,
    /// Whether a calibration comes with it, or why it is not for its images.
    calibration: Result<bool, String>,
    notes: Vec<String>,
}

impl SourceSummary {
    fn of(source: &dyn Source) -> Self {
        Self {
            info: source.info().clone(),
            calibration: (source.calibration())
                .map(|calibration| calibration.is_some())
                .map_err(|error| with_causes(error)),
            notes: Vec::new(),
        }
    }

    fn of_live(source: &dyn Live) -> Self {
        Self {
            info: source.info().clone(),
            calibration: Ok(false),
            notes: Vec::new(),
        }
    }

    fn with_notes(self, notes: &[String]) -> Self {
        Self {
            notes: notes.to_vec(),
            ..self
        }
    }
}

/// Description of a source, if it can be opened.
pub(super) fn source(
    camera: &Camera,
    rig: Option<&Rig>,
    walks: &mut Walks,
    report: &mut Report,
) -> Option<SourceInfo> {
    let SourceSummary {
        info,
        calibration: own_calibration,
        mut notes,
    } = open(camera, rig, walks, report)?;
    let of = &info.camera;
    let imu = info.imu.as_ref().map_or("no IMU".to_owned(), |imu| {
        format!("IMU at {:.1} Hz", imu.rate_hz)
    });
    report.ok(format!(
        "{}: {}x{} at {:.1} Hz, {imu}",
        info.description, of.width, of.height, of.rate_hz
    ));

    match (&camera.calibration, own_calibration) {
        (Some(path), _) => {
            // A configured file replaces the one of the data set.
            notes.retain(|note| !note.contains("calibration"));
            calibration(path, of.width / 2, of.height, report);
        }
        (None, Err(error)) => report.error(error),
        (None, Ok(true)) => report.ok("the calibration comes with the source"),
        _ if matches!(camera.source, SourceConfig::Synthetic(_)) => report
            .warning("a synthetic camera has no lenses: what it records cannot be reconstructed"),
        _ => report.warning(format!(
            "its intrinsics are not known: {}",
            command_line::remedy::before_recording(&camera.name)
        )),
    }
    for note in notes {
        report.warning(note);
    }
    Some(info)
}

#[cfg_attr(
    not(feature = "simulator"),
    expect(
        unused_variables,
        reason = "only simulated cameras share walks and need the rig"
    )
)]
fn open(
    camera: &Camera,
    rig: Option<&Rig>,
    walks: &mut Walks,
    report: &mut Report,
) -> Option<SourceSummary> {
    let start = HostTime(0);
    let opened = match &camera.source {
        SourceConfig::Replay(r) => {
            match Replay::open_head(&camera.name, &r.path, r.rate_hz, r.repeat, r.imu) {
                Err(error @ ReplayError::Dataset(DatasetError::Head { .. })) => {
                    report.warning(with_causes(&error));
                    return None;
                }
                replay => {
                    let replay = usable(replay, report)?;
                    heads(replay.is_head(), report);
                    SourceSummary::of(&replay).with_notes(replay.notes())
                }
            }
        }
        SourceConfig::Bag(b) => match Bag::open_head(&camera.name, b) {
            Err(error @ BagError::Head { .. }) => {
                report.warning(with_causes(&error));
                return None;
            }
            bag => {
                let bag = usable(bag, report)?;
                heads(bag.is_head(), report);
                SourceSummary::of(&bag).with_notes(bag.notes())
            }
        },
        SourceConfig::Video(v) => {
            SourceSummary::of(&usable(VideoReplay::open(&camera.name, v, start), report)?)
        }
        #[cfg(feature = "simulator")]
        SourceConfig::Simulated(s) => {
            let faults = s.faults.as_deref();
            let simulated = SimulatedCamera::open(&camera.name, &s.walk, faults, rig, walks, start);
            SourceSummary::of(&usable(simulated, report)?)
        }
        SourceConfig::Synthetic(s) => {
            let synthetic = Synthetic::new(
                &camera.name,
                s.width,
                s.height,
                s.rate_hz,
                s.imu_rate_hz,
                s.seed,
                start,
            );
            SourceSummary::of(&usable(synthetic, report)?)
        }
        SourceConfig::V4l2(config) => {
            for (level, message) in device::inspect(config) {
                report.add(level, message);
            }
            SourceSummary::of_live(&Device::new(config))
        }
        SourceConfig::Gstreamer(config) => {
            let camera = Gstreamer::new(config);
            usable(camera.check(), report)?;
            SourceSummary::of_live(&camera)
        }
    };
    Some(opened)
}

/// The value, or a reported error.
fn usable<T, E: std::error::Error>(result: Result<T, E>, report: &mut Report) -> Option<T> {
    result
        .map_err(|error| report.error(with_causes(&error)))
        .ok()
}

/// Notes that only the beginning of the source's files was read.
fn heads(are_heads: bool, report: &mut Report) {
    if are_heads {
        report.ok(
            "the first 1 MiB of each of its files was looked at; a recording reads all of them",
        );
    }
}

/// `width` and `height` are the size of one eye's image.
fn calibration(path: &Path, width: u32, height: u32, report: &mut Report) {
    match calibration_files::read_stereo(path, width, height) {
        Err(error) => report.error(with_causes(&error)),
        Ok((stereo, notes)) => {
            let baseline_mm = 1000.0 * stereo.baseline_m();
            report.ok(format!(
                "calibrated, baseline {baseline_mm:.1} mm: {}",
                path.display()
            ));
            for note in notes {
                report.warning(note.0);
            }
        }
    }
}
