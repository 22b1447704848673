//! Where pictures and IMU samples come from.
//!
//! A source delivers the samples of one camera and of the IMU in it, in the order of their arrival.
//! Each source separates bytes → sample (pure, tested on recorded bytes) from I/O, and has fakes
//! beside it. There are two kinds:
//!
//! * [`Source`]s need no hardware: [`replay`] of recorded data sets, of a [`bag`] and of a [video file](video_file), a
//!   [`simulated`] walk and a [`synthetic`] moving picture. They know when each sample is to arrive and leave the waiting to the runner, so that they
//!   run in real time and in virtual time alike.
//! * [`Live`] sources wait for devices, each on threads of its own. A device that is not there yet, or no
//!   longer, is waited for: see [`Live::run`].

use std::path::Path;

use calib::StereoCalibration;
use session_archive::record::paws::gap::Cause;
use session_archive::time::{HostTime, TickLength};
use video::encoder::Input;
use video::{NativeFrame, Picture};

pub mod bag;
pub mod datasets;
pub mod device;
pub mod gstreamer;
mod jpeg;
pub(crate) mod pairing;
pub mod replay;
pub mod simulated;
pub mod synthetic;
pub mod video_file;

/// One stereo frame as a source delivers it: as a [`Picture`], or in its camera's own buffer.
#[derive(Clone, Debug)]
pub struct RawFrame<P = Picture> {
    /// The device's own sequence number.
    pub number: u64,
    /// Device clock at the instant that the device stamps.
    pub device_ticks: i64,
    /// The driver's time stamp, where there is one.
    pub kernel_time: Option<HostTime>,
    /// When the frame arrived.
    pub host_time: HostTime,
    /// Exposure time where the device tells it, ns.
    pub exposure_ns: Option<u32>,
    /// How much later the right eye's image was taken, ns, where the eyes came separately.
    pub eyes_apart_ns: Option<i64>,
    /// Left and right side by side; a [`Picture`] is I420 (grey ones with neutral chroma).
    pub image: P,
}

/// The pixels of a frame, in the form in which they go into an encoder.
pub trait Pixels {
    /// What goes into the encoder.
    fn input(&self) -> Input<'_>;

    /// A number that tells whether the picture is the same as the one before it; none where the pixels cannot be
    /// looked at.
    fn digest(&self) -> Option<u64>;

    /// What can be shown small.
    fn preview_pixels(&self) -> PreviewPixels<'_>;
}

/// Pixels that are to be shown small.
#[derive(Clone, Copy, Debug)]
pub enum PreviewPixels<'a> {
    /// In memory.
    Image(&'a Picture),
    /// In a camera's own buffer.
    Native(&'a NativeFrame),
}

impl Pixels for Picture {
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
    /// When the sample arrived.
    pub host_time: HostTime,
    /// What was measured.
    pub values: ImuValues,
    /// Temperature of the IMU, in counts of [`ImuInfo::temperature_scale_c`].
    pub temperature: Option<i32>,
    /// Whether the device says that a frame was taken with it.
    pub frame_sync: bool,
}

/// A measurement, in the numbers in which the source has it; never converted.
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

/// A stereo frame that came while nobody stores frames: without its pixels, which were not fetched or made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameArrival {
    /// The device's own sequence number.
    pub number: u64,
    /// Device clock at the instant that the device stamps.
    pub device_ticks: i64,
    /// When the frame arrived.
    pub host_time: HostTime,
}

/// What a source delivers.
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
    /// The device is gone; samples that follow come from it after it has returned.
    Disconnected(Disconnected),
    /// A frame that came and cannot be used.
    Dropped(DroppedFrame),
    /// Something happened that is worth keeping.
    Notice(Notice),
    /// How the clocks of camera and IMU lie to each other, as the device itself tells it.
    FrameSync(FrameSync),
}

/// Which of a source's devices is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DevicePart {
    /// The camera alone.
    Camera,
    /// The IMU alone.
    Imu,
    /// Both, for they are one device.
    Both,
}

/// A device that is gone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Disconnected {
    /// When that was noticed.
    pub host_time: HostTime,
    /// What is gone.
    pub part: DevicePart,
    /// What exactly happened, for people.
    pub detail: String,
}

