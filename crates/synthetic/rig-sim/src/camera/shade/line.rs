//! Shading of a row of pixels.
//!
//! Contract: shading is done in steps, each a branch-free loop over the whole row or over [`LANES`]
//! pixels, so that it is vectorized where possible; only the fetching of texels is scalar. A
//! pixel's result does not depend on its neighbors.

use std::ops::Range;

use super::{Facing, luminance};
use crate::scene::surface::Material;
use crate::scene::texture::{MIX, TONE, TexelQuad, Texture, floor};

/// Scale and angle of the second texture layer, which hides the tiling.
const COARSER: f32 = 0.087;
const COARSER_TURN: (f32, f32) = (0.829, 0.559);

/// Pixels that are processed together: few surfaces are wider.
const LANES: usize = 8;

/// Per-column buffers, with [`LANES`] elements of padding.
pub(super) struct Line {
    /// The rays `(x, y, 1)` and their lengths.
    x: Vec<f32>,
    y: Vec<f32>,
    length: Vec<f32>,
    /// Position on the texture, texels of the finest level.
    u: Vec<f32>,
    v: Vec<f32>,
    /// Texels of the finest level in a pixel.
    footprint: Vec<f32>,
    /// Irradiance of the surface, and after [`Line::reflect`] the reflected light of a white
    /// surface.
    pub(super) light: Vec<f32>,
    /// Fraction of the material's second color.
    pub(super) mix: Vec<f32>,
    /// Luminance of the material, and difference to that of its second color.
    own: Vec<f32>,
    other: Vec<f32>,
    /// Texture and material numbers.
    texture: Vec<u16>,
    pub(super) material: Vec<u16>,
    /// Dither of the mip level.
    dither: Vec<f32>,
    /// The texture, and its scaled and rotated second layer.
    layers: [Layer; 2],
}

/// Texel positions of a texture layer.
struct Layer {
    /// Texel numbers, and after [`Line::fetch`] the texels with their right neighbors.
    top: Vec<u32>,
    bottom: Vec<u32>,
    right: Vec<f32>,
    down: Vec<f32>,
}

impl Line {
    pub(super) fn new(width: usize) -> Self {
        let count = width + LANES;
        let numbers = || vec![0.0; count];
        let layer = || Layer {
            top: vec![0; count],
            bottom: vec![0; count],
            right: numbers(),
            down: numbers(),
        };
        // Steps by the golden ratio: dither below the camera's noise.
        let step = |x: usize| (x as f64 * 0.618_033_988_749_895).fract() as f32;
        Self {
            x: numbers(),
            y: numbers(),
            length: numbers(),
            u: numbers(),
            v: numbers(),
            footprint: numbers(),
            light: numbers(),
            mix: numbers(),
            own: numbers(),
            other: numbers(),
            texture: vec![0; count],
            material: vec![0; count],
            dither: (0..count).map(step).collect(),
            layers: [layer(), layer()],
        }
    }

    /// Starts a row with these rays.
    #[inline(always)]
    pub(super) fn aim(&mut self, rays: &[[f32; 2]]) {
        let count = rays.len();
        let (x, y) = (&mut self.x[..count], &mut self.y[..count]);
        let length = &mut self.length[..count];
        for (i, ray) in rays.iter().enumerate() {
            (x[i], y[i]) = (ray[0], ray[1]);
            length[i] = (1.0 + ray[0] * ray[0] + ray[1] * ray[1]).sqrt();
        }
    }

    /// Intersects the rays of some columns with a surface of material `number`, and computes the
    /// light there. `pixel` is the angle of a pixel. May overwrite columns to the right.
    #[inline(always)]
    pub(super) fn hit(
        &mut self,
        facing: &Facing,
        columns: Range<usize>,
        pixel: f32,
        material: &Material,
        number: u16,
    ) {
        let per_texel = 1.0 / material.texel_m;
        let span = pixel * per_texel;
        let along = facing.u.map(|v| v * per_texel);
        let aside = facing.v.map(|v| v * per_texel);
        let own = luminance(material.albedo);
        let other = luminance(material.other_albedo) - own;
        for from in columns.step_by(LANES) {
            let (x, y) = (lanes(&self.x, from), lanes(&self.y, from));
            let length = lanes(&self.length, from);
            let dot = |g: &[f32], i: usize| g[0] * x[i] + g[1] * y[i] + g[2];
            let mut steep = [0.0; LANES];
            let mut depth = [0.0; LANES];
            for i in 0..LANES {
                steep[i] = 1.0 / dot(&facing.under, i);
                depth[i] = facing.over * steep[i];
            }
            let linear = |g: &[f32; 4]| -> [f32; LANES] {
                std::array::from_fn(|i| g[3] + depth[i] * dot(g, i))
            };
            *lanes_mut(&mut self.u, from) = linear(&along);
            *lanes_mut(&mut self.v, from) = linear(&aside);
            let light = linear(&facing.light);
            *lanes_mut(&mut self.light, from) = light.map(|lit| lit.max(0.0) + material.glow);
            // Texels across a pixel: between the footprints along and across the slant.
            *lanes_mut(&mut self.footprint, from) = std::array::from_fn(|i| {
                let across = depth[i] * span;
                across * across * length[i] * steep[i].abs().min(1e3)
            });
            *lanes_mut(&mut self.own, from) = [own; LANES];
            *lanes_mut(&mut self.other, from) = [other; LANES];
            *lanes_mut(&mut self.texture, from) = [material.texture; LANES];
            *lanes_mut(&mut self.material, from) = [number; LANES];
        }
    }

