//! `vm_cost`: wake-ups and processor time of the daemon's threads, against cameras, IMU, operator's
//! devices and page.
//!
//! `pawsd` runs in virtual machines with the kernel's own drivers; see [`vm::cases::cost`] for the
//! counters, and the accuracy of the processor time. The load of the host before and after is kept
//! beside it.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result};
use charts::{Axis, Chart, Series};
use serde_json::{Value, json};
use vm::case::Bench;
use vm::cases::cost::{Cost, SETUPS, Setup, Window, measure};
use vm::kernel::{Kernel, KernelError};
use vm::machine::Machine;

use crate::arguments::Arguments;
use crate::{power_cuts, stamp};

/// Kinds of threads, as in the table.
const KINDS: [&str; 10] = [
    "source", "imu", "hub", "encoder", "recorder", "main", "light", "button", "page", "control",
];
/// Rigs in the chart.
const DRAWN_RIGS: usize = 6;
/// Minimum ratio of samples that a rig must get, and maximum number of attempts: below it the host
/// was too busy.
const MIN_SERVED_RATIO: f64 = 0.95;
const MAX_TRIES: usize = 4;

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or a machine that fails.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let arguments = Arguments::parse(args)?;
    let mut stamp = stamp::stamp("vm_cost", args)?;
    let kernel = match Kernel::get(|what| println!("{what}")) {
        Err(error @ KernelError::Unavailable(_)) => {
            println!("skipped: {error}");
            return Ok(());
        }
        kernel => kernel?,
    };
    vm::leftovers::end_with_signals()?;
    let folder = tempfile::tempdir().context("making a folder")?;
    let bench = Bench {
        machine: Machine::user_mode(kernel, &power_cuts::programs()?)?,
        folder: folder.path().to_owned(),
        quick: arguments.quick,
        seed: 1,
    };
    let (setups, window_s) = if arguments.quick {
        (&SETUPS[..2], 5)
    } else {
        (&SETUPS[..], 20)
    };
    let before = load();
    let mut costs = Vec::new();
    for setup in setups {
        let cost = best(&bench, *setup, window_s)?;
        print(&cost);
        costs.push(cost);
    }
    stamp["host_load"] = json!({ "before": before, "after": load() });
    write(&arguments.out, &costs, window_s, &stamp)
}

/// The first measurement in which the guest had its time, or else the best.
fn best(bench: &Bench, setup: Setup, window_s: u32) -> Result<Cost> {
    let mut best = measure(bench, setup, window_s)?;
    for _ in 1..MAX_TRIES {
        if best.served() >= MIN_SERVED_RATIO {
            break;
        }
        println!("{}: served {:.2}, again", setup.name, best.served());
        let again = measure(bench, setup, window_s)?;
        if again.served() > best.served() {
            best = again;
        }
    }
    Ok(best)
}

/// The host's load averages over 1, 5 and 15 minutes.
fn load() -> Vec<f64> {
    let text = fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let words = text.split(' ').take(3);
    words.filter_map(|word| word.parse().ok()).collect()
}

/// A row of the table for each state: wake-ups per second, in all and by kind, and the share of a
/// processor.
fn print(cost: &Cost) {
    let row = |state: &str, window: &Window| {
        let kinds = KINDS.map(|kind| format!("{kind} {:.1}", window.of(kind).wakes));
        let total = window.total();
        println!(
            "{:20} {state:9} wakes/s {:7.1}  cpu {:5.1} %  [{}]",
            cost.setup.name,
            total.wakes,
            total.cpu_percent,
            kinds.join(", ")
        );
    };
    row("armed", &cost.armed);
    if let Some(window) = &cost.recording {
        row("recording", window);
    }
}

fn write(out: &Path, costs: &[Cost], window_s: u32, stamp: &Value) -> Result<()> {
    let report = json!({
        "benchmark": "vm_cost",
        "stamp": stamp,
        "window_s": window_s,
        "rigs": costs.iter().map(Cost::figures).collect::<Vec<_>>(),
    });
    fs::create_dir_all(out).with_context(|| format!("making {}", out.display()))?;
    for (name, text) in [
        ("vm_cost.json", format!("{report:#}\n")),
        ("vm_cost-wakes.svg", chart(&report, &WAKES)),
        ("vm_cost-cpu.svg", chart(&report, &CPU)),
    ] {
        let path = out.join(name);
        fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
        println!("wrote {}", path.display());
    }
    Ok(())
}

/// A charted quantity.
struct ChartSpec {
    /// Key in the report.
    key: &'static str,
    title: &'static str,
    quantity: &'static str,
    unit: &'static str,
}

const WAKES: ChartSpec = ChartSpec {
    key: "wakes_per_s",
    title: "Wake-ups of the daemon's threads",
    quantity: "wake-ups",
    unit: "1/s",
};

/// System calls are slow in a guest, so these are bounds.
const CPU: ChartSpec = ChartSpec {
    key: "cpu_percent",
    title: "Processor time of the daemon's threads, in a guest",
    quantity: "of one processor",
    unit: "%",
};

/// Value of each kind of thread while recording; if nothing is recorded, while waiting.
fn chart(report: &Value, spec: &ChartSpec) -> String {
    let rigs = || {
        let rigs = report["rigs"].as_array().into_iter().flatten();
        let rigs = rigs.filter(|rig| rig["size"][0].as_u64().is_some_and(|width| width < 1000));
        rigs.filter(|rig| rig["operator"] == false).take(DRAWN_RIGS)
    };
    let names = rigs().map(|rig| rig["name"].as_str().unwrap_or_default());
    let mut chart = Chart::new(spec.title)
        .subtitle(
            "while it records: 30 frames per second and camera, 800 samples per second of the IMU",
        )
        .x_axis(Axis::categories("", names))
        .y_axis(Axis::linear(spec.quantity, spec.unit).include(0.0))
        .footnote(&stamp::line(&report["stamp"]));
    let parts: [(&str, &[&str]); 5] = [
        ("cameras, IMU", &["source", "imu"]),
        ("hub", &["hub"]),
        ("encoders", &["encoder"]),
        ("recorder", &["recorder"]),
        (
            "all others",
            &["main", "light", "button", "page", "control", "rest"],
        ),
    ];
    for (name, kinds) in parts {
        let values = rigs().map(|rig| {
            let recording = &rig["recording"];
            let window = if recording.is_null() {
                &rig["armed"]
            } else {
                recording
            };
            let of = |kind: &&str| window["threads"][kind][spec.key].as_f64().unwrap_or(0.0);
            kinds.iter().map(of).sum()
        });
        chart = chart.series(Series::bars(name, values));
    }
    chart.to_svg(960, 380)
}
