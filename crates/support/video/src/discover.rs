//! Finds an encoder that works on this machine, by encoding and not by a list of what is installed.
//!
//! Contract: a trial encodes a few moving frames, forces a key frame in the middle, and checks
//! every promise of [`crate::encoder`] on what comes out. It takes at most [`TRIAL_LIMIT`], even
//! if the encoder hangs; a hung one is left behind on its thread. Trials run at the start of a
//! program, not while recording: a trial occupies the encoder.
//!
//! What is chosen is a function of what is installed, of whether it works, and of the pixels per
//! second of all cameras ([`choose`]), never of how long a trial took: a trial has the machine to
//! itself or shares it with programs that end a second later, and a few frames tell neither. A
//! trial's speed is shown to people and decides nothing.

use std::sync::mpsc;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use bytes::Bytes;
use thiserror::Error;

use crate::encoder::{self, EncodeError, Encoder, EncoderEvent, EncoderSettings, Preset, kinds};
use crate::pipeline::{self, InitError, lock};
use crate::{AccessUnit, Codec, PixelFormat, RawImage, RawImageError};

/// The longest that one trial may take.
pub const TRIAL_LIMIT: Duration = Duration::from_secs(20);

/// Frames of a trial, and which one is forced to be a key frame.
const FRAMES: usize = 12;
const FORCED: usize = 7;

/// What a trial found out about an encoder that works.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// The GStreamer element.
    pub element: String,
    /// What it produces.
    pub codec: Codec,
    /// Frames per second, one encoder with nothing beside it, on frames that are hard to
    /// compress. A rough figure: it comes from a few frames.
    pub frames_per_s: f64,
}

/// Why an encoder cannot be used here.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum TrialError {
    /// GStreamer itself is unusable.
    #[error(transparent)]
    Init(#[from] InitError),
    /// No encoder can do this size.
    #[error(transparent)]
    Size(#[from] RawImageError),
    /// The plugin is missing, or finds no device.
    #[error("not on this machine")]
    Missing,
    /// It is there but would not encode.
    #[error(transparent)]
    Encode(EncodeError),
    /// It encodes, but not as promised.
    #[error("{0}")]
    Wrong(String),
    /// It hangs.
    #[error("no result within {} s", TRIAL_LIMIT.as_secs())]
    Hung,
}

/// The encoder to use, and why not a better one.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// The GStreamer element, the same for every camera of a session.
    pub element: String,
    /// What it produces.
    pub codec: Codec,
    /// How hard it works, where the element has such a setting.
    pub preset: Preset,
    /// Those passed over, in order of preference, with the reasons.
    pub refused: Vec<(String, TrialError)>,
}

/// What the cameras of one session require of an encoder.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Load {
    /// Columns and rows of the stereo frame and frames per second, for each camera.
    pub cameras: Vec<(u32, u32, f64)>,
    /// Threads of a software encoder, for each camera.
    pub threads: u32,
}

impl Load {
    /// Luma pixels per second of all cameras together.
    pub fn pixels_per_s(&self) -> f64 {
        let of_one = |&(width, height, rate_hz): &(u32, u32, f64)| {
            f64::from(width) * f64::from(height) * rate_hz
        };
        self.cameras.iter().map(of_one).sum()
    }

    /// The preset of x264enc for this load.
    pub fn preset(&self) -> Preset {
        Preset::for_load(self.pixels_per_s())
    }

    /// Every size once.
    fn sizes(&self) -> Vec<(u32, u32)> {
        let mut sizes: Vec<_> = self.cameras.iter().map(|c| (c.0, c.1)).collect();
        sizes.sort_unstable();
        sizes.dedup();
        sizes
    }
}

/// No encoder works here.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("no video encoder works on this machine: {}", list(.refused))]
pub struct NoEncoder {
    /// All of them, in order of preference, with the reasons.
    pub refused: Vec<(String, TrialError)>,
}

fn list(refused: &[(String, TrialError)]) -> String {
    let lines: Vec<String> = refused
        .iter()
        .map(|(element, reason)| format!("{element}: {reason}"))
        .collect();
    lines.join("; ")
}

/// Tries one encoder at one size, with one thread.
///
/// # Errors
/// See [`TrialError`].
pub fn trial(element: &str, width: u32, height: u32) -> Result<Trial, TrialError> {
    trial_with(element, width, height, 1)
}

/// As [`trial`], with the number of threads of [`EncoderSettings::threads`].
///
/// # Errors
/// See [`TrialError`].
fn trial_with(element: &str, width: u32, height: u32, threads: u32) -> Result<Trial, TrialError> {
    pipeline::init()?;
    PixelFormat::I420.bytes(width, height)?;
    let codec = encoder::element_codec(element).ok_or(TrialError::Missing)?;
    if gstreamer::ElementFactory::find(element).is_none() {
        return Err(TrialError::Missing);
    }
    let (send, receive) = mpsc::sync_channel(1);
    let name = element.to_owned();
    thread::Builder::new()
        .name("video-trial".into())
        .spawn(move || {
            let _ = send.send(run(&name, codec, width, height, threads));
        })
        .map_err(|error| TrialError::Wrong(format!("starting a thread: {error}")))?;
    receive
        .recv_timeout(TRIAL_LIMIT)
        .unwrap_or(Err(TrialError::Hung))
}

