//! The command line of `paws`. Every command has examples in `examples`.
//!
//! Invalid arguments end with exit code 2, as does a command that is neither built in nor a program
//! `paws-COMMAND`. Everything else ends with an [`Outcome`].

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Result;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use command_line::{Papers, Verbosity, complain};
use console_output::{BadArguments, Console, Outcome, run_command, start_logger};
use session_archive::handoff::Verdict;
use session_health::Limits;

use crate::commands::export::Format;
use crate::commands::{
    export, handoff, import, index, list, metrics, prune, pull, rebuild, recover, report, rig,
    show, validate,
};
use crate::examples::EXAMPLES;
use crate::external;
use crate::forwarding::forward_arguments;
use crate::target::Target;

/// Environment variable with the library's folder, used without `--library`.
pub const LIBRARY_VARIABLE: &str = "PAWS_LIBRARY";

/// Placeholder for standard output where a file could be named.
const STDOUT: &str = "-";

/// Import, validate, index, export and hand over recorded sessions.
#[derive(Debug, Parser)]
#[command(name = "paws", version, arg_required_else_help = true, after_help = AFTER)]
struct Cli {
    /// Folder of the library [default: what PAWS_LIBRARY names]
    #[arg(long, global = true, value_name = "DIR")]
    library: Option<PathBuf>,
    #[command(flatten)]
    verbosity: Verbosity,
    #[command(subcommand)]
    verb: Verb,
}

const AFTER: &str = "\
SESSION is `latest` (the newest of the library), an identifier of the library or the beginning of one, the name
of a session or of the folder it was imported from, or the path of a session's folder. `paws calib cameras SESSION`
and `paws reconstruct run SESSION` take the same.
Exit codes: 0 fine, 1 failed, 2 bad arguments, 3 finished with loss.";

