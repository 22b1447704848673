//! `paws calib camera-imu`: extrinsics and time offset of the IMU of each camera, from a session
//! with a calibration board.
//!
//! Each camera with an IMU, intrinsics and a board in its images gives a table of nominal and
//! estimated values, and a section of `camera-imu.json` and `camera-imu.html`. The recorded
//! extrinsics are a weak prior. If the gates allow it, Kalibr's `camchain-imucam.yaml` and
//! `imu.yaml` are written too, and `rig-imu.toml`: the rig file with the estimated IMU extrinsics.
//! A camera whose gates fail, or that gives no result, keeps its nominal IMU extrinsics, and the
//! exit code is 1; damage on disk makes it 3.

mod document;
mod images;
mod inputs;
mod page;
mod result;
mod table;

use std::path::PathBuf;
use std::thread;

use anyhow::{Context, Result, anyhow, ensure};
use boards::Target as Board;
use cad_transforms::{Frame, FramePart, Rig, RigidTransform};
use calib::camera_imu::simulate::ZED_NOISE;
use calib::camera_imu::{Cameras, Config, ImuSample, Priors, Recording, estimate};
use calibration_files::kalibr::read_imu;
use calibration_files::{Format, contents};
use camera_models::{CameraModel, CameraSet, ImuNoise, NamedCamera, Provenance, SetImu};
use clap::Args;
use console_output::{Console, Outcome, text};
use nalgebra::{Matrix3, SMatrix};
use session_access::{SessionFolder, open, read_or_build};
use session_archive::index::{Access, CameraIndex};
use session_archive::manifest::{Camera, Manifest};
use session_input::imu::increasing_in_time;
use session_input::imu::recording::{self, ImuRecording};

use self::inputs::Inputs;
use self::result::CameraResult;
use crate::nominal_rig::NominalRig;
use crate::results::Output;
use crate::rig_file::{Joint, revised};
use crate::rig_poses;
use crate::target_detections;

/// The JSON document.
pub(crate) const DOCUMENT: &str = "camera-imu.json";
/// The report.
pub(crate) const PAGE: &str = "camera-imu.html";

/// The rig file with its IMUs.
pub(crate) const RIG: &str = "rig-imu.toml";

/// Names of Kalibr's files, after the camera's name.
const KALIBR: [&str; 2] = ["camchain-imucam.yaml", "imu.yaml"];

/// Options of `paws calib camera-imu`.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct Options {
    /// Only this camera
    #[arg(long, value_name = "NAME")]
    pub(crate) camera: Option<String>,
    /// A target that was shown, TOML or Kalibr's YAML; repeat for more [default: rig/target.*.toml
    /// of the session]
    #[arg(long, value_name = "FILE")]
    pub(crate) target: Vec<PathBuf>,
    /// Folder that `paws calib cameras` wrote: intrinsics, stereo extrinsics and the rig file to
    /// start from [default: the session's]
    #[arg(long, value_name = "DIR")]
    pub(crate) calibration: Option<PathBuf>,
    /// Noise of the IMU, Kalibr's imu.yaml [default: typical values, then corrected by the
    /// estimate]
    #[arg(long, value_name = "FILE")]
    pub(crate) noise: Option<PathBuf>,
    /// Rolling shutter: microseconds from each row to the next; repeat as CAMERA=US for cameras
    /// that differ
    #[arg(long, value_name = "[CAMERA=]US", value_parser = line_us)]
    pub(crate) line_us: Vec<(Option<String>, f64)>,
    /// Use every n-th image
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) every: u64,
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

