//! `frames_kept`: completeness of a recording under load.
//!
//! Three cameras of 1344x376 at 15 Hz are recorded in real time beside 0 to 6 busy loops. Their
//! frames are rendered once, before, and replayed from memory: this measures the recorder, not a
//! renderer. Each run is a process of its own: this program, started again with [`RECORD`], which
//! calls what `pawsd record` calls, or another build of `pawsd` (`--pawsd PATH`), to compare with
//! an earlier state.
//!
//! The same cameras then wait armed, without a pre-roll, beside nothing: the cost of a second of
//! waiting, against a second of recording. Both use a short and a long run, so that starting,
//! stopping and reading the frames do not count.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use cad_transforms::rig::Rig;
use capture_daemon::config::Config;
use capture_daemon::run::{self, StopFlag};
use capture_daemon::sources::simulated::SimulatedCamera;
use capture_daemon::sources::walks::Walks;
use capture_daemon::sources::{Sample, Source as _};
use charts::{Axis, Chart, Series};
use rig_sim::camera::Quality;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::Settings;
use serde_json::{Value, json};
use session_archive::reader::{Entry, SessionReader};
use session_archive::record::paws::gap::Cause;
use session_archive::record::{Frame, Gap, Record as _};
use session_archive::storage::DiskStorage;
use session_archive::time::HostTime;
use video::RawImage;

use crate::arguments::Arguments;
use crate::meter::{self, children_cpu_s};
use crate::recording::{self, RECORD};
use crate::stamp;

/// First argument of the process that waits armed: then follow the same.
const ARMED: &str = "--armed";
const CAMERAS: [&str; 3] = ["left_shoulder", "right_shoulder", "feet"];
const SIZE: (u32, u32) = (1344, 376);
const RATE_HZ: f64 = 15.0;
/// Number of frames that are replayed repeatedly: two seconds.
const FRAMES: usize = 30;
/// Number of busy loops up to which no frame may be lost.
const TARGET_LOOPS: usize = 4;
/// Time after which all frames have been read from their files, s: armed cameras show one frame per
/// second.
const ALL_SHOWN_S: u32 = 45;
/// Maximum ratio of the cost of waiting to that of recording.
const MAX_ARMED_RATIO: f64 = 0.1;

/// Result of a recording beside `loops` busy loops.
struct RecordingResult {
    loops: usize,
    stored: u64,
    /// Missing frames by cause.
    missing: BTreeMap<String, u64>,
    cpu_s: f64,
}

impl RecordingResult {
    fn all(&self) -> u64 {
        self.stored + self.missing.values().sum::<u64>()
    }

    /// Ratio of stored frames, 0 to 1.
    fn share(&self) -> f64 {
        self.stored as f64 / self.all().max(1) as f64
    }

    /// Missing frames that were not left out on purpose.
    fn lost(&self) -> u64 {
        let on_purpose = Cause::LoadShed.as_str_name();
        let causes = self
            .missing
            .iter()
            .filter(|(cause, _)| *cause != on_purpose);
        causes.map(|(_, count)| count).sum()
    }

    fn json(&self) -> Value {
        json!({
            "busy_loops": self.loops,
            "frames": self.all(),
            "stored": self.stored,
            "share_stored": self.share(),
            "lost": self.lost(),
            "missing_by_cause": self.missing,
            "cpu_s": self.cpu_s,
        })
    }
}

