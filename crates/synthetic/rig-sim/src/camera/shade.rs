//! Shading: the light of each pixel.
//!
//! Contract: the rasterizer gives the triangle of a pixel; the intersection with the pixel's exact
//! ray, its depth and its texel are computed here, for any lens. All quantities are linear in
//! light; 1 is a horizontal white surface in full daylight.

use std::ops::Range;

use crate::camera::raster::{NOTHING, View, Visibility};
use crate::random;
use crate::scene::Scene;
use crate::scene::body::Surface;
use crate::scene::surface::Class;
mod line;

use self::line::Line;

/// An image in linear light.
#[derive(Clone, Debug)]
pub struct Radiance {
    /// Columns, even.
    pub width: usize,
    /// Rows, even.
    pub height: usize,
    /// Luminance of every pixel, row-major.
    pub luminance: Vec<f32>,
    /// Red, green, blue of every second pixel of every second row.
    pub color: Vec<[f32; 3]>,
}

impl Radiance {
    /// A black image.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            luminance: vec![0.0; width * height],
            color: vec![[0.0; 3]; (width / 2) * (height / 2)],
        }
    }

    /// Adds another image of the same size.
    pub fn add(&mut self, other: &Self) {
        for (to, from) in self.luminance.iter_mut().zip(&other.luminance) {
            *to += from;
        }
        for (to, from) in self.color.iter_mut().zip(&other.color) {
            *to = [0, 1, 2].map(|k| to[k] + from[k]);
        }
    }

    /// Resets to black.
    pub fn clear(&mut self) {
        self.luminance.fill(0.0);
        self.color.fill([0.0; 3]);
    }
}

/// Luminance of linear red, green, blue (Rec. 709).
pub fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// A body with its views.
pub struct VisibleBody<'a> {
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
    #[inline(always)]
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

/// Index of the body of a triangle.
fn body_of(bodies: &[VisibleBody<'_>], triangle: u32) -> usize {
    bodies.partition_point(|b| b.first <= triangle) - 1
}

/// Adds the light of all pixels, times `weight`. `rays` are the pixel rays, `noise` selects among
/// mip levels. With AVX2 the same operations run on more pixels at a time; the result is the same.
pub fn add(
    radiance: &mut Radiance,
    scene: &Scene,
    visibility: &Visibility,
    bodies: &[VisibleBody<'_>],
    rays: &[[f32; 2]],
    weight: f32,
    noise: u64,
) {
    let shading = Shading {
        scene,
        visibility,
        bodies,
        rays,
        weight,
        noise,
    };
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor supports the features of the function.
        unsafe { shading.add_avx2(radiance) };
        return;
    }
    shading.add(radiance);
}

/// Arguments of [`add`].
struct Shading<'a> {
    scene: &'a Scene,
    visibility: &'a Visibility,
    bodies: &'a [VisibleBody<'a>],
    rays: &'a [[f32; 2]],
    weight: f32,
    noise: u64,
}

impl Shading<'_> {
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn add_avx2(&self, radiance: &mut Radiance) {
        self.add(radiance);
    }

    #[inline(always)]
    fn add(&self, radiance: &mut Radiance) {
        let (width, height) = (self.visibility.width, self.visibility.height);
        let half = width / 2;
        // Angle of a pixel at the image center.
        let middle = (height / 2) * width + half;
        let pixel = self.rays[middle + 1][0] - self.rays[middle][0];
        let materials = &self.scene.materials;
        let nothing = materials.len() as u16;
        // One tint per material, and one for no surface.
        let tint = self.scene.light.tint;
        let mut paints: Vec<[[f32; 3]; 2]> = Vec::new();
        paints.extend(materials.iter().map(|material| {
            let own = [0, 1, 2].map(|k| material.albedo[k] * tint[k]);
            let other = [0, 1, 2].map(|k| material.other_albedo[k] * tint[k] - own[k]);
            [own, other]
        }));
        paints.push([[0.0; 3]; 2]);
        let mut line = Line::new(width);
        let mut skies: Vec<Range<usize>> = Vec::new();
        for row in 0..height {
            let here = row * width..(row + 1) * width;
            let ids = &self.visibility.triangle[here.clone()];
            let rays = &self.rays[here.clone()];
            let luma = &mut radiance.luminance[here];
            let color = match row % 2 {
                0 => &mut radiance.color[row / 2 * half..(row / 2 + 1) * half],
                _ => &mut [],
            };
            line.aim(rays);
            skies.clear();
            let mut from = 0;
            while from < width {
                let id = ids[from];
                let mut to = from + 1;
                while to < width && ids[to] == id {
                    to += 1;
                }
                if id == NOTHING {
                    line.miss(from..to, nothing);
                    skies.push(from..to);
                } else {
                    let body = &self.bodies[body_of(self.bodies, id)];
                    let view = &body.views[row.min(body.views.len() - 1)];
                    let surface = &body.surfaces[(id - body.first) as usize];
                    let number = surface.material;
                    let material = &materials[number as usize];
                    let facing = Facing::new(surface, view);
                    line.hit(&facing, from..to, pixel, material, number);
                }
                from = to;
            }
            line.select_texels(random::uniform(self.noise, 0, row as u64) as f32);
            line.fetch(&self.scene.textures);
            line.reflect(luma, self.weight);
            for (i, to) in color.iter_mut().enumerate() {
                let (light, mix) = (line.light[2 * i], line.mix[2 * i]);
                let [own, other] = &paints[line.material[2 * i] as usize];
                for k in 0..3 {
                    to[k] += light * (own[k] + other[k] * mix);
                }
            }
            for columns in skies.drain(..) {
                self.sky(row, columns, rays, luma, color);
            }
        }
    }

    /// Pixels without a surface.
    #[inline(always)]
    fn sky(
        &self,
        row: usize,
        columns: Range<usize>,
        rays: &[[f32; 2]],
        luma: &mut [f32],
        color: &mut [[f32; 3]],
    ) {
        let views = self.bodies[0].views;
        let view = &views[row.min(views.len() - 1)];
        let sky_luma = luminance(self.scene.sky.zenith);
        for x in columns {
            let (light, tint) = self.scene.sky.seen(view, rays[x], self.scene);
            let light = self.weight * light;
            luma[x] += light * sky_luma;
            if x % 2 == 0
                && let Some(to) = color.get_mut(x / 2)
            {
                for k in 0..3 {
                    to[k] += light * tint[k];
                }
            }
        }
    }
}

/// Class of a surface.
pub fn class(scene: &Scene, surface: &Surface) -> Class {
    scene.materials[surface.material as usize].class
}

#[cfg(test)]
mod tests;
