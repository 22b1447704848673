//! Planes of the ground and of steps, refitted to the depths themselves.
//!
//! A voxel rounds the edges of stairs; the planes of treads and risers, each with thousands of
//! depths, do not. Contract: regions of the mesh that are plane within the sigmas of their vertices
//! are candidates ([`PlaneRefiner::new`]). Every view is given once more ([`PlaneRefiner::add`]);
//! memory grows with the candidates and the number of views that see each. Planes that the depths
//! confirm are the result ([`PlaneRefiner::finish`]): smooth ground that is curved, and rough
//! ground, have none.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use crate::config::PlaneConfig;
use crate::error::TerrainError;
use crate::mesh::Mesh;
use crate::view::{DepthView, Pose};

mod assignment;
mod ends;
pub(crate) mod frame;
mod outlines;
mod patches;
mod plane;
mod polygon;
mod regions;
pub(crate) mod sums;
pub(crate) mod support;

pub use self::{outlines::PlaneOutline, plane::Plane, polygon::Polygon};

use assignment::{Assigner, Extent, Lookup};
use patches::Patches;
use sums::ViewSums;
use support::SupportGrid;

/// Planes, and the vertices of the mesh on each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Planes {
    /// The planes.
    pub planes: Vec<Plane>,
    /// Plane of each vertex of the mesh.
    pub of_vertex: Vec<Option<u32>>,
    /// The configuration.
    pub config: PlaneConfig,
}

/// See the module.
#[derive(Debug)]
pub struct PlaneRefiner {
    config: PlaneConfig,
    extents: Vec<Extent>,
    vertices: Vec<Vec<u32>>,
    vertex_count: usize,
    lookup: Lookup,
    collected: Vec<CandidateViews>,
    views: u32,
    dropped: usize,
}

/// What views show of a candidate.
#[derive(Debug, Default)]
struct CandidateViews {
    sums: Vec<ViewSums>,
    support: SupportGrid,
    patches: Patches,
    /// Sums of coordinates and number of ends in each cell of the support.
    ends: BTreeMap<u32, ([f64; 2], u32)>,
    /// Views with ends, and the sum of the squared sigmas of their poses, m2.
    end_views: u32,
    end_pose_squares: f64,
}

impl PlaneRefiner {
    /// Number of candidates beyond those that 16 bits count, the smallest ones: they are no planes.
    pub fn dropped_candidates(&self) -> usize {
        self.dropped
    }

    /// Finds the candidates.
    pub fn new(mesh: &Mesh, config: &PlaneConfig) -> Self {
        let mut regions = regions::grow(mesh, config);
        // Numbers of planes are 16 bits; the largest ones come first.
        regions.sort_by_key(|region| std::cmp::Reverse(region.vertices.len()));
        let dropped = regions.len().saturating_sub(usize::from(assignment::NONE));
        regions.truncate(usize::from(assignment::NONE));
        let area: f64 = mesh.triangles.iter().map(|t| mesh.area_m2(*t)).sum();
        let spacing = (area / mesh.positions.len().max(1) as f64).sqrt();
        let cell_m = (1.3 * spacing).max(config.support_cell_m);
        let mut refiner = Self {
            config: *config,
            extents: Vec::new(),
            vertices: Vec::new(),
            vertex_count: mesh.positions.len(),
            lookup: Lookup::default(),
            collected: Vec::new(),
            views: 0,
            dropped,
        };
        for (number, region) in regions.into_iter().enumerate() {
            let frame = region.frame;
            let positions = region
                .vertices
                .iter()
                .map(|i| Vector3::from(mesh.positions[*i as usize].map(f64::from)));
            let at = positions.clone().map(|x| {
                let [s, t, _] = frame.coordinates(&x);
                [s, t]
            });
            let mut grid = SupportGrid::around(cell_m, at.clone(), 3.0 * cell_m);
            at.clone().for_each(|at| grid.add(at));
            let closed = grid.grown(&grid.grown(&grid.mask(1), 1, true), 1, false);
            let support = SupportGrid::around(config.support_cell_m, at, 3.0 * cell_m);
            positions.for_each(|x| refiner.lookup.add(number as u16, &x));
            refiner.extents.push(Extent {
                frame,
                interior: grid.grown(&closed, 1, false),
                wide: grid.grown(&closed, 2, true),
                closed,
                grid,
            });
            refiner.collected.push(CandidateViews {
                patches: Patches::around(&support),
                support,
                ..CandidateViews::default()
            });
            refiner.vertices.push(region.vertices);
        }
        refiner
    }

    /// Number of candidates.
    pub fn candidates(&self) -> usize {
        self.extents.len()
    }

