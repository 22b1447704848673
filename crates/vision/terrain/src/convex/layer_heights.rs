//! Heights of the layer of a level, so that its triangles and the parts make one surface.
//!
//! Contract: where a part ends the layer is `layer_seam_m` below its surface, so that it goes on
//! without a ditch. Where parts are everywhere around a sample it is `ground_thickness_m` below:
//! nothing touches it there, and an envelope of coarser cells does not reach out over a step. Above
//! a step it is below the lower ground instead, if parts cover all of the upper ground around the
//! sample or leave out at most `max_smear_m`: then the step is as steep as the part's border. Where
//! more is left out, the step is a slope between two samples. Below a step whose lower ground is
//! covered, the layer is so deep that this slope is at most `max_smear_m` wide above the lower
//! part.

use rayon::prelude::*;

use super::faces::{Face, Faces};
use super::layer::HeightLayer;
use crate::config::ConvexConfig;
use crate::maps::Level;

/// Parts of an edge of a triangle between the places at which it is examined.
const PARTS: usize = 4;
/// Neighbors of a sample, counterclockwise: each with the next one makes one of its triangles.
const AROUND: [[i64; 2]; 6] = [[1, 0], [1, 1], [0, 1], [-1, 0], [-1, -1], [0, -1]];

/// The layer of a level over its parts.
pub(super) fn height_layer(faces: &Faces, level: &Level, config: &ConvexConfig) -> HeightLayer {
    let samples = 0..level.elevation.len();
    let ground: Vec<Sample<'_>> = samples
        .into_par_iter()
        .map(|index| sample(faces, level, index, config))
        .collect();
    let layer = Layer {
        faces,
        level,
        ground,
        config,
    };
    let heights = (0..layer.ground.len()).into_par_iter();
    HeightLayer {
        cell_m: level.cell_m,
        origin: level.origin,
        size: level.size,
        heights: heights.map(|index| layer.height(index) as f32).collect(),
    }
}

/// Ground at a sample of the layer.
#[derive(Clone, Copy)]
struct Sample<'a> {
    /// Of the level, or of the part where the level has none, m; NaN where unknown.
    height: f64,
    /// The surface of a part that stands for the ground here.
    face: Option<&'a Face>,
}

struct Layer<'a> {
    faces: &'a Faces,
    level: &'a Level,
    ground: Vec<Sample<'a>>,
    config: &'a ConvexConfig,
}

/// The ground at a sample, with the highest part that stands for it. Ground that only a part has is
/// of this level if the part is at the height of the level in a neighboring cell.
fn sample<'a>(faces: &'a Faces, level: &Level, index: usize, config: &ConvexConfig) -> Sample<'a> {
    let at = level.center(index);
    let fits = |face: &Face, index: usize| {
        let away = face.height(level.center(index)) - f64::from(level.elevation[index]);
        away.abs() <= config.max_plane_distance_m
    };
    let is_known = level.has_height(index);
    let stands = |face: &&Face| match is_known {
        true => fits(face, index),
        false => level
            .near(index, 1.5 * level.cell_m)
            .any(|(other, _)| fits(face, other)),
    };
    let surfaces = faces.at(at).filter(|face| face.is_surface);
    let face = surfaces
        .filter(stands)
        .max_by(|a, b| a.height(at).total_cmp(&b.height(at)));
    let height = match (is_known, face) {
        (true, _) => f64::from(level.elevation[index]),
        (false, Some(face)) => face.height(at),
        (false, None) => f64::NAN,
    };
    Sample { height, face }
}

