//! Wall time and processor time of a task, statistics, and the output folder.

#![expect(
    clippy::disallowed_methods,
    reason = "the time that this machine takes is measured"
)]

use std::fs;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use rustix::time::{ClockId, clock_gettime};

/// Wall and processor time of one run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Timing {
    pub(crate) wall_s: f64,
    /// Processor time of this whole process, the kernel's on its behalf included.
    pub(crate) cpu_s: f64,
}

/// Runs `work` and measures it.
pub(crate) fn timed<T>(work: impl FnOnce() -> T) -> (T, Timing) {
    let (cpu, wall) = (cpu_s(), Instant::now());
    let result = work();
    let took = Timing {
        wall_s: wall.elapsed().as_secs_f64(),
        cpu_s: cpu_s() - cpu,
    };
    (result, took)
}

/// Processor time of this process so far, all threads, s.
pub(crate) fn cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Processor time of this thread so far, s.
pub(crate) fn thread_cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Processor time of all ended processes that this one started, s, to 10 ms.
pub(crate) fn children_cpu_s() -> Result<f64> {
    /// Of the numbers in `/proc/PID/stat`, on every Linux that this runs on (USER_HZ).
    const TICKS_PER_S: f64 = 100.0;
    let text = fs::read_to_string("/proc/self/stat").context("reading /proc/self/stat")?;
    // proc(5): cutime and cstime are fields 16 and 17, and field 2, in brackets, may hold anything.
    let rest = text.rsplit(')').next().unwrap_or_default();
    let fields = rest.split_whitespace().skip(13).take(2);
    let ticks: Vec<f64> = fields.filter_map(|f| f.parse().ok()).collect();
    ensure!(
        ticks.len() == 2,
        "/proc/self/stat is not as expected: {text}"
    );
    Ok((ticks[0] + ticks[1]) / TICKS_PER_S)
}

/// The value below which a share of the values lies, by the nearest rank.
pub(crate) fn quantile(ascending: &[f64], share: f64) -> f64 {
    let last = ascending.len().saturating_sub(1);
    let at = (share * last as f64).round() as usize;
    ascending.get(at).copied().unwrap_or(f64::NAN)
}

/// The middle one, or the mean of the two middle ones.
pub(crate) fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => f64::NAN,
        count if count % 2 == 1 => values[middle],
        _ => (values[middle - 1] + values[middle]) / 2.0,
    }
}

/// A folder on a disk for sessions: the one that was named, or else the one of this program, which
/// is the target folder.
///
/// # Errors
/// It is in memory, where a sync costs nothing and no block layer works.
pub(crate) fn on_disk(named: Option<PathBuf>) -> Result<PathBuf> {
    /// `TMPFS_MAGIC` and `RAMFS_MAGIC` of statfs(2).
    const IN_MEMORY: [i64; 2] = [0x0102_1994, 0x8584_58f6];
    let folder = match named {
        Some(folder) => folder,
        None => {
            let program = std::env::current_exe().context("finding this program")?;
            program.parent().context("finding its folder")?.to_owned()
        }
    };
    let system = rustix::fs::statfs(&folder)
        .with_context(|| format!("looking at the disk of {}", folder.display()))?;
    ensure!(
        !IN_MEMORY.contains(&(system.f_type as i64)),
        "sessions are to be written to a disk, and this folder is in memory: {}",
        folder.display()
    );
    Ok(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_two_lies_between_them() {
        assert_eq!(median([4.0, 1.0]), 2.5);
        assert_eq!(median([3.0, 1.0, 2.0]), 2.0);
        assert!(median([]).is_nan());
    }

    #[test]
    fn quantiles_are_values_that_were_there() {
        let values = [1.0, 2.0, 3.0, 4.0];
        assert_eq!(
            [0.0, 0.5, 1.0].map(|q| quantile(&values, q)),
            [1.0, 3.0, 4.0]
        );
        assert!(quantile(&[], 0.5).is_nan());
    }

    #[test]
    fn memory_is_no_disk() {
        let Some(memory) = Some(PathBuf::from("/dev/shm")).filter(|p| p.is_dir()) else {
            eprintln!("skipped: no /dev/shm here");
            return;
        };
        assert!(on_disk(Some(memory)).is_err());
    }
}
