//! `power_cuts`: loss by a power cut on a real file system, against the length of chunks.
//!
//! `pawsd` records in a virtual machine onto ext4, through a log of all writes. Every disk state
//! that a cut may leave can be reconstructed from it; some are mounted by the kernel of the machine
//! and examined, half of them with torn caches. Missing data that were reported durable fail the
//! benchmark; `cargo xtask vm-test power-cuts` does that with many more cuts. `archive` measures
//! the same of the writer alone, without a kernel.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, ensure};
use charts::{Axis, Chart, Series};
use serde_json::{Value, json};
use vm::case::Bench;
use vm::cases::power_cuts::replayed::{Plan, Recording};
use vm::cases::power_cuts::{Cut, wrong};
use vm::image::FileSystem;
use vm::kernel::{Kernel, KernelError};
use vm::machine::Machine;

use crate::arguments::Arguments;
use crate::meter::quantile;
use crate::stamp;

/// Chunk lengths, ms.
const CHUNKS_MS: [u32; 8] = [100, 200, 300, 400, 500, 600, 800, 1000];

/// What cuts took with one chunk length, s.
struct Loss {
    chunk_ms: u32,
    cuts: usize,
    cameras: Vec<f64>,
    imus: Vec<f64>,
}

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, a machine that fails, or a cut that took what had been reported durable.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let arguments = Arguments::parse(args)?;
    let stamp = stamp::stamp("power_cuts", args)?;
    let kernel = match Kernel::get(|what| println!("{what}")) {
        Err(error @ KernelError::Unavailable(_)) => {
            println!("skipped: {error}");
            return Ok(());
        }
        kernel => kernel?,
    };
    let folder = tempfile::tempdir().context("making a folder")?;
    let bench = Bench {
        machine: Machine::user_mode(kernel, &programs()?)?,
        folder: folder.path().to_owned(),
        quick: arguments.quick,
        seed: 1,
    };
    let (chunks, cuts, seconds) = if arguments.quick {
        (&CHUNKS_MS[..1], 6, 4)
    } else {
        (&CHUNKS_MS[..], 40, 10)
    };
    let mut losses = Vec::new();
    for &chunk_ms in chunks {
        let plan = Plan {
            file_system: FileSystem::Ext4,
            chunk_ms,
            seconds,
            syncs: true,
        };
        let name = format!("chunk-{chunk_ms}");
        let cuts = Recording::make(&bench, &name, plan)?.cuts(&bench, cuts)?;
        let errors = wrong(&cuts);
        ensure!(
            errors.is_empty(),
            "chunks of {chunk_ms} ms: {}",
            errors.join("; ")
        );
        fs::remove_dir_all(bench.folder.join(&name))?;
        let loss = Loss::of(chunk_ms, &cuts);
        println!("{}", loss.line());
        losses.push(loss);
    }
    write(&arguments.out, &losses, &stamp)
}

impl Loss {
    fn of(chunk_ms: u32, cuts: &[Cut]) -> Self {
        let lost = |imu: bool| {
            let all = cuts.iter().flat_map(|cut| &cut.lost);
            let all = all.filter(|(stream, _)| stream.ends_with("/imu") == imu);
            let mut lost: Vec<f64> = all.map(|(_, ns)| *ns as f64 / 1e9).collect();
            lost.sort_by(f64::total_cmp);
            lost
        };
        Self {
            chunk_ms,
            cuts: cuts.len(),
            cameras: lost(false),
            imus: lost(true),
        }
    }

    fn chunk_s(&self) -> f64 {
        f64::from(self.chunk_ms) / 1e3
    }

    fn line(&self) -> String {
        format!(
            "chunk {:.1} s, {} cuts: cameras lose {:.3} s (median), {:.3} s (most), IMUs {:.3} s (most)",
            self.chunk_s(),
            self.cuts,
            quantile(&self.cameras, 0.5),
            quantile(&self.cameras, 1.0),
            quantile(&self.imus, 1.0),
        )
    }

    fn json(&self) -> Value {
        let of =
            |lost: &[f64]| json!({ "median": quantile(lost, 0.5), "most": quantile(lost, 1.0) });
        json!({
            "chunk_s": self.chunk_s(), "cuts": self.cuts,
            "camera_lost_s": of(&self.cameras), "imu_lost_s": of(&self.imus),
        })
    }
}

fn write(out: &Path, losses: &[Loss], stamp: &Value) -> Result<()> {
    let line = |name: &str, of: fn(&Loss) -> f64| {
        Series::line(name, losses.iter().map(|loss| (loss.chunk_s(), of(loss))))
    };
    let chart = Chart::new("Loss by a power cut on ext4")
        .subtitle(
            "from the last sample on disk to the last one that had arrived, per stream and cut",
        )
        .x_axis(Axis::linear("chunk length", "s").include(0.0))
        .y_axis(Axis::linear("lost", "s").include(0.0))
        .hline(1.0, "bound")
        .series(line("cameras, most", |loss| quantile(&loss.cameras, 1.0)))
        .series(line("cameras, half of the cuts", |loss| {
            quantile(&loss.cameras, 0.5)
        }))
        .series(line("IMUs, most", |loss| quantile(&loss.imus, 1.0)))
        .footnote(&stamp::line(stamp));
    let report = json!({
        "benchmark": "power_cuts",
        "stamp": stamp,
        "loss": losses.iter().map(Loss::json).collect::<Vec<_>>(),
    });
    fs::create_dir_all(out).with_context(|| format!("making {}", out.display()))?;
    for (name, text) in [
        ("power_cuts.json", format!("{report:#}\n")),
        ("power_cuts.svg", chart.to_svg(720, 340)),
    ] {
        let path = out.join(name);
        fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
        println!("wrote {}", path.display());
    }
    Ok(())
}

/// The folder of this program, with those that guests run built into it.
pub(crate) fn programs() -> Result<PathBuf> {
    let own = std::env::current_exe().context("finding the own program")?;
    let folder = own.parent().context("the own program has no folder")?;
    let mut build = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    build.args(["build", "--quiet", "--locked", "--bins"]);
    build.args(["--package", "vm", "--package", "capture-daemon"]);
    if let Some(target) = folder.parent() {
        build.arg("--target-dir").arg(target);
    }
    if folder.ends_with("release") {
        build.arg("--release");
    }
    let status = build.status().context("building what guests run")?;
    ensure!(
        status.success(),
        "building what guests run: cargo ended with {status}"
    );
    Ok(folder.to_owned())
}
