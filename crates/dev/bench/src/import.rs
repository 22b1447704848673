//! `bench import`: cost of importing and validating a session, beside a plain copy.
//!
//! * *Import* against `cp -r` and then `sync -f` of the same session onto the same disk,
//!   alternating, with the page cache dropped before each. An import also hashes every byte, checks
//!   every checksum and lists the session. Target: at least 80 % of the speed of the copy.
//! * *Validate* without decoding, from the disk and from memory. Target: at least 1 GB/s from
//!   memory.
//! * *Validate* with decoding of every frame, on a session with real images.
//!
//! Only root may drop the page cache. For others everything is read from memory: the results state
//! that, and have none from the disk.
//!
//! The session is generated: three cameras of 30 Hz with access units of the sizes that 8 Mbit/s
//! give, and an IMU of 400 Hz each.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use charts::{Axis, Chart, Series};
use collector::commands::validate::{Options, ValidatedSession, validate};
use collector::import::{import, no_hook};
use collector::library::Library;
use console_output::{Clock, Console, Progress, Show};
use serde_json::{Value, json};
use session_archive::handoff::Verdict;
use session_archive::storage::DiskStorage;
use session_archive::time::NS_PER_S;
use session_archive::writer::SessionWriter;
use video::{AccessUnit, Encoder, EncoderEvent, EncoderSettings, PixelFormat, RawImage};

use crate::load::{self, Arrival};
use crate::meter::{self, Timing, children_cpu_s, median, timed};
use crate::stamp;

/// Minimum speed relative to cp and sync.
const MIN_COPY_SPEED_RATIO: f64 = 0.8;
/// Validation without decoding, bytes per second at least.
const MIN_VALIDATE_BYTES_PER_S: f64 = 1e9;
const PERIOD: i64 = 33_333_333;
const CHUNK_NS: i64 = NS_PER_S / 2;

/// Runs the benchmark: `[--quick] [--out DIR] [--disk DIR]`, the last being where to copy to and
/// from (default: the target folder).
///
/// # Errors
/// Bad arguments, a folder that is in memory, the disk is full, or a copy fails.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let (mut quick, mut disk) = (false, None);
    let mut out = PathBuf::from("docs/benchmarks");
    let mut rest = args.iter();
    while let Some(argument) = rest.next() {
        match argument.as_str() {
            "--quick" => quick = true,
            "--out" => out = rest.next().context("--out needs a folder")?.into(),
            "--disk" => disk = Some(rest.next().context("--disk needs a folder")?.into()),
            other => bail!("unknown argument {other:?}, expected --quick, --out or --disk DIR"),
        }
    }
    let place = meter::on_disk(disk)?;
    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    let work = tempfile::Builder::new()
        .prefix("bench-import-")
        .tempdir_in(&place)
        .with_context(|| format!("making a folder in {}", place.display()))?;

    let stamp = stamp::stamp("import", args)?;
    let load_average = fs::read_to_string("/proc/loadavg").unwrap_or_default();
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
        // Alternating, each first as often as second.
        for second in [false, true] {
            if (turn % 2 == 0) == second {
                let took = time_import(&source, &work.path().join("library"))?;
                imports.push(took.wall_s);
                imports_cpu.push(took.cpu_s);
            } else {
                let took = time_copy(&source, &work.path().join("copy"))?;
                copies.push(took.wall_s);
                copies_cpu.push(took.cpu_s);
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
    let middle = |times: &[f64]| median(times.iter().copied());
    let share = middle(&copies) / middle(&imports);

    let (mut from_disk, mut from_memory) = (Vec::new(), Vec::new());
    for _ in 0..turns.max(3) {
        if drop_caches() {
            from_disk.push(time_validate(&source, false)?.0);
        }
        from_memory.push(time_validate(&source, false)?.0);
    }
    let decoded = with_decode(&work.path().join("images"), if quick { 2 } else { 10 })?;

    let speed = |times: &[f64]| bytes as f64 / middle(times);
    let result = json!({
        "stamp": stamp,
        // Others' work slows an import more than a copy, which needs less of the processor.
        "load_average": load_average.split(' ').next().unwrap_or_default(),
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
        "import_share_target": MIN_COPY_SPEED_RATIO,
        "validate_target_bytes_per_second": MIN_VALIDATE_BYTES_PER_S,
        "targets_met": {
            "import": share >= MIN_COPY_SPEED_RATIO,
            "validate": speed(&from_memory) >= MIN_VALIDATE_BYTES_PER_S,
        },
        "deep": decoded,
    });
    let text = serde_json::to_string_pretty(&result)? + "\n";
    write(&out.join("import.json"), &text)?;
    let mut runs = vec![("cp -r, sync", &copies), ("paws import", &imports)];
    if cold {
        runs.push(("validate, from disk", &from_disk));
    }
    runs.push(("validate, from memory", &from_memory));
    let image = chart(&stamp::line(&result["stamp"]), &runs, bytes, cold);
    write(&out.join("import.svg"), &image)?;
    println!(
        "import {:.2} GB/s, {:.0} % of cp and sync ({:.2} GB/s; target {:.0} %)",
        speed(&imports) / 1e9,
        share * 100.0,
        speed(&copies) / 1e9,
        MIN_COPY_SPEED_RATIO * 100.0
    );
    println!(
        "validate {:.2} GB/s from memory (target 1)",
        speed(&from_memory) / 1e9
    );
    if cold {
        println!("validate {:.2} GB/s from disk", speed(&from_disk) / 1e9);
    }
    println!("validate with decoding: {}", result["deep"]);
    Ok(())
}

fn write(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).with_context(|| format!("writing {}", path.display()))
}

