//! The validation of one session: scan, decoding, comparison with the limits.

use std::path::{Path, PathBuf};
use std::thread;

use anyhow::{Context, Result};
use console_output::Console;
use session_access::decode_check::decode_all;
use session_access::{open, read_or_build};
use session_archive::reader::SessionReader;
use session_health::Limits;

use crate::calibration_check;
use crate::quality::evaluate;
use crate::scan_session::{SessionScan, scan_session};
use crate::validation::{Basis, Validation};

/// Options of a validation.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Decode every image, and verify the calibration.
    pub deep: bool,
    /// The limits.
    pub limits: Limits,
    /// Also write the JSON document here.
    pub json: Option<PathBuf>,
    /// Also write the HTML report here.
    pub html: Option<PathBuf>,
    /// The program that verifies the calibration [default: `paws-calib` beside this one or on
    /// PATH].
    pub calib_program: Option<PathBuf>,
}

/// A validated session, with everything that its report needs.
pub struct ValidatedSession {
    /// The session.
    pub reader: SessionReader,
    /// Result of the scan.
    pub found: SessionScan,
    /// The verdict.
    pub validation: Validation,
}

/// Scans and validates the session in a folder. Nothing is written.
///
/// # Errors
/// The session cannot be read, or no decoder is available.
pub fn validate(
    folder: &Path,
    options: &Options,
    console: &Console<'_>,
) -> Result<ValidatedSession> {
    let reader = open(folder)?;
    let context = || format!("validating the session: {}", folder.display());
    let bytes = reader.bytes().with_context(context)?;
    let found = {
        let progress = console.progress("validating", bytes);
        scan_session(&reader, &progress).with_context(context)?
    };
    let decoded = if options.deep {
        let index = read_or_build(&reader, console).with_context(context)?;
        let progress = console.progress("decoding", bytes);
        let threads = thread::available_parallelism().map_or(1, usize::from);
        Some(decode_all(&reader, &index, threads, &progress).with_context(context)?)
    } else {
        None
    };
    let manifest = reader.manifest();
    let mut findings = evaluate(manifest, &found, decoded.as_deref(), &options.limits);
    if options.deep {
        // Takes half a minute for an hour's session, in addition to decoding.
        let program = options.calib_program.as_deref();
        let measured =
            calibration_check::measure(folder, program, console).with_context(context)?;
        findings.extend(measured.iter().filter_map(|m| m.compare(&options.limits)));
    }
    let basis = Basis::of(&reader).with_context(context)?;
    let validation = Validation::new(
        manifest,
        basis,
        &found,
        findings,
        options.deep,
        &options.limits,
    );
    Ok(ValidatedSession {
        reader,
        found,
        validation,
    })
}
