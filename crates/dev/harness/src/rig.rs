//! Rigs of synthetic cameras: as the text of a configuration, and as ground truth of their data.

use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use capture_daemon::config::Config;
use capture_daemon::run::{RecordOptions, RecordingSummary, StopFlag, record};
use capture_daemon::sources::synthetic::Synthetic;
use session_archive::time::HostTime;

/// Names of the cameras, in their order.
pub const CAMERAS: [&str; 3] = ["left_shoulder", "right_shoulder", "feet"];

/// A recording of `seconds` in virtual time below `out`.
pub fn in_virtual_time(seconds: f64, out: &Path) -> RecordOptions {
    RecordOptions {
        seconds,
        virtual_time: true,
        name: "synthetic".to_owned(),
        out: out.to_owned(),
    }
}

/// A recording of `seconds` in real time below `out`.
pub fn in_real_time(seconds: f64, out: &Path) -> RecordOptions {
    RecordOptions {
        virtual_time: false,
        ..in_virtual_time(seconds, out)
    }
}

/// A rig of synthetic cameras of one kind, each with its IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rig {
    /// Number of [`CAMERAS`] in use.
    pub cameras: usize,
    /// Width of the stereo frame, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Frames per second.
    pub rate_hz: f64,
    /// IMU samples per second.
    pub imu_rate_hz: f64,
    /// The encoder. It is fixed because the search for the best one takes longer than a test's
    /// session.
    pub encoder: &'static str,
}

impl Rig {
    /// The smallest images from which a frame's number can be read: 64x32 per eye.
    pub const fn small(cameras: usize) -> Self {
        Self {
            cameras,
            width: 128,
            height: 32,
            rate_hz: 30.0,
            imu_rate_hz: 200.0,
            encoder: "x264enc",
        }
    }

    /// Names of the cameras.
    pub fn names(&self) -> &'static [&'static str] {
        &CAMERAS[..self.cameras]
    }

    /// The text of its configuration.
    pub fn toml(&self) -> String {
        let mut text = format!(
            "[session]\npre_roll_s = 1.0\n\n[disk]\nreserve_gb = 0.01\n\n[encoder]\nelement = {:?}\n\n[control]\nsocket = \"pawsd.sock\"\n",
            self.encoder
        );
        for (name, seed) in self.names().iter().zip(1..) {
            text.push_str(&format!(
                "\n[[camera]]\nname = {name:?}\n[camera.source]\nkind = \"synthetic\"\nwidth = {}\nheight = {}\n\
                 rate_hz = {:?}\nimu_rate_hz = {:?}\nseed = {seed}\n",
                self.width, self.height, self.rate_hz, self.imu_rate_hz
            ));
        }
        text
    }

    /// Its configuration; relative paths in it are relative to `folder`.
    ///
    /// # Errors
    /// The text above is not a valid configuration.
    pub fn config(&self, folder: &Path) -> Result<Config> {
        Config::parse(&self.toml(), folder).context("parsing the configuration of a synthetic rig")
    }

    /// Records it.
    ///
    /// # Errors
    /// It cannot be recorded, or not without a failure.
    pub fn record(&self, options: &RecordOptions) -> Result<RecordingSummary> {
        let config = self.config(&options.out)?;
        let finished = record(&config, options, &StopFlag::new(), Box::new(|_| {}))?;
        ensure!(
            finished.error.is_none(),
            "the recording failed: {finished:?}"
        );
        Ok(finished)
    }

    /// The source of one of its cameras, as the daemon opens it.
    ///
    /// # Errors
    /// The camera cannot be created.
    pub fn source(&self, camera: usize, start: HostTime) -> Result<Synthetic> {
        Ok(Synthetic::new(
            CAMERAS[camera],
            self.width,
            self.height,
            self.rate_hz,
            self.imu_rate_hz,
            camera as u64 + 1,
            start,
        )?)
    }
}
