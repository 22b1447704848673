//! Random schedules of faults against the daemon; `bench faults` runs more of them, and longer ones.
//!
//! `PAWS_FAULT_SEED=N cargo test --package tests --test faults` runs the schedule of one seed.

use tests::faults::Exam;

const SCHEDULES: u64 = 2000;
const SECONDS: f64 = 60.0;

#[test]
fn every_loss_is_told_with_its_cause() {
    let exam = Exam::new(SECONDS).expect("a walk");
    let folder = tempfile::tempdir().expect("folder");
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
