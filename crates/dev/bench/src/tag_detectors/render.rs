//! Images of scenes by supersampling: light of every surface where a ray meets it, then the blur of
//! the lens and the width of a pixel, the tone curve, noise, 8 bits.
//!
//! Nothing here is shared with the images that the fit is tested on, nor with those of the
//! simulated rig. The shutter is global. Grounds depend on the seed alone: they are rendered once
//! for all conditions.

use anyhow::{Context, Result};
use boards::Dictionary;
use counter_random::{bell, uniform};
use nalgebra::{Matrix3, Vector3};

use super::conditions::{Condition, Curve};
use super::scene::{BASELINE_M, Camera, EXPOSURE_S, Scene, TAG_M};

/// Standard deviation of the blur of the lens, px.
const LENS_PX: f64 = 0.6;
/// Pixels beyond which it is over, with half the width of a pixel.
const REACH_PX: usize = 3;
/// Samples of a pixel along each axis: around the tag, and elsewhere.
const FINE: usize = 6;
const COARSE: usize = 2;
/// Pixels around a tag that are sampled finely.
const AROUND_PX: f64 = 12.0;

/// Light of paper and print, of the shoe, and of the ground on average, relative to full scale.
const WHITE: f64 = 0.62;
const BLACK: f64 = 0.035;
const SHOE: f64 = 0.09;
const GROUND: f64 = 0.17;
/// Half axes of the shoe, m.
const SHOE_M: [f64; 2] = [0.13, 0.06];
/// Distance of the ground along the optical axis, m.
const GROUND_M: f64 = 2.2;
/// Side of slabs of the ground, of dark marks on it, and of the squares in these, m.
const SLAB_M: f64 = 0.3;
const MARK_M: f64 = 0.12;
const MARK_CELL_M: f64 = 0.011;
/// Share of the places of marks that have one.
const MARKS: f64 = 0.06;

/// Rays of an eye, of length 1 along the axis, at nodes between which they are interpolated: by
/// less than 0.002 px wrong.
pub(super) struct Renderer {
    camera: Camera,
    rays: Vec<[f64; 2]>,
    columns: usize,
}

/// Pixels between nodes.
const NODE_PX: usize = 2;
/// Pixels beyond the image that rays are known of.
const BORDER: usize = REACH_PX + 1;

impl Renderer {
    pub(super) fn new(camera: Camera) -> Result<Self> {
        let [columns, rows] = camera.size.map(|v| (v + 2 * BORDER) / NODE_PX + 1);
        let mut rays = Vec::with_capacity(columns * rows);
        for j in 0..rows {
            for i in 0..columns {
                let pixel = [i, j].map(|v| (v * NODE_PX) as f64 - BORDER as f64);
                let ray = camera.lens.unproject(pixel).context("a ray of a pixel")?;
                rays.push([ray[0] / ray[2], ray[1] / ray[2]]);
            }
        }
        Ok(Self {
            camera,
            rays,
            columns,
        })
    }

    pub(super) fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Light of the ground in the left image.
    pub(super) fn ground(&self, seed: u64) -> Vec<f32> {
        let world = World {
            ground: Ground::new(seed),
            shoe: None,
        };
        self.light(&world, 0, [[0, 0], self.camera.size], COARSE)
    }

    /// The images of the left and the right eye. Of the right one only what is around the tag is
    /// rendered: nothing looks for tags there.
    pub(super) fn images(
        &self,
        scene: &Scene,
        condition: &Condition,
        ground: &[f32],
    ) -> Result<[Vec<u8>; 2]> {
        let world = World {
            ground: Ground::new(scene.seed),
            shoe: Some(Shoe::new(scene)?),
        };
        let mut lights = [ground.to_vec(), vec![0.0; ground.len()]];
        let half_tag = [0.5 * TAG_M * 10.0 / 8.0; 2];
        for (eye, light) in lights.iter_mut().enumerate() {
            for (half, samples) in [(SHOE_M, COARSE), (half_tag, FINE)] {
                if let Some(around) = self.around(scene, eye, half) {
                    let [from, to] = around;
                    let part = self.light(&world, eye, around, samples);
                    for (row, part) in (from[1]..to[1]).zip(part.chunks(to[0] - from[0])) {
                        light[row * self.camera.size[0] + from[0]..][..part.len()]
                            .copy_from_slice(part);
                    }
                }
            }
        }
        let mut eye = 0;
        Ok(lights.map(|light| {
            eye += 1;
            let pixels = light.iter().enumerate();
            let level =
                |(at, light): (usize, &f32)| level(*light, condition, scene.seed, (eye, at));
            pixels.map(level).collect()
        }))
    }

