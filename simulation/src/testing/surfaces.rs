//! Exact surfaces: parallelograms, with rays, heights and Gaussians in closed form.

use cad_transforms::RigidTransform;
use nalgebra::Vector3;
use splats::{Plane, Splats, StartPoint, splats_from_points};

use crate::error::SimulationError;
use crate::scene::Similarity;

/// Standard deviation of Gaussians across a surface, m: thin, so that their depth is the surface's.
const THICKNESS_M: f32 = 0.001;
/// Logit of their opacity: 0.99.
const OPACITY_LOGIT: f32 = 4.595;
/// Standard deviation of Gaussians along a surface in units of their distance: a surface is opaque
/// between them too, by more than 0.97.
const SIGMA_RATIO: f32 = 0.65;

/// A parallelogram.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// A corner, m.
    pub corner_m: [f64; 3],
    /// The two edges from there, m. Their cross product points outward.
    pub edges_m: [[f64; 3]; 2],
    /// Mean color, 0 to 1. A pattern of the position varies it.
    pub color: [f32; 3],
    /// The walkable level that it is part of.
    pub level: Option<usize>,
}

impl Patch {
    /// Unit normal.
    pub fn normal(&self) -> [f64; 3] {
        let [u, v] = self.edges_m.map(Vector3::from);
        u.cross(&v).normalize().into()
    }

    /// Height above x, y, m, if it is there.
    pub fn height_m(&self, at_m: [f64; 2]) -> Option<f64> {
        self.hit([at_m[0], at_m[1], 0.0], [0.0, 0.0, 1.0])
    }

    /// The multiple of a direction at which a line meets it; of either sign.
    fn hit(&self, origin_m: [f64; 3], direction: [f64; 3]) -> Option<f64> {
        let [u, v] = self.edges_m.map(Vector3::from);
        let (direction, normal) = (Vector3::from(direction), u.cross(&v));
        let along = normal.dot(&direction);
        if along.abs() < 1e-12 * normal.norm() * direction.norm() {
            return None;
        }
        let from_corner = Vector3::from(self.corner_m) - Vector3::from(origin_m);
        let t = normal.dot(&from_corner) / along;
        let x = direction * t - from_corner;
        // Coordinates along both edges.
        let square = normal.norm_squared();
        let a = x.cross(&v).dot(&normal) / square;
        let b = u.cross(&x).dot(&normal) / square;
        let range = -1e-9..=1.0 + 1e-9;
        (range.contains(&a) && range.contains(&b)).then_some(t)
    }

    fn carried(&self, to_from_here: &Similarity) -> Self {
        let scaled = |edge: [f64; 3]| to_from_here.rotate(edge).map(|v| v * to_from_here.scale());
        Self {
            corner_m: to_from_here.apply(self.corner_m),
            edges_m: self.edges_m.map(scaled),
            ..*self
        }
    }
}

/// All surfaces of a scene.
#[derive(Clone, Debug, Default)]
pub struct Surfaces {
    /// The parallelograms.
    pub patches: Vec<Patch>,
    /// Boxes that stand on the ground, by their corners, m. Their faces are among the patches.
    pub obstacles: Vec<[[f64; 3]; 2]>,
    /// Takes points to the frame of the pattern of colors.
    pattern_from_here: Option<Similarity>,
}

impl Surfaces {
    /// Adds level or sloping ground over a rectangle in x and y, at given heights of its corners at
    /// least x and y, greatest x, and greatest y, m.
    pub(super) fn add_ground(
        &mut self,
        min_m: [f64; 2],
        max_m: [f64; 2],
        heights_m: [f64; 3],
        color: [f32; 3],
        level: Option<usize>,
    ) {
        let [z, at_x, at_y] = heights_m;
        self.patches.push(Patch {
            corner_m: [min_m[0], min_m[1], z],
            edges_m: [
                [max_m[0] - min_m[0], 0.0, at_x - z],
                [0.0, max_m[1] - min_m[1], at_y - z],
            ],
            color,
            level,
        });
    }

    /// Adds a box that agents cannot enter.
    pub(super) fn add_obstacle(&mut self, min_m: [f64; 3], max_m: [f64; 3], color: [f32; 3]) {
        self.obstacles.push([min_m, max_m]);
        let [x, y, z] = [0, 1, 2].map(|k| {
            let mut edge = [0.0; 3];
            edge[k] = max_m[k] - min_m[k];
            edge
        });
        let mut add = |corner_m: [f64; 3], edges_m| {
            self.patches.push(Patch {
                corner_m,
                edges_m,
                color,
                level: None,
            });
        };
        add(min_m, [x, z]);
        add(min_m, [z, y]);
        add([min_m[0], min_m[1], max_m[2]], [x, y]);
        add([min_m[0], max_m[1], min_m[2]], [z, x]);
        add([max_m[0], min_m[1], min_m[2]], [y, z]);
    }

