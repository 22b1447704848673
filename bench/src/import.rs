//! `bench import`: what importing and validating a session costs, beside a plain copy.
//!
//! * *Import* against `cp -r` and then `sync -f` of the same session onto the same disk, in turns,
//!   the page cache dropped before each. An import also hashes every byte, checks every checksum and
//!   lists the session. Target: at least 80 % of the speed of the copy.
//! * *Validate* without decoding, from the disk and from memory. Target: at least 1 GB/s.
//! * *Validate* with decoding of every picture, on a session with real pictures.
//!
//! The session is made up: three cameras of 30 Hz with access units of the sizes that 8 Mbit/s give,
//! and an IMU of 400 Hz.

#![expect(
    clippy::disallowed_methods,
    reason = "a benchmark reads the wall clock"
)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use charts::{Axis, Chart, Series};
use collector::console::{Clock, Console, Show};
use collector::import::{import, no_hook};
use collector::library::Library;
use collector::progress::Progress;
use collector::validate::{Options, Validated, validate};
use serde_json::{Value, json};
use session_archive::handoff::Verdict;
use session_archive::manifest::{Camera, Imu, Stop};
use session_archive::record::{Frame, ImuBatch};
use session_archive::storage::DiskStorage;
use session_archive::time::{CivilTime, HostTime, NS_PER_S, TickLength};
use session_archive::writer::{SessionSpec, SessionWriter};
use video::{AccessUnit, Encoder, EncoderEvent, EncoderSettings, Picture, PixelFormat};

/// Ours at least this share of the speed of cp and sync.
const TARGET_SHARE: f64 = 0.8;
/// Validation without decoding, bytes per second at least.
const TARGET_VALIDATE: f64 = 1e9;
const PERIOD: i64 = 33_333_333;
const CAMERAS: [&str; 3] = ["left_shoulder", "right_shoulder", "feet"];

