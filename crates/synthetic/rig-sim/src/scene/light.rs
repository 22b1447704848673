//! Light sources and irradiance of surfaces.
//!
//! Sun, sky and lamps, with shadows and ambient occlusion, computed once at the corners of
//! triangles and linear between them: shadows have soft outlines as wide as a triangle, and
//! triangles are cut where that is too wide (`shadow.rs`). Indirect light is part of the sky's
//! share. Moving bodies neither cast nor receive shadows.

use std::collections::HashMap;

use nalgebra::Vector3;

use super::Lighting;
use super::bvh::Bvh;
use super::mesh::{Mesh, Triangle};

/// Number of sky rays per corner.
const SKY_RAYS: usize = 14;
/// Maximum distance of ambient occlusion, m.
const SKY_REACH_M: f64 = 6.0;
/// Minimum cosine of the angle between faces that are shaded as smooth.
const ROUND: f64 = 0.8;

/// Distance of ray origins from a surface, m.
pub(super) const RAY_OFFSET_M: f64 = 0.02;

/// Irradiance at a corner of a triangle, by source.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lit {
    /// Surface normal, smoothed over small edges.
    pub(super) normal: Vector3<f64>,
    /// From the sun.
    pub(super) sun: f32,
    /// From everything else.
    pub(super) soft: f32,
}

/// A point light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lamp {
    /// Position, m.
    pub position: Vector3<f64>,
    /// Irradiance at 1 m, relative to daylight.
    pub strength: f64,
}

/// All light sources of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Direction to the sun, of length 1, and its irradiance on a surface that faces it.
    pub sun: Option<(Vector3<f64>, f64)>,
    /// Irradiance from an open sky.
    pub sky: f64,
    /// Lamps.
    pub lamps: Vec<Lamp>,
    /// Colour, luminance 1.
    pub tint: [f32; 3],
    /// Flicker of all light: frequency of the light's maxima, Hz, and depth (1 is full modulation).
    pub flicker: Option<(f64, f64)>,
}

/// The light sources of a scene in all lightings.
#[derive(Clone, Debug)]
pub struct Lights {
    /// Direction to the sun by day.
    pub sun: Vector3<f64>,
    /// Direction to the sun when it is low.
    pub low_sun: Vector3<f64>,
    /// Lamps that are on at night.
    pub lamps: Vec<Lamp>,
    /// Indoors the lamps are on by day too, and the sun enters only when it is low.
    pub indoors: bool,
}

impl Lights {
    /// Factor on the strength of lamps in a lighting.
    pub(crate) fn lamps_on(&self, lighting: Lighting) -> f64 {
        match (lighting, self.indoors) {
            (Lighting::Day | Lighting::LowSun, false) => 0.0,
            (Lighting::Day, true) => 1.0,
            (Lighting::LowSun, true) => 0.2,
            (Lighting::Night, false) => 1.0,
            (Lighting::Night, true) => 0.02,
            (Lighting::Flicker, false) => 4.0,
            (Lighting::Flicker, true) => 1.0,
        }
    }

    /// The light sources in a lighting.
    pub fn at(&self, lighting: Lighting) -> Light {
        const WHITE: [f32; 3] = [1.0, 1.0, 1.0];
        const WARM: [f32; 3] = [1.26, 0.97, 0.53];
        const MAINS: Option<(f64, f64)> = Some((100.0, 0.8));
        let sun = |direction: Vector3<f64>, strength| Some((direction.normalize(), strength));
        let lamps = || {
            let factor = self.lamps_on(lighting);
            let lit = |lamp: &Lamp| Lamp {
                strength: lamp.strength * factor,
                ..*lamp
            };
            self.lamps.iter().map(lit).collect()
        };
        let light = |sun, sky, lamps, tint, flicker| Light {
            sun,
            sky,
            lamps,
            tint,
            flicker,
        };
        match (lighting, self.indoors) {
            (Lighting::Day, false) => light(sun(self.sun, 0.75), 0.3, Vec::new(), WHITE, None),
            (Lighting::Day, true) => light(None, 0.03, lamps(), WHITE, None),
            (Lighting::LowSun, false) => {
                light(sun(self.low_sun, 0.6), 0.15, Vec::new(), WARM, None)
            }
            (Lighting::LowSun, true) => light(sun(self.low_sun, 0.4), 0.03, lamps(), WARM, None),
            (Lighting::Night, false) => light(None, 0.000_3, lamps(), WARM, None),
            (Lighting::Night, true) => light(None, 0.000_5, lamps(), WARM, None),
            // Outdoors: a dull evening under street lamps. Indoors: tubes.
            (Lighting::Flicker, false) => light(None, 0.001, lamps(), WHITE, MAINS),
            (Lighting::Flicker, true) => light(None, 0.01, lamps(), WHITE, MAINS),
        }
    }
}

impl Light {
    /// Irradiance at a point with this normal. `blocked(direction, reach)` returns whether the ray
    /// is occluded.
    pub fn irradiance(
        &self,
        point: &Vector3<f64>,
        normal: &Vector3<f64>,
        blocked: impl Fn(&Vector3<f64>, f64) -> bool,
    ) -> f64 {
        self.soft(point, normal, &blocked) + self.sunlight(normal, &blocked)
    }

