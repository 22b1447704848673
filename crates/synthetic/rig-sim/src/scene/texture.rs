//! Surface textures with the statistics of natural images.
//!
//! A *dead leaves* image (Matheron 1968; Lee, Mumford and Huang 2001): discs with radii by an
//! inverse cube law occlude each other. Unlike noise it has the properties of natural surfaces:
//! occlusion edges at every size, and an amplitude spectrum near 1/f. Outlines are bent and, for
//! surfaces laid of pieces, cut ([`layout`]); blocks of value noise add grain. Textures tile, have
//! two channels, and include all their mip levels.

use crate::random;

pub mod layout;

use self::layout::Layout;

/// Width and height of a texture's finest level, texels.
pub const SIZE: usize = 1024;
const LEVELS: usize = 11;
/// Units of a texel's low byte in reflectance, and of its high byte as a fraction.
pub const TONE: f32 = 1.0 / 128.0;
/// See [`TONE`].
pub(crate) const MIX: f32 = 1.0 / 255.0;

/// Start of the level of this size: after the sum of `n (n + 1)` over the larger sizes `n`.
#[inline(always)]
fn start(size: i32) -> i32 {
    const TOP: i32 = SIZE as i32;
    /// Inverse of 3 modulo 2³², so that exact division is a product.
    const THIRD: i32 = -0x5555_5555;
    (4 * (TOP * TOP - size * size)).wrapping_mul(THIRD) + 2 * (TOP - size)
}

/// Position of a bilinear sample between four texels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TexelQuad {
    /// Numbers of the upper left and of the lower left texel, among those of all levels.
    pub top: u32,
    /// See `top`.
    pub bottom: u32,
    /// Fractional position to the right and down, 0 to 1.
    pub right: f32,
    /// See `right`.
    pub down: f32,
}

/// A tileable texture with mip levels. A texel holds in its low byte reflectance relative to the
/// mean (1.0 is 128) and in its high byte the fraction of the second color (full is 255).
#[derive(Clone, Debug)]
pub struct Texture {
    /// Levels begin at [`start`]; their rows are one texel longer than the level's size and end
    /// with their first texel: two neighbors are adjacent in memory.
    texels: Vec<u16>,
}

/// Recipe of a texture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recipe {
    /// Radii of the leaves, texels.
    pub radius: [f32; 2],
    /// Standard deviation of a leaf's reflectance, relative.
    pub contrast: f32,
    /// Standard deviation of the grain on them, relative.
    pub grain: f32,
    /// Share of leaves of the second colour.
    pub mixed: f32,
    /// Aspect ratio of the leaves, along u.
    pub stretch: f32,
}

impl Texture {
    /// Generates the texture of a recipe, a layout and a seed.
    pub fn new(recipe: &Recipe, layout: &Layout, seed: u64) -> Self {
        let (mut luma, mut mix) = leaves(recipe, *layout == Layout::Tossed, seed);
        layout::lay(&mut luma, &mut mix, layout, seed);
        grain(&mut luma, recipe.grain, seed);
        // The mean is exactly 1, so a surface's albedo is that of its material.
        let mean = luma.iter().sum::<f32>() / luma.len() as f32;
        luma.iter_mut().for_each(|v| *v /= mean);
        let mut texels = Vec::with_capacity(SIZE * SIZE * 4 / 3 + 2 * SIZE);
        let mut size = SIZE;
        for _ in 0..LEVELS {
            for (luma, mix) in luma.chunks_exact(size).zip(mix.chunks_exact(size)) {
                let row = luma.iter().zip(mix).map(|(&l, &m)| {
                    let low = (l * 128.0 + 0.5).clamp(0.0, 255.0) as u16;
                    let high = (m * 255.0 + 0.5).clamp(0.0, 255.0) as u16;
                    low | (high << 8)
                });
                texels.extend(row);
                texels.push(texels[texels.len() - size]);
            }
            if size > 1 {
                luma = halved(&luma, size);
                mix = halved(&mix, size);
                size /= 2;
            }
        }
        Self { texels }
    }

    /// Reflectance (1 is the mean) and share of the second colour at `u`, `v` texels of level
    /// `level` (0 to 10), between the four texels around.
    #[inline]
    pub fn sample(&self, u: f32, v: f32, level: u32) -> (f32, f32) {
        let place = TexelQuad::new(u, v, level);
        let (top, bottom) = (self.pair(place.top), self.pair(place.bottom));
        let blend = |shift| place.blend(top, bottom, shift);
        (blend(0) * TONE, blend(8) * MIX)
    }

    /// A texel, and in the upper half its right neighbour.
    #[inline(always)]
    pub fn pair(&self, at: u32) -> u32 {
        let pair = &self.texels[at as usize..at as usize + 2];
        u32::from(pair[0]) | u32::from(pair[1]) << 16
    }
}

