//! The command line of `paws-rig-sim`.
//!
//! Results go to standard output, everything else to standard error. Exit codes: 0 success, 1
//! failure, 2 invalid arguments.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::{Context, Result};
use boards::Target;
use cad_transforms::rig::Rig;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::error::ErrorKind;
use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use command_line::output::{self, is_quiet, print};
use command_line::{Papers, Verbosity, complain};
use indicatif::{ProgressBar, ProgressStyle};
use log::LevelFilter;
use rig_sim::calibration_error::CalibrationError;
use rig_sim::camera::Quality;
use rig_sim::camera::sensor::Tone;
use rig_sim::faults::Faults;
use rig_sim::preview;
use rig_sim::render::{Job, render, render_session};
use rig_sim::scene::{Kind, Lighting, Scenery};
use rig_sim::simulation::{EyeDifference, Imaging, Settings, Simulation, SimulationError};
use rig_sim::targets::{Motion, Plan, april_grid};

mod examples;

/// Default rig.
const EXAMPLE_RIG: &str = include_str!("../../../../cad-transforms/rigs/example.toml");

/// Simulates a walk with the chest rig, with exact ground truth.
#[derive(Debug, Parser)]
#[command(name = "paws-rig-sim", version, after_help = AFTER)]
struct Arguments {
    #[command(flatten)]
    verbosity: Verbosity,
    #[command(subcommand)]
    command: Command,
}

const AFTER: &str = "\
`paws rig-sim` starts this program too.
Exit codes: 0 fine, 1 failed, 2 bad arguments.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Write camera and IMU data as EuRoC/ASL folders, with ground truth.
    Render(Render),
    /// Draw the camera images at a few instants and a map of the path as one PNG.
    Preview {
        /// Number of instants to show.
        #[arg(long, value_name = "N", default_value = "4")]
        instants: NonZeroUsize,
        /// PNG file to write.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// Frames per second of a film; the instants are frame times.
        #[arg(long, value_name = "HZ", default_value = "30")]
        rate: f64,
        /// Also write the whole walk as a film to this MP4 file.
        #[arg(long, value_name = "FILE")]
        film: Option<PathBuf>,
        #[command(flatten)]
        walk: Walk,
    },
    #[command(flatten)]
    Papers(Papers),
}

#[derive(Debug, Args)]
struct Render {
    /// Frames per second of every camera.
    #[arg(long, value_name = "HZ", default_value = "15")]
    rate: f64,
    /// Folder to write; must be new or empty.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Also write ground truth of every pixel: depth, class, instance and flow.
    #[arg(long)]
    truth: bool,
    /// Also write a session archive, as a recorder without faults would: DIR/session.
    #[arg(long)]
    session: bool,
    /// Write a session archive and nothing else: DIR is the session.
    #[arg(long, conflicts_with_all = ["session", "truth"])]
    session_only: bool,
    /// The session has neither intrinsics nor a rig file, as of an uncalibrated rig.
    #[arg(long)]
    uncalibrated: bool,
    /// Cameras rendered at a time [default: all]
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
    // Last, since it ends with its own headings.
    #[command(flatten)]
    walk: Walk,
}