fn chart(stamp: &str, runs: &[(&str, &Vec<f64>)], bytes: u64, cold: bool) -> String {
    let speed = |seconds: f64| bytes as f64 / seconds * 1e-9;
    let medians: Vec<f64> = runs
        .iter()
        .map(|(_, times)| speed(median(times.iter().copied())))
        .collect();
    let points = runs.iter().enumerate().flat_map(|(i, (_, times))| {
        let place = i as f64;
        times.iter().map(move |time| (place, speed(*time)))
    });
    let limit = medians[0] * MIN_COPY_SPEED_RATIO;
    let from = if cold { "disk" } else { "memory" };
    Chart::new("Importing and validating a session")
        .subtitle(&format!(
            "{:.2} GB; bars are medians, points single runs, copies and imports in turns, read from {from}",
            bytes as f64 * 1e-9
        ))
        .x_axis(Axis::categories("", runs.iter().map(|(name, _)| *name)))
        .y_axis(Axis::linear("speed", "GB/s").include(0.0))
        .series(Series::bars("median", medians))
        .series(Series::scatter("one run", points))
        .hline(limit, "80 % of cp and sync")
        .hline(MIN_VALIDATE_BYTES_PER_S * 1e-9, "target of validate")
        .footnote(stamp)
        .to_svg(760, 380)
}

/// Time of `cp -r` and a `sync` of that disk.
fn time_copy(source: &Path, target: &Path) -> Result<Timing> {
    clear(target)?;
    let cpu = children_cpu_s()?;
    let (done, mut took) = timed(|| {
        command(Command::new("cp").arg("-r").arg(source).arg(target))?;
        command(Command::new("sync").arg("-f").arg(target))
    });
    done?;
    took.cpu_s += children_cpu_s()? - cpu;
    clear(target)?;
    Ok(took)
}

