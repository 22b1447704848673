//! Material to encode: real stereo recordings where available, and a synthetic one.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use capture_daemon::sources::replay::Replay;
use capture_daemon::sources::synthetic::Synthetic;
use capture_daemon::sources::{Sample, Source};
use serde_json::{Value, json};
use session_archive::time::HostTime;
use video::RawImage;

/// Stereo frames as the daemon gets them: side by side, I420.
pub(super) struct Clip {
    /// `kitti`, `euroc` or `synthetic`.
    pub(super) name: &'static str,
    /// Description of the content.
    pub(super) shows: &'static str,
    pub(super) rate_hz: f64,
    pub(super) images: Vec<RawImage>,
}

impl Clip {
    pub(super) fn json(&self) -> Value {
        json!({
            "name": self.name,
            "shows": self.shows,
            "width": self.images[0].width,
            "height": self.images[0].height,
            "rate_hz": self.rate_hz,
            "frames": self.images.len(),
        })
    }
}

/// A folder of the real recordings, or a printed reason why it is skipped.
fn shared(folder: &str) -> Option<PathBuf> {
    match harness::data::sets([folder]) {
        Ok([path]) => Some(path),
        Err(reason) => {
            eprintln!("{reason}");
            None
        }
    }
}

/// The clips, at most `count` frames of each.
pub(super) fn clips(count: usize) -> Result<Vec<Clip>> {
    let shows = "a room, the cameras at rest";
    let euroc = match shared("03_stereo_imu/euroc_V1_01_micro") {
        Some(path) => Some(replay("euroc", shows, &path, None, count)?),
        None => None,
    };
    let wall = Synthetic::new("synthetic", 1344, 376, 30.0, 0.0, 0, HostTime(0))
        .context("generating images")?;
    let wall = clip(
        "synthetic",
        "a synthetic textured wall, moving",
        wall,
        count,
    )?;
    let kitti = kitti(count)?.map(|(_, clip)| clip);
    Ok(kitti.into_iter().chain(euroc).chain([wall]).collect())
}

/// The KITTI pairs and where they are.
pub(super) fn kitti(count: usize) -> Result<Option<(PathBuf, Clip)>> {
    let Some(path) = shared("02_stereo_odometry_kitti/KITTI_sequence_1") else {
        return Ok(None);
    };
    let clip = replay(
        "kitti",
        "a drive through a street",
        &path,
        Some(10.0),
        count,
    )?;
    Ok(Some((path, clip)))
}

fn replay(
    name: &'static str,
    shows: &'static str,
    path: &Path,
    rate_hz: Option<f64>,
    count: usize,
) -> Result<Clip> {
    let source = Replay::open(name, path, rate_hz, false, false, HostTime(0))
        .with_context(|| format!("opening the recording {name}"))?;
    clip(name, shows, source, count)
}

fn clip(
    name: &'static str,
    shows: &'static str,
    mut source: impl Source,
    count: usize,
) -> Result<Clip> {
    let rate_hz = source.info().camera.rate_hz;
    let mut images = Vec::new();
    while images.len() < count {
        match source
            .next_sample()
            .with_context(|| format!("reading {name}"))?
        {
            Some(Sample::Frame(frame)) => images.push(frame.image),
            Some(_) => {}
            None => break,
        }
    }
    anyhow::ensure!(!images.is_empty(), "{name} has no images");
    Ok(Clip {
        name,
        shows,
        rate_hz,
        images,
    })
}
