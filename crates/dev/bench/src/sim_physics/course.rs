//! Courses of 5 m over step edges of a walk.

use nalgebra::{Vector2, Vector3};
use serde_json::{Value, json};

use crate::terrain::truth::{Crossing, Step, Truth};

/// Length of a course, m.
pub(super) const LENGTH_M: f64 = 5.0;
/// From the start to the first edge, m: the one whose course is nearest to the footprints.
const BEFORE_M: [f64; 6] = [1.0, 1.5, 2.0, 2.5, 3.0, 3.5];
/// The ground is searched below this height above the nearest footprint, m.
const ABOVE_M: f64 = 0.4;

/// A straight line over the ground.
#[derive(Clone, Debug)]
pub(super) struct Course {
    pub(super) name: String,
    pub(super) start: [f64; 3],
    /// Unit vector.
    ahead: Vector2<f64>,
    /// From the start to the first edge, m.
    pub(super) before_m: f64,
    /// Distance from the nearest footprint, where it is largest, m.
    pub(super) away_m: f64,
}

impl Course {
    /// Whether a triangle may touch the ground within a distance of the course.
    pub(super) fn is_beside(&self, corners: &[Vector3<f64>; 3], margin_m: f64) -> bool {
        let start = Vector2::new(self.start[0], self.start[1]);
        let across = Vector2::new(-self.ahead.y, self.ahead.x);
        let overlaps = |axis: Vector2<f64>, low: f64, high: f64| {
            let places = corners.map(|corner| axis.dot(&(corner.xy() - start)));
            let is_above = places.iter().any(|v| *v > low - margin_m);
            is_above && places.iter().any(|v| *v < high + margin_m)
        };
        overlaps(self.ahead, 0.0, LENGTH_M) && overlaps(across, 0.0, 0.0)
    }

    /// Places along the course and along parallels on either side of it, each with the height of
    /// the footprint nearest to the middle, m.
    pub(super) fn places(
        &self,
        truth: &Truth<'_>,
        along_m: f64,
        aside_m: f64,
        parallels: i32,
    ) -> Vec<Vector3<f64>> {
        let start = Vector2::new(self.start[0], self.start[1]);
        let left = Vector2::new(-self.ahead.y, self.ahead.x);
        let count = (LENGTH_M / along_m) as i32;
        let along = (0..=count).map(|k| start + self.ahead * (f64::from(k) * along_m));
        let place = |middle: Vector2<f64>| {
            let z = nearest_footprint(truth, middle.into())?[2];
            Some((-parallels..=parallels).map(move |k| {
                let at = middle + left * (f64::from(k) * aside_m);
                Vector3::new(at.x, at.y, z)
            }))
        };
        along.filter_map(place).flatten().collect()
    }

    /// For the script.
    pub(super) fn to_json(&self) -> Value {
        json!({
            "start": self.start,
            "heading_rad": libm::atan2(self.ahead.y, self.ahead.x),
            "length_m": LENGTH_M,
        })
    }
}

/// Courses up and down the steps that the walker went over in a direction: over the lowest edge
/// of those going up, and over the highest of those going down.
pub(super) fn courses(truth: &Truth<'_>) -> Vec<Course> {
    let crossed = |crossing: Crossing| {
        truth
            .edges
            .iter()
            .filter(move |own| own.crossing == crossing)
    };
    let height = |own: &&Step| own.edge.ends[0].z;
    let up = crossed(Crossing::Up).min_by(|a, b| height(a).total_cmp(&height(b)));
    let down = crossed(Crossing::Down).max_by(|a, b| height(a).total_cmp(&height(b)));
    let of = |name: &str, edge: Option<&Step>, sign: f64| {
        let [from, to] = edge?.edge.ends;
        let along = (to - from).xy().normalize();
        // The lower side is on the right.
        let ahead = Vector2::new(-along.y, along.x) * sign;
        let middle = crossing_place(truth, from, to)?;
        let away = |before_m: &f64| {
            let places = [0.0, 0.25, 0.5, 0.75, 1.0].map(|share| LENGTH_M * share - before_m);
            let distances = places.map(|place| from_footprints(truth, middle + ahead * place));
            distances.into_iter().fold(0.0, f64::max)
        };
        let before_m = BEFORE_M
            .into_iter()
            .min_by(|a, b| away(a).total_cmp(&away(b)))?;
        let start = middle - ahead * before_m;
        let z = ground(truth, start.into())?;
        Some(Course {
            name: name.to_owned(),
            start: [start.x, start.y, z],
            ahead,
            before_m,
            away_m: away(&before_m),
        })
    };
    [of("up", up, 1.0), of("down", down, -1.0)]
        .into_iter()
        .flatten()
        .collect()
}

/// Place on an edge nearest to a footprint.
fn crossing_place(truth: &Truth<'_>, from: Vector3<f64>, to: Vector3<f64>) -> Option<Vector2<f64>> {
    let along = (to - from).xy();
    let near = truth.footprints.iter().map(|print| {
        let d = Vector3::from(print.middle).xy() - from.xy();
        let share = (along.dot(&d) / along.norm_squared()).clamp(0.1, 0.9);
        let place = from.xy() + along * share;
        let away = (Vector3::from(print.middle).xy() - place).norm();
        (away + (print.middle[2] - from.z).abs(), place)
    });
    near.min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, place)| place)
}

/// Horizontal distance from the nearest footprint, m.
fn from_footprints(truth: &Truth<'_>, at: Vector2<f64>) -> f64 {
    let prints = truth.footprints.iter();
    let distances = prints.map(|print| (Vector3::from(print.middle).xy() - at).norm());
    distances.fold(f64::INFINITY, f64::min)
}

/// True height of the ground on the level of the nearest footprint, m.
fn ground(truth: &Truth<'_>, at: [f64; 2]) -> Option<f64> {
    let nearest = nearest_footprint(truth, at)?;
    truth.ground([at[0], at[1], nearest[2]], ABOVE_M)
}

fn nearest_footprint(truth: &Truth<'_>, at: [f64; 2]) -> Option<[f64; 3]> {
    let distance = |x: &[f64; 3]| f64::hypot(x[0] - at[0], x[1] - at[1]);
    let prints = truth.footprints.iter().map(|print| print.middle);
    prints.min_by(|a, b| distance(a).total_cmp(&distance(b)))
}
