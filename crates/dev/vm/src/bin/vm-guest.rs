//! `vm-guest`: what scripts in a guest need and no shell has.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};

use anyhow::{Context as _, Result};
use clap::Parser;
use serde_json::json;
use vm::device_mapper::Device;
use vm::exam::{self, Contents, ExamResult, Promise};
use vm::marks::{Mark, TICK};

/// What scripts in a guest need and no shell has.
#[derive(Parser)]
#[command(name = "vm-guest")]
enum Cli {
    /// Run a recorder and mark what it says, on the console or in a log of writes
    Pump {
        /// Device of dm-log-writes; without, marks go to standard output
        #[arg(long)]
        device: Option<String>,
        /// `pawsd record --json ...`
        #[arg(last = true, required = true)]
        recorder: Vec<String>,
    },
    /// Examine what is left in folders of sessions, one line of JSON for each line of standard
    /// input: "IMAGE STARTED MESSAGES"; each image is mounted on the folder
    Exam {
        /// The whole recording
        #[arg(long)]
        reference: Option<PathBuf>,
        /// Where to mount
        #[arg(long, default_value = "/run/archive")]
        on: PathBuf,
    },
}

fn main() -> ExitCode {
    let done = match Cli::parse() {
        Cli::Pump { device, recorder } => pump(device.as_deref(), &recorder),
        Cli::Exam { reference, on } => exam(reference.as_deref(), &on),
    };
    done.unwrap_or_else(|error| {
        eprintln!("vm-guest: {error:#}");
        ExitCode::FAILURE
    })
}

fn pump(device: Option<&str>, recorder: &[String]) -> Result<ExitCode> {
    let device = device
        .map(Device::open)
        .transpose()
        .context("opening the device mapper")?;
    let put = |mark: Mark| match &device {
        Some(device) => device
            .send(&format!("mark {mark}"))
            .with_context(|| format!("marking {mark}")),
        None => writeln!(std::io::stdout(), "{mark}").context("writing to standard output"),
    };
    let (program, arguments) = recorder.split_first().context("no recorder")?;
    let mut child = Command::new(program)
        .args(arguments)
        .stdout(Stdio::piped())
        .spawn()
        .with_context(|| format!("starting {program}"))?;
    let output = child.stdout.take().context("no output to read")?;
    let (to, said) = sync_channel(64);
    std::thread::spawn(move || {
        for line in BufReader::new(output).lines().map_while(Result::ok) {
            if to.send(line).is_err() {
                return;
            }
        }
    });
    loop {
        match said.recv_timeout(TICK) {
            Ok(line) => {
                if let Some(mark) = Mark::of_progress(&line) {
                    put(mark)?;
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
        put(Mark::Now(now()))?;
    }
    let status = child.wait()?;
    Ok(ExitCode::from(status.code().unwrap_or(1) as u8))
}

#[expect(
    clippy::disallowed_methods,
    reason = "this is the clock that is marked"
)]
fn now() -> i64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    time.tv_sec * 1_000_000_000 + time.tv_nsec
}

/// One image after the other. An image that cannot be mounted or fails is a line like any other.
fn exam(reference: Option<&Path>, on: &Path) -> Result<ExitCode> {
    let reference = reference.map(Contents::read).transpose()?;
    let scratch = Path::new("/dev/shm/recovered");
    for line in std::io::stdin().lines() {
        let line = line.context("reading standard input")?;
        let words: Vec<&str> = line.split_whitespace().collect();
        let [image, started, messages] = words[..] else {
            anyhow::bail!("found {line:?}, expected IMAGE STARTED MESSAGES");
        };
        let promise = Promise {
            started: started.parse().context("STARTED")?,
            messages: messages.parse().context("MESSAGES")?,
        };
        let found = mounted(Path::new(image), on, |repaired| {
            let found = exam::examine(on, reference.as_ref(), promise, scratch)?;
            Ok(ExamResult { repaired, ..found })
        });
        let _ = std::fs::remove_dir_all(scratch);
        let said = match found {
            Ok(found) => json!({ "found": found }),
            Err(error) => json!({ "error": format!("{error:#}") }),
        };
        println!("{said}");
    }
    Ok(ExitCode::SUCCESS)
}

/// Does something while an image is mounted; the kernel replays its journal. One that cannot be
/// mounted is repaired as a person would, which is reported to `work`.
fn mounted<T>(image: &Path, on: &Path, work: impl FnOnce(bool) -> Result<T>) -> Result<T> {
    std::fs::create_dir_all(on)?;
    let mount = || {
        run(Command::new("mount")
            .args(["-o", "loop"])
            .arg(image)
            .arg(on))
    };
    let first = mount();
    let repaired = first.is_err();
    if let Err(error) = first {
        // Its exit code is 1 when it has mended something; whether it has is for the second mount
        // to tell.
        let _ = run(Command::new("e2fsck").arg("-fy").arg(image));
        mount().map_err(|_| error.context("mounting after the power cut"))?;
    }
    let done = work(repaired);
    run(Command::new("umount").arg(on))?;
    done
}

fn run(command: &mut Command) -> Result<()> {
    let output = command
        .stdin(Stdio::null())
        .output()
        .with_context(|| format!("starting {command:?}"))?;
    anyhow::ensure!(
        output.status.success(),
        "{command:?} ended with {}: {}",
        output.status,
        String::from_utf8_lossy(&output.stderr).trim()
    );
    Ok(())
}
