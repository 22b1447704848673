//! Sources of images and IMU samples.
//!
//! A source delivers the samples of one camera and of its IMU, in the order of their arrival. Each
//! source separates bytes → sample (pure, tested on recorded bytes) from I/O, and has fakes beside
//! it. There are two kinds:
//!
//! * [`Source`]s need no hardware: [`replay`] of recorded data sets, of a [`bag`] and of a [video
//!   file](video_file), a [`simulated`] walk and a [`synthetic`] moving image. They know the
//!   arrival time of each sample in advance and leave the waiting to the runner, so that they run
//!   in real time and in virtual time alike.
//! * [`Live`] sources wait for devices, each on threads of its own. A device that is absent or
//!   disconnected is waited for: see [`Live::run`].

use std::path::Path;

use calibration_files::CalibError;
use camera_models::StereoCalibration;
use session_archive::record::paws::gap::Cause;
use session_archive::time::{HostTime, TickLength};
use video::encoder::Input;
use video::{NativeFrame, RawImage};

pub mod bag;
pub mod datasets;
pub mod device;
pub mod gstreamer;
mod jpeg;
pub(crate) mod pairing;
pub mod replay;
#[cfg(feature = "simulator")]
pub mod simulated;
pub mod synthetic;
pub mod video_file;
pub mod walks;

/// One stereo frame from a source: as a [`RawImage`], or in its camera's own buffer.
#[derive(Clone, Debug)]
pub struct RawFrame<P = RawImage> {
    /// The device's own sequence number.
    pub number: u64,
    /// Device clock at the stamped instant.
    pub device_ticks: i64,
    /// The driver's timestamp, if there is one.
    pub kernel_time: Option<HostTime>,
    /// Arrival of the frame.
    pub host_time: HostTime,
    /// Exposure time, ns, if the device reports it.
    pub exposure_ns: Option<u32>,
    /// Delay of the right eye's image, ns, if the eyes were captured separately.
    pub eyes_apart_ns: Option<i64>,
    /// Left and right side by side; a [`RawImage`] is I420 (gray ones with neutral chroma).
    pub image: P,
}

/// The pixels of a frame, in the form that an encoder takes.
pub trait Pixels {
    /// Input of the encoder.
    fn input(&self) -> Input<'_>;

    /// Hash for detecting an unchanged image; `None` if the pixels are not accessible.
    fn digest(&self) -> Option<u64>;

    /// Input of the preview.
    fn preview_pixels(&self) -> PreviewPixels<'_>;
}

/// Pixels for a preview.
#[derive(Clone, Copy, Debug)]
pub enum PreviewPixels<'a> {
    /// In memory.
    Image(&'a RawImage),
    /// In a camera's own buffer.
    Native(&'a NativeFrame),
}

impl Pixels for RawImage {
    fn input(&self) -> Input<'_> {
        self.into()
    }

    fn digest(&self) -> Option<u64> {
        Some(crc32fast::hash(&self.data).into())
    }

    fn preview_pixels(&self) -> PreviewPixels<'_> {
        PreviewPixels::Image(self)
    }
}

impl Pixels for NativeFrame {
    fn input(&self) -> Input<'_> {
        self.into()
    }

    fn digest(&self) -> Option<u64> {
        NativeFrame::digest(self)
    }

    fn preview_pixels(&self) -> PreviewPixels<'_> {
        PreviewPixels::Native(self)
    }
}

/// One IMU sample as a source delivers it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawImu {
    /// The device's own sequence number.
    pub number: u64,
    /// Device clock.
    pub device_ticks: i64,
    /// Arrival of the sample.
    pub host_time: HostTime,
    /// The measurement.
    pub values: ImuValues,
    /// Temperature of the IMU, in counts of [`ImuInfo::temperature_scale_c`].
    pub temperature: Option<i32>,
    /// Whether the device marks the sample as simultaneous with a frame.
    pub frame_sync: bool,
}

