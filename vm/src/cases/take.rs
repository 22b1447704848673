//! `take`: the daemon runs in a guest, records on ext4, is started and stopped, and its session is good on the host.

use std::fs;
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::{Context as _, Result, ensure};
use serde_json::json;

use super::config;
use crate::case::{Bench, Case, Report};
use crate::exam::{Contents, only_session};
use crate::guest::Guest;
use crate::image::{self, FileSystem};

/// The case.
pub(super) const CASE: Case = Case {
    name: "take",
    shows: "pawsd records three made-up cameras in a guest, started and stopped by command",
    quick: true,
    on_qemu: true,
    run,
};

const SCRIPT: &str = r"
mkdir -p /run/archive && mount $DISK0 /run/archive || exit 9
pawsd run --config pawsd.toml 2>daemon.txt & daemon=$!
until_true pawsd status >/dev/null || exit 8
pawsd start || exit 7
sleep 3
pawsd stop || exit 6
kill $daemon; wait $daemon
mkdir sessions && cp -r /run/archive/*-* sessions/ && umount /run/archive
";

fn run(bench: &Bench) -> Result<Report> {
    let job = bench.folder("job")?;
    let disk = bench.folder.join("disk.img");
    image::formatted(&disk, 512 << 20, FileSystem::Ext4)?;
    fs::write(job.join("pawsd.toml"), config::synthetic(500))?;
    let guest = Guest::new(&job, SCRIPT).disk(&disk);
    guest
        .run(&bench.machine, Duration::from_secs(300))?
        .success()?;
    let session = only_session(&job.join("sessions"))?.context("no session was recorded")?;
    let contents = Contents::read(&session)?;
    let samples = contents.samples.values().map(Vec::len);
    let counts: Vec<usize> = samples.collect();
    ensure!(
        counts.iter().all(|n| *n > 0),
        "samples by stream: {counts:?}"
    );
    let said = Command::new(bench.machine.host_program("paws"))
        .arg("validate")
        .arg(&session)
        .stdin(Stdio::null())
        .output()
        .context("starting paws")?;
    ensure!(
        said.status.success(),
        "paws validate ended with {}:\n{}{}",
        said.status,
        String::from_utf8_lossy(&said.stdout),
        String::from_utf8_lossy(&said.stderr)
    );
    let total: usize = counts.iter().sum();
    Ok(Report {
        line: format!("{total} samples of {} streams, validated", counts.len()),
        figures: json!({ "samples": contents.samples.iter().map(|(name, samples)| (name.clone(), samples.len())).collect::<std::collections::BTreeMap<_, _>>() }),
    })
}
