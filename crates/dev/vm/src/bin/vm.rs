//! `vm`: runs the test cases in virtual machines.
//!
//! Exit codes: 0 all that ran has passed, 1 a case has failed, 2 bad arguments, 4 nothing ran
//! because there is no kernel.
#![expect(
    clippy::disallowed_methods,
    reason = "a developer tool tells people how long each case took"
)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail};
use clap::{Args, Parser, Subcommand};
use serde_json::json;
use vm::case::{Bench, Case, make_empty};
use vm::cases;
use vm::guest::Guest;
use vm::kernel::{Kernel, KernelError};
use vm::machine::Machine;
use vm::stock::StockKernel;

/// Tests on real kernel drivers, in virtual machines.
#[derive(Parser)]
#[command(name = "vm")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// List the cases
    List,
    /// Run cases, all if none is named
    Run(RunArgs),
    /// Run a script of your own in a guest and show what it prints
    Script(ScriptArgs),
    /// Build the kernel, if it is not in the cache, and print its path
    Kernel,
}

#[derive(Args)]
struct RunArgs {
    /// A short slice of each, and only the cases of the short form
    #[arg(long)]
    quick: bool,
    /// On Debian's own kernel under QEMU; only the cases that can
    #[arg(long)]
    qemu: bool,
    /// Do not build a kernel: skip if none is in the cache
    #[arg(long)]
    cached: bool,
    /// Where cases work and results go; emptied first
    #[arg(long, value_name = "DIR", default_value = "target/vm")]
    out: PathBuf,
    /// Decides everything that is random
    #[arg(long, default_value_t = 1)]
    seed: u64,
    names: Vec<String>,
}

#[derive(Args)]
struct ScriptArgs {
    /// On Debian's own kernel under QEMU
    #[arg(long)]
    qemu: bool,
    /// Virtual time
    #[arg(long = "virtual")]
    virtual_time: bool,
    /// The job's folder, writable in the guest as /run/job
    #[arg(long, value_name = "DIR", default_value = "target/vm/script")]
    job: PathBuf,
    /// A disk's image; may be given several times
    #[arg(long, value_name = "IMAGE")]
    disk: Vec<PathBuf>,
    /// Longest that it may take, s
    #[arg(long, default_value_t = 600)]
    limit: u64,
    /// The script, in bash
    script: PathBuf,
}

fn main() -> ExitCode {
    let done = vm::leftovers::end_with_signals().and_then(|()| match Cli::parse().command {
        Command::List => {
            for case in cases::all() {
                println!("{:24} {}", case.name, case.shows);
            }
            Ok(ExitCode::SUCCESS)
        }
        Command::Run(args) => run(&args),
        Command::Script(args) => script(&args),
        Command::Kernel => {
            println!("{}", Kernel::get(tell)?.path().display());
            Ok(ExitCode::SUCCESS)
        }
    });
    done.unwrap_or_else(|error| match error.downcast_ref() {
        Some(KernelError::Unavailable(_)) => {
            println!("skipped: {error:#}");
            ExitCode::from(4)
        }
        _ => {
            eprintln!("vm: {error:#}");
            ExitCode::FAILURE
        }
    })
}

fn tell(what: &str) {
    eprintln!("{what}");
}

fn machine(qemu: bool, cached: bool) -> Result<Machine> {
    if qemu {
        return Machine::qemu(StockKernel::get(tell)?, &programs()?);
    }
    let kernel = if cached {
        let reason = "it was not built before".to_owned();
        Kernel::cached()?.ok_or(KernelError::Unavailable(reason))?
    } else {
        Kernel::get(tell)?
    };
    Machine::user_mode(kernel, &programs()?)
}

/// The folder of the programs that were built with this one.
fn programs() -> Result<PathBuf> {
    let own = std::env::current_exe().context("finding this program's own path")?;
    Ok(own.parent().unwrap_or(Path::new("/")).to_owned())
}

