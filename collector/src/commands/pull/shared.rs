//! What the threads of a pull share.

use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result, anyhow};

/// Locks a mutex even if it is poisoned: the data is consistent at every step.
pub(super) fn locked<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Adds the session's name to an error.
pub(super) fn of_session<T, E: Into<anyhow::Error>>(name: &str, result: Result<T, E>) -> Result<T> {
    result
        .map_err(|e| anyhow!(e))
        .with_context(|| format!("pulling {name}"))
}
