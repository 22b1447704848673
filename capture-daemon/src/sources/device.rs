//! A V4L2 camera, with the IMU of a ZED's microcontroller if it has one; or two cameras, one for
//! each eye.
//!
//! Contract: frames carry the driver's own sequence number and its timestamp on the host clock. A
//! frame that the driver reports as damaged, or that is shorter than an image, is dropped with its
//! number and a cause. Camera and IMU are waited for on a thread each, so that neither blocks the
//! other. *An absent or disconnected device* is reported once and waited for; its settings are
//! written again when it has reconnected. *An unsupported mode* is reported in the same manner. The
//! clocks of IMU and camera are related by the samples that the IMU marks as simultaneous with a
//! frame, once a second ([`FrameSync`](super::FrameSync)). Tested on the kernel's own drivers in a
//! virtual machine (docs/guides/vm-tests.md), never with a real camera.
//!
//! The processing between driver and sink is pure and can be tested without a device: a buffer
//! becomes a sample ([`sample_from_buffer`]), and the samples of two cameras are joined into one
//! camera's ([`StereoJoiner`]).

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use session_archive::time::{HostTime, TickLength};
use v4l2::hotplug::Watch;

use zed::report::{ACCEL_M_PER_S2, GYRO_DEG_PER_S, TEMPERATURE_C};

use super::{
    CameraInfo, DevicePart, Disconnect, ImuInfo, Live, Sample, Sink, SourceError, SourceInfo,
    TimestampRelation,
};
use crate::config::{DeviceChoice, PixelLayout, V4l2Config, ZedImuConfig};

pub(crate) mod camera;
mod frame_sync;
mod imu;
mod pair;
mod zed_camera;

pub use camera::sample_from_buffer;
pub(super) use frame_sync::FrameSyncTracker;
pub use pair::StereoJoiner;

/// Uncertainty of a driver's timestamp, which is taken in an interrupt, ns.
const TIMESTAMP_SIGMA_NS: u64 = 50_000;

/// Maximum wait before the end is checked.
const POLL_TIMEOUT: Duration = Duration::from_millis(100);

/// A V4L2 camera. See the module.
pub struct Device {
    info: SourceInfo,
    config: V4l2Config,
}

impl Device {
    /// The camera of these settings, which need not be present yet.
    pub fn new(config: &V4l2Config) -> Self {
        let camera = CameraInfo {
            width: config.width,
            height: config.height,
            rate_hz: config.rate_hz,
            tick: TickLength::NANOSECOND,
            tick_bits: None,
            number_bits: Some(32),
            colour: config.format != PixelLayout::Grey,
            still: false,
            stamped: Some(TimestampRelation {
                latency_ns: 0,
                sigma_ns: TIMESTAMP_SIGMA_NS,
            }),
        };
        let imu = config.imu.as_ref().map(|imu| imu_info(imu.rate_hz));
        Self {
            info: SourceInfo {
                description: describe(config),
                camera,
                imu,
                calibration_files: Vec::new(),
            },
            config: config.clone(),
        }
    }
}

impl Live for Device {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn run(self: Box<Self>, sink: &dyn Sink) -> Result<(), SourceError> {
        let failed = |what| {
            Err(SourceError::Unusable {
                source_name: self.info.description.clone(),
                what,
            })
        };
        if let (Some(right), [left_eye, right_eye]) =
            (&self.config.right, self.config.eyes().as_slice())
        {
            let ended = pair::run([left_eye, right_eye], right.within_ns, sink);
            return match ended {
                Ok(()) => Ok(()),
                Err(error) => failed(format!("its right eye gets no thread: {error}")),
            };
        }
        let camera = |sync_tracker: Option<&Mutex<FrameSyncTracker>>| {
            camera::run(&self.config, sync_tracker, sink)
        };
        match beside_imu(self.config.imu.as_ref(), sink, camera) {
            Ok(()) => Ok(()),
            Err(error) => failed(no_thread(&error)),
        }
    }
}

/// Runs a camera and, on a thread of its own, its IMU if it has one, which ends when the camera
/// does.
///
/// # Errors
/// The system provides no thread.
pub(super) fn beside_imu<T>(
    imu: Option<&ZedImuConfig>,
    sink: &dyn Sink,
    camera: impl FnOnce(Option<&Mutex<FrameSyncTracker>>) -> T,
) -> std::io::Result<T> {
    let Some(imu) = imu else {
        return Ok(camera(None));
    };
    let sync_tracker = Mutex::default();
    let until = EndableSink {
        sink,
        is_over: AtomicBool::new(false),
    };
    std::thread::scope(|scope| {
        std::thread::Builder::new()
            .name("imu".to_owned())
            .spawn_scoped(scope, || imu::run(imu, &sync_tracker, &until))?;
        let ended = camera(Some(&sync_tracker));
        until.is_over.store(true, Ordering::Relaxed);
        Ok(ended)
    })
}