/// Runs the benchmark: `[--quick] [--out DIR] [--dir DIR]`, the last being where to copy to and
/// from (default: beside the program).
///
/// # Errors
/// The disk is full, or a copy fails.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let quick = args.iter().any(|a| a == "--quick");
    let option = |name: &str| {
        let at = args.iter().position(|a| a == name)?;
        args.get(at + 1).map(PathBuf::from)
    };
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/benchmarks");
    let out = option("--out").unwrap_or(docs);
    let own = std::env::current_exe().context("finding this program")?;
    let beside = own.parent().unwrap_or(Path::new(".")).to_owned();
    let place = option("--dir").unwrap_or(beside);
    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    let work = tempfile::Builder::new()
        .prefix("bench-import-")
        .tempdir_in(&place)
        .with_context(|| format!("making a folder in {}", place.display()))?;

    let stamp = stamp(quick);
    let (seconds, turns) = if quick { (40, 2) } else { (680, 7) };
    let source = work.path().join("source");
    eprintln!("writing a session of {seconds} s ...");
    write_session(&source, seconds, None)?;
    let bytes = size(&source)?;
    let cold = drop_caches();
    if !cold {
        eprintln!("the page cache cannot be dropped here: the source is read from memory");
    }

    let (mut copies, mut imports) = (Vec::new(), Vec::new());
    let (mut copies_cpu, mut imports_cpu) = (Vec::new(), Vec::new());
    for turn in 0..turns {
        // In turns, and each first as often as second.
        for second in [false, true] {
            if (turn % 2 == 0) == second {
                let (took, cpu) = time_import(&source, &work.path().join("library"))?;
                imports.push(took);
                imports_cpu.push(cpu);
            } else {
                let (took, cpu) = time_copy(&source, &work.path().join("copy"))?;
                copies.push(took);
                copies_cpu.push(cpu);
            }
        }
        eprintln!(
            "turn {}: cp and sync {:.2} s ({:.2} s CPU), import {:.2} s ({:.2} s CPU)",
            turn + 1,
            copies[turn],
            copies_cpu[turn],
            imports[turn],
            imports_cpu[turn],
        );
    }
    let share = median(&copies) / median(&imports);

    let (mut from_disk, mut from_memory) = (Vec::new(), Vec::new());
    for _ in 0..turns.max(3) {
        drop_caches();
        from_disk.push(time_validate(&source, false)?.0);
        from_memory.push(time_validate(&source, false)?.0);
    }
    let decoded = with_decode(&work.path().join("pictures"), if quick { 2 } else { 10 })?;

    let speed = |times: &[f64]| bytes as f64 / median(times);
    let result = json!({
        "stamp": stamp,
        "session_bytes": bytes,
        "session_seconds": seconds,
        "page_cache_dropped": cold,
        "seconds": {
            "cp_and_sync": copies,
            "import": imports,
            "validate_from_disk": from_disk,
            "validate_from_memory": from_memory,
        },
        "cpu_seconds": {
            "cp_and_sync": copies_cpu,
            "import": imports_cpu,
        },
        "bytes_per_second": {
            "cp_and_sync": speed(&copies),
            "import": speed(&imports),
            "validate_from_disk": speed(&from_disk),
            "validate_from_memory": speed(&from_memory),
        },
        "import_share_of_cp": share,
        "import_share_target": TARGET_SHARE,
        "validate_target_bytes_per_second": TARGET_VALIDATE,
        "targets_met": {
            "import": share >= TARGET_SHARE,
            "validate": speed(&from_memory) >= TARGET_VALIDATE,
        },
        "deep": decoded,
    });
    let text = serde_json::to_string_pretty(&result)? + "\n";
    write(&out.join("import.json"), &text)?;
    let runs = [&copies, &imports, &from_disk, &from_memory];
    write(&out.join("import.svg"), &chart(&result, &runs, bytes))?;
    println!(
        "import {:.2} GB/s, {:.0} % of cp and sync ({:.2} GB/s; target {:.0} %)",
        speed(&imports) / 1e9,
        share * 100.0,
        speed(&copies) / 1e9,
        TARGET_SHARE * 100.0
    );
    println!(
        "validate {:.2} GB/s from memory (target 1), {:.2} GB/s from disk",
        speed(&from_memory) / 1e9,
        speed(&from_disk) / 1e9
    );
    println!("validate with decoding: {}", result["deep"]);
    Ok(())
}

fn write(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).with_context(|| format!("writing {}", path.display()))
}

fn chart(result: &Value, runs: &[&Vec<f64>; 4], bytes: u64) -> String {
    let names = [
        "cp -r, sync",
        "paws import",
        "validate, from disk",
        "validate, from memory",
    ];
    let medians = runs.map(|times| bytes as f64 / median(times) * 1e-9);
    let points = runs.iter().enumerate().flat_map(|(i, times)| {
        let speeds = times.iter().map(move |t| bytes as f64 / t * 1e-9);
        speeds.map(move |speed| (i as f64, speed))
    });
    let stamp = &result["stamp"];
    let words = ["machine", "date", "commit", "command"];
    let words = words.map(|key| stamp[key].as_str().unwrap_or_default());
    Chart::new("Importing and validating a session")
        .subtitle(&format!(
            "{:.2} GB; bars are medians, points single runs, copies and imports in turns",
            bytes as f64 * 1e-9
        ))
        .x_axis(Axis::categories("", names))
        .y_axis(Axis::linear("speed", "GB/s").include(0.0))
        .series(Series::bars("median", medians))
        .series(Series::scatter("one run", points))
        .hline(medians[0] * TARGET_SHARE, "80 % of cp and sync")
        .hline(TARGET_VALIDATE * 1e-9, "target of validate")
        .footnote(&words.join("; "))
        .to_svg(760, 380)
}

