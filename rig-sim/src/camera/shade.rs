//! The light that each pixel gets.
//!
//! Contract: a pixel's surface is the triangle that the rasteriser found; where on it the pixel's exact
//! ray hits, how far away that is and which texel lies there is computed here, for any lens. All
//! quantities are linear in light; 1 is a level white surface in full daylight.

use crate::camera::raster::{NOTHING, View, Visibility};
use crate::random;
use crate::scene::Scene;
use crate::scene::body::Surface;
use crate::scene::surface::Class;

/// How much larger and at which angle the second layer of a texture lies. It hides the tiling.
const COARSER: f32 = 0.087;
const COARSER_TURN: (f32, f32) = (0.829, 0.559);

/// A picture in linear light.
#[derive(Clone, Debug)]
pub struct Radiance {
    /// Columns, even.
    pub width: usize,
    /// Rows, even.
    pub height: usize,
    /// Luminance of every pixel, rows first.
    pub luminance: Vec<f32>,
    /// Red, green, blue of every second pixel of every second row.
    pub colour: Vec<[f32; 3]>,
}

impl Radiance {
    /// Darkness.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            luminance: vec![0.0; width * height],
            colour: vec![[0.0; 3]; (width / 2) * (height / 2)],
        }
    }

    /// Adds another picture of the same size.
    pub fn add(&mut self, other: &Self) {
        for (to, from) in self.luminance.iter_mut().zip(&other.luminance) {
            *to += from;
        }
        for (to, from) in self.colour.iter_mut().zip(&other.colour) {
            *to = [0, 1, 2].map(|k| to[k] + from[k]);
        }
    }

    /// Darkness again.
    pub fn clear(&mut self) {
        self.luminance.fill(0.0);
        self.colour.fill([0.0; 3]);
    }
}

/// Luminance of linear red, green, blue (Rec. 709).
pub fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// A body as one row of pixels sees it.
pub struct Seen<'a> {
    /// Number of its first triangle.
    pub first: u32,
    /// Its surfaces.
    pub surfaces: &'a [Surface],
    /// One view for all rows or one for each.
    pub views: &'a [View],
}

/// A surface in the optical frame: linear functions of the ray `(x, y, 1)` and of the depth.
struct Facing {
    /// `depth = over / (under · ray)`.
    under: [f32; 3],
    over: f32,
    u: [f32; 4],
    v: [f32; 4],
    light: [f32; 4],
}

impl Facing {
    #[inline]
    fn new(surface: &Surface, view: &View) -> Self {
        let o = view.origin;
        let dot = |g: &[f32]| g[0] * o[0] + g[1] * o[1] + g[2] * o[2];
        let linear = |f: &[f32; 4]| {
            let [x, y, z] = view.turn([f[0], f[1], f[2]]);
            [x, y, z, f[3] + dot(f)]
        };
        Self {
            under: view.turn(surface.normal),
            over: surface.offset - dot(&surface.normal),
            u: linear(&surface.u),
            v: linear(&surface.v),
            light: linear(&surface.light),
        }
    }
}

