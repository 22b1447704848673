//! One encoder at one quality on one clip.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};
use video::raw_image::psnr;
use video::{AccessUnit, Decoder, Encoder, EncoderEvent, EncoderSettings};

use super::material::Clip;
use crate::meter::{Timing, median, timed};

/// Maximum time of an encoder for a clip.
const ENCODER_TIMEOUT: Duration = Duration::from_secs(120);

/// Result.
pub(super) struct Point {
    pub(super) element: &'static str,
    pub(super) clip: &'static str,
    pub(super) target_db: f64,
    quantiser: u32,
    /// Luma, mean over the frames.
    pub(super) psnr_db: f64,
    /// Luma, worst frame.
    pub(super) psnr_min_db: f64,
    /// At the clip's nominal rate.
    pub(super) mbit_s: f64,
    /// Processor time of a further frame, all threads.
    pub(super) cpu_ms: f64,
    /// Further frames per second, by wall time.
    frames_per_s: f64,
}

impl Point {
    pub(super) const HEADING: &'static str =
        "encoder      clip       target QP   PSNR mean    min   Mbit/s  CPU ms    frames/s";

    pub(super) fn json(&self) -> Value {
        json!({
            "element": self.element,
            "clip": self.clip,
            "target_db": self.target_db,
            "quantiser": self.quantiser,
            "psnr_mean_db": round(self.psnr_db),
            "psnr_min_db": round(self.psnr_min_db),
            "target_met": self.psnr_db >= self.target_db,
            "mbit_per_s": round(self.mbit_s),
            "cpu_ms_per_frame": round(self.cpu_ms),
            "frames_per_s": round(self.frames_per_s),
        })
    }
}

/// Thousandths are below repeatability.
pub(super) fn round(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}

impl fmt::Display for Point {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:12} {:10} {:6.1} {:2} {:11.2} {:6.2} {:8.2} {:7.2} {:11.1}",
            self.element,
            self.clip,
            self.target_db,
            self.quantiser,
            self.psnr_db,
            self.psnr_min_db,
            self.mbit_s,
            self.cpu_ms,
            self.frames_per_s
        )
    }
}

/// Encodes the clip `repetitions` times, once and twice over, decodes it and compares. Times are
/// medians of what the second time over adds.
pub(super) fn measure(
    element: &'static str,
    clip: &Clip,
    target_db: f64,
    repetitions: usize,
) -> Result<Point> {
    let (mut encoded, mut added) = (None, Vec::new());
    for _ in 0..repetitions {
        let (once, short) = timed(|| encode(element, clip, target_db, 1));
        let (twice, long) = timed(|| encode(element, clip, target_db, 2));
        (encoded, _) = (Some(once?), twice?);
        added.push(Timing {
            wall_s: long.wall_s - short.wall_s,
            cpu_s: long.cpu_s - short.cpu_s,
        });
    }
    let (quantiser, units) = encoded.context("no repetitions")?;
    let codec = video::encoder::element_codec(element).context("an encoder without a codec")?;
    let decoded = Decoder::with_threads(codec, 0).decode(&units)?;
    ensure!(
        decoded.len() == clip.images.len(),
        "{} of {} frames were decoded",
        decoded.len(),
        clip.images.len()
    );
    let each: Vec<f64> = clip
        .images
        .iter()
        .zip(&decoded)
        .map(|(before, (_, after))| psnr(before, after))
        .collect();
    let count = clip.images.len() as f64;
    let bytes: usize = units.iter().map(|unit| unit.data.len()).sum();
    Ok(Point {
        element,
        clip: clip.name,
        target_db,
        quantiser,
        psnr_db: each.iter().sum::<f64>() / count,
        psnr_min_db: each.iter().copied().fold(f64::INFINITY, f64::min),
        mbit_s: bytes as f64 * 8.0 / 1e6 / count * clip.rate_hz,
        cpu_ms: median(added.iter().map(|took| took.cpu_s)) * 1e3 / count,
        frames_per_s: count / median(added.iter().map(|took| took.wall_s)),
    })
}

/// `passes` passes over a clip, from starting the encoder to its end; the quantizer and the video.
fn encode(
    element: &str,
    clip: &Clip,
    quality_db: f64,
    passes: usize,
) -> Result<(u32, Vec<AccessUnit>)> {
    let first = &clip.images[0];
    let settings = EncoderSettings {
        element: element.to_owned(),
        width: first.width,
        height: first.height,
        rate_hz: clip.rate_hz,
        quality_db,
        threads: 1,
        max_key_interval_frames: 1000,
        preset: video::encoder::Preset::default(),
    };
    let output: Arc<Mutex<(Vec<AccessUnit>, Option<String>)>> = Arc::default();
    let collecting = output.clone();
    let on_output = move |event| {
        let mut output = collecting.lock().unwrap_or_else(PoisonError::into_inner);
        match event {
            EncoderEvent::AccessUnit(unit) => output.0.push(unit),
            EncoderEvent::Failed(reason) => output.1 = Some(reason),
        }
    };
    let mut encoder = Encoder::start(&settings, Box::new(on_output))?;
    let quantiser = encoder.quantiser();
    let period_ns = (1e9 / clip.rate_hz) as i64;
    let mut half_second = -1;
    let images = (0..passes).flat_map(|_| &clip.images);
    for (image, time_ns) in images.zip((0..).map(|n| n * period_ns)) {
        let key = time_ns / 500_000_000 > half_second;
        half_second = time_ns / 500_000_000;
        encoder.push(time_ns, image, key)?;
    }
    encoder.finish(ENCODER_TIMEOUT)?;
    let mut output = output.lock().unwrap_or_else(PoisonError::into_inner);
    let (units, failure) = std::mem::take(&mut *output);
    ensure!(failure.is_none(), "the encoder failed: {failure:?}");
    Ok((quantiser, units))
}