#[derive(Debug, Args)]
struct Walk {
    /// Scene.
    #[arg(long, value_name = "SCENE", value_parser = scene())]
    scene: Kind,
    /// Lighting.
    #[arg(long, default_value = Lighting::Day.name(), value_parser = lighting())]
    light: Lighting,
    /// Seed of all random numbers.
    #[arg(long, value_name = "N", default_value = "1")]
    seed: u64,
    /// Length of the walk.
    #[arg(
        long,
        value_name = "SECONDS",
        default_value = "10",
        allow_negative_numbers = true
    )]
    seconds: f64,
    /// Columns of one eye.
    #[arg(long, value_name = "PIXELS", default_value = "672")]
    width: u32,
    /// Rows.
    #[arg(long, value_name = "PIXELS", default_value = "376")]
    height: u32,
    /// TOML file with faults; a preview has those of the wearer, folders also those of lenses and
    /// light, and the session has all.
    #[arg(long, value_name = "FILE")]
    faults: Option<PathBuf>,
    /// fast: one sample per image; accurate: smooth edges and motion blur.
    #[arg(long, default_value = "accurate", value_parser = quality())]
    quality: Quality,
    /// Distance between the bars of a fence along the route, in metres [default: no fence]
    #[arg(
        long,
        value_name = "METRES",
        default_value = "0",
        hide_default_value = true
    )]
    fence_spacing: f64,
    /// Reflectance of the ground relative to glass: highlights of lamps and of the sun.
    #[arg(long, value_name = "X", default_value = "0")]
    gloss: f32,
    /// Rig file [default: the example rig]
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Intrinsics of a camera, from a calibration file or folder; may be given for each camera
    /// [default: nominal ones]
    #[arg(long, value_name = "CAMERA=FILE", value_parser = camera_file)]
    calibration: Vec<(String, PathBuf)>,
    #[command(flatten)]
    ground_truth: GroundTruthArguments,
    #[command(flatten)]
    boards: Boards,
    #[command(flatten)]
    sensors: Sensors,
}

/// Ground truth that differs from the recorded calibration.
#[derive(Debug, Args)]
#[command(next_help_heading = "Ground truth that differs from the recorded calibration")]
struct GroundTruthArguments {
    /// Rig file with the true extrinsics; the recording contains --rig.
    #[arg(long, value_name = "FILE", conflicts_with = "deviation")]
    true_rig: Option<PathBuf>,
    /// True intrinsics of a camera; the recording contains --calibration, or the nominal ones.
    #[arg(long, value_name = "CAMERA=FILE", value_parser = camera_file)]
    true_calibration: Vec<(String, PathBuf)>,
    /// Frame timestamp minus true exposure time of a camera, in milliseconds.
    #[arg(long, value_name = "CAMERA=MS", value_parser = time_offset)]
    time_offset: Vec<(String, f64)>,
    /// TOML file with errors of rotation, translation, time offset and intrinsics: see
    /// docs/reference/rig-sim.md.
    #[arg(long, value_name = "FILE")]
    deviation: Option<PathBuf>,
}

/// Options of the scene with calibration boards.
#[derive(Debug, Args)]
#[command(next_help_heading = "Scene targets")]
struct Boards {
    /// Motion of the rig in front of the boards.
    #[arg(long, default_value = Motion::Varied.name(), value_parser = motion())]
    motion: Motion,
    /// Number of views, after which the rig is at rest [default: as time allows]
    #[arg(long, value_name = "N")]
    views: Option<usize>,
    /// Distance of the middle of each board behind its edges, mm.
    #[arg(
        long,
        value_name = "MM",
        default_value = "0",
        allow_negative_numbers = true
    )]
    board_bow: f64,
    /// Size of the boards relative to their files, minus one, percent.
    #[arg(
        long,
        value_name = "PERCENT",
        default_value = "0",
        allow_negative_numbers = true
    )]
    board_scale_error: f64,
    /// File of a board; may be given for each camera [default: AprilGrids of 6 x 6 tags for all]
    #[arg(long, value_name = "FILE")]
    target: Vec<PathBuf>,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Sensors")]
struct Sensors {
    /// Exposure time of every image, in milliseconds [default: automatic]
    #[arg(long, value_name = "MS")]
    exposure: Option<f64>,
    /// Factor on the image noise; 1 is nominal.
    #[arg(long, value_name = "X", default_value = "1")]
    noise: f64,
    /// Linear pixel values, without the sRGB tone curve.
    #[arg(long)]
    linear: bool,
    /// Expose all rows of all cameras simultaneously; otherwise the feet camera has a rolling
    /// shutter.
    #[arg(long)]
    global_shutter: bool,
    /// Additional blur of the right eyes, standard deviation in pixels.
    #[arg(long, value_name = "PIXELS", default_value = "0")]
    right_blur: f32,
    /// Additional vignetting of the right eyes, as a part of the cos⁴ falloff.
    #[arg(long, value_name = "X", default_value = "0")]
    right_vignetting: f32,
    /// Gain of the right eyes relative to the left ones, minus 1.
    #[arg(
        long,
        value_name = "X",
        default_value = "0",
        allow_negative_numbers = true
    )]
    right_gain: f32,
    /// Quantization step of a codec, in gray levels.
    #[arg(long, value_name = "X", default_value = "0")]
    codec_step: f32,
}

