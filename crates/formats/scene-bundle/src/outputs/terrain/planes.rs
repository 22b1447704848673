//! Planes of the ground and their edges.

use serde::{Deserialize, Serialize};

use crate::outputs::Fault;

/// Largest deviation of normals and axes from length 1 and from right angles.
const MAX_AXES_ERROR: f64 = 1e-6;

/// A plane part of the surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TerrainPlane {
    /// A point near its middle, in the world, m.
    pub center_m: [f64; 3],
    /// Outward normal, of length 1.
    pub normal: [f64; 3],
    /// Axes on the plane for the coordinates of the polygons, of length 1; the normal is their
    /// cross product.
    pub axes: [[f64; 3]; 2],
    /// One standard deviation of the position along the normal at the center, m.
    pub sigma_m: f64,
    /// One standard deviation of the slope along both axes, rad.
    pub tilt_sigma_rad: [f64; 2],
    /// Depths that the plane was fitted to.
    pub depths: u64,
    /// Views of these depths.
    pub views: u64,
    /// Chi-square per depth.
    pub chi_square: f64,
    /// Observed area, m2.
    pub area_m2: f64,
    /// Observed parts.
    pub polygons: Vec<TerrainPolygon>,
}

/// A polygon with holes, in coordinates along the axes of a plane from its center, m.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TerrainPolygon {
    /// Corners, counterclockwise seen from outside.
    pub outline_m: Vec<[f64; 2]>,
    /// Corners of each hole, clockwise.
    pub holes_m: Vec<Vec<[f64; 2]>>,
}

/// What an edge is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EdgeKind {
    /// Two planes meet, and one steps down from one to the other: a tread and the riser below it.
    Convex,
    /// Two planes meet in a corner: a riser and the tread at its foot.
    Concave,
    /// A plane ends, and what is behind its end was not seen: a tread seen from above.
    End,
}

/// A straight edge of a plane.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepEdge {
    /// What the edge is.
    pub kind: EdgeKind,
    /// One end, in the world, m.
    pub from_m: [f64; 3],
    /// The other end, in the world, m.
    pub to_m: [f64; 3],
    /// One standard deviation of its place on the first plane, across the edge, m.
    pub sigma_m: f64,
    /// The plane, and the one that it meets. The more level one is first.
    pub planes: (u32, Option<u32>),
    /// The step down from the first plane, if there is ground below.
    pub step: Option<Step>,
}

/// Height of a step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// The plane below.
    pub below: u32,
    /// Vertical distance at the middle of the edge, m.
    pub height_m: f64,
    /// One standard deviation, m.
    pub sigma_m: f64,
    /// Views that saw both planes.
    pub views: u64,
    /// Horizontal direction down the step, x and y in the world.
    pub direction: [f64; 2],
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Numbers that must be finite, and of sigmas that must not be negative.
fn check_numbers(place: &str, numbers: &[f64], sigmas: &[f64]) -> Result<(), Fault> {
    if let Some(number) = numbers.iter().chain(sigmas).find(|v| !v.is_finite()) {
        let found = format!("a number that is {number}");
        return Err(Fault::new(place, found, "finite numbers"));
    }
    match sigmas.iter().find(|v| **v < 0.0) {
        Some(sigma) => {
            let found = format!("a standard deviation or area of {sigma}");
            Err(Fault::new(place, found, "0 or more"))
        }
        None => Ok(()),
    }
}

impl TerrainPlane {
    pub(super) fn check(&self, place: &str) -> Result<(), Fault> {
        let [first, second] = self.axes;
        let numbers = [self.center_m, self.normal, first, second];
        let [along, across] = self.tilt_sigma_rad;
        let sigmas = [self.sigma_m, along, across, self.chi_square, self.area_m2];
        check_numbers(place, numbers.as_flattened(), &sigmas)?;
        let normal = cross(first, second);
        let normal_error = (0..3).map(|k| (normal[k] - self.normal[k]).abs());
        let errors = [
            dot(first, first) - 1.0,
            dot(second, second) - 1.0,
            dot(first, second),
        ];
        let error = errors
            .into_iter()
            .map(f64::abs)
            .chain(normal_error)
            .fold(0.0, f64::max);
        if error > MAX_AXES_ERROR {
            let found = format!("axes {:?} with normal {:?}", self.axes, self.normal);
            let expected = "lengths of 1 and right angles, the normal being their cross product";
            return Err(Fault::new(place, found, expected));
        }
        for polygon in &self.polygons {
            for corners in polygon.holes_m.iter().chain([&polygon.outline_m]) {
                check_numbers(place, corners.as_flattened(), &[])?;
                if corners.len() < 3 {
                    let found = format!("an outline of {} corners", corners.len());
                    return Err(Fault::new(place, found, "3 or more"));
                }
            }
        }
        Ok(())
    }
}

impl StepEdge {
    pub(super) fn check(&self, place: &str, planes: usize) -> Result<(), Fault> {
        check_numbers(
            place,
            [self.from_m, self.to_m].as_flattened(),
            &[self.sigma_m],
        )?;
        let (first, second) = self.planes;
        let below = self.step.map(|step| step.below);
        let mut named = [Some(first), second, below].into_iter().flatten();
        if let Some(plane) = named.find(|plane| *plane as usize >= planes) {
            let found = format!("plane {plane} of {planes}");
            return Err(Fault::new(place, found, "the index of a plane"));
        }
        let Some(step) = self.step else {
            return Ok(());
        };
        let [x, y] = step.direction;
        check_numbers(place, &[step.height_m, x, y], &[step.sigma_m])
    }
}
