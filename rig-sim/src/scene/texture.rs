//! Surface textures with the statistics of natural pictures.
//!
//! A *dead leaves* picture (Matheron 1968; Lee, Mumford and Huang 2001): discs with radii by an inverse
//! cube law cover each other. It has what natural surfaces have and noise has not: edges where one
//! thing hides another, at every size, and an amplitude spectrum near 1/f. Outlines are bent and, for what
//! is laid of pieces, cut ([`layout`]); blocks of value noise add grain. Textures tile, hold two channels,
//! and come with all their mip levels.

use crate::random;

pub mod layout;

use self::layout::Layout;

/// Width and height of a texture's finest level, texels.
pub const SIZE: usize = 1024;
const LEVELS: usize = 11;

/// A tileable texture with mip levels. A texel holds, in its low byte, reflectance relative to the mean
/// (1.0 is 128) and in its high byte how much of the second colour it has (full is 255).
#[derive(Clone, Debug)]
pub struct Texture {
    /// Level `l` starts at `start(l)` and is `SIZE >> l` wide.
    texels: Vec<u16>,
}

/// How a texture is made.
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
    /// How much longer than wide leaves are, along u.
    pub stretch: f32,
}

impl Texture {
    /// The texture of a recipe, a layout and a seed.
    pub fn new(recipe: &Recipe, layout: &Layout, seed: u64) -> Self {
        let (mut luma, mut mix) = leaves(recipe, *layout == Layout::Tossed, seed);
        layout::lay(&mut luma, &mut mix, layout, seed);
        grain(&mut luma, recipe.grain, seed);
        // The mean is 1 exactly, so that a surface's albedo is what its material says.
        let mean = luma.iter().sum::<f32>() / luma.len() as f32;
        luma.iter_mut().for_each(|v| *v /= mean);
        let mut texels = Vec::with_capacity(SIZE * SIZE * 4 / 3 + 1);
        let mut size = SIZE;
        for _ in 0..LEVELS {
            texels.extend(luma.iter().zip(&mix).map(|(&l, &m)| {
                let low = (l * 128.0 + 0.5).clamp(0.0, 255.0) as u16;
                let high = (m * 255.0 + 0.5).clamp(0.0, 255.0) as u16;
                low | (high << 8)
            }));
            if size > 1 {
                luma = halved(&luma, size);
                mix = halved(&mix, size);
                size /= 2;
            }
        }
        Self { texels }
    }

    /// Reflectance (1 is the mean) and share of the second colour at `u`, `v` texels of level
    /// `level`, between the four texels around.
    #[inline]
    pub fn sample(&self, u: f32, v: f32, level: u32) -> (f32, f32) {
        let level = level.min(LEVELS as u32 - 1);
        let shift = SIZE.trailing_zeros() - level;
        let mask = (1_i32 << shift) - 1;
        let (fu, fv) = (floor(u), floor(v));
        let (a, b) = (u - fu, v - fv);
        let (x0, y0) = (fu as i32 & mask, fv as i32 & mask);
        let (x1, y1) = ((x0 + 1) & mask, (y0 + 1) & mask);
        let level = &self.texels[start(level as usize)..];
        let at = |x: i32, y: i32| u32::from(level[((y << shift) + x) as usize]);
        let (p, q, r, s) = (at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1));
        let weights = [(1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b];
        let blend = |f: fn(u32) -> u32| {
            f(p) as f32 * weights[0]
                + f(q) as f32 * weights[1]
                + f(r) as f32 * weights[2]
                + f(s) as f32 * weights[3]
        };
        (
            blend(|t| t & 0xff) * (1.0 / 128.0),
            blend(|t| t >> 8) * (1.0 / 255.0),
        )
    }
}

/// Without a call into the maths library, which baseline x86-64 makes for `f32::floor`.
#[inline]
fn floor(x: f32) -> f32 {
    let whole = x as i32 as f32;
    if whole > x { whole - 1.0 } else { whole }
}

const fn start(level: usize) -> usize {
    // The sum of SIZE² / 4^l over the finer levels.
    let mut sum = 0;
    let mut l = 0;
    while l < level {
        sum += (SIZE >> l) * (SIZE >> l);
        l += 1;
    }
    sum
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

/// Contrast of a leaf over that of the largest, by its size over that of the largest.
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

/// Covers the tile from the front: a leaf, an ellipse, only shows where nothing lies yet.
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
        // Near the end, large leaves close what is left; small ones would take for ever.
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
    // Three octaves of value noise, equally strong: what 1/f asks for.
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
    fn levels_keep_the_mean_and_tile() {
        let texture = Texture::new(&STONES, &Layout::Along, 1);
        assert_eq!(texture.texels.len(), start(LEVELS));
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

    /// Power falls with frequency about as 1/f², as in natural pictures: each octave then holds the
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
