//! Where the depths of a plane end and something farther begins.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::assignment::{Extent, NONE};
use crate::view::DepthView;

/// Difference to a plane from which on a neighboring depth is farther, in its sigmas and m.
const FARTHER_SIGMAS: f64 = 5.0;
const FARTHER_M: f64 = 0.03;

/// Points in coordinates of planes: between the last pixel of a plane and a pixel beside it that is
/// farther. The plane ends there; where the pixel beside is nearer, the plane may go on behind it.
pub(crate) fn ends(
    extents: &[Extent],
    view: &DepthView<'_>,
    labels: &[u16],
) -> Vec<(u16, [f64; 2])> {
    let [width, height] = view.size;
    let rows: Vec<Vec<(u16, [f64; 2])>> = (1..height - 1)
        .into_par_iter()
        .map(|row| {
            let mut found = Vec::new();
            for column in 1..width - 1 {
                let pixel = row * width + column;
                let plane = labels[pixel];
                if plane == NONE {
                    continue;
                }
                for (other, right, down) in [
                    (pixel - 1, -1.0, 0.0),
                    (pixel + 1, 1.0, 0.0),
                    (pixel - width, 0.0, -1.0),
                    (pixel + width, 0.0, 1.0),
                ] {
                    if labels[other] == plane {
                        continue;
                    }
                    let at = [column as f64, row as f64];
                    let extent = &extents[usize::from(plane)];
                    let end = end(extent, view, at, [right, down], other);
                    found.extend(end.map(|end| (plane, end)));
                }
            }
            found
        })
        .collect();
    rows.into_iter().flatten().collect()
}

fn end(
    extent: &Extent,
    view: &DepthView<'_>,
    [u, v]: [f64; 2],
    [right, down]: [f64; 2],
    other: usize,
) -> Option<[f64; 2]> {
    let (depth, sigma) = view.depth(other)?;
    let depth_of_plane = |u: f64, v: f64| {
        // Intersection of the ray with the plane, at the pose of the row.
        let from = Vector3::from(view.position(u, v, 0.0));
        let to = Vector3::from(view.position(u, v, 1.0));
        let n = &extent.frame.normal;
        let slope = n.dot(&(to - from));
        // Rays from outside only, and not along the plane.
        (slope < -0.05).then(|| n.dot(&(extent.frame.origin - from)) / slope)
    };
    let beyond = f64::from(depth) - depth_of_plane(u + right, v + down)?;
    if beyond < FARTHER_M.max(FARTHER_SIGMAS * f64::from(sigma)) {
        return None;
    }
    let (u, v) = (u + 0.5 * right, v + 0.5 * down);
    let x = Vector3::from(view.position(u, v, depth_of_plane(u, v)?));
    let [s, t, _] = extent.frame.coordinates(&x);
    Some([s, t])
}