    /// Columns without a surface: a black one, of material `number`.
    #[inline(always)]
    pub(super) fn miss(&mut self, columns: Range<usize>, number: u16) {
        self.light[columns.clone()].fill(0.0);
        self.texture[columns.clone()].fill(0);
        self.material[columns].fill(number);
    }

    /// Computes texel positions, in mip levels that `shift` (0 to 1) dithers.
    #[inline(always)]
    pub(super) fn select_texels(&mut self, shift: f32) {
        let count = self.u.len();
        let (u, v) = (&self.u[..count], &self.v[..count]);
        let (footprint, dither) = (&self.footprint[..count], &self.dither[..count]);
        let [fine, broad] = &mut self.layers;
        let (mut fine, mut broad) = (fine.slices(count), broad.slices(count));
        for i in 0..count {
            let moved = dither[i] + shift;
            let dither = if moved >= 1.0 { moved - 1.0 } else { moved };
            let level = 0.5 * log2(footprint[i]) + dither - 0.5;
            let level = floor(level.clamp(0.0, 9.0));
            let scale = power_of_half(level);
            let center = 0.5 * scale - 0.5;
            let (u, v) = (u[i], v[i]);
            let place = TexelQuad::new(u * scale + center, v * scale + center, level as u32);
            fine.put(i, place);
            let coarse = (level - 3).max(0);
            let scale = COARSER * power_of_half(coarse);
            let (cu, cv) = (
                u * COARSER_TURN.0 - v * COARSER_TURN.1,
                u * COARSER_TURN.1 + v * COARSER_TURN.0,
            );
            broad.put(i, TexelQuad::new(cu * scale, cv * scale, coarse as u32));
        }
    }

    /// Fetches the texels from the textures of a scene.
    #[inline(always)]
    pub(super) fn fetch(&mut self, textures: &[Texture]) {
        let count = self.texture.len();
        let [fine, broad] = &mut self.layers;
        let (fine, broad) = (fine.slices(count), broad.slices(count));
        for (i, &number) in self.texture.iter().enumerate() {
            let Some(texture) = textures.get(usize::from(number)) else {
                continue;
            };
            for at in [&mut fine.top[i], &mut fine.bottom[i]] {
                *at = texture.pair(*at);
            }
            for at in [&mut broad.top[i], &mut broad.bottom[i]] {
                *at = texture.pair(*at);
            }
        }
    }

    /// Adds the reflected light to `luma`, times `weight`.
    #[inline(always)]
    pub(super) fn reflect(&mut self, luma: &mut [f32], weight: f32) {
        let count = luma.len();
        let (light, mix) = (&mut self.light[..count], &mut self.mix[..count]);
        let (own, other) = (&self.own[..count], &self.other[..count]);
        let [fine, broad] = &mut self.layers;
        let (fine, broad) = (fine.slices(count), broad.slices(count));
        for i in 0..count {
            let tone = fine.blend(i, 0) * TONE;
            let broad = broad.blend(i, 0) * TONE;
            light[i] *= weight * tone * (0.45 + 0.55 * broad);
            mix[i] = fine.blend(i, 8) * MIX;
            luma[i] += light[i] * (own[i] + other[i] * mix[i]);
        }
    }
}

#[inline(always)]
fn lanes(of: &[f32], from: usize) -> &[f32; LANES] {
    of[from..]
        .first_chunk()
        .expect("lines are longer than rows")
}

#[inline(always)]
fn lanes_mut<T>(of: &mut [T], from: usize) -> &mut [T; LANES] {
    of[from..]
        .first_chunk_mut()
        .expect("lines are longer than rows")
}

/// A layer's arrays, all of the same length.
struct Slices<'a> {
    top: &'a mut [u32],
    bottom: &'a mut [u32],
    right: &'a mut [f32],
    down: &'a mut [f32],
}

impl Layer {
    #[inline(always)]
    fn slices(&mut self, count: usize) -> Slices<'_> {
        Slices {
            top: &mut self.top[..count],
            bottom: &mut self.bottom[..count],
            right: &mut self.right[..count],
            down: &mut self.down[..count],
        }
    }
}

impl Slices<'_> {
    #[inline(always)]
    fn put(&mut self, i: usize, place: TexelQuad) {
        self.top[i] = place.top;
        self.bottom[i] = place.bottom;
        self.right[i] = place.right;
        self.down[i] = place.down;
    }

    #[inline(always)]
    fn blend(&self, i: usize, shift: u32) -> f32 {
        let place = TexelQuad {
            top: 0,
            bottom: 0,
            right: self.right[i],
            down: self.down[i],
        };
        place.blend(self.top[i], self.bottom[i], shift)
    }
}

/// 2 to the power of `-level`, for 0 to 126.
#[inline(always)]
fn power_of_half(level: i32) -> f32 {
    f32::from_bits(((127 - level) as u32) << 23)
}

/// Binary logarithm, to 0.01: the exponent and a parabola through the mantissa's ends.
#[inline(always)]
fn log2(x: f32) -> f32 {
    let bits = x.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let m = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000);
    exponent as f32 + (m - 1.0) * (1.0 + 0.34 * (2.0 - m))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn approximate_logarithm_is_within_tolerance() {
        for i in 1..2000 {
            let x = 0.003 * i as f32;
            assert!((log2(x) - x.log2()).abs() < 0.012, "{x}: {}", log2(x));
        }
    }
}
