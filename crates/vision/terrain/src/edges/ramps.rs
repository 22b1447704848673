//! Ramps below steps that are errors of the matcher.
//!
//! A view from above sees the border of a tread and, behind it, the tread below, but not the riser
//! between them. Matchers join both over a few pixels by a ramp that descends away from the
//! camera: in the mesh, and where many views agree even as a plane. Where the depths of other views
//! end at the edge (an edge of the type `End` with a step), no surface can be on the ramp.
//!
//! Contract: a point is on a ramp if it is beside such an edge on its lower side, below a line that
//! falls from the edge at `min_slope`, and above the plane below the step. Edges of leaning planes
//! count if they are steps of a flight, parallel to an edge of the type `End` nearby. Planes are
//! ramps if most of what was observed of them is on ramps.

use nalgebra::{Vector2, Vector3};

use super::edge::{Edge, EdgeKind};
use crate::config::RampConfig;
use crate::mesh::Mesh;
use crate::planes::{Plane, Planes};

/// Least cosine of the directions of two steps of a flight.
const PARALLEL_COS: f64 = 0.97;
/// Spacing of the places at which a plane is searched, m.
const SEARCH_M: f64 = 0.02;
/// Distance from an edge within which the ground above it was observed, m.
const BORDER_M: f64 = 0.10;
/// Distance beyond an edge from which on it was not, m.
const BEYOND_M: f64 = 0.06;

/// A mesh whose vertices on ramps below steps are moved down to the ground there. Vertices of the
/// ground above that are beyond its edge are moved back to it; those of other planes that are no
/// ramps remain.
///
/// The planes and edges must be those of the mesh.
pub fn without_ramps(mesh: &Mesh, planes: &Planes, edges: &[Edge], config: &RampConfig) -> Mesh {
    Ramps::new(planes, edges, config).lowered(mesh)
}

/// Ground below steps, and what of the surface there is an error.
#[derive(Clone, Debug)]
pub(crate) struct Ramps<'a> {
    planes: &'a Planes,
    strips: Vec<Strip>,
    is_ramp: Vec<bool>,
    config: RampConfig,
}

/// The ground below an edge with a step.
#[derive(Clone, Debug)]
pub(crate) struct Strip {
    /// Begin of the edge, m.
    pub(crate) from: Vector3<f64>,
    /// Unit vector along the edge, horizontal, and its rise per metre.
    pub(crate) along: Vector2<f64>,
    rise: f64,
    /// Horizontal unit vector down the step.
    pub(crate) direction: Vector2<f64>,
    pub(crate) length_m: f64,
    pub(crate) upper: usize,
    pub(crate) below: usize,
}

/// A point of the ground below a step.
struct Ground<'a> {
    at: [f64; 3],
    plane: &'a Plane,
}

impl<'a> Ramps<'a> {
    /// Of planes and their edges.
    pub(crate) fn new(planes: &'a Planes, edges: &[Edge], config: &RampConfig) -> Self {
        let mut ramps = Self {
            planes,
            strips: strips(planes, edges, config),
            is_ramp: Vec::new(),
            config: *config,
        };
        let planes = planes.planes.iter();
        ramps.is_ramp = planes.map(|plane| ramps.is_ramp_plane(plane)).collect();
        ramps
    }

    /// Whether a plane is no surface, but a ramp.
    pub(crate) fn is_ramp(&self, plane: usize) -> bool {
        self.is_ramp[plane]
    }

    /// See [`without_ramps`].
    fn lowered(&self, mesh: &Mesh) -> Mesh {
        let mut lowered = mesh.clone();
        for (number, position) in lowered.positions.iter_mut().enumerate() {
            let of_plane = self.planes.of_vertex.get(number).copied().flatten();
            let of_plane = of_plane.filter(|plane| !self.is_ramp[*plane as usize]);
            let x = Vector3::from(position.map(f64::from));
            if let Some(plane) = of_plane {
                let plane = &self.planes.planes[plane as usize];
                if let Some(at) = self.on_edge(plane, &x) {
                    *position = at.map(|v| v as f32);
                }
            } else if let Some(foot) = self.ground(&x) {
                *position = foot.at.map(|v| v as f32);
                lowered.normals[number] = foot.plane.normal.map(|v| v as f32);
                lowered.sigma_m[number] = foot.plane.sigma_at(foot.at) as f32;
            }
        }
        lowered
    }

    /// The place on an edge that a point of the ground above it belongs to, if it is beyond it.
    fn on_edge(&self, plane: &Plane, x: &Vector3<f64>) -> Option<[f64; 3]> {
        let is_ground = plane.frame.normal.z > self.config.max_plane_cos;
        let mut strips = self.strips.iter().filter(|_| is_ground);
        strips.find_map(|strip| {
            let [along, away] = strip.coordinates(&x.xy());
            let edge = strip.height_m(along);
            let is_beyond = away > 0.0
                && away <= self.config.max_overhang_m
                && (x.z - edge).abs() <= self.config.max_above_m;
            self.below(strip, x, self.config.margin_m)
                .filter(|_| is_beyond)?;
            let at = x.xy() - strip.direction * away;
            Some([at.x, at.y, plane.height_at(at.x, at.y)?])
        })
    }

    /// The strips of ground below steps.
    pub(crate) fn strips(&self) -> &[Strip] {
        &self.strips
    }

