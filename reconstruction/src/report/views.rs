//! Viewpoints of a cloud, computed from the cloud and the path through it.
//!
//! Contract: both views leave out points higher than [`MAX_HEIGHT_M`] above the rig, so that rooms
//! and the ground under trees are visible. In the view from above, y is up, and the image contains
//! the whole path. The oblique view shows the middle of the path with its surroundings, from the
//! rear and from the side with less occlusion.

use scene_bundle::outputs::cloud::CloudPoint;

use super::point_raster::{Scale, Viewpoint, dot};

/// Size of rendered points, m: slightly more than the edge of a voxel, so that surfaces are closed.
pub(super) const POINT_SIZE_M: f64 = 0.06;
/// Maximum height of shown points above the highest position of the rig, m.
pub(super) const MAX_HEIGHT_M: f64 = 1.0;
/// Points above this depth below the rig may occlude the path, m.
const OCCLUDER_MIN_HEIGHT_M: f64 = 0.5;
/// Radius around the middle of the path that is shown, m.
pub(super) const VIEW_RADIUS_M: f64 = 12.0;
/// Columns of both images.
const WIDTH: usize = 1000;
/// Rows of the oblique view.
const HEIGHT: usize = 600;
/// Rows of the map.
const MAP_HEIGHTS: [f64; 2] = [300.0, 1000.0];
/// Focal length of the oblique view, px.
const FOCAL_PX: f64 = 900.0;
/// Pitch of the oblique view, and yaw against the path, degrees.
const PITCH_DOWN_DEG: f64 = 35.0;
const YAW_DEG: f64 = 35.0;
/// Ratio of points at either end that are ignored when the image is framed.
const OUTLIER_RATIO: f64 = 0.01;
/// Margin factor of the framing.
const MARGIN_FACTOR: f64 = 1.04;

/// Points that are shown.
pub(super) fn shown(points: &[CloudPoint], rig_path: &[[f64; 3]]) -> Vec<CloudPoint> {
    let top = rig_path
        .iter()
        .map(|x| x[2])
        .fold(f64::NEG_INFINITY, f64::max)
        + MAX_HEIGHT_M;
    let is_low = |p: &&CloudPoint| f64::from(p.x_in_world[2]) <= top || top.is_infinite();
    points.iter().filter(is_low).copied().collect()
}

/// View from above.
pub(super) fn above(points: &[CloudPoint], rig_path: &[[f64; 3]]) -> Option<Viewpoint> {
    let range = |k: usize| {
        let (low, high) = range(points.iter().map(|p| f64::from(p.x_in_world[k])))?;
        let of_path = rig_path.iter().map(|x| x[k]);
        Some((
            of_path.clone().fold(low, f64::min),
            of_path.fold(high, f64::max),
        ))
    };
    let [x, y, z] = [range(0)?, range(1)?, range(2)?];
    let [across, up] = [x, y].map(|(low, high)| MARGIN_FACTOR * (high - low).max(0.5));
    let height = (WIDTH as f64 * up / across).clamp(MAP_HEIGHTS[0], MAP_HEIGHTS[1]);
    let px_per_m = (WIDTH as f64 / across).min(height / up);
    Some(Viewpoint {
        size: [WIDTH, height as usize],
        eye: [0.5 * (x.0 + x.1), 0.5 * (y.0 + y.1), z.1 + 10.0],
        axes: [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]],
        scale: Scale::Map(px_per_m),
    })
}

/// Initial camera position and target of the interactive view: as [`oblique`], or a default without
/// points.
pub(super) fn first(points: &[CloudPoint], rig_path: &[[f64; 3]]) -> [[f64; 3]; 2] {
    let Some(viewpoint) = oblique(points, rig_path) else {
        let target = rig_path.first().copied().unwrap_or([0.0; 3]);
        return [[0, 1, 2].map(|k| target[k] + [-4.0, -4.0, 4.0][k]), target];
    };
    let middle = rig_path[rig_path.len() / 2];
    let forward = viewpoint.axes[2];
    let ahead = dot(forward, [0, 1, 2].map(|k| middle[k] - viewpoint.eye[k])).max(0.5);
    let target = [0, 1, 2].map(|k| viewpoint.eye[k] + ahead * forward[k]);
    [viewpoint.eye, target]
}

/// Oblique view.
pub(super) fn oblique(points: &[CloudPoint], rig_path: &[[f64; 3]]) -> Option<Viewpoint> {
    let middle = *rig_path.get(rig_path.len() / 2)?;
    let beside = |x: &[f64; 3]| (x[0] - middle[0]).hypot(x[1] - middle[1]) <= VIEW_RADIUS_M;
    let near: Vec<[f64; 3]> = points
        .iter()
        .map(|p| p.x_in_world.map(f64::from))
        .filter(beside)
        .collect();
    let along = direction(&rig_path.iter().copied().filter(beside).collect::<Vec<_>>());
    let heading = along + side(&near, middle, along) * YAW_DEG.to_radians();
    let (steep, flat) = PITCH_DOWN_DEG.to_radians().sin_cos();
    let (sin, cos) = heading.sin_cos();
    let forward = [flat * cos, flat * sin, -steep];
    let right = [sin, -cos, 0.0];
    let down = [-steep * cos, -steep * sin, -flat];
    let axes = [right, down, forward];
    let [u, v, w] = axes.map(|axis| range(near.iter().map(|x| dot(axis, *x))));
    let ranges = [u?, v?, w?];
    let centre = ranges.map(|(low, high)| 0.5 * (low + high));
    let half = ranges.map(|(low, high)| 0.5 * MARGIN_FACTOR * (high - low));
    // Far enough away to contain the sides, measured in the middle, and outside of them.
    let for_side = |k: usize, px: usize| half[k] * FOCAL_PX / (0.5 * px as f64);
    let back = for_side(0, WIDTH)
        .max(for_side(1, HEIGHT))
        .max(half[2] + 0.5);
    let eye = [0, 1, 2].map(|k| {
        let at = (0..3).map(|a| centre[a] * axes[a][k]).sum::<f64>();
        at - back * forward[k]
    });
    Some(Viewpoint {
        size: [WIDTH, HEIGHT],
        eye,
        axes,
        scale: Scale::Perspective(FOCAL_PX),
    })
}

