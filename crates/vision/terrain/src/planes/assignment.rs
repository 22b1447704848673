//! Which depths of a view belong to which plane.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::frame::PlaneFrame;
use super::sums::ViewSums;
use super::support::SupportGrid;
use crate::config::PlaneConfig;
use crate::fusion::grid::{KeyMap, pack};
use crate::view::{DepthView, PixelClass, Pose};

/// Edge of a cell of the table of planes, m.
const CELL_M: f64 = 0.1;
/// Distance of a depth from the vertices of its plane, m: more than its gate.
const MARGIN_M: f64 = 0.08;
/// Every second column and row is assigned: neighboring pixels share most of their errors.
pub(crate) const STRIDE: usize = 2;
/// Samples on planes that are seen at a shallow angle stand for at most this share more.
const MIN_REACH_COS: f64 = 0.4;
/// Sampled rows that one task works on.
const ROWS: usize = 16;
/// A pixel of no plane.
pub(crate) const NONE: u16 = u16::MAX;

/// Where a plane is expected.
#[derive(Clone, Debug)]
pub(crate) struct Extent {
    pub(crate) frame: PlaneFrame,
    /// The region of the mesh.
    pub(crate) grid: SupportGrid,
    /// Its cells, without gaps.
    pub(crate) closed: Vec<bool>,
    /// Those away from its border: rays there end at the plane.
    pub(crate) interior: Vec<bool>,
    /// Its cells and those around it: depths there may be of the plane.
    pub(crate) wide: Vec<bool>,
}

/// Planes by their place.
#[derive(Clone, Debug, Default)]
pub(crate) struct Lookup(KeyMap<Vec<u16>>);

impl Lookup {
    pub(crate) fn add(&mut self, plane: u16, x: &Vector3<f64>) {
        let cell = |offset: f64| [0, 1, 2].map(|k| ((x[k] + offset) / CELL_M).floor() as i32);
        let (from, to) = (cell(-MARGIN_M), cell(MARGIN_M));
        for z in from[2]..=to[2] {
            for y in from[1]..=to[1] {
                for x in from[0]..=to[0] {
                    let planes = self.0.entry(pack([x, y, z])).or_default();
                    if planes.last() != Some(&plane) {
                        planes.push(plane);
                    }
                }
            }
        }
    }

    fn at(&self, x: &Vector3<f64>) -> &[u16] {
        let cell = [0, 1, 2].map(|k| (x[k] / CELL_M).floor() as i32);
        self.0.get(&pack(cell)).map_or(&[], Vec::as_slice)
    }
}

/// A depth of a plane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    pub(crate) plane: u16,
    /// Coordinates where the ray meets the plane, and height of the depth above it.
    pub(crate) at: [f64; 3],
    /// One standard deviation along the normal, m.
    pub(crate) sigma: f64,
    /// Half of the distance to the next sample on the plane, m.
    pub(crate) reach: f64,
    /// Whether the ray ends at this plane for certain.
    pub(crate) is_certain: bool,
}

/// What a view shows of planes.
#[derive(Debug, Default)]
pub(crate) struct Assignment {
    /// Columns of samples.
    pub(crate) columns: usize,
    /// Plane of each sample.
    pub(crate) labels: Vec<u16>,
    /// Normal equations of planes, in the order of rows.
    pub(crate) sums: Vec<(u16, ViewSums)>,
    /// Depths on planes.
    pub(crate) hits: Vec<Hit>,
}

/// Assigns depths of a view to planes.
pub(crate) struct Assigner<'a> {
    pub(crate) config: &'a PlaneConfig,
    pub(crate) extents: &'a [Extent],
    pub(crate) lookup: &'a Lookup,
    pub(crate) view: &'a DepthView<'a>,
    pub(crate) pose: Pose,
}

