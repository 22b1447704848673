//! Faults of cameras, IMU, button, clock and of the daemon itself.

use anyhow::{Result, ensure};
use session_archive::record::paws::event::Kind;
use session_archive::record::paws::gap::Cause;

use super::{Fault, Left};
use crate::case::{Bench, Case, Report};
use crate::cases::config::IMU;

const CAMERA: &str = "left_shoulder";

const fn case(name: &'static str, shows: &'static str, run: fn(&Bench) -> Result<Report>) -> Case {
    Case {
        name,
        shows,
        quick: false,
        on_qemu: false,
        run,
    }
}

/// A fault of a device, in virtual time.
fn happen(bench: &Bench, imu: &'static str, during: &'static str) -> Result<Left> {
    let fault = Fault {
        on_disk: false,
        imu,
        during,
    };
    fault.happen(bench)
}

/// One stream is hit, for one cause, and comes back.
fn one_stream(left: &Left, stream: &str, cause: Cause) -> Result<Report> {
    left.others_are_whole(&[stream])?;
    let missing = left.missing(stream, cause)?;
    left.is_back(stream)?;
    let cause = cause.as_str_name();
    left.report(format!(
        "{stream} misses {missing}, all {cause}; it is back, nothing else is missing"
    ))
}

pub(super) const DROPPED: Case = case(
    "fault-dropped",
    "the driver drops a fifth of a camera's pictures",
    |bench| {
        let during = "v4l2-ctl -d /dev/video0 -c percentage_of_dropped_buffers=20; sleep 5
            v4l2-ctl -d /dev/video0 -c percentage_of_dropped_buffers=0";
        let left = happen(bench, "", during)?;
        one_stream(&left, CAMERA, Cause::Device)
    },
);

/// The stream is begun anew at once, so that hardly a picture is missing. The event stays.
pub(super) const IO_ERROR: Case = case(
    "fault-camera-error",
    "a camera's stream ends with an I/O error",
    |bench| {
        let during = "v4l2-ctl -d /dev/video0 -c inject_fatal_streaming_error=1; sleep 5";
        let left = happen(bench, "", during)?;
        left.others_are_whole(&[CAMERA])?;
        left.is_back(CAMERA)?;
        let session = left.session()?;
        for kind in [Kind::Fault, Kind::Cleared] {
            let events = session.events.iter();
            let mut of_camera = events.filter(|(_, source, _)| source == CAMERA);
            ensure!(
                of_camera.any(|(found, ..)| *found == kind),
                "no event {kind:?} of {CAMERA}: {:?}",
                session.events
            );
        }
        let missing = session.stream(CAMERA)?.gaps;
        left.report(format!(
            "{CAMERA} misses {missing} and is back; the error is an event"
        ))
    },
);

/// vivid is plugged in again when its last user has closed it, so this also shows that the daemon lets go.
pub(super) const UNPLUGGED: Case = case(
    "fault-camera-unplugged",
    "a camera is unplugged, and plugged in again",
    |bench| {
        let during = "v4l2-ctl -d /dev/video0 -c disconnect=1; sleep 5";
        let left = happen(bench, "", during)?;
        one_stream(&left, CAMERA, Cause::Disconnected)
    },
);

pub(super) const IMU_SILENT: Case = case(
    "fault-imu-silent",
    "the IMU sends nothing for 3 s, though its samples are counted",
    |bench| {
        let left = happen(bench, "--silent 8:3", "sleep 12")?;
        left.others_are_whole(&[IMU])?;
        let session = left.session()?;
        let missing = session.stream(IMU)?.gaps;
        ensure!(missing > 1600, "{IMU} misses {missing}: {:?}", session.gaps);
        left.is_back(IMU)?;
        let causes: std::collections::BTreeSet<&str> = session
            .gaps
            .iter()
            .map(|gap| gap.cause().as_str_name())
            .collect();
        left.report(format!(
            "{IMU} misses {missing} {causes:?}; it is back, no frame is missing"
        ))
    },
);

pub(super) const IMU_STOPPED: Case = case(
    "fault-imu-stopped",
    "the IMU ends its stream as if no keep-alive had come, and is started again by the watchdog",
    |bench| {
        let left = happen(bench, "--stopped 8", "sleep 12")?;
        left.others_are_whole(&[IMU])?;
        left.is_back(IMU)?;
        let session = left.session()?;
        let missing = session.stream(IMU)?.gaps;
        left.report(format!(
            "{IMU} misses {missing}; it is back, no frame is missing"
        ))
    },
);

pub(super) const IMU_GONE: Case = case("fault-imu-gone", "the IMU is unplugged for 3 s", |bench| {
    let left = happen(bench, "--gone 8:3", "sleep 12")?;
    one_stream(&left, IMU, Cause::Disconnected)
});

pub(super) const BUTTON_GONE: Case = case(
    "fault-button-gone",
    "the GPIO chip with button and light is unplugged; another button still stops",
    |bench| {
        let during = "echo 0 >/sys/kernel/config/gpio-sim/rig/live; sleep 2
            vm-button press@3 end@6 >button.txt; until_state armed || exit 3
            pawsd start >/dev/null || exit 2";
        let left = happen(bench, "", during)?;
        ensure!(left.sessions.len() == 2, "{} sessions", left.sessions.len());
        for session in &left.sessions {
            session.is_accounted_for()?;
            ensure!(
                session.closed && session.gaps.is_empty(),
                "{:?}",
                session.gaps
            );
        }
        let stopped = left.sessions[0].stopped.clone().unwrap_or_default();
        ensure!(
            stopped.contains("button"),
            "stopped by {stopped:?}, expected the key"
        );
        left.report("the key stopped the recording, and nothing is missing".to_owned())
    },
);

pub(super) const CLOCK_STEP: Case = case(
    "fault-clock-step",
    "civil time is set an hour forward, and two back",
    |bench| {
        let during =
            "date -s '+1 hour' >/dev/null; sleep 4; date -s '-2 hours' >/dev/null; sleep 3";
        let left = happen(bench, "", during)?;
        left.others_are_whole(&[])?;
        let hours: Vec<f64> = left
            .session()?
            .clock_steps
            .iter()
            .map(|ns| *ns as f64 / 3.6e12)
            .collect();
        let near = |expected: f64| hours.iter().any(|hours| (hours - expected).abs() < 0.01);
        ensure!(
            near(1.0) && near(-2.0),
            "steps of {hours:?} h were recorded, expected 1 and -2"
        );
        left.report("nothing is missing, both steps are recorded".to_owned())
    },
);

pub(super) const KILLED: Case = case(
    "fault-killed",
    "the daemon is killed while it records, and started again",
    |bench| {
        let during = "kill -9 $daemon; wait $daemon; daemon || exit 3; pawsd start >/dev/null || exit 2; sleep 3";
        let left = happen(bench, "", during)?;
        ensure!(left.sessions.len() == 2, "{} sessions", left.sessions.len());
        for session in &left.sessions {
            session.is_accounted_for()?;
        }
        ensure!(left.sessions[1].closed, "the second session is not closed");
        // One chunk at most: 3 s were recorded.
        let kept = left.sessions[0].stream(IMU)?.span_ns;
        ensure!(kept > 2_000_000_000, "{kept} ns are left of 3 s");
        left.report(format!(
            "{:.2} s are left of 3 s, and the next recording is whole",
            kept as f64 / 1e9
        ))
    },
);