/// Runs the benchmark: `[--quick] [--out DIR] [--pawsd PATH]`.
///
/// # Errors
/// Bad arguments, or a recording fails.
pub(crate) fn run(args: &[String]) -> Result<()> {
    match args.split_first() {
        Some((first, rest)) if first == RECORD => return recording::record(rest),
        Some((first, rest)) if first == ARMED => return wait_armed(rest),
        _ => {}
    }
    let mut rest = args.to_vec();
    let mut pawsd = None;
    if let Some(at) = rest.iter().position(|a| a == "--pawsd") {
        ensure!(at + 1 < rest.len(), "--pawsd needs the path of a program");
        pawsd = Some(PathBuf::from(rest.remove(at + 1)));
        rest.remove(at);
    }
    let Arguments { quick, out } = Arguments::parse(&rest)?;
    let stamp = stamp::stamp("frames_kept", args)?;
    let seconds: u32 = if quick { 6 } else { 20 };
    let loads: &[usize] = if quick {
        &[0, 4]
    } else {
        &[0, 1, 2, 3, 4, 5, 6]
    };
    let disk = meter::on_disk(None)?;
    let disk = tempfile::tempdir_in(&disk).context("making a folder for sessions")?;
    let config = prepare(disk.path())?;
    let mut result = Vec::new();
    for &loops in loads {
        let one = recording(
            &config,
            &disk.path().join("sessions"),
            seconds,
            loops,
            pawsd.as_deref(),
        )?;
        println!(
            "{loops} busy loops: {:.1} % of {} frames stored, {} lost; {:.1} s of processor time",
            100.0 * one.share(),
            one.all(),
            one.lost(),
            one.cpu_s
        );
        result.push(one);
    }
    let armed = match pawsd {
        Some(_) => None,
        None => Some(ArmedCost::measure(&config, disk.path(), seconds)?),
    };
    if let Some(armed) = &armed {
        println!(
            "a second costs {:.1} ms of processor time armed, {:.1} ms recording: ratio {:.3} (limit {MAX_ARMED_RATIO})",
            1e3 * armed.armed,
            1e3 * armed.recording,
            armed.share()
        );
    }
    let report = json!({
        "benchmark": "frames_kept",
        "stamp": stamp,
        "program": if pawsd.is_some() { "another pawsd" } else { "this state" },
        "cameras": CAMERAS.len(),
        "width": SIZE.0,
        "height": SIZE.1,
        "rate_hz": RATE_HZ,
        "seconds": seconds,
        "runs": result.iter().map(RecordingResult::json).collect::<Vec<_>>(),
        "armed": armed.map(|armed| armed.json()),
    });
    // A comparison does not replace the record of this state.
    let name = if pawsd.is_some() {
        "frames_kept-other"
    } else {
        "frames_kept"
    };
    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    for (file, text) in [
        (format!("{name}.json"), format!("{report:#}\n")),
        (format!("{name}.svg"), chart(&result, &stamp::line(&stamp))),
    ] {
        let path = out.join(file);
        fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
        println!("wrote {}", path.display());
    }
    let within_goal = result.iter().filter(|k| k.loops <= TARGET_LOOPS);
    let lost: u64 = within_goal.map(RecordingResult::lost).sum();
    println!("lost beside up to {TARGET_LOOPS} busy loops: {lost} (goal: none)");
    Ok(())
}

/// Processor time of a second, s.
struct ArmedCost {
    armed: f64,
    recording: f64,
}

impl ArmedCost {
    fn measure(config: &Path, folder: &Path, seconds: u32) -> Result<Self> {
        let sessions = folder.join("sessions");
        let per_second = |mode: &str, short: u32| {
            let mut costs = [0.0; 2];
            for (cost, seconds) in costs.iter_mut().zip([short, short + seconds]) {
                let mut command = again(mode, config, &sessions, seconds);
                let before = children_cpu_s()?;
                let status = quiet(&mut command)?;
                ensure!(status.success(), "{command:?} ended with {status}");
                *cost = children_cpu_s()? - before;
                fs::remove_dir_all(&sessions).context("removing the sessions")?;
            }
            anyhow::Ok((costs[1] - costs[0]) / f64::from(seconds))
        };
        Ok(Self {
            armed: per_second(ARMED, ALL_SHOWN_S)?,
            recording: per_second(RECORD, 2 * (FRAMES as f64 / RATE_HZ) as u32)?,
        })
    }

    fn share(&self) -> f64 {
        self.armed / self.recording
    }

