//! Overhead of a recording over its encoders.
//!
//! The daemon records three cameras in real time; the peer is one `gst-launch-1.0` with three
//! branches that read the same images from memory, wait for their time, and run the same encoder
//! element with the same properties into nothing. The daemon runs as a process of its own: this
//! program, started again with [`RECORD`], which calls what `pawsd record` calls. Images are the
//! KITTI pairs, repeated; the daemon caches them decoded after the first round, so that in the long
//! run neither side pays for reading PNG.
//!
//! Sessions are written to the disk that the target folder is on, with all syncs; the peer's images
//! are in memory, where the daemon's are too after the first round. Processor time of a process is
//! read after it has ended, to 10 ms.

use std::fs;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};
use session_archive::index::Index;
use session_archive::reader::SessionReader;
use session_archive::storage::DiskStorage;
use video::{Encoder, EncoderSettings, RawImage};

use super::curve::round;
use super::material;
use crate::meter::{self, children_cpu_s, median};
use crate::recording::RECORD;

const ELEMENT: &str = "x264enc";
const CAMERAS: [&str; 3] = ["left_shoulder", "right_shoulder", "feet"];
const RATE_HZ: u32 = 20;
/// A key frame each half second, as the daemon forces them.
const KEY_INTERVAL: u32 = RATE_HZ / 2;
const QUALITY_DB: f64 = 42.0;
/// Maximum ratio of processor time against the bare pipeline.
const MAX_CPU_RATIO: f64 = 1.10;
/// Accepted ratio of video bytes of daemon and peer; outside of it their settings differ.
const BYTES_RATIO_RANGE: RangeInclusive<f64> = 0.98..=1.02;

/// Length and number of the runs.
pub(super) struct Plan {
    pub(super) short_s: u32,
    pub(super) long_s: u32,
    pub(super) repetitions: usize,
}

/// Result.
pub(super) struct Share {
    /// Processor time per stereo frame, ms: the daemon's and the bare pipeline's, run side by side.
    pairs_ms: Vec<(f64, f64)>,
    /// The bare pipeline without its encoder: cost of reading the images, ms per frame.
    pub(super) reading_ms: f64,
    /// Frames that the daemon did not store, of all runs.
    missing: u64,
    /// Bytes of video of the daemon over those of the bare pipeline, for the same number of frames.
    bytes_ratio: f64,
}

impl Share {
    pub(super) fn daemon_ms(&self) -> f64 {
        median(self.pairs_ms.iter().map(|(daemon, _)| *daemon))
    }

    pub(super) fn bare_ms(&self) -> f64 {
        median(self.pairs_ms.iter().map(|(_, bare)| *bare))
    }

    /// Median over the pairs: other load of the machine affects both of a pair.
    pub(super) fn ratio(&self) -> f64 {
        median(self.pairs_ms.iter().map(|(daemon, bare)| daemon / bare))
    }

    /// The same with what the bare pipeline spends on reading taken off: the harder comparison.
    fn ratio_to_encoder(&self) -> f64 {
        let encoder = |bare: &f64| bare - self.reading_ms;
        median(
            self.pairs_ms
                .iter()
                .map(|(daemon, bare)| daemon / encoder(bare)),
        )
    }

    pub(super) fn json(&self) -> Value {
        let pair = |(daemon, bare): &(f64, f64)| json!([round(*daemon), round(*bare)]);
        json!({
            "element": ELEMENT,
            "cameras": CAMERAS.len(),
            "rate_hz": RATE_HZ,
            "quality_db": QUALITY_DB,
            "daemon_cpu_ms_per_frame": round(self.daemon_ms()),
            "bare_cpu_ms_per_frame": round(self.bare_ms()),
            "bare_reading_cpu_ms_per_frame": round(self.reading_ms),
            "pairs": self.pairs_ms.iter().map(pair).collect::<Vec<_>>(),
            "ratio": round(self.ratio()),
            "ratio_to_encoder_alone": round(self.ratio_to_encoder()),
            "limit": MAX_CPU_RATIO,
            "within_limit": self.ratio() <= MAX_CPU_RATIO,
            "missing_frames": self.missing,
            "bytes_ratio": round(self.bytes_ratio),
        })
    }
}

