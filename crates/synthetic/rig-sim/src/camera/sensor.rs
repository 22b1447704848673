//! Image sensor: from light to pixel values.
//!
//! Shot noise and read noise are added, gain multiplies both, and a tone curve quantizes the result
//! to eight bits. Noise is a function of seed, frame and pixel only.

use std::ops::Range;

use crate::camera::shade::Radiance;
use crate::random;

/// Entries of the table of normal random numbers; rows start at random positions in it.
const NORMALS: usize = 1 << 15;
/// Steps of the tone curve's table.
const TONES: usize = 4096;

/// Parameters of an image sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorModel {
    /// Electrons per ms of a white surface in daylight.
    pub electrons_per_ms: f32,
    /// Full-well capacity at unit gain, electrons.
    pub full_well: f32,
    /// Read noise, electrons.
    pub read_noise: f32,
    /// Vignetting: the part of the cos⁴ falloff that is applied.
    pub vignetting: f32,
    /// Response nonuniformity of pixels, and of the two sensors of a camera: standard deviation,
    /// relative.
    pub uneven: f32,
    /// Seed of the nonuniformity.
    pub seed: u64,
    /// No noise and uniform response: for ground truth.
    pub noiseless: bool,
    /// Factor on the noise; 1 is nominal.
    pub noise: f32,
    /// Tone curve.
    pub tone: Tone,
}

/// Tone curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// The sRGB curve, as cameras deliver it.
    Srgb,
    /// Linear.
    Linear,
}

impl SensorModel {
    /// A small global-shutter sensor of the AR0234's kind: 10 ke- wells, 3 e- read noise.
    pub const SMALL: Self = Self {
        electrons_per_ms: 9000.0,
        full_well: 10_000.0,
        read_noise: 3.0,
        vignetting: 0.7,
        uneven: 0.01,
        seed: 0,
        noiseless: false,
        noise: 1.0,
        tone: Tone::Srgb,
    };
}

/// Exposure of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// Exposure time, s.
    pub seconds: f64,
    /// Gain, 1 or more; less with an iris.
    pub gain: f64,
}

/// Sensor of one eye.
#[derive(Clone, Debug)]
pub struct Sensor {
    model: SensorModel,
    /// Fraction of the light that reaches each pixel.
    falloff: Vec<f32>,
    normals: Vec<f32>,
    tones: Vec<u8>,
}

impl Sensor {
    /// A sensor whose pixels have these rays.
    pub fn new(model: SensorModel, rays: &[[f32; 2]]) -> Self {
        let uneven = if model.noiseless { 0.0 } else { model.uneven };
        let differs = |k: u64, i: u64| {
            let draw = random::bell(model.seed, random::SENSOR + 4 + k, i);
            1.0 + uneven * draw as f32
        };
        let of_all = differs(0, 0);
        let falloff = |(&[x, y], i): (&[f32; 2], u64)| {
            let cosine2 = 1.0 / (1.0 + x * x + y * y);
            let kept = 1.0 - model.vignetting * (1.0 - cosine2 * cosine2);
            kept * of_all * differs(1, i)
        };
        // The sRGB curve, IEC 61966-2-1.
        let tone = |i: usize| {
            let v = i as f64 / (TONES - 1) as f64;
            let s = match v <= 0.003_130_8 {
                _ if model.tone == Tone::Linear => v,
                true => 12.92 * v,
                false => 1.055 * libm::pow(v, 1.0 / 2.4) - 0.055,
            };
            (255.0 * s + 0.5) as u8
        };
        let normal = |i: usize| {
            let draw = |k| random::uniform(0, random::SENSOR + k, i as u64);
            // Box and Muller 1958.
            let radius = (-2.0 * libm::log(draw(0))).sqrt();
            (radius * libm::cos(2.0 * std::f64::consts::PI * draw(1))) as f32
        };
        Self {
            model,
            falloff: rays.iter().zip(0..).map(falloff).collect(),
            normals: (0..NORMALS).map(normal).collect(),
            tones: (0..TONES).map(tone).collect(),
        }
    }

