//! `paws calib verify`: checks that the calibration still holds, from an ordinary recording without
//! a target.
//!
//! A few bursts of images, spread over the parts of the session with high angular rates, are
//! decoded, and all gyroscope samples are read. The result is a table of nominal and estimated
//! values with verdicts by the limits of [`session_health::TABLE`]. A parameter that the recording
//! does not constrain has no verdict, and a recording that constrains none is a WARN. Nothing is
//! written into the session's folder. FAIL ends with exit code 1, everything else with 0.

mod page;
mod result;

use std::path::PathBuf;
use std::sync::Mutex;
use std::thread;

use anyhow::{Context, Result, ensure};
use cad_transforms::output::{Existing, write};
use cad_transforms::{Frame, FramePart};
use calib::verify::{
    Burst, Camera, Config, FeatureTracker, Gyro, StereoFrame, Tolerances, choose_bursts, verify,
};
use camera_models::{ImuCalibration, Provenance, StereoCalibration};
use clap::Args;
use console_output::{Console, Outcome};
use imaging::ImageView;
use session_access::decode::visit_run;
use session_access::{SessionFolder, open, read_or_build};
use session_archive::handoff::Verdict;
use session_archive::index::{Access, CameraIndex, Index};
use session_archive::manifest;
use session_archive::reader::SessionReader;
use session_health::{Limits, overall, write_measurements};
use session_input::imu::recording;
use video::RawImage;

use self::result::SessionVerification;
use crate::nominal_rig::NominalRig;

/// Duration of a burst, ns: slightly more than three overlapping track segments.
const BURST_DURATION_NS: i64 = 1_050_000_000;
/// Maximum rate of processed images, Hz; of a faster camera every second one, or fewer.
const MAX_FRAME_RATE_HZ: f64 = 15.0;

/// Options of `paws calib verify`.
#[derive(Clone, Debug, Args)]
pub(crate) struct Options {
    /// Number of image bursts to process, a second each
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = bursts)]
    pub(crate) bursts: usize,
    /// Also write the results as JSON
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
    /// Also write the report as one HTML page
    #[arg(long, value_name = "FILE")]
    pub(crate) html: Option<PathBuf>,
    /// Overwrite existing reports
    #[arg(long)]
    pub(crate) force: bool,
}

fn bursts(text: &str) -> Result<usize> {
    let number = text.parse().ok().filter(|n| (1..=1000).contains(n));
    number.with_context(|| format!("found {text:?}, expected a number from 1 to 1000"))
}

impl Default for Options {
    fn default() -> Self {
        Self {
            bursts: 16,
            json: None,
            html: None,
            force: false,
        }
    }
}

/// A camera with a complete nominal calibration.
struct KnownCamera<'a> {
    index: usize,
    camera: &'a manifest::Camera,
    nominal: StereoCalibration,
    gyro: Option<Gyro>,
}

/// Verifies, and prints the result.
///
/// # Errors
/// The session cannot be read, no camera is calibrated, or a report cannot be written.
pub(crate) fn run(
    session: &SessionFolder,
    options: &Options,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let reader = open(&session.folder)?;
    for path in options.json.iter().chain(&options.html) {
        ensure!(
            options.force || !path.exists(),
            "this report exists already, and --force was not given: {}",
            path.display()
        );
    }
    let checked = check(&reader, options, console)?;
    ensure!(
        !checked.verification.cameras.is_empty(),
        "nothing to verify: {}: {}",
        checked.left_out.join("; "),
        session.folder.display()
    );
    let limits = Limits::default();
    let findings = checked.findings(&limits);
    let verdict = match findings.is_empty() {
        true => Verdict::Warn,
        false => overall(&findings),
    };
    for line in checked.lines(&findings) {
        console.line(line)?;
    }
    if findings.is_empty() {
        console.line(
            "this session determines no parameter: too short, too dark, or too little rotation",
        )?;
    }
    let existing = match options.force {
        true => Existing::Replace,
        false => Existing::Refuse,
    };
    if let Some(path) = &options.json {
        write(path, &checked.json(reader.manifest(), verdict)?, existing)?;
    }
    if let Some(path) = &options.html {
        let page = page::html(reader.manifest(), &checked, &findings, verdict);
        write(path, page.as_bytes(), existing)?;
    }
    console.line(format!("{verdict}  {}", session.name()))?;
    Ok(match verdict {
        Verdict::Fail => Outcome::Failed,
        _ => Outcome::Fine,
    })
}

