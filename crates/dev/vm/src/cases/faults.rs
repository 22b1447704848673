//! `fault-…`: something breaks while the daemon records. The recording goes on where it can, every
//! hole has its cause, alarms begin and end, and nothing hangs.
//!
//! Every fault is one guest in virtual time: the rig of `devices`, a recording, the fault in its
//! midst, an end by command. So whatever is missing is missing because of the fault. Faults of
//! disks have ext4 over the device mapper on a file in memory, which, unlike a disk of the guest's,
//! does not move the clock.

use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context as _, Result, ensure};
use serde_json::{Value, json};
use session_archive::record::paws::event::Kind;
use session_archive::record::paws::gap::Cause;

use super::config::{self, CAMERAS, IMU};
use crate::account::{Account, validate};
use crate::case::{Bench, Case, Report};
use crate::guest::Guest;

mod cameras;
mod daemon;
mod disks;
mod imus;
mod operator;
mod power;

/// All of them.
pub(super) const CASES: [Case; 24] = [
    cameras::DROPPED,
    cameras::DAMAGED,
    cameras::ERROR,
    cameras::UNPLUGGED,
    cameras::AWAY,
    cameras::ALL_GONE,
    imus::SILENT,
    imus::STOPPED,
    imus::LATE_PINGS,
    imus::DEAF,
    imus::GONE,
    operator::BUTTON_GONE,
    operator::KEY_GONE,
    operator::CLOCK_STEP,
    power::BATTERY,
    daemon::HELD_UP,
    daemon::KILLED,
    disks::FULL,
    disks::NO_SPACE,
    disks::ERRORS,
    disks::BAD_PLACE,
    disks::STALLS,
    disks::SLOW,
    disks::HANGS,
];

/// A camera, for faults that hit one.
const CAMERA: &str = CAMERAS[0];

const fn case(name: &'static str, shows: &'static str, run: fn(&Bench) -> Result<Report>) -> Case {
    Case {
        name,
        shows,
        quick: false,
        on_qemu: false,
        run,
    }
}

/// What breaks, and how.
#[derive(Clone, Copy, Default)]
struct Fault {
    /// On ext4, or in memory.
    on_disk: bool,
    /// Settings of the shell's variables IMU (arguments of the IMU) and RESERVE_GB.
    given: &'static str,
    /// Runs between start and stop, three seconds after the one and before the other.
    during: &'static str,
    /// Metrics of `paws validate` with other limits.
    limits: &'static [&'static str],
}

/// Result of a run.
struct FaultRun {
    fault: Fault,
    job: PathBuf,
    sessions: Vec<Account>,
    /// What `pawsd status --json` said just before the stop.
    status: Value,
}

const BEGIN: &str = r#"
mkdir -p /run/archive
now() { cut -d' ' -f1 /proc/uptime; }
if [ -n "$ON_DISK" ]; then
  mkdir -p /run/memory && mount -t tmpfs -o size=700M tmpfs /run/memory && truncate -s 2G /run/memory/disk &&
    mkfs.ext4 -q -E lazy_itable_init=0,lazy_journal_init=0 /run/memory/disk || exit 9
  disk=$(losetup -f --show /run/memory/disk) && sectors=$(blockdev --getsz $disk)
  dmsetup create rig --table "0 $sectors linear $disk 0" && dmsetup mknodes && mount /dev/mapper/rig /run/archive || exit 9
  # disk_becomes TABLE [OPTIONS of suspend]: from now on the disk is another one.
  disk_becomes() { dmsetup suspend ${@:2} rig && dmsetup load rig --table "$1" && dmsetup resume rig; }
  available() { df --output=avail -B1 /run/archive | tail -1; }
else
  mount -t tmpfs -o size=512M tmpfs /run/archive || exit 9
fi
sed -i "s/^reserve_gb = .*/reserve_gb = ${RESERVE_GB:-0}/" pawsd.toml
cameras 30 || exit 8
imu --rate 800 --frames 30 $IMU
gpio_chip || exit 7
daemon || exit 6
pawsd start >/dev/null || exit 5
sleep 3
"#;