/// Seconds that `cp -r` and a `sync` of that disk take, by the clock and of CPU.
fn time_copy(source: &Path, target: &Path) -> Result<(f64, f64)> {
    clear(target)?;
    let cpu = cpu_seconds();
    let start = Instant::now();
    command(Command::new("cp").arg("-r").arg(source).arg(target))?;
    command(Command::new("sync").arg("-f").arg(target))?;
    let took = (start.elapsed().as_secs_f64(), cpu_seconds() - cpu);
    clear(target)?;
    Ok(took)
}

/// Seconds that an import into a new library takes, by the clock and of CPU.
fn time_import(source: &Path, root: &Path) -> Result<(f64, f64)> {
    clear(root)?;
    let cpu = cpu_seconds();
    let start = Instant::now();
    let mut library = Library::create(root)?;
    let lock = library.lock()?;
    let imported = import(
        &mut library,
        source,
        Clock::MACHINE,
        &Progress::hidden(),
        &no_hook,
    )?;
    let took = (start.elapsed().as_secs_f64(), cpu_seconds() - cpu);
    ensure!(
        imported.report.is_sound(),
        "the imported session is not sound"
    );
    drop((lock, library));
    clear(root)?;
    Ok(took)
}

/// CPU seconds of this process and of those that it started and that have ended (proc(5), stat).
fn cpu_seconds() -> f64 {
    /// The kernel counts in hundredths of a second towards programs, whatever it does itself.
    const TICKS_PER_SECOND: f64 = 100.0;
    let stat = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The name in parentheses may hold anything; fields are counted from behind it.
    let rest = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
    let ticks = rest.split_whitespace().skip(11).take(4);
    ticks.filter_map(|t| t.parse::<f64>().ok()).sum::<f64>() / TICKS_PER_SECOND
}

/// Removes a copy and leaves the disk and the page cache as if it had never been.
fn clear(folder: &Path) -> Result<()> {
    if folder.exists() {
        fs::remove_dir_all(folder).with_context(|| format!("removing {}", folder.display()))?;
    }
    drop_caches();
    Ok(())
}

fn command(command: &mut Command) -> Result<()> {
    let status = command
        .status()
        .with_context(|| format!("running {:?}", command.get_program()))?;
    if !status.success() {
        bail!("{:?} ended with {status}", command.get_program());
    }
    Ok(())
}

/// Writes everything out and empties the page cache; false where that is not allowed.
fn drop_caches() -> bool {
    rustix::fs::sync();
    fs::write("/proc/sys/vm/drop_caches", "3").is_ok()
}

fn time_validate(folder: &Path, deep: bool) -> Result<(f64, Validated)> {
    let options = Options {
        deep,
        ..Options::default()
    };
    let mut out = std::io::sink();
    let console = Console {
        out: &mut out,
        show: Show::Nothing,
        clock: Clock::MACHINE,
    };
    let start = Instant::now();
    let validated = validate(folder, &options, &console)?;
    let took = start.elapsed().as_secs_f64();
    ensure!(
        validated.validation.verdict != Verdict::Fail,
        "the session failed: {:?}",
        validated.validation.reasons
    );
    Ok((took, validated))
}

/// Validates a session of real pictures with decoding.
fn with_decode(folder: &Path, seconds: i64) -> Result<Value> {
    const WIDTH: u32 = 1344;
    const HEIGHT: u32 = 376;
    eprintln!("encoding {seconds} s of pictures ...");
    let frames = (seconds * NS_PER_S / PERIOD) as usize + 1;
    let units = encode(WIDTH, HEIGHT, frames)?;
    write_session(folder, seconds, Some((WIDTH, HEIGHT, units)))?;
    let (took, validated) = time_validate(folder, true)?;
    let pictures: usize = validated.found.facts.cameras.iter().map(Vec::len).sum();
    let bytes = size(folder)?;
    Ok(json!({
        "pictures": pictures,
        "width": WIDTH,
        "height": HEIGHT,
        "codec": "h264",
        "bytes": bytes,
        "seconds": took,
        "pictures_per_second": pictures as f64 / took,
        "bytes_per_second": bytes as f64 / took,
        "times_real_time": seconds as f64 / took,
    }))
}