    /// Writes luma of every pixel to `luma` (rows of `stride`), and Cb, Cr of every second pixel of
    /// every second row to `chroma` (rows of `stride / 2`), full range BT.601. `noise` is different
    /// for every image. Returns the mean of the exposed light, 1 being full scale.
    pub fn develop(
        &self,
        light: &Radiance,
        exposure: &Exposure,
        noise: u64,
        luma: &mut [u8],
        chroma: [&mut [u8]; 2],
        stride: usize,
    ) -> f64 {
        let model = &self.model;
        let (width, half) = (light.width, light.width / 2);
        let electrons = model.electrons_per_ms * (exposure.seconds * 1e3) as f32;
        let full = model.full_well / exposure.gain as f32;
        let to_tone = (TONES - 1) as f32 / full;
        let read2 = model.read_noise * model.read_noise;
        let silent = if model.noiseless { 0.0 } else { model.noise };
        let mut sum = 0.0;
        for row in 0..light.height {
            let start = row * width;
            let skip = random::bits(noise, random::SENSOR + 2, row as u64) as usize;
            let skip = skip % (NORMALS - width);
            let normals = &self.normals[skip..skip + width];
            let pixels = light.luminance[start..start + width]
                .iter()
                .zip(&self.falloff[start..start + width]);
            let out = &mut luma[row * stride..row * stride + width];
            let mut row_sum = 0.0_f32;
            for ((out, (light, falloff)), normal) in out.iter_mut().zip(pixels).zip(normals) {
                let e = light * falloff * electrons;
                row_sum += e.min(full);
                let noisy = e + silent * normal * (e + read2).sqrt();
                let tone = (noisy * to_tone).clamp(0.0, (TONES - 1) as f32);
                *out = self.tones[tone as usize];
            }
            sum += f64::from(row_sum);
        }
        let [cb, cr] = chroma;
        for row in 0..light.height / 2 {
            for x in 0..half {
                let color = light.color[row * half + x];
                let factor = self.falloff[2 * row * width + 2 * x] * electrons * to_tone;
                let tone = |v: f32| {
                    let i = (v * factor).clamp(0.0, (TONES - 1) as f32);
                    f32::from(self.tones[i as usize])
                };
                let [r, g, b] = color.map(tone);
                let y = 0.299 * r + 0.587 * g + 0.114 * b;
                let to = row * (stride / 2) + x;
                cb[to] = (128.5 + 0.564 * (b - y)).clamp(0.0, 255.0) as u8;
                cr[to] = (128.5 + 0.713 * (r - y)).clamp(0.0, 255.0) as u8;
            }
        }
        sum / f64::from(full) / (width * light.height) as f64
    }
}

/// Red, green, blue of some columns of an I420 image, rows first.
pub(crate) fn rgb_of(
    i420: &[u8],
    [width, height]: [usize; 2],
    columns: Range<usize>,
) -> Vec<[u8; 3]> {
    let (luma, chroma) = i420.split_at(width * height);
    let (cb, cr) = chroma.split_at(width * height / 4);
    let pixel = |x: usize, y: usize| {
        let c = y / 2 * (width / 2) + x / 2;
        let luma = f32::from(luma[y * width + x]);
        let (b, r) = (f32::from(cb[c]) - 128.0, f32::from(cr[c]) - 128.0);
        // The inverse of what `Sensor::develop` does (BT.601).
        [
            luma + 1.402 * r,
            luma - 0.344 * b - 0.714 * r,
            luma + 1.772 * b,
        ]
        .map(|v| (v + 0.5).clamp(0.0, 255.0) as u8)
    };
    (0..height)
        .flat_map(|y| columns.clone().map(move |x| (x, y)))
        .map(|(x, y)| pixel(x, y))
        .collect()
}

/// Automatic exposure: adapts slowly to the last image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AutoExposure {
    /// Exposure time times gain, s.
    product: f64,
    /// Maximum exposure time, s.
    max_s: f64,
    /// Fixed exposure time, s.
    fixed_s: Option<f64>,
}

/// Target mean of the exposed light, 1 being full scale.
const TARGET_MEAN: f64 = 0.18;
/// Fraction of the log error that is corrected per frame.
const ADAPTATION_RATE: f64 = 0.25;
const MIN_EXPOSURE_S: f64 = 2e-5;
const MAX_GAIN: f64 = 16.0;

impl AutoExposure {
    /// Starts with an exposure for daylight.
    pub(crate) fn new(max_s: f64) -> Self {
        Self {
            product: 4e-4,
            max_s,
            fixed_s: None,
        }
    }

    /// Fixes the exposure time, s; if that is too long for the light, an iris reduces the gain
    /// below 1.
    #[must_use]
    pub(crate) fn fixed(self, seconds: Option<f64>) -> Self {
        Self {
            fixed_s: seconds,
            ..self
        }
    }

    /// Exposure of the next frame: the time is maximized before the gain.
    pub(crate) fn exposure(&self) -> Exposure {
        if let Some(seconds) = self.fixed_s {
            let gain = (self.product / seconds).min(MAX_GAIN);
            return Exposure { seconds, gain };
        }
        let seconds = self.product.clamp(MIN_EXPOSURE_S, self.max_s);
        Exposure {
            seconds,
            gain: (self.product / seconds).clamp(1.0, MAX_GAIN),
        }
    }

    /// Adapts to the mean of an image.
    pub(crate) fn learn(&mut self, mean: f64) {
        let factor = (TARGET_MEAN / mean.max(1e-3)).clamp(0.2, 5.0);
        let most = self.fixed_s.unwrap_or(self.max_s) * MAX_GAIN;
        self.product =
            (self.product * libm::pow(factor, ADAPTATION_RATE)).clamp(MIN_EXPOSURE_S, most);
    }
}