    /// The ground below a point of a ramp; near the edge, that at the foot of the step.
    fn ground(&self, x: &Vector3<f64>) -> Option<Ground<'a>> {
        let of_strips = self.strips.iter().filter_map(|strip| {
            let height = self.below(strip, x, 0.0)?;
            let [_, away] = strip.coordinates(&x.xy());
            let back = match away < self.config.foot_reach_m {
                true => away - self.config.min_run_m,
                false => 0.0,
            };
            let at = x.xy() - strip.direction * back;
            Some((height, at, &self.planes.planes[strip.below]))
        });
        let (_, at, plane) = of_strips.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let at = [at.x, at.y, plane.height_at(at.x, at.y)?];
        Some(Ground { at, plane })
    }

    /// Height of the ground of a strip below a point that is on its ramp, or within a margin of it.
    fn below(&self, strip: &Strip, x: &Vector3<f64>, margin: f64) -> Option<f64> {
        let [along, away] = strip.coordinates(&x.xy());
        let config = &self.config;
        let is_beside = (-config.max_extension_m..=strip.length_m + config.max_extension_m)
            .contains(&along)
            && away > config.min_run_m - margin
            && away <= config.max_run_m + margin;
        if !is_beside {
            return None;
        }
        let edge = strip.height_m(along);
        let height = self.planes.planes[strip.below].height_at(x.x, x.y)?;
        let is_on_ramp = x.z >= height - margin
            && x.z <= edge + config.max_above_m - config.min_slope * away + margin;
        (is_on_ramp && self.is_step(strip, along)).then_some(height)
    }

    /// Whether the ground above a strip ends at a place along its edge, and that below was seen.
    pub(crate) fn is_step(&self, strip: &Strip, along: f64) -> bool {
        let at = strip.from.xy() + strip.along * along;
        let is_observed = |number: usize, away: f64| {
            let x = at + strip.direction * away;
            let plane = &self.planes.planes[number];
            let height = plane.height_at(x.x, x.y);
            height.is_some_and(|height| plane.is_observed([x.x, x.y, height]))
        };
        let places = |from_m: f64, to_m: f64| {
            let [first, last] = [from_m, to_m].map(|v| (v / SEARCH_M).round() as usize);
            (first..=last).map(|k| SEARCH_M * k as f64)
        };
        let reach_m = self.config.max_reach_m;
        places(SEARCH_M, BORDER_M).any(|away| is_observed(strip.upper, -away))
            && !places(BEYOND_M, BORDER_M + BEYOND_M).all(|away| is_observed(strip.upper, away))
            && places(SEARCH_M, reach_m).any(|away| is_observed(strip.below, away))
    }

    fn is_ramp_plane(&self, plane: &Plane) -> bool {
        let config = &self.config;
        let normal = plane.frame.normal;
        if !(config.min_plane_cos..=config.max_plane_cos).contains(&normal.z) {
            return false;
        }
        let facing: Vec<&Strip> = self
            .strips
            .iter()
            .filter(|strip| normal.xy().normalize().dot(&strip.direction) >= config.min_facing_cos)
            .collect();
        let observed = plane.observed.iter().enumerate().filter(|(_, is)| **is);
        let (mut count, mut on_ramp) = (0_usize, 0_usize);
        for (index, _) in observed {
            let x = plane.frame.position(plane.support.center(index));
            let is_on_ramp = |strip: &&Strip| self.below(strip, &x, config.margin_m).is_some();
            count += 1;
            on_ramp += usize::from(facing.iter().any(is_on_ramp));
        }
        on_ramp as f64 > config.min_share * count as f64
    }
}

impl Strip {
    pub(crate) fn new(edge: &Edge, step: &super::edge::Step) -> Option<Self> {
        let [from, to] = [edge.from, edge.to].map(Vector3::from);
        let length_m = (to - from).xy().norm();
        (length_m > 1e-3).then(|| Self {
            from,
            along: (to - from).xy() / length_m,
            rise: (to.z - from.z) / length_m,
            direction: Vector2::from(step.direction),
            length_m,
            upper: edge.planes.0 as usize,
            below: step.below as usize,
        })
    }

    /// Coordinates along the edge and away from it, down the step.
    pub(crate) fn coordinates(&self, at: &Vector2<f64>) -> [f64; 2] {
        let d = at - self.from.xy();
        [self.along.dot(&d), self.direction.dot(&d)]
    }

    /// Height of the edge at a place along it, m.
    pub(crate) fn height_m(&self, along: f64) -> f64 {
        self.from.z + self.rise * along
    }

    fn middle(&self) -> Vector2<f64> {
        self.from.xy() + self.along * (0.5 * self.length_m)
    }
}

/// Strips of edges where depths end, and of leaning planes of the same flights.
fn strips(planes: &Planes, edges: &[Edge], config: &RampConfig) -> Vec<Strip> {
    let of_kind = |is: &dyn Fn(&Edge) -> bool| -> Vec<Strip> {
        let own = edges.iter().filter(|edge| is(edge));
        own.filter_map(|edge| Strip::new(edge, edge.step.as_ref()?))
            .collect()
    };
    let ends = of_kind(&|edge| edge.kind == EdgeKind::End);
    let leaning = of_kind(&|edge| {
        let riser = edge.planes.1.map(|riser| &planes.planes[riser as usize]);
        edge.kind == EdgeKind::Convex
            && riser.is_some_and(|riser| riser.frame.normal.z >= config.min_plane_cos)
    });
    let is_of_flight = |strip: &Strip| {
        ends.iter().any(|end| {
            let d = end.middle() - strip.middle();
            end.direction.dot(&strip.direction) >= PARALLEL_COS
                && end.direction.dot(&d).abs() <= config.max_flight_m
        })
    };
    let leaning = leaning.into_iter().filter(is_of_flight);
    let leaning: Vec<Strip> = leaning.collect();
    ends.into_iter().chain(leaning).collect()
}
