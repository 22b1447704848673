//! A step of 17 cm with a map of two levels and parts for physics. Nothing in it is symmetric, so
//! that no axis can be confused with another.

use scene_bundle::Draft;
use scene_bundle::outputs::collision::{
    Collision, CollisionReport, ConvexPart, HeightErrors, HeightLayer, PartKind,
};
use scene_bundle::outputs::grid::Grid;
use scene_bundle::outputs::maps::{self, MapLevel};
use scene_bundle::outputs::terrain::{
    EdgeKind, Step, StepEdge, Terrain, TerrainMesh, TerrainPlane, TerrainPolygon,
};
use scene_bundle::outputs::{collision, terrain};

/// Heights of the two treads, m.
pub(crate) const TREADS_M: [f64; 2] = [0.1, 0.27];

pub(crate) fn write_terrain(draft: &Draft) {
    terrain::write(draft, &terrain(), &dense(), &simplified()).unwrap();
}

pub(crate) fn write_maps(draft: &Draft) {
    maps::write(draft, &levels()).unwrap();
}

pub(crate) fn write_collision(draft: &Draft) {
    collision::write(draft, &collision()).unwrap();
}

pub(crate) fn terrain() -> Terrain {
    let plane = |center_m, normal, axes, outline_m: &[[f64; 2]]| TerrainPlane {
        center_m,
        normal,
        axes,
        sigma_m: 0.0012,
        tilt_sigma_rad: [0.002, 0.003],
        depths: 48_211,
        views: 31,
        chi_square: 1.04,
        area_m2: 2.5,
        polygons: vec![TerrainPolygon {
            outline_m: outline_m.to_vec(),
            holes_m: vec![vec![[0.1, 0.1], [0.1, 0.2], [0.2, 0.1]]],
        }],
    };
    let (x, y, z) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    let square = [[-1.0, -1.5], [1.0, -1.5], [1.0, 1.5], [-1.0, 1.5]];
    let low = [[-1.0, -0.085], [1.0, -0.085], [1.0, 0.085]];
    let edge = |kind, planes, step| StepEdge {
        kind,
        from_m: [2.0, 0.0, 0.27],
        to_m: [2.0, 2.0, 0.27],
        sigma_m: 0.0021,
        planes,
        step,
    };
    let step = Step {
        below: 0,
        height_m: 0.17,
        sigma_m: 0.0018,
        views: 12,
        direction: [-1.0, 0.0],
    };
    Terrain {
        voxel_m: 0.02,
        planes: vec![
            plane([1.0, 1.5, 0.1], z, [x, y], &square),
            plane(
                [2.0, 1.0, 0.185],
                [-1.0, 0.0, 0.0],
                [[0.0, -1.0, 0.0], z],
                &low,
            ),
            plane([2.5, 1.0, 0.27], z, [x, y], &square),
        ],
        edges: vec![
            edge(EdgeKind::Convex, (2, Some(1)), Some(step)),
            edge(EdgeKind::Concave, (0, Some(1)), None),
            edge(EdgeKind::End, (2, None), None),
        ],
    }
}

/// Both treads and the riser between them.
pub(crate) fn simplified() -> TerrainMesh {
    let [low, high] = TREADS_M.map(|z| z as f32);
    let (up, back) = ([0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]);
    let quads = [
        (
            [
                [0.0, 0.0, low],
                [2.0, 0.0, low],
                [2.0, 3.0, low],
                [0.0, 3.0, low],
            ],
            up,
        ),
        (
            [
                [2.0, 0.0, low],
                [2.0, 0.0, high],
                [2.0, 2.0, high],
                [2.0, 2.0, low],
            ],
            back,
        ),
        (
            [
                [2.0, 0.0, high],
                [3.0, 0.0, high],
                [3.0, 2.0, high],
                [2.0, 2.0, high],
            ],
            up,
        ),
    ];
    let mut mesh = TerrainMesh::default();
    for (plane, (corners, normal)) in quads.into_iter().enumerate() {
        let first = mesh.positions.len() as u32;
        for (corner, position) in corners.into_iter().enumerate() {
            mesh.positions.push(position);
            mesh.normals.push(normal);
            mesh.colors.push([200, 60 * plane as u8, 40 * corner as u8]);
            mesh.sigma_m.push(0.001 * (1 + plane) as f32);
            mesh.views.push(3 + corner as u8);
            mesh.planes.push(Some(plane as u32));
        }
        mesh.triangles.push([first, first + 1, first + 2]);
        mesh.triangles.push([first, first + 2, first + 3]);
    }
    mesh
}

/// With a triangle that is on no plane.
pub(crate) fn dense() -> TerrainMesh {
    let mut mesh = simplified();
    for position in [[0.2, 3.25, 0.5], [0.7, 3.25, 0.5], [0.7, 3.5, 0.625]] {
        mesh.positions.push(position);
        mesh.normals.push([0.0, 0.0, 1.0]);
        mesh.colors.push([0; 3]);
        mesh.sigma_m.push(0.02);
        mesh.views.push(255);
        mesh.planes.push(None);
    }
    mesh.triangles.push([12, 13, 14]);
    mesh
}

