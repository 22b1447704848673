//! The command line of `paws`.
//!
//! Bad arguments end with exit code 2, as does a verb that is neither known here nor a program
//! `paws-VERB`. Everything else ends with an [`Outcome`].

use std::ffi::OsString;
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Result;
use clap::{CommandFactory, Parser, Subcommand};
use session_archive::text::shown_lines;

use crate::calibrate;
use crate::console::{Clock, Console, Show};
use crate::export::{self, Format};
use crate::limits::Limits;
use crate::outcome::Outcome;
use crate::target::Target;
use crate::{
    external, handoff, importing, indexing, list, prune, pull, rebuild, recover, reporting, rig,
    show, validate,
};

/// Names the library when `--library` does not.
pub const LIBRARY_VARIABLE: &str = "PAWS_LIBRARY";

/// Import, validate, index, export and hand over recorded sessions.
#[derive(Debug, Parser)]
#[command(name = "paws", version, arg_required_else_help = true, after_help = AFTER)]
struct Cli {
    /// Folder of the library [default: what PAWS_LIBRARY names]
    #[arg(long, global = true, value_name = "DIR")]
    library: Option<PathBuf>,
    #[command(subcommand)]
    verb: Verb,
}

const AFTER: &str = "\
SESSION is an identifier of the library, the beginning of one, the name of a session, or a folder.
`paws X` starts the program paws-X found beside paws or on PATH.
Exit codes: 0 fine, 1 failed, 2 bad arguments, 3 finished with loss.";

