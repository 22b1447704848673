//! The hierarchy of clusters, and what a camera takes of it.
//!
//! Leaves are clusters of neighboring Gaussians of the scene. A node above them holds the Gaussians
//! of its children merged, in a number like that of a leaf: nodes grow with the distance.

use std::ops::Range;

use super::camera::{BORDER_PX, RegionCamera};

/// A cluster at one level.
#[derive(Clone, Debug)]
pub(super) struct Node {
    pub(super) sphere: Sphere,
    /// Gaussians, as indices of the scene of all levels.
    pub(super) range: Range<usize>,
    /// The same as blocks of eight.
    pub(super) blocks: Range<usize>,
    /// Mean of the largest standard deviations, m.
    pub(super) sigma_m: f32,
    /// Nodes of the level below; none of a leaf.
    pub(super) children: Range<usize>,
}

/// A sphere around a cluster.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sphere {
    /// In the world, m.
    pub(super) center: [f32; 3],
    /// Around all that has pixels, m.
    pub(super) radius_m: f32,
    /// Around the means, m.
    pub(super) spread_m: f32,
}

/// A node that a camera takes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    /// Smallest depth of a mean, m.
    pub(super) z_m: f32,
    /// In the camera, m.
    pub(super) center: [f32; 3],
    pub(super) radius_m: f32,
    pub(super) node: u32,
}

/// All nodes, level by level from the leaves on.
#[derive(Clone, Debug, Default)]
pub(super) struct Nodes {
    pub(super) all: Vec<Node>,
    /// The highest level.
    pub(super) roots: Range<usize>,
}

impl Nodes {
    /// Nodes that can have pixels in the region of a camera, the one with the nearest mean first:
    /// of each branch the highest one whose Gaussians are small in the image. Cameras with
    /// distortion or in motion see all in front.
    pub(super) fn find(
        &self,
        camera: &RegionCamera<'_>,
        max_sigma_px: f32,
        open: &mut Vec<usize>,
        out: &mut Vec<Candidate>,
    ) {
        out.clear();
        open.clear();
        open.extend(self.roots.clone());
        let frustum = Frustum::new(camera);
        let focal = camera.view.focal[0].max(camera.view.focal[1]);
        while let Some(index) = open.pop() {
            let node = &self.all[index];
            let Some((center, z_m)) = frustum.sees(&node.sphere) else {
                continue;
            };
            if node.children.is_empty() || node.sigma_m * focal <= max_sigma_px * z_m {
                out.push(Candidate {
                    z_m,
                    center,
                    radius_m: node.sphere.radius_m,
                    node: index as u32,
                });
            } else {
                open.extend(node.children.clone());
            }
        }
        out.sort_unstable_by_key(|candidate| (candidate.z_m.to_bits(), candidate.node));
    }
}

/// What a region of a camera sees.
struct Frustum<'a> {
    camera: &'a RegionCamera<'a>,
    is_pinhole: bool,
    /// Slopes of the sides at low and high coordinates, and lengths of (1, slope).
    sides: [[f32; 4]; 2],
}

impl<'a> Frustum<'a> {
    fn new(camera: &'a RegionCamera<'a>) -> Self {
        let view = camera.view;
        let sides = [0, 1].map(|k: usize| {
            let center = view.principal[k] - camera.rectangle.origin[k] as f32;
            let low = (-BORDER_PX - center) / view.focal[k];
            let size = camera.rectangle.size[k] as f32;
            let high = (size + BORDER_PX - center) / view.focal[k];
            let length = |slope: f32| (1.0 + slope * slope).sqrt();
            [low, length(low), high, length(high)]
        });
        Self {
            camera,
            is_pinhole: view.lens.is_none() && view.rolling.is_none(),
            sides,
        }
    }

    /// The center in the camera and the smallest depth of a mean, if anything can have pixels.
    fn sees(&self, sphere: &Sphere) -> Option<([f32; 3], f32)> {
        let view = self.camera.view;
        let mut offset = sphere.center;
        for k in 0..3 {
            offset[k] -= view.center[k];
        }
        let [x, y, z] = view
            .rotation
            .map(|row| row[0] * offset[0] + row[1] * offset[1] + row[2] * offset[2]);
        let radius = sphere.radius_m;
        let near_m = self.camera.config.near_m;
        if z + radius < near_m {
            return None;
        }
        if self.is_pinhole {
            for (at, [low, low_length, high, high_length]) in [x, y].into_iter().zip(self.sides) {
                if at - low * z < -radius * low_length || at - high * z > radius * high_length {
                    return None;
                }
            }
        }
        Some(([x, y, z], (z - sphere.spread_m).max(near_m).max(1e-3)))
    }
}
