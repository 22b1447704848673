//! Models of MuJoCo of true and reconstructed ground, by the exporter of scene bundles.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use nalgebra::Vector3;
use reconstruction::pipeline::stages::map_collision;
use scene_bundle::export::{Format, Options, export};
use scene_bundle::outputs::COLLISION;
use scene_bundle::outputs::collision::{self, Collision, CollisionReport, ConvexPart, PartKind};
use scene_bundle::{Bundle, Provenance, Record, RigRevision};
use terrain::ConvexConfig;
use terrain::ObstacleConfig;
use terrain::convex::{collision_parts, obstacle_parts};

use super::course::Course;
use crate::terrain::surface::Surface;
use crate::terrain::truth::Truth;

/// Thickness of the true ground, m: more than the height of a step.
const PRISM_M: f64 = 0.2;
/// Twice the area of the smallest triangle of the true ground, m2.
const MIN_AREA_M2: f64 = 1e-6;
/// Corners of a polygon are within this distance of a plane, m.
const PLANE_M: f64 = 5e-4;
/// True ground around a course, m.
const MARGIN_M: f64 = 1.2;

/// Collision geometry as the stage `maps` writes it.
pub(super) fn reconstructed(surface: &Surface) -> Collision {
    with_config(surface, &ConvexConfig::default())
}

/// The same with other limits of the parts.
pub(super) fn with_config(surface: &Surface, config: &ConvexConfig) -> Collision {
    let Surface {
        ground,
        planes,
        edges,
        levels,
        ..
    } = surface;
    let parts = collision_parts(planes, edges, levels, config);
    let obstacles = obstacle_parts(ground, planes, levels, &ObstacleConfig::default());
    map_collision(parts, obstacles, planes, config)
}

/// The true ground around a course: its triangles, joined to convex polygons where they are
/// coplanar, as prisms.
///
/// A height field would not do: with cells smaller than a foot, the edges of its cells give
/// contacts with normals to all sides, between which feet stick.
pub(super) fn truth(truth: &Truth<'_>, course: &Course) -> Collision {
    let near = truth.walkable_triangles().filter(|corners| {
        let [a, b, c] = corners;
        // Upwards, and not too small to compile.
        course.is_beside(corners, MARGIN_M) && (b - a).cross(&(c - a)).z > MIN_AREA_M2
    });
    let part = |polygon: Vec<Vector3<f64>>| {
        let count = polygon.len() as u32;
        let top = polygon.iter().map(|x| [x.x, x.y, x.z]);
        let bottom = polygon.iter().map(|x| [x.x, x.y, x.z - PRISM_M]);
        let fans = (1..count - 1).flat_map(|i| [[0, i, i + 1], [count, count + i + 1, count + i]]);
        let sides = (0..count).flat_map(|i| {
            let next = (i + 1) % count;
            [[i, i + count, next + count], [i, next + count, next]]
        });
        ConvexPart {
            kind: PartKind::Ground,
            plane: None,
            vertices_m: top.chain(bottom).collect(),
            triangles: fans.chain(sides).collect(),
        }
    };
    Collision {
        parts: joined(near.map(|own| own.to_vec()).collect())
            .into_iter()
            .map(part)
            .collect(),
        layers: Vec::new(),
        report: CollisionReport::default(),
    }
}

/// Polygons joined over shared edges as long as they are coplanar and remain convex.
fn joined(polygons: Vec<Vec<Vector3<f64>>>) -> Vec<Vec<Vector3<f64>>> {
    let mut polygons: Vec<Option<Vec<Vector3<f64>>>> = polygons.into_iter().map(Some).collect();
    let key = |x: &Vector3<f64>| [x.x, x.y, x.z].map(f64::to_bits);
    loop {
        // Directed edges; the neighbor has the opposite one.
        let mut edges = BTreeMap::new();
        for (number, polygon) in polygons.iter().enumerate() {
            for [a, b] in polygon.iter().flat_map(|own| sides(own)) {
                edges.insert([key(&a), key(&b)], number);
            }
        }
        let mut is_changed = false;
        let mut is_used = vec![false; polygons.len()];
        for number in 0..polygons.len() {
            let Some(own) = polygons[number].clone() else {
                continue;
            };
            let join = sides(&own)
                .into_iter()
                .enumerate()
                .find_map(|(place, [a, b])| {
                    let other = *edges.get(&[key(&b), key(&a)])?;
                    let is_free = !is_used[number] && !is_used[other] && other != number;
                    let polygon = polygons[other].as_ref().filter(|_| is_free)?;
                    let joint = polygon.iter().position(|x| *x == a)?;
                    // From the end of the shared edge around to its begin, and on around the other.
                    let count = polygon.len();
                    let before = (1..=own.len()).map(|i| own[(place + i) % own.len()]);
                    let after = (1..count - 1).map(|i| polygon[(joint + i) % count]);
                    let all: Vec<Vector3<f64>> = before.chain(after).collect();
                    is_convex(&all).then_some((other, all))
                });
            if let Some((other, all)) = join {
                polygons[number] = Some(all);
                polygons[other] = None;
                is_used[number] = true;
                is_used[other] = true;
                is_changed = true;
            }
        }
        if !is_changed {
            return polygons.into_iter().flatten().collect();
        }
    }
}