/// Calibrates the cameras of a session.
///
/// # Errors
/// The session cannot be read or has no such camera, there is no board, an output file exists
/// already, or it cannot be written.
pub(crate) fn run(
    session: &SessionFolder,
    options: &Options,
    output: &Output,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    ensure!(options.every > 0, "--every 0: expected at least 1");
    let reader = open(&session.folder)?;
    let manifest = reader.manifest();
    let selected = |name: &str| options.camera.as_deref().is_none_or(|c| c == name);
    check_line_us(options, manifest, session)?;
    let names = || manifest.cameras.iter().map(|c| c.name.as_str());
    let mut possible_files = vec![DOCUMENT.to_owned(), PAGE.to_owned(), RIG.to_owned()];
    possible_files.extend(
        names()
            .filter(|n| selected(n))
            .flat_map(|n| KALIBR.map(|end| format!("{n}-{end}"))),
    );
    let results = output.prepare(output.folder(session)?, possible_files)?;
    let boards = target_detections::targets(&reader, &options.target)?;
    let noise = match &options.noise {
        Some(path) => read_imu(path)?.noise,
        None => ZED_NOISE,
    };
    ensure!(
        names().any(selected),
        "looking for the camera {:?}: the session has {}: {}",
        options.camera.as_deref().unwrap_or("any"),
        camera_names(manifest),
        session.folder.display()
    );
    let index = read_or_build(&reader, console)?;
    let access = Access::open(&**reader.storage(), &index).context("opening the segments")?;
    let nominal = NominalRig::read(&reader)?;
    let inputs = Inputs::read(&nominal, options.calibration.as_deref(), manifest)?;
    let samples = recording::read(
        &reader,
        |name| name.strip_suffix("/imu").is_some_and(selected),
        |_| (),
    )?;
    let calibration = Calibration {
        inputs: &inputs,
        access: &access,
        boards: &boards,
        imus: &samples.imus,
        noise,
        options,
    };
    let mut outcome = Outcome::Fine;
    let mut all = Vec::new();
    for (camera, images) in manifest.cameras.iter().zip(&index.cameras) {
        if !selected(&camera.name) {
            continue;
        }
        let (result, missing) = calibration.of_camera(camera, images, console)?;
        if missing > 0 {
            outcome = outcome.max(Outcome::Loss);
        }
        table::print(&result, console)?;
        all.push(result);
    }
    let joints: Vec<Joint> = all.iter().filter_map(joint).collect();
    let rig = match inputs.rig() {
        _ if joints.is_empty() => Err("no IMU was calibrated"),
        Ok(rig) => Ok(revised(rig, &joints, "camera-imu", "imu", manifest)?),
        Err(reason) => Err(reason),
    };
    let files = files(manifest, &all, rig.as_ref().ok(), console)?;
    results.write(&files, console)?;
    if let Err(reason) = rig {
        console.line(format!("no rig file was written: {reason}"))?;
    }
    if samples.damaged > 0 {
        let damaged = text::count(samples.damaged, "damaged place");
        console.line(format!("{damaged} of the session left out"))?;
        outcome = outcome.max(Outcome::Loss);
    }
    if all.iter().any(|m| m.accepted().is_none()) {
        outcome = Outcome::Failed;
    }
    Ok(outcome)
}

/// Names of the session's cameras, for messages.
fn camera_names(manifest: &Manifest) -> String {
    let names = manifest.cameras.iter().map(|c| c.name.as_str());
    names.collect::<Vec<_>>().join(", ")
}

/// Whether the session has the cameras of `--line-us`.
fn check_line_us(options: &Options, manifest: &Manifest, session: &SessionFolder) -> Result<()> {
    for (name, _) in &options.line_us {
        ensure!(
            name.as_deref()
                .is_none_or(|name| manifest.cameras.iter().any(|c| c.name == name)),
            "--line-us of the camera {:?}: the session has {}: {}",
            name.as_deref().unwrap_or_default(),
            camera_names(manifest),
            session.folder.display()
        );
    }
    Ok(())
}

/// What the calibration of each camera needs.
struct Calibration<'a> {
    inputs: &'a Inputs<'a>,
    access: &'a Access,
    boards: &'a [Board],
    imus: &'a [ImuRecording],
    noise: ImuNoise,
    options: &'a Options,
}

impl Calibration<'_> {
    /// The result of a camera, and the number of its images that could not be decoded.
    fn of_camera(
        &self,
        camera: &Camera,
        images: &CameraIndex,
        console: &mut Console<'_>,
    ) -> Result<(CameraResult, u64)> {
        let name = &camera.name;
        let nominal = self.inputs.imu_from_left(name);
        let mut result = CameraResult {
            camera: name.clone(),
            nominal,
            board: None,
            noise: self.noise,
            line_s: line_s(self.options, name),
            rate_hz: 0.0,
            lenses: Vec::new(),
            found: Err(anyhow!("not started")),
        };
        let (lenses, imu) = match self.lenses_and_imu(name) {
            Ok(ready) => ready,
            Err(error) => {
                result.found = Err(error);
                return Ok((result, 0));
            }
        };
        let right = lenses
            .get(1)
            .map(|(model, right_from_left)| (model, right_from_left));
        let cameras = Cameras::new(&lenses[0].0, right).with_rolling_shutter(result.line_s);
        result.rate_hz = imu.rate_hz;
        result.lenses = lenses;
        let bytes = images.frames.iter().map(|f| u64::from(f.bytes)).sum();
        let threads = thread::available_parallelism().map_or(1, usize::from);
        let observed = {
            let progress = console.progress(name, bytes);
            images::find(
                camera,
                images,
                self.access,
                self.boards,
                self.options.every,
                threads,
                &progress,
            )?
        };
        result.board = observed.board;
        let recording = Recording {
            cameras,
            observations: observed.images,
            imu: inertial(imu),
            noise: self.noise,
            range: imu.count.map(|c| c.map_or(f64::INFINITY, |c| c * 32_767.0)),
        };
        let priors = Priors {
            imu_from_left: nominal,
            ..Priors::default()
        };
        result.found =
            estimate(&recording, &priors, &Config::default()).map_err(anyhow::Error::from);
        Ok((result, observed.missing))
    }

    fn lenses_and_imu(
        &self,
        camera: &str,
    ) -> Result<(Vec<(CameraModel, RigidTransform)>, &ImuRecording)> {
        let name = format!("{camera}/imu");
        let imu = self.imus.iter().find(|i| i.name == name);
        let imu = imu.with_context(|| format!("the session has no {name}"))?;
        Ok((self.inputs.lenses(camera)?, imu))
    }
}

