//! What must be killed when this program receives a signal to end: the process groups of running
//! guests.
//!
//! A guest is a process group of its own, so an interrupt at the terminal does not reach it.
//! Without [`end_with_signals`] it would go on alone.

use std::collections::BTreeSet;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;

use anyhow::{Context as _, Result};
use rustix::process::{Pid, Signal, kill_process_group};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

static GROUPS: Mutex<BTreeSet<u32>> = Mutex::new(BTreeSet::new());

fn groups() -> MutexGuard<'static, BTreeSet<u32>> {
    GROUPS.lock().unwrap_or_else(PoisonError::into_inner)
}

pub(crate) fn add(group: u32) {
    groups().insert(group);
}

pub(crate) fn remove(group: u32) {
    groups().remove(&group);
}

/// From now on SIGINT, SIGTERM and SIGHUP kill the guests before they end this program.
///
/// # Errors
/// The system gives no thread or no handler.
pub fn end_with_signals() -> Result<()> {
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP]).context("taking over signals")?;
    thread::Builder::new()
        .name("signals".into())
        .spawn(move || {
            if let Some(signal) = signals.forever().next() {
                for group in groups().iter() {
                    if let Some(group) = Pid::from_raw(*group as i32) {
                        let _ = kill_process_group(group, Signal::KILL);
                    }
                }
                let _ = signal_hook::low_level::emulate_default_handler(signal);
            }
        })
        .context("starting the thread for signals")?;
    Ok(())
}