/// Measures the same and prints the metrics as JSON; `paws validate --deep` compares them with its
/// limits. A session without enough calibration has none.
///
/// # Errors
/// As [`check`].
pub(crate) fn measure(session: &SessionFolder, console: &mut Console<'_>) -> Result<Outcome> {
    let reader = open(&session.folder)?;
    let checked = check(&reader, &Options::default(), console)?;
    let document = write_measurements(crate::software::SOFTWARE, &checked.measurements());
    console.out.write_all(&document.context("writing JSON")?)?;
    Ok(Outcome::Fine)
}

/// Verifies the nominal calibration of a session's rig. A session without enough calibration gives
/// an empty result.
///
/// # Errors
/// An I/O error occurs, or there is no decoder.
fn check(
    reader: &SessionReader,
    options: &Options,
    console: &Console<'_>,
) -> Result<SessionVerification> {
    let rig = NominalRig::read(reader)?;
    let index = read_or_build(reader, console)?;
    let mut checked = SessionVerification {
        verification: verify(&[], &Tolerances::default(), &Config::default()),
        revision: rig
            .rig
            .as_ref()
            .map(|(name, rig)| (name.clone(), rig.revision().to_owned())),
        left_out: rig.unreadable.iter().cloned().collect(),
        bursts: 0,
    };
    let mut gyros = gyros(reader, console)?;
    let mut known = Vec::new();
    for (i, camera) in reader.manifest().cameras.iter().enumerate() {
        match calibration(&rig, &camera.name) {
            Err(missing) => checked.left_out.push(format!("{}: {missing}", camera.name)),
            Ok(nominal) => known.push(KnownCamera {
                index: i,
                camera,
                nominal,
                gyro: gyros
                    .iter()
                    .position(|(name, _)| *name == format!("{}/imu", camera.name))
                    .map(|at| gyros.swap_remove(at).1),
            }),
        }
    }
    if known.is_empty() {
        return Ok(checked);
    }
    let config = Config::default();
    let bursts = read_bursts(reader, &index, &known, &config, options, console)?;
    checked.bursts = bursts.iter().map(Vec::len).max().unwrap_or(0);
    let cameras: Vec<Camera<'_>> = (known.iter().zip(&bursts))
        .map(|(known, bursts)| Camera {
            name: &known.camera.name,
            nominal: &known.nominal,
            rig_from_left: rig.rig_from_left(&known.camera.name).map(|t| t.transform),
            joint_sigma_rad: joint(&rig, &known.camera.name),
            line_s: None,
            bursts,
            gyro: known.gyro.as_ref(),
        })
        .collect();
    checked.verification = verify(&cameras, &Tolerances::default(), &config);
    Ok(checked)
}

fn gyros(reader: &SessionReader, console: &Console<'_>) -> Result<Vec<(String, Gyro)>> {
    let progress = console.progress("reading IMUs", reader.bytes()?);
    let read = recording::read(reader, |_| true, |bytes| progress.add(bytes))?;
    let gyro = |imu: recording::ImuRecording| {
        let samples = imu.samples.iter().map(|s| (s.time_ns, s.gyro_rad_s));
        (imu.name, Gyro::new(samples))
    };
    Ok(read.imus.into_iter().map(gyro).collect())
}

/// Nominal calibration of a camera, or what is missing.
fn calibration(rig: &NominalRig, camera: &str) -> Result<StereoCalibration, String> {
    let [left, right, imu] = ["left", "right", "imu"].map(|part| format!("{camera}/{part}"));
    let lens = |eye: &str| rig.lens(eye).ok_or(format!("no calibration of {eye}"));
    let right_from_left = rig.frames.transform(&right, &left);
    Ok(StereoCalibration {
        left: lens(&left)?,
        right: lens(&right)?,
        right_from_left: right_from_left.ok_or("no extrinsics of the right eye")?,
        imu: rig
            .frames
            .transform(&imu, &left)
            .map(|imu_from_left| ImuCalibration {
                imu_from_left,
                rate_hz: 0.0,
                noise: None,
            }),
        provenance: Provenance {
            format: None,
            files: Vec::new(),
            part: None,
        },
    })
}