/// Measures; `None` if the images or `gst-launch-1.0` are absent.
///
/// # Errors
/// A run fails, or the two encode differently, so that their times are not comparable.
pub(super) fn measure(plan: &Plan) -> Result<Option<Share>> {
    // All of them: the daemon replays the whole folder.
    let Some((kitti, clip)) = material::kitti(usize::MAX)? else {
        eprintln!("skipped: the daemon's share needs the KITTI pairs");
        return Ok(None);
    };
    if Command::new("gst-launch-1.0")
        .arg("--version")
        .output()
        .is_err()
    {
        eprintln!("skipped: the daemon's share needs gst-launch-1.0");
        return Ok(None);
    }
    let folder = memory_folder()?;
    let bare = Bare::new(folder.path(), &clip.images)?;
    let disk = meter::on_disk(None)?;
    let disk = tempfile::tempdir_in(&disk).context("making a folder for sessions")?;
    let daemon = Daemon::new(disk.path(), &kitti)?;

    let mut share = Share {
        pairs_ms: Vec::new(),
        reading_ms: bare.per_frame_ms(plan)?,
        missing: 0,
        bytes_ratio: f64::NAN,
    };
    for repetition in 0..plan.repetitions {
        let mut daemon_costs = Vec::new();
        let mut bare_costs = Vec::new();
        for seconds in [plan.short_s, plan.long_s] {
            // The order alternates, so that a rising load of the machine favours neither.
            if repetition % 2 == 0 {
                daemon_costs.push(daemon.run(seconds)?);
                bare_costs.push(bare.run(seconds, true)?);
            } else {
                bare_costs.push(bare.run(seconds, true)?);
                daemon_costs.push(daemon.run(seconds)?);
            }
        }
        let pair = (per_frame_ms(&daemon_costs), per_frame_ms(&bare_costs));
        println!(
            "a frame costs the daemon {:.2} ms, the bare pipeline {:.2} ms",
            pair.0, pair.1
        );
        share.pairs_ms.push(pair);
        share.missing += daemon_costs.iter().map(|cost| cost.missing).sum::<u64>();
        if repetition == 0 {
            let long = &daemon_costs[1];
            share.bytes_ratio = long.bytes as f64 / bare.bytes(long.frames)? as f64;
            ensure!(
                BYTES_RATIO_RANGE.contains(&share.bytes_ratio),
                "the daemon's video is {:.3} times as large as the bare pipeline's: their encoders \
                 are not set up alike",
                share.bytes_ratio
            );
        }
    }
    println!(
        "daemon over bare pipeline: {:.3} (limit {MAX_CPU_RATIO}), over the encoder alone {:.3}; \
         {} frames missing; {:.3} times the bytes",
        share.ratio(),
        share.ratio_to_encoder(),
        share.missing,
        share.bytes_ratio
    );
    Ok(Some(share))
}

/// Processor time that a frame adds, from a short and a long run.
fn per_frame_ms(costs: &[Cost]) -> f64 {
    let (short, long) = (&costs[0], &costs[1]);
    (long.cpu_s - short.cpu_s) * 1e3 / (long.frames - short.frames) as f64
}

/// What a run took and did.
struct Cost {
    cpu_s: f64,
    frames: u64,
    missing: u64,
    bytes: u64,
}

/// A folder in memory where the machine has one, or else on disk.
fn memory_folder() -> Result<tempfile::TempDir> {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() {
        tempfile::tempdir_in(memory).context("making a folder in /dev/shm")
    } else {
        tempfile::tempdir().context("making a folder for images")
    }
}

/// Runs a process to its end and gives the processor time that it took.
fn cpu_of(command: &mut Command) -> Result<f64> {
    let before = children_cpu_s()?;
    let status = command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .status()
        .with_context(|| format!("starting {command:?}"))?;
    ensure!(status.success(), "{command:?} ended with {status}");
    Ok(children_cpu_s()? - before)
}

/// The daemon.
struct Daemon {
    config: PathBuf,
    sessions: PathBuf,
}

impl Daemon {
    fn new(folder: &Path, images: &Path) -> Result<Self> {
        let images = fs::canonicalize(images).context("finding the KITTI pairs")?;
        let mut text =
            format!("[encoder]\nelement = {ELEMENT:?}\nquality_db = {QUALITY_DB:?}\nthreads = 1\n");
        for name in CAMERAS {
            text += &format!(
                "[[camera]]\nname = {name:?}\n[camera.source]\nkind = \"replay\"\npath = {:?}\n\
                 rate_hz = {RATE_HZ}\nrepeat = true\nimu = false\n",
                images.display().to_string()
            );
        }
        let config = folder.join("pawsd.toml");
        fs::write(&config, text).with_context(|| format!("writing {}", config.display()))?;
        Ok(Self {
            config,
            sessions: folder.join("sessions"),
        })
    }

    fn run(&self, seconds: u32) -> Result<Cost> {
        // This very program, even if its file was replaced since it started.
        let mut command = Command::new("/proc/self/exe");
        command
            .args(["encode", RECORD])
            .arg(&self.config)
            .arg(&self.sessions);
        let cpu_s = cpu_of(command.arg(seconds.to_string()))?;
        let mut cost = Cost {
            cpu_s,
            frames: 0,
            missing: 0,
            bytes: 0,
        };
        for entry in fs::read_dir(&self.sessions).context("looking for the session")? {
            let session = entry.context("looking for the session")?.path();
            let reader = SessionReader::open(Arc::new(DiskStorage::new(&session)))
                .with_context(|| format!("opening {}", session.display()))?;
            let index = Index::build(&reader, |_| {}).context("indexing the session")?;
            for camera in &index.cameras {
                let numbers = camera.frames.first().zip(camera.frames.last());
                let span = numbers.map_or(0, |(first, last)| last.number - first.number + 1);
                cost.frames += camera.frames.len() as u64;
                cost.missing += span - camera.frames.len() as u64;
                cost.bytes += camera
                    .frames
                    .iter()
                    .map(|f| u64::from(f.bytes))
                    .sum::<u64>();
            }
        }
        fs::remove_dir_all(&self.sessions).context("removing the session")?;
        ensure!(cost.frames > 0, "the daemon recorded nothing");
        Ok(cost)
    }
}

