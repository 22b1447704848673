//! A row of pixels at work.
//!
//! Contract: what a pixel sees is found in steps, each a plain loop without branches over the row or
//! over the pixels of one triangle, so that it becomes vector code wherever there is any; only the
//! fetching of texels goes pixel by pixel. A pixel's result does not depend on its neighbours.

use std::ops::Range;

use super::Facing;
use crate::scene::surface::Material;
use crate::scene::texture::{MIX, Place, TONE, Texture, floor};

/// How much larger and at which angle the second layer of a texture lies. It hides the tiling.
const COARSER: f32 = 0.087;
const COARSER_TURN: (f32, f32) = (0.829, 0.559);

/// One number per column of everything. Where nothing was hit, numbers are of no meaning.
pub(super) struct Line {
    /// Position on the texture, texels of the finest level.
    u: Vec<f32>,
    v: Vec<f32>,
    /// Texels of the finest level in a pixel.
    footprint: Vec<f32>,
    /// What lights the surface, and from [`Line::reflect`] on what a white one throws back.
    pub(super) light: Vec<f32>,
    /// Share of the material's second colour.
    pub(super) mix: Vec<f32>,
    /// Moves each pixel's mip level.
    dither: Vec<f32>,
    /// The texture as it is, and larger and turned.
    layers: [Layer; 2],
}

/// Where a layer of the texture is looked at.
struct Layer {
    /// Numbers of texels, and from [`Line::fetch`] on the texels with their right neighbours.
    top: Vec<u32>,
    bottom: Vec<u32>,
    right: Vec<f32>,
    down: Vec<f32>,
}

impl Line {
    pub(super) fn new(width: usize) -> Self {
        let numbers = || vec![0.0; width];
        let layer = || Layer {
            top: vec![0; width],
            bottom: vec![0; width],
            right: numbers(),
            down: numbers(),
        };
        // Steps by the golden ratio: dither that a camera's noise hides.
        let step = |x: usize| (x as f64 * 0.618_033_988_749_895).fract() as f32;
        Self {
            u: numbers(),
            v: numbers(),
            footprint: numbers(),
            light: numbers(),
            mix: numbers(),
            dither: (0..width).map(step).collect(),
            layers: [layer(), layer()],
        }
    }

    /// Where the rays of some columns hit a surface, and the light there. `rays` are the row's, `pixel`
    /// is the angle of one.
    #[inline(always)]
    pub(super) fn hit(
        &mut self,
        facing: &Facing,
        columns: Range<usize>,
        rays: &[[f32; 2]],
        pixel: f32,
        material: &Material,
    ) {
        let rays = &rays[columns.clone()];
        let count = rays.len();
        let u = &mut self.u[columns.clone()][..count];
        let v = &mut self.v[columns.clone()][..count];
        let footprint = &mut self.footprint[columns.clone()][..count];
        let light = &mut self.light[columns][..count];
        let per_texel = 1.0 / material.texel_m;
        let span = pixel * per_texel;
        let along = facing.u.map(|v| v * per_texel);
        let aside = facing.v.map(|v| v * per_texel);
        for (i, &[x, y]) in rays.iter().enumerate() {
            let dot = |g: &[f32]| g[0] * x + g[1] * y + g[2];
            let steep = 1.0 / dot(&facing.under);
            let depth = facing.over * steep;
            u[i] = along[3] + depth * dot(&along);
            v[i] = aside[3] + depth * dot(&aside);
            let lit = facing.light[3] + depth * dot(&facing.light);
            light[i] = lit.max(0.0) + material.glow;
            // Texels across a pixel: between those along and across the slant.
            let length = (1.0 + x * x + y * y).sqrt();
            let across = depth * span;
            footprint[i] = across * across * length * steep.abs().min(1e3);
        }
    }

    /// Which texels that is, in mip levels that `shift` (0 to 1) dithers.
    #[inline(always)]
    pub(super) fn look(&mut self, shift: f32) {
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
            let centre = 0.5 * scale - 0.5;
            let (u, v) = (u[i], v[i]);
            let place = Place::new(u * scale + centre, v * scale + centre, level as u32);
            fine.put(i, place);
            let coarse = (level - 3).max(0);
            let scale = COARSER * power_of_half(coarse);
            let (cu, cv) = (
                u * COARSER_TURN.0 - v * COARSER_TURN.1,
                u * COARSER_TURN.1 + v * COARSER_TURN.0,
            );
            broad.put(i, Place::new(cu * scale, cv * scale, coarse as u32));
        }
    }

    /// Reads them for columns that see one texture.
    #[inline(always)]
    pub(super) fn fetch(&mut self, texture: &Texture, columns: Range<usize>) {
        for layer in &mut self.layers {
            for at in [&mut layer.top, &mut layer.bottom] {
                for at in &mut at[columns.clone()] {
                    *at = texture.pair(*at);
                }
            }
        }
    }

    /// What they throw back.
    #[inline(always)]
    pub(super) fn reflect(&mut self) {
        let count = self.u.len();
        let (light, mix) = (&mut self.light[..count], &mut self.mix[..count]);
        let [fine, broad] = &mut self.layers;
        let (fine, broad) = (fine.slices(count), broad.slices(count));
        for i in 0..count {
            let tone = fine.blend(i, 0) * TONE;
            let broad = broad.blend(i, 0) * TONE;
            light[i] *= tone * (0.45 + 0.55 * broad);
            mix[i] = fine.blend(i, 8) * MIX;
        }
    }
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
    fn put(&mut self, i: usize, place: Place) {
        self.top[i] = place.top;
        self.bottom[i] = place.bottom;
        self.right[i] = place.right;
        self.down[i] = place.down;
    }

    #[inline(always)]
    fn blend(&self, i: usize, shift: u32) -> f32 {
        let place = Place {
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
    fn the_short_logarithm_is_close() {
        for i in 1..2000 {
            let x = 0.003 * i as f32;
            assert!((log2(x) - x.log2()).abs() < 0.012, "{x}: {}", log2(x));
        }
    }
}
