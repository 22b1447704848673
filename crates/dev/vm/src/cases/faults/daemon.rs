//! Faults of the daemon itself.

use anyhow::ensure;
use session_archive::record::paws::gap::Cause;

use super::{Fault, case, is_accounted_for};
use crate::case::Case;
use crate::cases::config::{CAMERAS, IMU};

/// It sends no pings either, so the IMU ends its stream.
pub(super) const HELD_UP: Case = case(
    "fault-held-up",
    "the daemon is stopped for 7 s: buffers and queues run full, the IMU's keep-alive is lost",
    |bench| {
        let fault = Fault {
            during: "kill -STOP $daemon; sleep 7; kill -CONT $daemon; sleep 3",
            ..Fault::default()
        };
        let left = fault.happen(bench)?;
        let mut frames = 0;
        for camera in CAMERAS {
            left.is_back(camera)?;
            frames = left.missing(camera, Cause::Device)?;
            ensure!(
                (180..220).contains(&frames),
                "{camera} misses {frames} of 7 s"
            );
        }
        left.is_back(IMU)?;
        let samples = left.missing(IMU, Cause::Device)?;
        ensure!(
            (5000..6500).contains(&samples),
            "{IMU} misses {samples} of 7 s"
        );
        left.report(
            bench,
            &[],
            format!(
                "{frames} frames of each camera and {samples} IMU samples are missing, all go on"
            ),
        )
    },
);

pub(super) const KILLED: Case = case(
    "fault-killed",
    "the daemon is killed while it records, and started again",
    |bench| {
        let fault = Fault {
            during: "kill -9 $daemon; wait $daemon; daemon || exit 4
                sleep 1; pawsd status --json >again.json
                pawsd start >/dev/null || exit 3; sleep 3",
            ..Fault::default()
        };
        let left = fault.happen(bench)?;
        ensure!(left.sessions.len() == 2, "{} sessions", left.sessions.len());
        for session in &left.sessions {
            is_accounted_for(session)?;
            ensure!(session.gaps.is_empty(), "{:?}", session.gaps);
        }
        let status = left.file("again.json")?;
        ensure!(
            status.contains("an earlier recording was cut off"),
            "started again it says: {status}"
        );
        let kept = left.sessions[0].stream(IMU)?.span_ns;
        ensure!(kept > 2_000_000_000, "{kept} ns are left of 3 s");
        left.report(
            bench,
            &[],
            format!(
                "{:.2} s are left of 3 s, closed by the next start, which says so; the next recording is whole",
                kept as f64 / 1e9
            ),
        )
    },
);
