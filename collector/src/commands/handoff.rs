//! `paws handoff`: seals a session for the next processing stage.
//!
//! Hash every file, validate if the last validation no longer fits, index, then write
//! `handoff.json` into the session's folder: the recorded files with their hashes under a seal, and
//! beside it the verdict, the limits, and the acceptance. A validation is still valid if it used
//! the same limits and no byte has changed since the import; a repeated one is as deep as the last
//! one. A session that fails its validation is handed over only if that is accepted, now or by an
//! earlier hand-off of the same recording; else an older hand-off of it is withdrawn. Handing over
//! the same session again changes nothing.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use console_output::{Console, Outcome};
use session_access::open;
use session_archive::handoff::{
    Acceptance, Beyond, HandOff, HandOffError, SealedFile, Statement, Verdict,
};
use session_archive::layout;
use session_archive::storage::DiskStorage;
use session_archive::time::CivilTime;
use session_health::{Finding, Limits, reasons};

use crate::commands::index;
use crate::commands::validate;
use crate::external;
use crate::import::ImportRecord;
use crate::target::Target;
use crate::validation::Validation;
use crate::verdict_change;

/// Options of a hand-off.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The worst verdict with which the session is still handed over.
    pub accept: Option<Verdict>,
    /// The limits of the validation.
    pub limits: Limits,
    /// Folder for the output of `paws-reconstruct frames`, started afterwards.
    pub frames: Option<PathBuf>,
    /// The program that verifies the calibration in a deep validation [default: `paws-calib` beside
    /// this one or on PATH].
    pub calib_program: Option<PathBuf>,
}

/// [`run_with`] default limits, accepting no failure.
///
/// # Errors
/// See [`run_with`].
pub fn run(target: &Target, frames: Option<&Path>, console: &mut Console<'_>) -> Result<Outcome> {
    let options = Options {
        frames: frames.map(Path::to_owned),
        ..Options::default()
    };
    run_with(target, &options, console)
}

/// Seals a session, prints the path of the hand-off, and starts its reconstruction if requested. An
/// accepted failure ends as [`Outcome::Loss`].
///
/// # Errors
/// The session cannot be read or sealed, or the reconstruction cannot be started.
pub fn run_with(target: &Target, options: &Options, console: &mut Console<'_>) -> Result<Outcome> {
    let folder = &target.folder;
    let path = target.derived(layout::HANDOFF, index::IMPORT_FIRST)?;
    let storage = DiskStorage::new(folder);
    let before = HandOff::read(&storage).ok();
    let recorded = recorded(folder, console)?;
    let validation = current_validation(target, options, &recorded, console)?;
    let before = before.filter(|before| before.session_id == validation.session_id);
    let same = (before.as_ref()).filter(|before| is_same(&before.files, &recorded));
    let accepted = acceptance(&validation, options.accept, same, console);
    if validation.verdict == Verdict::Fail && accepted.is_none() {
        refuse(target, &validation, before.as_ref(), &path, console)?;
        return Ok(Outcome::Failed);
    }
    index::ensure(folder, console)?;
    let index = SealedFile::of(&storage, layout::INDEX, |_| {});
    let sealing = || format!("sealing the session: {}", folder.display());
    let said = Statement {
        software: crate::SOFTWARE.to_owned(),
        sealed: CivilTime((console.clock.civil_ns)()),
        verdict: validation.verdict,
        limits: validation.limits.clone(),
        acceptance: accepted,
    };
    let index = index.with_context(sealing)?;
    let mut handoff = HandOff::new(&validation.session_id, recorded, vec![index], said);
    handoff.earlier_seals = same.map(earlier_seals).unwrap_or_default();
    if !same.is_some_and(|same| is_equivalent(same, &handoff)) {
        handoff.write(&storage).with_context(sealing)?;
    }
    if let Some(before) = &before
        && before.verdict != handoff.verdict
    {
        let (old, new) = (before.verdict, handoff.verdict);
        console.line(format!(
            "handed over as {new}; before, {}, as {old}",
            before.sealed
        ))?;
    }
    if let (Verdict::Fail, Some(acceptance)) = (handoff.verdict, &handoff.acceptance) {
        let at = acceptance.accepted;
        console.line(format!(
            "FAIL  {}: accepted {at}, handed over",
            target.name()
        ))?;
        print_reasons(&validation, console)?;
    }
    console.line(path.display())?;
    let outcome = match handoff.verdict {
        Verdict::Fail => Outcome::Loss,
        _ => validate::outcome_of(&validation),
    };
    match &options.frames {
        Some(out) => external::start(
            "reconstruct",
            &[
                "frames".as_ref(),
                path.as_os_str(),
                "--out".as_ref(),
                out.as_os_str(),
            ],
        ),
        None => Ok(outcome),
    }
}

/// Reports why a session is not handed over, and withdraws an older hand-off of it.
fn refuse(
    target: &Target,
    validation: &Validation,
    before: Option<&HandOff>,
    path: &Path,
    console: &mut Console<'_>,
) -> Result<()> {
    match fs::remove_file(path) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => {
            return Err(e).with_context(|| format!("withdrawing the hand-off: {}", path.display()));
        }
        _ => {}
    }
    let name = target.name();
    console.line(format!("FAIL  {name}: not handed over"))?;
    print_reasons(validation, console)?;
    if let Some(before) = before {
        let (verdict, sealed) = (before.verdict, before.sealed);
        console.line(format!(
            "the hand-off of {sealed}, as {verdict}, is withdrawn"
        ))?;
    }
    console.line(format!(
        "`paws handoff {name} --accept FAIL` hands it over as it is, marked as failed"
    ))?;
    Ok(())
}

