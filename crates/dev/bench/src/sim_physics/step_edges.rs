//! Step edges of a collision shape: where they are, and how high, against the true ones.
//!
//! Profiles cross a true edge every five centimetres of it, where feet go. Heights are compared six
//! centimetres from the edge on both sides; the edge of the shape is where its profile, from the
//! upper side on, first falls below the middle of both true heights.

use nalgebra::Vector2;
use serde_json::{Value, json};

use super::probe::Probe;
use super::values::{FEET_REACH_M, LEVEL_M};
use crate::terrain::scores::Quantiles;
use crate::terrain::truth::{Footprint, Step, Truth};

/// Distance of profiles along an edge, and from its ends, m.
const ALONG_M: f64 = 0.05;
/// Reach of a profile to both sides, and distance of its points, m.
const REACH_M: f64 = 0.12;
const POINT_M: f64 = 0.002;
/// Where heights are compared, m from the edge.
const BESIDE_M: f64 = 0.06;
/// True ground beside the edge is that of the edge itself, m: no other edge is that near.
const SAME_M: f64 = 0.01;

/// Errors of the edges that a shape has.
pub(super) fn step_edges(probe: &Probe, truth: &Truth<'_>) -> Value {
    let (mut profiles, mut lacking) = (0, 0);
    let (mut positions, mut heights) = (Vec::new(), Vec::new());
    let all = truth.edges.iter().flat_map(|step| of_edge(step, truth));
    for profile in all.filter(|profile| profile.is_near(&truth.footprints)) {
        profiles += 1;
        match profile.found(probe) {
            Some((position_m, height_m)) => {
                positions.push(position_m);
                heights.push(height_m);
            }
            None => lacking += 1,
        }
    }
    json!({
        "profiles": profiles,
        "lacking_share": f64::from(lacking) / f64::from(profiles.max(1)),
        "position": Quantiles::of(positions),
        "height": Quantiles::of(heights),
    })
}

/// A line across an edge.
struct Profile {
    /// The point of the edge, m.
    at: Vector2<f64>,
    /// Unit vector to the lower side.
    across: Vector2<f64>,
    /// True heights on the upper and the lower side, m.
    true_m: [f64; 2],
}

fn of_edge<'a>(step: &Step, truth: &'a Truth<'_>) -> impl Iterator<Item = Profile> + 'a {
    let [from, to] = step.edge.ends;
    let lower_m = step.edge.lower_m;
    let length_m = (to - from).norm();
    let along = (to - from).xy().normalize();
    // The lower side is on the right.
    let across = Vector2::new(along.y, -along.x);
    let count = ((length_m / ALONG_M) as usize).saturating_sub(1);
    (1..=count).filter_map(move |number| {
        let share = number as f64 * ALONG_M / length_m;
        let place = from + (to - from) * share;
        let expected_m = [place.z, lower_m[0] + (lower_m[1] - lower_m[0]) * share];
        let mut true_m = [0.0; 2];
        for (side, sign) in [-1.0, 1.0].into_iter().enumerate() {
            let at = place.xy() + across * (sign * BESIDE_M);
            let found = truth.ground([at.x, at.y, expected_m[side]], SAME_M)?;
            if (found - expected_m[side]).abs() > SAME_M {
                return None;
            }
            true_m[side] = found;
        }
        Some(Profile {
            at: place.xy(),
            across,
            true_m,
        })
    })
}

impl Profile {
    /// Whether feet go there.
    fn is_near(&self, footprints: &[Footprint]) -> bool {
        footprints.iter().any(|print| {
            let [x, y, z] = print.middle;
            let far_m = (Vector2::new(x, y) - self.at).norm();
            far_m <= FEET_REACH_M && (z - self.true_m[0]).abs() <= LEVEL_M
        })
    }

    /// Errors of the position of the edge, positive towards the lower side, and of its height, m.
    fn found(&self, probe: &Probe) -> Option<(f64, f64)> {
        let [upper_m, lower_m] = self.true_m;
        let height = |x: f64| {
            Some(
                probe
                    .highest(self.at + self.across * x, upper_m, LEVEL_M)?
                    .0,
            )
        };
        let middle_m = 0.5 * (upper_m + lower_m);
        let count = (2.0 * REACH_M / POINT_M).round() as i32;
        let places = (0..=count).map(|k| f64::from(k) * POINT_M - REACH_M);
        let mut last = None;
        let mut position_m = None;
        for x in places {
            // Nothing at all is below too: a foot finds no upper side there.
            let is_above = height(x).is_some_and(|z| z >= middle_m);
            if let (Some(above), false) = (last, is_above) {
                position_m = Some(0.5 * (above + x));
                break;
            }
            last = is_above.then_some(x);
        }
        let step_m = height(-BESIDE_M)? - height(BESIDE_M)?;
        Some((position_m?, step_m - (upper_m - lower_m)))
    }
}

#[cfg(test)]
mod tests {
    use scene_bundle::outputs::collision::{Collision, HeightLayer};
    use scene_bundle::outputs::grid::Grid;

    use super::*;

    #[test]
    fn an_edge_beside_the_true_one_is_found_with_its_height() {
        // Falls by 0.2 m between x = 1.02 and 1.03 m.
        let cell_m = 0.01;
        let heights = (0..3 * 201).map(|cell| if cell % 201 <= 102 { 0.2_f32 } else { 0.0 });
        let layer = HeightLayer {
            grid: Grid {
                cell_m,
                origin_m: [0.0, 0.0],
                columns: 201,
                rows: 3,
            },
            heights_m: heights.collect(),
        };
        let collision = Collision {
            layers: vec![layer],
            ..Collision::default()
        };
        let profile = Profile {
            at: Vector2::new(1.0, 0.01),
            across: Vector2::new(1.0, 0.0),
            true_m: [0.21, 0.0],
        };
        let (position_m, height_m) = profile.found(&Probe::new(&collision)).expect("an edge");
        assert!((position_m - 0.025).abs() < 0.004, "{position_m}");
        assert!((height_m + 0.01).abs() < 1e-6, "{height_m}");
        assert!(profile.found(&Probe::new(&Collision::default())).is_none());
    }
}
