//! What keeps a recording from being held up: threads that take from devices before these overwrite what was not
//! taken, and memory that stays where it is.
//!
//! Contract: each thread asks for itself, when it begins: one that is started by a thread in real time is an ordinary one, and
//! nobody else knows when it is there. A refusal is told once and changes nothing else.

use std::sync::Once;

use machine::Roots;
use machine::realtime::{self, Outcome, PRIORITY};

/// Lets the calling thread go before everything that can wait.
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