/// Rotation sigma of a camera's joint by the rig file, rad: the largest of its axes.
fn joint(rig: &NominalRig, camera: &str) -> Option<f64> {
    let (_, rig) = rig.rig.as_ref()?;
    let left = Frame::of_camera(camera, FramePart::Left).ok()?;
    let covariance = rig.covariance(&Frame::rig(), &left).ok()??;
    let rotations = covariance.matrix().fixed_view::<3, 3>(3, 3).into_owned();
    let largest = rotations.symmetric_eigenvalues().max();
    (largest > 0.0).then(|| largest.sqrt())
}

/// Decodes the bursts of all cameras, one thread per camera.
fn read_bursts(
    reader: &SessionReader,
    index: &Index,
    known: &[KnownCamera<'_>],
    config: &Config,
    options: &Options,
    console: &Console<'_>,
) -> Result<Vec<Vec<Burst>>> {
    let access = Access::open(&**reader.storage(), index).context("opening the segments")?;
    let frames = |known: &KnownCamera<'_>| &index.cameras[known.index].frames;
    let firsts = known
        .iter()
        .filter_map(|k| Some(frames(k).first()?.time_ns));
    let lasts = known.iter().filter_map(|k| Some(frames(k).last()?.time_ns));
    let span = [firsts.max().unwrap_or(0), lasts.min().unwrap_or(0)];
    let refs: Vec<&Gyro> = known.iter().filter_map(|k| k.gyro.as_ref()).collect();
    let times = choose_bursts(
        &refs,
        span,
        options.bursts,
        BURST_DURATION_NS,
        &config.bursts,
    );
    let progress = console.progress("looking", (times.len() * known.len()) as u64);
    let failure = Mutex::new(None);
    let bursts = thread::scope(|scope| {
        let (times, access, progress, failure) = (&times, &access, &progress, &failure);
        let one = move |known: &KnownCamera<'_>| -> Vec<Burst> {
            let frames = &index.cameras[known.index];
            let mut follower = FeatureTracker::new(&known.nominal, known.gyro.as_ref(), config);
            let mut bursts = Vec::new();
            for burst in times {
                if let Err(e) = track_burst(known.camera, frames, access, *burst, &mut follower) {
                    let mut failure = failure.lock().unwrap_or_else(|e| e.into_inner());
                    failure.get_or_insert(e);
                }
                bursts.push(follower.end());
                progress.add(1);
            }
            bursts
        };
        let running: Vec<_> = known.iter().map(|k| scope.spawn(move || one(k))).collect();
        let joined = running.into_iter().map(|thread| match thread.join() {
            Ok(bursts) => bursts,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        joined.collect()
    });
    match failure.into_inner().unwrap_or_else(|e| e.into_inner()) {
        Some(e) => Err(e),
        None => Ok(bursts),
    }
}

/// Tracks features through one burst.
fn track_burst(
    camera: &manifest::Camera,
    index: &CameraIndex,
    access: &Access,
    [from, to]: [i64; 2],
    follower: &mut FeatureTracker<'_>,
) -> Result<()> {
    let first = index.frames.partition_point(|f| f.time_ns < from);
    let last = index.frames.partition_point(|f| f.time_ns <= to);
    let every = (camera.rate_hz / MAX_FRAME_RATE_HZ).round().max(1.0) as u64;
    visit_run(camera, index, access, first..last, &mut |frame, image| {
        if frame.number % every == 0
            && let Some([left, right]) = eyes(image)
        {
            follower.push(&StereoFrame {
                time_ns: frame.time_ns,
                left,
                right,
            });
        }
    })
}

/// The luma of the left and right half of a side-by-side stereo frame.
fn eyes(image: &RawImage) -> Option<[ImageView<'_>; 2]> {
    let (width, height) = (image.width as usize, image.height as usize);
    let luma = image.data.get(..width * height)?;
    let half = width / 2;
    let eye = |pixels| ImageView::new(half, height, width, pixels);
    Some([eye(luma)?, eye(luma.get(half..)?)?])
}
