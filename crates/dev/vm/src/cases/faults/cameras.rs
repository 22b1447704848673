//! Faults of cameras.

use anyhow::{Result, ensure};
use session_archive::record::paws::gap::Cause;

use super::{CAMERA, Fault, FaultRun, case};
use crate::case::{Bench, Case};
use crate::cases::config::{CAMERAS, IMU};

fn happen(bench: &Bench, during: &'static str) -> Result<FaultRun> {
    let fault = Fault {
        during,
        ..Fault::default()
    };
    fault.happen(bench)
}

/// One camera is hit, for one cause, and comes back; how much it misses.
fn one_camera(left: &FaultRun, cause: Cause) -> Result<u64> {
    left.others_are_whole(&[CAMERA])?;
    left.is_back(CAMERA)?;
    left.missing(CAMERA, cause)
}

pub(super) const DROPPED: Case = case(
    "fault-camera-dropped",
    "the driver drops a fifth of a camera's frames for 5 s",
    |bench| {
        let during = "v4l2-ctl -d /dev/video0 -c percentage_of_dropped_buffers=20; sleep 5
            v4l2-ctl -d /dev/video0 -c percentage_of_dropped_buffers=0";
        let left = happen(bench, during)?;
        let missing = one_camera(&left, Cause::Device)?;
        ensure!((10..60).contains(&missing), "{missing} of 150 are missing");
        left.report(
            bench,
            &[],
            format!("{missing} of 150 frames are missing, each as lost by the device"),
        )
    },
);

pub(super) const DAMAGED: Case = case(
    "fault-camera-damaged",
    "the driver calls three frames of a camera damaged",
    |bench| {
        let during = "for _ in 1 2 3; do
            v4l2-ctl -d /dev/video0 -c inject_v4l2_buf_flag_error=1; sleep 1; done";
        let left = happen(bench, during)?;
        let missing = one_camera(&left, Cause::Device)?;
        let gaps = &left.session()?.gaps;
        ensure!(
            missing == 3 && gaps.iter().all(|gap| gap.detail.contains("damaged")),
            "{gaps:?}"
        );
        left.report(
            bench,
            &[],
            "3 frames are missing, as damaged, and no more".into(),
        )
    },
);

/// The stream is restarted immediately, at another phase, so that hardly a frame is missing; the
/// alarms say what happened.
pub(super) const ERROR: Case = case(
    "fault-camera-error",
    "a camera's stream fails, by a fatal error and by a buffer that is refused",
    |bench| {
        let during = "v4l2-ctl -d /dev/video0 -c inject_fatal_streaming_error=1; sleep 3
            v4l2-ctl -d /dev/video0 -c inject_vidioc_qbuf_error=1; sleep 3";
        let fault = Fault {
            during,
            limits: &["camera.period_deviation=never,never"],
            ..Fault::default()
        };
        let left = fault.happen(bench)?;
        let missing = one_camera(&left, Cause::Disconnected)?;
        ensure!(missing < 60, "{missing} frames are missing");
        let events = &left.session()?.events;
        let alarm_events = events
            .iter()
            .filter(|(_, _, text)| text.contains("stopped the stream after a failure"));
        ensure!(alarm_events.count() == 4, "expected two alarms: {events:?}");
        left.report(
            bench,
            &[],
            format!(
                "both failures are alarms, the stream is restarted, {missing} frames are missing"
            ),
        )
    },
);

/// vivid's camera returns when its last user has closed it, so this also shows that the daemon
/// closes it.
pub(super) const UNPLUGGED: Case = case(
    "fault-camera-unplugged",
    "a camera is unplugged for 3 s",
    |bench| {
        let during = "exec 9</dev/video0; v4l2-ctl -d /dev/video0 -c disconnect=1; sleep 3
            exec 9<&-; sleep 3";
        let left = happen(bench, during)?;
        let missing = one_camera(&left, Cause::Disconnected)?;
        ensure!(
            (85..125).contains(&missing),
            "{missing} frames are missing of 3 s"
        );
        left.report(
            bench,
            &[],
            format!("{missing} frames are missing, back within a second of its return"),
        )
    },
);

pub(super) const AWAY: Case = case(
    "fault-camera-away",
    "a camera is unplugged until the recording ends",
    |bench| {
        let during = "exec 9</dev/video0; v4l2-ctl -d /dev/video0 -c disconnect=1; sleep 3";
        let left = happen(bench, during)?;
        left.others_are_whole(&[CAMERA])?;
        let missing = left.missing(CAMERA, Cause::Disconnected)?;
        let session = left.session()?;
        let all = session.stream(CAMERA)?.samples + missing;
        let other = session.stream(CAMERAS[1])?.samples;
        ensure!(
            all.abs_diff(other) < 8,
            "{CAMERA} has {all} frames and gaps, {} has {other}",
            CAMERAS[1]
        );
        let alarms = left.status["alarms"].to_string();
        ensure!(
            alarms.contains("is disconnected"),
            "the alarms at the end: {alarms}"
        );
        left.report(
            bench,
            &[CAMERA],
            format!("{missing} frames are missing, up to the end; the alarm stands"),
        )
    },
);

/// For a moment after their return the cameras have another rate than requested.
pub(super) const ALL_GONE: Case = case(
    "fault-cameras-gone",
    "the driver lets go of all cameras and takes them back, with other modes at first",
    |bench| {
        let during = "echo vivid.0 >/sys/bus/platform/drivers/vivid/unbind; sleep 3
            echo vivid.0 >/sys/bus/platform/drivers/vivid/bind; cameras 30 || exit 4; sleep 4";
        let left = happen(bench, during)?;
        left.others_are_whole(&CAMERAS)?;
        let mut most = 0;
        for camera in CAMERAS {
            left.is_back(camera)?;
            most = most.max(left.missing(camera, Cause::Disconnected)?);
        }
        ensure!(
            (85..185).contains(&most),
            "{most} frames are missing of 3 s"
        );
        left.report(
            bench,
            &[],
            format!("each misses at most {most} frames; all are back, and {IMU} went on"),
        )
    },
);