    /// First and last but one pixel around a rectangle on the shoe, with these half sides, during
    /// the exposure.
    fn around(
        &self,
        scene: &Scene,
        eye: usize,
        [half_x, half_y]: [f64; 2],
    ) -> Option<[[usize; 2]; 2]> {
        let (mut from, mut to) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for (x, y) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
            let (x, y) = (x * half_x, y * half_y);
            for time_s in [-0.5 * EXPOSURE_S, 0.5 * EXPOSURE_S] {
                let moved = Vector3::from(scene.motion.linear) * time_s;
                let point = Vector3::from(scene.left_from_tag.apply([x, y, 0.0])) + moved;
                let point = point - Vector3::new(eye as f64 * BASELINE_M, 0.0, 0.0);
                let pixel = self.camera.lens.project(point.into())?;
                for k in 0..2 {
                    from[k] = from[k].min(pixel[k] - AROUND_PX);
                    to[k] = to[k].max(pixel[k] + AROUND_PX);
                }
            }
        }
        let bounds = |v: f64, k: usize| (v.max(0.0) as usize).min(self.camera.size[k]);
        let around = [
            [0, 1].map(|k| bounds(from[k], k)),
            [0, 1].map(|k| bounds(to[k], k)),
        ];
        (0..2)
            .all(|k| around[1][k] > around[0][k])
            .then_some(around)
    }

    /// Light of a rectangle of pixels, by its first pixel and that beyond its last one, relative to
    /// full scale.
    fn light(
        &self,
        world: &World,
        eye: usize,
        [from, to]: [[usize; 2]; 2],
        samples: usize,
    ) -> Vec<f32> {
        let size = [0, 1].map(|k: usize| to[k] - from[k]);
        let kernel = Kernel::new(samples);
        let [columns, rows] = size.map(|v| (v + 2 * REACH_PX) * samples);
        let origin = Vector3::new(eye as f64 * BASELINE_M, 0.0, 0.0);
        let step = 1.0 / samples as f64;
        let mut fine = vec![0.0; columns];
        let mut across = vec![0.0; size[0] * rows];
        for j in 0..rows {
            for (i, value) in fine.iter_mut().enumerate() {
                let word = hash(world.ground.seed, (i + 8192 * j + 7 * eye) as u32);
                let jitter = [word & 0xff, word >> 8 & 0xff].map(|v| (f64::from(v) + 0.5) / 256.0);
                let place = |n: usize, k: usize| {
                    from[k] as f64 - REACH_PX as f64 - 0.5 + (n as f64 + jitter[k]) * step
                };
                let ray = self.ray(place(i, 0), place(j, 1));
                let time = (f64::from(word >> 16) + 0.5) / 65536.0 - 0.5;
                *value = world.light(&origin, &ray, time * EXPOSURE_S) as f32;
            }
            for (i, value) in across[j * size[0]..][..size[0]].iter_mut().enumerate() {
                *value = kernel.apply(fine[i * samples..].iter());
            }
        }
        let column = |i: usize, j: usize| across[j * samples * size[0] + i..].iter();
        (0..size[0] * size[1])
            .map(|n| kernel.apply(column(n % size[0], n / size[0]).step_by(size[0])))
            .collect()
    }

    fn ray(&self, x: f64, y: f64) -> Vector3<f64> {
        let [x, y] = [x, y].map(|v| (v + BORDER as f64) / NODE_PX as f64);
        let (i, j) = (x as usize, y as usize);
        let (s, t) = (x - i as f64, y - j as f64);
        let node = |i: usize, j: usize| self.rays[j * self.columns + i];
        let [a, b, c, d] = [
            node(i, j),
            node(i + 1, j),
            node(i, j + 1),
            node(i + 1, j + 1),
        ];
        let mix = |k: usize| {
            (a[k] * (1.0 - s) + b[k] * s) * (1.0 - t) + (c[k] * (1.0 - s) + d[k] * s) * t
        };
        Vector3::new(mix(0), mix(1), 1.0)
    }
}

