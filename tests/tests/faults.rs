//! Random schedules of faults against the daemon, two thousand minutes of session time.
//!
//! `PAWS_FAULT_SEED=N cargo test --package tests --test faults` runs the schedule of one seed, and says so
//! where one fails.

use std::path::Path;

use tests::faults::Exam;

const SCHEDULES: u64 = 2000;
const SECONDS: f64 = 60.0;

#[test]
fn every_loss_is_told_with_its_cause() {
    let exam = Exam::new(SECONDS).expect("a walk");
    // What a disk makes of it is for other tests; in memory syncing costs nothing.
    let memory = Path::new("/dev/shm");
    let folder = match memory.is_dir() {
        true => tempfile::tempdir_in(memory),
        false => tempfile::tempdir(),
    };
    let folder = folder.expect("folder");
    let seeds = match std::env::var("PAWS_FAULT_SEED") {
        Ok(seed) => {
            let seed: u64 = seed.parse().expect("PAWS_FAULT_SEED is a number");
            seed..seed + 1
        }
        Err(_) => 0..SCHEDULES,
    };
    let (tally, failures) = exam.run_all(seeds, folder.path());
    println!("{tally:?}");
    for (seed, error) in &failures {
        eprintln!("{error:#}\nPAWS_FAULT_SEED={seed} runs it again\n");
    }
    assert!(failures.is_empty(), "{} schedules failed", failures.len());
    // Doubting everything would be no account.
    assert!(tally.doubtful * 3 < tally.stored, "{tally:?}");
}
