//! `pawsd`: the recorder on the body, and the commands that control it.
//!
//! Exit codes: 0 fine, 1 failed, 2 wrong arguments or configuration, 3 recorded with loss.
//! Requested output goes to standard output, everything else to standard error.

use std::fmt::Display;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use capture_daemon::announce::STEP;
use capture_daemon::check::{Finding, Level, check as findings_of, usb_budget};
use capture_daemon::config::{Config, ConfigError, DEFAULT_SOCKET};
use capture_daemon::control::{self, screen};
use capture_daemon::recorder::OnProgress;
use capture_daemon::run::{self, RecordOptions, StopFlag};
use capture_daemon::status::{Progress, Request, Response, State, Status};
use capture_daemon::{devices, selftest};
use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use command_line::output::is_broken_pipe;
use command_line::{Papers, Verbosity, complain, output};
use log::LevelFilter;
use serde::Serialize;
use session_archive::text::{NoteError, Screen, check_note};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use video::{discover, encoder};

mod examples;

/// All messages to people pass here: foreign names must not act on a terminal.
macro_rules! eprintln {
    ($($words:tt)*) => {
        complain!("{}", session_archive::text::shown_lines(&format!($($words)*)))
    };
}

mod printer;

use printer::{Lines, Printer, Priority};

const DEFAULT_CONFIG: &str = "/etc/paws/pawsd.toml";
/// Maximum length of a recording, s: a week.
const MAX_SECONDS: f64 = 7.0 * 86_400.0;

const FIRST_STEPS: &str = "\
First steps:
  pawsd devices                                              what is plugged in
  pawsd check  --config pawsd.toml                           what is wrong with the configuration
  pawsd record --config pawsd.toml --out DIR --seconds 10    one recording
  pawsd run    --config pawsd.toml                           the daemon, for `pawsd start` and `pawsd stop`

deploy/pawsd.toml is a configuration that works without a camera and explains every setting. The service reads
/etc/paws/pawsd.toml, writes sessions to /var/lib/paws and is controlled through /run/paws/pawsd.sock, which members
of the group `paws` may use.
Exit codes: 0 fine, 1 failed, 2 wrong arguments or configuration, 3 recorded with loss.";

