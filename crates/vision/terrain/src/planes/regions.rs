//! Plane regions of a mesh, by region growing.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use super::frame::PlaneFrame;
use crate::config::PlaneConfig;
use crate::mesh::Mesh;

/// Maximum gap between regions that are merged, m.
const MERGE_GAP_M: f64 = 0.06;

/// Least and greatest coordinates.
type Bounds = (Vector3<f64>, Vector3<f64>);

/// A region with its bounds and moments.
type RegionSummary = (Region, Bounds, Moments);

/// Vertices on a plane.
pub(crate) struct Region {
    pub(crate) frame: PlaneFrame,
    /// Ascending.
    pub(crate) vertices: Vec<u32>,
}

/// Neighbors of each vertex.
struct Adjacency {
    start: Vec<u32>,
    neighbors: Vec<u32>,
}

impl Adjacency {
    fn of(mesh: &Mesh) -> Self {
        let mut pairs = Vec::with_capacity(6 * mesh.triangles.len());
        for [a, b, c] in &mesh.triangles {
            pairs.extend([(*a, *b), (*b, *a), (*b, *c), (*c, *b), (*c, *a), (*a, *c)]);
        }
        pairs.sort_unstable();
        pairs.dedup();
        let mut start = vec![0; mesh.positions.len() + 1];
        for (from, _) in &pairs {
            start[*from as usize + 1] += 1;
        }
        for i in 1..start.len() {
            start[i] += start[i - 1];
        }
        Self {
            start,
            neighbors: pairs.into_iter().map(|(_, to)| to).collect(),
        }
    }

    fn of_vertex(&self, vertex: u32) -> &[u32] {
        let range = [0, 1].map(|k| self.start[vertex as usize + k] as usize);
        &self.neighbors[range[0]..range[1]]
    }
}

/// Moments of points, for a plane of least squares.
#[derive(Clone, Default)]
struct Moments {
    count: f64,
    sum: Vector3<f64>,
    square: Matrix3<f64>,
    normals: Vector3<f64>,
}

impl Moments {
    fn add(&mut self, x: &Vector3<f64>, normal: &Vector3<f64>) {
        self.count += 1.0;
        self.sum += x;
        self.square += x * x.transpose();
        self.normals += normal;
    }

    fn sum(&self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            sum: self.sum + other.sum,
            square: self.square + other.square,
            normals: self.normals + other.normals,
        }
    }

    /// Mean and normal on the side of the mean normal.
    fn plane(&self) -> (Vector3<f64>, Vector3<f64>) {
        (self.sum / self.count, self.normal().0)
    }

    /// Normal, and root mean square distance from the plane.
    fn normal(&self) -> (Vector3<f64>, f64) {
        let mean = self.sum / self.count;
        let covariance = self.square / self.count - mean * mean.transpose();
        let eigen = SymmetricEigen::new(covariance);
        let least = eigen.eigenvalues.imin();
        let normal = eigen.eigenvectors.column(least).into_owned();
        let deviation = eigen.eigenvalues[least].max(0.0).sqrt();
        match normal.dot(&self.normals) < 0.0 {
            true => (-normal, deviation),
            false => (normal, deviation),
        }
    }
}

