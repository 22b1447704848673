//! `paws handoff`: seals a session for whoever works on it next.
//!
//! Validate if the last validation no longer fits, index, then seal: `handoff.json` in the
//! session's folder names every file with its hash. A session that fails its validation is not
//! sealed, and an older hand-off of it is withdrawn.

use std::fs;
use std::io;
use std::path::Path;

use anyhow::{Context, Result};
use session_archive::handoff::{HandOff, Verdict};
use session_archive::layout;
use session_archive::storage::DiskStorage;

use crate::console::Console;
use crate::external;
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
    let validation = current_validation(target, console)?;
    let handoff = folder.join(layout::HANDOFF);
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
    seal(folder, validation.verdict, console)?;
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

/// The validation of the session as it is now; made and written if need be.
fn current_validation(target: &Target, console: &mut Console<'_>) -> Result<Validation> {
    let folder = &target.folder;
    if let Ok(validation) = Validation::read(folder)
        && validation.is_fresh(&open(folder)?)
    {
        return Ok(validation);
    }
    let validation = validate::validate(folder, &Options::default(), console)?.validation;
    validation.write(folder)?;
    target.refresh()?;
    Ok(validation)
}

fn seal(folder: &Path, verdict: Verdict, console: &Console<'_>) -> Result<()> {
    let reader = open(folder)?;
    let manifest = reader.manifest();
    let mut paths = vec![layout::MANIFEST.to_owned()];
    paths.extend(manifest.rig.iter().map(|f| layout::rig_file(&f.name)));
    let basis = crate::validation::Basis::of(&reader)
        .with_context(|| format!("sealing the session: {}", folder.display()))?;
    paths.extend(basis.segments.iter().map(|(n, _)| layout::segment(*n)));
    paths.extend([layout::INDEX, layout::VALIDATION].map(str::to_owned));
    // A session whose manifest is gone is sealed without it; the segments repeat it.
    paths.retain(|path| path != layout::MANIFEST || !basis.manifest_blake3.is_empty());
    let progress = console.progress("sealing", reader.bytes()?);
    HandOff::seal(
        &DiskStorage::new(folder),
        &manifest.session_id,
        verdict,
        crate::SOFTWARE,
        (console.clock.civil)(),
        &paths,
        |bytes| progress.add(bytes),
    )
    .with_context(|| format!("sealing the session: {}", folder.display()))?;
    Ok(())
}