/// A measurement, in the source's own numbers; never converted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ImuValues {
    /// Raw counts; the scales are in [`ImuInfo::scale`].
    Counts {
        /// Angular rate, x y z.
        gyro: [i32; 3],
        /// Specific force, x y z.
        accel: [i32; 3],
    },
    /// SI values.
    Si {
        /// Angular rate, rad/s, x y z.
        gyro: [f64; 3],
        /// Specific force, m/s², x y z.
        accel: [f64; 3],
    },
}

/// A stereo frame that arrived while nobody stores frames: without its pixels, which were not
/// fetched or rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameArrival {
    /// The device's own sequence number.
    pub number: u64,
    /// Device clock at the stamped instant.
    pub device_ticks: i64,
    /// Arrival of the frame.
    pub host_time: HostTime,
}

/// Output of a source.
#[derive(Clone, Debug)]
pub enum Sample {
    /// A frame without its pixels.
    Arrival(FrameArrival),
    /// A stereo frame.
    Frame(RawFrame),
    /// A stereo frame in its camera's own buffer.
    Native(RawFrame<NativeFrame>),
    /// An IMU sample.
    Imu(RawImu),
    /// The device is disconnected; later samples come from it after it has reconnected.
    Disconnected(Disconnect),
    /// A frame that arrived and is unusable.
    Dropped(DroppedFrame),
    /// An event worth recording.
    Notice(Notice),
    /// Clock relation of camera and IMU, measured by the device itself.
    FrameSync(FrameSync),
}

/// Part of a source's device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DevicePart {
    /// The camera alone.
    Camera,
    /// The IMU alone.
    Imu,
    /// Both, if they are one device.
    Both,
}

/// A disconnect of a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Disconnect {
    /// Time of the detection.
    pub host_time: HostTime,
    /// The disconnected part.
    pub part: DevicePart,
    /// Details, for people.
    pub detail: String,
}

/// A frame that the device counted and that is unusable.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DroppedFrame {
    /// The device's own sequence number.
    pub number: u64,
    /// Its arrival.
    pub host_time: HostTime,
    /// Cause of the drop.
    pub cause: Cause,
    /// Details, for people.
    pub detail: String,
}

/// An event of a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    /// Time of the event.
    pub host_time: HostTime,
    /// The affected part.
    pub part: DevicePart,
    /// The event, for people.
    pub text: String,
}

/// Clock relation of a camera and its IMU, from samples that the device marks as simultaneous with
/// a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameSync {
    /// Time of the estimate.
    pub host_time: HostTime,
    /// Number of marked samples with a frame, used for the estimate.
    pub pairs: u32,
    /// An instant on the IMU's clock.
    pub ticks: i64,
    /// The same instant on the clock of the camera driver's timestamps.
    pub stamp: HostTime,
    /// One standard deviation of that, ns.
    pub sigma_ns: u64,
    /// Median distance of the timestamps above the fitted line, ns.
    pub residual_median_ns: u64,
    /// 99th percentile of the same, ns.
    pub residual_p99_ns: u64,
    /// Device's sync counter minus frame number.
    pub count_minus_number: i64,
}

impl Sample {
    /// Arrival time, in the past or in the future.
    pub fn host_time(&self) -> HostTime {
        match self {
            Self::Arrival(s) => s.host_time,
            Self::Frame(f) => f.host_time,
            Self::Native(f) => f.host_time,
            Self::Imu(i) => i.host_time,
            Self::Disconnected(g) => g.host_time,
            Self::Dropped(l) => l.host_time,
            Self::Notice(n) => n.host_time,
            Self::FrameSync(s) => s.host_time,
        }
    }

    /// Size in bytes, for bounding queues.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Arrival(_) => size_of::<FrameArrival>(),
            Self::Frame(f) => f.image.data.len() + size_of::<RawFrame>(),
            Self::Native(f) => f.image.bytes() + size_of::<RawFrame<NativeFrame>>(),
            Self::Imu(_) => size_of::<RawImu>(),
            Self::Disconnected(Disconnect { detail, .. })
            | Self::Dropped(DroppedFrame { detail, .. }) => {
                size_of::<DroppedFrame>() + detail.len()
            }
            Self::Notice(notice) => size_of::<Notice>() + notice.text.len(),
            Self::FrameSync(_) => size_of::<FrameSync>(),
        }
    }
}

