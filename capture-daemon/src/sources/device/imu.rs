//! The IMU of a device: a ZED's microcontroller.

use std::sync::Mutex;
use std::time::Duration;

use session_archive::time::{HostTime, NS_PER_S};
use v4l2::hotplug::Watch;
use zed::imu::{Arrival, Event, HidPort, Imu};

use super::{FrameSyncTracker, lock, report_disconnect, wait};
use crate::config::ZedImuConfig;
use crate::error_chain::with_causes;
use crate::realtime_priority;
use crate::sources::{DevicePart, ImuValues, Notice, RawImu, Sample, Sink};

/// Maximum wait before the end is checked, ns.
const POLL_TIMEOUT_NS: i64 = 100_000_000;
/// Retry interval for a device that is present and unusable.
const RETRY: Duration = Duration::from_secs(1);
/// Minimum interval between notices about damaged reports, ns.
const REPORT_INTERVAL_NS: i64 = NS_PER_S;

/// Delivers samples until the sink requests the end.
pub(super) fn run(config: &ZedImuConfig, sync_tracker: &Mutex<FrameSyncTracker>, sink: &dyn Sink) {
    realtime_priority::this_thread();
    let port = HidPort {
        model: None,
        serial: config.serial.clone(),
    };
    let mut reported = None;
    let mut imu = loop {
        if sink.is_ending() {
            return;
        }
        let before = Watch::new(["/dev"]);
        match Imu::open(port.clone(), sink.now().0) {
            Ok(imu) => break imu,
            Err(error) => {
                report_disconnect(&mut reported, DevicePart::Imu, with_causes(&error), sink);
                wait(before, RETRY, sink);
            }
        }
    };
    let mut opened = sink.now();
    let mut malformed_reported = HostTime::MIN;
    while !sink.is_ending() {
        let event = imu.next(&|| sink.now().0, sink.now().0 + POLL_TIMEOUT_NS);
        match event {
            Event::Nothing => {}
            Event::Sample(arrival) => {
                reported = None;
                take(&arrival, sync_tracker, sink);
            }
            Event::Malformed(error) => {
                if sink.now().since(malformed_reported) >= REPORT_INTERVAL_NS {
                    malformed_reported = sink.now();
                    notice(sink, format!("a report that is none: {error}"));
                }
            }
            Event::Silent { .. } => notice(sink, "silent for half a second".to_owned()),
            Event::Restarted { .. } => {
                notice(
                    sink,
                    "stopped and started, because it was silent".to_owned(),
                );
            }
            Event::Reopened => notice(sink, "closed and opened, because it was silent".to_owned()),
            Event::Gone { detail } => {
                report_disconnect(&mut reported, DevicePart::Imu, detail, sink);
                lock(sync_tracker).restart();
                // Delay for a device that fails as soon as it is opened.
                if sink.now().since(opened) < RETRY.as_nanos() as i64 {
                    wait(Watch::new(["/dev"]), RETRY, sink);
                }
                let before = Watch::new(["/dev"]);
                match imu.try_reopen(sink.now().0) {
                    Ok(()) => opened = sink.now(),
                    Err(_) => wait(before, RETRY, sink),
                }
            }
        }
    }
}

fn take(arrival: &Arrival, sync_tracker: &Mutex<FrameSyncTracker>, sink: &dyn Sink) {
    let sample = &arrival.sample;
    let host_time = HostTime(arrival.host_ns);
    lock(sync_tracker).imu(sample, host_time);
    if !sample.valid {
        // It has a number of its own, so the resulting gap is detected.
        return;
    }
    sink.put(Sample::Imu(RawImu {
        number: arrival.numbered.number,
        device_ticks: i64::try_from(sample.ticks).unwrap_or(i64::MAX),
        host_time,
        values: ImuValues::Counts {
            gyro: sample.gyro.map(i32::from),
            accel: sample.accel.map(i32::from),
        },
        temperature: Some(sample.temperature.into()),
        frame_sync: sample.frame_sync,
    }));
}

fn notice(sink: &dyn Sink, text: String) {
    sink.put(Sample::Notice(Notice {
        host_time: sink.now(),
        part: DevicePart::Imu,
        text,
    }));
}