/// The encoder for all cameras of a session: the first in order of preference that does at every
/// size what it promises. Hardware, then x264enc, then openh264enc. x265enc has to be named by the
/// user: in software it takes eight times the processor time for a tenth fewer bytes.
///
/// # Errors
/// [`NoEncoder`] with every reason.
pub fn choose(load: &Load) -> Result<Choice, NoEncoder> {
    let mut refused = Vec::new();
    for kind in kinds::KINDS {
        if kind.only_by_name {
            continue;
        }
        match works(kind.element, load) {
            Ok(codec) => {
                return Ok(Choice {
                    element: kind.element.to_owned(),
                    codec,
                    preset: load.preset(),
                    refused,
                });
            }
            Err(reason) => refused.push((kind.element.to_owned(), reason)),
        }
    }
    Err(NoEncoder { refused })
}

/// Tries one encoder at every size of a session; what it produces.
///
/// # Errors
/// See [`TrialError`].
pub fn works(element: &str, load: &Load) -> Result<Codec, TrialError> {
    let codec = encoder::element_codec(element).ok_or(TrialError::Missing)?;
    for (width, height) in load.sizes() {
        trial_with(element, width, height, load.threads)?;
    }
    Ok(codec)
}

/// The encoder that [`choose`] takes for one camera of this size.
///
/// # Errors
/// As for [`choose`].
pub fn best_encoder(width: u32, height: u32) -> Result<Choice, NoEncoder> {
    choose(&Load {
        cameras: vec![(width, height, 30.0)],
        threads: 1,
    })
}

/// The trial itself, on a thread that may be left behind.
fn run(
    element: &str,
    codec: Codec,
    width: u32,
    height: u32,
    threads: u32,
) -> Result<Trial, TrialError> {
    let images: Vec<RawImage> = (0..FRAMES)
        .map(|number| moving(width, height, number))
        .collect::<Result<_, _>>()?;
    // Odd, uneven and far from zero, as CLOCK_MONOTONIC is.
    let times: Vec<i64> = (0..FRAMES as i64)
        .map(|number| 86_400_000_000_007 + number * 33_333_333 + number * number * 1_013)
        .collect();
    let settings = EncoderSettings {
        element: element.to_owned(),
        width,
        height,
        rate_hz: 30.0,
        quality_db: 42.0,
        threads,
        max_key_interval_frames: 1_000,
        preset: Preset::default(),
    };
    let units: Arc<Mutex<Vec<AccessUnit>>> = Arc::default();
    let collecting = units.clone();
    let mut encoder = Encoder::start(
        &settings,
        Box::new(move |event| {
            if let EncoderEvent::AccessUnit(unit) = event {
                lock(&collecting).push(unit);
            }
        }),
    )
    .map_err(TrialError::Encode)?;
    #[expect(
        clippy::disallowed_methods,
        reason = "the speed of this machine is the question"
    )]
    let begin = Instant::now();
    for (number, (image, &time)) in images.iter().zip(&times).enumerate() {
        encoder
            .push(time, image, number == FORCED)
            .map_err(TrialError::Encode)?;
    }
    encoder.finish(TRIAL_LIMIT).map_err(TrialError::Encode)?;
    let elapsed = begin.elapsed().as_secs_f64();
    check(&lock(&units), &times)?;
    Ok(Trial {
        element: element.to_owned(),
        codec,
        frames_per_s: FRAMES as f64 / elapsed.max(1e-6),
    })
}

/// Order, times and parameter sets are watched by the encoder itself; what is left is the number
/// and where the key frames are.
fn check(units: &[AccessUnit], times: &[i64]) -> Result<(), TrialError> {
    let found: Vec<i64> = units.iter().map(|unit| unit.pts_ns).collect();
    if found != times {
        return Err(TrialError::Wrong(format!(
            "times {found:?}, expected {times:?}"
        )));
    }
    let keys: Vec<usize> = (0..units.len())
        .filter(|&number| units[number].key)
        .collect();
    if keys != [0, FORCED] {
        return Err(TrialError::Wrong(format!(
            "key frames at {keys:?}, expected {:?}",
            [0, FORCED]
        )));
    }
    Ok(())
}

/// Blocky texture that moves two pixels per frame.
fn moving(width: u32, height: u32, number: usize) -> Result<RawImage, RawImageError> {
    let mut data = vec![128; PixelFormat::I420.bytes(width, height)?];
    for (y, row) in data
        .chunks_mut(width as usize)
        .take(height as usize)
        .enumerate()
    {
        for (x, luma) in row.iter_mut().enumerate() {
            let x = x + 2 * number;
            let cell = (x / 8 * 2_654_435_761usize) ^ (y / 8).wrapping_mul(40_503);
            let fine = (x * 7 + y * 13) ^ (x * y);
            *luma = (64 + (cell >> 7) % 96 + fine % 32) as u8;
        }
    }
    RawImage::new(width, height, PixelFormat::I420, Bytes::from(data))
}
