//! Where the depths of a plane end and something farther begins.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::assignment::{Assigner, Assignment, Extent, NONE, STRIDE};
use crate::view::{DepthView, Pose};

/// Difference to a plane from which on a neighboring depth is farther, in its sigmas and m.
const FARTHER_SIGMAS: f64 = 5.0;
const FARTHER_M: f64 = 0.03;

/// Points in coordinates of planes: between the last pixel of a plane and a pixel beside it that is
/// farther. The plane ends there; where the pixel beside is nearer, the plane may go on behind it.
pub(crate) fn ends(assigner: &Assigner<'_>, assignment: &Assignment) -> Vec<(u16, [f64; 2])> {
    let columns = assignment.columns;
    let rows = assignment.labels.len() / columns.max(1);
    let found: Vec<Vec<(u16, [f64; 2])>> = (0..rows)
        .into_par_iter()
        .map(|row| {
            let mut found = Vec::new();
            for column in 0..columns {
                let sample = row * columns + column;
                let label = assignment.labels[sample];
                let is_change = |other: usize| assignment.labels[other] != label;
                if column + 1 < columns && is_change(sample + 1) {
                    between(assigner, [column, row], [1, 0], &mut found);
                }
                if row + 1 < rows && is_change(sample + columns) {
                    between(assigner, [column, row], [0, 1], &mut found);
                }
            }
            found
        })
        .collect();
    found.into_iter().flatten().collect()
}

/// Ends of planes at the pixels from one sample to the next.
fn between(
    assigner: &Assigner<'_>,
    sample: [usize; 2],
    step: [usize; 2],
    found: &mut Vec<(u16, [f64; 2])>,
) {
    let pixel = |k: usize| [0, 1].map(|axis| STRIDE * sample[axis] + k * step[axis]);
    let label = |[u, v]: [usize; 2]| assigner.hit(u, v).map_or(NONE, |hit| hit.plane);
    let labels: [u16; STRIDE + 1] = std::array::from_fn(|k| label(pixel(k)));
    for k in 0..STRIDE {
        if labels[k] == labels[k + 1] {
            continue;
        }
        let direction = step.map(|s| s as f64);
        for (from, to, sign) in [(k, k + 1, 1.0), (k + 1, k, -1.0)] {
            if labels[from] == NONE {
                continue;
            }
            let extent = &assigner.extents[usize::from(labels[from])];
            let at = pixel(from).map(|v| v as f64);
            let [u, v] = pixel(to);
            let other = v * assigner.view.size[0] + u;
            let end = end(
                extent,
                (assigner.view, &assigner.pose),
                at,
                direction.map(|d| sign * d),
                other,
            );
            found.extend(end.map(|end| (labels[from], end)));
        }
    }
}

fn end(
    extent: &Extent,
    (view, pose): (&DepthView<'_>, &Pose),
    [u, v]: [f64; 2],
    [right, down]: [f64; 2],
    other: usize,
) -> Option<[f64; 2]> {
    let (depth, sigma) = view.depth(other)?;
    let depth_of_plane = |u: f64, v: f64| {
        // Intersection of the ray with the plane, at the pose of the row.
        let from = Vector3::from(view.position(pose, u, v, 0.0));
        let to = Vector3::from(view.position(pose, u, v, 1.0));
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
    let x = Vector3::from(view.position(pose, u, v, depth_of_plane(u, v)?));
    let [s, t, _] = extent.frame.coordinates(&x);
    Some([s, t])
}
