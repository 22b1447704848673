//! Cuts out of a log of writes.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use anyhow::{Context as _, Result, bail, ensure};
use serde_json::Value;

use super::super::config;
use super::Cut;
use crate::case::Bench;
use crate::exam::{Contents, ExamResult, Promise, only_session};
use crate::guest::Guest;
use crate::image::{self, FileSystem};
use crate::marks::{Mark, promise};
use crate::write_log::{Torn, WriteLog};

const DISK_BYTES: u64 = 512 << 20;
const LOG_BYTES: u64 = 2 << 30;
/// Images that lie on the host's disk at the same time.
const BATCH: usize = 25;
/// What a disk writes whole: F2FS is made for flash, which writes pages, and has no checksums over
/// parts of them.
const fn grain(file_system: FileSystem) -> u64 {
    match file_system {
        FileSystem::Ext4 => 512,
        FileSystem::F2fs => 4096,
    }
}

/// What to record.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// On what.
    pub file_system: FileSystem,
    /// Length of chunks, ms.
    pub chunk_ms: u32,
    /// How long.
    pub seconds: u32,
    /// Whether syncs do what they say.
    pub syncs: bool,
}

/// A recording with the log of its writes.
#[derive(Debug)]
pub struct Recording {
    job: PathBuf,
    plan: Plan,
    base: PathBuf,
    log: WriteLog,
    marks: Vec<(usize, Mark)>,
    /// The whole of it.
    reference: Contents,
}