    fn json(&self) -> Value {
        json!({
            "armed_cpu_s_per_s": self.armed,
            "recording_cpu_s_per_s": self.recording,
            "share": self.share(),
            "limit": MAX_ARMED_RATIO,
            "within_limit": self.share() <= MAX_ARMED_RATIO,
        })
    }
}

/// Renders the frames and writes the configuration that replays them.
fn prepare(folder: &Path) -> Result<PathBuf> {
    let rig =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../cad-transforms/rigs/example.toml");
    let rig = Rig::read(&rig).context("reading the example rig")?;
    let walk = Settings {
        kind: Kind::Pavement,
        lighting: Lighting::Day,
        seed: 1,
        seconds: FRAMES as f64 / RATE_HZ + 1.0,
        rate_hz: RATE_HZ,
        width: SIZE.0 / 2,
        height: SIZE.1,
        quality: Quality::FAST,
    };
    let mut walks = Walks::default();
    let mut text = String::new();
    for name in CAMERAS {
        let mut source =
            SimulatedCamera::open(name, &walk, None, Some(&rig), &mut walks, HostTime(0))?;
        let eyes = folder.join(name);
        for eye in ["left", "right"] {
            fs::create_dir_all(eyes.join(eye)).context("making a folder for frames")?;
        }
        let mut count = 0;
        while count < FRAMES {
            match source.next_sample()? {
                Some(Sample::Frame(frame)) => {
                    write_eyes(&eyes, count, &frame.image)?;
                    count += 1;
                }
                Some(_) => {}
                None => bail!("the walk ended after {count} frames, expected {FRAMES}"),
            }
        }
        text += &format!(
            "[[camera]]\nname = {name:?}\n[camera.source]\nkind = \"replay\"\npath = {:?}\nrate_hz = {RATE_HZ:?}\n\
             repeat = true\n",
            eyes.display().to_string()
        );
    }
    let config = folder.join("pawsd.toml");
    fs::write(&config, text).with_context(|| format!("writing {}", config.display()))?;
    Ok(config)
}

/// Writes the luma of both images as PNG files.
fn write_eyes(folder: &Path, number: usize, image: &RawImage) -> Result<()> {
    let (width, height) = (image.width as usize, image.height as usize);
    for (eye, first) in [("left", 0), ("right", width / 2)] {
        let rows = image.data.chunks(width).take(height);
        let luma: Vec<u8> = rows
            .flat_map(|row| row[first..first + width / 2].iter().copied())
            .collect();
        let path = folder.join(eye).join(format!("{number:06}.png"));
        let file = File::create(&path).with_context(|| format!("making {}", path.display()))?;
        let mut encoder = png::Encoder::new(BufWriter::new(file), image.width / 2, image.height);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        encoder
            .write_header()
            .and_then(|mut writer| writer.write_image_data(&luma))
            .with_context(|| format!("writing {}", path.display()))?;
    }
    Ok(())
}

/// Processes that do nothing but use a core each, until dropped.
struct BusyLoops(Vec<Child>);

impl BusyLoops {
    fn start(count: usize) -> Result<Self> {
        let mut loops = Self(Vec::new());
        for _ in 0..count {
            let child = Command::new("sh")
                .args(["-c", "while :; do :; done"])
                .stdin(Stdio::null())
                .spawn()
                .context("starting a busy loop")?;
            loops.0.push(child);
        }
        Ok(loops)
    }
}

