//! Cuts of guests that record: killed at a random instant with everything that belongs to them.
//!
//! The guest's page cache is lost then, and what it had handed to its disk is in the image: a cut
//! that a disk without a cache sees.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};

use super::super::config;
use super::replayed::examine;
use super::{CHUNK_MS, Cut};
use crate::case::Bench;
use crate::guest::Guest;
use crate::image::{self, FileSystem};
use crate::marks::{Mark, promise};
use crate::random::Random;

const DISK_BYTES: u64 = 512 << 20;
/// The earliest and the latest cut after the recorder said that it began, ms.
const AFTER_MS: (u64, u64) = (50, 4000);
/// How long a guest may take to begin.
const BEGIN_LIMIT: Duration = Duration::from_secs(1800);

const SCRIPT: &str = r"
mkdir -p /run/archive && mount $DISK0 /run/archive || exit 9
vm-guest pump -- pawsd record --config pawsd.toml --out /run/archive --seconds 600 --json 2>recorder.txt
";

/// Cuts the power of `count` guests, one after the other, and examines what is left.
///
/// # Errors
/// A guest does not begin, or the one that examines fails.
pub fn cuts(bench: &Bench, name: &str, file_system: FileSystem, count: u32) -> Result<Vec<Cut>> {
    let folder = bench.folder(name)?;
    let base = folder.join("base.img");
    image::formatted(&base, DISK_BYTES, file_system)?;
    let mut random = Random::new(bench.seed);
    let (least, most) = AFTER_MS;
    let (mut states, mut instants) = (Vec::new(), Vec::new());
    for i in 0..count {
        let after = Duration::from_millis(least + random.next() % (most - least + 1));
        let disk = folder.join(format!("{i}.img"));
        image::copy(&base, &disk)?;
        let marks = cut(bench, &folder.join(format!("cut-{i}")), &disk, after)
            .with_context(|| format!("cut {i}, {}", folder.display()))?;
        let now = marks.iter().rev().find_map(|mark| match mark {
            Mark::Now(now) => Some(*now),
            _ => None,
        });
        instants.push((after.as_millis() as u64, now));
        states.push((disk, promise(marks)));
    }
    let found = examine(bench, &folder, None, &states)?;
    let cuts: Vec<Cut> = instants
        .iter()
        .zip(found)
        .map(|((at, now), found)| {
            let mut cut = Cut {
                at: *at,
                torn: false,
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
                    let newest = found.newest.into_iter();
                    cut.lost = newest
                        .filter_map(|(stream, time)| Some((stream, ((*now)? - time).max(0))))
                        .collect();
                }
            }
            cut
        })
        .collect();
    if super::wrong(&cuts).is_empty() {
        fs::remove_dir_all(&folder)?;
    }
    Ok(cuts)
}

/// One cut; everything that the recorder had said.
#[expect(
    clippy::disallowed_methods,
    reason = "cuts come at random instants of real time"
)]
fn cut(bench: &Bench, job: &Path, disk: &PathBuf, after: Duration) -> Result<Vec<Mark>> {
    fs::create_dir(job)?;
    fs::write(job.join("pawsd.toml"), config::synthetic(CHUNK_MS))?;
    let mut guest = Guest::new(job, SCRIPT).disk(disk).start(&bench.machine)?;
    guest.wait_for("started", BEGIN_LIMIT)?;
    let until = Instant::now() + after;
    let mut lines = vec![Mark::Started.to_string()];
    // Lines come all the time, so this is over in time.
    while Instant::now() < until {
        let line = guest.line(BEGIN_LIMIT)?;
        lines.push(line.context("the guest ended before it was cut")?);
    }
    lines.extend(guest.cut_power());
    Ok(lines.iter().filter_map(|line| Mark::parse(line)).collect())
}
