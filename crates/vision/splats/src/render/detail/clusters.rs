//! Clusters of neighboring Gaussians: what a camera can see of them, and at which level.

use std::ops::Range;

use super::baked::Row;
use super::region::Camera;
use crate::lanes::{LANES, Lanes};
use crate::render::geometry::{dot, splat3x3};

/// Rows of eight clusters: center in the world, m; radius of a sphere around all that has pixels,
/// m; largest distance of a mean from the center, m.
const ROWS: usize = 5;

/// A level of a cluster.
#[derive(Clone, Debug)]
pub(super) struct Level {
    /// Gaussians, as indices of the scene of all levels.
    pub(super) range: Range<usize>,
    /// The same as blocks of eight.
    pub(super) blocks: Range<usize>,
    /// Mean of the largest standard deviations, m.
    pub(super) sigma_m: f32,
}

/// A sphere around a cluster.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sphere {
    pub(super) center: [f32; 3],
    /// Around all that has pixels, m.
    pub(super) radius_m: f32,
    /// Around the means, m.
    pub(super) spread_m: f32,
}

/// A cluster that a camera may see.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    /// Smallest depth of a mean, m.
    pub(super) z_m: f32,
    /// In the camera, m.
    pub(super) center: [f32; 3],
    pub(super) radius_m: f32,
    pub(super) cluster: u32,
    /// Index among all levels.
    level: u32,
}

/// All clusters of a scene.
#[derive(Clone, Debug, Default)]
pub(super) struct Clusters {
    spheres: Vec<[Row; ROWS]>,
    /// Levels of all clusters, each from the originals to the coarsest.
    levels: Vec<Level>,
    /// First level of each cluster, and their number.
    first: Vec<u32>,
}

impl Clusters {
    pub(super) fn push(&mut self, sphere: &Sphere, levels: Vec<Level>) {
        let count = self.first.len();
        if count % LANES == 0 {
            self.spheres.push([[0.0; LANES]; ROWS]);
        }
        let rows = &mut self.spheres[count / LANES];
        let [x, y, z] = sphere.center;
        let values = [x, y, z, sphere.radius_m, sphere.spread_m];
        for (row, value) in rows.iter_mut().zip(values) {
            row[count % LANES] = value;
        }
        self.first.push(self.levels.len() as u32);
        self.levels.extend(levels);
    }

    /// The chosen level of a candidate.
    pub(super) fn level(&self, candidate: &Candidate) -> &Level {
        &self.levels[candidate.level as usize]
    }

    /// Its Gaussians as blocks of eight.
    pub(super) fn blocks(&self, candidate: &Candidate) -> Range<usize> {
        self.level(candidate).blocks.clone()
    }

    fn levels_of(&self, cluster: usize) -> Range<usize> {
        let end = self.first.get(cluster + 1);
        self.first[cluster] as usize..end.map_or(self.levels.len(), |end| *end as usize)
    }

    /// Clusters that can have pixels in the region of a camera, the one with the nearest mean first.
    /// Cameras with distortion or in motion see all in front.
    #[inline(always)]
    pub(super) fn find<V: Lanes>(
        &self,
        camera: &Camera<'_>,
        max_sigma_px: f32,
        out: &mut Vec<Candidate>,
    ) {
        let s = V::splat;
        out.clear();
        let view = camera.view;
        let is_pinhole = view.lens.is_none() && view.rolling.is_none();
        let rotation = splat3x3::<V>(&view.rotation);
        let near_m = camera.config.near_m;
        let focal = view.focal[0].max(view.focal[1]);
        // Slopes of the sides of the region, and the length of (1, slope).
        let mut sides = [[s(0.0); 4]; 2];
        for k in 0..2 {
            let center = view.principal[k] - camera.rectangle.origin[k] as f32;
            let low = (-super::BORDER_PX - center) / view.focal[k];
            let size = camera.rectangle.size[k] as f32;
            let high = (size + super::BORDER_PX - center) / view.focal[k];
            let length = |slope: f32| (1.0 + slope * slope).sqrt();
            sides[k] = [s(low), s(length(low)), s(high), s(length(high))];
        }
        for (group, rows) in self.spheres.iter().enumerate() {
            let mut offset = [s(0.0); 3];
            for k in 0..3 {
                offset[k] = V::load(&rows[k]) - s(view.center[k]);
            }
            let radius = V::load(&rows[3]);
            let mut at = [s(0.0); 3];
            for k in 0..3 {
                at[k] = dot(&rotation[k], &offset);
            }
            let count = (self.first.len() - group * LANES).min(LANES);
            let mut visible = (1 << count) - 1;
            visible &= !(at[2] + radius).less(s(near_m)).bits();
            if is_pinhole {
                for k in 0..2 {
                    let [low, low_length, high, high_length] = sides[k];
                    let outside = (at[k] - low * at[2]).less(-(radius * low_length));
                    let beyond = (radius * high_length).less(at[k] - high * at[2]);
                    visible &= !outside.or(beyond).bits();
                }
            }
            if visible == 0 {
                continue;
            }
            let nearest = (at[2] - V::load(&rows[4])).max(s(near_m.max(1e-3)));
            let mut values = [[0.0; LANES]; 4];
            at[0].store(&mut values[0]);
            at[1].store(&mut values[1]);
            at[2].store(&mut values[2]);
            nearest.store(&mut values[3]);
            while visible != 0 {
                let lane = visible.trailing_zeros() as usize % LANES;
                visible &= visible - 1;
                let z_m = values[3][lane];
                let cluster = group * LANES + lane;
                let of_cluster = self.levels_of(cluster);
                // The coarsest one that is small enough in the image; else the originals.
                let mut level = of_cluster.end - 1;
                while level > of_cluster.start
                    && self.levels[level].sigma_m * focal > max_sigma_px * z_m
                {
                    level -= 1;
                }
                out.push(Candidate {
                    z_m,
                    center: [values[0][lane], values[1][lane], values[2][lane]],
                    radius_m: rows[3][lane],
                    cluster: cluster as u32,
                    level: level as u32,
                });
            }
        }
        out.sort_unstable_by_key(|candidate| (candidate.z_m.to_bits(), candidate.cluster));
    }
}
