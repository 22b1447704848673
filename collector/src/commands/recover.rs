//! `paws recover`: an undamaged copy of a session that was cut off or damaged.
//!
//! The original is only read. In a library the copy becomes a separate session, `ID.recovered`,
//! that appears by one rename as an import does; elsewhere it goes to a new folder beside the
//! original, or to the named one. Samples that could not be recovered have gap records in the copy
//! (`docs/decisions/0005-collector.md`).

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail, ensure};
use console_output::{Console, Outcome, text};
use session_access::open;
use session_archive::recover::{Recovery, recover};
use session_archive::storage::DiskStorage;
use session_archive::time::CivilTime;
use session_archive::verify::verify;

use crate::condition::Condition;
use crate::import::{ImportRecord, check_space, publish_folder};
use crate::library::Library;
use crate::quality::faults;
use crate::session_key::RECOVERED;
use crate::target::Target;

/// Recovers a session into the folder `out`, which must be new.
///
/// # Errors
/// The session cannot be read, or the copy cannot be written or is damaged.
pub fn run(target: &Target, out: Option<&Path>, console: &mut Console<'_>) -> Result<Outcome> {
    let reader = open(&target.folder)?;
    let bytes = reader.bytes()?;
    let report = {
        let progress = console.progress("checking", bytes);
        verify(&reader, |n| progress.add(n))?
    };
    if report.is_sound() {
        console.line(format!("{}: undamaged, nothing to recover", target.name()))?;
        return Ok(Outcome::Fine);
    }
    match (target.key(), out) {
        (Some((root, key)), None) => in_library(target, root, key, bytes, console),
        (_, out) => {
            let copy = match out {
                Some(out) => out.to_owned(),
                None => recovered_path(&target.folder),
            };
            let occupied = copy.exists()
                && fs::read_dir(&copy)
                    .with_context(|| format!("recovering to {}", copy.display()))?
                    .next()
                    .is_some();
            ensure!(
                !occupied,
                "the copy needs a new or an empty folder, and this one holds something: {}",
                copy.display()
            );
            let recovered = write(target, &copy, bytes, console)?;
            report_recovered(
                &target.name(),
                &copy.display().to_string(),
                &recovered,
                console,
            )
        }
    }
}

fn in_library(
    target: &Target,
    root: &Path,
    key: &str,
    bytes: u64,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let mut library = Library::open(root)?;
    let _lock = library.lock()?;
    let copy_key = format!("{key}{RECOVERED}");
    if library.folder(&copy_key).exists() {
        bail!(
            "{key} has been recovered before; `paws prune --session {copy_key} --yes` removes that \
             copy: {}",
            library.folder(&copy_key).display()
        );
    }
    let incoming = library.incoming(&copy_key);
    // Remains of a stopped recovery.
    if incoming.exists() {
        fs::remove_dir_all(&incoming)
            .with_context(|| format!("clearing {}", incoming.display()))?;
    }
    check_space(library.root(), bytes)?;
    let recovered = write(target, &incoming, bytes, console)?;
    let record = ImportRecord::of_folder(
        &recovered.copy.session_id,
        &incoming,
        &target.folder,
        CivilTime((console.clock.civil_ns)()),
        recovered.copy.clone(),
    )?;
    record
        .write(&incoming)
        .with_context(|| format!("writing the record of {}", incoming.display()))?;
    publish_folder(&library, &copy_key)?;
    library.refresh(&copy_key)?;
    report_recovered(key, &copy_key, &recovered, console)
}

/// `FOLDER.recovered`, beside the folder.
fn recovered_path(folder: &Path) -> PathBuf {
    let mut path = folder.as_os_str().to_owned();
    path.push(RECOVERED);
    path.into()
}

fn write(target: &Target, copy: &Path, bytes: u64, console: &Console<'_>) -> Result<Recovery> {
    let reader = open(&target.folder)?;
    // Progress counts the verification of the source and of the copy.
    let progress = console.progress("recovering", 2 * bytes);
    recover(&reader, Arc::new(DiskStorage::new(copy)), |n| {
        progress.add(n)
    })
    .with_context(|| format!("recovering to {}", copy.display()))
}

fn report_recovered(
    name: &str,
    copy: &str,
    recovered: &Recovery,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let kept: u64 = recovered.copy.streams.values().map(|s| s.samples).sum();
    let lost: u64 = recovered.lost.iter().map(|l| l.last - l.first + 1).sum();
    for fault in faults(&recovered.source) {
        console.line(format!("  {fault}"))?;
    }
    if recovered.saved_chunks > 0 {
        console.line(format!(
            "  {} saved from {} with a wrong checksum: all but the frames with damaged images",
            text::count(recovered.saved_messages, "message"),
            text::count(recovered.saved_chunks, "chunk"),
        ))?;
    }
    console.line(format!(
        "{name}: recovered as {copy}, {} kept, {lost} lost",
        text::count(kept, "sample"),
    ))?;
    // A cut loses nothing that was synced; anything else is loss.
    let only_cut = lost == 0
        && Condition::of(
            session_archive::manifest::State::Recording,
            &recovered.source,
        ) == Condition::Unclosed;
    Ok(if only_cut {
        Outcome::Fine
    } else {
        Outcome::Loss
    })
}
