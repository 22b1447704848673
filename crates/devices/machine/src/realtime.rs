//! What a recorder requests of the kernel: to run immediately when a frame arrives, and not to wait
//! for its own memory.
//!
//! Contract: nothing here fails. Each call says what was achieved, or why not and what to set in
//! the unit; a recorder without either records all the same, and is only later when the machine is
//! busy.
//!
//! **Scheduling.** `SCHED_RR` at a low priority goes before everything ordinary and behind the
//! kernel's own threads (50) and the Jetson's daemons. Threads that a real-time thread starts are
//! ordinary again (`SCHED_RESET_ON_FORK`): an encoder at real-time priority would starve the
//! machine. Only for threads that wait nearly all the time; sched(7) says how much of each second
//! is left to others.
//!
//! **Memory.** `mlockall` with `MCL_ONFAULT`: touched pages remain in memory, what is only reserved
//! costs nothing. Without it, every stack and every arena that GStreamer reserves is filled
//! immediately: a pipeline with three software encoders (1280x720, x264) took 207 MB at most
//! instead of 97 MB, and 88 MB this way. A limit that is not unlimited is worse than no lock:
//! reserved memory counts against it, and the allocation that exceeds it fails (16 MiB did under a
//! limit of 8 MiB).

use std::io;

use rustix::process::{Resource, getrlimit};
use serde::Serialize;

use crate::sysfs::{Roots, text};

/// The priority to ask for: 1 is the lowest, 99 the highest of the kernel.
pub const PRIORITY: u8 = 10;

/// Result of a request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Granted.
    Achieved,
    /// Not granted; why, and what to do.
    Refused(String),
}

impl std::fmt::Display for Outcome {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Achieved => f.write_str("achieved"),
            Self::Refused(why) => f.write_str(why),
        }
    }
}

/// Asks for real time for the calling thread, at `priority` of 1 to 99.
pub fn this_thread(priority: u8) -> Outcome {
    // SAFETY: a plain struct of integers, valid as all zeros.
    let mut parameters: libc::sched_param = unsafe { std::mem::zeroed() };
    parameters.sched_priority = libc::c_int::from(priority);
    let policy = libc::SCHED_RR | libc::SCHED_RESET_ON_FORK;
    // SAFETY: `parameters` lives through the call, which only reads it; 0 is the calling thread.
    if unsafe { libc::sched_setscheduler(0, policy, &raw const parameters) } == 0 {
        return Outcome::Achieved;
    }
    let error = io::Error::last_os_error();
    Outcome::Refused(match error.raw_os_error() {
        Some(libc::EPERM) => {
            let limit = getrlimit(Resource::Rtprio).current;
            no_real_time(
                priority,
                limit.is_none_or(|limit| limit >= u64::from(priority)),
            )
        }
        _ => format!("no real time at priority {priority}: {error}"),
    })
}

fn no_real_time(priority: u8, is_within_limit: bool) -> String {
    if is_within_limit {
        // Documentation/admin-guide/cgroup-v2.rst, "CPU": a kernel with CONFIG_RT_GROUP_SCHED.
        format!(
            "no real time at priority {priority} although the limit allows it: this kernel gives services no \
             share of it; `sysctl kernel.sched_rt_runtime_us=-1` lifts that"
        )
    } else {
        format!("no real time at priority {priority}: set LimitRTPRIO={priority} in the unit")
    }
}

/// Keeps this process's memory from being swapped or dropped, now and from now on, page by page as
/// it is touched.
pub fn lock_memory(roots: &Roots) -> Outcome {
    let limit = getrlimit(Resource::Memlock).current;
    if let (Some(limit), false) = (limit, may_lock_anything(roots)) {
        return Outcome::Refused(format!(
            "memory is not locked: the limit of {limit} bytes would make allocations fail; set \
             LimitMEMLOCK=infinity in the unit"
        ));
    }
    let flags = libc::MCL_CURRENT | libc::MCL_FUTURE | libc::MCL_ONFAULT;
    // SAFETY: takes only flags, and changes how pages are kept, not what is in them.
    if unsafe { libc::mlockall(flags) } == 0 {
        return Outcome::Achieved;
    }
    let error = io::Error::last_os_error();
    Outcome::Refused(format!("memory is not locked: {error}"))
}

/// Lets memory be swapped and dropped again.
pub fn unlock_memory() {
    // SAFETY: takes nothing, and changes how pages are kept, not what is in them.
    unsafe { libc::munlockall() };
}

/// Whether this process has the capability that lifts the limit (`CAP_IPC_LOCK`, capabilities(7)).
fn may_lock_anything(roots: &Roots) -> bool {
    const CAP_IPC_LOCK: u32 = 14;
    let status = text(roots.proc.join("self/status")).unwrap_or_default();
    let effective = status.lines().find_map(|line| {
        let hex = line.strip_prefix("CapEff:")?.trim();
        u64::from_str_radix(hex, 16).ok()
    });
    effective.is_some_and(|effective| effective >> CAP_IPC_LOCK & 1 == 1)
}

/// Memory of this process that is locked, bytes, if the kernel tells.
pub fn locked_bytes(roots: &Roots) -> Option<u64> {
    let status = text(roots.proc.join("self/status"))?;
    let kilobytes = status.lines().find_map(|line| {
        let rest = line.strip_prefix("VmLck:")?.trim();
        rest.strip_suffix("kB")?.trim().parse::<u64>().ok()
    })?;
    Some(kilobytes * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sysfs::fake::tree;

    #[test]
    fn refusals_say_what_to_set() {
        let text = no_real_time(10, false);
        assert_eq!(
            text,
            "no real time at priority 10: set LimitRTPRIO=10 in the unit"
        );
        assert!(no_real_time(10, true).contains("sched_rt_runtime_us"));
        let impossible = this_thread(200);
        assert_ne!(impossible, Outcome::Achieved, "100 and above do not exist");
    }

    #[test]
    fn the_capability_is_read_from_the_process() {
        let may = |capabilities: &str| {
            let (_root, roots) = tree(&format!("proc/self/status = CapEff: {capabilities}"));
            may_lock_anything(&roots)
        };
        assert!(may("000001ffffffffff"));
        assert!(may("0000000000004000"));
        assert!(!may("0000000000003fff"));
        assert!(!may("many"));
        let (_root, roots) = tree("proc/self/stat = 1");
        assert!(!may_lock_anything(&roots));
        assert_eq!(locked_bytes(&roots), None);
    }

    #[test]
    fn a_thread_reports_its_policy() {
        let thread = std::thread::spawn(|| {
            let outcome = this_thread(1);
            // SAFETY: reads the policy of the calling thread.
            (outcome, unsafe { libc::sched_getscheduler(0) })
        });
        let (outcome, policy) = thread.join().unwrap();
        // Whether it is allowed depends on who runs the test; that it is reported correctly does
        // not.
        let is_real_time = policy == libc::SCHED_RR | libc::SCHED_RESET_ON_FORK;
        assert_eq!(
            outcome == Outcome::Achieved,
            is_real_time,
            "{outcome}, {policy}"
        );
    }

    #[test]
    fn locking_says_truly_whether_it_did() {
        let roots = Roots::default();
        let outcome = lock_memory(&roots);
        let locked = locked_bytes(&roots).unwrap_or_default();
        unlock_memory();
        assert_eq!(
            outcome == Outcome::Achieved,
            locked > 0,
            "{outcome}, {locked} bytes"
        );
    }
}
