//! `paws calib camera-imu`: where the IMU of each camera sits, and by how much its clock differs, from a
//! session before boards.
//!
//! Each camera that has an IMU, lenses and a board in its pictures ends as a table of what was told and what was
//! found, and as a part of `camera-imu.json` and `camera-imu.html`. What the rig file tells counts as a
//! loose measurement. Nothing is written into a rig file here. A camera whose gates fail, or that gives no
//! result, makes the exit code 1; damage on disk makes it 3.

mod document;
mod page;
mod sightings;
mod table;

use std::fs;
use std::path::PathBuf;
use std::thread;

use anyhow::{Context, Result, anyhow, bail, ensure};
use cad_transforms::RigidTransform;
use calib::camera_imu::simulate::ZED_NOISE;
use calib::camera_imu::{CameraImu, Cameras, ImuSample, Recording, Told, Verdict, estimate};
use calib::target::Target as Board;
use calib::{CameraModel, Distortion, ImuNoise};
use clap::Args;
use session_archive::index::Access;
use session_archive::reader::SessionReader;
use session_archive::record::CameraCalibration;
use session_archive::verify::rig_file;

use crate::calibrate::Output;
use crate::calibrate::imu_samples::{self, ImuRecording};
use crate::console::Console;
use crate::facts::Facts;
use crate::frames::Frames;
use crate::indexing::read_or_build;
use crate::outcome::Outcome;
use crate::target::Target;
use crate::text;
use crate::validate::open;

/// The JSON document.
pub const DOCUMENT: &str = "camera-imu.json";
/// The report.
pub const PAGE: &str = "camera-imu.html";

/// How to do it.
#[derive(Clone, Debug, Default, Args)]
pub struct Options {
    /// Only this camera
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// The board, TOML or Kalibr's YAML; again for more [default: rig/target.*.toml of the session]
    #[arg(long, value_name = "FILE")]
    pub board: Vec<PathBuf>,
    /// Noise of the IMU, Kalibr's imu.yaml [default: typical of such parts, then corrected by what is found]
    #[arg(long, value_name = "FILE")]
    pub noise: Option<PathBuf>,
    /// Rolling shutter: microseconds from each row to the next; again as CAMERA=US for cameras that differ
    #[arg(long, value_name = "[CAMERA=]US", value_parser = line_us)]
    pub line_us: Vec<(Option<String>, f64)>,
    /// Use every n-th picture
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub every: u64,
}

fn line_us(text: &str) -> Result<(Option<String>, f64)> {
    let (camera, number) = match text.split_once('=') {
        Some((camera, number)) => (Some(camera.to_owned()), number),
        None => (None, text),
    };
    let us: f64 = number
        .parse()
        .with_context(|| format!("found {number:?}, expected microseconds"))?;
    ensure!(us.is_finite(), "found {number:?}, expected microseconds");
    Ok((camera, us))
}

/// A camera, and what came out.
struct Measured {
    camera: String,
    /// As the session tells it.
    told: Option<RigidTransform>,
    /// Which board, and pictures that show enough of it.
    board: Option<usize>,
    noise: ImuNoise,
    line_s: f64,
    found: Result<CameraImu>,
}