impl TexelQuad {
    /// The position `u`, `v` texels of level `level` (0 to 10) from the corner; textures tile.
    /// Without branches and memory access, so that a loop over it is vectorized.
    #[inline(always)]
    pub(crate) fn new(u: f32, v: f32, level: u32) -> Self {
        let size = SIZE as i32 >> level.min(LEVELS as u32 - 1);
        let mask = size - 1;
        let (x, y) = (floor(u), floor(v));
        let start = start(size) + (x & mask);
        let row = |y: i32| (start + (y & mask) * (size + 1)) as u32;
        Self {
            top: row(y),
            bottom: row(y.wrapping_add(1)),
            right: u - x as f32,
            down: v - y as f32,
        }
    }

    /// Interpolates one of a texel's two bytes, the one `shift` bits up, between two
    /// [`Texture::pair`]s; 0 to 255.
    #[inline(always)]
    pub(crate) fn blend(&self, top: u32, bottom: u32, shift: u32) -> f32 {
        let at = |pair: u32, side: u32| (pair >> (shift + side) & 0xff) as i32 as f32;
        let (p, q) = (at(top, 0), at(top, 16));
        let (r, s) = (at(bottom, 0), at(bottom, 16));
        let high = p + (q - p) * self.right;
        let low = r + (s - r) * self.right;
        high + (low - high) * self.down
    }
}

/// Floor of `x`, for magnitudes below 2²²; any number otherwise. A cast would need a branch each.
#[inline(always)]
pub(crate) fn floor(x: f32) -> i32 {
    /// Numbers of this size have no fraction bits: an added value is rounded into the last bits.
    const LARGE: f32 = 12_582_912.0;
    let sum = x + LARGE;
    let whole = (sum.to_bits() as i32).wrapping_sub(LARGE.to_bits() as i32);
    whole.wrapping_sub(i32::from(sum - LARGE > x))
}

fn halved(values: &[f32], size: usize) -> Vec<f32> {
    let half = size / 2;
    let mut small = Vec::with_capacity(half * half);
    for y in 0..half {
        for x in 0..half {
            let at = |dx: usize, dy: usize| values[(2 * y + dy) * size + 2 * x + dx];
            small.push(0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)));
        }
    }
    small
}

/// Contrast of a leaf relative to that of the largest, by its relative size.
fn fainter(size: f32) -> f32 {
    // About the fifth root.
    let root = size.sqrt().sqrt();
    0.12 + 0.88 * root * (1.25 - 0.25 * root)
}

/// The first open texel of a row from `x` on, or its end.
fn find(next: &mut [u16], x: usize) -> usize {
    let mut end = x;
    while usize::from(next[end]) != end {
        end = usize::from(next[end]);
    }
    let mut at = x;
    while at != end {
        (at, next[at]) = (usize::from(next[at]), end as u16);
    }
    end
}

/// Covers the tile from front to back: a leaf, an ellipse, is visible only where no leaf is yet.
fn leaves(recipe: &Recipe, tossed: bool, seed: u64) -> (Vec<f32>, Vec<f32>) {
    let [least, most] = recipe.radius.map(f64::from);
    let mut luma = vec![0.0_f32; SIZE * SIZE];
    let mut mix = vec![0.0_f32; SIZE * SIZE];
    let mut open = SIZE * SIZE;
    // The next texel of a row that is open, from each on; kept roughly up to date.
    let mut next: Vec<u16> = (0..SIZE).flat_map(|_| 0..=SIZE as u16).collect();
    let mut leaf = 0;
    while open > 0 {
        let draw = |k: u64| random::uniform(seed, random::TEXTURE + k, leaf);
        // P(radius > r) falls as r^-2 between the limits.
        let spread = 1.0 - (least / most) * (least / most);
        // At the end large leaves fill the rest; small ones would take too long.
        let wish = least / (1.0 - spread * draw(0)).sqrt();
        let radius = wish.max(0.05 * leaf as f64 / 1000.0).min(most) as f32;
        let (cx, cy) = (draw(1) as f32 * SIZE as f32, draw(2) as f32 * SIZE as f32);
        // Small things differ less from what is around them.
        let contrast = recipe.contrast * fainter(radius / recipe.radius[1]);
        let tone = 1.0 + contrast * random::bell(seed, random::TEXTURE + 3, leaf) as f32;
        let tone = tone.clamp(0.15, 1.95);
        let second = f32::from(u8::from((draw(4) as f32) < recipe.mixed));
        // A slope across the leaf, as of a rounded thing in slanting light.
        let slope = 0.3 * contrast * (draw(5) as f32 - 0.5) / radius;
        let (rx, ry) = (
            radius * recipe.stretch.sqrt(),
            radius / recipe.stretch.sqrt(),
        );
        let angle = if tossed {
            std::f64::consts::PI * draw(6)
        } else {
            0.0
        };
        let (sin, cos) = (libm::sin(angle) as f32, libm::cos(angle) as f32);
        // Within `a x² + 2 b x y + c y² < 1`, `c` following from the size.
        let (ix, iy) = (1.0 / (rx * rx), 1.0 / (ry * ry));
        let a = cos * cos * ix + sin * sin * iy;
        let b = sin * cos * (ix - iy);
        let high = (a / (ix * iy)).sqrt();
        let reach = high.ceil() as i32;
        for dy in -reach..=reach {
            let y = cy as i32 + dy;
            let up = y as f32 + 0.5 - cy;
            let chord = 1.0 - up * up / (high * high);
            if chord <= 0.0 {
                continue;
            }
            let half = (chord / a).sqrt();
            let middle = cx - b / a * up;
            let from = (middle - half + 0.5).floor() as i32;
            let to = (middle + half + 0.5).floor() as i32;
            let row = y.rem_euclid(SIZE as i32) as usize;
            let next = &mut next[row * (SIZE + 1)..(row + 1) * (SIZE + 1)];
            // Wider than the tile, it would cover itself.
            let to = to.min(from + SIZE as i32);
            let size = SIZE as i32;
            let beyond = from.div_euclid(size) * size;
            for tile in [beyond, beyond + size] {
                let (first, end) = (from.max(tile) - tile, to.min(tile + size) - tile);
                let mut x = find(next, first.min(size) as usize);
                while (x as i32) < end {
                    let i = row * SIZE + x;
                    luma[i] = tone + slope * ((x as i32 + tile) as f32 + 0.5 - cx);
                    mix[i] = second;
                    next[x] = x as u16 + 1;
                    open -= 1;
                    x = find(next, x + 1);
                }
            }
        }
        leaf += 1;
    }
    (luma, mix)
}