/// Records stereo cameras and their IMUs into crash-safe sessions.
#[derive(Parser)]
#[command(name = "pawsd", version, after_help = FIRST_STEPS)]
struct Cli {
    #[command(flatten)]
    verbosity: Verbosity,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Report everything that is wrong with a configuration on this machine
    Check {
        #[command(flatten)]
        config: ConfigArgs,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Make one recording: it starts immediately and ends on its own or by SIGINT or SIGTERM
    Record(RecordArgs),
    /// Run the daemon: it waits for `start` and `stop`
    Run(ConfigArgs),
    /// Start recording; prints the session's folder
    Start {
        /// Name of the session
        #[arg(long, default_value = "")]
        name: String,
        #[command(flatten)]
        control: ControlArgs,
    },
    /// Stop recording and keep the session; prints its folder
    Stop(ControlArgs),
    /// Mark this instant in the session
    Mark {
        /// Text of the mark
        #[arg(default_value = "")]
        text: String,
        #[command(flatten)]
        control: ControlArgs,
    },
    /// Stop recording and delete the session
    Discard(ControlArgs),
    /// Show the state of the daemon
    Status {
        /// As JSON, in one line
        #[arg(long)]
        json: bool,
        #[command(flatten)]
        control: ControlArgs,
    },
    /// List cameras, IMUs, buttons and lights with their capabilities and problems
    Devices {
        /// As JSON
        #[arg(long)]
        json: bool,
        /// Also report whether the cameras of this configuration fit on their USB controllers
        #[arg(long, value_name = "FILE")]
        config: Option<PathBuf>,
    },
    /// Try everything once, and write a report to send back
    Selftest {
        #[command(flatten)]
        config: ConfigArgs,
        /// Length of the recording
        #[arg(long, value_name = "SECONDS", value_parser = parse_seconds, default_value = "10")]
        seconds: f64,
        /// Path of the report; must not exist yet
        #[arg(long, value_name = "FILE", default_value = "pawsd-selftest.txt")]
        report: PathBuf,
    },
    /// Show the fingerprint of the phone page's certificate
    Fingerprint(ConfigArgs),
    /// Try the video encoders of this machine
    Encoders {
        /// Size of the stereo frame, both eyes, pixels
        #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = parse_size, default_value = "1344x376")]
        size: (u32, u32),
    },
    #[command(flatten)]
    Papers(Papers),
}

#[derive(Args)]
struct ConfigArgs {
    /// Configuration
    #[arg(long, value_name = "FILE", default_value = DEFAULT_CONFIG)]
    config: PathBuf,
}

#[derive(Args)]
struct RecordArgs {
    #[command(flatten)]
    config: ConfigArgs,
    /// Folder in which the session's folder is created; without, the one in the configuration
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Length of the recording
    #[arg(long, value_name = "SECONDS", value_parser = parse_seconds)]
    seconds: f64,
    /// As fast as the machine can, dropping nothing, with the same bytes each time
    #[arg(long = "virtual")]
    virtual_time: bool,
    /// Progress as JSON lines on standard output; the last one names the session's folder
    #[arg(long)]
    json: bool,
    /// Name of the session
    #[arg(long, default_value = "")]
    name: String,
}

#[derive(Args)]
struct ControlArgs {
    /// Control socket of the daemon [default: /run/paws/pawsd.sock]
    #[arg(long, value_name = "PATH")]
    socket: Option<PathBuf>,
    /// Configuration of the daemon, which names its control socket
    #[arg(long, value_name = "FILE", conflicts_with = "socket")]
    config: Option<PathBuf>,
}

impl ControlArgs {
    fn socket(&self) -> Result<PathBuf, ConfigError> {
        Ok(match (&self.socket, &self.config) {
            (Some(socket), _) => socket.clone(),
            (None, Some(config)) => Config::read(config)?.control.socket,
            (None, None) => DEFAULT_SOCKET.into(),
        })
    }
}

/// Usage error: the command line cannot be executed as given.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Usage(&'static str);

fn main() -> ExitCode {
    // Bad arguments end here, with 2.
    let cli = Cli::from_arg_matches(&command().get_matches()).unwrap_or_else(|error| error.exit());
    let stderr = match Printer::start(io::stderr()) {
        Ok(printer) => printer,
        Err(error) => {
            complain!("pawsd: {error:#}");
            return ExitCode::FAILURE;
        }
    };
    let is_daemon = matches!(cli.command, Command::Run(_));
    log_to(stderr.lines(), is_daemon, cli.verbosity);
    let done = match cli.command {
        Command::Check { config, json } => check(&config.config, json),
        Command::Record(args) => check_note(&args.name)
            .map_err(Into::into)
            .and_then(|()| record(&args, stderr.lines())),
        Command::Run(args) => daemon(&args.config),
        Command::Start { name, control } => {
            send_request(&control, &Request::Start { name }, print_session)
        }
        Command::Stop(control) => send_request(&control, &Request::Stop, print_session),
        Command::Mark { text, control } => {
            send_request(&control, &Request::Mark { text, at: None }, |_| Ok(()))
        }
        Command::Discard(control) => send_request(&control, &Request::Discard, |_| Ok(())),
        Command::Status { json, control } => send_request(&control, &Request::Status, |status| {
            let text = if json {
                serde_json::to_string(status)?
            } else {
                screen::status(status)
            };
            print(text.trim_end())
        }),
        Command::Devices { json, config } => devices(json, config.as_deref()),
        Command::Selftest {
            config,
            seconds,
            report,
        } => selftest(&config.config, seconds, &report),
        Command::Fingerprint(args) => Config::read(&args.config)
            .map_err(Into::into)
            .and_then(|config| run::fingerprint(&config))
            .and_then(print)
            .map(|()| ExitCode::SUCCESS),
        Command::Encoders { size } => encoders(size),
        Command::Papers(papers) => papers
            .write(command(), &mut io::stdout())
            .map(|()| ExitCode::SUCCESS),
    };
    stderr.finish();
    done.unwrap_or_else(|error| {
        if is_broken_pipe(&error) {
            return ExitCode::SUCCESS;
        }
        eprintln!("pawsd: {error:#}");
        let is_wrong_input =
            error.is::<Usage>() || error.is::<ConfigError>() || error.is::<NoteError>();
        ExitCode::from(if is_wrong_input { 2 } else { 1 })
    })
}

/// The command line with its examples.
fn command() -> clap::Command {
    command_line::examples::add(Cli::command(), examples::EXAMPLES)
}

fn log_to(stderr: Lines, daemon: bool, verbosity: Verbosity) {
    let usual = match daemon {
        true => LevelFilter::Info,
        false => LevelFilter::Warn,
    };
    let mut logger = verbosity.logger(usual);
    if !verbosity.is_quiet() {
        logger.filter_module(STEP, LevelFilter::Info);
    }
    logger.target(env_logger::Target::Pipe(Box::new(stderr)));
    // The journal has its own timestamps.
    let has_times = std::env::var_os("JOURNAL_STREAM").is_none();
    logger.format(move |out, record| {
        let (level, target, text) = (record.level(), record.target(), record.args());
        let time = out.timestamp_seconds();
        match (target == STEP, has_times) {
            (true, _) => writeln!(out, "{text}"),
            (false, true) => writeln!(out, "[{time} {level:5} {target}] {text}"),
            (false, false) => writeln!(out, "[{level:5} {target}] {text}"),
        }
    });
    logger.init();
}

/// Output of `check --json`; docs/reference/command-line.md lists the fields.
#[derive(Serialize)]
struct CheckOutput<'a> {
    format: &'static str,
    version: u32,
    config: &'a Path,
    errors: usize,
    warnings: usize,
    findings: &'a [Finding],
}