/// A level of 3 m by 2 m with an obstacle and an unknown corner, and a small one above it.
pub(crate) fn levels() -> Vec<MapLevel> {
    let below = Grid {
        cell_m: 0.25,
        origin_m: [0.125, -0.375],
        columns: 12,
        rows: 8,
    };
    let above = Grid {
        origin_m: [7.125, 0.375],
        columns: 3,
        rows: 2,
        ..below
    };
    let mut levels = [MapLevel::unknown(below), MapLevel::unknown(above)];
    for (number, level) in levels.iter_mut().enumerate() {
        let grid = level.grid;
        for cell in 0..grid.cells() {
            let (column, row) = (cell % grid.columns, cell / grid.columns);
            if column < 3 && row > 5 {
                continue;
            }
            let tread = TREADS_M[usize::from(grid.center_m(cell)[0] > 2.0)];
            // A number of its own for every cell.
            let height = tread + 2.5 * number as f64 + 0.001 * column as f64 + 0.0125 * row as f64;
            fill(level, cell, height as f32);
            if row == 2 && (5..8).contains(&column) {
                level.occupancy[cell] = maps::OCCUPIED;
                level.distance[cell] = -level.distance[cell];
            }
        }
    }
    levels.to_vec()
}

fn fill(level: &mut MapLevel, cell: usize, height: f32) {
    level.elevation[cell] = height;
    level.lower[cell] = height - 0.01;
    level.upper[cell] = height + 0.02;
    level.sigma[cell] = 0.003 + 1e-4 * cell as f32;
    level.normal[cell] = [0.6, 0.0, 0.8];
    level.slope[cell] = 0.643_501_1;
    level.step[cell] = 0.02;
    level.roughness[cell] = 0.004;
    level.clearance[cell] = if cell.is_multiple_of(5) {
        f32::INFINITY
    } else {
        2.25
    };
    level.traversability[cell] = (cell % 11) as f32 / 10.0;
    level.distance[cell] = 0.125 * (1 + cell % 7) as f32;
    level.occupancy[cell] = maps::FREE;
    level.views[cell] = cell as u8;
    level.flags[cell] = match cell % 3 {
        0 => maps::KNOWN,
        1 => maps::FILLED | maps::EDGE,
        _ => maps::KNOWN | maps::SAMPLED | maps::CONTRADICTED,
    };
}

/// The parts of the step, a stone, and terraces beside them.
pub(crate) fn collision() -> Collision {
    let [low, high] = TREADS_M;
    let parts = vec![
        slab(
            PartKind::Ground,
            Some(0),
            [[0.0, 2.0], [0.0, 3.0], [low - 0.2, low]],
        ),
        slab(
            PartKind::Wall,
            Some(1),
            [[2.0, 2.1], [0.0, 2.0], [low, high]],
        ),
        slab(
            PartKind::Ground,
            Some(2),
            [[2.0, 3.0], [0.0, 2.0], [high - 0.2, high]],
        ),
        ConvexPart {
            kind: PartKind::Obstacle,
            plane: None,
            vertices_m: vec![
                [0.2, 2.4, low],
                [0.5, 2.4, low],
                [0.2, 2.8, low],
                [0.3, 2.5, low + 0.3],
            ],
            triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        },
    ];
    Collision {
        parts,
        layers: vec![terraces()],
        report: CollisionReport {
            parts: 5,
            parts_per_100_m2: 62.5,
            height_errors: HeightErrors {
                count: 96,
                median_m: 0.0005,
                p95_m: 0.0125,
                max_m: 0.031,
                mean_m: -0.0002,
            },
            volume_added_m3: 0.001,
            volume_missing_m3: 0.0025,
        },
    }
}

/// Terraces of 30 cm by 50 cm at x from 4 m and y from 1 m, the last of them unknown.
pub(crate) fn terraces() -> HeightLayer {
    let grid = Grid {
        cell_m: 0.1,
        origin_m: [4.05, 1.05],
        columns: 12,
        rows: 15,
    };
    let heights_m = (0..grid.cells()).map(|cell| {
        let terrace = [cell % grid.columns / 3, cell / grid.columns / 5];
        match terrace {
            [3, 2] => f32::NAN,
            [column, row] => 0.4 + 0.05 * column as f32 + 0.3 * row as f32,
        }
    });
    HeightLayer {
        grid,
        heights_m: heights_m.collect(),
    }
}

fn slab(kind: PartKind, plane: Option<u32>, [x, y, z]: [[f64; 2]; 3]) -> ConvexPart {
    let outline = [[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]];
    let at = |z: f64| outline.map(|[x, y]| [x, y, z]);
    let mut triangles = vec![[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]];
    for i in 0..4 {
        let j = (i + 1) % 4;
        triangles.extend([[i, 4 + i, 4 + j], [i, 4 + j, j]]);
    }
    ConvexPart {
        kind,
        plane,
        vertices_m: [at(z[1]), at(z[0])].concat(),
        triangles,
    }
}
