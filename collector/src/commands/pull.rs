//! `paws pull`: brings sessions from a rig into the library over the network, several at a time.
//!
//! * **Which**: the named sessions, else all of the rig. The one that is being recorded is left
//!   out.
//! * **How**: each file is downloaded into `.incoming/ID/`, compared with the rig's hash and
//!   synced; then the session is verified and published as by an import (see [`crate::import`]).
//! * **Stopped at any point**: downloaded bytes remain in `.incoming/` and are not listed; the next
//!   pull resumes, if necessary in the middle of a file, and so does an import of the same session
//!   from a disk.
//! * **Receipt**: sent only for a session that is complete and synced in the library: its list hash
//!   is computed from the library's files. A damaged session gets none, so the rig keeps it.
//! * **Freeing** is requested with `--free` and only after the receipt; the rig compares again and
//!   decides.
//!
//! If one session cannot be pulled, the others still are. Each gives one line.

mod session;
mod shared;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread;

use anyhow::Result;
use command_line::complain;
use console_output::{BadArguments, Console, Outcome, Show};
use rig_link::client::{Address, Client, LinkError, RetryPolicy};
use rig_link::identity::Fingerprint;
use rig_link::link::{SessionState, SessionSummary};
use rig_link::token::Token;

use self::session::{PullResult, Puller};
use crate::commands::import;
use crate::library::{LATEST, Library};

/// Maximum number of simultaneous downloads.
pub const MAX_JOBS: usize = 8;

/// Options of `paws pull`.
#[derive(Debug)]
pub struct Options {
    /// The rig.
    pub rig: Address,
    /// Fingerprint of its certificate; needed with https.
    pub fingerprint: Option<Fingerprint>,
    /// The rig's token, if it needs one.
    pub token: Option<Token>,
    /// Simultaneous downloads, 1 to [`MAX_JOBS`].
    pub jobs: usize,
    /// Whether the rig frees sessions that have been pulled.
    pub free: bool,
    /// Names or identifiers of sessions, or beginnings of them; none: all.
    pub sessions: Vec<String>,
    /// Timeouts and retries.
    pub retry: RetryPolicy,
}

impl Options {
    /// Parses the options of a command line.
    ///
    /// # Errors
    /// The address, the fingerprint or the token is invalid.
    pub fn parse(
        rig: &str,
        fingerprint: Option<&str>,
        token_file: Option<PathBuf>,
    ) -> Result<Self> {
        let bad = |e: &dyn std::fmt::Display| BadArguments(e.to_string());
        let fingerprint = fingerprint.map(str::parse::<Fingerprint>);
        Ok(Self {
            rig: rig.parse().map_err(|e: LinkError| bad(&e))?,
            fingerprint: fingerprint.transpose().map_err(|e| bad(&e))?,
            token: token_file.map(|path| Token::read(&path)).transpose()?,
            jobs: 2,
            free: false,
            sessions: Vec::new(),
            retry: RetryPolicy::default(),
        })
    }

    fn client(&self) -> Result<Client, LinkError> {
        let token = self.token.clone();
        Client::new(self.rig.clone(), self.fingerprint, token, self.retry)
    }
}

/// Pulls sessions into the library in the folder `root`.
///
/// # Errors
/// The rig does not answer, or the library cannot be used.
pub fn run(options: &Options, root: &Path, console: &mut Console<'_>) -> Result<Outcome> {
    if console.show != Show::Nothing {
        let limit = options.retry.connect_timeout.as_secs();
        complain!("connecting to {} (gives up after {limit} s)", options.rig);
    }
    let there = options.client()?.sessions()?;
    let mut library = Library::create(root)?;
    let _lock = library.lock_waiting(import::report_waiting)?;
    let mut outcome = Outcome::Fine;
    let mut refuse = |why: String| {
        complain!("paws: {why}");
        outcome = Outcome::Failed;
    };
    let chosen = choose(&there, &options.sessions, &mut refuse);
    let chosen = pullable(chosen, options.sessions.is_empty(), &mut refuse);
    if there.is_empty() {
        console.line(format!("no sessions on {}", options.rig))?;
    }

    let bytes = chosen.iter().map(|s| s.bytes).sum();
    let progress = console.progress("pulling", bytes);
    let puller = Puller {
        library: Mutex::new(library),
        clock: console.clock,
        progress: &progress,
        host: host_name(),
        free: options.free,
    };
    let next = AtomicUsize::new(0);
    let work = |client: &mut Client| {
        let summary = chosen.get(next.fetch_add(1, Ordering::Relaxed))?;
        Some((summary, puller.pull(client, summary)))
    };
    let jobs = options.jobs.clamp(1, MAX_JOBS).min(chosen.len());
    thread::scope(|scope| {
        let (results, finished) = sync_channel(jobs);
        for _ in 0..jobs {
            let results = results.clone();
            let mut client = options.client()?;
            scope.spawn(move || {
                while let Some(result) = work(&mut client) {
                    if results.send(result).is_err() {
                        return;
                    }
                }
            });
        }
        drop(results);
        for (summary, result) in finished {
            outcome = outcome.max(report(summary, result, console)?);
        }
        Ok(outcome)
    })
}

