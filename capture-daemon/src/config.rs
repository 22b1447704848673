//! The configuration of the daemon: one TOML file, `deploy/pawsd.toml` explains every key.
//!
//! Contract: a [`Config`] that exists is complete, every number in its range and every name valid;
//! what the file leaves out has its default. Reading reports everything that is wrong with a file at
//! once, each with its line, what was found and what was expected; a key that is not known is
//! refused and the nearest known one named. Reading looks at nothing but the file: whether paths
//! exist and encoders work is for [`check`] to find out. Relative paths are relative to the file.

use std::fmt;
use std::path::{Path, PathBuf};

mod check;
mod device;
mod file;
mod operator;
mod section;

pub use device::{DeviceChoice, GstreamerConfig, PixelLayout, V4l2Config, ZedImuConfig};
pub use operator::{Operator, Page};

pub use check::{Finding, Level, check, usb_budget};

/// Where the control socket is unless the configuration says otherwise.
pub const DEFAULT_SOCKET: &str = "/run/paws/pawsd.sock";

/// Everything that can be set.
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
    /// `[page]`: none without the section.
    pub page: Option<Page>,
    /// `[rig] file`: where the cameras sit on the plate.
    pub rig: Option<PathBuf>,
    /// `[[camera]]`: at least one, each name once.
    pub cameras: Vec<Camera>,
}

/// What sessions are like.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// Folder in which sessions are made. The daemon needs it; `pawsd record` may be told another.
    pub out: Option<PathBuf>,
    /// Name of sessions that are not given one; may be empty.
    pub name: String,
    /// Length of a chunk, ns: the most that a power cut takes. 0.1 s to 1 s.
    pub chunk_ns: i64,
    /// How much from before the press is kept, ns. 0 to 60 s.
    pub pre_roll_ns: i64,
}

/// How much of the disk is left alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Disk {
    /// A recording ends when less than this is free, bytes.
    pub reserve_bytes: u64,
}

/// How pictures are compressed.
#[derive(Clone, Debug, PartialEq)]
pub struct Encoder {
    /// GStreamer element, one of [`video::encoder::known_elements`]; none chooses the best that works.
    pub element: Option<String>,
    /// Luma PSNR to reach on real pictures, 30 to 55 dB.
    pub quality_db: f64,
    /// Threads of a software encoder, per camera, 1 to 16.
    pub threads: u32,
}

/// How the daemon is controlled.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Control {
    /// The control socket.
    pub socket: PathBuf,
}

/// A stereo camera with the IMU in it.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Name, unique; streams and frames are called by it.
    pub name: String,
    /// Cameras with the same trigger expose at the same instant; none is free-running.
    pub trigger: Option<String>,
    /// Calibration file; none takes what comes with the source.
    pub calibration: Option<PathBuf>,
    /// From the instant that the device stamps to the arrival, as far as it is constant, ns. Cannot be
    /// seen in arrival times.
    pub latency_ns: i64,
    /// How uncertain that is, ns.
    pub latency_sigma_ns: u64,
    /// The same for the IMU, ns.
    pub imu_latency_ns: i64,
    /// How uncertain that is, ns.
    pub imu_latency_sigma_ns: u64,
    /// Where its samples come from.
    pub source: SourceConfig,
}

/// Where the samples of a camera come from.
#[derive(Clone, Debug, PartialEq)]
pub enum SourceConfig {
    /// A recorded data set.
    Replay(ReplayConfig),
    /// A made-up moving picture.
    Synthetic(SyntheticConfig),
    /// A walk with a simulated rig.
    Simulated(SimulatedConfig),
    /// A camera on the kernel's video interface: any, or a ZED over USB.
    V4l2(V4l2Config),
    /// A camera behind GStreamer elements.
    Gstreamer(GstreamerConfig),
}

/// Replay of a data set.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayConfig {
    /// Its folder.
    pub path: PathBuf,
    /// Rate of a data set that has no times, Hz.
    pub rate_hz: Option<f64>,
    /// Whether the pictures start again when they end.
    pub repeat: bool,
    /// Whether the data set's IMU is replayed too, if it has one.
    pub imu: bool,
}

/// A walk with a simulated rig.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedConfig {
    /// Place, light, length, rate, size of an eye, quality. Cameras with the same share one walk.
    pub walk: rig_sim::simulation::Settings,
    /// File of what goes wrong; none for nothing.
    pub faults: Option<PathBuf>,
}

/// A made-up moving picture with its IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct SyntheticConfig {
    /// Width of the stereo frame (both eyes), pixels, a multiple of 4.
    pub width: u32,
    /// Height, pixels, even.
    pub height: u32,
    /// Pictures per second.
    pub rate_hz: f64,
    /// IMU samples per second; 0 for none.
    pub imu_rate_hz: f64,
    /// Another seed gives another picture.
    pub seed: u64,
}

/// Why there is no configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file could not be read: check the path and its permissions.
    #[error("reading the configuration: {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not a configuration: correct everything listed.
    #[error("checking the configuration: {problems}{}", in_file(path.as_deref()))]
    Invalid {
        /// Everything that is wrong, in the order of the file.
        problems: Problems,
        /// The file, where the text came from one.
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
        // The daemon may change its folder; the paths in the configuration must not follow.
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