/// Calibrates the cameras of a session.
///
/// # Errors
/// The session cannot be read or has no such camera, there is no board, a result is in the way, or it cannot be
/// written.
pub fn run(
    target: &Target,
    options: &Options,
    output: &Output,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    ensure!(options.every > 0, "--every 0: expected at least 1");
    let reader = open(&target.folder)?;
    let folder = output.folder(target)?;
    output.check(&folder, [DOCUMENT, PAGE])?;
    let boards = boards(&reader, options)?;
    let noise = match &options.noise {
        Some(path) => kalibr_noise(path)?,
        None => ZED_NOISE,
    };
    let manifest = reader.manifest();
    let wanted = |name: &str| options.camera.as_deref().is_none_or(|c| c == name);
    let names = || manifest.cameras.iter().map(|c| c.name.as_str());
    ensure!(
        names().any(wanted),
        "looking for the camera {:?}: the session has {}: {}",
        options.camera.as_deref().unwrap_or("any"),
        names().collect::<Vec<_>>().join(", "),
        target.folder.display()
    );
    let index = read_or_build(&reader, console)?;
    let access = Access::open(&**reader.storage(), &index).context("opening the segments")?;
    let facts = Facts::gather(&reader, |_| {})?;
    let frames = Frames::of(&facts.transforms.clone().unwrap_or_default());
    let samples = imu_samples::read(
        &reader,
        |name| name.strip_suffix("/imu").is_some_and(wanted),
        |_| (),
    )?;
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let mut outcome = Outcome::Fine;
    let mut all = Vec::new();
    for (camera, pictures) in manifest.cameras.iter().zip(&index.cameras) {
        if !wanted(&camera.name) {
            continue;
        }
        let name = &camera.name;
        let frame = |part: &str| format!("{name}/{part}");
        let told = frames.transform(&frame("imu"), &frame("left"));
        let mut measured = Measured {
            camera: name.clone(),
            told,
            board: None,
            noise,
            line_s: line_s(options, name),
            found: Err(anyhow!("not begun")),
        };
        let ready = || -> Result<(Cameras, &ImuRecording)> {
            let lens = |eye: &str| {
                let of = facts.calibrations.get(&frame(eye));
                let of =
                    of.with_context(|| format!("the session holds no lens of {name}/{eye}"))?;
                model(of).with_context(|| format!("reading the lens of {name}/{eye}"))
            };
            let right = match frames.transform(&frame("right"), &frame("left")) {
                Some(right_from_left) => Some((lens("right")?, right_from_left)),
                None => None,
            };
            let cameras = Cameras::new(&lens("left")?, right.as_ref().map(|(m, t)| (m, t)))
                .with_rolling_shutter(measured.line_s);
            let imu = samples.imus.iter().find(|i| i.name == frame("imu"));
            Ok((
                cameras,
                imu.with_context(|| format!("the session has no {name}/imu"))?,
            ))
        };
        measured.found = match ready() {
            Err(error) => Err(error),
            Ok((cameras, imu)) => {
                let bytes = pictures.frames.iter().map(|f| u64::from(f.bytes)).sum();
                let seen = {
                    let progress = console.progress(name, bytes);
                    sightings::find(
                        camera,
                        pictures,
                        &access,
                        &boards,
                        options.every,
                        threads,
                        &progress,
                    )?
                };
                if seen.missing > 0 {
                    outcome = outcome.max(Outcome::Loss);
                }
                measured.board = seen.board;
                let recording = Recording {
                    cameras,
                    pictures: seen.pictures,
                    imu: inertial(imu),
                    noise,
                    range: imu.count.map(|c| c.map_or(f64::INFINITY, |c| c * 32_767.0)),
                };
                let told = Told {
                    imu_from_left: told,
                    ..Told::default()
                };
                estimate(&recording, &told).map_err(anyhow::Error::from)
            }
        };
        table::print(&measured, console)?;
        all.push(measured);
    }
    let files = [
        (DOCUMENT.to_owned(), document::json(manifest, &all)?),
        (PAGE.to_owned(), page::html(manifest, &all).into_bytes()),
    ];
    output.write(&folder, &files)?;
    for (name, _) in &files {
        console.line(folder.join(name).display())?;
    }
    if samples.damaged > 0 {
        let places = text::count(samples.damaged, "damaged place");
        console.line(format!("{places} of the session left out"))?;
        outcome = outcome.max(Outcome::Loss);
    }
    let failed = |m: &Measured| match &m.found {
        Ok(found) => found.verdict() == Verdict::Fail,
        Err(_) => true,
    };
    if all.iter().any(failed) {
        outcome = Outcome::Failed;
    }
    Ok(outcome)
}

fn line_s(options: &Options, camera: &str) -> f64 {
    let own = |(name, _): &&(Option<String>, f64)| name.as_deref() == Some(camera);
    let all = |(name, _): &&(Option<String>, f64)| name.is_none();
    let lines = &options.line_us;
    let found = lines.iter().find(own).or_else(|| lines.iter().find(all));
    found.map_or(0.0, |(_, us)| us * 1e-6)
}

