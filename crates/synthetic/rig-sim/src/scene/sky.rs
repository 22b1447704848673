//! Background: sky, clouds, the sun.

use super::Lighting;
use super::light::Light;
use crate::camera::raster::View;
use crate::camera::shade::luminance;
use crate::scene::Scene;

/// `1 - cosine` of the sun's angular radius of 0.266°.
const SUN: f32 = 1.08e-5;
/// Solid angle of the sun, sr.
const SUN_SR: f64 = 6.8e-5;
/// `1 - cosine` of the angle at which the glow around the sun is half as bright, some 5°.
const GLOW: f32 = 0.004;

/// A sky: brighter and paler towards the horizon and around the sun, with clouds.
#[derive(Clone, Copy, Debug)]
pub struct Sky {
    /// Linear red, green, blue overhead, relative to white in daylight.
    pub zenith: [f32; 3],
    /// Colours at the horizon and around the sun, as bright as the zenith.
    horizon: [f32; 3],
    warm: [f32; 3],
    /// Brightness of the horizon relative to the zenith, minus one.
    pub rise: f32,
    /// Contrast of clouds.
    pub clouds: f32,
    /// The texture of the clouds.
    pub texture: u16,
    /// Direction to the sun, and its brightness relative to the zenith.
    pub sun: Option<([f32; 3], f32)>,
    /// Brightness beside the sun relative to the zenith.
    glow: f32,
}

/// The same colour with this luminance.
fn bright(color: [f32; 3], luminance_is: f32) -> [f32; 3] {
    let factor = luminance_is / luminance(color);
    color.map(|c| c * factor)
}

impl Sky {
    /// The sky of a lighting, with clouds of a texture.
    pub(super) fn new(lighting: Lighting, light: &Light, texture: u16) -> Self {
        const BLUE: [f32; 3] = [0.55, 0.86, 1.5];
        const HAZE: [f32; 3] = [0.92, 1.0, 1.12];
        const PEACH: [f32; 3] = [1.5, 0.95, 0.55];
        const DUSK: [f32; 3] = [0.65, 0.85, 1.35];
        // The light of towns on clouds.
        const TOWN: [f32; 3] = [1.25, 0.95, 0.7];
        // A uniform sky with an irradiance of 1 is as bright as a white surface. At night surfaces
        // receive light from lamps, directly and reflected, rather than from the sky.
        let (colors, share, rise, clouds, glow) = match lighting {
            Lighting::Day => ([BLUE, HAZE, HAZE], 0.7, 1.2, 0.7, 3.0),
            Lighting::LowSun => ([BLUE, PEACH, PEACH], 0.6, 1.6, 0.7, 12.0),
            Lighting::Night => ([TOWN, TOWN, TOWN], 0.04, 2.0, 0.6, 0.0),
            Lighting::Flicker => ([DUSK, HAZE, HAZE], 0.3, 1.0, 0.6, 0.0),
        };
        let overhead = (share * light.sky) as f32;
        let sun = light.sun.map(|(direction, strength)| {
            let radiance = (strength * std::f64::consts::PI / SUN_SR) as f32;
            (direction.map(|v| v as f32).into(), radiance / overhead)
        });
        let [zenith, horizon, warm] = colors.map(|c| bright(c, overhead));
        Self {
            zenith,
            horizon,
            warm,
            rise,
            clouds,
            texture,
            sun,
            glow,
        }
    }

    /// Brightness relative to the zenith, and a colour as bright as the zenith, in the direction of
    /// a ray.
    #[inline]
    pub(crate) fn seen(&self, view: &View, [x, y]: [f32; 2], scene: &Scene) -> (f32, [f32; 3]) {
        // The transpose maps optical directions to the world.
        let r = &view.rotation;
        let direction = [0, 1, 2].map(|k| r[0][k] * x + r[1][k] * y + r[2][k]);
        let length = (direction[0] * direction[0]
            + direction[1] * direction[1]
            + direction[2] * direction[2])
            .sqrt();
        let direction = direction.map(|v| v / length);
        let up = direction[2].max(0.0);
        let pale = (1.0 - up) * (1.0 - up);
        let pale = pale * pale;
        // A high layer of clouds, which recedes towards the horizon.
        let clouds = &scene.textures[usize::from(self.texture)];
        let scale = 36.0 / (up + 0.15);
        let (cu, cv) = (direction[0] * scale, direction[1] * scale);
        let (soft, _) = clouds.sample(cu, cv, 4);
        let (torn, _) = clouds.sample(4.0 * cu, 4.0 * cv, 2);
        let cloud = (0.75 * soft + 0.25 * torn - 1.0) * self.clouds;
        let mut light = 1.0 + pale * self.rise + 2.0 * cloud.max(-0.2);
        // Clouds are white.
        let mut white = (pale + 2.5 * cloud.max(0.0)).min(1.0);
        let mut warm = 0.0;
        if let Some((sun, strength)) = &self.sun {
            let miss = 1.0 - (0..3).map(|k| sun[k] * direction[k]).sum::<f32>();
            let near = GLOW / (GLOW + miss.max(0.0));
            light += self.glow * near;
            warm = near.sqrt();
            white *= 1.0 - warm;
            if miss < SUN {
                light += strength;
            }
        }
        let blue = (1.0 - white - warm).max(0.0);
        let color = [0, 1, 2]
            .map(|k| blue * self.zenith[k] + white * self.horizon[k] + warm * self.warm[k]);
        (light.max(0.05), color)
    }
}
