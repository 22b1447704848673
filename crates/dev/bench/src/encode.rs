//! `encode`: cost of quality in bits and processor time, and overhead of the daemon.
//!
//! 1. Every encoder that passes its trial on this machine, at several quality targets, on real
//!    stereo images side by side at their own size (KITTI and EuRoC, where the data are available)
//!    and on synthetic ones: luma PSNR of the decoded images, Mbit/s at the nominal rate, CPU time
//!    per frame, and whether the target was met. As in a recording: one thread per encoder, a key
//!    frame each half second. Times are those of a clip twice over less those of the clip once, so
//!    that starting and draining the encoder are excluded.
//! 2. The processor time of a whole recording (three cameras, real time) against the same encoder
//!    with the same settings on the same images in a bare `gst-launch-1.0` pipeline. The daemon
//!    writes its sessions to a disk and syncs them; the peer throws its video away. Both run
//!    alternately in this run, short and long: the difference is free of everything that happens
//!    once, such as starting and reading the images.
//!
//! Processor time is what processes used, waiting not counted, so it depends less on the load of
//! the machine than frames per second; published numbers should come from an idle one nevertheless.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};

mod charts;
mod curve;
mod daemon;
mod material;

use crate::{recording, stamp};
use curve::Point;
use material::Clip;

/// Amount of work.
struct Plan {
    targets_db: &'static [f64],
    /// Maximum number of frames of each clip.
    images: usize,
    repetitions: usize,
    daemon: daemon::Plan,
}

const FULL: Plan = Plan {
    targets_db: &[36.0, 39.0, 42.0, 45.0, 48.0],
    images: 30,
    repetitions: 3,
    daemon: daemon::Plan {
        short_s: 3,
        long_s: 13,
        repetitions: 9,
    },
};

const QUICK: Plan = Plan {
    targets_db: &[36.0, 42.0, 48.0],
    images: 10,
    repetitions: 1,
    daemon: daemon::Plan {
        short_s: 3,
        long_s: 8,
        repetitions: 1,
    },
};

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, an encoder that fails half-way, or an I/O error. A target that is missed is a
/// result and no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let mut plan = FULL;
    let mut out = PathBuf::from("docs/benchmarks");
    let mut rest = args.iter();
    while let Some(argument) = rest.next() {
        match argument.as_str() {
            "--quick" => plan = QUICK,
            "--out" => out = rest.next().context("--out needs a folder")?.into(),
            // What the daemon's part starts as a process of its own.
            recording::RECORD => return recording::record(&rest.cloned().collect::<Vec<_>>()),
            other => bail!("unknown argument {other:?}, expected --quick or --out DIR"),
        }
    }
    let stamp = stamp::stamp("encode", args)?;
    let clips = material::clips(plan.images)?;
    let (points, refused) = measure_encoders(&clips, &plan)?;
    let share = daemon::measure(&plan.daemon)?;

    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    let report = json!({
        "benchmark": "encode",
        "stamp": stamp,
        "clips": clips.iter().map(Clip::json).collect::<Vec<_>>(),
        "refused": refused,
        "encoders": points.iter().map(Point::json).collect::<Vec<_>>(),
        "daemon": share.as_ref().map_or(Value::Null, daemon::Share::json),
    });
    write(&out.join("encode.json"), &format!("{report:#}\n"))?;
    let line = stamp::line(&stamp);
    for (name, svg) in charts::draw(&clips, &points, share.as_ref(), &line) {
        write(&out.join(format!("encode-{name}.svg")), &svg)?;
    }
    Ok(())
}

/// All encoders on all clips; and the unusable ones, with the reason.
fn measure_encoders(clips: &[Clip], plan: &Plan) -> Result<(Vec<Point>, Vec<Value>)> {
    let (mut points, mut refused) = (Vec::new(), Vec::new());
    println!("{}", Point::HEADING);
    for element in video::encoder::known_elements() {
        let size = &clips[0].images[0];
        if let Err(reason) = video::discover::trial(element, size.width, size.height) {
            println!("{element:12} {reason}");
            refused.push(json!({ "element": element, "reason": reason.to_string() }));
            continue;
        }
        for clip in clips {
            for &target_db in plan.targets_db {
                let point = curve::measure(element, clip, target_db, plan.repetitions)
                    .with_context(|| format!("{element} at {target_db} dB on {}", clip.name))?;
                println!("{point}");
                points.push(point);
            }
        }
    }
    if points.is_empty() {
        bail!("no encoder works on this machine");
    }
    Ok((points, refused))
}

fn write(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).with_context(|| format!("writing {}", path.display()))?;
    println!("wrote {}", path.display());
    Ok(())
}
