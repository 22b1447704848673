//! Faults of the disk.

use anyhow::{Result, ensure};
use session_archive::record::paws::gap::Cause;

use super::{Fault, FaultRun, case, is_accounted_for};
use crate::case::{Bench, Case, Report};
use crate::cases::config::{CAMERAS, IMU};

fn happen(bench: &Bench, during: &'static str) -> Result<FaultRun> {
    let fault = Fault {
        on_disk: true,
        during,
        ..Fault::default()
    };
    fault.happen(bench)
}

/// The disk broke three seconds after the start, for good, was mended, and the daemon started
/// again: it had said that it failed, closed what was left, and recorded once more. Returns the
/// seconds left of the first recording.
fn broken_and_mended(left: &FaultRun) -> Result<f64> {
    let during = left.file("broken.json")?;
    ensure!(
        during.contains("\"state\":\"fault\"") && during.contains("recording ended by a failure"),
        "the state with the broken disk: {during}"
    );
    cut_off_and_closed(left)
}

/// The first recording was cut off, was closed by the next start, and the next one is whole.
/// Seconds left of the first.
fn cut_off_and_closed(left: &FaultRun) -> Result<f64> {
    ensure!(left.sessions.len() == 2, "{} sessions", left.sessions.len());
    for session in &left.sessions {
        is_accounted_for(session)?;
    }
    let status = left.file("again.json")?;
    ensure!(
        status.contains("an earlier recording was cut off"),
        "started again it says: {status}"
    );
    ensure!(
        left.sessions[1].gaps.is_empty(),
        "{:?}",
        left.sessions[1].gaps
    );
    let kept = left.sessions[0].stream(IMU)?.span_ns as f64 / 1e9;
    ensure!(kept > 2.0, "{kept:.2} s are left of 3 s");
    Ok(kept)
}

pub(super) const FULL: Case = case(
    "fault-disk-full",
    "the disk is full up to the reserve",
    |bench| {
        let fault = Fault {
            on_disk: true,
            given: "RESERVE_GB=0.1",
            during: "fallocate -l $(($(available) - 100300000)) /run/archive/other || exit 4
                until_state armed || exit 3; pawsd status --json >full.json
                pawsd start >/dev/null 2>refused.txt && exit 2
                rm /run/archive/other; sleep 15; pawsd start >/dev/null || exit 1",
            ..Fault::default()
        };
        let left = fault.happen(bench)?;
        ensure!(left.sessions.len() == 2, "{} sessions", left.sessions.len());
        for session in &left.sessions {
            is_accounted_for(session)?;
            ensure!(session.gaps.is_empty(), "{:?}", session.gaps);
        }
        let alarmed = left.sessions[0]
            .events
            .iter()
            .any(|(_, source, _)| source == "disk");
        ensure!(alarmed, "no alarm: {:?}", left.sessions[0].events);
        let refused = left.file("refused.txt")?;
        left.report(
            bench,
            &["disk"],
            format!(
                "ended cleanly for {:?}, nothing is missing; a start is refused ({}) until there is room",
                left.sessions[0].stopped.clone().unwrap_or_default(),
                refused.trim()
            ),
        )
    },
);

pub(super) const NO_SPACE: Case = case(
    "fault-disk-no-space",
    "somebody takes all space at once, the reserve too",
    |bench| {
        let during = "fallocate -l $(available) /run/archive/other
            dd if=/dev/zero of=/run/archive/rest bs=4k 2>/dev/null
            sleep 3; pawsd status --json >broken.json
            rm /run/archive/other /run/archive/rest
            kill $daemon; wait $daemon; daemon || exit 4
            sleep 1; pawsd status --json >again.json; pawsd start >/dev/null || exit 3";
        let left = happen(bench, during)?;
        let kept = broken_and_mended(&left)?;
        left.report(
            bench,
            &[],
            format!("the state is a fault; {kept:.2} s are left of 3 s, closed by the next start"),
        )
    },
);

pub(super) const ERRORS: Case = case(
    "fault-disk-errors",
    "the disk fails every read and write, and is mended",
    |bench| {
        let during = r#"disk_becomes "0 $sectors error" --noflush --nolockfs || exit 4
            sleep 5; pawsd status --json >broken.json
            kill $daemon; wait $daemon; umount -l /run/archive
            disk_becomes "0 $sectors linear $disk 0" --noflush --nolockfs || exit 4
            dmsetup create again --table "0 $sectors linear $disk 0" && dmsetup mknodes && mount /dev/mapper/again /run/archive || exit 4
            daemon || exit 3
            sleep 1; pawsd status --json >again.json; pawsd start >/dev/null || exit 2"#;
        let left = happen(bench, during)?;
        let kept = broken_and_mended(&left)?;
        left.report(
            bench,
            &[],
            format!("the state is a fault; {kept:.2} s are left of 3 s, closed by the next start"),
        )
    },
);

