//! Random schedules of faults against the daemon, a minute of session time each.
//!
//! `PAWS_FAULT_SEEDS=2000 cargo test --package tests --test faults` runs all schedules instead of a
//! slice, `PAWS_FAULT_SEED=N` the schedule of one seed; a failure prints it.

use std::path::Path;

use harness::faults::Exam;

/// A slice of the 2000 schedules.
const SCHEDULES: u64 = 60;
const SECONDS: f64 = 60.0;

#[test]
fn every_loss_is_recorded_with_its_cause() {
    let exam = Exam::new(SECONDS).expect("a walk");
    // Disk behavior is covered by other tests; in memory syncing costs nothing.
    let memory = Path::new("/dev/shm");
    let folder = match memory.is_dir() {
        true => tempfile::tempdir_in(memory),
        false => tempfile::tempdir(),
    };
    let folder = folder.expect("folder");
    let number = |name| {
        let text = std::env::var(name).ok()?;
        Some(
            text.parse::<u64>()
                .unwrap_or_else(|e| panic!("{name}={text}: {e}")),
        )
    };
    let seeds = match number("PAWS_FAULT_SEED") {
        Some(seed) => seed..seed + 1,
        None => 0..number("PAWS_FAULT_SEEDS").unwrap_or(SCHEDULES),
    };
    let (tally, failures) = exam.run_all(seeds, folder.path());
    println!("{tally:?}");
    for (seed, error) in &failures {
        eprintln!("{error:#}\nPAWS_FAULT_SEED={seed} runs it again\n");
    }
    assert!(failures.is_empty(), "{} schedules failed", failures.len());
    // Marking everything as unreliable would not be an account.
    assert!(tally.unreliable * 3 < tally.stored, "{tally:?}");
}
