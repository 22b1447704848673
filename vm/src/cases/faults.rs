//! `fault-…`: something breaks while the daemon records. The recording goes on where it can, every hole has its cause, and
//! nothing hangs.
//!
//! Every fault is one guest: the rig of `devices`, a recording, the fault in its midst, an end by command. Faults of devices and
//! clocks come in virtual time, where whatever is missing is missing because of the fault. Faults of disks come in real time, on
//! ext4 over the device mapper.

use std::fs;
use std::time::Duration;

use anyhow::{Context as _, Result, ensure};
use serde_json::{Value, json};
use session_archive::record::paws::gap::Cause;

use super::config::{self, CAMERAS, IMU};
use crate::account::Account;
use crate::case::{Bench, Case, Report};
use crate::guest::Guest;
use crate::image::{self, FileSystem};

mod devices;
mod disks;

/// All of them.
pub(super) const CASES: [Case; 12] = [
    devices::DROPPED,
    devices::IO_ERROR,
    devices::UNPLUGGED,
    devices::IMU_SILENT,
    devices::IMU_STOPPED,
    devices::IMU_GONE,
    devices::BUTTON_GONE,
    devices::CLOCK_STEP,
    devices::KILLED,
    disks::FULL,
    disks::ERRORS,
    disks::SLOW,
];

/// What breaks, and how.
struct Fault {
    /// On a disk and in real time, or in memory and in virtual time.
    on_disk: bool,
    /// Arguments of the IMU.
    imu: &'static str,
    /// Runs between start and stop, three seconds after the one and before the other.
    during: &'static str,
}

/// What it left.
struct Left {
    sessions: Vec<Account>,
    /// What `pawsd status --json` said just before the stop.
    status: Value,
}

const BEGIN: &str = r#"
mkdir -p /run/archive
if [ -n "$DISK0" ]; then
  sectors=$(blockdev --getsz $DISK0)
  dmsetup create rig --table "0 $sectors linear $DISK0 0" && dmsetup mknodes || exit 9
  mount /dev/mapper/rig /run/archive || exit 9
else
  mount -t tmpfs -o size=512M tmpfs /run/archive || exit 9
fi
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
kill $daemon; wait $daemon
kill -INT $imu; wait $imu
mkdir sessions && cp -r /run/archive/*-* sessions/
";

impl Fault {
    /// Lets it happen.
    fn happen(&self, bench: &Bench) -> Result<Left> {
        self.happen_without_end(bench, "status.json")
    }

    /// The same, where the fault's own script may not come to the end; `status` is the file in which it left the daemon's state.
    fn happen_without_end(&self, bench: &Bench, status: &str) -> Result<Left> {
        let job = bench.folder("job")?;
        fs::write(job.join("pawsd.toml"), config::devices(true))?;
        let script = format!("IMU='{}'\n{BEGIN}\n{}\n{END}", self.imu, self.during);
        let mut guest = Guest::new(&job, script).error_injection().memory_mb(1536);
        if self.on_disk {
            let disk = bench.folder.join("disk.img");
            image::formatted(&disk, 1 << 30, FileSystem::Ext4)?;
            guest = guest.disk(disk);
        } else {
            guest = guest.virtual_time();
        }
        let ended = guest.run(&bench.machine, Duration::from_secs(600));
        ended?.success()?;
        let read = fs::read(job.join(status));
        let read = read.with_context(|| format!("reading {status}"))?;
        Ok(Left {
            sessions: Account::read_all(&job.join("sessions"))?,
            status: serde_json::from_slice(&read).with_context(|| format!("reading {status}"))?,
        })
    }
}

impl Left {
    /// The only session, closed, with every sample accounted for.
    fn session(&self) -> Result<&Account> {
        ensure!(
            self.sessions.len() == 1,
            "{} sessions, expected one",
            self.sessions.len()
        );
        let session = &self.sessions[0];
        session.is_accounted_for()?;
        ensure!(session.closed, "the session was not closed");
        Ok(session)
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
            missing > 0 && missing == all,
            "{stream}: {missing} samples are missing for {}, {all} in all: {:?}",
            cause.as_str_name(),
            session.gaps
        );
        Ok(missing)
    }

    /// The stream delivered at the end again.
    fn is_back(&self, stream: &str) -> Result<()> {
        let streams = self.status["streams"].as_array();
        let streams = streams.context("a status without streams")?;
        let found = streams.iter().find(|s| s["name"] == stream);
        let rate = found.and_then(|s| s["rate_hz"].as_f64()).unwrap_or(0.0);
        ensure!(rate > 1.0, "{stream} has not come back: {}", self.status);
        Ok(())
    }

    fn report(&self, line: String) -> Result<Report> {
        Ok(Report {
            line,
            figures: json!({
                "sessions": self.sessions.iter().map(Account::figures).collect::<Vec<Value>>(),
                "alarms": self.status["alarms"],
            }),
        })
    }
}
