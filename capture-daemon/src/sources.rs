//! Where pictures and IMU samples come from.
//!
//! A source delivers the samples of one camera and of the IMU in it, in the order of their arrival.
//! Each source separates bytes → sample (pure, tested on recorded bytes) from I/O, and has fakes
//! beside it. Here are the sources that need no hardware: [`replay`] of recorded data sets, a
//! [`simulated`] walk and a [`synthetic`] moving picture; all know when each sample is to arrive and leave the
//! waiting to the runner, so that they run in real time and in virtual time alike.

use std::path::Path;

use calib::StereoCalibration;
use session_archive::time::{HostTime, TickLength};
use video::Picture;

pub mod datasets;
pub mod replay;
pub mod simulated;
pub mod synthetic;

/// One stereo frame as a source delivers it.
#[derive(Clone, Debug)]
pub struct RawFrame {
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
    /// Left and right side by side, I420 (grey pictures with neutral chroma).
    pub picture: Picture,
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

/// What a source delivers.
#[derive(Clone, Debug)]
pub enum Sample {
    /// A stereo frame.
    Frame(RawFrame),
    /// An IMU sample.
    Imu(RawImu),
    /// The device is gone; samples that follow come from it after it has returned.
    Gone(Gone),
}

/// A device that is gone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gone {
    /// When that was noticed.
    pub host_time: HostTime,
    /// What exactly happened, for people.
    pub detail: String,
}

impl Sample {
    /// When it arrived, or is to arrive.
    pub fn host_time(&self) -> HostTime {
        match self {
            Self::Frame(f) => f.host_time,
            Self::Imu(i) => i.host_time,
            Self::Gone(g) => g.host_time,
        }
    }

    /// Bytes that it occupies, for bounding queues.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Frame(f) => f.picture.data.len() + size_of::<RawFrame>(),
            Self::Imu(_) => size_of::<RawImu>(),
            Self::Gone(_) => size_of::<Gone>(),
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

/// A source of samples.
pub trait Source: Send {
    /// What it delivers.
    fn info(&self) -> &SourceInfo;

    /// The next sample, in the order of arrival; none when there will be no more. A scheduled source
    /// returns at once with an arrival time that may lie in the future; a live one returns when
    /// the sample has arrived.
    ///
    /// # Errors
    /// See [`SourceError`].
    fn next_sample(&mut self) -> Result<Option<Sample>, SourceError>;

    /// Whether arrival times are a schedule that the caller has to wait for.
    fn is_scheduled(&self) -> bool;

    /// Moves the schedule so that it begins at `start`; only before the first sample. A live source
    /// has no schedule.
    fn begin_at(&mut self, start: HostTime) {
        let _ = start;
    }

    /// It is so late that samples which were to arrive before `now` cannot be made any more: a source that
    /// makes its samples leaves frames out, as a device does that is not read in time.
    fn hurry(&mut self, now: HostTime) {
        let _ = now;
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
    fn calibration_files_are_named_by_camera_and_place() {
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