/// Reports the result of one session.
fn report(
    summary: &SessionSummary,
    result: Result<PullResult>,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let pulled = match result {
        Ok(pulled) => pulled,
        Err(e) => {
            complain!("paws: {e:#}");
            console.line(format!("not pulled: {}", summary.name))?;
            return Ok(Outcome::Failed);
        }
    };
    let mut line = format!("{} {}", summary.name, import::summary(&pulled.imported));
    let mut outcome = Outcome::Fine;
    if pulled.imported.condition.needs_recovery() {
        outcome = Outcome::Loss;
    }
    match &pulled.rig {
        Ok(done) => line.push_str(&format!("; {done}")),
        Err(e) => {
            complain!("paws: {}: {e:#}", summary.name);
            line.push_str("; the rig keeps it");
            outcome = Outcome::Failed;
        }
    }
    console.line(line)?;
    Ok(outcome)
}

/// The selected sessions, each once, in the rig's order.
fn choose<'a>(
    there: &'a [SessionSummary],
    names: &[String],
    refuse: &mut impl FnMut(String),
) -> Vec<&'a SessionSummary> {
    if names.is_empty() {
        return there.iter().collect();
    }
    let mut chosen = BTreeSet::new();
    for text in names {
        let id = |s: &SessionSummary| s.session_id.clone().unwrap_or_default();
        let whole = there.iter().position(|s| s.name == *text || id(s) == *text);
        let begins = |s: &&SessionSummary| s.name.starts_with(text) || id(s).starts_with(text);
        let fits: Vec<&str> = there
            .iter()
            .filter(begins)
            .map(|s| s.name.as_str())
            .collect();
        match (whole, &fits[..]) {
            (Some(at), _) => _ = chosen.insert(at),
            (None, _) if text == LATEST => match latest(there) {
                Some(at) => _ = chosen.insert(at),
                None => {
                    refuse("the rig has no session that is ended and could be pulled".to_owned())
                }
            },
            (None, [one]) => chosen.extend(there.iter().position(|s| s.name == *one)),
            (None, []) => refuse(format!(
                "looking for session {text:?}: none of the {} on the rig begins with that",
                there.len()
            )),
            (None, fits) => refuse(format!(
                "looking for session {text:?}: {} fit, among them {}; give a longer prefix",
                fits.len(),
                fits[..fits.len().min(3)].join(", ")
            )),
        }
    }
    chosen.into_iter().map(|at| &there[at]).collect()
}

/// The last recorded session of those that have ended.
fn latest(there: &[SessionSummary]) -> Option<usize> {
    let ended = there
        .iter()
        .enumerate()
        .filter(|(_, s)| s.state != SessionState::Recording);
    ended
        .max_by_key(|(_, s)| (s.started_ns, &s.name))
        .map(|(at, _)| at)
}

/// Leaves out sessions that cannot be pulled, with the reason.
fn pullable<'a>(
    chosen: Vec<&'a SessionSummary>,
    all: bool,
    refuse: &mut impl FnMut(String),
) -> Vec<&'a SessionSummary> {
    let mut ids = BTreeSet::new();
    let mut pullable = Vec::new();
    for summary in chosen {
        let name = &summary.name;
        match &summary.session_id {
            _ if summary.state == SessionState::Recording && all => {
                log::warn!("{name} is being recorded and left alone");
            }
            _ if summary.state == SessionState::Recording => {
                refuse(format!("{name} is being recorded; stop it, then pull it"));
            }
            None => refuse(format!(
                "{name} cannot be pulled: the rig finds no session identifier in it"
            )),
            Some(id) if !ids.insert(id) => refuse(format!(
                "{name} is not pulled: another session on the rig has the same identifier {id}"
            )),
            Some(_) => pullable.push(summary),
        }
    }
    pullable
}

/// Host name of this machine, for the receipt.
fn host_name() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let name: String = name.trim().chars().filter(|c| !c.is_control()).collect();
    if name.is_empty() {
        "unnamed host".to_owned()
    } else {
        name.chars().take(60).collect()
    }
}