/// A frame that the device counted and that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DroppedFrame {
    /// The device's own sequence number.
    pub number: u64,
    /// When it arrived.
    pub host_time: HostTime,
    /// Why it cannot be used.
    pub cause: Cause,
    /// What exactly happened, for people.
    pub detail: String,
}

/// Something that happened to a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    /// When.
    pub host_time: HostTime,
    /// To which device.
    pub part: DevicePart,
    /// What, for people.
    pub text: String,
}

/// Clocks of a camera and its IMU, tied by samples that the device marks as taken with a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameSync {
    /// When this was found.
    pub host_time: HostTime,
    /// Marked samples that belong to a frame, used for it.
    pub pairs: u32,
    /// An instant on the IMU's clock.
    pub ticks: i64,
    /// The same instant as the camera's driver would stamp it.
    pub stamp: HostTime,
    /// One standard deviation of that, ns.
    pub sigma_ns: u64,
    /// By how much the stamps lie above the line through all, ns: half of them by less.
    pub residual_median_ns: u64,
    /// The same; 99 of 100 by less.
    pub residual_p99_ns: u64,
    /// Number of the device's sync counter less that of the frame.
    pub count_minus_number: i64,
}

impl Sample {
    /// When it arrived, or is to arrive.
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

    /// Bytes that it occupies, for bounding queues.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Arrival(_) => size_of::<FrameArrival>(),
            Self::Frame(f) => f.image.data.len() + size_of::<RawFrame>(),
            Self::Native(f) => f.image.bytes() + size_of::<RawFrame<NativeFrame>>(),
            Self::Imu(_) => size_of::<RawImu>(),
            Self::Disconnected(Disconnected { detail, .. })
            | Self::Dropped(DroppedFrame { detail, .. }) => {
                size_of::<DroppedFrame>() + detail.len()
            }
            Self::Notice(notice) => size_of::<Notice>() + notice.text.len(),
            Self::FrameSync(_) => size_of::<FrameSync>(),
        }
    }
}

/// What is known of a source's camera before the first sample.
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
    /// Width of the device's tick counter, where it wraps.
    pub tick_bits: Option<u8>,
    /// Width of the device's frame counter, where it wraps.
    pub number_bits: Option<u8>,
    /// Whether chroma means anything.
    pub colour: bool,
    /// Whether the same picture again and again is what the source is meant to deliver, so that a
    /// frozen picture is no fault.
    pub still: bool,
    /// Where ticks are ns of the host clock, as drivers stamp them: then there is no clock to be learned.
    pub stamped: Option<Stamped>,
}

/// How the host's own stamps lie to the instants that they stand for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamped {
    /// From the instant to the stamp, as far as it is known and constant, ns.
    pub latency_ns: i64,
    /// One standard deviation of what remains, ns.
    pub sigma_ns: u64,
}

/// What is known of a source's IMU before the first sample.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuInfo {
    /// Nominal rate.
    pub rate_hz: f64,
    /// Length of a device tick.
    pub tick: TickLength,
    /// Width of the device's tick counter, where it wraps.
    pub tick_bits: Option<u8>,
    /// Width of the device's sample counter, where it wraps.
    pub number_bits: Option<u8>,
    /// rad/s per gyro count and m/s² per accelerometer count, where samples are counts.
    pub scale: Option<(f64, f64)>,
    /// °C per count, where samples have a temperature: all of them or none.
    pub temperature_scale_c: Option<f64>,
}

/// What is known of a source before the first sample.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceInfo {
    /// For people: `replay of KITTI pairs`, `ZED Mini SN…`.
    pub description: String,
    /// Its camera.
    pub camera: CameraInfo,
    /// Its IMU, if it has one.
    pub imu: Option<ImuInfo>,
    /// Name and content of the vendor's calibration files, as they came.
    pub calibration_files: Vec<(String, Vec<u8>)>,
}

/// Why a source cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The data cannot be used; trying again will not help.
    #[error("{source_name} cannot be read: {what}")]
    Unusable {
        /// Which source.
        source_name: String,
        /// What is wrong.
        what: String,
    },
}