/// Properties of a source's camera, known before the first sample.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraInfo {
    /// Width of the stereo frame, pixels, even.
    pub width: u32,
    /// Height, pixels, even.
    pub height: u32,
    /// Nominal rate.
    pub rate_hz: f64,
    /// Length of a device tick.
    pub tick: TickLength,
    /// Width of the device's tick counter in bits, if it wraps.
    pub tick_bits: Option<u8>,
    /// Width of the device's frame counter in bits, if it wraps.
    pub number_bits: Option<u8>,
    /// Whether the images have color.
    pub colour: bool,
    /// Whether a repeated image is intended, so that a frozen image is no fault.
    pub still: bool,
    /// Properties of the timestamps, if ticks are ns of the host clock, as from a driver: then no
    /// clock map is estimated.
    pub stamped: Option<TimestampRelation>,
}

/// Relation of host timestamps to the instants that they stand for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimestampRelation {
    /// Known constant delay from the instant to the timestamp, ns.
    pub latency_ns: i64,
    /// One standard deviation of the remaining error, ns.
    pub sigma_ns: u64,
}

/// Properties of a source's IMU, known before the first sample.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuInfo {
    /// Nominal rate.
    pub rate_hz: f64,
    /// Length of a device tick.
    pub tick: TickLength,
    /// Width of the device's tick counter in bits, if it wraps.
    pub tick_bits: Option<u8>,
    /// Width of the device's sample counter in bits, if it wraps.
    pub number_bits: Option<u8>,
    /// rad/s per gyro count and m/s² per accelerometer count, if samples are counts.
    pub scale: Option<(f64, f64)>,
    /// °C per count, if samples have a temperature: all of them or none.
    pub temperature_scale_c: Option<f64>,
}

/// Properties of a source, known before the first sample.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceInfo {
    /// For people: `replay of KITTI pairs`, `ZED Mini SN…`.
    pub description: String,
    /// Its camera.
    pub camera: CameraInfo,
    /// Its IMU, if it has one.
    pub imu: Option<ImuInfo>,
    /// Name and content of the vendor's calibration files, unmodified.
    pub calibration_files: Vec<(String, Vec<u8>)>,
}

/// Permanent error of a source.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The data is unusable; a retry will not help.
    #[error("{source_name} cannot be read: {what}")]
    Unusable {
        /// Name of the source.
        source_name: String,
        /// The error.
        what: String,
    },
}

/// Maximum number of bytes that [`Extent::Head`] reads of a file. 1 MiB.
pub const HEAD_BYTES: u64 = 1 << 20;

/// Extent to which a recorded source reads its files when it is opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// All of lists and bags, so that unusable data is rejected.
    Whole,
    /// The beginning of each file, up to [`HEAD_BYTES`], as if there were no more: for a check, not
    /// for a replay.
    Head,
}

/// A source of samples with arrival times known in advance.
pub trait Source: Send {
    /// Its properties.
    fn info(&self) -> &SourceInfo;

    /// The next sample, in the order of arrival; `None` at the end. It returns immediately, with an
    /// arrival time that may be in the future and that the caller has to wait for.
    ///
    /// # Errors
    /// See [`SourceError`].
    fn next_sample(&mut self) -> Result<Option<Sample>, SourceError>;

    /// Sets whether the pixels of the following frames are needed. While they are not, a source may
    /// deliver [`Sample::Arrival`] instead. A source whose frames depend on earlier ones may ignore
    /// it.
    fn set_pixels_needed(&mut self, needed: bool) {
        let _ = needed;
    }

    /// Moves the schedule so that it begins at `start`; only before the first sample.
    fn begin_at(&mut self, start: HostTime) {
        let _ = start;
    }