/// A made-up session. Without `pictures` the access units are noise of plausible sizes.
fn write_session(
    folder: &Path,
    seconds: i64,
    pictures: Option<(u32, u32, Vec<AccessUnit>)>,
) -> Result<()> {
    let start = HostTime(1_000 * NS_PER_S);
    let (width, height) = pictures.as_ref().map_or((2560, 720), |p| (p.0, p.1));
    let camera = |name: &str| Camera {
        name: name.to_owned(),
        width,
        height,
        codec: "h264".to_owned(),
        colour: "grey".to_owned(),
        rate_hz: 1e9 / PERIOD as f64,
        tick: TickLength::NANOSECOND,
        trigger: Some("bench".to_owned()),
        source: "made up".to_owned(),
        encoder: "none".to_owned(),
    };
    let spec = SessionSpec {
        session_id: "0192aa00-0000-7000-8000-0000000000be".to_owned(),
        name: "bench".to_owned(),
        software: "bench".to_owned(),
        started: start,
        started_civil: CivilTime(1_790_000_000 * NS_PER_S),
        chunk_ns: NS_PER_S / 2,
        cameras: CAMERAS.map(camera).to_vec(),
        imus: vec![Imu {
            name: "feet/imu".to_owned(),
            rate_hz: 400.0,
            tick: TickLength::NANOSECOND,
            source: "made up".to_owned(),
        }],
        rig: Vec::new(),
    };
    fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
    let mut writer = SessionWriter::create(Arc::new(DiskStorage::new(folder)), spec)?;
    let mut noise = 0x9E37_79B9_7F4A_7C15_u64;
    let mut epoch = -1;
    let mut batches = 0;
    for number in 0..=(seconds * NS_PER_S / PERIOD) {
        let t = number * PERIOD;
        let key = t / (NS_PER_S / 2) != epoch;
        epoch = t / (NS_PER_S / 2);
        for name in CAMERAS {
            let frame = Frame {
                number: number as u64,
                device_ticks: t,
                host_time: start.0 + t + 5_000_000,
                time: start.0 + t,
                sigma_ns: 20_000,
                clock_map: 1,
                ..Frame::default()
            };
            match &pictures {
                Some((.., units)) => {
                    let unit = &units[number as usize];
                    writer.append_frame(name, frame, &unit.data, unit.key)?;
                }
                None => {
                    // 8 Mbit/s at 30 Hz, a key frame being six times a usual one.
                    let unit = random(&mut noise, if key { 150_000 } else { 25_000 });
                    writer.append_frame(name, frame, &unit, key)?;
                }
            }
        }
        while batches * 50_000_000 + 50_000_000 <= t {
            let times: Vec<i64> = (0..20)
                .map(|i| start.0 + batches * 50_000_000 + i * 2_500_000)
                .collect();
            let batch = ImuBatch {
                first_number: batches as u64 * 20,
                device_ticks: times.clone(),
                host_times: times.clone(),
                times,
                gyro_counts: (0..60).map(|i| i + batches as i32).collect(),
                gyro_scale: 5.3e-4,
                accel_counts: (0..60).map(|i| i - batches as i32).collect(),
                accel_scale: 2.4e-3,
                ..ImuBatch::default()
            };
            let time = HostTime(batch.times[0]);
            writer.append("feet/imu", time, time, &batch)?;
            batches += 1;
        }
    }
    let stop = Stop {
        at: start + seconds * NS_PER_S,
        reason: "bench".to_owned(),
    };
    writer.close(stop)?;
    Ok(())
}

fn random(state: &mut u64, bytes: usize) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes + 8);
    while out.len() < bytes {
        *state ^= *state << 13;
        *state ^= *state >> 7;
        *state ^= *state << 17;
        out.extend(state.to_le_bytes());
    }
    out.truncate(bytes);
    out
}

