//! Real-time priority and locked memory for the recorder: threads that read devices run before the
//! device overwrites unread data, and memory is kept resident.
//!
//! Contract: each thread requests its priority itself, when it begins: a thread started by a
//! real-time thread is an ordinary one, and no other thread knows when it runs. A refusal is
//! reported once and has no other effect.

use std::sync::Once;

use machine::Roots;
use machine::realtime::{self, Outcome, PRIORITY};

/// Gives the calling thread priority over everything that can wait.
pub(crate) fn this_thread() {
    static REPORTED: Once = Once::new();
    let outcome = realtime::this_thread(PRIORITY);
    REPORTED.call_once(|| report(outcome, "cameras and IMUs are read in real time"));
}

/// Keeps the program's memory from being swapped or dropped.
pub(crate) fn lock_memory() {
    report(realtime::lock_memory(&Roots::default()), "memory is locked");
}

fn report(outcome: Outcome, achieved: &str) {
    match outcome {
        Outcome::Achieved => log::info!("{achieved}"),
        Outcome::Refused(why) => log::warn!("{why}"),
    }
}