fn run(args: &RunArgs) -> Result<ExitCode> {
    let chosen = chosen(&args.names, args.quick, args.qemu)?;
    let machine = machine(args.qemu, args.cached)?;
    fs::create_dir_all(&args.out).with_context(|| format!("making {}", args.out.display()))?;
    let out = fs::canonicalize(&args.out)?;
    try_a_guest(&machine, &out.join("try"))?;
    let mut failed = Vec::new();
    for case in chosen {
        let folder = out.join(case.name);
        make_empty(&folder)?;
        let bench = Bench {
            machine: machine.clone(),
            folder,
            quick: args.quick,
            seed: args.seed,
        };
        let start = Instant::now();
        let result = (case.run)(&bench);
        let took_s = start.elapsed().as_secs_f64();
        let (word, line) = match &result {
            Ok(report) => ("PASS", report.line.clone()),
            Err(error) => ("FAIL", format!("{error:#}")),
        };
        println!("{word} {:22} {took_s:6.1} s  {line}", case.name);
        let report = json!({
            "case": case.name,
            "passed": result.is_ok(),
            "quick": args.quick,
            "seed": args.seed,
            "took_s": took_s,
            "line": line,
            "figures": result.as_ref().map_or(&serde_json::Value::Null, |report| &report.figures),
        });
        let path = out.join(format!("{}.json", case.name));
        fs::write(&path, format!("{report:#}\n"))
            .with_context(|| format!("writing {}", path.display()))?;
        if result.is_err() {
            failed.push(case.name);
        } else {
            // What a case leaves is of use only where it failed.
            fs::remove_dir_all(&bench.folder)?;
        }
    }
    if failed.is_empty() {
        return Ok(ExitCode::SUCCESS);
    }
    println!(
        "failed: {}; what they left is in {}",
        failed.join(", "),
        out.display()
    );
    Ok(ExitCode::FAILURE)
}

/// Some machines do not let a program trace its children, which User-Mode Linux does all the time:
/// the tests are skipped there, which is not a failure.
fn try_a_guest(machine: &Machine, folder: &Path) -> Result<()> {
    const LIMIT: Duration = Duration::from_secs(600);
    make_empty(folder)?;
    let tried = Guest::new(folder, "true").run(machine, LIMIT);
    match tried.and_then(|ended| ended.success()) {
        Ok(_) => Ok(fs::remove_dir_all(folder)?),
        Err(error) => {
            let reason = format!("a guest that does nothing does not come up here: {error:#}");
            Err(KernelError::Unavailable(reason).into())
        }
    }
}

fn chosen(names: &[String], quick: bool, qemu: bool) -> Result<Vec<&'static Case>> {
    if names.is_empty() {
        let all = cases::all();
        let fits = |case: &&Case| (case.quick || !quick) && (case.on_qemu || !qemu);
        return Ok(all.filter(fits).collect());
    }
    let find = |name: &String| {
        let found = cases::all().find(|case| case.name == name);
        found.with_context(|| {
            let known: Vec<&str> = cases::all().map(|case| case.name).collect();
            format!("there is no case {name:?}; there are: {}", known.join(", "))
        })
    };
    names.iter().map(find).collect()
}

fn script(args: &ScriptArgs) -> Result<ExitCode> {
    let text = fs::read_to_string(&args.script)
        .with_context(|| format!("reading {}", args.script.display()))?;
    let mut guest = Guest::new(&args.job, text);
    if args.virtual_time {
        guest = guest.virtual_time();
    }
    for image in &args.disk {
        guest = guest.disk(image);
    }
    let mut running = guest.start(&machine(args.qemu, false)?)?;
    let until = Instant::now() + Duration::from_secs(args.limit);
    let mut exit: Option<u8> = None;
    while let Some(line) = running.line(until.saturating_duration_since(Instant::now()))? {
        println!("{line}");
        if let Some(code) = line.strip_prefix("guest: exit ") {
            exit = code.parse().ok();
        }
    }
    match exit {
        Some(code) => Ok(ExitCode::from(code)),
        None => bail!("the guest ended without a word"),
    }
}