/// Most that [`Extent::Head`] reads of a file. 1 MiB.
pub const HEAD_BYTES: u64 = 1 << 20;

/// How much of its files a recorded source reads to be opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// All of lists and bags, so that what cannot be replayed is refused.
    Whole,
    /// The beginning of each file, up to [`HEAD_BYTES`], as if there were no more: for a look, not to be replayed.
    Head,
}

/// A source of samples that knows beforehand when they are to arrive.
pub trait Source: Send {
    /// What it delivers.
    fn info(&self) -> &SourceInfo;

    /// The next sample, in the order of arrival; none when there will be no more. It returns at once, with
    /// an arrival time that may lie in the future and that the caller has to wait for.
    ///
    /// # Errors
    /// See [`SourceError`].
    fn next_sample(&mut self) -> Result<Option<Sample>, SourceError>;

    /// Whether the pixels of the frames that follow are wanted: while nobody stores them a source may deliver
    /// [`Sample::Arrival`] instead. A source of which each frame needs the ones before may ignore it.
    fn set_pixels_needed(&mut self, needed: bool) {
        let _ = needed;
    }

    /// Moves the schedule so that it begins at `start`; only before the first sample.
    fn begin_at(&mut self, start: HostTime) {
        let _ = start;
    }

    /// It is so late that samples which were to arrive before `now` cannot be made any more: a source that
    /// makes its samples leaves frames out, as a device does that is not read in time. Which ones.
    fn skip_overdue(&mut self, now: HostTime) -> Vec<DroppedFrame> {
        let _ = now;
        Vec::new()
    }

    /// What is true, as files that the session keeps beside the rig's: name and content. Asked for when the
    /// beginning of the schedule is known.
    fn truth(&self) -> Vec<(String, Vec<u8>)> {
        Vec::new()
    }

    /// The stereo calibration that comes with the source, where there is one.
    fn calibration(&self) -> Option<&StereoCalibration> {
        None
    }

    /// Bytes that are others when what it delivers is something else by its settings or by what it reads, beside what
    /// [`Source::info`] and [`Source::truth`] say; the same wherever its files lie. Recordings in virtual time are told
    /// apart by them.
    fn digest(&self) -> Vec<u8>;
}

/// Where a live source puts its samples; used from several threads.
pub trait Sink: Sync {
    /// Now, on the host clock.
    fn now(&self) -> HostTime;

    /// Takes a sample. IMU samples wait for room; a frame for which there is none is dropped and accounted for.
    fn put(&self, sample: Sample);

    /// Whether the pixels of a frame are wanted now; if not, [`Sample::Arrival`] stands for it.
    fn pixels_needed(&self) -> bool {
        true
    }

    /// Whether the source is to end: looked at several times a second.
    fn is_ending(&self) -> bool;
}

/// A source that waits for a device.
pub trait Live: Send {
    /// What it delivers. Known from the configuration, before the device is there.
    fn info(&self) -> &SourceInfo;

    /// Delivers until the sink says that it is to end. A device that is not there, or that goes away, is told
    /// once as [`Sample::Disconnected`] and waited for; its samples follow when it is there.
    ///
    /// # Errors
    /// [`SourceError`] when waiting and trying again cannot help.
    fn run(self: Box<Self>, sink: &dyn Sink) -> Result<(), SourceError>;
}

/// A source of either kind.
pub enum AnySource {
    /// Knows beforehand when its samples are to arrive.
    Scheduled(Box<dyn Source>),
    /// Waits for a device.
    Live(Box<dyn Live>),
}

impl AnySource {
    /// What it delivers.
    pub fn info(&self) -> &SourceInfo {
        match self {
            Self::Scheduled(source) => source.info(),
            Self::Live(source) => source.info(),
        }
    }

    /// The stereo calibration that comes with the source, where there is one.
    pub fn calibration(&self) -> Option<&StereoCalibration> {
        match self {
            Self::Scheduled(source) => source.calibration(),
            Self::Live(_) => None,
        }
    }
}

/// The name under which a session keeps a calibration file of `camera`: the camera's, then the file's
/// place below `root` (the file itself or a folder), joined with dots.
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