    /// Adds the depths of a view.
    ///
    /// # Errors
    /// [`TerrainError::ImageSize`] and [`TerrainError::View`].
    pub fn add(&mut self, view: &DepthView<'_>) -> Result<(), TerrainError> {
        view.validate()?;
        let assigner = Assigner {
            config: &self.config,
            extents: &self.extents,
            lookup: &self.lookup,
            view,
            pose: Pose::new(&view.world_from_view),
        };
        let assignment = assigner.run();
        let ends = ends::ends(&assigner, &assignment);
        for (plane, sums) in &assignment.sums {
            let of_plane = &mut self.collected[usize::from(*plane)].sums;
            match of_plane.last_mut().filter(|last| last.view == self.views) {
                Some(last) => last.merge(sums),
                None => {
                    let mut sums = *sums;
                    sums.view = self.views;
                    of_plane.push(sums);
                }
            }
        }
        for hit in &assignment.hits {
            let collected = &mut self.collected[usize::from(hit.plane)];
            let [s, t, height] = hit.at;
            collected.support.add_square([s, t], hit.reach);
            if hit.is_certain {
                collected.patches.add([s, t], height, hit.sigma);
            }
        }
        let mut with_ends: Vec<u16> = ends.iter().map(|(plane, _)| *plane).collect();
        with_ends.sort_unstable();
        with_ends.dedup();
        for plane in with_ends {
            let collected = &mut self.collected[usize::from(plane)];
            collected.end_views += 1;
            collected.end_pose_squares += view.pose_sigma_m * view.pose_sigma_m;
        }
        for (plane, at) in ends {
            let collected = &mut self.collected[usize::from(plane)];
            if let Some(cell) = collected.support.index(at) {
                let (sum, count) = collected.ends.entry(cell as u32).or_default();
                *sum = [sum[0] + at[0], sum[1] + at[1]];
                *count += 1;
            }
        }
        self.views += 1;
        Ok(())
    }

    /// The planes that the depths confirm, the largest region first.
    pub fn finish(self) -> Planes {
        let mut planes = Planes {
            planes: Vec::new(),
            of_vertex: vec![None; self.vertex_count],
            config: self.config,
        };
        let candidates = self
            .extents
            .into_iter()
            .zip(self.collected)
            .zip(&self.vertices);
        for ((extent, collected), vertices) in candidates {
            let Some(plane) = fitted(&self.config, extent, collected) else {
                continue;
            };
            for i in vertices {
                planes.of_vertex[*i as usize] = Some(planes.planes.len() as u32);
            }
            planes.planes.push(plane);
        }
        planes
    }
}

fn fitted(config: &PlaneConfig, extent: Extent, collected: CandidateViews) -> Option<Plane> {
    let CandidateViews {
        mut sums,
        support,
        patches,
        ends,
        end_views,
        end_pose_squares,
    } = collected;
    sums.retain(|sums| sums.depths >= config.min_view_depths);
    let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
    let (mut square, mut freedom, mut depths) = (0.0, 0.0, 0);
    for view in &sums {
        let (of_matrix, of_right) = view.marginalized(
            config.correlated_samples,
            config.common_ratio,
            config.view_tilt_sigma_rad,
        );
        matrix += of_matrix;
        right += of_right;
        let (of_square, of_freedom) = view.residual();
        square += of_square;
        freedom += of_freedom;
        depths += u64::from(view.depths);
    }
    let covariance = matrix.try_inverse()?;
    let chi_square = square / f64::max(freedom, 1.0);
    if chi_square > config.max_chi_square {
        return None;
    }
    let height = covariance * right;
    if patches.is_rough(&height, config) {
        return None;
    }
    let frame = extent.frame.adjusted(height.into());
    let seen = support.mask(support.min_count(config.min_cell_share));
    let observed = support.grown(&support.grown(&seen, 1, true), 1, false);
    let cells = observed.iter().filter(|is| **is).count();
    let area_m2 = cells as f64 * support.cell_m * support.cell_m;
    if area_m2 < config.min_area_m2 {
        return None;
    }
    let count = |(sum, count): ([f64; 2], u32)| (sum.map(|s| s / f64::from(count)), count);
    Some(Plane {
        center: frame.origin.into(),
        normal: frame.normal.into(),
        axes: [frame.u.into(), frame.v.into()],
        sigma_m: covariance[(0, 0)].max(0.0).sqrt(),
        tilt_sigma_rad: [1, 2].map(|k| covariance[(k, k)].max(0.0).sqrt()),
        depths,
        views: sums.len(),
        chi_square,
        area_m2,
        polygons: polygon::outlines(&support, &observed, 1.1 * support.cell_m),
        frame,
        sums_frame: extent.frame,
        height,
        covariance,
        sums,
        observed,
        ends: ends.into_values().map(count).collect(),
        // Views have unequal shares: as if half of them had equal ones.
        end_pose_sigma_m: (2.0 * end_pose_squares).sqrt() / f64::from(end_views.max(1)),
        support,
    })
}
