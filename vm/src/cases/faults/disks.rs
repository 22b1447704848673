//! Faults of disks, in real time.

use std::collections::BTreeSet;

use anyhow::{Context as _, Result, ensure};
use session_archive::record::Gap;
use session_archive::record::paws::gap::Cause;

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

pub(super) const FULL: Case = case("fault-disk-full", "somebody else fills the disk", |bench| {
    let during = "dd if=/dev/zero of=/run/archive/other bs=1M 2>/dev/null; sync; sleep 5; rm /run/archive/other";
    let left = happen(bench, during)?;
    // A disk may be so full that not even the manifest fits any more; then the session stays open.
    let session = left.sessions.first().context("no session is left")?;
    session.is_accounted_for()?;
    let stopped = session.stopped.clone().unwrap_or_default();
    let told = session
        .events
        .iter()
        .any(|(_, source, text)| source == "disk" || text.contains("disk"));
    ensure!(
        told,
        "no event names the disk, and the session ended for {stopped:?}: {:?}",
        session.events
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
        let kept = session.stream(IMU)?.span_ns as f64 / 1e9;
        ensure!(kept > 1.9, "{kept:.2} s are left of 3 s");
        left.report(format!("the state is a fault; {kept:.2} s are left of 3 s"))
    },
);

pub(super) const SLOW: Case = case(
    "fault-disk-slow",
    "the disk stalls for a second, five times",
    |bench| {
        let during = "for _ in 1 2 3 4 5; do
            dmsetup suspend --noflush --nolockfs rig || exit 4
            sleep 1
            dmsetup resume rig || exit 4
            sleep 1
        done";
        let left = happen(bench, during)?;
        let session = left.session()?;
        let missing: u64 = session.gaps.iter().map(Gap::count).sum();
        let causes: BTreeSet<&str> = session
            .gaps
            .iter()
            .map(|gap| gap.cause().as_str_name())
            .collect();
        // In real time a busy host loses samples in front of the daemon.
        let by_disk = session
            .gaps
            .iter()
            .find(|gap| matches!(gap.cause(), Cause::Storage | Cause::Unknown));
        ensure!(
            by_disk.is_none(),
            "a stall is no failure: {by_disk:?}, {:?}",
            session.gaps
        );
        let imu = session.missing(IMU, Cause::WriterOverload);
        ensure!(imu == 0, "{IMU} misses {imu}: IMU samples wait");
        left.report(format!("{missing} samples are missing {causes:?}"))
    },
);
