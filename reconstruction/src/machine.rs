//! Clocks and memory use of this process.

use std::time::Duration;

use reconstruction::pipeline::Meter;

/// Clock and memory of this machine.
pub(crate) const METER: Meter = Meter {
    now: monotonic,
    forget_peak,
    peak_bytes,
};

/// Now, ns of UTC since 1970, as well as the machine knows it.
pub(crate) fn civil_ns() -> i64 {
    #[expect(
        clippy::disallowed_methods,
        reason = "the bundle records when it was made; nothing depends on it"
    )]
    let t = rustix::time::clock_gettime(rustix::time::ClockId::Realtime);
    t.tv_sec * 1_000_000_000 + t.tv_nsec
}

fn monotonic() -> Duration {
    #[expect(
        clippy::disallowed_methods,
        reason = "how long stages take is printed; nothing depends on it"
    )]
    let t = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    Duration::new(t.tv_sec.max(0) as u64, t.tv_nsec as u32)
}

/// proc_pid_clear_refs(5): 5 sets the peak of the resident memory to what it is now.
fn forget_peak() {
    // Where the kernel has no such file, the peak is that of the process.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// proc_pid_status(5).
fn peak_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix(" kB")?.trim().parse().ok()?;
    Some(1024 * kib)
}

/// Memory that this process can still take, bytes: of the machine (proc_meminfo(5)), and of its
/// control group where that has a limit (cgroup v2). `None` where neither is known.
pub(crate) fn available_bytes() -> Option<u64> {
    let meminfo = std::fs::read_to_string("/proc/meminfo").ok();
    let machine = meminfo.and_then(|text| {
        let line = text
            .lines()
            .find_map(|line| line.strip_prefix("MemAvailable:"))?;
        let kib: u64 = line.trim().strip_suffix(" kB")?.trim().parse().ok()?;
        Some(1024 * kib)
    });
    let number = |file: &str| -> Option<u64> {
        let text = std::fs::read_to_string(format!("/sys/fs/cgroup/{file}")).ok()?;
        // "max" without a limit.
        text.trim().parse().ok()
    };
    let group = number("memory.max").map(|most| {
        let used = number("memory.current").unwrap_or(0);
        most.saturating_sub(used)
    });
    [machine, group].into_iter().flatten().min()
}