#[derive(Debug, Subcommand)]
enum Verb {
    /// Copy sessions into the library, checked and on disk
    Import {
        /// Session folders, or folders and mounted disks to search for sessions
        #[arg(required = true, value_name = "SRC")]
        sources: Vec<PathBuf>,
    },
    /// Fetch sessions from a rig over the network, checked and on disk
    Pull {
        /// The rig, as in https://RIG:8077
        #[arg(value_name = "RIG")]
        rig: String,
        /// Sessions of the rig: names or identifiers, or beginnings of them [default: all]
        #[arg(value_name = "SESSION")]
        sessions: Vec<String>,
        /// SHA-256 of the rig's certificate, as `pawsd` shows it; needed with https
        #[arg(long, value_name = "AA:BB:..")]
        fingerprint: Option<String>,
        /// File with the token that the rig asks for
        #[arg(long, value_name = "FILE")]
        token_file: Option<PathBuf>,
        /// Sessions at a time
        #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=pull::MAX_JOBS as i64))]
        jobs: u8,
        /// Ask the rig to free what the library holds
        #[arg(long)]
        free: bool,
    },
    /// Judge sessions: PASS, WARN or FAIL, with the reasons
    Validate {
        /// Sessions
        #[arg(required = true, value_name = "SESSION")]
        sessions: Vec<String>,
        /// Decode every picture, and see whether the calibration is still true
        #[arg(long)]
        deep: bool,
        /// Set a limit: METRIC=WARN,FAIL in the unit of the report (ratio, ns, count or deg), or `never`
        #[arg(long = "limit", value_name = "LIMIT")]
        limits: Vec<String>,
        /// Also write the findings as JSON
        #[arg(long, value_name = "FILE")]
        json: Option<PathBuf>,
        /// Also write the report as one HTML page
        #[arg(long, value_name = "FILE")]
        html: Option<PathBuf>,
    },
    /// Make the index that gives random access to every frame
    Index {
        /// Sessions
        #[arg(required = true, value_name = "SESSION")]
        sessions: Vec<String>,
    },
    /// Seal a session for whoever works on it next
    Handoff {
        /// The session
        session: String,
        /// Then write its pictures to this folder with paws-reconstruct
        #[arg(long, value_name = "OUTDIR")]
        reconstruct: Option<PathBuf>,
    },
    /// What is in the library
    List,
    /// One session on one screen
    Show {
        /// The session
        session: String,
    },
    /// Make a sound copy of a session that was cut off or damaged
    Recover {
        /// The session
        session: String,
        /// Folder for the copy [default: ID.recovered in the library, or beside the folder]
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
    },
    /// Write the report of a session as one HTML page
    Report {
        /// The session
        session: String,
        /// Decode every picture, and see whether the calibration is still true
        #[arg(long)]
        deep: bool,
        /// The file [default: report.html in the session's folder]
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Write a session in the formats of others
    Export {
        /// The session
        session: String,
        /// The format
        #[arg(long, value_enum)]
        format: Format,
        /// The folder, new or empty
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
    /// Remove derived files and what stopped imports left behind
    Prune {
        /// Remove the session with this whole identifier, recording and all, instead
        #[arg(long, value_name = "ID")]
        session: Option<String>,
        /// Really remove the recording
        #[arg(long, requires = "session")]
        yes: bool,
    },
    /// Build the catalogue anew from the sessions' folders
    Rebuild,
    /// Calibrate from a session
    #[command(subcommand)]
    Calib(calibrate::Command),
    /// Look at rig files, check, compare and convert them
    #[command(subcommand)]
    Rig(rig::RigVerb),
    #[command(external_subcommand)]
    External(Vec<OsString>),
}

/// Runs the program with these arguments, the first being its own name.
pub fn run(arguments: Vec<OsString>) -> ExitCode {
    let filter = env_logger::Env::default().default_filter_or("warn");
    env_logger::Builder::from_env(filter)
        .format(|out, record| {
            writeln!(
                out,
                "{}: {}",
                record.level().as_str().to_lowercase(),
                shown_lines(&record.args().to_string())
            )
        })
        .init();
    let cli = match Cli::try_parse_from(arguments) {
        Ok(cli) => cli,
        Err(e) => {
            // Help goes to standard output and is no error.
            let _ = e.print();
            return ExitCode::from(e.exit_code() as u8);
        }
    };
    if let Verb::External(words) = &cli.verb {
        return external_verb(words);
    }
    let show = if io::stderr().is_terminal() {
        Show::Bar
    } else {
        Show::Lines
    };
    let mut out = io::stdout().lock();
    let mut console = Console {
        out: &mut out,
        show,
        clock: Clock::MACHINE,
    };
    match dispatch(cli, &mut console) {
        Ok(outcome) => outcome.into(),
        Err(e) if is_broken_pipe(&e) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("paws: {e:#}");
            match e.downcast_ref::<BadArguments>() {
                Some(_) => ExitCode::from(2),
                None => Outcome::Failed.into(),
            }
        }
    }
}

/// Marks errors that are about the command line.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct BadArguments(pub(crate) String);

fn dispatch(cli: Cli, console: &mut Console<'_>) -> Result<Outcome> {
    let library = cli.library.or_else(|| {
        std::env::var_os(LIBRARY_VARIABLE)
            .filter(|v| !v.is_empty())
            .map(PathBuf::from)
    });
    let library = library.as_deref();
    let find = |sessions: &[String]| -> Result<Vec<Target>> {
        sessions.iter().map(|s| Target::find(s, library)).collect()
    };
    match cli.verb {
        Verb::Import { sources } => importing::run(&sources, needed(library)?, console),
        Verb::Pull {
            rig,
            sessions,
            fingerprint,
            token_file,
            jobs,
            free,
        } => {
            let options = pull::Options {
                jobs: jobs.into(),
                free,
                sessions,
                ..pull::Options::parse(&rig, fingerprint.as_deref(), token_file)?
            };
            pull::run(&options, needed(library)?, console)
        }
        Verb::Validate {
            sessions,
            deep,
            limits,
            json,
            html,
        } => {
            if sessions.len() > 1 && (json.is_some() || html.is_some()) {
                let what = "--json and --html are for one session at a time";
                return Err(BadArguments(what.to_owned()).into());
            }
            let options = validate::Options {
                deep,
                limits: parse_limits(&limits)?,
                json,
                html,
            };
            validate::run(&find(&sessions)?, &options, console)
        }
        Verb::Index { sessions } => indexing::run(&find(&sessions)?, console),
        Verb::Handoff {
            session,
            reconstruct,
        } => {
            let target = Target::find(&session, library)?;
            handoff::run(&target, reconstruct.as_deref(), console)
        }
        Verb::List => list::run(needed(library)?, console),
        Verb::Show { session } => show::run(&Target::find(&session, library)?, console),
        Verb::Recover { session, out } => {
            let target = Target::find(&session, library)?;
            recover::run(&target, out.as_deref(), console)
        }
        Verb::Report { session, deep, out } => {
            let options = validate::Options {
                deep,
                ..validate::Options::default()
            };
            let target = Target::find(&session, library)?;
            reporting::run(&target, &options, out.as_deref(), console)
        }
        Verb::Export {
            session,
            format,
            out,
        } => export::run(&Target::find(&session, library)?, format, &out, console),
        Verb::Prune { session: None, .. } => prune::derived(needed(library)?, console),
        Verb::Prune {
            session: Some(session),
            yes,
        } => prune::session(needed(library)?, &session, yes, console),
        Verb::Rebuild => rebuild::run(needed(library)?, console),
        Verb::Calib(command) => calibrate::run(&command, library, console),
        Verb::Rig(verb) => rig::run(&verb, console),
        Verb::External(_) => Ok(Outcome::Failed),
    }
}

fn needed(library: Option<&Path>) -> Result<&Path> {
    library
        .ok_or_else(|| {
            BadArguments(format!(
                "which library? say --library DIR, or set {LIBRARY_VARIABLE}"
            ))
        })
        .map_err(Into::into)
}

fn parse_limits(texts: &[String]) -> Result<Limits> {
    let mut limits = Limits::default();
    for text in texts {
        limits.set(text).map_err(|e| BadArguments(e.to_string()))?;
    }
    Ok(limits)
}

/// Becomes `paws-VERB`, or names the nearest verb.
fn external_verb(words: &[OsString]) -> ExitCode {
    let name = words.first().map(|w| w.to_string_lossy().into_owned());
    let name = name.unwrap_or_default();
    if let Some(program) = external::program(&name) {
        let error = external::become_program(&program, &words[1..]);
        eprintln!("paws: starting {}: {error}", program.display());
        return Outcome::Failed.into();
    }
    let command = Cli::command();
    let verbs = command.get_subcommands().map(|c| c.get_name());
    let nearest = verbs
        .map(|verb| (strsim::damerau_levenshtein(verb, &name), verb))
        .min();
    let hint = match nearest {
        Some((distance, verb)) if distance <= verb.len() / 2 => format!("; did you mean {verb}?"),
        _ => "; `paws --help` lists the verbs".to_owned(),
    };
    eprintln!(
        "paws: {name:?} is no verb, and no program paws-{name} is beside paws or on PATH{hint}"
    );
    ExitCode::from(2)
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        cause
            .downcast_ref::<io::Error>()
            .is_some_and(|e| e.kind() == io::ErrorKind::BrokenPipe)
    })
}