#[derive(Debug, Subcommand)]
enum Verb {
    /// Copy sessions into the library, checked and on disk
    Import {
        /// Session folders, or folders and mounted disks to search for sessions
        #[arg(required = true, value_name = "SRC")]
        sources: Vec<PathBuf>,
        /// Print one line of JSON per session
        #[arg(long)]
        json: bool,
    },
    /// Fetch sessions from a rig over the network, checked and on disk
    Pull {
        /// The rig, as in https://RIG:8077
        #[arg(value_name = "RIG")]
        rig: String,
        /// Sessions of the rig: names or identifiers, or beginnings of them, or `latest` [default:
        /// all]
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
    /// Validate sessions: PASS, WARN or FAIL, with the reasons
    Validate {
        /// Sessions
        #[arg(required_unless_present = "metrics", value_name = "SESSION")]
        sessions: Vec<String>,
        /// List the metrics and their limits instead; with --json as a JSON array
        #[arg(long, conflicts_with_all = ["sessions", "deep", "limits", "html"])]
        metrics: bool,
        /// Decode every image, and check that the calibration still holds
        #[arg(long)]
        deep: bool,
        /// Set a limit: METRIC=WARN,FAIL in the unit that --metrics names; `never` for one, or
        /// METRIC=never for both
        #[arg(long = "limit", value_name = "LIMIT")]
        limits: Vec<String>,
        /// Also write the findings as JSON
        #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = STDOUT)]
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
    /// Seal a session for the next processing stage
    Handoff {
        /// The session
        session: String,
        /// The worst verdict to hand over with; WARN is handed over without it. The acceptance is
        /// recorded in the hand-off, in scene bundles and in reports
        #[arg(long, value_name = "VERDICT", ignore_case = true, value_parser = acceptable())]
        accept: Option<Verdict>,
        /// Set a limit, as in `paws validate`
        #[arg(long = "limit", value_name = "LIMIT")]
        limits: Vec<String>,
        /// Then write its images to this folder with paws-reconstruct
        #[arg(long, value_name = "OUTDIR")]
        reconstruct: Option<PathBuf>,
    },
    /// List the sessions of the library
    List {
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Show a summary of one session
    Show {
        /// The session
        session: String,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Make an undamaged copy of a session that was cut off or damaged
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
        /// Decode every image, and check that the calibration still holds
        #[arg(long)]
        deep: bool,
        /// The file [default: report.html in the session's folder]
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Export a session to other formats
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
        /// Confirm the removal of the recording
        #[arg(long, requires = "session")]
        yes: bool,
    },
    /// Rebuild the catalogue from the sessions' folders
    Rebuild,
    /// Show, check, compare and convert rig files
    #[command(subcommand)]
    Rig(rig::RigVerb),
    #[command(flatten)]
    Papers(Papers),
    #[command(external_subcommand)]
    External(Vec<OsString>),
}

/// Runs the program with these arguments, the first being its own name.
pub fn run(arguments: Vec<OsString>) -> ExitCode {
    if let Some(code) = help_of_a_program(&arguments) {
        return code;
    }
    let cli = match parse(&arguments, external::listing) {
        Ok(cli) => cli,
        Err(e) => {
            // Help goes to standard output and is no error.
            let _ = e.print();
            return ExitCode::from(e.exit_code() as u8);
        }
    };
    start_logger(cli.verbosity);
    if let Verb::External(words) = &cli.verb {
        return external_verb(words, cli.verbosity, cli.library);
    }
    let verbosity = cli.verbosity;
    run_command("paws", verbosity, |console| dispatch(cli, console))
}

/// Parses the command line. `listing` lists the external programs; it is called for help only,
/// because it reads all folders of PATH.
fn parse(
    arguments: &[OsString],
    listing: impl FnOnce() -> String,
) -> Result<Cli, clap::error::Error> {
    let parsed = match command().try_get_matches_from(arguments) {
        Err(e) if is_help(e.kind()) => command()
            .after_help(format!("{}\n\n{AFTER}", listing()))
            .try_get_matches_from(arguments),
        other => other,
    };
    Cli::from_arg_matches(&parsed?)
}

fn is_help(kind: ErrorKind) -> bool {
    let help = [
        ErrorKind::DisplayHelp,
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand,
    ];
    help.contains(&kind)
}

/// The command line with its examples.
fn command() -> clap::Command {
    command_line::examples::add(Cli::command(), EXAMPLES)
}

/// The library: the one named, else that of the environment.
fn library_of(named: Option<PathBuf>) -> Option<PathBuf> {
    named.or_else(|| {
        std::env::var_os(LIBRARY_VARIABLE)
            .filter(|v| !v.is_empty())
            .map(PathBuf::from)
    })
}

fn dispatch(cli: Cli, console: &mut Console<'_>) -> Result<Outcome> {
    let library = library_of(cli.library);
    let library = library.as_deref();
    let find = |sessions: &[String]| -> Result<Vec<Target>> {
        sessions.iter().map(|s| Target::find(s, library)).collect()
    };
    match cli.verb {
        Verb::Import { sources, json } => import::run_as(&sources, needed(library)?, json, console),
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
            metrics: true,
            json,
            ..
        } => {
            if json.as_ref().is_some_and(|json| json != Path::new(STDOUT)) {
                let what = "--metrics --json goes to standard output and takes no FILE";
                return Err(BadArguments(what.to_owned()).into());
            }
            metrics::run(json.is_some(), console)
        }
        Verb::Validate {
            sessions,
            metrics: false,
            deep,
            limits,
            json,
            html,
        } => {
            if sessions.len() > 1 && (json.is_some() || html.is_some()) {
                let what = "--json and --html are for one session at a time";
                return Err(BadArguments(what.to_owned()).into());
            }
            if json.as_ref().is_some_and(|json| json == Path::new(STDOUT)) {
                let what = "--json needs a FILE to write the findings to";
                return Err(BadArguments(what.to_owned()).into());
            }
            let options = validate::Options {
                deep,
                limits: parse_limits(&limits)?,
                json,
                html,
                calib_program: None,
            };
            validate::run(&find(&sessions)?, &options, console)
        }
        Verb::Index { sessions } => index::run(&find(&sessions)?, console),
        Verb::Handoff {
            session,
            accept,
            limits,
            reconstruct,
        } => {
            let options = handoff::Options {
                accept,
                limits: parse_limits(&limits)?,
                frames: reconstruct,
                calib_program: None,
            };
            handoff::run_with(&Target::find(&session, library)?, &options, console)
        }
        Verb::List { json: true } => list::json(needed(library)?, console),
        Verb::List { json: false } => list::run(needed(library)?, console),
        Verb::Show { session, json } => {
            let target = Target::find(&session, library)?;
            match json {
                true => show::json(&target, console),
                false => show::run(&target, console),
            }
        }
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
            report::run(&target, &options, out.as_deref(), console)
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
        Verb::Rig(verb) => rig::run(&verb, console),
        Verb::Papers(papers) => {
            papers.write(command(), console.out)?;
            Ok(Outcome::Fine)
        }
        Verb::External(_) => Ok(Outcome::Failed),
    }
}

fn needed(library: Option<&Path>) -> Result<&Path> {
    library
        .ok_or_else(|| {
            BadArguments(format!(
                "no library given: use --library DIR, or set {LIBRARY_VARIABLE}"
            ))
        })
        .map_err(Into::into)
}

/// Parser of the verdicts that can be accepted.
fn acceptable() -> impl TypedValueParser<Value = Verdict> {
    PossibleValuesParser::new(["WARN", "FAIL"]).map(|text| {
        match text.eq_ignore_ascii_case("WARN") {
            true => Verdict::Warn,
            false => Verdict::Fail,
        }
    })
}

fn parse_limits(texts: &[String]) -> Result<Limits> {
    let mut limits = Limits::default();
    for text in texts {
        limits.set(text).map_err(|e| BadArguments(e.to_string()))?;
    }
    Ok(limits)
}

/// `paws help X` where X is an external program: shows the program's own help; `paws help X VERB`
/// that of a verb, for programs of the toolkit.
fn help_of_a_program(arguments: &[OsString]) -> Option<ExitCode> {
    let [_, help, name, verbs @ ..] = arguments else {
        return None;
    };
    let name = name.to_str().filter(|_| help == "help")?;
    let is_built_in = Cli::command().find_subcommand(name).is_some();
    if is_built_in || !(verbs.is_empty() || external::is_known(name)) {
        return None;
    }
    let program = external::program(name)?;
    let arguments = [verbs, &[OsString::from("--help")]].concat();
    let error = external::become_program(&program, &arguments);
    complain!("paws: starting {}: {error}", program.display());
    Some(Outcome::Failed.into())
}

/// Executes `paws-COMMAND`, or suggests the nearest command.
fn external_verb(words: &[OsString], verbosity: Verbosity, library: Option<PathBuf>) -> ExitCode {
    let name = words.first().map(|w| w.to_string_lossy().into_owned());
    let name = name.unwrap_or_default();
    if let Some(program) = external::program(&name) {
        let library = library_of(library);
        match forward_arguments(&name, verbosity, &words[1..], library.as_deref()) {
            Ok(words) => {
                let error = external::become_program(&program, &words);
                complain!("paws: starting {}: {error}", program.display());
            }
            Err(error) => complain!("paws: {error:#}"),
        }
        return Outcome::Failed.into();
    }
    if external::is_known(&name) {
        complain!(
            "paws: `paws {name}` is the program paws-{name}, which is neither beside paws nor on PATH; install it there"
        );
        return ExitCode::from(2);
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
    complain!(
        "paws: {name:?} is not a command, and no program paws-{name} is beside paws or on PATH{hint}"
    );
    ExitCode::from(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn programs_are_searched_only_for_help() {
        let words = |text: &str| -> Vec<OsString> { text.split(' ').map(Into::into).collect() };
        for text in ["paws list", "paws lisst", "paws list --wrong"] {
            let _ = parse(&words(text), || panic!("{text}"));
        }
        for text in ["paws", "paws --help", "paws -h", "paws help"] {
            let error = parse(&words(text), || "all programs".to_owned()).unwrap_err();
            let help = error.to_string();
            assert!(help.contains("all programs"), "{text}: {help}");
            assert!(help.contains("Exit codes"), "{text}: {help}");
        }
    }

    #[test]
    fn every_command_has_valid_examples() {
        command().debug_assert();
        let wrong = command_line::examples::check(&command());
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }

    #[test]
    fn every_help_lists_values_and_names_units() {
        let wrong = command_line::help::check(&command());
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }
}
