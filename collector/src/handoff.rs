//! `paws handoff`: seals a session for whoever works on it next.
//!
//! Hash every file, validate if the last validation no longer fits, index, then seal: `handoff.json`
//! in the session's folder names every file with its hash. A validation fits if it used the limits
//! of the table and nothing has changed since the import, byte by byte. A session that fails its
//! validation is not sealed, and an older hand-off of it is withdrawn.

use std::fs;
use std::io;
use std::path::Path;

use anyhow::{Context, Result};
use session_archive::handoff::{HandOff, HandOffError, SealedFile, Verdict};
use session_archive::layout;
use session_archive::storage::DiskStorage;

use crate::console::Console;
use crate::external;
use crate::import::ImportRecord;
use crate::indexing;
use crate::outcome::Outcome;
use crate::target::Target;
use crate::validate::{self, Options, open};
use crate::validation::Validation;

/// Seals a session, prints where the hand-off is, and starts its reconstruction if asked to: `frames`
/// is the folder that `paws-reconstruct frames` is to fill.
///
/// # Errors
/// The session cannot be read or sealed, or the reconstruction cannot be started.
pub fn run(target: &Target, frames: Option<&Path>, console: &mut Console<'_>) -> Result<Outcome> {
    let folder = &target.folder;
    let handoff = target.derived(layout::HANDOFF, indexing::IMPORT_FIRST)?;
    let recorded = recorded(folder, console)?;
    let validation = current_validation(target, &recorded, console)?;
    if validation.verdict == Verdict::Fail {
        match fs::remove_file(&handoff) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => {
                return Err(e)
                    .with_context(|| format!("withdrawing the hand-off: {}", handoff.display()));
            }
            _ => {}
        }
        console.line(format!("FAIL  {}: not handed over", target.name()))?;
        for reason in &validation.reasons {
            console.line(format!("  {reason}"))?;
        }
        return Ok(Outcome::Failed);
    }
    indexing::ensure(folder, console)?;
    seal(folder, validation.verdict, recorded, console)?;
    console.line(handoff.display())?;
    match frames {
        Some(out) => external::start(
            "reconstruct",
            &[
                "frames".as_ref(),
                handoff.as_os_str(),
                "--out".as_ref(),
                out.as_os_str(),
            ],
        ),
        None => Ok(validate::outcome_of(&validation)),
    }
}

/// The files of the recording as they are now: manifest, rig files and segments. One that should be
/// there and is not is left out; it costs the validation.
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

/// The validation of the session as it is now; made and written if need be.
fn current_validation(
    target: &Target,
    recorded: &[SealedFile],
    console: &mut Console<'_>,
) -> Result<Validation> {
    let folder = &target.folder;
    if let Ok(validation) = Validation::read(folder)
        && validation.limits.is_empty()
        && validation.is_fresh(&open(folder)?)
        && is_as_imported(folder, recorded)
    {
        return Ok(validation);
    }
    let validation = validate::validate(folder, &Options::default(), console)?.validation;
    validation.write(folder)?;
    target.refresh()?;
    Ok(validation)
}

/// Whether every file is what was imported. A validation looked at the same bytes then, or failed:
/// lengths and times say too little of what a disk has done to them since.
fn is_as_imported(folder: &Path, recorded: &[SealedFile]) -> bool {
    let Some(record) = ImportRecord::read(folder) else {
        return false;
    };
    record.files.iter().all(|imported| {
        let mut recorded = recorded.iter();
        recorded.any(|now| now.path == imported.path && now.blake3 == imported.blake3)
    })
}

fn seal(
    folder: &Path,
    verdict: Verdict,
    mut files: Vec<SealedFile>,
    console: &Console<'_>,
) -> Result<()> {
    let context = || format!("sealing the session: {}", folder.display());
    let storage = DiskStorage::new(folder);
    for derived in [layout::INDEX, layout::VALIDATION] {
        files.push(SealedFile::of(&storage, derived, |_| {}).with_context(context)?);
    }
    HandOff::seal_files(
        &storage,
        &open(folder)?.manifest().session_id,
        verdict,
        crate::SOFTWARE,
        (console.clock.civil)(),
        files,
    )
    .with_context(context)?;
    Ok(())
}
