//! Errors for want of space.

use std::io;

use anyhow::{Context, Result};

/// Adds to an error for want of space how to continue.
pub(super) fn explained<T>(result: Result<T>) -> Result<T> {
    match result {
        Err(error) if is_full(&error) => Err(error).context(
            "the disk is full or a quota is used up; make space there and run the same command \
             again: outputs that were complete are unchanged",
        ),
        other => other,
    }
}

fn is_full(error: &anyhow::Error) -> bool {
    let kinds = [io::ErrorKind::StorageFull, io::ErrorKind::QuotaExceeded];
    error.chain().any(|cause| {
        let cause = cause.downcast_ref::<io::Error>();
        cause.is_some_and(|cause| kinds.contains(&cause.kind()))
    })
}