/// The bare pipeline.
struct Bare {
    /// Path pattern of the images, with a placeholder for the number.
    pattern: PathBuf,
    caps: String,
    encoder: String,
    last: usize,
}

impl Bare {
    fn new(folder: &Path, images: &[RawImage]) -> Result<Self> {
        for (number, image) in images.iter().enumerate() {
            let path = folder.join(format!("{number:06}.i420"));
            fs::write(&path, padded(image)?)
                .with_context(|| format!("writing {}", path.display()))?;
        }
        let (width, height) = (images[0].width, images[0].height);
        let settings = EncoderSettings {
            element: ELEMENT.to_owned(),
            width,
            height,
            rate_hz: f64::from(RATE_HZ),
            quality_db: QUALITY_DB,
            threads: 1,
            max_key_interval_frames: KEY_INTERVAL,
            preset: video::encoder::Preset::default(),
        };
        let quantiser = Encoder::start(&settings, Box::new(|_| {}))?.quantiser();
        Ok(Self {
            pattern: folder.join("%06d.i420"),
            caps: format!(
                "video/x-raw,format=I420,width={width},height={height},framerate={RATE_HZ}/1,\
                 pixel-aspect-ratio=1/1,interlace-mode=progressive,colorimetry=1:4:7:1,\
                 chroma-site=jpeg"
            ),
            // What the crate `video` sets; that both give the same number of bytes is checked.
            encoder: format!(
                "{ELEMENT} speed-preset=ultrafast tune=zerolatency pass=quant \
                 quantizer={quantiser} ip-factor=1.0 key-int-max={KEY_INTERVAL} bframes=0 \
                 threads=1 sliced-threads=false aud=false option-string=scenecut=0:open-gop=0"
            ),
            last: images.len() - 1,
        })
    }

    /// `frames` over all cameras; `sink` ends each branch.
    fn pipeline(&self, frames: u64, middle: &[&str], sink: &dyn Fn(usize) -> String) -> Command {
        let mut command = Command::new("gst-launch-1.0");
        command.arg("-q");
        for camera in 0..CAMERAS.len() {
            let count = frames / CAMERAS.len() as u64;
            command.args([
                "multifilesrc".to_owned(),
                format!("location={}", self.pattern.display()),
                format!("stop-index={}", self.last),
                "loop=true".to_owned(),
                format!("num-buffers={count}"),
                format!("caps={}", self.caps),
            ]);
            command.args(["!", "clocksync"]);
            for element in middle {
                command.arg("!").args(element.split_whitespace());
            }
            command.arg("!").args(sink(camera).split_whitespace());
        }
        command
    }

    /// One run, with the encoder or with nothing in its place.
    fn run(&self, seconds: u32, encode: bool) -> Result<Cost> {
        let middle: &[&str] = if encode { &[&self.encoder] } else { &[] };
        let frames = u64::from(seconds * RATE_HZ) * CAMERAS.len() as u64;
        let sink = |_| "fakesink sync=false".to_owned();
        Ok(Cost {
            cpu_s: cpu_of(&mut self.pipeline(frames, middle, &sink))?,
            frames,
            missing: 0,
            bytes: 0,
        })
    }

    /// Cost of reading the images.
    fn per_frame_ms(&self, plan: &Plan) -> Result<f64> {
        Ok(per_frame_ms(&[
            self.run(plan.short_s, false)?,
            self.run(plan.long_s, false)?,
        ]))
    }

    /// Bytes of video for `frames` frames over all cameras.
    fn bytes(&self, frames: u64) -> Result<u64> {
        let file = |camera| self.pattern.with_file_name(format!("{camera}.h264"));
        let sink = |camera| format!("filesink location={}", file(camera).display());
        cpu_of(&mut self.pipeline(frames, &[&self.encoder], &sink))?;
        let mut bytes = 0;
        for camera in 0..CAMERAS.len() {
            let path = file(camera);
            let length = fs::metadata(&path).map(|data| data.len());
            bytes += length.with_context(|| format!("looking at {}", path.display()))?;
        }
        Ok(bytes)
    }
}

/// The planes with rows padded to a multiple of four bytes, as GStreamer expects raw video in a
/// file.
fn padded(image: &RawImage) -> Result<Vec<u8>> {
    image.check()?;
    let (width, height) = (image.width as usize, image.height as usize);
    let mut planes = &image.data[..];
    let mut out = Vec::new();
    for (width, height) in [
        (width, height),
        (width / 2, height / 2),
        (width / 2, height / 2),
    ] {
        let (plane, rest) = planes.split_at(width * height);
        planes = rest;
        for row in plane.chunks_exact(width) {
            out.extend_from_slice(row);
            out.resize(out.len().next_multiple_of(4), 0);
        }
    }
    Ok(out)
}