impl Assigner<'_> {
    /// Assigns the samples of the view.
    pub(crate) fn run(&self) -> Assignment {
        let [columns, rows] = self.view.size.map(|size| size.div_ceil(STRIDE));
        let mut labels = vec![NONE; columns * rows];
        let parts: Vec<_> = labels
            .par_chunks_mut(columns * ROWS)
            .enumerate()
            .map(|(chunk, labels)| {
                let mut sums: Vec<(u16, ViewSums)> = Vec::new();
                let mut hits = Vec::new();
                for (i, label) in labels.iter_mut().enumerate() {
                    let row = STRIDE * (chunk * ROWS + i / columns);
                    let Some(hit) = self.hit(STRIDE * (i % columns), row) else {
                        continue;
                    };
                    *label = hit.plane;
                    if hit.is_certain {
                        self.add(&mut sums, &hit);
                    }
                    hits.push(hit);
                }
                (sums, hits)
            })
            .collect();
        let mut all = Assignment {
            columns,
            labels,
            ..Assignment::default()
        };
        for (sums, hits) in parts {
            all.sums.extend(sums);
            all.hits.extend(hits);
        }
        all
    }

    fn add(&self, sums: &mut Vec<(u16, ViewSums)>, hit: &Hit) {
        let position = sums.iter().position(|(of, _)| *of == hit.plane);
        let position = position.unwrap_or_else(|| {
            sums.push((hit.plane, ViewSums::default()));
            sums.len() - 1
        });
        sums[position]
            .1
            .add(hit.at, hit.sigma, self.view.pose_sigma_m);
    }

    /// The plane of a pixel.
    pub(crate) fn hit(&self, column: usize, row: usize) -> Option<Hit> {
        let pixel = row * self.view.size[0] + column;
        if self.view.class(pixel) != PixelClass::Static {
            return None;
        }
        let (depth, sigma) = self.view.depth(pixel)?;
        let (u, v) = (column as f64, row as f64);
        let x = Vector3::from(self.view.position(&self.pose, u, v, f64::from(depth)));
        let candidates = self.lookup.at(&x);
        if candidates.is_empty() {
            return None;
        }
        let ray = Vector3::from(self.pose.rotate(self.view.ray(u, v)));
        let pose_sigma = self.view.pose_sigma_m;
        let reach = 0.5 * STRIDE as f64 * f64::from(depth) / self.view.focal_px[0];
        let (mut best, mut count) = (None, 0);
        // Planes that the mesh shows here come before planes beside them.
        let mut best_rank = (true, f64::INFINITY);
        for plane in candidates {
            let extent = &self.extents[usize::from(*plane)];
            let frame = &extent.frame;
            let height = frame.normal.dot(&(x - frame.origin));
            let slope = frame.normal.dot(&ray);
            let cos = slope.abs();
            // The sigma at the depth of the plane: it grows with the square of the depth, and
            // depths that are too small by chance must not count more.
            let predicted = 1.0 + height / (cos.max(0.05) * f64::from(depth));
            let along = f64::from(sigma) * predicted * predicted * cos;
            if slope > -0.05 || along > self.config.max_sigma_m {
                continue;
            }
            let common = self.config.common_ratio * along;
            let combined = (along * along + pose_sigma * pose_sigma + common * common).sqrt();
            let gate =
                (self.config.max_depth_sigmas * combined).max(self.config.min_vertex_distance_m);
            if height.abs() > gate {
                continue;
            }
            // Where the ray meets the plane: the place of the depth itself has its error. Which
            // plane a ray ends at follows from the ray alone as well.
            let [s, t, _] = frame.coordinates(&(x - ray * (height / slope)));
            let index = extent
                .grid
                .index([s, t])
                .filter(|index| extent.wide[*index]);
            let Some(index) = index else {
                continue;
            };
            let is_closed = extent.closed[index];
            count += u32::from(is_closed);
            let rank = (!is_closed, height.abs() / gate);
            if rank < best_rank {
                best_rank = rank;
                best = Some(Hit {
                    plane: *plane,
                    at: [s, t, height],
                    // Half a millimetre: rounding of stored depths.
                    sigma: along.hypot(5e-4),
                    reach: reach / (cos / ray.norm()).max(MIN_REACH_COS),
                    is_certain: extent.interior[index],
                });
            }
        }
        best.map(|hit| Hit {
            // Rays that may end at two planes belong to neither for certain.
            is_certain: hit.is_certain && count == 1,
            ..hit
        })
    }
}
