//! The camera of a device: search, configuration, reading, disconnects.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use session_archive::record::paws::gap::Cause;
use session_archive::time::HostTime;
use v4l2::hotplug::Watch;
use v4l2::node::{self, FindError, NodeSelector};
use v4l2::{Camera, CameraError, Fourcc, FrameInfo, Interval, Mode, Next, Stream};
use video::raw_image::{grey_to_i420, nv12_to_i420, yuyv_to_i420};
use video::{PixelFormat, RawImage, RawImageError};

use super::zed_camera::{self, FindZedError};
use super::{FrameSyncTracker, POLL_TIMEOUT, lock, report_disconnect, wait};
use crate::config::{DeviceChoice, PixelLayout, V4l2Config};
use crate::error_chain::with_causes;
use crate::sources::jpeg::{self, JpegError};
use crate::sources::{DevicePart, DroppedFrame, FrameArrival, Notice, RawFrame, Sample, Sink};

/// Retry interval for a device that is present and unusable.
const RETRY: Duration = Duration::from_secs(1);

/// Delivers frames until the sink requests the end. A camera that does not accept its settings, as
/// behind a slower port, is reported and waited for like a disconnected one.
pub(super) fn run(
    config: &V4l2Config,
    sync_tracker: Option<&Mutex<FrameSyncTracker>>,
    sink: &dyn Sink,
) {
    let mut reported = None;
    let starting = NoticeFilter {
        sink,
        reported: Mutex::default(),
    };
    while !sink.is_ending() {
        let before = Watch::new(["/dev"]);
        match start(config, &starting) {
            Ok(stream) => {
                let began = sink.now();
                let reason = read(stream, config, sync_tracker, sink);
                if let Some(sync_tracker) = sync_tracker {
                    lock(sync_tracker).restart();
                }
                report_disconnect(&mut None, DevicePart::Camera, reason, sink);
                // Delay for a camera that fails as soon as it is started.
                if sink.now().since(began) < RETRY.as_nanos() as i64 {
                    wait(before, RETRY, sink);
                } else {
                    starting.forget();
                }
                reported = None;
            }
            Err(error) => {
                report_disconnect(&mut reported, DevicePart::Camera, with_causes(&error), sink);
                // A present device may be released by another program, without any event.
                wait(before, RETRY, sink);
            }
        }
    }
}

/// Forwards each notice once: a camera that fails as soon as it is started is started every second.
struct NoticeFilter<'a> {
    sink: &'a dyn Sink,
    reported: Mutex<BTreeSet<String>>,
}

impl NoticeFilter<'_> {
    fn reported(&self) -> MutexGuard<'_, BTreeSet<String>> {
        self.reported.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn forget(&self) {
        self.reported().clear();
    }
}

impl Sink for NoticeFilter<'_> {
    fn now(&self) -> HostTime {
        self.sink.now()
    }

    fn put(&self, sample: Sample) {
        match &sample {
            Sample::Notice(notice) if !self.reported().insert(notice.text.clone()) => {}
            _ => self.sink.put(sample),
        }
    }

    fn pixels_needed(&self) -> bool {
        self.sink.pixels_needed()
    }

    fn is_ending(&self) -> bool {
        self.sink.is_ending()
    }
}

