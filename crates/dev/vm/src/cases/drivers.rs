//! The crate `v4l2` alone on the kernel's test cameras: its own tests, which need them
//! (`crates/devices/v4l2/tests/vivid.rs`).

use std::fs;
use std::time::Duration;

use anyhow::{Context as _, Result, ensure};
use serde_json::json;

use crate::case::{Bench, Case, Report};
use crate::guest::Guest;

/// The tests, as `cargo xtask vm-test` builds them.
const PROGRAM: &str = "v4l2-vivid";

pub(super) const CASE: Case = Case {
    name: "drivers",
    shows: "the tests of the crate v4l2 that need real cameras: modes, controls, faults, unplugging",
    quick: true,
    on_qemu: false,
    run,
};

/// In virtual time, where a busy host is never late for a camera.
const SCRIPT: &str =
    "ERROR_INJECTION=1 cameras 30 && PAWS_VIVID=1 v4l2-vivid --test-threads=1 >tests.txt 2>&1";

fn run(bench: &Bench) -> Result<Report> {
    let program = bench.machine.host_program(PROGRAM);
    ensure!(
        program.is_file(),
        "{} is not there: `cargo xtask vm-test` builds it",
        program.display()
    );
    let job = bench.folder("job")?;
    let ended = Guest::new(&job, SCRIPT)
        .error_injection()
        .virtual_time()
        .run(&bench.machine, Duration::from_secs(1800))?
        .success();
    let output = fs::read_to_string(job.join("tests.txt")).unwrap_or_default();
    let failed: Vec<&str> = output.lines().filter(|l| l.ends_with("FAILED")).collect();
    ended.with_context(|| failed.join("; "))?;
    let passed = output.lines().filter(|l| l.ends_with("... ok")).count();
    ensure!(passed > 0, "not one test ran: {output}");
    Ok(Report {
        line: format!("{passed} tests"),
        figures: json!({ "passed": passed }),
    })
}