/// Pictures of a texture that moves, with noise, as access units; a key frame every half second.
fn encode(width: u32, height: u32, frames: usize) -> Result<Vec<AccessUnit>> {
    let settings = EncoderSettings {
        element: "x264enc".to_owned(),
        width,
        height,
        rate_hz: 30.0,
        quality_db: 42.0,
        threads: 2,
        max_key_interval_frames: 1000,
    };
    let events: Arc<Mutex<Vec<EncoderEvent>>> = Arc::default();
    let collecting = events.clone();
    let on_output = move |event| {
        if let Ok(mut events) = collecting.lock() {
            events.push(event);
        }
    };
    let mut encoder = Encoder::start(&settings, Box::new(on_output))?;
    let mut noise = 0x9E37_79B9_7F4A_7C15_u64;
    let mut epoch = -1;
    for n in 0..frames {
        let grain = random(&mut noise, (width * height) as usize);
        let mut data: Vec<u8> = (0..width * height)
            .zip(&grain)
            .map(|(i, grain)| {
                let (x, y) = (i % width + 3 * n as u32, i / width);
                let texture = ((x / 8) ^ (y / 8)).wrapping_mul(37) & 0x7F;
                texture as u8 + 40 + grain / 64
            })
            .collect();
        data.resize(data.len() * 3 / 2, 128);
        let picture = Picture::new(width, height, PixelFormat::I420, data)?;
        let t = n as i64 * PERIOD;
        let key = t / (NS_PER_S / 2) != epoch;
        epoch = t / (NS_PER_S / 2);
        encoder.push(t, &picture, key)?;
    }
    encoder.finish(Duration::from_secs(120))?;
    let events = events.lock().map(|mut e| std::mem::take(&mut *e));
    let mut units = Vec::new();
    for event in events.unwrap_or_default() {
        match event {
            EncoderEvent::AccessUnit(unit) => units.push(unit),
            EncoderEvent::Failed(reason) => bail!("encoding failed: {reason}"),
        }
    }
    Ok(units)
}

fn size(folder: &Path) -> Result<u64> {
    collector::import::size(folder).map_err(Into::into)
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    match sorted.len() % 2 {
        0 if middle > 0 => (sorted[middle - 1] + sorted[middle]) / 2.0,
        _ => sorted.get(middle).copied().unwrap_or(f64::NAN),
    }
}

/// Machine, date, commit and command.
fn stamp(quick: bool) -> Value {
    let cpus = std::thread::available_parallelism().map_or(1, usize::from);
    let info = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info.lines().find_map(|line| {
        let (key, value) = line.split_once(':')?;
        (key.trim() == "model name").then(|| value.trim().to_owned())
    });
    let git = |arguments: &[&str]| {
        let output = Command::new("git")
            .args(arguments)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .output()
            .ok()
            .filter(|output| output.status.success())?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let commit = git(&["rev-parse", "--short=12", "HEAD"]).unwrap_or_else(|| "unknown".to_owned());
    let changed = git(&["status", "--porcelain", "--untracked-files=no"]);
    let changes = if changed.is_some_and(|c| c.is_empty()) {
        ""
    } else {
        " with changes"
    };
    let kernel = fs::read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
    let load = fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let date = (Clock::MACHINE.civil)().to_string();
    json!({
        "machine": format!("{cpus} CPUs, {}", name.as_deref().unwrap_or(std::env::consts::ARCH)),
        "system": format!("Linux {}", kernel.trim()),
        // Others' work slows an import more than a copy, which needs less of the processor.
        "load_average": load.split(' ').next().unwrap_or_default(),
        "build": if cfg!(debug_assertions) { "debug" } else { "release" },
        "date": date.split('T').next().unwrap_or_default(),
        "commit": format!("{commit}{changes}"),
        "command": format!("cargo xtask bench import{}", if quick { " --quick" } else { "" }),
    })
}
