//! Faults of disks, in real time.

use std::fs;

use anyhow::{Context as _, Result, ensure};

use super::{Fault, Left};
use crate::case::{Bench, Case, Report};
use crate::cases::config::IMU;

const fn case(name: &'static str, shows: &'static str, run: fn(&Bench) -> Result<Report>) -> Case {
    Case {
        name,
        shows,
        quick: false,
        on_qemu: false,
        run,
    }
}

fn happen(bench: &Bench, during: &'static str) -> Result<Left> {
    let fault = Fault {
        on_disk: true,
        imu: "",
        during,
    };
    fault.happen(bench)
}

/// The stop's exit code.
fn code(left: &Left) -> Result<String> {
    let code = fs::read_to_string(left.job.join("stop.code")).context("reading stop.code")?;
    Ok(code.trim().to_owned())
}

pub(super) const FULL: Case = case("fault-disk-full", "somebody else fills the disk", |bench| {
    let during = "dd if=/dev/zero of=/run/archive/other bs=1M 2>/dev/null; sync; sleep 5; rm /run/archive/other";
    let left = happen(bench, during)?;
    let session = left.session()?;
    let stopped = session.stopped.clone().unwrap_or_default();
    ensure!(
        stopped.contains("disk"),
        "the session ended for {stopped:?}, expected the disk"
    );
    let span = session.stream(IMU)?.span_ns as f64 / 1e9;
    left.report(format!(
        "ended by itself for {stopped:?} with {span:.1} s in it"
    ))
});

pub(super) const ERRORS: Case = case(
    "fault-disk-errors",
    "the disk fails every write and read from some instant on",
    |bench| {
        // What is on the disk is read after it has been taken out and put in again.
        let during = r#"
dmsetup suspend --noflush --nolockfs rig && dmsetup load rig --table "0 $sectors error" && dmsetup resume rig || exit 4
sleep 5; pawsd status --json >broken.json
kill -9 $daemon; wait $daemon; umount -l /run/archive
dmsetup suspend --noflush --nolockfs rig; dmsetup load rig --table "0 $sectors linear $DISK0 0"; dmsetup resume rig
mkdir -p /run/again; dmsetup create again --table "0 $sectors linear $DISK0 0" && dmsetup mknodes && mount /dev/mapper/again /run/again || exit 3
mkdir sessions && cp -r /run/again/*-* sessions/; exit 0"#;
        let fault = Fault {
            on_disk: true,
            imu: "",
            during,
        };
        let left = fault.happen_without_end(bench, "broken.json")?;
        ensure!(
            left.status["state"] == "fault",
            "the state after the disk had failed is {}, expected a fault",
            left.status["state"]
        );
        let session = left.sessions.first().context("no session is left")?;
        session.is_accounted_for()?;
        let durable = left.status["durable_until"].as_i64().unwrap_or(0);
        ensure!(durable > 0, "nothing was reported durable: {}", left.status);
        let kept = session.stream(IMU)?.span_ns as f64 / 1e9;
        ensure!(kept > 1.9, "{kept:.2} s are left of 3 s");
        left.report(format!("the state is a fault; {kept:.2} s are left of 3 s"))
    },
);

pub(super) const SLOW: Case = case(
    "fault-disk-slow",
    "for ten seconds every write takes the disk a second",
    |bench| {
        let during = r#"
dmsetup suspend rig && dmsetup load rig --table "0 $sectors delay $DISK0 0 0 $DISK0 0 1000" && dmsetup resume rig || exit 4
sleep 10
dmsetup suspend rig && dmsetup load rig --table "0 $sectors linear $DISK0 0" && dmsetup resume rig || exit 3"#;
        let left = happen(bench, during)?;
        let session = left.session()?;
        let imu = session.stream(IMU)?;
        ensure!(imu.gaps == 0, "{IMU}: {imu:?}: {:?}", session.gaps);
        let missing: u64 = session
            .gaps
            .iter()
            .map(session_archive::record::Gap::count)
            .sum();
        left.report(format!("no IMU sample is missing, {missing} frames are, with their cause; pawsd stop ended with {}", code(&left)?),
        )
    },
);
