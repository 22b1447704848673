//! Reading the clocks, and who keeps them right.

use std::io;
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use rustix::time::{
    ClockId, Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, Timespec, timerfd_create,
    timerfd_settime,
};
use serde::Serialize;

use super::{ClockReading, Kernel, Leap};
use crate::NS_PER_S;
use crate::sysfs::{Roots, names, numbered, text};

/// How often the clocks are read for one look; the best one counts.
const TRIES: usize = 5;
/// Good enough not to try again, ns.
const TIGHT_NS: i64 = 2_000;

/// Reads the clocks. Takes a few microseconds; tries again when it was interrupted in between.
#[expect(
    clippy::disallowed_methods,
    reason = "this is where this crate reads the clocks; everything else is handed what they said"
)]
pub fn read() -> ClockReading {
    let clock = |id| {
        let t = rustix::time::clock_gettime(id);
        t.tv_sec * NS_PER_S + t.tv_nsec
    };
    let once = || {
        let before = clock(ClockId::Monotonic);
        let realtime_ns = clock(ClockId::Realtime);
        let boottime_ns = clock(ClockId::Boottime);
        let after = clock(ClockId::Monotonic);
        ClockReading {
            monotonic_ns: before + (after - before) / 2,
            realtime_ns,
            boottime_ns,
            apart_ns: after - before,
            kernel: None,
        }
    };
    let mut best = once();
    for _ in 1..TRIES {
        if best.apart_ns <= TIGHT_NS {
            break;
        }
        let reading = once();
        if reading.apart_ns < best.apart_ns {
            best = reading;
        }
    }
    best.kernel = kernel().ok();
    best
}

/// Asks the kernel about its civil clock. Needs no privilege; a system call filter may refuse it.
fn kernel() -> io::Result<Kernel> {
    let mut timex = MaybeUninit::<libc::timex>::zeroed();
    // SAFETY: `timex` is a plain struct of integers, valid as all zeros, and mode 0 only reads: the
    // kernel writes it whole.
    let (state, timex) = unsafe {
        let state = libc::adjtimex(timex.as_mut_ptr());
        (state, timex.assume_init())
    };
    if state < 0 {
        return Err(io::Error::last_os_error());
    }
    Ok(meaning(state, &timex))
}

pub(super) fn meaning(state: libc::c_int, timex: &libc::timex) -> Kernel {
    let has = |bit| timex.status & bit != 0;
    let unit_ns = if has(libc::STA_NANO) { 1 } else { 1000 };
    #[expect(
        clippy::useless_conversion,
        reason = "c_long has 32 bits on some machines"
    )]
    let wide = |value: libc::c_long| i64::from(value);
    Kernel {
        synchronised: !has(libc::STA_UNSYNC) && state != libc::TIME_ERROR,
        offset_ns: wide(timex.offset).saturating_mul(unit_ns),
        estimated_error_ns: wide(timex.esterror).saturating_mul(1000),
        max_error_ns: wide(timex.maxerror).saturating_mul(1000),
        // In the kernel's unit of 2⁻¹⁶ parts per million.
        frequency_ppb: (wide(timex.freq).saturating_mul(1000)) >> 16,
        tai_offset_s: timex.tai,
        leap: match state {
            libc::TIME_INS => Leap::Insert,
            libc::TIME_DEL => Leap::Delete,
            libc::TIME_OOP => Leap::Now,
            libc::TIME_WAIT => Leap::Done,
            _ => Leap::None,
        },
    }
}

/// Wakes a thread when civil time is set: a timer in the far future that the kernel cancels then
/// (timerfd_create(2), `TFD_TIMER_CANCEL_ON_SET`).
#[derive(Debug)]
pub struct StepAlarm {
    timer: OwnedFd,
}

impl StepAlarm {
    /// Watches from now on.
    ///
    /// # Errors
    /// The kernel gives no timer.
    pub fn new() -> io::Result<Self> {
        let flags = TimerfdFlags::CLOEXEC | TimerfdFlags::NONBLOCK;
        let timer = timerfd_create(TimerfdClockId::Realtime, flags)?;
        let never = Itimerspec {
            it_interval: Timespec::default(),
            it_value: Timespec {
                tv_sec: i64::MAX,
                tv_nsec: 0,
            },
        };
        let flags = TimerfdTimerFlags::ABSTIME | TimerfdTimerFlags::CANCEL_ON_SET;
        timerfd_settime(&timer, flags, &never)?;
        Ok(Self { timer })
    }

    /// Waits until civil time is set or the machine wakes from a suspension (true), or `limit` is
    /// over (false). Every step wakes once; several before the call wake it once together.
    ///
    /// # Errors
    /// The kernel refuses to wait.
    pub fn wait(&self, limit: Duration) -> io::Result<bool> {
        let limit = Timespec::try_from(limit).ok();
        let mut fds = [PollFd::new(&self.timer, PollFlags::IN)];
        match poll(&mut fds, limit.as_ref()) {
            Ok(0) | Err(Errno::INTR) => Ok(false),
            Ok(_) => self.take(),
            Err(error) => Err(error.into()),
        }
    }

    /// Whether civil time was set since the last call, for callers that wait for several
    /// descriptors.
    ///
    /// # Errors
    /// The kernel refuses to tell.
    pub fn take(&self) -> io::Result<bool> {
        match rustix::io::read(&self.timer, &mut [0; 8]) {
            Err(Errno::CANCELED) => Ok(true),
            Err(Errno::AGAIN | Errno::INTR) | Ok(_) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }
}

impl AsFd for StepAlarm {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.timer.as_fd()
    }
}

/// Who keeps the machine's clock right, judged from outside: none of them is queried.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Discipline {
    /// Programs at work, by the names people know.
    pub programs: Vec<String>,
    /// Network cards and others with a clock of their own.
    pub ptp_clocks: Vec<String>,
    /// `systemd-timesyncd` has reached a server since boot.
    pub timesyncd_has_synchronised: bool,
}

impl std::fmt::Display for Discipline {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.programs.is_empty() {
            f.write_str("nobody")
        } else {
            f.write_str(&self.programs.join(", "))
        }
    }
}

/// Looks who keeps the clock right. Goes through all processes: once in a while, not every second.
pub fn discipline(roots: &Roots) -> Discipline {
    // Names of processes are cut after 15 characters, proc_pid_comm(5).
    const KNOWN: [(&str, &str); 6] = [
        ("chronyd", "chrony"),
        ("systemd-timesyn", "systemd-timesyncd"),
        ("ntpd", "ntpd"),
        ("ptp4l", "ptp4l"),
        ("phc2sys", "phc2sys"),
        ("timemaster", "timemaster"),
    ];
    let running: Vec<String> = numbered(&roots.proc, "")
        .into_iter()
        .filter_map(|(_, folder)| text(folder.join("comm")))
        .collect();
    let programs = KNOWN
        .iter()
        .filter(|(comm, _)| running.iter().any(|name| name == comm))
        .map(|(_, name)| (*name).to_owned())
        .collect();
    let ptp = roots.sys.join("class/ptp");
    let ptp_clocks = names(&ptp)
        .into_iter()
        .map(|name| text(ptp.join(&name).join("clock_name")).unwrap_or(name))
        .collect();
    Discipline {
        programs,
        ptp_clocks,
        timesyncd_has_synchronised: roots.run.join("systemd/timesync/synchronized").exists(),
    }
}
