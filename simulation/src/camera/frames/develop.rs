//! From images of a scene to 8 bits and depth in the memory of a batch.

use splats::{Exposure, Image};

use super::{CameraConfig, FrameRequest};
use crate::camera::exposure::{SCENE_GAMMA, ToneCurve, quantized, scene_exposure};
use crate::camera::noise::NoiseConfig;
use crate::camera::sensor::DepthKind;
use crate::camera::{ExposureConfig, ShutterConfig, VariationConfig};
use crate::error::SimulationError;
use crate::randomness::{RandomStream, Stream};

/// Memory of one frame of a batch.
pub(super) struct Slot<'a> {
    pub(super) rgb: &'a mut [u8],
    pub(super) depth_m: &'a mut [f32],
    pub(super) has_depth: &'a mut [bool],
}

/// Accumulated alpha from which a pixel shows a surface.
const MIN_ALPHA: f32 = 0.5;

/// Exposure, motion blur, noise, quantization, and the depth that was chosen.
pub(super) struct Developer {
    exposure: ExposureConfig,
    variation: VariationConfig,
    noise: NoiseConfig,
    shutter: ShutterConfig,
    depth: DepthKind,
    far_m: f32,
    /// Present where colors go through linear light.
    curve: Option<ToneCurve>,
}

impl Developer {
    pub(super) fn new(config: &CameraConfig) -> Self {
        let is_linear = config.noise.is_none()
            && config.shutter.blur_poses == 1
            && config.exposure.gamma == SCENE_GAMMA;
        Self {
            exposure: config.exposure,
            variation: config.variation,
            noise: config.noise,
            shutter: config.shutter,
            depth: config.depth,
            far_m: config.far_m,
            curve: (!is_linear).then(|| ToneCurve::new(config.exposure.gamma)),
        }
    }

    /// Times of the images of a frame against that of its request, s.
    pub(super) fn times_s(&self) -> impl Iterator<Item = f64> {
        let poses = self.shutter.blur_poses;
        (0..poses).map(move |pose| self.shutter.blur_time_s(pose))
    }

    /// Renders and writes a frame. `image` renders at a time against that of the request, s.
    pub(super) fn develop(
        &self,
        request: &FrameRequest,
        image: impl Fn(f64, &Exposure) -> Result<Image, SimulationError>,
        mut slot: Slot<'_>,
    ) -> Result<(), SimulationError> {
        let key = request.noise;
        let varied = self.variation.gain_of(key.seed, key.episode, key.camera);
        let gains = self.exposure.gains(request.gain * varied);
        let Some(curve) = &self.curve else {
            let image = image(0.0, &scene_exposure(gains))?;
            self.write_depth(&image, &mut slot);
            let [r, g, b] = &image.rgb;
            let colors = r.iter().zip(g).zip(b);
            for (pixel, ((r, g), b)) in slot.rgb.as_chunks_mut::<3>().0.iter_mut().zip(colors) {
                *pixel = [*r, *g, *b].map(quantized);
            }
            return Ok(());
        };
        let light = self.light(curve, image, &mut slot)?;
        let stream = RandomStream::new(key.seed, key.episode, Stream::Noise);
        let first = (key.frame << 40) | (u64::from(key.camera) << 32);
        for (channel, plane) in light.iter().enumerate() {
            let gain = gains[channel] as f32;
            let noise = self.noise.of_channel(gains[channel]);
            for (pixel, light) in plane.iter().enumerate() {
                let mut light = gain * light;
                if !self.noise.is_none() {
                    light = noise.add(light, &stream, first | (3 * pixel + channel) as u64);
                }
                slot.rgb[3 * pixel + channel] = curve.value(light);
            }
        }
        Ok(())
    }

    /// Mean linear light over the exposure. Writes the depth of its middle.
    fn light(
        &self,
        curve: &ToneCurve,
        image: impl Fn(f64, &Exposure) -> Result<Image, SimulationError>,
        slot: &mut Slot<'_>,
    ) -> Result<[Vec<f32>; 3], SimulationError> {
        let poses = self.shutter.blur_poses;
        let share = 1.0 / poses as f32;
        let mut light: Option<[Vec<f32>; 3]> = None;
        for pose in 0..poses {
            let is_middle = 2 * pose + 1 == poses;
            let time_s = match is_middle {
                true => 0.0,
                false => self.shutter.blur_time_s(pose),
            };
            let mut image = image(time_s, &Exposure::NONE)?;
            if is_middle {
                self.write_depth(&image, slot);
            }
            for value in image.rgb.iter_mut().flatten() {
                *value = share * curve.light(*value);
            }
            match &mut light {
                None => light = Some(image.rgb),
                Some(sum) => {
                    let values = sum.iter_mut().flatten();
                    for (sum, value) in values.zip(image.rgb.iter().flatten()) {
                        *sum += value;
                    }
                }
            }
        }
        Ok(light.unwrap_or_default())
    }

    fn write_depth(&self, image: &Image, slot: &mut Slot<'_>) {
        let depths = match self.depth {
            DepthKind::Median => &image.median_depth_m,
            DepthKind::Expected => &image.expected_depth_m,
        };
        let into = slot.depth_m.iter_mut().zip(slot.has_depth.iter_mut());
        let from = depths.iter().zip(&image.alpha);
        for ((depth_m, has_depth), (found, alpha)) in into.zip(from) {
            // Not for NaN.
            *has_depth = *alpha >= MIN_ALPHA && *found < self.far_m;
            *depth_m = if *has_depth { *found } else { self.far_m };
        }
    }
}
