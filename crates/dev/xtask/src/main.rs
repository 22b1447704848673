//! `cargo xtask VERB`: what a newcomer and the build machine type; each verb installs the
//! system packages that it needs.
//!
//! Early: this program compiles before any system package is there, because it installs them.
//! Late: a verb may be run again at any time; what is already done is not done twice. At a gap
//! (no network, no Python index, no optional tool) the verb says what it leaves out and why. At
//! the end: exit code 0 fine, 1 failed, 2 bad arguments, 3 finished with loss. On failure: one
//! message that names the step, what was found, and what to do.
#![expect(
    clippy::disallowed_methods,
    reason = "a developer tool tells people how long each step took; no logic here depends on time"
)]

mod args;
mod bench;
mod deb;
mod demo;
mod fuzz;
mod guide;
mod process;
mod schemas;
mod setup;
mod test;
mod tidy;
mod vm;
mod wheel;

use std::process::ExitCode;

use args::Verb;
use setup::Purpose;

/// The exit code of a program that did all it was to do and says that something is missing.
const WITH_LOSS: u8 = 3;

/// How a verb ended that could do its work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ending {
    Whole,
    /// Something recorded is missing, or was judged unfit.
    WithLoss,
}

fn main() -> ExitCode {
    let verb = match args::parse(std::env::args_os().skip(1)) {
        Ok(verb) => verb,
        Err(message) => {
            eprintln!("{message}");
            return ExitCode::from(2);
        }
    };
    match run(verb) {
        Ok(Ending::Whole) => ExitCode::SUCCESS,
        Ok(Ending::WithLoss) => ExitCode::from(WITH_LOSS),
        Err(error) => {
            eprintln!("\nfailed: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(verb: Verb) -> anyhow::Result<Ending> {
    let done = match verb {
        Verb::Demo {
            install,
            seconds,
            folder,
        } => return demo::run(install, seconds, folder),
        Verb::Help => {
            print!("{}", args::HELP);
            Ok(())
        }
        Verb::Setup { install } => setup::system_packages(
            &[
                Purpose::Build,
                Purpose::Video,
                Purpose::Graphics,
                Purpose::Interoperability,
            ],
            install,
        ),
        Verb::Test { install, quick } => test::run(install, quick),
        Verb::Bench {
            install,
            names,
            arguments,
        } => bench::run(install, &names, &arguments),
        Verb::VmTest {
            install,
            quick,
            qemu,
            cached,
            names,
        } => vm::run(install, quick, qemu, cached, None, &names).map(|_| ()),
        Verb::Schemas => schemas::run(),
        Verb::Tidy { mode } => tidy::run(mode),
        Verb::Guide { install } => guide::whole(install),
        Verb::Fuzz { install, seconds } => fuzz::run(install, seconds),
        Verb::Wheel { install, out } => wheel::run(install, out),
        Verb::Deb {
            install,
            architecture,
            out,
            check,
        } => deb::run(install, architecture, out, check),
    };
    done.map(|()| Ending::Whole)
}