/// Weights of samples in a pixel: its width and the blur of the lens.
struct Kernel(Vec<f32>);

impl Kernel {
    fn new(samples: usize) -> Self {
        let count = (2 * REACH_PX + 1) * samples;
        let weight = |n: usize| {
            let x = (n as f64 + 0.5) / samples as f64 - REACH_PX as f64 - 0.5;
            let integral = |x: f64| 0.5 * libm::erf(x / (LENS_PX * std::f64::consts::SQRT_2));
            integral(x + 0.5) - integral(x - 0.5)
        };
        let weights: Vec<f64> = (0..count).map(weight).collect();
        let sum: f64 = weights.iter().sum();
        Self(weights.iter().map(|v| (v / sum) as f32).collect())
    }

    fn apply<'a>(&self, values: impl Iterator<Item = &'a f32>) -> f32 {
        self.0.iter().zip(values).map(|(w, v)| w * v).sum()
    }
}

/// Gray level of a pixel.
fn level(light: f32, condition: &Condition, seed: u64, (eye, at): (usize, usize)) -> u8 {
    /// Of noise.
    const STREAM: u64 = 3;
    let light = f64::from(light).clamp(0.0, 1.0);
    let share = match condition.curve {
        Curve::Linear => light,
        // IEC 61966-2-1.
        Curve::Srgb if light <= 0.003_130_8 => 12.92 * light,
        Curve::Srgb => 1.055 * libm::pow(light, 1.0 / 2.4) - 0.055,
    };
    let noise = bell(seed, STREAM + eye as u64, at as u64);
    (255.0 * share + condition.noise_levels * noise + 0.5).clamp(0.0, 255.0) as u8
}

/// Surfaces in the frame of the left eye.
struct World {
    ground: Ground,
    shoe: Option<Shoe>,
}

impl World {
    /// Light along a ray at a time after mid-exposure.
    fn light(&self, origin: &Vector3<f64>, ray: &Vector3<f64>, time_s: f64) -> f64 {
        let ground = &self.ground;
        let shoe = self.shoe.as_ref();
        let shoe = shoe.and_then(|shoe| shoe.light(&ground.texture, origin, ray, time_s));
        let shade = 1.0 + ground.shade[0] * ray.x + ground.shade[1] * ray.y;
        ground.exposure * shade * shoe.unwrap_or_else(|| ground.light(origin, ray))
    }
}

/// An ellipse in the plane of its tag.
struct Shoe {
    tag_from_left: Matrix3<f64>,
    middle: Vector3<f64>,
    velocity: Vector3<f64>,
    /// Bits of the tag, `None` where the shoe has none.
    code: Option<u64>,
}

impl Shoe {
    fn new(scene: &Scene) -> Result<Self> {
        let rotation = scene.left_from_tag.rotation().inverse();
        let code = Dictionary::AprilTag36h11.code(scene.id);
        Ok(Self {
            tag_from_left: rotation.to_rotation_matrix().into_inner(),
            middle: *scene.left_from_tag.translation(),
            velocity: Vector3::from(scene.motion.linear),
            code: match scene.has_tag {
                true => Some(code.context("a code of the dictionary")?),
                false => None,
            },
        })
    }

    /// Its light, if the ray meets it.
    fn light(
        &self,
        texture: &Texture,
        origin: &Vector3<f64>,
        ray: &Vector3<f64>,
        time_s: f64,
    ) -> Option<f64> {
        let from = self.tag_from_left * (origin - self.middle - self.velocity * time_s);
        let ray = self.tag_from_left * ray;
        let along = -from.z / ray.z;
        let [x, y] = [from.x + along * ray.x, from.y + along * ray.y];
        let cell = TAG_M / 8.0;
        if let Some(code) = self.code
            && x.abs().max(y.abs()) < 5.0 * cell
        {
            let [column, row] = [x, y].map(|v| (v / cell + 5.0) as usize);
            return Some(match is_white(code, row, column) {
                true => WHITE,
                false => BLACK,
            });
        }
        let inside = (x / SHOE_M[0]).powi(2) + (y / SHOE_M[1]).powi(2) < 1.0;
        inside.then(|| SHOE * (0.6 + 0.8 * texture.noise(x / 0.004, y / 0.004)))
    }
}