fn print_reasons(validation: &Validation, console: &mut Console<'_>) -> Result<()> {
    for finding in reasons(&validation.findings) {
        console.line(format!("  {}  {}", finding.verdict, finding.text))?;
    }
    Ok(())
}

/// The current files of the recording: manifest, rig files and segments. A missing one is left out;
/// the validation then no longer matches.
fn recorded(folder: &Path, console: &Console<'_>) -> Result<Vec<SealedFile>> {
    let context = || format!("hashing the session: {}", folder.display());
    let reader = open(folder)?;
    let rig = reader.manifest().rig.iter();
    let mut paths = vec![layout::MANIFEST.to_owned()];
    paths.extend(rig.map(|f| layout::rig_file(&f.name)));
    paths.extend(reader.segment_numbers().map(layout::segment));
    let progress = console.progress("hashing", reader.bytes()?);
    let mut files = Vec::new();
    for path in paths {
        match SealedFile::of(&**reader.storage(), &path, |bytes| progress.add(bytes)) {
            Ok(file) => files.push(file),
            Err(HandOffError::Io { error, .. }) if error.kind() == io::ErrorKind::NotFound => {}
            Err(e) => return Err(e).with_context(context),
        }
    }
    Ok(files)
}

/// The validation of the current session by these limits; run and written if necessary.
fn current_validation(
    target: &Target,
    options: &Options,
    recorded: &[SealedFile],
    console: &mut Console<'_>,
) -> Result<Validation> {
    let folder = &target.folder;
    let known = Validation::read(folder).ok();
    if let Some(known) = &known
        && known.limits == options.limits.moved()
        && known.is_fresh(&open(folder)?)
        && is_as_imported(folder, recorded)
    {
        return Ok(known.clone());
    }
    let options = validate::Options {
        // Findings of a deep validation must not be lost by a repeated one.
        deep: known.as_ref().is_some_and(|known| known.deep),
        limits: options.limits.clone(),
        calib_program: options.calib_program.clone(),
        ..validate::Options::default()
    };
    let validation = validate::validate(folder, &options, console)?.validation;
    validation.write(folder)?;
    target.refresh()?;
    if let Some(change) = known.and_then(|known| verdict_change::describe(&known, &validation)) {
        console.line(change)?;
    }
    Ok(validation)
}

/// Whether every file is unchanged since the import. Then the validation has seen the same bytes,
/// or failed. Lengths and times do not show disk errors.
fn is_as_imported(folder: &Path, recorded: &[SealedFile]) -> bool {
    let Some(record) = ImportRecord::read(folder) else {
        return false;
    };
    record.files.iter().all(|imported| {
        let mut recorded = recorded.iter();
        recorded.any(|now| now.path == imported.path && now.blake3 == imported.blake3)
    })
}

/// Whether two lists name the same files with the same hashes.
fn is_same(one: &[SealedFile], other: &[SealedFile]) -> bool {
    one.len() == other.len() && one.iter().all(|file| other.contains(file))
}

/// The acceptance that a verdict needs: that of an earlier hand-off of the same recording if it
/// covers the verdict and no other level is given, else a new one if the given level covers it.
fn acceptance(
    validation: &Validation,
    level: Option<Verdict>,
    same: Option<&HandOff>,
    console: &Console<'_>,
) -> Option<Acceptance> {
    let verdict = validation.verdict;
    let beyond = reasons(&validation.findings);
    if verdict == Verdict::Pass {
        return None;
    }
    let previous = same.and_then(|same| same.acceptance.as_ref());
    let previous = previous.filter(|previous| {
        let beyond = beyond.iter();
        previous.verdict == verdict
            && previous.limits == validation.limits
            && level.is_none_or(|level| level == previous.level)
            && previous.covers(
                verdict,
                beyond.map(|f| (f.metric.as_str(), f.of.as_str(), f.verdict)),
            )
    });
    let given = || {
        let level = level.filter(|level| *level >= verdict)?;
        Some(Acceptance {
            level,
            accepted: CivilTime((console.clock.civil_ns)()),
            verdict,
            metrics: beyond.iter().map(|finding| of_finding(finding)).collect(),
            limits: validation.limits.clone(),
        })
    };
    previous.cloned().or_else(given)
}

fn of_finding(finding: &Finding) -> Beyond {
    Beyond {
        metric: finding.metric.clone(),
        of: finding.of.clone(),
        verdict: finding.verdict,
        value: finding.value.is_finite().then_some(finding.value),
        warn: finding.warn,
        fail: finding.fail,
        unit: finding.unit.clone(),
        text: finding.text.clone(),
    }
}

/// Version 1 seals of the same recording.
fn earlier_seals(same: &HandOff) -> Vec<String> {
    let mut seals = same.earlier_seals.clone();
    if same.version < session_archive::handoff::VERSION {
        seals.push(same.seal.clone());
    }
    seals
}

/// Whether two hand-offs differ only in time and software version.
fn is_equivalent(old: &HandOff, new: &HandOff) -> bool {
    let timeless = HandOff {
        software: old.software.clone(),
        sealed: old.sealed,
        ..new.clone()
    };
    *old == timeless
}