/// Names and bytes of all results; prints the poses of the rig.
fn files(
    manifest: &Manifest,
    all: &[CameraResult],
    rig: Option<&Rig>,
    console: &mut Console<'_>,
) -> Result<Vec<(String, Vec<u8>)>> {
    let page = page::html(manifest, all, rig)?;
    let mut files = vec![
        (DOCUMENT.to_owned(), document::json(manifest, all)?),
        (PAGE.to_owned(), page.into_bytes()),
    ];
    for result in all {
        match kalibr(result) {
            Ok(more) => files.extend(more),
            Err(error) => {
                console.line(format!("{}: no file for Kalibr: {error:#}", result.camera))?
            }
        }
    }
    if let Some(rig) = rig {
        files.push((RIG.to_owned(), rig.to_toml().into_bytes()));
        for line in rig_poses::lines(rig)? {
            console.line(line)?;
        }
        console.line("")?;
    }
    Ok(files)
}

fn line_s(options: &Options, camera: &str) -> f64 {
    let own = |(name, _): &&(Option<String>, f64)| name.as_deref() == Some(camera);
    let all = |(name, _): &&(Option<String>, f64)| name.is_none();
    let lines = &options.line_us;
    let found = lines.iter().find(own).or_else(|| lines.iter().find(all));
    found.map_or(0.0, |(_, us)| us * 1e-6)
}

/// Samples in order of time; those whose time does not increase are left out.
fn inertial(imu: &ImuRecording) -> Vec<ImuSample> {
    (increasing_in_time(&imu.samples).map(ImuSample::from)).collect()
}

/// The estimated IMU extrinsics, as in rig files.
fn joint(result: &CameraResult) -> Option<Joint> {
    let found = result.accepted()?;
    let parent_from_child = found.imu_from_left.inverse();
    // A rotation δ in the left frame and a translation τ in the IMU frame rotate left_from_imu by
    // -δ and translate it by p × δ - Rᵀ τ.
    let back = parent_from_child.rotation().to_rotation_matrix();
    let mut by = SMatrix::<f64, 6, 6>::zeros();
    by.fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&parent_from_child.translation().cross_matrix());
    by.fixed_view_mut::<3, 3>(0, 3).copy_from(&-back.matrix());
    by.fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&-Matrix3::identity());
    let covariance = by * found.covariance.fixed_view::<6, 6>(0, 0) * by.transpose();
    Some(Joint {
        parent: Frame::of_camera(&result.camera, FramePart::Left).ok()?,
        child: Frame::of_camera(&result.camera, FramePart::Imu).ok()?,
        parent_from_child,
        covariance: Some(covariance),
    })
}

/// Intrinsics, extrinsics and noise as Kalibr's files. An error if Kalibr has no such camera model.
fn kalibr(result: &CameraResult) -> Result<Vec<(String, Vec<u8>)>> {
    let Some(found) = result.accepted() else {
        return Ok(Vec::new());
    };
    let noise = &result.noise;
    let times = &found.noises;
    let mut cameras = Vec::new();
    for (eye, (model, eye_from_left)) in ["left", "right"].iter().zip(&result.lenses) {
        cameras.push(NamedCamera {
            name: format!("{}/{eye}", result.camera),
            model: *model,
            camera_from_first: Some(*eye_from_left),
        });
    }
    let set = CameraSet {
        cameras,
        imu: Some(SetImu {
            imu_from_first: found.imu_from_left,
            rate_hz: Some(result.rate_hz),
            noise: Some(ImuNoise {
                gyro_noise_density: noise.gyro_noise_density * times.gyro.ratio_to_nominal,
                gyro_random_walk: noise.gyro_random_walk * times.gyro_walk.ratio_to_nominal,
                accel_noise_density: noise.accel_noise_density * times.accel.ratio_to_nominal,
                accel_random_walk: noise.accel_random_walk * times.accel_walk.ratio_to_nominal,
            }),
            time_offset_s: Some(found.time_offset_s),
            gyro_bias: Some(found.gyro_bias),
            accel_bias: Some(found.accel_bias),
        }),
        provenance: Provenance {
            format: None,
            files: Vec::new(),
            part: None,
        },
    };
    let files = contents(&set, Format::Kalibr)?;
    let named = files.into_iter();
    Ok(named
        .map(|(name, bytes)| (format!("{}-{name}", result.camera), bytes))
        .collect())
}

#[cfg(test)]
mod tests;