/// Reason why a source has no IMU.
pub(super) fn no_thread(error: &std::io::Error) -> String {
    format!("its IMU gets no thread: {error}")
}

/// A sink that can be ended earlier than its inner one.
struct EndableSink<'a> {
    sink: &'a dyn Sink,
    is_over: AtomicBool,
}

impl Sink for EndableSink<'_> {
    fn now(&self) -> HostTime {
        self.sink.now()
    }

    fn put(&self, sample: Sample) {
        self.sink.put(sample);
    }

    fn pixels_needed(&self) -> bool {
        self.sink.pixels_needed()
    }

    fn is_ending(&self) -> bool {
        self.is_over.load(Ordering::Relaxed) || self.sink.is_ending()
    }
}

/// Properties of a ZED's IMU before it is present.
pub(super) fn imu_info(rate_hz: f64) -> ImuInfo {
    ImuInfo {
        rate_hz,
        tick: TickLength::ZED_MINI,
        tick_bits: None,
        number_bits: None,
        scale: Some((GYRO_DEG_PER_S.to_radians(), ACCEL_M_PER_S2)),
        temperature_scale_c: Some(TEMPERATURE_C),
    }
}

fn describe(config: &V4l2Config) -> String {
    if let Some(right) = &config.right {
        let (left, right) = (name(&config.device), name(&right.device));
        return format!("{left} and {right}, one for each eye");
    }
    let what = name(&config.device);
    match config.imu.as_ref().map(|imu| &imu.serial) {
        _ if matches!(config.device, DeviceChoice::Zed { .. }) => what,
        Some(Some(serial)) => format!("{what} with ZED IMU {serial}"),
        Some(None) => format!("{what} with ZED IMU"),
        None => what,
    }
}

fn name(device: &DeviceChoice) -> String {
    match device {
        DeviceChoice::Path(path) => path.display().to_string(),
        DeviceChoice::Zed { serial } => match serial {
            Some(serial) => format!("ZED {serial}"),
            None => "ZED".to_owned(),
        },
        DeviceChoice::Usb {
            vendor,
            product,
            serial,
        } => {
            let serial = serial.as_ref().map(|s| format!(" {s}")).unwrap_or_default();
            format!("USB camera {vendor:04x}:{product:04x}{serial}")
        }
    }
}

/// Reports once why a device is not available, and again when the reason changes.
pub(super) fn report_disconnect(
    reported: &mut Option<String>,
    part: DevicePart,
    detail: String,
    sink: &dyn Sink,
) {
    if sink.is_ending() || reported.as_ref() == Some(&detail) {
        return;
    }
    sink.put(Sample::Disconnected(Disconnect {
        host_time: sink.now(),
        part,
        detail: detail.clone(),
    }));
    *reported = Some(detail);
}

/// Waits until the folder of devices changes, `limit` has passed, or the end.
pub(super) fn wait(watch: std::io::Result<Watch>, limit: Duration, sink: &dyn Sink) {
    let until = sink.now() + limit.as_nanos() as i64;
    let mut watch = watch.ok();
    while !sink.is_ending() && sink.now() < until {
        match watch.as_mut().map(|watch| watch.next(POLL_TIMEOUT)) {
            Some(Ok(None)) => {}
            Some(Ok(Some(_))) => return,
            Some(Err(_)) | None => {
                watch = None;
                #[expect(
                    clippy::disallowed_methods,
                    reason = "no inotify watch is available, and an immediate retry would loop forever"
                )]
                std::thread::sleep(POLL_TIMEOUT);
            }
        }
    }
}

pub(super) fn lock(sync_tracker: &Mutex<FrameSyncTracker>) -> MutexGuard<'_, FrameSyncTracker> {
    sync_tracker.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::{Clock as _, RealClock};

    struct Clock;

    impl Sink for Clock {
        fn now(&self) -> HostTime {
            RealClock.now()
        }

        fn put(&self, _: Sample) {}

        fn is_ending(&self) -> bool {
            false
        }
    }

    /// Otherwise a real-time thread would retry in a busy loop.
    #[test]
    fn wait_without_inotify_still_takes_its_time() {
        let before = Clock.now();
        let limit = Duration::from_millis(150);
        wait(Err(std::io::ErrorKind::Other.into()), limit, &Clock);
        assert!(Clock.now() - before >= 150_000_000);
    }
}