impl Recording {
    /// Records in a guest.
    ///
    /// # Errors
    /// The guest or the recording fails.
    pub fn make(bench: &Bench, name: &str, plan: Plan) -> Result<Self> {
        let job = bench.folder(name)?;
        let [base, disk, writes] = ["base.img", "disk.img", "log.img"].map(|file| job.join(file));
        image::formatted(&base, DISK_BYTES, plan.file_system)?;
        image::copy(&base, &disk)?;
        image::blank(&writes, LOG_BYTES)?;
        fs::write(job.join("pawsd.toml"), config::synthetic(plan.chunk_ms))?;
        let preload = if plan.syncs {
            ""
        } else {
            build_nosync(&job)?;
            "env LD_PRELOAD=/run/job/nosync.so"
        };
        let script = format!(
            r#"
sectors=$(blockdev --getsz $DISK0)
dmsetup create lw --table "0 $sectors log-writes $DISK0 $DISK1" && dmsetup mknodes || exit 9
mkdir -p /run/archive && mount -o noatime /dev/mapper/lw /run/archive || exit 8
vm-guest pump --device lw -- {preload} pawsd record --config pawsd.toml --out /run/archive --seconds {} --json 2>recorder.txt
code=$?
mkdir reference && cp -r /run/archive/*-* reference/
umount /run/archive && dmsetup remove lw || exit 7
# 3: the host was too busy for all frames; what is there is judged.
[ $code -eq 0 ] || [ $code -eq 3 ] || exit $code
"#,
            plan.seconds
        );
        let guest = Guest::new(&job, script).disk(&disk).disk(&writes);
        let limit = Duration::from_secs(1800 + 10 * u64::from(plan.seconds));
        guest
            .run(&bench.machine, limit)?
            .success()
            .with_context(|| format!("recording {}", job.display()))?;
        let log = WriteLog::open(&writes)?;
        let marks: Vec<(usize, Mark)> = log
            .marks()
            .filter_map(|(i, word)| Some((i, Mark::parse(word)?)))
            .collect();
        ensure!(
            marks
                .iter()
                .any(|(_, mark)| matches!(mark, Mark::Durable { .. })),
            "the recorder never said that anything is on disk: {}",
            job.display()
        );
        let session = only_session(&job.join("reference"))?.context("no session was recorded")?;
        Ok(Self {
            reference: Contents::read(&session)?,
            job,
            plan,
            base,
            log,
            marks,
        })
    }

    /// Cuts the power at `count` places spread over the log, every second time with a torn cache,
    /// and examines what is left.
    ///
    /// # Errors
    /// An image cannot be made, or the guest that examines fails.
    pub fn cuts(&self, bench: &Bench, count: u32) -> Result<Vec<Cut>> {
        let places = self.places(count);
        let mut cuts = Vec::new();
        for (i, batch) in places.chunks(BATCH).enumerate() {
            let job = self.job.join(format!("exam-{i}"));
            fs::create_dir(&job)?;
            let mut states = Vec::new();
            for (j, (at, torn)) in batch.iter().enumerate() {
                let image = job.join(format!("{j}.img"));
                let torn = torn.then(|| Torn {
                    seed: bench.seed.wrapping_mul(1 << 32) + *at as u64,
                    grain: grain(self.plan.file_system),
                });
                self.log.crash_image(&self.base, &image, *at, torn)?;
                let marks = self.marks.iter().take_while(|(place, _)| place < at);
                states.push((image, promise(marks.map(|(_, mark)| *mark))));
            }
            let found = examine(bench, &job, Some(&self.job.join("reference")), &states)?;
            for ((at, torn), found) in batch.iter().zip(found) {
                cuts.push(self.cut(*at, *torn, found));
            }
            // Kept when something is wrong, to be looked at.
            if super::wrong(&cuts).is_empty() || !self.plan.syncs {
                fs::remove_dir_all(&job)?;
            }
        }
        Ok(cuts)
    }

    /// Places of cuts in the order of the log, and whether the cache is torn there.
    fn places(&self, count: u32) -> Vec<(usize, bool)> {
        let total = self.log.entries().len();
        // Multiples of the golden ratio: as even as can be, and in step with nothing.
        let place = |i: u32| (f64::from(i) * 0.618_033_988_749_895).fract() * total as f64;
        let mut places: Vec<usize> = (1..=count).map(|i| place(i) as usize).collect();
        places.sort_unstable();
        let torn = (0..places.len()).map(|i| i % 2 == 1);
        places.into_iter().zip(torn).collect()
    }

    fn cut(&self, at: usize, torn: bool, found: Result<ExamResult, String>) -> Cut {
        let mut cut = Cut {
            at: at as u64,
            torn,
            lost: BTreeMap::new(),
            damage: 0,
            repaired: false,
            error: None,
        };
        match found {
            Err(error) => cut.error = Some(error),
            Ok(found) => {
                cut.damage = found.damage;
                cut.repaired = found.repaired;
                // The time at the cut lies between two marks of it; the later one makes more of
                // what is lost.
                let now = self.marks.iter().find_map(|(place, mark)| match mark {
                    Mark::Now(now) if *place >= at => Some(*now),
                    _ => None,
                });
                cut.lost = self.reference.lost(&found.newest, now.unwrap_or(i64::MAX));
            }
        }
        cut
    }
}

/// Has a guest mount and examine images; one result for each.
pub(super) fn examine(
    bench: &Bench,
    job: &Path,
    reference: Option<&Path>,
    states: &[(PathBuf, Promise)],
) -> Result<Vec<Result<ExamResult, String>>> {
    let mut list = String::new();
    for (image, promise) in states {
        let image = image.file_name().context("an image without a name")?;
        let Promise { started, messages } = promise;
        let image = image.to_string_lossy();
        let _ = writeln!(list, "/run/job/{image} {started} {messages}");
    }
    fs::write(job.join("states.txt"), list)?;
    let mut script = "vm-guest exam ".to_owned();
    if let Some(reference) = reference {
        let session = only_session(reference)?.context("no reference")?;
        let _ = write!(script, "--reference '{}' ", session.display());
    }
    script += "<states.txt >found.txt 2>exam.txt";
    let limit = Duration::from_secs(1800 + 20 * states.len() as u64);
    Guest::new(job, script)
        .run(&bench.machine, limit)?
        .success()
        .with_context(|| format!("examining disks {}", job.display()))?;
    let said = fs::read_to_string(job.join("found.txt"))?;
    let found: Vec<_> = said.lines().map(parse).collect::<Result<_>>()?;
    ensure!(
        found.len() == states.len(),
        "{} disks were examined, expected {}: {}",
        found.len(),
        states.len(),
        job.display()
    );
    Ok(found)
}

fn parse(line: &str) -> Result<Result<ExamResult, String>> {
    let mut said: Value =
        serde_json::from_str(line).with_context(|| format!("the guest said {line:?}"))?;
    match said["error"].as_str() {
        Some(error) => Ok(Err(error.to_owned())),
        None => Ok(Ok(serde_json::from_value(said["found"].take())?)),
    }
}

fn build_nosync(job: &Path) -> Result<()> {
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/guest/nosync.c");
    let output = Command::new("cc")
        .args(["-shared", "-fPIC", "-o"])
        .arg(job.join("nosync.so"))
        .arg(source)
        .output()
        .context("starting cc")?;
    if !output.status.success() {
        bail!("cc: {}", String::from_utf8_lossy(&output.stderr));
    }
    Ok(())
}