/// Which body a triangle belongs to.
pub fn body_of(bodies: &[Seen<'_>], triangle: u32) -> usize {
    bodies.partition_point(|b| b.first <= triangle) - 1
}

/// Adds what the pixels see, times `weight`. `rays` are the pixels' directions, `noise` chooses
/// among mip levels.
pub fn add(
    radiance: &mut Radiance,
    scene: &Scene,
    visibility: &Visibility,
    bodies: &[Seen<'_>],
    rays: &[[f32; 2]],
    weight: f32,
    noise: u64,
) {
    let width = visibility.width;
    // Angle of a pixel at the middle of the picture.
    let middle = (visibility.height / 2) * width + width / 2;
    let pixel = rays[middle + 1][0] - rays[middle][0];
    let sky_luma = luminance(scene.sky.zenith);
    for row in 0..visibility.height {
        let start = row * width;
        let ids = &visibility.triangle[start..start + width];
        let rays = &rays[start..start + width];
        let luma = &mut radiance.luminance[start..start + width];
        let mut colour = (row % 2 == 0).then(|| {
            let half = width / 2;
            &mut radiance.colour[row / 2 * half..(row / 2 + 1) * half]
        });
        // One random number per row and a step by the golden ratio along it: dither that a camera's
        // noise hides.
        let mut dither = random::uniform(noise, 0, row as u64) as f32;
        let mut x = 0;
        while x < width {
            let id = ids[x];
            let mut end = x + 1;
            while end < width && ids[end] == id {
                end += 1;
            }
            if id == NOTHING {
                let view = &bodies[0].views[row.min(bodies[0].views.len() - 1)];
                for i in x..end {
                    let (light, tint) = scene.sky.seen(view, rays[i], scene);
                    luma[i] += weight * light * sky_luma;
                    if i % 2 == 0
                        && let Some(colour) = &mut colour
                    {
                        let to = &mut colour[i / 2];
                        for k in 0..3 {
                            to[k] += weight * light * tint[k];
                        }
                    }
                }
                x = end;
                continue;
            }
            let body = &bodies[body_of(bodies, id)];
            let view = &body.views[row.min(body.views.len() - 1)];
            let surface = &body.surfaces[(id - body.first) as usize];
            let facing = Facing::new(surface, view);
            let material = &scene.materials[surface.material as usize];
            let texture = &scene.textures[material.texture as usize];
            let own = luminance(material.albedo);
            let other = luminance(material.other_albedo);
            let per_texel = 1.0 / material.texel_m;
            let level_offset = pixel * per_texel;
            for i in x..end {
                let [rx, ry] = rays[i];
                let dot = |g: &[f32]| g[0] * rx + g[1] * ry + g[2];
                let cosine = dot(&facing.under);
                let depth = facing.over / cosine;
                let u = (facing.u[3] + depth * dot(&facing.u)) * per_texel;
                let v = (facing.v[3] + depth * dot(&facing.v)) * per_texel;
                let light = facing.light[3] + depth * dot(&facing.light);
                // Texels across a pixel: between those along and across the slant.
                let square = 1.0 + rx * rx + ry * ry;
                let span = depth * level_offset;
                let footprint = span * span * square.sqrt() / cosine.abs().max(1e-3);
                dither += 0.618_034;
                dither -= dither as i32 as f32;
                let level = (0.5 * log2(footprint) + dither - 0.5).clamp(0.0, 9.0);
                let level = level as u32;
                let scale = 1.0 / (1_u32 << level) as f32;
                let (tone, mix) = texture.sample(
                    u * scale - 0.5 + 0.5 * scale,
                    v * scale - 0.5 + 0.5 * scale,
                    level,
                );
                let coarse = level.saturating_sub(3);
                let scale = COARSER / (1_u32 << coarse) as f32;
                let (cu, cv) = (
                    u * COARSER_TURN.0 - v * COARSER_TURN.1,
                    u * COARSER_TURN.1 + v * COARSER_TURN.0,
                );
                let (broad, _) = texture.sample(cu * scale, cv * scale, coarse);
                let light =
                    weight * (light.max(0.0) + material.glow) * tone * (0.45 + 0.55 * broad);
                luma[i] += light * (own + (other - own) * mix);
                if i % 2 == 0
                    && let Some(colour) = &mut colour
                {
                    let to = &mut colour[i / 2];
                    for (k, to) in to.iter_mut().enumerate() {
                        let albedo = material.albedo[k];
                        *to += light
                            * (albedo + (material.other_albedo[k] - albedo) * mix)
                            * scene.light.tint[k];
                    }
                }
            }
            x = end;
        }
    }
}

/// Binary logarithm, to 0.01: the exponent and a parabola through the mantissa's ends.
#[inline]
fn log2(x: f32) -> f32 {
    let bits = x.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let m = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000);
    exponent as f32 + (m - 1.0) * (1.0 + 0.34 * (2.0 - m))
}

/// What a pixel's surface is.
pub fn class(scene: &Scene, surface: &Surface) -> Class {
    scene.materials[surface.material as usize].class
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_short_logarithm_is_close() {
        for i in 1..2000 {
            let x = 0.003 * i as f32;
            assert!((log2(x) - x.log2()).abs() < 0.012, "{x}: {}", log2(x));
        }
    }
}