impl Layer<'_> {
    fn height(&self, index: usize) -> f64 {
        let own = self.ground[index];
        let Some(face) = own.face else {
            return own.height;
        };
        let surface = face.height(self.level.center(index));
        if let Some(least) = self.least_around(index) {
            return least.min(surface) - self.config.ground_thickness_m;
        }
        let below = self.below_parts(index, face);
        below.unwrap_or(surface).min(surface) - self.config.layer_seam_m
    }

    /// The neighbor in a direction, if the grid has one.
    fn neighbor(&self, index: usize, [right, up]: [i64; 2]) -> Option<usize> {
        let [columns, rows] = self.level.size.map(|count| count as i64);
        let column = (index % self.level.size[0]) as i64 + right;
        let row = (index / self.level.size[0]) as i64 + up;
        let inside = (0..columns).contains(&column) && (0..rows).contains(&row);
        inside.then_some((row * columns + column) as usize)
    }

    /// Height of the ground at a sample above a surface; NaN where unknown.
    fn rise(&self, face: &Face, index: usize) -> f64 {
        self.ground[index].height - face.height(self.level.center(index))
    }

    /// Whether the ground at a sample is below a surface, rather than at its height or above it.
    fn is_below(&self, face: &Face, index: usize) -> bool {
        self.rise(face, index) < -self.config.max_plane_distance_m
    }

    /// Whether the ground at a sample is above a surface, rather than at its height or below it.
    fn is_above(&self, face: &Face, index: usize) -> bool {
        self.rise(face, index) > self.config.max_plane_distance_m
    }

    /// Depth below a surface at which the slope from higher ground at a neighbor is `max_smear_m`
    /// wide above the surface.
    fn drop(&self, face: &Face, index: usize, higher: usize) -> f64 {
        let centers = [index, higher].map(|index| self.level.center(index));
        let away = [0, 1].map(|k| centers[1][k] - centers[0][k]);
        let ratio = away[0].hypot(away[1]) / self.config.max_smear_m;
        self.rise(face, higher) * (ratio - 1.0).max(0.0)
    }

    /// Least height of the parts in all triangles of a sample; `None` if they leave out some of the
    /// ground there. At a step it may be as much as half a cell of the upper ground.
    fn least_around(&self, index: usize) -> Option<f64> {
        let around = AROUND.map(|step| self.neighbor(index, step));
        let mut least = f64::INFINITY;
        for side in 0..around.len() {
            let corners = [index, around[side]?, around[(side + 1) % around.len()]?];
            let heights = corners.map(|index| self.ground[index].height);
            if heights.iter().any(|height| height.is_nan()) {
                return None;
            }
            let lowest = heights.into_iter().fold(f64::INFINITY, f64::min);
            for (at, _) in places(0, corners.map(|index| self.level.center(index))) {
                let top = self.faces.top(at, lowest)?;
                if top < lowest - self.config.max_plane_distance_m {
                    return None;
                }
                least = least.min(top);
            }
        }
        Some(least)
    }

    /// Greatest height of the layer at a sample below parts and beside steps; `None` if ground at
    /// the height of its surface would be in a ditch then.
    fn below_parts(&self, index: usize, face: &Face) -> Option<f64> {
        let around = AROUND.map(|step| self.neighbor(index, step));
        let neighbors = around.iter().copied().flatten();
        let higher = neighbors
            .clone()
            .filter(|other| self.is_above(face, *other));
        let drop = higher.map(|other| self.drop(face, index, other));
        let mut least = face.height(self.level.center(index)) - drop.fold(0.0, f64::max);
        let mut all = neighbors.clone();
        if all.all(|other| face.contains(self.level.center(other))) {
            return Some(least);
        }
        for other in neighbors {
            let ground = self.ground[other];
            if let Some(part) = ground.face {
                least = least.min(part.height(self.level.center(other)));
            } else if self.is_below(face, other) {
                least = least.min(ground.height + self.config.layer_seam_m);
            } else if !ground.height.is_nan() && !self.is_above(face, other) {
                return None;
            }
        }
        for side in 0..around.len() {
            let (first, second) = (around[side], around[(side + 1) % around.len()]);
            if let (Some(first), Some(second)) = (first, second) {
                least = least.min(self.below_triangle([index, first, second], face)?);
            }
        }
        Some(least)
    }

    /// The same for a triangle of the layer. The sample is its first corner.
    fn below_triangle(&self, corners: [usize; 3], face: &Face) -> Option<f64> {
        let centers = corners.map(|index| self.level.center(index));
        // Where a corner is unknown, the layer has no surface to be in a ditch.
        let is_known = corners
            .iter()
            .all(|index| !self.ground[*index].height.is_nan());
        let has_step = corners.iter().any(|index| self.is_below(face, *index));
        let mut least = f64::INFINITY;
        for (at, weights) in places(1, centers) {
            let plane = face.height(at);
            let top = self.faces.top(at, plane);
            least = least.min(top.unwrap_or(f64::INFINITY));
            let is_covered = top.is_some_and(|top| top >= plane - self.config.max_plane_distance_m);
            if is_covered || !is_known {
                continue;
            }
            // The sample itself if others are as near.
            let nearest = (0..3).rev().max_by_key(|k| weights[*k]).unwrap_or(0);
            let away = [0, 1].map(|k| at[k] - centers[nearest][k]);
            let is_left_out = has_step && away[0].hypot(away[1]) <= self.config.max_smear_m;
            let is_of_surface =
                !self.is_below(face, corners[nearest]) && !self.is_above(face, corners[nearest]);
            if is_of_surface && !is_left_out {
                return None;
            }
        }
        Some(least)
    }
}

/// Places in a triangle, with their weights in parts; that of its first corner has a least value.
fn places(least: usize, corners: [[f64; 2]; 3]) -> impl Iterator<Item = ([f64; 2], [usize; 3])> {
    let weights = (least..=PARTS)
        .flat_map(|first| (0..=PARTS - first).map(move |second| (first, second)))
        .map(|(first, second)| [first, second, PARTS - first - second]);
    weights.map(move |weights| {
        let at = [0, 1].map(|k| {
            let parts = weights.iter().zip(&corners);
            parts.map(|(w, x)| *w as f64 * x[k]).sum::<f64>() / PARTS as f64
        });
        (at, weights)
    })
}