    /// Skips samples that are overdue at `now`: a source that renders its samples leaves frames
    /// out, like a device that is not read in time. Returns the skipped ones.
    fn skip_overdue(&mut self, now: HostTime) -> Vec<DroppedFrame> {
        let _ = now;
        Vec::new()
    }

    /// Ground truth as files that the session stores beside the rig's: name and content. Called
    /// when the beginning of the schedule is known.
    fn truth(&self) -> Vec<(String, Vec<u8>)> {
        Vec::new()
    }

    /// The stereo calibration of the source, if there is one.
    ///
    /// # Errors
    /// It is for images of another size than those of the source.
    fn calibration(&self) -> Result<Option<&StereoCalibration>, &CalibError> {
        Ok(None)
    }

    /// Digest of the settings and input data that determine its output, beside [`Source::info`] and
    /// [`Source::truth`]; independent of the folder of its files. It distinguishes recordings in
    /// virtual time.
    fn digest(&self) -> Vec<u8>;
}

/// Receiver of a live source's samples; used from several threads.
pub trait Sink: Sync {
    /// Now, on the host clock.
    fn now(&self) -> HostTime;

    /// Takes a sample. IMU samples wait for room; a frame without room is dropped and accounted
    /// for.
    fn put(&self, sample: Sample);

    /// Whether the pixels of a frame are needed now; if not, [`Sample::Arrival`] is delivered
    /// instead.
    fn pixels_needed(&self) -> bool {
        true
    }

    /// Whether the source has to end: checked several times a second.
    fn is_ending(&self) -> bool;
}

/// A source that waits for a device.
pub trait Live: Send {
    /// Its properties. Known from the configuration, before the device is present.
    fn info(&self) -> &SourceInfo;

    /// Delivers until the sink requests the end. A device that is absent or disconnects is reported
    /// once as [`Sample::Disconnected`] and waited for; its samples follow when it is present.
    ///
    /// # Errors
    /// [`SourceError`] if waiting and retrying cannot help.
    fn run(self: Box<Self>, sink: &dyn Sink) -> Result<(), SourceError>;
}

/// A source of either kind.
pub enum AnySource {
    /// Arrival times are known in advance.
    Scheduled(Box<dyn Source>),
    /// Waits for a device.
    Live(Box<dyn Live>),
}

impl AnySource {
    /// Its properties.
    pub fn info(&self) -> &SourceInfo {
        match self {
            Self::Scheduled(source) => source.info(),
            Self::Live(source) => source.info(),
        }
    }

    /// The stereo calibration of the source, if there is one.
    ///
    /// # Errors
    /// It is for images of another size than those of the source.
    pub fn calibration(&self) -> Result<Option<&StereoCalibration>, &CalibError> {
        match self {
            Self::Scheduled(source) => source.calibration(),
            Self::Live(_) => Ok(None),
        }
    }
}

/// Name of a calibration file of `camera` in a session: the camera's name, then the file's path
/// below `root` (the file itself or a folder), joined with dots.
pub(crate) fn rig_file_name(camera: &str, root: &Path, file: &Path) -> String {
    let inside = match file.strip_prefix(root) {
        Ok(inside) if inside != Path::new("") => inside,
        _ => Path::new(file.file_name().unwrap_or_default()),
    };
    let inside = inside.strip_prefix("mav0").unwrap_or(inside);
    let parts = inside.iter().map(|part| part.to_string_lossy());
    parts.fold(camera.to_owned(), |name, part| format!("{name}.{part}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calibration_files_are_named_by_camera_and_path() {
        let name = |root: &str, file: &str| rig_file_name("feet", root.as_ref(), file.as_ref());
        assert_eq!(name("a/SN1.conf", "a/SN1.conf"), "feet.SN1.conf");
        assert_eq!(name("a", "a/K.txt"), "feet.K.txt");
        assert_eq!(
            name("a", "a/mav0/cam0/sensor.yaml"),
            "feet.cam0.sensor.yaml"
        );
        assert_eq!(
            name("a/mav0", "a/mav0/cam1/sensor.yaml"),
            "feet.cam1.sensor.yaml"
        );
    }
}