/// Error of starting a stream.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StartError {
    #[error(transparent)]
    Find(#[from] FindError),
    #[error(transparent)]
    FindZed(#[from] FindZedError),
    #[error("looking for cameras")]
    List(#[from] std::io::Error),
    #[error(transparent)]
    Camera(#[from] CameraError),
}

/// The node of the configured device. Without a sink no camera is queried for its serial number.
pub(crate) fn find_node(
    choice: &DeviceChoice,
    sink: Option<&dyn Sink>,
) -> Result<PathBuf, StartError> {
    let (vendor, product, serial) = match choice {
        DeviceChoice::Path(path) => return Ok(path.clone()),
        DeviceChoice::Zed { serial } => {
            return zed_camera::find_plugged(serial.as_deref(), sink);
        }
        DeviceChoice::Usb {
            vendor,
            product,
            serial,
        } => (*vendor, *product, serial.clone()),
    };
    let nodes = node::list(Path::new("/sys"), Path::new("/dev"))?;
    let configured = NodeSelector::Usb {
        vendor,
        product,
        serial,
    };
    Ok(node::find(&nodes, &configured)?.path.clone())
}

fn start(config: &V4l2Config, sink: &dyn Sink) -> Result<Stream, StartError> {
    let camera = Camera::open(&find_node(&config.device, Some(sink))?)?;
    camera.set_mode(&Mode {
        fourcc: Fourcc(config.format.fourcc()),
        width: config.width,
        height: config.height,
        interval: interval(config.rate_hz),
    })?;
    let is_zed = matches!(config.device, DeviceChoice::Zed { .. });
    if is_zed {
        for text in zed_camera::prepare(&camera, sink)? {
            notice(sink, text);
        }
    }
    set_controls(&camera, &config.controls, sink)?;
    let stream = Stream::start(&camera, config.buffers)?;
    if is_zed
        && config.imu.is_some()
        && let Some(text) = zed_camera::enable_frame_sync(&camera, sink)
    {
        notice(sink, text);
    }
    if stream.buffers() < config.buffers as usize {
        notice(
            sink,
            format!(
                "the driver provides {} buffers, expected {}",
                stream.buffers(),
                config.buffers
            ),
        );
    }
    Ok(stream)
}

/// The rate as a fraction: exact for integers and for thousandths of 1001.
pub(crate) fn interval(rate_hz: f64) -> Interval {
    let whole = rate_hz.round();
    if (rate_hz - whole).abs() < 1e-9 {
        return Interval::of_rate(whole as u32);
    }
    Interval {
        numerator: 1001,
        denominator: (rate_hz * 1001.0).round() as u32,
    }
}

/// Writes controls by the driver's names, and reports those that were not accepted.
fn set_controls(
    camera: &Camera,
    configured: &[(String, i64)],
    sink: &dyn Sink,
) -> Result<(), CameraError> {
    if configured.is_empty() {
        return Ok(());
    }
    let known = camera.controls()?;
    let mut values = Vec::new();
    for (name, value) in configured {
        match known.iter().find(|control| key(&control.name) == *name) {
            Some(control) => values.push((control.id, *value)),
            None => {
                let names: Vec<String> = known.iter().map(|c| key(&c.name)).collect();
                notice(
                    sink,
                    format!(
                        "no control is called {name}; there are {}",
                        names.join(", ")
                    ),
                );
            }
        }
    }
    for refused in camera.write_and_check(&values)? {
        let name = known.iter().find(|control| control.id == refused.id);
        let name = name.map_or_else(|| "a control".to_owned(), |control| key(&control.name));
        notice(sink, format!("{name}: {refused}"));
    }
    Ok(())
}

/// A driver's name of a control as the configuration writes it: `White Balance, Automatic` as
/// `white_balance_automatic`, like v4l2-ctl.
pub(crate) fn key(name: &str) -> String {
    let mut key = String::new();
    for c in name.chars() {
        if c.is_ascii_alphanumeric() {
            key.push(c.to_ascii_lowercase());
        } else if !key.ends_with('_') {
            key.push('_');
        }
    }
    key.trim_matches('_').to_owned()
}

fn notice(sink: &dyn Sink, text: String) {
    sink.put(Sample::Notice(Notice {
        host_time: sink.now(),
        part: DevicePart::Camera,
        text,
    }));
}

/// Delivers frames until the camera disconnects or fails; returns the reason.
fn read(
    mut stream: Stream,
    config: &V4l2Config,
    sync_tracker: Option<&Mutex<FrameSyncTracker>>,
    sink: &dyn Sink,
) -> String {
    let mut overruns = OverrunDetector::new(stream.buffers(), config.rate_hz);
    while !sink.is_ending() {
        let sample = match stream.next(POLL_TIMEOUT) {
            Ok(Next::Nothing) => continue,
            Ok(Next::Frame(buffer)) => {
                let arrival = sink.now();
                let info = *buffer.info();
                let age_ns = arrival.0 - info.time_ns;
                for number in overruns.frame(info.sequence, age_ns) {
                    sink.put(Sample::Dropped(DroppedFrame {
                        number: number.into(),
                        host_time: arrival,
                        cause: Cause::MachineOverload,
                        detail: "all of the driver's buffers were full".to_owned(),
                    }));
                }
                if let (Some(sync_tracker), None) = (sync_tracker, fault(&info)) {
                    let kernel_time = HostTime(info.time_ns);
                    let tied = lock(sync_tracker).frame(info.sequence, kernel_time, arrival);
                    if let Some(sync) = tied {
                        sink.put(Sample::FrameSync(sync));
                    }
                }
                sample_from_buffer(config, &info, buffer.bytes(), arrival, sink.pixels_needed())
            }
            Err(error) => return with_causes(&error),
        };
        sink.put(sample);
    }
    "the daemon ends".to_owned()
}

/// Detects frames that a driver skipped because no buffer was dequeued in time: then all of its
/// buffers were waiting, and the frame before the skipped ones is as old as most of them together.
struct OverrunDetector {
    /// Age from which a frame has waited in the driver, ns.
    old_ns: i64,
    before: Option<(u32, bool)>,
}

impl OverrunDetector {
    /// Maximum number of skipped frames. With more, the counter has restarted.
    const MAX_SKIPPED: u32 = 10_000;

    fn new(buffers: usize, rate_hz: f64) -> Self {
        let waiting = buffers.saturating_sub(1).max(1) as f64;
        Self {
            old_ns: (0.5 * waiting * 1e9 / rate_hz.max(1e-3)) as i64,
            before: None,
        }
    }

    /// Takes the next frame and its age; returns the numbers before it that were skipped for lack
    /// of buffers.
    fn frame(&mut self, sequence: u32, age_ns: i64) -> std::ops::Range<u32> {
        let before = self.before.replace((sequence, age_ns > self.old_ns));
        match before {
            Some((number, true)) if sequence > number && sequence - number <= Self::MAX_SKIPPED => {
                number + 1..sequence
            }
            _ => sequence..sequence,
        }
    }
}

/// Reason why a buffer is unusable according to the driver, if there is one.
fn fault(info: &FrameInfo) -> Option<String> {
    if info.corrupt {
        Some("the driver reports a damaged image".to_owned())
    } else if info.short {
        Some(format!(
            "only {} bytes of an image arrived",
            info.bytes_used
        ))
    } else if info.time_ns <= 0 {
        Some("the driver gives no time stamp".to_owned())
    } else {
        None
    }
}

/// Converts a buffer filled by a driver to a sample: a frame, a frame without its pixels if those
/// are not needed, or a dropped frame with the reason. Pure: `bytes` are the buffer's, `arrival` is
/// the time at which it was dequeued.
pub fn sample_from_buffer(
    config: &V4l2Config,
    info: &FrameInfo,
    bytes: &[u8],
    arrival: HostTime,
    pixels_needed: bool,
) -> Sample {
    let lost = |detail| {
        Sample::Dropped(DroppedFrame {
            number: info.sequence.into(),
            host_time: arrival,
            cause: Cause::Device,
            detail,
        })
    };
    if let Some(detail) = fault(info) {
        return lost(detail);
    }
    if !pixels_needed {
        return Sample::Arrival(FrameArrival {
            number: info.sequence.into(),
            device_ticks: info.time_ns,
            host_time: arrival,
        });
    }
    match image(config, bytes) {
        Ok(image) => Sample::Frame(RawFrame {
            number: info.sequence.into(),
            device_ticks: info.time_ns,
            kernel_time: Some(HostTime(info.time_ns)),
            host_time: arrival,
            exposure_ns: None,
            eyes_apart_ns: None,
            image,
        }),
        Err(error) => lost(error.to_string()),
    }
}

/// Error of converting a buffer.
#[derive(Debug, thiserror::Error)]
enum BufferError {
    #[error(transparent)]
    Image(#[from] RawImageError),
    #[error(transparent)]
    Jpeg(#[from] JpegError),
    #[error("the JPEG image is {}x{}, expected {}x{} as the camera was set to", found.0, found.1, expected.0, expected.1)]
    Size {
        found: (u32, u32),
        expected: (u32, u32),
    },
}

fn image(config: &V4l2Config, bytes: &[u8]) -> Result<RawImage, BufferError> {
    let (width, height) = (config.width, config.height);
    Ok(match config.format {
        PixelLayout::Yuyv => yuyv_to_i420(width, height, bytes)?,
        PixelLayout::Nv12 => nv12_to_i420(width, height, bytes)?,
        PixelLayout::Grey => {
            let grey = RawImage::new(width, height, PixelFormat::Grey8, bytes.to_vec())?;
            grey_to_i420(&grey)?
        }
        PixelLayout::Mjpeg => {
            let image = jpeg::decode(bytes)?.image;
            let found = (image.width, image.height);
            if found != (width, height) {
                let expected = (width, height);
                return Err(BufferError::Size { found, expected });
            }
            image
        }
    })
}

#[cfg(test)]
mod tests {
    use jpeg_encoder::{ColorType, Encoder};
    use v4l2::stream::{Clock, TimestampSource};

    use super::*;

    #[test]
    fn rates_are_fractions() {
        let of = |rate| {
            let interval = interval(rate);
            (interval.numerator, interval.denominator)
        };
        assert_eq!(of(30.0), (1, 30));
        assert_eq!(of(30_000.0 / 1001.0), (1001, 30_000));
        assert_eq!(of(29.97), (1001, 30_000));
    }

    /// Three of four buffers at 10 Hz: 150 ms.
    #[test]
    fn frames_not_dequeued_in_time_are_dropped_as_overload() {
        let mut overruns = OverrunDetector::new(4, 10.0);
        const MS: i64 = 1_000_000;
        assert!(overruns.frame(7, 5 * MS).is_empty());
        assert!(overruns.frame(9, 5 * MS).is_empty(), "the device's");
        assert!(overruns.frame(10, 290 * MS).is_empty());
        assert_eq!(overruns.frame(14, 5 * MS), 11..14);
        assert!(overruns.frame(15, 290 * MS).is_empty());
        assert!(
            overruns.frame(2, 5 * MS).is_empty(),
            "it counts from the beginning"
        );
    }

    fn config(format: PixelLayout, width: u32, height: u32) -> V4l2Config {
        V4l2Config {
            device: DeviceChoice::Path("/dev/video0".into()),
            right: None,
            width,
            height,
            rate_hz: 30.0,
            format,
            buffers: 4,
            controls: Vec::new(),
            imu: None,
        }
    }

    /// A whole buffer of frame 7.
    fn info(bytes: &[u8]) -> FrameInfo {
        FrameInfo {
            sequence: 7,
            time_ns: 5_000_000_000,
            clock: Clock::Monotonic,
            stamped: TimestampSource::StartOfExposure,
            bytes_used: bytes.len(),
            corrupt: false,
            short: false,
        }
    }

    const ARRIVAL: HostTime = HostTime(5_010_000_000);

    /// A gray image as a JPEG file.
    fn grey_file(width: u16, height: u16, grey: u8) -> Vec<u8> {
        let samples = vec![grey; usize::from(width) * usize::from(height)];
        let mut bytes = Vec::new();
        Encoder::new(&mut bytes, 95)
            .encode(&samples, width, height, ColorType::Luma)
            .expect("encoding");
        bytes
    }

    /// Reason why frame 7 is dropped.
    fn loss_reason(sample: Sample) -> String {
        match sample {
            Sample::Dropped(lost) => {
                let found = (lost.number, lost.host_time, lost.cause);
                assert_eq!(found, (7, ARRIVAL, Cause::Device));
                lost.detail
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn motion_jpeg_buffer_is_a_frame() {
        let file = grey_file(64, 48, 90);
        let config = config(PixelLayout::Mjpeg, 64, 48);
        // With padding, as drivers deliver it.
        let mut buffer = file.clone();
        buffer.resize(file.len() + 100, 0);
        for bytes in [&file, &buffer] {
            match sample_from_buffer(&config, &info(bytes), bytes, ARRIVAL, true) {
                Sample::Frame(frame) => {
                    assert_eq!(
                        (frame.number, frame.device_ticks, frame.host_time),
                        (7, 5_000_000_000, ARRIVAL)
                    );
                    assert_eq!(frame.kernel_time, Some(HostTime(5_000_000_000)));
                    let image = frame.image;
                    assert_eq!((image.width, image.height), (64, 48));
                    let luma = image.luma().expect("luma");
                    assert!(luma.iter().all(|value| value.abs_diff(90) <= 2));
                }
                other => panic!("{other:?}"),
            }
        }
        let seen = sample_from_buffer(&config, &info(&file), &file, ARRIVAL, false);
        assert!(matches!(
            seen,
            Sample::Arrival(FrameArrival { number: 7, .. })
        ));
    }

    #[test]
    fn motion_jpeg_of_another_size_or_damaged_is_a_dropped_frame() {
        let file = grey_file(64, 48, 90);
        for (width, height) in [(32, 48), (64, 46), (128, 48)] {
            let config = config(PixelLayout::Mjpeg, width, height);
            assert_eq!(
                loss_reason(sample_from_buffer(
                    &config,
                    &info(&file),
                    &file,
                    ARRIVAL,
                    true
                )),
                format!(
                    "the JPEG image is 64x48, expected {width}x{height} as the camera was set to"
                )
            );
        }
        let config = config(PixelLayout::Mjpeg, 64, 48);
        let cut = &file[..file.len() / 2];
        let noise = [0x5a; 500];
        for bytes in [cut, &noise[..], &[]] {
            let why = loss_reason(sample_from_buffer(
                &config,
                &info(bytes),
                bytes,
                ARRIVAL,
                true,
            ));
            assert!(why.starts_with("the JPEG image is damaged: "), "{why}");
        }
        // The following buffer is a frame again: no state is carried over.
        let next = sample_from_buffer(&config, &info(&file), &file, ARRIVAL, true);
        assert!(matches!(next, Sample::Frame(_)), "{next:?}");
    }

    #[test]
    fn driver_flags_take_precedence() {
        let bytes = [90; 64 * 48 * 2];
        let config = config(PixelLayout::Yuyv, 64, 48);
        let of = |change: fn(&mut FrameInfo), pixels_needed| {
            let mut info = info(&bytes);
            change(&mut info);
            sample_from_buffer(&config, &info, &bytes, ARRIVAL, pixels_needed)
        };
        assert!(matches!(of(|_| {}, true), Sample::Frame(_)));
        // With and without pixels.
        for pixels_needed in [true, false] {
            let unstamped: [fn(&mut FrameInfo); 2] =
                [|info| info.time_ns = 0, |info| info.time_ns = -1];
            for unstamped in unstamped {
                assert_eq!(
                    loss_reason(of(unstamped, pixels_needed)),
                    "the driver gives no time stamp"
                );
            }
            assert_eq!(
                loss_reason(of(|info| info.corrupt = true, pixels_needed)),
                "the driver reports a damaged image"
            );
            let short: fn(&mut FrameInfo) = |info| (info.short, info.bytes_used) = (true, 12);
            assert_eq!(
                loss_reason(of(short, pixels_needed)),
                "only 12 bytes of an image arrived"
            );
        }
    }

    /// As v4l2-ctl has them.
    #[test]
    fn control_names_match_the_configuration() {
        for (name, expected) in [
            ("Brightness", "brightness"),
            ("White Balance, Automatic", "white_balance_automatic"),
            ("Exposure Time, Absolute", "exposure_time_absolute"),
            ("(odd) name ", "odd_name"),
        ] {
            assert_eq!(key(name), expected);
        }
    }
}