    /// Height of walkable ground at x, y that is nearest to z, and its upward normal.
    pub fn ground(&self, at_m: [f64; 2], near_z_m: f64) -> Option<(f64, [f64; 3])> {
        let walkable = self.patches.iter().filter(|patch| patch.level.is_some());
        let heights = walkable.filter_map(|patch| Some((patch.height_m(at_m)?, patch.normal())));
        heights.min_by(|a, b| (a.0 - near_z_m).abs().total_cmp(&(b.0 - near_z_m).abs()))
    }

    /// The multiple of a direction at which a ray meets the first surface. With a direction of
    /// depth 1 in a camera, rotated to the world, it is the depth.
    pub fn ray_m(&self, origin_m: [f64; 3], direction: [f64; 3]) -> Option<f64> {
        self.first_hit(origin_m, direction).map(|(t, _)| t)
    }

    /// The exact color that a ray meets, 0 to 1.
    pub fn color(&self, origin_m: [f64; 3], direction: [f64; 3]) -> Option<[f32; 3]> {
        let (t, patch) = self.first_hit(origin_m, direction)?;
        let at_m = [0, 1, 2].map(|k| origin_m[k] + t * direction[k]);
        let to_pattern = self.pattern_from_here.as_ref();
        Some(pattern(
            patch.color,
            to_pattern.map_or(at_m, |to| to.apply(at_m)),
        ))
    }

    fn first_hit(&self, origin_m: [f64; 3], direction: [f64; 3]) -> Option<(f64, &Patch)> {
        let hit = |patch| Some((Patch::hit(patch, origin_m, direction)?, patch));
        let hits = self
            .patches
            .iter()
            .filter_map(hit)
            .filter(|(t, _)| *t > 1e-9);
        hits.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// The same surfaces in another frame.
    #[must_use]
    pub(super) fn carried(&self, to_from_here: &Similarity) -> Self {
        let corners = |obstacle: &[[f64; 3]; 2]| {
            let ends = obstacle.map(|corner| to_from_here.apply(corner));
            let [low, high] =
                [f64::min, f64::max].map(|of| [0, 1, 2].map(|k| of(ends[0][k], ends[1][k])));
            [low, high]
        };
        Self {
            patches: self
                .patches
                .iter()
                .map(|patch| patch.carried(to_from_here))
                .collect(),
            obstacles: self.obstacles.iter().map(corners).collect(),
            pattern_from_here: Some(to_from_here.inverse()),
        }
    }

    /// Gaussians at regular distances on all surfaces, `sector_from_here` of their frame. The
    /// pattern of their colors is a function of the position here.
    pub(crate) fn gaussians(
        &self,
        spacing_m: f64,
        sector_from_here: &RigidTransform,
    ) -> Result<Splats, SimulationError> {
        let wrong = |found: String| SimulationError::Scene {
            place: "Gaussians of a synthetic scene".to_owned(),
            found,
            expected: "finite surfaces".to_owned(),
        };
        let is_finite = |patch: &Patch| {
            let numbers = patch.corner_m.iter().chain(patch.edges_m.as_flattened());
            numbers.copied().all(f64::is_finite)
        };
        if !self.patches.iter().all(is_finite) {
            return Err(wrong("a surface that is not finite".to_owned()));
        }
        let mut points = Vec::new();
        for patch in &self.patches {
            let [u, v] = patch.edges_m.map(Vector3::from);
            let counts = [u, v].map(|edge| (edge.norm() / spacing_m).ceil().max(1.0));
            let normal = sector_from_here.rotate(patch.normal()).map(|v| v as f32);
            for i in 0..counts[0] as usize {
                for j in 0..counts[1] as usize {
                    let [a, b] =
                        [(i, counts[0]), (j, counts[1])].map(|(i, n)| (i as f64 + 0.5) / n);
                    let at: [f64; 3] = (Vector3::from(patch.corner_m) + u * a + v * b).into();
                    points.push(StartPoint {
                        position_m: sector_from_here.apply(at).map(|v| v as f32),
                        normal: Some(normal),
                        spacing_m: 2.0 * SIGMA_RATIO * spacing_m as f32,
                        sigma_m: THICKNESS_M,
                        color: pattern(patch.color, at),
                    });
                }
            }
        }
        let splats = splats_from_points(&points).map_err(|e| wrong(e.to_string()))?;
        let (degree, mut planes) = (splats.degree(), splats.planes().to_vec());
        planes[Plane::SCALE + 2].fill(libm::logf(THICKNESS_M));
        planes[Plane::OPACITY].fill(OPACITY_LOGIT);
        Splats::from_planes(degree, planes).map_err(|e| wrong(e.to_string()))
    }
}

/// A color that varies smoothly with the position, within a quarter.
fn pattern(color: [f32; 3], at_m: [f64; 3]) -> [f32; 3] {
    let wave = |length_m: f64, phase: f64| {
        let along = at_m[0] + 0.7 * at_m[1] + 1.3 * at_m[2];
        libm::sin(along / length_m + phase) * libm::cos((at_m[1] - at_m[2]) / length_m - phase)
    };
    let shade = |channel: f64| 1.0 + 0.125 * (wave(0.35, channel) + wave(1.1, 2.0 * channel));
    [0, 1, 2].map(|k| (color[k] * shade(k as f64) as f32).clamp(0.0, 1.0))
}