    /// Irradiance from the sun; see [`Light::irradiance`].
    pub(super) fn sunlight(
        &self,
        normal: &Vector3<f64>,
        blocked: impl Fn(&Vector3<f64>, f64) -> bool,
    ) -> f64 {
        match &self.sun {
            Some((direction, strength)) if normal.dot(direction) > 0.0 => {
                match blocked(direction, 200.0) {
                    true => 0.0,
                    false => strength * normal.dot(direction),
                }
            }
            _ => 0.0,
        }
    }

    /// Irradiance from sky, lamps and indirect light; see [`Light::irradiance`].
    fn soft(
        &self,
        point: &Vector3<f64>,
        normal: &Vector3<f64>,
        blocked: impl Fn(&Vector3<f64>, f64) -> bool,
    ) -> f64 {
        // Evenly spread over the sphere (Fibonacci), weighted by the cosine.
        let (mut open, mut all) = (0.0, 0.0);
        for i in 0..2 * SKY_RAYS {
            let z = 1.0 - (2 * i + 1) as f64 / (2 * SKY_RAYS) as f64;
            let angle = i as f64 * 2.399_963_229_728_653;
            let r = (1.0 - z * z).sqrt();
            let direction = Vector3::new(r * libm::cos(angle), r * libm::sin(angle), z);
            let cosine = normal.dot(&direction);
            if cosine > 0.05 {
                all += cosine;
                if !blocked(&direction, SKY_REACH_M) {
                    // Light from below the horizon is reflected by the ground.
                    open += cosine * if z > 0.0 { 1.0 } else { 0.4 };
                }
            }
        }
        let mut sum = self.sky * (0.15 + 0.85 * open / all);
        for lamp in &self.lamps {
            let arm = lamp.position - point;
            let square = arm.norm_squared();
            let distance = square.sqrt();
            let direction = arm / distance;
            let cosine = normal.dot(&direction);
            // A part of a lamp's light is reflected by walls and ground.
            let direct = match cosine > 0.0 && !blocked(&direction, distance - 0.05) {
                true => cosine,
                false => 0.0,
            };
            sum += lamp.strength * (direct + 0.1) / (square + 0.05);
        }
        sum
    }

    /// Irradiance at the corners of each triangle.
    pub(crate) fn baked(&self, mesh: &Mesh, solid: &Bvh) -> Vec<[f32; 3]> {
        let lit = self.lit(mesh, solid);
        lit.iter()
            .map(|corners| corners.map(|c| c.soft + c.sun))
            .collect()
    }

    /// The light at the corners of each triangle, by kind.
    pub(super) fn lit(&self, mesh: &Mesh, solid: &Bvh) -> Vec<[Lit; 3]> {
        let key = |p: &Vector3<f64>| [p.x, p.y, p.z].map(f64::to_bits);
        let flat: Vec<Vector3<f64>> = mesh.triangles.iter().map(Triangle::normal).collect();
        let mut around: HashMap<[u64; 3], Vec<usize>> = HashMap::new();
        for (i, t) in mesh.triangles.iter().enumerate() {
            for corner in &t.corners {
                around.entry(key(&corner.position)).or_default().push(i);
            }
        }
        let mut known: HashMap<([u64; 3], [i32; 3]), Lit> = HashMap::new();
        let mut at = |i: usize, p: &Vector3<f64>| {
            let near = around[&key(p)].iter().map(|&k| flat[k]);
            let round: Vector3<f64> = near.filter(|n| n.dot(&flat[i]) > ROUND).sum();
            let normal = round.normalize();
            let cell = normal.map(|v| (v * 1000.0).round() as i32);
            *known
                .entry((key(p), [cell.x, cell.y, cell.z]))
                .or_insert_with(|| {
                    let start = p + flat[i] * RAY_OFFSET_M;
                    let blocked = |d: &Vector3<f64>, reach: f64| solid.is_hidden(&start, d, reach);
                    Lit {
                        normal,
                        soft: self.soft(p, &normal, blocked) as f32,
                        sun: self.sunlight(&normal, blocked) as f32,
                    }
                })
        };
        mesh.triangles
            .iter()
            .enumerate()
            .map(|(i, t)| t.corners.map(|c| at(i, &c.position)))
            .collect()
    }

    /// Mean brightness of a flickering light from `from_s` for `length_s`, relative to its
    /// long-term mean. The light follows a squared sine, as of a lamp on mains.
    pub(crate) fn flicker_factor(&self, from_s: f64, length_s: f64) -> f64 {
        let Some((hz, depth)) = self.flicker else {
            return 1.0;
        };
        let turn = 2.0 * std::f64::consts::PI * hz;
        if length_s < 1e-9 {
            return 1.0 - depth * libm::cos(turn * from_s);
        }
        let wave = libm::sin(turn * (from_s + length_s)) - libm::sin(turn * from_s);
        1.0 - depth * wave / (turn * length_s)
    }
}