fn grain(luma: &mut [f32], strength: f32, seed: u64) {
    // Three octaves of value noise of equal strength, as 1/f requires.
    for (octave, step) in [1_usize, 2, 4].into_iter().enumerate() {
        let wide = SIZE / step;
        let node = |x: usize, y: usize| {
            let index = ((y % wide) * wide + x % wide) as u64;
            random::bell(seed, random::TEXTURE + 16 + octave as u64, index) as f32
        };
        let nodes: Vec<f32> = (0..wide * wide).map(|i| node(i % wide, i / wide)).collect();
        for y in 0..SIZE {
            for x in 0..SIZE {
                let (i, j) = (x / step, y / step);
                let (s, t) = (
                    (x % step) as f32 / step as f32,
                    (y % step) as f32 / step as f32,
                );
                let at = |i: usize, j: usize| nodes[(j % wide) * wide + i % wide];
                let top = at(i, j) * (1.0 - s) + at(i + 1, j) * s;
                let bottom = at(i, j + 1) * (1.0 - s) + at(i + 1, j + 1) * s;
                luma[y * SIZE + x] *= 1.0 + 0.58 * strength * (top * (1.0 - t) + bottom * t);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STONES: Recipe = Recipe {
        radius: [2.0, 200.0],
        contrast: 0.3,
        grain: 0.05,
        mixed: 0.3,
        stretch: 1.0,
    };

    #[test]
    fn fast_floor_agrees_with_the_standard_library() {
        for i in -3000..3000 {
            for x in [i as f32 * 0.25, i as f32 * 1397.7 + 0.3, i as f32] {
                assert_eq!(floor(x), x.floor() as i32, "{x}");
            }
        }
    }

    #[test]
    fn mip_levels_preserve_the_mean_and_tile() {
        let texture = Texture::new(&STONES, &Layout::Along, 1);
        assert_eq!(texture.texels.len(), start(1) as usize + 2);
        let (mean, _) = texture.sample(0.5, 0.5, 10);
        assert!((mean - 1.0).abs() < 0.02, "{mean}");
        for level in [0, 3, 9] {
            let size = (SIZE >> level) as f32;
            let (a, b) = (
                texture.sample(1.25, 7.75, level),
                texture.sample(1.25 - 3.0 * size, 7.75 + size, level),
            );
            assert!((a.0 - b.0).abs() < 1e-3, "level {level}: {a:?} {b:?}");
        }
    }

    /// Power falls with frequency about as 1/f², as in natural images: each octave then holds the
    /// same variance, and so do the differences between one mip level and the next.
    #[test]
    fn octaves_have_similar_power() {
        let texture = Texture::new(&STONES, &Layout::Along, 2);
        let variance = |level: u32| {
            let size = SIZE >> level;
            let band = |i: usize| {
                let (x, y) = ((i % size) as f32, (i / size) as f32);
                let (fine, _) = texture.sample(x, y, level);
                let (coarse, _) = texture.sample(0.5 * x - 0.25, 0.5 * y - 0.25, level + 1);
                f64::from(fine - coarse).powi(2)
            };
            (0..size * size).map(band).sum::<f64>() / (size * size) as f64
        };
        let bands: Vec<f64> = (1..6).map(variance).collect();
        let (least, most) = bands
            .iter()
            .fold((f64::MAX, 0.0_f64), |(l, m), &b| (l.min(b), m.max(b)));
        assert!(most / least < 4.0, "{bands:?}");
    }
}