fn check(path: &Path, json: bool) -> anyhow::Result<ExitCode> {
    let findings = findings_of(&Config::read(path)?);
    let count = |level| {
        findings
            .iter()
            .filter(|finding| finding.level == level)
            .count()
    };
    let (errors, warnings) = (count(Level::Error), count(Level::Warning));
    if json {
        print(serde_json::to_string_pretty(&CheckOutput {
            format: "pawsd-check",
            version: 1,
            config: path,
            errors,
            warnings,
            findings: &findings,
        })?)?;
        return Ok(ExitCode::from(u8::from(errors > 0)));
    }
    for finding in &findings {
        print(finding)?;
    }
    let some = |count, what| format!("{count} {what}{}", if count == 1 { "" } else { "s" });
    let (errors_text, warnings_text) = (some(errors, "error"), some(warnings, "warning"));
    print(format_args!(
        "\n{errors_text}, {warnings_text}: {}",
        path.display()
    ))?;
    Ok(ExitCode::from(u8::from(errors > 0)))
}

/// 0: no problem; 1: at least one.
fn devices(json: bool, config: Option<&Path>) -> anyhow::Result<ExitCode> {
    let config = config.map(Config::read).transpose()?;
    let inventory = devices::inventory();
    let mut is_wrong = inventory.has_problems();
    if json {
        print(serde_json::to_string_pretty(&inventory)?)?;
    } else {
        print(inventory.to_string().trim_end())?;
    }
    for finding in config.as_ref().map(usb_budget).unwrap_or_default() {
        is_wrong |= finding.level == Level::Error;
        print(finding)?;
    }
    Ok(ExitCode::from(u8::from(is_wrong)))
}

/// 0: everything works; 1: something does not.
fn selftest(path: &Path, seconds: f64, report: &Path) -> anyhow::Result<ExitCode> {
    let config = Config::read(path)?;
    let folder = config
        .session
        .out
        .clone()
        .ok_or(Usage("no folder for the recording; set out in [session]"))?;
    if std::os::unix::net::UnixStream::connect(&config.control.socket).is_ok() {
        anyhow::bail!(
            "the daemon has the cameras, and its recording would feel a test beside it: stop it first, as with \
             `systemctl stop pawsd`: {}",
            config.control.socket.display()
        );
    }
    // First, so that no work is wasted.
    let mut file = std::fs::File::create_new(report)
        .with_context(|| format!("creating the report {}", report.display()))?;
    if !output::is_quiet() {
        complain!("this takes about {:.0} s", seconds + 15.0);
    }
    let done = selftest::run(&config, &folder, seconds, &stop_on_signals()?);
    file.write_all(done.text.as_bytes())
        .with_context(|| format!("writing the report {}", report.display()))?;
    print(done.text.trim())?;
    print(format_args!("\nThe report is in {}", report.display()))?;
    Ok(ExitCode::from(u8::from(!done.failures.is_empty())))
}

