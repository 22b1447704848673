//! `paws-reconstruct run`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, ensure};
use clap::builder::PossibleValuesParser;
use clap::{Args, CommandFactory, ValueEnum};
use command_line::complain;
use command_line::output::{is_quiet, print};
use indicatif::ProgressBar;
use reconstruction::Input;
use reconstruction::camera_images;
use reconstruction::pipeline::stages::device::{Device, DeviceName};
use reconstruction::pipeline::stages::networks::{NetworkFiles, Networks};
use reconstruction::pipeline::stages::{self, Options, Preset, rig};
use reconstruction::pipeline::{Observer, Outcome, Selection, Sources, State, stage_timings};
use rustix::fs::{Mode, OFlags};
use scene_bundle::{Bundle, Provenance, Scene};

use super::{code, loss, open, print_losses, progress_bar};
use crate::machine;

mod full_disk;
mod overrides;

#[derive(Args)]
pub(crate) struct Arguments {
    /// The session's folder, or the handoff.json in it.
    handoff: PathBuf,
    /// Folder of the bundle; new, empty, or a bundle of the same hand-off.
    #[arg(long, value_name = "BUNDLE")]
    out: PathBuf,
    /// Trade-off of accuracy against time.
    #[arg(long, value_enum, default_value_t = PresetName::Balanced)]
    preset: PresetName,
    /// First stage; outputs of earlier stages are used as they are.
    #[arg(long, value_name = "STAGE", value_parser = PossibleValuesParser::new(stages::NAMES))]
    from: Option<String>,
    /// Last stage.
    #[arg(long, value_name = "STAGE", value_parser = PossibleValuesParser::new(stages::NAMES))]
    to: Option<String>,
    /// Re-run stages even if their outputs are up to date.
    #[arg(long)]
    force: bool,
    /// A rig file instead of the session's, for example of `paws calib cameras`.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Calibration instead of the recorded one: the folder that `paws calib cameras` wrote, or a
    /// camera's file; may be repeated.
    #[arg(long, value_name = "DIR|CAMERA=FILE", value_parser = calibration)]
    calibration: Vec<Calibration>,
    /// Readout line time of a rolling shutter, microseconds; may be given for each camera.
    #[arg(long, value_name = "CAMERA=US", value_parser = named)]
    line_us: Vec<(String, String)>,
    /// A stereo network instead of the built-in matcher (docs/reference/learned.md); ORT_DYLIB_PATH
    /// names ONNX Runtime.
    #[arg(long, value_name = "MODEL.onnx")]
    depth_network: Option<PathBuf>,
    /// A segmentation network; movable objects get no depth (docs/reference/learned.md).
    #[arg(long, value_name = "MODEL.onnx")]
    segmentation_network: Option<PathBuf>,
    /// An LPIPS network, for the quality of held-out images (docs/reference/learned.md).
    #[arg(long, value_name = "MODEL.onnx")]
    lpips_network: Option<PathBuf>,
    /// Preset of the stage splats, instead of that of all stages.
    #[arg(long, value_enum)]
    splat_preset: Option<PresetName>,
    /// Training steps of the stage splats, instead of those of the preset (2000, 7000, 20000).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    splat_steps: Option<u32>,
    /// Most images inside of a sector of the stage splats: longer walks are trained in several.
    #[arg(long, value_name = "N", default_value_t = 1250,
        value_parser = clap::value_parser!(u32).range(20..))]
    splat_sector_views: u32,
    /// Where the stage splats trains; a GPU needs a program built with the feature `gpu`.
    #[arg(long, value_enum, default_value_t = DeviceArgument::Cpu)]
    device: DeviceArgument,
    /// Continue on the processor if the GPU is lost or has no memory left during the training.
    #[arg(long)]
    cpu_fallback: bool,
    /// Memory that the stage splats may use, MB; otherwise what the machine has available.
    #[arg(long, value_name = "MB")]
    max_memory_mb: Option<u64>,
    /// Print a JSON object per stage, one in a line, and no progress.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum PresetName {
    /// Least time
    Fast,
    /// The default
    Balanced,
    /// Least error
    Accurate,
}