/// 1 to view from the right of the path, -1 from its left: the side with fewer points nearly as
/// high as the rig.
fn side(points: &[[f64; 3]], middle: [f64; 3], along: f64) -> f64 {
    let (sin, cos) = along.sin_cos();
    let is_tall = |x: &&[f64; 3]| x[2] > middle[2] - OCCLUDER_MIN_HEIGHT_M;
    let is_left = |x: &&[f64; 3]| cos * (x[1] - middle[1]) > sin * (x[0] - middle[0]);
    let tall: Vec<&[f64; 3]> = points.iter().filter(is_tall).collect();
    let left = tall.iter().filter(|x| is_left(x)).count();
    if tall.len() - left <= left { 1.0 } else { -1.0 }
}

/// Range of nearly all values; `None` without values.
pub(super) fn range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let mut values: Vec<f64> = values.collect();
    let last = values.len().checked_sub(1)?;
    let outside = (OUTLIER_RATIO * last as f64) as usize;
    let low = *values.select_nth_unstable_by(outside, f64::total_cmp).1;
    let high = *values
        .select_nth_unstable_by(last - outside, f64::total_cmp)
        .1;
    Some((low, high))
}

/// Direction of a path, as an angle from x: from its first position to its last one, or, for a
/// closed path, to the farthest.
fn direction(rig_path: &[[f64; 3]]) -> f64 {
    let Some(first) = rig_path.first() else {
        return 0.0;
    };
    let away = |x: &&[f64; 3]| (x[0] - first[0]).hypot(x[1] - first[1]);
    let farthest = rig_path.iter().max_by(|a, b| away(a).total_cmp(&away(b)));
    farthest.map_or(0.0, |x| (x[1] - first[1]).atan2(x[0] - first[0]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::point_raster::{TRANSPARENT, draw};

    /// Ground along a path of 10 m, and a ceiling.
    fn room() -> (Vec<CloudPoint>, Vec<[f64; 3]>) {
        let point = |x: i32, y: i32, z: f32| CloudPoint {
            x_in_world: [0.1 * x as f32, 0.1 * y as f32, z],
            color: [10, 120, 10],
            sigma_m: 0.01,
        };
        let places = (0..100).flat_map(|x| (-20..20).map(move |y| (x, y)));
        let points = places.flat_map(|(x, y)| [point(x, y, -1.3), point(x, y, 1.5)]);
        let rig_path = (0..100).map(|x| [0.1 * f64::from(x), 0.0, 0.0]);
        (points.collect(), rig_path.collect())
    }

    #[test]
    fn the_ground_fills_both_images() {
        let (points, rig_path) = room();
        let shown = shown(&points, &rig_path);
        assert_eq!(shown.len(), points.len() / 2);
        for viewpoint in [above(&shown, &rig_path), oblique(&shown, &rig_path)] {
            let viewpoint = viewpoint.expect("a viewpoint");
            let image = draw(&shown, 0.12, &[], &viewpoint);
            let empty = image.chunks(4).filter(|c| *c == TRANSPARENT).count();
            let share = empty as f64 / (image.len() / 4) as f64;
            assert!(share < 0.75, "{share} is empty: {viewpoint:?}");
            // The middle of the image is covered.
            let middle = viewpoint.size[1] / 2 * viewpoint.size[0] + viewpoint.size[0] / 2;
            assert_ne!(
                image[4 * middle..4 * middle + 4],
                TRANSPARENT,
                "{viewpoint:?}"
            );
        }
    }

    #[test]
    fn the_oblique_view_is_from_the_side_without_a_wall() {
        let (mut points, rig_path) = room();
        let wall = |y: f32| {
            let places = (0..100).flat_map(|x| (0..20).map(move |z| (x, z)));
            places.map(move |(x, z)| CloudPoint {
                x_in_world: [0.1 * x as f32, y, -1.3 + 0.1 * z as f32],
                color: [90; 3],
                sigma_m: 0.01,
            })
        };
        for (y, is_behind) in [(-2.0, 1.0), (2.0, -1.0)] {
            let ground = points.len();
            points.extend(wall(y));
            let viewpoint = oblique(&points, &rig_path).expect("a viewpoint");
            // The camera is on the other side of the path.
            assert!(viewpoint.eye[1] * is_behind > 0.0, "{y}: {viewpoint:?}");
            points.truncate(ground);
        }
    }

    #[test]
    fn empty_input_does_not_panic() {
        assert_eq!(above(&[], &[]), None);
        assert_eq!(oblique(&[], &[]), None);
        assert_eq!(oblique(&[], &[[0.0; 3]]), None);
        for rig_path in [&[][..], &[[0.0; 3]][..]] {
            let [eye, target] = first(&[], rig_path);
            assert!(eye != target, "{eye:?}");
        }
    }
}