fn record(args: &RecordArgs, stderr: Lines) -> anyhow::Result<ExitCode> {
    let config = Config::read(&args.config.config)?;
    let out = args.out.clone().or_else(|| config.session.out.clone());
    let options = RecordOptions {
        seconds: args.seconds,
        virtual_time: args.virtual_time,
        name: args.name.clone(),
        out: out.ok_or(Usage(
            "where do sessions go? Give --out DIR, or set out in [session]",
        ))?,
    };
    let stop = stop_on_signals()?;
    let stdout = args
        .json
        .then(|| Printer::start(io::stdout()))
        .transpose()?;
    let json = stdout.as_ref().map(Printer::lines);
    let finished = run::record(&config, &options, &stop, report_progress(stderr, json))?;
    if let Some(stdout) = stdout {
        stdout.finish();
    }
    if !args.json {
        unless_closed(print(finished.session.display()))?;
    }
    let is_whole = finished.missing == 0 && finished.absent.is_empty();
    Ok(ExitCode::from(match (finished.error, is_whole) {
        (Some(_), _) => 1,
        (None, true) => 0,
        (None, false) => 3,
    }))
}

/// A reader that has closed the pipe does not change the result: the exit code reports it.
fn unless_closed(printed: anyhow::Result<()>) -> anyhow::Result<()> {
    match printed {
        Err(error) if is_broken_pipe(&error) => Ok(()),
        printed => printed,
    }
}

fn daemon(path: &Path) -> anyhow::Result<ExitCode> {
    let config = Config::read(path)?;
    if config.session.out.is_none() {
        return Err(Usage("where do sessions go? Set out in [session]").into());
    }
    run::daemon(&config, &stop_on_signals()?)?;
    Ok(ExitCode::SUCCESS)
}

/// Lines for people, and for programs if requested. A recording continues without readers.
fn report_progress(people: Lines, programs: Option<Lines>) -> OnProgress {
    let mut narrator = screen::ProgressText::default();
    let is_quiet = output::is_quiet();
    Box::new(move |progress: Progress| {
        let priority = match progress {
            Progress::Durable { .. } => Priority::Routine,
            Progress::Started { .. } | Progress::Alarm { .. } => Priority::Event,
            Progress::Finished { .. } => Priority::Final,
        };
        let is_failure = matches!(
            progress,
            Progress::Alarm { active: true, .. } | Progress::Finished { error: Some(_), .. }
        );
        if let Some(line) = narrator.line(&progress)
            && (is_failure || !is_quiet)
        {
            people.print_line(&line, priority);
        }
        if let Some(programs) = &programs
            && let Ok(line) = serde_json::to_string(&progress)
        {
            programs.print_line(&line, priority);
        }
    })
}

/// A flag that is set by the first SIGINT, SIGTERM or SIGHUP (the terminal was closed). The second
/// one ends the program as if it did not handle them, in case it is stuck.
fn stop_on_signals() -> anyhow::Result<StopFlag> {
    let stop = StopFlag::new();
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP]).context("taking over signals")?;
    let flag = stop.clone();
    std::thread::Builder::new()
        .name("signals".into())
        .spawn(move || {
            for signal in &mut signals {
                if flag.is_set() {
                    let _ = signal_hook::low_level::emulate_default_handler(signal);
                }
                flag.set();
                let _ = writeln!(io::stderr(), "stopping; the same again breaks off");
            }
        })
        .context("starting the thread for signals")?;
    Ok(stop)
}