/// Parser of one word per value.
fn one_of<T>(values: Vec<(&'static str, T)>) -> impl TypedValueParser<Value = T>
where
    T: Copy + Send + Sync + 'static,
{
    PossibleValuesParser::new(values.iter().map(|(name, _)| *name)).map(move |word| {
        let found = values.iter().find(|(name, _)| *name == word);
        found.expect("the parser lets no other word pass").1
    })
}

fn scene() -> impl TypedValueParser<Value = Kind> {
    let all = Kind::ALL.into_iter().chain([Kind::Targets]);
    one_of(all.map(|kind| (kind.name(), kind)).collect())
}

fn motion() -> impl TypedValueParser<Value = Motion> {
    one_of(Motion::ALL.map(|motion| (motion.name(), motion)).to_vec())
}

fn lighting() -> impl TypedValueParser<Value = Lighting> {
    one_of(
        Lighting::ALL
            .map(|lighting| (lighting.name(), lighting))
            .to_vec(),
    )
}

fn quality() -> impl TypedValueParser<Value = Quality> {
    one_of(vec![
        ("fast", Quality::FAST),
        ("accurate", Quality::ACCURATE),
    ])
}

fn main() -> ExitCode {
    // Invalid arguments exit here with code 2.
    let arguments = Arguments::from_arg_matches(&command().get_matches());
    let arguments = arguments.unwrap_or_else(|error| error.exit());
    arguments.verbosity.logger(LevelFilter::Warn).init();
    let result = match arguments.command {
        Command::Render(arguments) => render_to(&arguments),
        Command::Preview {
            walk,
            instants,
            out,
            rate,
            film,
        } => preview_to(&walk, instants.get(), &out, rate, film.as_deref()),
        Command::Papers(papers) => papers.write(command(), &mut std::io::stdout()),
    };
    if let Err(error) = &result
        && let Some(SimulationError::Setting { .. }) = error.downcast_ref()
    {
        let message = format!("{error:#}");
        let wrong = Arguments::command().error(ErrorKind::ValueValidation, message);
        wrong.exit();
    }
    output::finish(result.map(|()| ExitCode::SUCCESS))
}

/// The command line with its examples.
fn command() -> clap::Command {
    command_line::examples::add(Arguments::command(), examples::EXAMPLES)
}

/// Reads a text file.
fn text_of(path: &Path, what: &str) -> Result<String> {
    plain_file::read_to_string(path, plain_file::TEXT_LIMIT)
        .with_context(|| format!("reading {what} {}", path.display()))
}

/// The simulation, the rig and the text of its file.
fn simulate(walk: &Walk, rate_hz: f64) -> Result<(Arc<Simulation>, Rig, String, Faults)> {
    let (text, rig) = match &walk.rig {
        Some(path) => {
            let text = text_of(path, "the rig file")?;
            let rig = Rig::parse(&text).with_context(|| format!("in {}", path.display()))?;
            (text, rig)
        }
        None => (EXAMPLE_RIG.to_owned(), Rig::parse(EXAMPLE_RIG)?),
    };
    let settings = Settings {
        kind: walk.scene,
        lighting: walk.light,
        seed: walk.seed,
        seconds: walk.seconds,
        rate_hz,
        width: walk.width,
        height: walk.height,
        quality: walk.quality,
    };
    let faults = match &walk.faults {
        None => Faults::default(),
        Some(path) => {
            let text = text_of(path, "the faults")?;
            Faults::parse(&text, &rig.cameras(), walk.seed)
                .with_context(|| format!("in {}", path.display()))?
        }
    };
    let mut simulation = match walk.scene {
        Kind::Targets => target_session(&settings, &rig, &walk.boards)?,
        _ => Simulation::with_wearer_faults(&settings, &rig, &faults.of_wearer())?,
    };
    let stereo = |camera: &str, path: &Path| {
        let (stereo, notes) = calibration_files::read_stereo(path, walk.width, walk.height)
            .with_context(|| format!("reading the calibration of {camera}"))?;
        for note in notes.iter().filter(|_| !is_quiet()) {
            complain!("{}: {}", path.display(), note.0);
        }
        anyhow::Ok(stereo)
    };
    for (camera, path) in &walk.calibration {
        simulation = simulation.with_lenses(camera, &stereo(camera, path)?)?;
    }
    let ground_truth = &walk.ground_truth;
    for (camera, path) in &ground_truth.true_calibration {
        simulation = simulation.with_true_lenses(camera, &stereo(camera, path)?)?;
    }
    if let Some(path) = &ground_truth.true_rig {
        simulation = simulation.with_true_rig(&Rig::read(path)?)?;
    }
    let mut calibration_error = match &ground_truth.deviation {
        None => CalibrationError::default(),
        Some(path) => {
            let text = text_of(path, "the calibration errors")?;
            CalibrationError::parse(&text, &rig.cameras())
                .with_context(|| format!("in {}", path.display()))?
        }
    };
    for (camera, ms) in &ground_truth.time_offset {
        if !rig.cameras().contains(&camera.as_str()) {
            anyhow::bail!(
                "setting the time offset of a camera: found {camera:?}, expected one of {}",
                rig.cameras().join(", ")
            );
        }
        calibration_error.of_mut(camera).time_offset_ns = (ms * 1e6).round() as i64;
    }
    simulation = simulation.with_calibration_error(&rig, &calibration_error)?;
    let sensors = &walk.sensors;
    simulation = simulation.with_imaging(Imaging {
        exposure_s: sensors.exposure.map(|ms| 1e-3 * ms),
        noise: sensors.noise,
        tone: if sensors.linear {
            Tone::Linear
        } else {
            Tone::Srgb
        },
        global_shutter: sensors.global_shutter,
        right_eye: EyeDifference {
            blur_px: sensors.right_blur,
            vignetting: sensors.right_vignetting,
            gain: sensors.right_gain,
        },
        codec_step: sensors.codec_step,
    })?;
    simulation = simulation.with_scenery(Scenery {
        fence_spacing_m: walk.fence_spacing,
        gloss: walk.gloss,
    })?;
    Ok((Arc::new(simulation), rig, text, faults))
}

fn target_session(settings: &Settings, rig: &Rig, boards: &Boards) -> Result<Simulation> {
    let plan = Plan {
        motion: boards.motion,
        views: boards.views,
        bow_m: 1e-3 * boards.board_bow,
        scale_error: 1e-2 * boards.board_scale_error,
    };
    let read = |path: &PathBuf| {
        let target = calibration_files::board::read(path)?;
        match target.invalid_reason() {
            None => anyhow::Ok(target),
            Some((key, why)) => anyhow::bail!("{key} is {why}: {}", path.display()),
        }
    };
    let targets: Vec<Target> = boards.target.iter().map(read).collect::<Result<_>>()?;
    let target = |number: usize| match targets.as_slice() {
        [] => Some(april_grid(number)),
        some => some.get(number).cloned(),
    };
    Ok(Simulation::with_targets(settings, rig, &plan, &target)?)
}

/// `CAMERA=MS`
fn time_offset(text: &str) -> Result<(String, f64), String> {
    let parts = text
        .split_once('=')
        .filter(|(camera, _)| !camera.is_empty());
    let ms = parts.and_then(|(camera, ms)| Some((camera.to_owned(), ms.parse::<f64>().ok()?)));
    ms.filter(|(_, ms)| ms.abs() <= 500.0)
        .ok_or_else(|| "expected CAMERA=MS, from -500 to 500 ms".to_owned())
}

/// `CAMERA=FILE`
fn camera_file(text: &str) -> Result<(String, PathBuf), String> {
    match text.split_once('=') {
        Some((camera, file)) if !camera.is_empty() && !file.is_empty() => {
            Ok((camera.to_owned(), file.into()))
        }
        _ => Err("expected CAMERA=FILE".to_owned()),
    }
}

fn render_to(arguments: &Render) -> Result<()> {
    let walk = &arguments.walk;
    let (mut simulation, rig, rig_text, faults) = simulate(walk, arguments.rate)?;
    if arguments.uncalibrated {
        simulation = Arc::new(Arc::unwrap_or_clone(simulation).without_calibration());
    }
    let cameras = simulation.cameras().len();
    let frames = simulation.settings().frame_count() * cameras as u64;
    let times = if arguments.session { 2 } else { 1 };
    let bar = progress_bar(times * frames, "stereo frames")?;
    let job = Job {
        rig: &rig,
        rig_text: &rig_text,
        truth: arguments.truth,
        session: arguments.session,
        faults: &faults,
        threads: arguments.threads.map_or(cameras, NonZeroUsize::get),
    };
    match arguments.session_only {
        true => render_session(&simulation, &job, &arguments.out, &|| bar.inc(1))?,
        false => render(&simulation, &job, &arguments.out, &|| bar.inc(1))?,
    }
    bar.finish_and_clear();
    print(format_args!(
        "{frames} stereo frames of {cameras} cameras with IMU and truth, {} s of {}, {}, seed {}: {}",
        walk.seconds,
        walk.scene.name(),
        walk.light.name(),
        walk.seed,
        arguments.out.display()
    ))?;
    Ok(())
}

fn preview_to(
    walk: &Walk,
    instants: usize,
    out: &Path,
    rate_hz: f64,
    film: Option<&Path>,
) -> Result<()> {
    let (simulation, ..) = simulate(walk, rate_hz)?;
    let instants = preview::instants(&simulation, instants);
    let cameras = simulation.cameras().len() as u64;
    let filmed = film.map_or(0, |_| simulation.settings().frame_count());
    let bar = progress_bar((instants.len() as u64 + filmed) * cameras, "images")?;
    let sheet = preview::sheet(&simulation, &instants, &|| bar.inc(1));
    preview::save(&sheet, out)
        .with_context(|| format!("writing the sheet to {}", out.display()))?;
    if let Some(film) = film {
        preview::film::film(&simulation, film, &|| bar.inc(1))?;
    }
    bar.finish_and_clear();
    print(format_args!(
        "{} x {} pixels: {}",
        sheet.width,
        sheet.height,
        out.display()
    ))?;
    if let Some(film) = film {
        let seconds = walk.seconds;
        print(format_args!(
            "{seconds} s at {rate_hz} Hz: {}",
            film.display()
        ))?;
    }
    Ok(())
}

/// Shown only if standard error is a terminal, and not with `-q`.
fn progress_bar(length: u64, what: &str) -> Result<ProgressBar> {
    if is_quiet() {
        return Ok(ProgressBar::hidden());
    }
    let template =
        format!("rendering {{wide_bar}} {{pos}}/{{len}} {what}, {{per_sec}}, {{eta}} left");
    let style = ProgressStyle::with_template(&template).context("laying out the progress bar")?;
    Ok(ProgressBar::new(length).with_style(style))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        command().debug_assert();
        let wrong = command_line::examples::check(&command());
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }

    #[test]
    fn help_lists_values_and_units() {
        let wrong = command_line::help::check(&command());
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }

    #[test]
    fn unknown_scene_is_rejected_with_the_known_ones() {
        let words = [
            "paws-rig-sim",
            "preview",
            "--scene",
            "moon",
            "--out",
            "x.png",
        ];
        let message = Arguments::try_parse_from(words).unwrap_err().to_string();
        for kind in Kind::ALL {
            assert!(message.contains(kind.name()), "{message}");
        }
    }
}