/// The boards that were named, else those of the session.
fn boards(reader: &SessionReader, options: &Options) -> Result<Vec<Board>> {
    let mut boards = Vec::new();
    for path in &options.board {
        boards.push(Board::read(path)?);
    }
    if !boards.is_empty() {
        return Ok(boards);
    }
    for file in &reader.manifest().rig {
        let is_board = file.name.starts_with("target.") && file.name.ends_with(".toml");
        if !is_board {
            continue;
        }
        let bytes = rig_file(&**reader.storage(), file)
            .with_context(|| format!("rig/{} is not there or not what it was", file.name))?;
        // The reader of boards takes files: its errors name them.
        let folder = std::env::temp_dir().join(format!("paws-board-{}", std::process::id()));
        fs::create_dir_all(&folder).with_context(|| format!("making {}", folder.display()))?;
        let path = folder.join(&file.name);
        fs::write(&path, bytes).with_context(|| format!("writing {}", path.display()))?;
        let board = Board::read(&path);
        let _ = fs::remove_dir_all(&folder);
        boards.push(board?);
    }
    if boards.is_empty() {
        bail!("the session names no board (rig/target.*.toml); --board must say which one it was");
    }
    Ok(boards)
}

/// In order of time; samples that share a time with one before are left out.
fn inertial(imu: &ImuRecording) -> Vec<ImuSample> {
    let mut last = i64::MIN;
    let mut out = Vec::with_capacity(imu.samples.len());
    for sample in &imu.samples {
        if sample.time <= last {
            continue;
        }
        last = sample.time;
        out.push(ImuSample {
            time_ns: sample.time,
            gyro: sample.gyro,
            accel: sample.accel,
        });
    }
    out
}

/// The lens of a record.
fn model(record: &CameraCalibration) -> Result<CameraModel> {
    let k = &record.k;
    ensure!(
        k.len() == 9,
        "found a camera matrix of {} numbers, expected 9",
        k.len()
    );
    let d = &record.d;
    let distortion = match (record.distortion_model.as_str(), d.len()) {
        ("", _) | (_, 0) => Distortion::None,
        ("plumb_bob", 5) => Distortion::RadTan5 {
            k1: d[0],
            k2: d[1],
            p1: d[2],
            p2: d[3],
            k3: d[4],
        },
        ("rational_polynomial", 8) => Distortion::Rational8 {
            k1: d[0],
            k2: d[1],
            p1: d[2],
            p2: d[3],
            k3: d[4],
            k4: d[5],
            k5: d[6],
            k6: d[7],
        },
        ("kannala_brandt", 4) => Distortion::KannalaBrandt4 {
            k1: d[0],
            k2: d[1],
            k3: d[2],
            k4: d[3],
        },
        ("double_sphere", 2) => Distortion::DoubleSphere {
            xi: d[0],
            alpha: d[1],
        },
        ("eucm", 2) => Distortion::Eucm {
            alpha: d[0],
            beta: d[1],
        },
        (model, count) => bail!(
            "found the distortion {model:?} with {count} numbers, expected plumb_bob 5, rational_polynomial 8, \
             kannala_brandt 4, double_sphere 2 or eucm 2"
        ),
    };
    Ok(CameraModel {
        width: record.width,
        height: record.height,
        fx: k[0],
        fy: k[4],
        cx: k[2],
        cy: k[5],
        distortion,
    })
}

/// The four numbers of Kalibr's `imu.yaml`.
fn kalibr_noise(path: &std::path::Path) -> Result<ImuNoise> {
    let text = fs::read_to_string(path)
        .with_context(|| format!("reading the noise of the IMU: {}", path.display()))?;
    let number = |key: &str| -> Result<f64> {
        let value = text.lines().find_map(|line| {
            let (name, value) = line.split('#').next()?.split_once(':')?;
            (name.trim() == key).then(|| value.trim().to_owned())
        });
        let value = value.with_context(|| format!("{key} is missing: {}", path.display()))?;
        let number = value
            .parse()
            .ok()
            .filter(|v: &f64| v.is_finite() && *v > 0.0);
        number.with_context(|| {
            format!(
                "{key}: found {value:?}, expected a number above 0: {}",
                path.display()
            )
        })
    };
    Ok(ImuNoise {
        gyro_noise_density: number("gyroscope_noise_density")?,
        gyro_random_walk: number("gyroscope_random_walk")?,
        accel_noise_density: number("accelerometer_noise_density")?,
        accel_random_walk: number("accelerometer_random_walk")?,
    })
}

#[cfg(test)]
mod tests;