/// Regions with at least the area of the configuration, the flattest surroundings first.
pub(crate) fn grow(mesh: &Mesh, config: &PlaneConfig) -> Vec<Region> {
    let adjacency = Adjacency::of(mesh);
    let positions: Vec<Vector3<f64>> = vectors(&mesh.positions);
    let normals: Vec<Vector3<f64>> = vectors(&mesh.normals);
    let areas = vertex_areas(mesh);
    let flatness = |i: u32| {
        let normal = &normals[i as usize];
        let of = |j: &u32| 1.0 - normal.dot(&normals[*j as usize]);
        adjacency.of_vertex(i).iter().map(of).fold(0.0, f64::max)
    };
    let mut seeds: Vec<(f64, u32)> = (0..positions.len() as u32)
        .map(|i| (flatness(i), i))
        .collect();
    seeds.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let min_cos = cos(config.max_normal_angle_rad);
    let mut owner = vec![false; positions.len()];
    let mut tried = vec![u32::MAX; positions.len()];
    // Seeds in a region that was too small would grow it again.
    let mut is_spent = vec![false; positions.len()];
    let mut regions = Vec::new();
    for (round, (flatness, seed)) in seeds.iter().enumerate() {
        if owner[*seed as usize] || is_spent[*seed as usize] || *flatness > 1.0 - min_cos {
            continue;
        }
        let start = positions[*seed as usize];
        let (mut mean, mut normal) = (start, normals[*seed as usize]);
        let mut moments = Moments::default();
        let (mut vertices, mut next, mut refit_at) = (vec![*seed], 0, 8);
        tried[*seed as usize] = round as u32;
        while next < vertices.len() {
            let i = vertices[next] as usize;
            next += 1;
            moments.add(&(positions[i] - start), &normals[i]);
            if vertices.len() >= refit_at && next >= 8 {
                let (center, fitted) = moments.plane();
                (mean, normal) = (center + start, fitted);
                refit_at *= 2;
            }
            for j in adjacency.of_vertex(vertices[next - 1]) {
                let k = *j as usize;
                if owner[k] || tried[k] == round as u32 {
                    continue;
                }
                let x = &positions[k];
                let gate = (config.max_vertex_sigmas * f64::from(mesh.sigma_m[k]))
                    .max(config.min_vertex_distance_m);
                if normal.dot(&(x - mean)).abs() <= gate
                    && normal.dot(&normals[k]) >= min_cos
                    && (x - start).norm() <= config.max_radius_m
                {
                    tried[k] = round as u32;
                    vertices.push(*j);
                }
            }
        }
        let area: f64 = vertices.iter().map(|i| areas[*i as usize]).sum();
        if area < config.min_area_m2 {
            for i in &vertices {
                is_spent[*i as usize] = true;
            }
            continue;
        }
        let (center, normal) = moments.plane();
        vertices.sort_unstable();
        for i in &vertices {
            owner[*i as usize] = true;
        }
        regions.push(Region {
            frame: PlaneFrame::new(center + start, normal),
            vertices,
        });
    }
    merged(regions, &positions, &normals, config)
}

/// Regions with smaller ones beside them that are on their planes.
fn merged(
    mut regions: Vec<Region>,
    positions: &[Vector3<f64>],
    normals: &[Vector3<f64>],
    config: &PlaneConfig,
) -> Vec<Region> {
    regions.sort_by_key(|region| (std::cmp::Reverse(region.vertices.len()), region.vertices[0]));
    let min_cos = cos(config.max_merge_angle_rad);
    let Some(origin) = regions.first().map(|region| region.frame.origin) else {
        return regions;
    };
    let bounds = |region: &Region| -> Bounds {
        let start = (
            Vector3::repeat(f64::INFINITY),
            Vector3::repeat(f64::NEG_INFINITY),
        );
        region.vertices.iter().fold(start, |(low, high), i| {
            let x = &positions[*i as usize];
            (low.inf(x), high.sup(x))
        })
    };
    let moments = |region: &Region| {
        let mut moments = Moments::default();
        for i in &region.vertices {
            moments.add(&(positions[*i as usize] - origin), &normals[*i as usize]);
        }
        moments
    };
    let mut kept: Vec<RegionSummary> = Vec::new();
    for region in regions {
        let (own_bounds, own) = (bounds(&region), moments(&region));
        let part_of = kept.iter().position(|(larger, (low, high), moments)| {
            let touches = (0..3).all(|k| {
                low[k] - MERGE_GAP_M <= own_bounds.1[k] && own_bounds.0[k] - MERGE_GAP_M <= high[k]
            });
            let is_near = (region.frame.origin - larger.frame.origin).norm() <= config.max_radius_m;
            touches && is_near && {
                let (joint, deviation) = moments.sum(&own).normal();
                deviation <= config.max_merge_m
                    && [&region, larger]
                        .iter()
                        .all(|of| of.frame.normal.dot(&joint) >= min_cos)
            }
        });
        match part_of {
            Some(number) => {
                let (larger, (low, high), moments) = &mut kept[number];
                larger.vertices.extend(region.vertices);
                larger.vertices.sort_unstable();
                (*low, *high) = (low.inf(&own_bounds.0), high.sup(&own_bounds.1));
                *moments = moments.sum(&own);
                let (center, normal) = moments.plane();
                larger.frame = PlaneFrame::new(center + origin, normal);
            }
            None => kept.push((region, own_bounds, own)),
        }
    }
    kept.into_iter().map(|(region, _, _)| region).collect()
}

/// A third of the area of the triangles around each vertex, m2.
fn vertex_areas(mesh: &Mesh) -> Vec<f64> {
    let mut areas = vec![0.0; mesh.positions.len()];
    for triangle in &mesh.triangles {
        let third = mesh.area_m2(*triangle) / 3.0;
        for i in triangle {
            areas[*i as usize] += third;
        }
    }
    areas
}

fn vectors(of: &[[f32; 3]]) -> Vec<Vector3<f64>> {
    of.iter().map(|v| Vector3::from(v.map(f64::from))).collect()
}

/// Cosine of a small angle, by its series: the same on every machine.
fn cos(angle: f64) -> f64 {
    let square = angle * angle;
    1.0 - square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0))
}