fn sides(polygon: &[Vector3<f64>]) -> Vec<[Vector3<f64>; 2]> {
    let next = polygon.iter().cycle().skip(1);
    polygon.iter().zip(next).map(|(a, b)| [*a, *b]).collect()
}

/// Whether a polygon, counterclockwise seen from above, is plane and convex.
fn is_convex(polygon: &[Vector3<f64>]) -> bool {
    let fan = polygon.windows(2).skip(1);
    let area = fan.map(|pair| (pair[0] - polygon[0]).cross(&(pair[1] - polygon[0])));
    let normal = area.sum::<Vector3<f64>>().normalize();
    let is_plane = |x: &Vector3<f64>| normal.dot(&(x - polygon[0])).abs() < PLANE_M;
    let sides = sides(polygon);
    let next = sides.iter().cycle().skip(1);
    let is_left_turn = |([a, b], [_, c]): (&[Vector3<f64>; 2], &[Vector3<f64>; 2])| {
        let (u, v) = ((b - a).normalize(), (c - b).normalize());
        normal.dot(&u.cross(&v)) > -1e-6 && u.dot(&v) > -0.999
    };
    polygon.iter().all(is_plane) && sides.iter().zip(next).all(is_left_turn)
}

/// A folder of an export in the folder of this benchmark; one that is there is replaced.
///
/// # Errors
/// It cannot be written, or geometry is lost in it.
pub(super) fn exported(collision: &Collision, folder: &Path, name: &str) -> Result<PathBuf> {
    let (out, lost) = exported_in_part(collision, folder, name)?;
    ensure!(lost.is_empty(), "lost: {lost:?}");
    Ok(out)
}

/// The same, with what was lost: flat parts.
///
/// # Errors
/// It cannot be written.
pub(super) fn exported_in_part(
    collision: &Collision,
    folder: &Path,
    name: &str,
) -> Result<(PathBuf, Vec<String>)> {
    let (bundle, out) = (folder.join(format!("{name}.scene")), folder.join(name));
    for old in [&bundle, &out] {
        if old.exists() {
            fs::remove_dir_all(old).with_context(|| format!("removing {}", old.display()))?;
        }
    }
    let provenance = Provenance {
        session_id: "00000000-0000-7000-8000-000000000000".to_owned(),
        handoff_blake3: "00".repeat(32),
        judgement: None,
        rig: RigRevision {
            name: "example".to_owned(),
            revision: "A".to_owned(),
        },
        program: "bench".to_owned(),
        program_version: String::new(),
        started_civil_ns: 0,
        ended_civil_ns: None,
    };
    let bundle = Bundle::create_or_open(&bundle, provenance)?;
    let draft = bundle.begin(COLLISION)?;
    collision::write(&draft, collision)?;
    draft.commit(Record {
        stage: "bench".to_owned(),
        stage_version: 1,
        settings: serde_json::Value::Null,
        inputs: BTreeMap::new(),
    })?;
    let summary = export(&bundle.scene(), Format::Mjcf, &Options::default(), &out)?;
    Ok((out, summary.lost))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Triangles of a grid of squares.
    fn squares(cells: &[[f64; 2]]) -> Vec<Vec<Vector3<f64>>> {
        let corner = |x: f64, y: f64| Vector3::new(x, y, 0.1 * x);
        let of = |[x, y]: &[f64; 2]| {
            let [a, b] = [corner(*x, *y), corner(x + 1.0, *y)];
            let [c, d] = [corner(x + 1.0, y + 1.0), corner(*x, y + 1.0)];
            [vec![a, b, c], vec![a, c, d]]
        };
        cells.iter().flat_map(of).collect()
    }

    /// Area seen from above.
    fn area(polygons: &[Vec<Vector3<f64>>]) -> f64 {
        let of = |own: &Vec<Vector3<f64>>| {
            let fan = own.windows(2).skip(1);
            let doubled = fan.map(|pair| (pair[0] - own[0]).cross(&(pair[1] - own[0])).z);
            0.5 * doubled.sum::<f64>()
        };
        polygons.iter().map(of).sum()
    }

    #[test]
    fn coplanar_triangles_become_fewer_convex_polygons_of_the_same_area() {
        let square = squares(&[[0.0, 0.0]]);
        assert_eq!(joined(square).len(), 1);
        for cells in [
            &[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]][..],
            // An L is not convex.
            &[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
        ] {
            let all = joined(squares(cells));
            assert!(all.len() > usize::from(cells.len() == 3));
            assert!(all.len() <= cells.len(), "{}", all.len());
            assert!(all.iter().all(|own| is_convex(own)));
            assert!((area(&all) - cells.len() as f64).abs() < 1e-12);
        }
    }

    #[test]
    fn a_step_remains_an_edge() {
        let mut all = squares(&[[0.0, 0.0], [1.0, 0.0]]);
        all[3].iter_mut().for_each(|x| x.z += 0.05);
        all[2].iter_mut().for_each(|x| x.z += 0.05);
        assert_eq!(joined(all).len(), 2);
    }
}