impl Drop for BusyLoops {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// One recording beside `loops` busy loops.
fn recording(
    config: &Path,
    sessions: &Path,
    seconds: u32,
    loops: usize,
    pawsd: Option<&Path>,
) -> Result<RecordingResult> {
    let mut command = match pawsd {
        Some(program) => {
            let mut command = Command::new(program);
            command.args(["record", "--config"]).arg(config);
            command.arg("--out").arg(sessions);
            command.args(["--seconds", &seconds.to_string()]);
            command
        }
        None => again(RECORD, config, sessions, seconds),
    };
    let before = children_cpu_s()?;
    let busy = BusyLoops::start(loops)?;
    let status = quiet(&mut command)?;
    let cpu_s = children_cpu_s()? - before;
    drop(busy);
    // 3: with loss, which is what is counted here.
    ensure!(
        matches!(status.code(), Some(0 | 3)),
        "{command:?} ended with {status}"
    );
    let mut result = RecordingResult {
        loops,
        stored: 0,
        missing: BTreeMap::new(),
        cpu_s,
    };
    for entry in fs::read_dir(sessions).context("looking for the session")? {
        let session = entry.context("looking for the session")?.path();
        let reader = SessionReader::open(Arc::new(DiskStorage::new(&session)))
            .with_context(|| format!("opening {}", session.display()))?;
        count(&reader, &mut result)?;
    }
    fs::remove_dir_all(sessions).context("removing the session")?;
    ensure!(result.stored > 0, "the recording holds no frame");
    Ok(result)
}

/// This very program, even if its file was replaced since it started.
fn again(mode: &str, config: &Path, sessions: &Path, seconds: u32) -> Command {
    let mut command = Command::new("/proc/self/exe");
    command.args(["frames_kept", mode]).arg(config);
    command.arg(sessions).arg(seconds.to_string());
    command
}

/// Runs it to its end with nothing shown.
fn quiet(command: &mut Command) -> Result<ExitStatus> {
    command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .with_context(|| format!("starting {command:?}"))
}

/// Adds up frames and gaps of the cameras.
fn count(reader: &SessionReader, result: &mut RecordingResult) -> Result<()> {
    let streams: BTreeMap<_, _> = reader
        .manifest()
        .streams
        .iter()
        .map(|stream| (stream.id, stream.schema.clone()))
        .collect();
    for entry in reader.entries() {
        let Entry::Message(message) = entry.context("reading the session")? else {
            continue;
        };
        let schema = streams.get(&message.stream).map(String::as_str);
        if schema == Some(Frame::SCHEMA.name) {
            result.stored += 1;
        } else if schema == Some(Gap::SCHEMA.name) {
            let gap: Gap = message.decode().context("decoding a gap record")?;
            if CAMERAS.contains(&gap.stream.as_str()) {
                let cause = gap.cause().as_str_name().to_owned();
                *result.missing.entry(cause).or_default() += gap.count();
            }
        }
    }
    Ok(())
}

/// The waiting process: configuration, folder, seconds.
#[expect(
    clippy::disallowed_methods,
    reason = "the daemon waits in real time for so long"
)]
fn wait_armed(arguments: &[String]) -> Result<()> {
    let [config, out, seconds] = arguments else {
        bail!("{ARMED} takes a configuration, a folder and seconds");
    };
    let seconds: u64 = seconds.parse().context("reading the seconds")?;
    let mut config = Config::read(config.as_ref())?;
    config.control.socket = Path::new(out).with_extension("socket");
    config.session.out = Some(out.into());
    let stop = StopFlag::new();
    let of_timer = stop.clone();
    let timer = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_secs(seconds));
        of_timer.set();
    });
    run::daemon(&config, &stop)?;
    let _ = timer.join();
    Ok(())
}

fn chart(result: &[RecordingResult], footnote: &str) -> String {
    let line = |name: &str, of: &dyn Fn(&RecordingResult) -> u64| {
        let points: Vec<(f64, f64)> = result
            .iter()
            .map(|k| (k.loops as f64, 100.0 * of(k) as f64 / k.all().max(1) as f64))
            .collect();
        Series::line(name, points)
    };
    Chart::new("Frames of a recording beside busy loops")
        .subtitle("three cameras of 1344x376 at 15 Hz, replayed from memory")
        .footnote(footnote)
        .x_axis(Axis::linear("busy loops", "").include(0.0))
        .y_axis(Axis::linear("share of the frames", "%").include(0.0))
        .series(line("stored", &|k| k.stored))
        .series(line("lost", &RecordingResult::lost))
        .to_svg(720, 320)
}