fn send_request(
    control: &ControlArgs,
    request: &Request,
    show: impl Fn(&Status) -> anyhow::Result<()>,
) -> anyhow::Result<ExitCode> {
    request.check()?;
    match control::request(&control.socket()?, request)? {
        Response::Ok { status } => {
            unless_closed(show(&status))?;
            if matches!(request, Request::Start { .. }) {
                status
                    .notes
                    .iter()
                    .for_each(|note| eprintln!("note: {note}"));
            }
            if *request != Request::Stop {
                return Ok(ExitCode::SUCCESS);
            }
            if status.state == State::Fault {
                for alarm in &status.alarms {
                    complain!("pawsd: {alarm}");
                }
            }
            Ok(ExitCode::from(code_of_stop(&status)))
        }
        Response::Error { message } => anyhow::bail!(message),
    }
}

/// Exit code of a stop: whether the recording is complete.
fn code_of_stop(status: &Status) -> u8 {
    match status.state {
        State::Fault => 1,
        // A stream without samples is as bad as one with gaps.
        _ if status
            .streams
            .iter()
            .any(|s| s.missing > 0 || s.stored == 0) =>
        {
            3
        }
        _ => 0,
    }
}

fn print_session(status: &Status) -> anyhow::Result<()> {
    match &status.session {
        Some(session) => print(session.display()),
        None => Ok(()),
    }
}

fn encoders((width, height): (u32, u32)) -> anyhow::Result<ExitCode> {
    let mut works = false;
    print(format_args!(
        "{:<15}{:<7}at {width}x{height}, one thread",
        "encoder", "codec"
    ))?;
    for element in encoder::known_elements() {
        let (codec, result) = match discover::trial(element, width, height) {
            Ok(trial) => {
                let preferred = if works { "" } else { ", preferred" };
                works = true;
                (
                    trial.codec.to_string(),
                    format!("{:.0} frames/s{preferred}", trial.frames_per_s),
                )
            }
            Err(reason) => (String::new(), reason.to_string()),
        };
        print(format_args!("{element:<15}{codec:<7}{result}"))?;
    }
    Ok(ExitCode::from(u8::from(!works)))
}

/// Prints one line to standard output immediately.
fn print(line: impl Display) -> anyhow::Result<()> {
    let mut out = Screen(io::stdout().lock());
    writeln!(out, "{line}")
        .and_then(|()| out.flush())
        .context("writing to standard output")
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if seconds > 0.0 && seconds <= MAX_SECONDS => Ok(seconds),
        _ => Err(format!(
            "expected a number above 0 and at most {MAX_SECONDS}"
        )),
    }
}

fn parse_size(text: &str) -> Result<(u32, u32), String> {
    text.split_once('x')
        .and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)))
        .ok_or_else(|| "expected a width and a height like 1344x376".to_owned())
}

#[cfg(test)]
mod tests {
    use capture_daemon::status::{MachineStatus, StreamStatus};

    use super::*;

    #[test]
    fn every_command_has_examples_that_parse() {
        command().debug_assert();
        let wrong = command_line::examples::check(&command());
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }

    /// Both crates have the rule, because neither depends on the other.
    #[test]
    fn messages_and_recorded_names_are_escaped_alike() {
        for c in '\0'..=char::MAX {
            let text = c.to_string();
            let message = output::harmless(&text);
            assert_eq!(message, session_archive::text::shown_lines(&text), "{c:?}");
        }
    }

    #[test]
    fn every_help_lists_words_and_names_units() {
        let wrong = command_line::help::check(&command());
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }

    #[test]
    fn stop_exit_code_reports_completeness() {
        let code = |state, stored, missing| {
            code_of_stop(&Status {
                state,
                session: None,
                seconds: 1.0,
                durable_until: None,
                streams: vec![StreamStatus {
                    stored,
                    missing,
                    ..StreamStatus::default()
                }],
                free_bytes: None,
                seconds_left: None,
                alarms: Vec::new(),
                notes: Vec::new(),
                concerns: Default::default(),
                encoders: Vec::new(),
                machine: MachineStatus::default(),
                degradation: String::new(),
            })
        };
        assert_eq!(code(State::Armed, 9, 0), 0);
        assert_eq!(code(State::Armed, 9, 2), 3);
        assert_eq!(code(State::Armed, 0, 0), 3, "nothing came of it");
        assert_eq!(code(State::Fault, 9, 0), 1);
        assert_eq!(code(State::Fault, 9, 2), 1);
    }
}
