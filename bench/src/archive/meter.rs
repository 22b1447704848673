//! Wall time and processor time of a piece of work, and statistics of several.

use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};

/// What one run took.
#[derive(Clone, Copy, Debug)]
pub(super) struct Took {
    pub(super) wall_s: f64,
    /// Processor time of the whole process, the kernel's on its behalf included.
    pub(super) cpu_s: f64,
}

/// Runs `work` and measures it.
pub(super) fn timed<T>(work: impl FnOnce() -> T) -> (T, Took) {
    let (cpu, wall) = (cpu(), Instant::now());
    let result = work();
    let took = Took {
        wall_s: wall.elapsed().as_secs_f64(),
        cpu_s: (self::cpu() - cpu).as_secs_f64(),
    };
    (result, took)
}

fn cpu() -> Duration {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}

/// The value below which a share `q` of the values lies; sorts them.
pub(super) fn quantile(values: &mut [f64], q: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    let at = (q * last as f64).round() as usize;
    values.get(at).copied().unwrap_or(f64::NAN)
}

/// The middle value.
pub(super) fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    quantile(&mut values.into_iter().collect::<Vec<_>>(), 0.5)
}
