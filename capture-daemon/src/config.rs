//! The configuration of the daemon: one TOML file. `deploy/pawsd.toml` explains every key.
//!
//! Contract: a [`Config`] is complete, every number in its range and every name valid; absent keys
//! have their defaults. Parsing reports all problems of a file together, each with its line, what
//! was found and what was expected; an unknown key is rejected and the nearest known one named.
//! Parsing reads nothing but the file: [`crate::check`] finds out whether paths exist and encoders
//! work. Relative paths are relative to the file.

use std::fmt;
use std::path::{Path, PathBuf};

mod device;
mod file;
mod operator;
mod recorded;
mod section;
#[cfg(feature = "simulator")]
mod simulated;

pub use device::{
    DeviceChoice, GstreamerConfig, PixelLayout, RightDevice, V4l2Config, ZedImuConfig,
};
pub use operator::{Operator, Page};
pub use recorded::{BagConfig, BagImages, VideoConfig};
#[cfg(feature = "simulator")]
pub use simulated::SimulatedConfig;

/// Default path of the control socket.
pub const DEFAULT_SOCKET: &str = "/run/paws/pawsd.sock";

/// All settings.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// `[session]`
    pub session: Session,
    /// `[disk]`
    pub disk: Disk,
    /// `[encoder]`
    pub encoder: Encoder,
    /// `[control]`
    pub control: Control,
    /// `[operator]`
    pub operator: Operator,
    /// `[page]`; `None` without the section.
    pub page: Option<Page>,
    /// `[rig] file`: positions of the cameras on the plate.
    pub rig: Option<PathBuf>,
    /// `[[camera]]`: at least one, with unique names.
    pub cameras: Vec<Camera>,
}

/// Settings of sessions.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// Folder in which sessions are created. Required by the daemon; `pawsd record` has an option
    /// for another one.
    pub out: Option<PathBuf>,
    /// Default name of sessions; may be empty.
    pub name: String,
    /// Length of a chunk, ns: the maximum loss by a power cut. 0.1 s to 1 s.
    pub chunk_ns: i64,
    /// Length of the pre-roll, ns. 0 to 60 s.
    pub pre_roll_ns: i64,
}

/// Reserved disk space.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Disk {
    /// Minimum free space, bytes. A recording ends when less is free.
    pub reserve_bytes: u64,
}

/// Settings of the video encoders.
#[derive(Clone, Debug, PartialEq)]
pub struct Encoder {
    /// GStreamer element, one of [`video::encoder::known_elements`]; `None` selects the best that
    /// works.
    pub element: Option<String>,
    /// Target luma PSNR on real images, 30 to 55 dB.
    pub quality_db: f64,
    /// Threads of a software encoder, per camera, 1 to 16.
    pub threads: u32,
}

/// Settings of the control socket.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Control {
    /// The control socket.
    pub socket: PathBuf,
}

/// A stereo camera with the IMU in it.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Unique name, used for streams and frames.
    pub name: String,
    /// Cameras with the same trigger expose simultaneously; `None` is free-running.
    pub trigger: Option<String>,
    /// Calibration file; `None` uses the calibration of the source.
    pub calibration: Option<PathBuf>,
    /// Constant part of the latency from the stamped instant to the arrival, ns. Not observable
    /// from arrival times.
    pub latency_ns: i64,
    /// One sigma of `latency_ns`.
    pub latency_sigma_ns: u64,
    /// The same for the IMU, ns.
    pub imu_latency_ns: i64,
    /// One sigma of `imu_latency_ns`.
    pub imu_latency_sigma_ns: u64,
    /// Source of its samples.
    pub source: SourceConfig,
}

/// Source of a camera's samples.
#[derive(Clone, Debug, PartialEq)]
pub enum SourceConfig {
    /// A recorded data set.
    Replay(ReplayConfig),
    /// A ROS 2 bag.
    Bag(BagConfig),
    /// A video file, or two.
    Video(VideoConfig),
    /// A synthetic moving image.
    Synthetic(SyntheticConfig),
    /// A walk with a simulated rig.
    #[cfg(feature = "simulator")]
    Simulated(SimulatedConfig),
    /// A V4L2 camera: any, or a ZED over USB.
    V4l2(V4l2Config),
    /// A camera behind GStreamer elements.
    Gstreamer(GstreamerConfig),
}

impl SourceConfig {
    /// Whether its samples come with the calibration of nominal lenses, so that none can be given.
    pub(crate) fn has_nominal_lenses(&self) -> bool {
        match self {
            #[cfg(feature = "simulator")]
            Self::Simulated(_) => true,
            _ => false,
        }
    }
}

/// Replay of a data set.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayConfig {
    /// Its folder.
    pub path: PathBuf,
    /// Frame rate of a data set without times, Hz.
    pub rate_hz: Option<f64>,
    /// Whether the images start again after the last one.
    pub repeat: bool,
    /// Whether the data set's IMU is replayed too, if it has one.
    pub imu: bool,
}

/// A synthetic moving image with its IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct SyntheticConfig {
    /// Width of the stereo frame (both eyes), pixels, a multiple of 4.
    pub width: u32,
    /// Height, pixels, even.
    pub height: u32,
    /// Frames per second.
    pub rate_hz: f64,
    /// IMU samples per second; 0 for none.
    pub imu_rate_hz: f64,
    /// Seed of the image.
    pub seed: u64,
}

/// Error of reading a configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file could not be read: check the path and its permissions.
    #[error("reading the configuration: {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file is not a configuration: correct everything listed.
    #[error("checking the configuration: {problems}{}", in_file(path.as_deref()))]
    Invalid {
        /// All problems, in the order of the file.
        problems: Problems,
        /// The file, if the text came from one.
        path: Option<PathBuf>,
    },
}

/// A list of problems, shown one per line.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Problems(pub Vec<Problem>);

/// One thing that is wrong with a configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Line in the file, from 1.
    pub line: usize,
    /// What was found and what was expected.
    pub message: String,
}

impl Config {
    /// Reads and checks a configuration file.
    ///
    /// # Errors
    /// [`ConfigError::Read`], or [`ConfigError::Invalid`] with everything that is wrong.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let failed = |source| ConfigError::Read {
            path: path.to_owned(),
            source,
        };
        let text = plain_file::read_to_string(path, plain_file::TEXT_LIMIT).map_err(failed)?;
        // The daemon may change its working folder; the paths in the configuration must not follow.
        let absolute = std::path::absolute(path).map_err(failed)?;
        let folder = absolute.parent().unwrap_or(Path::new("/"));
        file::parse(&text, folder).map_err(|problems| ConfigError::Invalid {
            problems,
            path: Some(path.to_owned()),
        })
    }

    /// Reads and checks the text of a configuration; relative paths in it are relative to `folder`.
    ///
    /// # Errors
    /// [`ConfigError::Invalid`] with everything that is wrong.
    pub fn parse(text: &str, folder: &Path) -> Result<Self, ConfigError> {
        file::parse(text, folder).map_err(|problems| ConfigError::Invalid {
            problems,
            path: None,
        })
    }
}

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0.as_slice() {
            [only] => write!(f, "{only}"),
            all => {
                write!(f, "{} problems", all.len())?;
                all.iter()
                    .try_for_each(|problem| write!(f, "\n  {problem}"))
            }
        }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: {}", self.line, self.message)
    }
}

fn in_file(path: Option<&Path>) -> String {
    path.map(|path| format!("\nin {}", path.display()))
        .unwrap_or_default()
}

#[cfg(test)]
mod tests;
