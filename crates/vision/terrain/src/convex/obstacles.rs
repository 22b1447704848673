//! Convex parts of things that are neither plane nor ground, by V-HACD (Mamou 2016) of `parry3d`.
//!
//! The decomposition works on voxels of the surface, in tiles, since its tolerance is relative to
//! the size of what it divides. Backs that no view saw stay open: parts are as thick as a voxel
//! there.

use std::collections::BTreeMap;

use parry3d::math::Vector;
use parry3d::transformation::vhacd::{VHACD, VHACDParameters};
use parry3d::transformation::voxelization::FillMode;
use rayon::prelude::*;

use crate::config::ObstacleConfig;
use crate::maps::{FREE, Level};
use crate::mesh::{Mesh, connected};
use crate::planes::Planes;

/// A convex part of a thing.
#[derive(Clone, Debug, PartialEq)]
pub struct Obstacle {
    /// Corners, m.
    pub vertices: Vec<[f64; 3]>,
    /// Triangles of its hull, counterclockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// Parts of all surfaces that are on no plane and not the ground of a level.
pub fn obstacle_parts(
    mesh: &Mesh,
    planes: &Planes,
    levels: &[Level],
    config: &ObstacleConfig,
) -> Vec<Obstacle> {
    let mut tiles: BTreeMap<[i32; 3], Vec<[u32; 3]>> = BTreeMap::new();
    for triangle in &mesh.triangles {
        let middle = [0, 1, 2].map(|k| {
            triangle
                .iter()
                .map(|i| f64::from(mesh.positions[*i as usize][k]))
                .sum::<f64>()
                / 3.0
        });
        let is_plane = triangle
            .iter()
            .all(|i| planes.of_vertex[*i as usize].is_some());
        let is_ground = levels.iter().any(|level| is_ground(level, middle, config));
        if !is_plane && !is_ground {
            let tile = middle.map(|v| (v / config.tile_m).floor() as i32);
            tiles.entry(tile).or_default().push(*triangle);
        }
    }
    // Things that do not touch have no hull in common.
    let things: Vec<Vec<[u32; 3]>> = tiles.values().flat_map(|own| connected(own)).collect();
    let parts: Vec<Vec<Obstacle>> = things
        .par_iter()
        .map(|triangles| decompose(mesh, triangles, config))
        .collect();
    parts.into_iter().flatten().collect()
}

/// Whether a point is on the free ground of a level, or on the face of a step between the grounds
/// of neighboring cells.
fn is_ground(level: &Level, [x, y, z]: [f64; 3], config: &ObstacleConfig) -> bool {
    let Some(index) = level.index(x, y) else {
        return false;
    };
    let near = level.near(index, 1.5 * level.cell_m);
    let cells = std::iter::once(index).chain(near.map(|(other, _)| other));
    let (mut is_above, mut is_below) = (false, false);
    for cell in cells.filter(|cell| level.occupancy[*cell] == FREE) {
        let [lower, upper] = [&level.lower, &level.upper].map(|of| z - f64::from(of[cell]));
        is_above |= (-config.ground_m..=config.max_step_m).contains(&lower);
        is_below |= (-config.max_step_m..=config.ground_m).contains(&upper);
    }
    is_above && is_below
}

fn decompose(mesh: &Mesh, triangles: &[[u32; 3]], config: &ObstacleConfig) -> Vec<Obstacle> {
    let area: f64 = triangles
        .iter()
        .map(|triangle| mesh.area_m2(*triangle))
        .sum();
    if area < config.min_area_m2 {
        return Vec::new();
    }
    let mut numbers: Vec<u32> = triangles.iter().flatten().copied().collect();
    numbers.sort_unstable();
    numbers.dedup();
    // From the first vertex: 32 bits have few digits far from the origin.
    let origin = mesh.positions[numbers[0] as usize].map(f64::from);
    let position = |i: &u32| {
        let x = mesh.positions[*i as usize].map(f64::from);
        [0, 1, 2].map(|k| (x[k] - origin[k]) as f32)
    };
    let points: Vec<Vector> = numbers
        .iter()
        .map(position)
        .map(|[x, y, z]| Vector::new(x, y, z))
        .collect();
    let indices: Vec<[u32; 3]> = triangles
        .iter()
        .map(|triangle| triangle.map(|i| numbers.binary_search(&i).unwrap_or(0) as u32))
        .collect();
    let extent = (0..3).map(|k| {
        let of = |i: &u32| position(i)[k];
        let high = numbers.iter().map(of).fold(f32::NEG_INFINITY, f32::max);
        high - numbers.iter().map(of).fold(f32::INFINITY, f32::min)
    });
    let extent = f64::from(extent.fold(0.0, f32::max));
    let parameters = VHACDParameters {
        concavity: config.concavity as f32,
        resolution: (extent / config.voxel_m).ceil().clamp(4.0, 128.0) as u32,
        fill_mode: FillMode::SurfaceOnly,
        max_convex_hulls: config.max_parts,
        ..VHACDParameters::default()
    };
    let parts = VHACD::decompose(&parameters, &points, &indices, false).compute_convex_hulls(1);
    let obstacle = |(vertices, triangles): (Vec<Vector>, Vec<[u32; 3]>)| Obstacle {
        vertices: vertices
            .iter()
            .map(|v| [v.x, v.y, v.z])
            .map(|v| [0, 1, 2].map(|k| origin[k] + f64::from(v[k])))
            .collect(),
        triangles,
    };
    parts
        .into_iter()
        .map(obstacle)
        .filter(|part| part.triangles.len() >= 4)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball of 20 cm, 1 m above the origin.
    fn ball() -> Mesh {
        let mut mesh = Mesh::default();
        let (rings, sectors) = (24, 48);
        for ring in 0..=rings {
            for sector in 0..sectors {
                let polar = std::f64::consts::PI * f64::from(ring) / f64::from(rings);
                let azimuth = std::f64::consts::TAU * f64::from(sector) / f64::from(sectors);
                let n = [
                    polar.sin() * azimuth.cos(),
                    polar.sin() * azimuth.sin(),
                    polar.cos(),
                ];
                mesh.normals.push(n.map(|v| v as f32));
                let x = [0.2 * n[0], 0.2 * n[1], 1.0 + 0.2 * n[2]];
                mesh.positions.push(x.map(|v| v as f32));
            }
        }
        for ring in 0..rings {
            for sector in 0..sectors {
                let at = |r: i32, s: i32| ((ring + r) * sectors + (sector + s) % sectors) as u32;
                let [a, b, c, d] = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
                mesh.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        let count = mesh.positions.len();
        mesh.colors = vec![[0; 3]; count];
        mesh.sigma_m = vec![0.01; count];
        mesh.views = vec![3; count];
        mesh
    }

    #[test]
    fn parts_cover_the_thing_within_voxels() {
        let mesh = ball();
        let planes = Planes {
            of_vertex: vec![None; mesh.positions.len()],
            ..Planes::default()
        };
        let config = ObstacleConfig::default();
        let parts = obstacle_parts(&mesh, &planes, &[], &config);
        assert!(!parts.is_empty() && parts.len() <= 8 * config.max_parts as usize);
        let distance = |x: &[f64; 3]| {
            ((x[0] * x[0] + x[1] * x[1] + (x[2] - 1.0) * (x[2] - 1.0)).sqrt() - 0.2).abs()
        };
        for part in &parts {
            assert!(
                part.triangles
                    .iter()
                    .flatten()
                    .all(|i| (*i as usize) < part.vertices.len())
            );
            let farthest = part.vertices.iter().map(distance).fold(0.0, f64::max);
            assert!(farthest < 2.5 * config.voxel_m, "{farthest}");
        }
        // Every direction has a corner nearby.
        for n in &mesh.normals {
            let nearest = parts.iter().flat_map(|part| &part.vertices).map(|x| {
                let d = [0, 1, 2].map(|k| x[k] - [0.0, 0.0, 1.0][k] - 0.2 * f64::from(n[k]));
                (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
            });
            assert!(nearest.fold(f64::INFINITY, f64::min) < 0.15);
        }
        assert_eq!(parts, obstacle_parts(&mesh, &planes, &[], &config));
        // On planes there is nothing left.
        let planes = Planes {
            of_vertex: vec![Some(0); mesh.positions.len()],
            ..Planes::default()
        };
        assert_eq!(obstacle_parts(&mesh, &planes, &[], &config), []);
    }
}