/// Time of an import into a new library.
fn time_import(source: &Path, root: &Path) -> Result<Timing> {
    clear(root)?;
    let (sound, took) = timed(|| -> Result<bool> {
        let mut library = Library::create(root)?;
        let _lock = library.lock()?;
        let imported = import(
            &mut library,
            source,
            Clock::MACHINE,
            &Progress::hidden(),
            &no_hook,
        )?;
        Ok(imported.report.is_sound())
    });
    ensure!(sound?, "the imported session is not sound");
    clear(root)?;
    Ok(took)
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

fn time_validate(folder: &Path, deep: bool) -> Result<(f64, ValidatedSession)> {
    let options = Options {
        deep,
        calib_program: deep.then(harness::program::calib).transpose()?,
        ..Options::default()
    };
    let mut out = std::io::sink();
    let console = Console {
        out: &mut out,
        show: Show::Nothing,
        clock: Clock::MACHINE,
    };
    let (validated, took) = timed(|| validate(folder, &options, &console));
    let validated = validated?;
    ensure!(
        validated.validation.verdict != Verdict::Fail,
        "the session failed: {:?}",
        validated.validation.reasons
    );
    Ok((took.wall_s, validated))
}

/// Validates a session of real images with decoding.
fn with_decode(folder: &Path, seconds: i64) -> Result<Value> {
    const WIDTH: u32 = 1344;
    const HEIGHT: u32 = 376;
    eprintln!("encoding {seconds} s of images ...");
    let frames = (seconds * NS_PER_S / PERIOD) as usize + 1;
    let units = encode(WIDTH, HEIGHT, frames)?;
    write_session(folder, seconds, Some((WIDTH, HEIGHT, units)))?;
    let (took, validated) = time_validate(folder, true)?;
    let images: usize = validated.found.stats.cameras.iter().map(Vec::len).sum();
    let bytes = size(folder)?;
    Ok(json!({
        "frames": images,
        "width": WIDTH,
        "height": HEIGHT,
        "codec": "h264",
        "bytes": bytes,
        "seconds": took,
        "frames_per_second": images as f64 / took,
        "bytes_per_second": bytes as f64 / took,
        "times_real_time": seconds as f64 / took,
    }))
}

/// A generated session. Without `images` the access units are noise of plausible sizes.
fn write_session(
    folder: &Path,
    seconds: i64,
    images: Option<(u32, u32, Vec<AccessUnit>)>,
) -> Result<()> {
    let mut spec = load::spec(CHUNK_NS);
    if let Some((width, height, _)) = images {
        for camera in &mut spec.cameras {
            (camera.width, camera.height) = (width, height);
        }
    }
    fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
    let mut writer = SessionWriter::create(Arc::new(DiskStorage::new(folder)), spec)?;
    // 8 Mbit/s at 30 Hz, a key frame being six times a usual one.
    let (usual, key) = (load::units(22_000, 28_000), load::units(135_000, 165_000));
    for arrival in load::arrivals(seconds as f64, CHUNK_NS) {
        match (&arrival, &images) {
            (&Arrival::Frame(camera, number, time, _), Some((.., units))) => {
                let unit = &units[number as usize];
                let frame = load::frame(number, time);
                writer.append_frame(load::CAMERAS[camera], frame, &unit.data, unit.key)?;
            }
            (Arrival::Frame(.., true), None) => {
                load::put(&mut writer, &arrival, &key)?;
            }
            _ => {
                load::put(&mut writer, &arrival, &usual)?;
            }
        }
    }
    writer.close(load::stop(load::START + seconds * NS_PER_S))?;
    Ok(())
}

/// Images of a moving texture, with noise, as access units; a key frame every half second.
fn encode(width: u32, height: u32, frames: usize) -> Result<Vec<AccessUnit>> {
    let settings = EncoderSettings {
        element: "x264enc".to_owned(),
        width,
        height,
        rate_hz: 30.0,
        quality_db: 42.0,
        threads: 2,
        max_key_interval_frames: 1000,
        preset: video::encoder::Preset::default(),
    };
    let events: Arc<Mutex<Vec<EncoderEvent>>> = Arc::default();
    let collecting = events.clone();
    let on_output = move |event| {
        if let Ok(mut events) = collecting.lock() {
            events.push(event);
        }
    };
    let mut encoder = Encoder::start(&settings, Box::new(on_output))?;
    let mut noise = load::Noise::new();
    let mut epoch = -1;
    for n in 0..frames {
        let grain = noise.bytes((width * height) as usize);
        let mut data: Vec<u8> = (0..width * height)
            .zip(&grain)
            .map(|(i, grain)| {
                let (x, y) = (i % width + 3 * n as u32, i / width);
                let texture = ((x / 8) ^ (y / 8)).wrapping_mul(37) & 0x7F;
                texture as u8 + 40 + grain / 64
            })
            .collect();
        data.resize(data.len() * 3 / 2, 128);
        let image = RawImage::new(width, height, PixelFormat::I420, data)?;
        let t = n as i64 * PERIOD;
        let key = t / (NS_PER_S / 2) != epoch;
        epoch = t / (NS_PER_S / 2);
        encoder.push(t, &image, key)?;
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
