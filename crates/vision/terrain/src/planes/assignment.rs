//! Which depths of a view belong to which plane.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::frame::PlaneFrame;
use super::sums::ViewSums;
use super::support::SupportGrid;
use crate::config::PlaneConfig;
use crate::fusion::grid::{KeyMap, pack};
use crate::view::{DepthView, PixelClass};

/// Edge of a cell of the table of planes, m.
const CELL_M: f64 = 0.1;
/// Distance of a depth from the vertices of its plane, m: more than its gate.
const MARGIN_M: f64 = 0.08;
/// Rows that one task works on.
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

/// What a view tells of planes.
#[derive(Debug, Default)]
pub(crate) struct Assignment {
    /// Plane of each pixel.
    pub(crate) labels: Vec<u16>,
    /// Normal equations of planes, in the order of rows.
    pub(crate) sums: Vec<(u16, ViewSums)>,
    /// Coordinates of depths on planes.
    pub(crate) hits: Vec<(u16, [f32; 2])>,
}

/// Assigns the depths of a view.
pub(crate) fn assign(
    config: &PlaneConfig,
    extents: &[Extent],
    lookup: &Lookup,
    view: &DepthView<'_>,
) -> Assignment {
    let width = view.size[0];
    let mut labels = vec![NONE; width * view.size[1]];
    let parts: Vec<_> = labels
        .par_chunks_mut(width * ROWS)
        .enumerate()
        .map(|(chunk, labels)| {
            let mut part = Part {
                config,
                extents,
                view,
                sums: Vec::new(),
                hits: Vec::new(),
            };
            for (i, label) in labels.iter_mut().enumerate() {
                *label = part.pixel(lookup, i % width, chunk * ROWS + i / width);
            }
            (part.sums, part.hits)
        })
        .collect();
    let mut all = Assignment {
        labels,
        ..Assignment::default()
    };
    for (sums, hits) in parts {
        all.sums.extend(sums);
        all.hits.extend(hits);
    }
    all
}

struct Part<'a> {
    config: &'a PlaneConfig,
    extents: &'a [Extent],
    view: &'a DepthView<'a>,
    sums: Vec<(u16, ViewSums)>,
    hits: Vec<(u16, [f32; 2])>,
}

impl Part<'_> {
    fn pixel(&mut self, lookup: &Lookup, column: usize, row: usize) -> u16 {
        let pixel = row * self.view.size[0] + column;
        if self.view.class(pixel) != PixelClass::Static {
            return NONE;
        }
        let Some((depth, sigma)) = self.view.depth(pixel) else {
            return NONE;
        };
        let (u, v) = (column as f64, row as f64);
        let x = Vector3::from(self.view.position(u, v, f64::from(depth)));
        let candidates = lookup.at(&x);
        if candidates.is_empty() {
            return NONE;
        }
        let ray = Vector3::from(self.view.world_from_view.rotate(self.view.ray(u, v)));
        let pose = self.view.pose_sigma_m;
        let (mut best, mut count) = ((false, f64::INFINITY, NONE, [0.0; 3], 0.0), 0);
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
            // Where the ray meets the plane: the place of the depth itself has its error.
            let [s, t, _] = frame.coordinates(&(x - ray * (height / slope)));
            let common = self.config.common_ratio * along;
            let combined = (along * along + pose * pose + common * common).sqrt();
            let gate =
                (self.config.max_depth_sigmas * combined).max(self.config.min_vertex_distance_m);
            let Some(index) = extent
                .grid
                .index([s, t])
                .filter(|index| extent.wide[*index])
            else {
                continue;
            };
            if height.abs() > gate {
                continue;
            }
            // Which plane a ray ends at follows from the ray, not from the error of its depth.
            let is_closed = extent.closed[index];
            count += usize::from(is_closed);
            let rank = height.abs() / gate;
            if (is_closed && !best.0) || (is_closed == best.0 && rank < best.1) {
                best = (is_closed, rank, *plane, [s, t, height], along);
            }
        }
        let (_, _, plane, at, along) = best;
        if plane == NONE {
            return NONE;
        }
        self.hits.push((plane, [at[0] as f32, at[1] as f32]));
        let extent = &self.extents[usize::from(plane)];
        let is_interior = extent
            .grid
            .index([at[0], at[1]])
            .is_some_and(|index| extent.interior[index]);
        // Rays that may end at two planes belong to neither for certain.
        if is_interior && count == 1 {
            let position = self.sums.iter().position(|(of, _)| *of == plane);
            let position = position.unwrap_or_else(|| {
                self.sums.push((plane, ViewSums::default()));
                self.sums.len() - 1
            });
            // Half a millimetre: rounding of stored depths.
            self.sums[position].1.add(at, along.hypot(5e-4), pose);
        }
        plane
    }
}
