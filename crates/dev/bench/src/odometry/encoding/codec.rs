//! Images through an encoder and a decoder.

use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use harness::sequences::OwnedFrameSet;
use serde::Serialize;
use video::raw_image::psnr;
use video::{AccessUnit, Decoder, Encoder, EncoderEvent, EncoderSettings, RawImage};

use super::material::{Material, view};
use crate::meter::{children_cpu_s, timed};

/// The element that the daemon uses on this machine, and its speed preset.
pub(super) const DAEMONS: &str = "x264enc";
const DAEMONS_PRESET: &str = "ultrafast";
/// Maximum time of an encoder for the images of a camera.
const ENCODER_TIMEOUT: Duration = Duration::from_secs(600);
/// Frames from one key frame to the next, at 15 Hz: half a second, rounded up.
const KEY_INTERVAL: usize = 8;

/// How to encode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Encoding {
    pub(super) element: &'static str,
    /// Another speed preset than the daemon's.
    pub(super) preset: Option<&'static str>,
    /// Quality target, dB. With another preset: the quantizer that the daemon's would have.
    pub(super) target_db: f64,
}

impl Encoding {
    pub(super) fn name(&self) -> String {
        match (self.element, self.preset) {
            (DAEMONS, None) => format!("{DAEMONS} {DAEMONS_PRESET}"),
            (element, None) => element.to_owned(),
            (element, Some(preset)) => format!("{element} {preset}"),
        }
    }
}

/// Result and cost of encoding.
#[derive(Clone, Debug, Serialize)]
pub(super) struct EncodingResult {
    /// Of all cameras together.
    pub(super) mbit_s: f64,
    pub(super) quantiser: u32,
    /// Luma, mean over all frames.
    pub(super) psnr_db: f64,
    /// Processor time of a stereo frame, ms. Through `gst-launch-1.0` it includes reading the
    /// images.
    pub(super) cpu_ms: f64,
}

/// Encodes and decodes all images; returns them by set.
///
/// # Errors
/// An encoder or decoder fails.
pub(super) fn pass(
    material: &Material,
    encoding: &Encoding,
) -> Result<(Vec<OwnedFrameSet>, EncodingResult)> {
    let mut sets = material.empty();
    let (mut bytes, mut cpu_s, mut psnr_sum, mut quantiser) = (0, 0.0, 0.0, 0);
    for path in &material.files {
        let camera = match encoding.preset {
            None => by_daemon(material, path, encoding)?,
            Some(preset) => by_launch(material, path, encoding, preset)?,
        };
        let (found, expected) = (camera.images.len(), material.times.len());
        ensure!(
            found == expected,
            "{found} frames were decoded, expected {expected}"
        );
        bytes += camera.bytes;
        cpu_s += camera.cpu_s;
        quantiser = camera.quantiser;
        let before = material.images(path)?;
        for ((set, after), before) in sets.iter_mut().zip(camera.images).zip(before) {
            psnr_sum += psnr(&before?, &after);
            set.views.push(Some(view(&after, set.time_ns)));
        }
    }
    let count = (material.times.len() * material.files.len()) as f64;
    let seconds = material.times.len() as f64 / material.rate_hz;
    let result = EncodingResult {
        mbit_s: bytes as f64 * 8e-6 / seconds,
        quantiser,
        psnr_db: psnr_sum / count,
        cpu_ms: 1e3 * cpu_s / count,
    };
    Ok((sets, result))
}

/// One camera.
struct Camera {
    images: Vec<RawImage>,
    bytes: usize,
    cpu_s: f64,
    quantiser: u32,
}

fn settings(material: &Material, encoding: &Encoding) -> EncoderSettings {
    EncoderSettings {
        element: encoding.element.to_owned(),
        width: material.width,
        height: material.height,
        rate_hz: material.rate_hz,
        quality_db: encoding.target_db,
        threads: 1,
        max_key_interval_frames: 1000,
        preset: video::encoder::Preset::default(),
    }
}

fn by_daemon(material: &Material, path: &Path, encoding: &Encoding) -> Result<Camera> {
    let output: Arc<Mutex<(Vec<AccessUnit>, Option<String>)>> = Arc::default();
    let collecting = output.clone();
    let on_output = move |event| {
        let mut output = collecting.lock().unwrap_or_else(PoisonError::into_inner);
        match event {
            EncoderEvent::AccessUnit(unit) => output.0.push(unit),
            EncoderEvent::Failed(reason) => output.1 = Some(reason),
        }
    };
    let images: Vec<RawImage> = material.images(path)?.collect::<Result<_>>()?;
    let mut encoder = Encoder::start(&settings(material, encoding), Box::new(on_output))?;
    let (quantiser, codec) = (encoder.quantiser(), encoder.codec());
    let (encoded, took) = timed(|| -> Result<()> {
        for (k, (time_ns, image)) in material.times.iter().zip(&images).enumerate() {
            encoder.push(*time_ns, image, k.is_multiple_of(KEY_INTERVAL))?;
        }
        Ok(encoder.finish(ENCODER_TIMEOUT)?)
    });
    encoded?;
    let mut output = output.lock().unwrap_or_else(PoisonError::into_inner);
    let (units, failure) = std::mem::take(&mut *output);
    ensure!(failure.is_none(), "the encoder failed: {failure:?}");
    let decoded = Decoder::with_threads(codec, 0).decode(&units)?;
    Ok(Camera {
        images: decoded.into_iter().map(|(_, image)| image).collect(),
        bytes: units.iter().map(|unit| unit.data.len()).sum(),
        cpu_s: took.cpu_s,
        quantiser,
    })
}

/// The daemon's element with its properties but for the speed preset.
fn by_launch(
    material: &Material,
    path: &Path,
    encoding: &Encoding,
    preset: &str,
) -> Result<Camera> {
    let probe = Encoder::start(&settings(material, encoding), Box::new(drop))?;
    let quantiser = probe.quantiser();
    drop(probe);
    let folder = tempfile::tempdir().context("making a folder for video")?;
    let (video, raw) = (folder.path().join("video.h264"), folder.path().join("raw"));
    let source = |path: &Path| format!("location={}", path.display());
    let (width, height) = (material.width, material.height);
    let rate = material.rate_hz;
    let encode = format!(
        "filesrc {} ! rawvideoparse format=i420 width={width} height={height} framerate={rate}/1 \
         ! {} speed-preset={preset} tune=zerolatency pass=quant quantizer={quantiser} ip-factor=1.0 \
         key-int-max={KEY_INTERVAL} bframes=0 threads=1 sliced-threads=false aud=false \
         option-string=scenecut=0:open-gop=0 ! video/x-h264,stream-format=byte-stream ! filesink {}",
        source(path),
        encoding.element,
        source(&video)
    );
    let before = children_cpu_s()?;
    launch(&encode)?;
    let cpu_s = children_cpu_s()? - before;
    let decode = format!(
        "filesrc {} ! h264parse ! avdec_h264 ! video/x-raw,format=I420 ! filesink {}",
        source(&video),
        source(&raw)
    );
    launch(&decode)?;
    Ok(Camera {
        images: material.images(&raw)?.collect::<Result<_>>()?,
        bytes: std::fs::metadata(&video)?.len() as usize,
        cpu_s,
        quantiser,
    })
}

fn launch(pipeline: &str) -> Result<()> {
    let output = Command::new("gst-launch-1.0")
        .arg("-q")
        .args(pipeline.split_whitespace())
        .output()
        .context("starting gst-launch-1.0")?;
    ensure!(
        output.status.success(),
        "gst-launch-1.0 {pipeline} ended with {}: {}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    Ok(())
}