const END: &str = r"
sleep 3
pawsd status --json >status.json
pawsd stop >/dev/null 2>stop.txt
kill $daemon; wait $daemon; echo $? >daemon.code
kill -INT $imu; wait $imu
mkdir sessions && cp -r /run/archive/*-* sessions/
";

impl Fault {
    /// Runs the recording with the fault.
    fn happen(&self, bench: &Bench) -> Result<FaultRun> {
        let job = bench.folder("job")?;
        fs::write(job.join("pawsd.toml"), config::devices(true))?;
        let on_disk = if self.on_disk { "1" } else { "" };
        let script = format!(
            "ON_DISK={on_disk}\n{}\n{BEGIN}\n{}\n{END}",
            self.given, self.during
        );
        let guest = Guest::new(&job, script).error_injection().memory_mb(1536);
        let ended = guest
            .virtual_time()
            .run(&bench.machine, Duration::from_secs(1800));
        ended?.success()?;
        let left = FaultRun {
            fault: *self,
            sessions: Account::read_all(&job.join("sessions"))?,
            status: Value::Null,
            job,
        };
        let status = serde_json::from_str(&left.file("status.json")?);
        Ok(FaultRun {
            status: status.context("reading status.json")?,
            ..left
        })
    }
}

impl FaultRun {
    /// A file that the script wrote.
    fn file(&self, name: &str) -> Result<String> {
        let path = self.job.join(name);
        fs::read_to_string(&path).with_context(|| format!("reading {}", path.display()))
    }

    /// The only session, closed, with every sample accounted for and every hole with its cause.
    fn session(&self) -> Result<&Account> {
        ensure!(
            self.sessions.len() == 1,
            "{} sessions, expected one",
            self.sessions.len()
        );
        is_accounted_for(&self.sessions[0])?;
        Ok(&self.sessions[0])
    }

    /// Two sessions with nothing missing, the first one stopped by this.
    fn two_whole_sessions(&self, stopped_by: &str) -> Result<()> {
        ensure!(
            self.sessions.len() == 2,
            "{} sessions, expected two",
            self.sessions.len()
        );
        for session in &self.sessions {
            is_accounted_for(session)?;
            ensure!(session.gaps.is_empty(), "{:?}", session.gaps);
        }
        let stopped = self.sessions[0].stopped.clone().unwrap_or_default();
        ensure!(stopped == stopped_by, "stopped by {stopped:?}");
        Ok(())
    }

    /// Streams that were not hit have everything.
    fn others_are_whole(&self, hit: &[&str]) -> Result<()> {
        let session = self.session()?;
        for name in CAMERAS.into_iter().chain([IMU]) {
            let stream = session.stream(name)?;
            ensure!(
                hit.contains(&name) || stream.gaps == 0,
                "{name} was not hit and has gaps, {stream:?}: {:?}",
                session.gaps
            );
        }
        Ok(())
    }

    /// How many samples of a stream are missing, all for this cause.
    fn missing(&self, stream: &str, cause: Cause) -> Result<u64> {
        let session = self.session()?;
        let (missing, all) = (session.missing(stream, cause), session.stream(stream)?.gaps);
        ensure!(
            missing == all,
            "{stream}: {missing} samples are missing for {}, {all} in all: {:?}",
            cause.as_str_name(),
            session.gaps
        );
        Ok(missing)
    }

    /// The stream delivered at the end again, and no alarm is active any more.
    fn is_back(&self, stream: &str) -> Result<()> {
        let streams = self.status["streams"].as_array();
        let streams = streams.context("a status without streams")?;
        let found = streams.iter().find(|s| s["name"] == stream);
        let rate = found.and_then(|s| s["rate_hz"].as_f64()).unwrap_or(0.0);
        ensure!(rate > 1.0, "{stream} has not come back: {}", self.status);
        ensure!(
            self.status["alarms"].as_array().is_some_and(Vec::is_empty),
            "alarms at the end: {}",
            self.status["alarms"]
        );
        Ok(())
    }

    /// Checks what must hold for every fault, and reports. In the session, alarms that began have
    /// ended, except those whose text begins with one of `standing`.
    fn report(&self, bench: &Bench, standing: &[&str], line: String) -> Result<Report> {
        for session in &self.sessions {
            alarms_end(session, standing)?;
        }
        let limits = [&LIMITS, self.fault.limits].concat();
        validate(&bench.machine.host_program("paws"), &self.sessions, &limits)?;
        Ok(Report {
            line,
            figures: json!({
                "sessions": self.sessions.iter().map(Account::figures).collect::<Vec<Value>>(),
                "alarms": self.status["alarms"],
            }),
        })
    }
}

/// `paws validate` is to find fault with nothing but what is missing; vivid's frames come by ticks
/// of 1 ms.
const LIMITS: [&str; 7] = [
    "camera.period_deviation=1500000,2000000",
    "camera.dropped=never,never",
    "camera.longest_gap=never,never",
    "imu.dropped=never,never",
    "imu.longest_gap=never,never",
    "stream.start_offset=never,never",
    "stream.end_offset=never,never",
];

/// Closed, or recovered; every sample is there or in a gap record, and every gap record has a cause
/// and says what happened.
fn is_accounted_for(session: &Account) -> Result<()> {
    session.is_accounted_for()?;
    ensure!(session.closed, "not closed: {}", session.folder.display());
    let silent = |gap: &&session_archive::record::Gap| {
        gap.cause() == Cause::Unknown || gap.detail.is_empty()
    };
    let without = session.gaps.iter().find(silent);
    ensure!(without.is_none(), "a gap without a cause: {without:?}");
    Ok(())
}

fn alarms_end(session: &Account, standing: &[&str]) -> Result<()> {
    for (i, (kind, _, text)) in session.events.iter().enumerate() {
        let ends =
            |(kind, _, other): &(Kind, String, String)| *kind == Kind::Cleared && other == text;
        ensure!(
            *kind != Kind::Fault
                || standing.iter().any(|begin| text.starts_with(begin))
                || session.events[i..].iter().any(ends),
            "the alarm {text:?} does not end: {:?}",
            session.events
        );
    }
    Ok(())
}