/// 64 KiB right behind what the recording has on the disk: where the file system puts its next
/// chunk.
pub(super) const BAD_PLACE: Case = case(
    "fault-disk-bad-place",
    "a bad place on the disk, just where the recording goes on",
    |bench| {
        let during = r#"sync; segment=$(ls /run/archive/*/segments/* | tail -1)
            last=$(filefrag -v $segment | awk '/eof/ { split($0, f, ":"); split(f[3], b, "\\.\\."); print b[2] + 0 }')
            from=$(((last + 1) * 8)) n=128
            disk_becomes "0 $from linear $disk 0
            $from $n error
            $((from + n)) $((sectors - from - n)) linear $disk $((from + n))" --noflush --nolockfs || exit 4
            sleep 6"#;
        let left = happen(bench, during)?;
        let session = left.session()?;
        let mut most = 0;
        for camera in CAMERAS {
            most = most.max(left.missing(camera, Cause::Storage)?);
        }
        let samples = left.missing(IMU, Cause::Storage)?;
        // A chunk is half a second.
        ensure!(
            most <= 16 && samples <= 420,
            "more is missing than a chunk: {:?}",
            session.gaps
        );
        let has_event = session
            .events
            .iter()
            .any(|(_, source, text)| source == "disk" && text.contains("given up"));
        ensure!(has_event, "no event tells: {:?}", session.events);
        left.report(
            bench,
            &["segment", "the samples"],
            format!("at most {most} frames of a camera and {samples} IMU samples are missing, the rest is in a new segment"),
        )
    },
);

/// A disk that is late loses nothing: the queue to the recorder holds minutes of this rig.
fn loses_nothing(bench: &Bench, left: &FaultRun) -> Result<Report> {
    left.others_are_whole(&[])?;
    left.report(bench, &[], "nothing is missing".into())
}

pub(super) const STALLS: Case = case(
    "fault-disk-stalls",
    "the disk stalls for a second, five times",
    |bench| {
        let during = "for _ in 1 2 3 4 5; do
            dmsetup suspend --noflush --nolockfs rig || exit 4; sleep 1
            dmsetup resume rig || exit 4; sleep 1; done";
        loses_nothing(bench, &happen(bench, during)?)
    },
);

pub(super) const SLOW: Case = case(
    "fault-disk-slow",
    "for ten seconds every write takes the disk a second",
    |bench| {
        let during = r#"disk_becomes "0 $sectors delay $disk 0 0 $disk 0 1000" || exit 4; sleep 10
            disk_becomes "0 $sectors linear $disk 0" || exit 4"#;
        loses_nothing(bench, &happen(bench, during)?)
    },
);

pub(super) const HANGS: Case = case(
    "fault-disk-hangs",
    "the disk does not answer for 15 s: the daemon gives up after 10 and is started again",
    |bench| {
        let during = "dmsetup suspend --noflush --nolockfs rig || exit 4; hung=$(now)
            for _ in {1..15}; do sleep 1; [ -n \"$gave_up\" ] || grep -qs 'State:.Z' /proc/$daemon/status && gave_up=${gave_up:-$(now)}; done
            dmsetup resume rig; wait $daemon; echo \"$hung ${gave_up:-never} $?\" >hung.txt
            daemon || exit 3
            sleep 1; pawsd status --json >again.json; pawsd start >/dev/null || exit 2";
        let left = happen(bench, during)?;
        let hung = left.file("hung.txt")?;
        let words: Vec<f64> = hung
            .split_whitespace()
            .filter_map(|w| w.parse().ok())
            .collect();
        let [at, gave_up, code] = words[..] else {
            anyhow::bail!("the daemon did not give up: {hung}");
        };
        ensure!(
            (9.0..13.0).contains(&(gave_up - at)) && code == 1.0,
            "gave up after {:.1} s with {code}, expected 10 s and 1",
            gave_up - at
        );
        let kept = cut_off_and_closed(&left)?;
        left.report(
            bench,
            &[],
            format!(
                "it ended with an error after {:.0} s; {kept:.2} s are left of 3 s, closed by the next start",
                gave_up - at
            ),
        )
    },
);