impl From<PresetName> for Preset {
    fn from(name: PresetName) -> Self {
        match name {
            PresetName::Fast => Self::Fast,
            PresetName::Balanced => Self::Balanced,
            PresetName::Accurate => Self::Accurate,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum DeviceArgument {
    /// The processor
    Cpu,
    /// A GPU, through Vulkan, Metal or DirectX 12
    Gpu,
    /// The GPU's kernels, on the processor where there is no GPU: slow, for tests
    Software,
}

impl From<DeviceArgument> for DeviceName {
    fn from(name: DeviceArgument) -> Self {
        match name {
            DeviceArgument::Cpu => Self::Cpu,
            DeviceArgument::Gpu => Self::Gpu,
            DeviceArgument::Software => Self::Software,
        }
    }
}

/// Value of `--calibration`.
#[derive(Clone, Debug)]
enum Calibration {
    /// Folder written by `paws calib`: rig file and intrinsics.
    Folder(PathBuf),
    /// A camera and its file.
    Camera(String, PathBuf),
}

fn calibration(text: &str) -> Result<Calibration, String> {
    if !text.contains('=') || Path::new(text).is_dir() {
        return Ok(Calibration::Folder(text.into()));
    }
    named(text).map(|(camera, file)| Calibration::Camera(camera, file.into()))
}

fn named(text: &str) -> Result<(String, String), String> {
    let pair = text
        .split_once('=')
        .filter(|(name, value)| !name.is_empty() && !value.is_empty());
    let pair = pair.map(|(name, value)| (name.to_owned(), value.to_owned()));
    pair.ok_or_else(|| "expected a name and a value, as in feet=VALUE".to_owned())
}

fn stage_number(stage: &str) -> Option<usize> {
    stages::NAMES.iter().position(|name| *name == stage)
}

pub(crate) fn run(arguments: &Arguments) -> Result<ExitCode> {
    let place = |stage: &Option<String>| stage_number(stage.as_deref()?);
    if let (Some(from), Some(to)) = (place(&arguments.from), place(&arguments.to))
        && from > to
    {
        let message = "the stage of --from has to come before that of --to";
        let kind = clap::error::ErrorKind::ValueValidation;
        crate::Arguments::command().error(kind, message).exit();
    }
    // The bundle's rig is used where the stage `rig` does not run.
    let rig_is_fixed = place(&arguments.from).is_some_and(|from| from > 0);
    let has_overrides = arguments.rig.is_some()
        || !arguments.calibration.is_empty()
        || !arguments.line_us.is_empty();
    if rig_is_fixed && has_overrides {
        let message =
            "--rig, --calibration and --line-us are for the stage rig, which --from leaves out";
        let kind = clap::error::ErrorKind::ArgumentConflict;
        crate::Arguments::command().error(kind, message).exit();
    }
    let input = open(&arguments.handoff)?;
    full_disk::explained(reconstruct(arguments, &input))
}

fn reconstruct(arguments: &Arguments, input: &Input) -> Result<ExitCode> {
    let place = |stage: &Option<String>| stage_number(stage.as_deref()?);
    let rig_is_fixed = place(&arguments.from).is_some_and(|from| from > 0);
    let rig_overrides = overrides(arguments, input)?;
    let there = Scene::open(&arguments.out).ok();
    let there = there.as_ref().map(|scene| &scene.manifest().provenance);
    let kept = there.filter(|_| rig_is_fixed).map(|made| made.rig.clone());
    let seal = seal(input, there);
    let provenance = Provenance {
        session_id: input.handoff().session_id.clone(),
        handoff_blake3: seal.clone(),
        judgement: Some(input.judgement()),
        rig: kept.unwrap_or_else(|| rig::revision(input, &rig_overrides)),
        program: env!("CARGO_BIN_NAME").to_owned(),
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        started_civil_ns: machine::civil_ns(),
        ended_civil_ns: None,
    };
    let sources = Sources {
        source: input,
        hashes: BTreeMap::from([(stages::HANDOFF.to_owned(), seal)]),
    };
    let options = Options {
        preset: arguments.preset.into(),
        splat_preset: arguments.splat_preset.map(Preset::from),
        rig_overrides,
        networks: Networks::open(&NetworkFiles {
            stereo: arguments.depth_network.as_deref(),
            segmentation: arguments.segmentation_network.as_deref(),
            lpips: arguments.lpips_network.as_deref(),
        })?,
        splat_steps: arguments.splat_steps.map(|steps| steps as usize),
        splat_sector_views: Some(arguments.splat_sector_views as usize),
        device: Device::open(arguments.device.into(), arguments.cpu_fallback)?,
        memory_bytes: match arguments.max_memory_mb {
            Some(mb) => Some(mb.saturating_mul(1_000_000)),
            None => machine::available_bytes(),
        },
    };
    let pipeline = stages::pipeline(options)?;
    let (from, to) = (arguments.from.clone(), arguments.to.clone());
    let force = arguments.force;
    let selection = Selection { from, to, force };
    let bundle = Bundle::create_or_open(&arguments.out, provenance)?;
    let observer = ProgressReporter {
        bar: match arguments.json {
            true => ProgressBar::hidden(),
            false => progress_bar(0, "{prefix:>20}  {wide_bar} {pos}/{len}, {eta} left  {msg}")?,
        },
        is_json: arguments.json,
        folder: bundle.path(),
    };
    if place(&arguments.to).is_none_or(|to| stages::NAMES[..=to].contains(&"depth")) {
        keep_frames(input, &bundle.path());
    }
    let outcomes = pipeline.run(&sources, &bundle, &selection, &observer, &machine::METER);
    observer.bar.finish_and_clear();
    let outcomes =
        outcomes.with_context(|| format!("reconstructing into {}", arguments.out.display()))?;
    let is_new = outcomes.iter().any(|o| o.state == State::Ran);
    if is_new || !bundle.path().join(camera_images::FILE).exists() {
        // They are not part of the bundle, which is valid without them.
        if let Err(error) = camera_images::write(&bundle.path(), input) {
            log::warn!(
                "writing images of the cameras: {error}: {}",
                arguments.out.display()
            );
        }
    }
    bundle.finish(machine::civil_ns())?;

    let losses: usize = outcomes.iter().map(|o| o.report.losses.len()).sum();
    if !arguments.json {
        let made = outcomes.iter().filter(|o| o.state == State::Ran).count();
        let loss = loss(losses, input);
        print(format_args!(
            "{made} stages run, {} up to date, {loss}: {}",
            outcomes.len() - made,
            arguments.out.display()
        ))?;
    }
    Ok(code(losses, input))
}

/// Most bytes of decoded frames that stages keep for later ones: 2800 frames of 2 x 672x376.
/// Frames above it are decoded again.
const MAX_KEPT_BYTES: u64 = 2 << 30;

/// Free bytes of the disk for each byte of kept frames: the outputs of the stages need space too.
const FREE_PER_KEPT: u64 = 4;

/// Lets stages keep decoded frames for later ones, in a file without a name in the bundle's folder:
/// it ends with the process. Where the file system has no such files, they are decoded again.
fn keep_frames(input: &Input, folder: &Path) {
    let flags = OFlags::TMPFILE | OFlags::RDWR | OFlags::CLOEXEC;
    let kept = rustix::fs::open(folder, flags, Mode::RUSR | Mode::WUSR).and_then(|file| {
        let disk = rustix::fs::fstatvfs(&file)?;
        let free = disk.f_bavail.saturating_mul(disk.f_frsize);
        let max_bytes = MAX_KEPT_BYTES.min(free / FREE_PER_KEPT);
        input.session().keep_frames_in(file.into(), max_bytes);
        Ok(())
    });
    if let Err(error) = kept {
        log::debug!("frames are not kept: {error}: {}", folder.display());
    }
}

/// The seal that identifies the recording in this bundle: an earlier one if the bundle was made
/// from that, so that its outputs remain valid.
fn seal(input: &Input, there: Option<&Provenance>) -> String {
    let handoff = input.handoff();
    let made_of = there.map(|made| &made.handoff_blake3);
    let known = made_of.filter(|seal| handoff.is_known_as(seal));
    known.unwrap_or(&handoff.seal).clone()
}

fn overrides(arguments: &Arguments, input: &Input) -> Result<rig::RigOverrides> {
    let mut rig_overrides = rig::RigOverrides::default();
    let mut named = BTreeSet::new();
    for given in &arguments.calibration {
        let Calibration::Camera(camera, path) = given else {
            continue;
        };
        ensure!(
            named.insert(camera.as_str()),
            "taking a calibration: camera {camera} has two, expected one"
        );
        overrides::lenses(&mut rig_overrides, camera, path, input)?;
    }
    if let Some(path) = &arguments.rig {
        overrides::rig(&mut rig_overrides, path)?;
    }
    // Files given individually take precedence over a folder.
    for given in &arguments.calibration {
        if let Calibration::Folder(folder) = given {
            overrides::folder(&mut rig_overrides, folder, input)?;
        }
    }
    for (camera, us) in &arguments.line_us {
        let line_us = us
            .parse()
            .ok()
            .filter(|us: &f64| *us >= 0.0 && us.is_finite());
        let line_us = line_us.with_context(|| {
            format!(
                "setting the readout line time of {camera}: found {us:?}, expected microseconds"
            )
        })?;
        rig_overrides
            .line_times_s
            .insert(camera.clone(), 1e-6 * line_us);
    }
    Ok(rig_overrides)
}

/// Reports progress: a progress bar, or a line of JSON per stage.
struct ProgressReporter {
    bar: ProgressBar,
    is_json: bool,
    /// Folder of the bundle.
    folder: PathBuf,
}

impl Observer for ProgressReporter {
    fn begin(&self, stage: &str, number: usize, of: usize) {
        self.bar.reset();
        self.bar.set_position(0);
        self.bar.set_length(0);
        self.bar.set_prefix(format!("{number}/{of} {stage}"));
        self.bar.set_message("");
    }

    fn status(&self, text: &str) {
        self.bar.set_message(text.to_owned());
    }

    fn progress(&self, done: u64, total: u64) {
        self.bar.set_length(total);
        self.bar.set_position(done);
    }

    fn end(&self, outcome: &Outcome) {
        // Immediately, since a later stage may fail.
        if let Err(error) = stage_timings::write(&self.folder, std::slice::from_ref(outcome)) {
            log::warn!(
                "writing the timing of {} to {}: {error}",
                outcome.stage,
                self.folder.display()
            );
        }
        if self.is_json {
            // The work continues even if nobody reads the output.
            let _ = print(serde_json::to_string(outcome).unwrap_or_default());
            return;
        }
        self.bar.suspend(|| {
            if !is_quiet() {
                for note in &outcome.report.notes {
                    complain!("note: {note}");
                }
            }
            print_losses(&outcome.report.losses);
            let Outcome { stage, seconds, .. } = outcome;
            let _ = match outcome.state {
                State::Ran => print(format_args!("{stage}: ran in {seconds:.1} s")),
                State::UpToDate => print(format_args!("{stage}: up to date")),
            };
        });
    }
}
