//! Random schedules of faults against the daemon; `bench faults` runs more of them, and longer ones.
//!
//! `PAWS_FAULT_SEED=N cargo test --package tests --test faults` runs the schedule of one seed.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use tests::faults::{Exam, Tally};

const SCHEDULES: u64 = 40;

#[test]
fn every_loss_is_told_with_its_cause() {
    let exam = Exam::new(60.0).expect("a walk");
    let folder = tempfile::tempdir().expect("folder");
    let seeds = match std::env::var("PAWS_FAULT_SEED") {
        Ok(seed) => {
            let seed: u64 = seed.parse().expect("PAWS_FAULT_SEED is a number");
            seed..seed + 1
        }
        Err(_) => 0..SCHEDULES,
    };
    let next = AtomicU64::new(seeds.start);
    let all = Mutex::new(Tally::default());
    thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= seeds.end {
                        break;
                    }
                    let tally = exam.run(seed, folder.path()).unwrap_or_else(|e| {
                        panic!("{e:#}\n\nPAWS_FAULT_SEED={seed} runs it again")
                    });
                    let mut all = all.lock().unwrap_or_else(PoisonError::into_inner);
                    all.stored += tally.stored;
                    all.accounted += tally.accounted;
                    all.wrong_times += tally.wrong_times;
                }
            });
        }
    });
    println!("{:?}", all.into_inner());
}
