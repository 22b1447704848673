//! Levels and convex parts as the outputs `maps` and `collision` have them.

use scene_bundle::outputs::collision::{
    Collision, CollisionReport, ConvexPart, HeightErrors, HeightLayer, PartKind,
};
use scene_bundle::outputs::grid::Grid;
use scene_bundle::outputs::maps::MapLevel;
use terrain::ConvexConfig;
use terrain::convex::{self, Obstacle};
use terrain::maps::Level;
use terrain::planes::Planes;

/// Levels as the output `maps` has them.
pub fn map_levels(levels: Vec<Level>) -> Vec<MapLevel> {
    let stored = |level: Level| MapLevel {
        grid: grid(level.cell_m, level.origin, level.size),
        elevation: level.elevation,
        lower: level.lower,
        upper: level.upper,
        sigma: level.sigma,
        normal: level.normal,
        slope: level.slope,
        step: level.step,
        roughness: level.roughness,
        clearance: level.clearance,
        traversability: level.traversability,
        distance: level.distance,
        occupancy: level.occupancy,
        views: level.views,
        flags: level.flags,
    };
    levels.into_iter().map(stored).collect()
}

/// Parts and layers as the output `collision` has them.
pub fn map_collision(
    collision: convex::Collision,
    obstacles: Vec<Obstacle>,
    planes: &Planes,
    config: &ConvexConfig,
) -> Collision {
    let of_plane = |part: convex::ConvexPart| ConvexPart {
        kind: match planes.planes[part.plane as usize].normal[2] >= config.min_ground_cos {
            true => PartKind::Ground,
            false => PartKind::Wall,
        },
        plane: Some(part.plane),
        vertices_m: part.vertices,
        triangles: part.triangles,
    };
    let of_obstacle = |obstacle: Obstacle| ConvexPart {
        kind: PartKind::Obstacle,
        plane: None,
        vertices_m: obstacle.vertices,
        triangles: obstacle.triangles,
    };
    let layer = |layer: convex::HeightLayer| HeightLayer {
        grid: grid(layer.cell_m, layer.origin, layer.size),
        heights_m: layer.heights,
    };
    let (report, errors) = (&collision.report, &collision.report.height_errors);
    let report = CollisionReport {
        parts: (report.parts + obstacles.len()) as u64,
        parts_per_100_m2: report.parts_per_100_m2,
        height_errors: HeightErrors {
            count: errors.count as u64,
            median_m: errors.median_m,
            p95_m: errors.p95_m,
            max_m: errors.max_m,
            mean_m: errors.mean_m,
        },
        volume_added_m3: report.volume_added_m3,
        volume_missing_m3: report.volume_missing_m3,
    };
    let parts = collision.parts.into_iter().map(of_plane);
    Collision {
        parts: parts
            .chain(obstacles.into_iter().map(of_obstacle))
            .collect(),
        layers: collision.layers.into_iter().map(layer).collect(),
        report,
    }
}

fn grid(cell_m: f64, origin_m: [f64; 2], size: [usize; 2]) -> Grid {
    Grid {
        cell_m,
        origin_m,
        columns: size[0],
        rows: size[1],
    }
}