/// A plane with slabs, marks and texture, and the light on everything.
struct Ground {
    seed: u64,
    slopes: [f64; 2],
    /// Sine and cosine of its rotation.
    turn: [f64; 2],
    /// Change of the light across the image.
    shade: [f64; 2],
    exposure: f64,
    texture: Texture,
}

impl Ground {
    fn new(seed: u64) -> Self {
        /// Of surfaces.
        const STREAM: u64 = 2;
        let draw = |index, from: f64, to: f64| from + (to - from) * uniform(seed, STREAM, index);
        let about = draw(2, 0.0, std::f64::consts::TAU);
        Self {
            seed,
            slopes: [draw(0, -0.2, 0.2), draw(1, -0.2, 0.2)],
            turn: [libm::sin(about), libm::cos(about)],
            shade: [draw(3, -0.3, 0.3), draw(4, -0.3, 0.3)],
            exposure: draw(5, 0.7, 1.1),
            texture: Texture::new(seed),
        }
    }

    /// Of the ground: slabs with joints, texture of three sizes, dark marks with squares in them.
    fn light(&self, origin: &Vector3<f64>, ray: &Vector3<f64>) -> f64 {
        let [by_x, by_y] = self.slopes;
        let along = (GROUND_M + by_x * origin.x + by_y * origin.y - origin.z)
            / (ray.z - by_x * ray.x - by_y * ray.y);
        let [x, y] = [origin.x + along * ray.x, origin.y + along * ray.y];
        let [sin, cos] = self.turn;
        let [x, y] = [cos * x - sin * y + 50.0, sin * x + cos * y + 50.0];
        let within = |v: f64, side: f64| v - (v / side).floor() * side;
        if within(x, SLAB_M).min(within(y, SLAB_M)) < 0.008 {
            return 0.05;
        }
        let [i, j] = [x, y].map(|v| (v / MARK_M).floor());
        let here = self.texture.at(i as usize, j as usize);
        let [u, v] = [within(x, MARK_M), within(y, MARK_M)].map(|v| v / MARK_CELL_M);
        if f64::from(here) < MARKS && u.max(v) < 8.0 {
            let is_inside = u.min(v) >= 1.0 && u.max(v) < 7.0;
            let bit = self
                .texture
                .at(i as usize * 8 + u as usize, j as usize * 8 + v as usize);
            return if is_inside && bit > 0.5 { 0.5 } else { 0.04 };
        }
        let octaves = [(0.04, 0.8), (0.013, 0.7), (0.004, 0.5)];
        let sum =
            octaves.map(|(side, share)| share * (self.texture.noise(x / side, y / side) - 0.5));
        (GROUND * (1.0 + sum.iter().sum::<f64>())).max(0.0)
    }
}

/// A table of random numbers from 0 to 1.
struct Texture(Vec<f32>);

/// Side of the table.
const TABLE: usize = 256;

impl Texture {
    fn new(seed: u64) -> Self {
        const STREAM: u64 = 6;
        let table = (0..TABLE * TABLE).map(|n| uniform(seed, STREAM, n as u64) as f32);
        Self(table.collect())
    }

    fn at(&self, i: usize, j: usize) -> f32 {
        self.0[(j % TABLE) * TABLE + i % TABLE]
    }

    /// Bilinear between integers.
    fn noise(&self, x: f64, y: f64) -> f64 {
        let (x, y) = (x + 4096.0, y + 4096.0);
        let (i, j) = (x as usize, y as usize);
        let (s, t) = ((x - i as f64) as f32, (y - j as f64) as f32);
        let [a, b] = [j, j + 1].map(|j| self.at(i, j) * (1.0 - s) + self.at(i + 1, j) * s);
        f64::from(a * (1.0 - t) + b * t)
    }
}

/// Whether a cell of a tag with its margin is white.
fn is_white(code: u64, row: usize, column: usize) -> bool {
    match [row, column].iter().map(|&i| i.min(9 - i.min(9))).min() {
        Some(0) => true,
        Some(1) => false,
        _ => code >> (35 - ((row - 2) * 6 + column - 2)) & 1 == 1,
    }
}

/// 32 random bits of a sample.
fn hash(seed: u64, index: u32) -> u32 {
    let mut x = index.wrapping_mul(0x9e37_79b9) ^ seed as u32;
    x = (x ^ x >> 16).wrapping_mul(0x7feb_352d);
    x = (x ^ x >> 15).wrapping_mul(0x846c_a68b);
    x ^ x >> 16
}
