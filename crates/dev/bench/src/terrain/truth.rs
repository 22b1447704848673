//! Ground truth of a walk: the triangles of the scene, footprints, step edges and planes.

use std::collections::HashMap;

use nalgebra::{Isometry3, Vector3};
use rig_sim::scene::terrain::{Plane, StepEdge};
use rig_sim::simulation::Simulation;
use rig_sim::walker::Side;

use super::walks::WalkInputs;

/// Sole: from the middle to heel and toe, and half of its width, m (280 x 95 mm).
pub(super) const SOLE_M: [f64; 3] = [0.13, 0.15, 0.0475];
/// Spacing of samples of a sole, m.
const SAMPLE_M: f64 = 0.02;
/// Ground under a sole is within this height of it, m; beyond, the sole juts out over an edge.
const UNDER_M: f64 = 0.03;
/// Footprints begin and end this long after and before the keyframes, s.
const MARGIN_S: f64 = 1.0;
/// Shorter edges are those of single stones, m.
const MIN_EDGE_M: f64 = 0.25;
/// One standard deviation of the height of a contact, m: what `bench feet` finds for the stage.
pub(super) const CONTACT_SIGMA_M: f64 = 0.004;
/// Edge of a cell of the table of triangles, m.
const CELL_M: f64 = 0.25;
/// Distance from the footsteps up to which triangles are in the table, m.
const REACH_M: f64 = 4.0;

/// See the module.
pub(crate) struct Truth<'a> {
    simulation: &'a Simulation,
    pub(crate) footprints: Vec<Footprint>,
    triangles: Vec<[Vector3<f64>; 3]>,
    /// Triangles by the columns that they touch.
    columns: HashMap<[i32; 2], Vec<u32>>,
    pub(crate) edges: Vec<Step>,
    pub(crate) planes: Vec<TruePlane>,
}

/// A foot at rest.
pub(crate) struct Footprint {
    /// Middle of the sole, m.
    pub(crate) middle: [f64; 3],
    /// Pose of the foot: x to the toe, z up from the sole.
    pub(crate) world_from_foot: Isometry3<f64>,
    /// Points of the ground under the sole, m.
    pub(crate) ground: Vec<[f64; 3]>,
}

/// Direction in which the walker crossed an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Crossing {
    Up,
    Down,
    Beside,
}

/// A step edge near the footsteps.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    pub(crate) edge: StepEdge,
    pub(crate) crossing: Crossing,
}

/// Points of a plane near the footsteps.
pub(crate) struct TruePlane {
    pub(crate) plane: Plane,
    pub(crate) points: Vec<[f64; 3]>,
}

impl<'a> Truth<'a> {
    pub(crate) fn new(prepared: &'a WalkInputs) -> Self {
        let simulation = &*prepared.simulation;
        let [from, to] = prepared.walk.span_s;
        let mut falls: Vec<_> = [Side::Left, Side::Right]
            .into_iter()
            .flat_map(|side| simulation.walker().contacts(side))
            .filter(|fall| fall.strike_s > from + MARGIN_S && fall.off_s < to - MARGIN_S)
            .collect();
        falls.sort_by(|a, b| a.strike_s.total_cmp(&b.strike_s));
        let footprints: Vec<Footprint> = falls
            .iter()
            .map(|fall| {
                let steps = |from: f64, to: f64| {
                    let count = ((to - from) / SAMPLE_M).round() as i32;
                    (0..=count).map(move |i| from + (to - from) * f64::from(i) / f64::from(count))
                };
                let along = steps(-SOLE_M[0], SOLE_M[1]);
                let points = along.flat_map(|x| steps(-SOLE_M[2], SOLE_M[2]).map(move |y| [x, y]));
                let ground = points.filter_map(|[x, y]| {
                    let sole = fall.position + fall.rotation * Vector3::new(x, y, 0.0);
                    let z = ground(simulation, sole.into(), UNDER_M)?;
                    ((z - sole.z).abs() < UNDER_M).then_some([sole.x, sole.y, z])
                });
                Footprint {
                    middle: fall.position.into(),
                    world_from_foot: Isometry3::from_parts(fall.position.into(), fall.rotation),
                    ground: ground.collect(),
                }
            })
            .collect();
        let mut truth = Self {
            simulation,
            footprints,
            triangles: Vec::new(),
            columns: HashMap::new(),
            edges: Vec::new(),
            planes: Vec::new(),
        };
        truth.add_triangles();
        truth.add_edges();
        truth.add_planes();
        truth
    }

    fn add_triangles(&mut self) {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for print in &self.footprints {
            for k in 0..2 {
                low[k] = low[k].min(print.middle[k] - REACH_M);
                high[k] = high[k].max(print.middle[k] + REACH_M);
            }
        }
        for triangle in &self.simulation.scene().fixed.triangles {
            let corners = triangle.corners.map(|corner| corner.position);
            let range = |k: usize| {
                let least = corners.iter().map(|c| c[k]).fold(f64::INFINITY, f64::min);
                let most = corners
                    .iter()
                    .map(|c| c[k])
                    .fold(f64::NEG_INFINITY, f64::max);
                (least.max(low[k]) / CELL_M - 0.2).floor() as i32
                    ..=(most.min(high[k]) / CELL_M + 0.2).floor() as i32
            };
            let number = self.triangles.len() as u32;
            let mut is_near = false;
            for x in range(0) {
                for y in range(1) {
                    is_near = true;
                    self.columns.entry([x, y]).or_default().push(number);
                }
            }
            if is_near {
                self.triangles.push(corners);
            }
        }
    }

    /// Triangles on which one can walk.
    pub(crate) fn walkable_triangles(&self) -> impl Iterator<Item = [Vector3<f64>; 3]> + '_ {
        let scene = self.simulation.scene();
        let walkable = scene.fixed.triangles.iter().filter(|triangle| {
            let material = &scene.materials[triangle.material as usize];
            material.walkable
        });
        walkable.map(|triangle| triangle.corners.map(|corner| corner.position))
    }

    fn add_edges(&mut self) {
        let mut all = self.simulation.scene().step_edges();
        // The longest first: the simulator lists parts of an edge beside the whole of it.
        all.sort_by(|a, b| length(b).total_cmp(&length(a)));
        for edge in all.into_iter().filter(|edge| length(edge) >= MIN_EDGE_M) {
            if self.edges.iter().any(|longer| is_part(&edge, &longer.edge)) {
                continue;
            }
            let is_near = self
                .footprints
                .iter()
                .any(|print| horizontal_distance(&edge, print.middle) < 1.0);
            if is_near {
                let crossing = self.crossing(&edge);
                self.edges.push(Step { edge, crossing });
            }
        }
    }

    /// How the feet pass an edge, by the first step over it.
    fn crossing(&self, edge: &StepEdge) -> Crossing {
        let [from, to] = edge.ends;
        let along = (to - from).xy();
        let length = along.norm();
        let along = along / length;
        let place = |x: [f64; 3]| {
            let d = Vector3::from(x).xy() - from.xy();
            // The lower side is on the right.
            [along.dot(&d), along.y * d.x - along.x * d.y]
        };
        for pair in self.footprints.windows(2) {
            let [a, b] = [0, 1].map(|k| place(pair[k].middle));
            let is_beside = |at: f64| (-0.3..length + 0.3).contains(&at);
            let is_level = (0..2).all(|k| (pair[k].middle[2] - from.z).abs() < 0.6);
            if a[1] * b[1] < 0.0 && is_beside(a[0]) && is_beside(b[0]) && is_level {
                return if b[1] > 0.0 {
                    Crossing::Down
                } else {
                    Crossing::Up
                };
            }
        }
        Crossing::Beside
    }

    fn add_planes(&mut self) {
        let scene = self.simulation.scene();
        let planes = scene.planes();
        let mut points: Vec<Vec<[f64; 3]>> = vec![Vec::new(); planes.planes.len()];
        for at in self.cells(0.05, 0.6) {
            let Some(ground) = scene.ground(at[0], at[1], at[2] + 0.4) else {
                continue;
            };
            if let Some(plane) = planes.of_triangle[ground.triangle as usize] {
                points[plane as usize].push([at[0], at[1], ground.height]);
            }
        }
        // A quarter of a square metre in cells of 5 cm.
        self.planes = planes
            .planes
            .into_iter()
            .zip(points)
            .filter(|(_, points)| points.len() >= 100)
            .map(|(plane, points)| TruePlane { plane, points })
            .collect();
    }

    /// Centers of cells within a radius of footprints, each with the height of the nearest one.
    pub(crate) fn cells(&self, cell_m: f64, radius_m: f64) -> Vec<[f64; 3]> {
        let mut cells: HashMap<[i32; 2], (f64, f64)> = HashMap::new();
        let reach = (radius_m / cell_m).ceil() as i32;
        for print in &self.footprints {
            let [x, y, z] = print.middle;
            let at = [x, y].map(|v| (v / cell_m).floor() as i32);
            for dy in -reach..=reach {
                for dx in -reach..=reach {
                    let cell = [at[0] + dx, at[1] + dy];
                    let center = cell.map(|k| (f64::from(k) + 0.5) * cell_m);
                    let distance = f64::hypot(center[0] - x, center[1] - y);
                    if distance <= radius_m {
                        let nearest = cells.entry(cell).or_insert((f64::INFINITY, z));
                        if distance < nearest.0 {
                            *nearest = (distance, z);
                        }
                    }
                }
            }
        }
        let mut cells: Vec<_> = cells.into_iter().collect();
        cells.sort_by_key(|(cell, _)| *cell);
        let center = |cell: [i32; 2]| cell.map(|k| (f64::from(k) + 0.5) * cell_m);
        cells
            .into_iter()
            .map(|(cell, (_, z))| [center(cell)[0], center(cell)[1], z])
            .collect()
    }

    /// The ground at a place that is nearest below a height above a point, m.
    pub(crate) fn ground(&self, at: [f64; 3], above_m: f64) -> Option<f64> {
        ground(self.simulation, at, above_m)
    }

    /// Heights of surfaces of any kind at a place, m.
    pub(crate) fn surfaces(&self, [x, y]: [f64; 2]) -> impl Iterator<Item = f64> + '_ {
        let cell = [x, y].map(|v| (v / CELL_M).floor() as i32);
        let numbers = self.columns.get(&cell).map_or(&[][..], Vec::as_slice);
        numbers.iter().filter_map(move |number| {
            let [a, b, c] = self.triangles[*number as usize];
            let (u, v) = ((b - a).xy(), (c - a).xy());
            let area = u.x * v.y - u.y * v.x;
            if area.abs() < 1e-9 {
                return None;
            }
            let d = nalgebra::Vector2::new(x, y) - a.xy();
            let of_b = (d.x * v.y - d.y * v.x) / area;
            let of_c = (u.x * d.y - u.y * d.x) / area;
            let is_inside = of_b >= -1e-6 && of_c >= -1e-6 && of_b + of_c <= 1.0 + 1e-6;
            is_inside.then(|| a.z + of_b * (b.z - a.z) + of_c * (c.z - a.z))
        })
    }

    /// Distance of a point from the nearest surface, m; up to 5 cm it is exact.
    pub(crate) fn distance(&self, x: [f64; 3]) -> f64 {
        let cell = [x[0], x[1]].map(|v| (v / CELL_M).floor() as i32);
        let numbers = self.columns.get(&cell).map_or(&[][..], Vec::as_slice);
        numbers
            .iter()
            .map(|number| {
                distance_to_triangle(&self.triangles[*number as usize], &Vector3::from(x))
            })
            .fold(f64::INFINITY, f64::min)
    }
}

fn ground(simulation: &Simulation, [x, y, z]: [f64; 3], above_m: f64) -> Option<f64> {
    let ground = simulation.scene().ground(x, y, z + above_m)?;
    Some(ground.height)
}

fn length(edge: &StepEdge) -> f64 {
    (edge.ends[1] - edge.ends[0]).norm()
}

/// Whether both ends of an edge lie on a longer one, to a centimetre.
fn is_part(edge: &StepEdge, longer: &StepEdge) -> bool {
    let [from, to] = longer.ends;
    let along = to - from;
    edge.ends.iter().all(|end| {
        let share = along.dot(&(end - from)) / along.norm_squared();
        (end - from - along * share.clamp(0.0, 1.0)).norm() < 0.01
    })
}

/// Horizontal distance of a point from an edge, m.
pub(crate) fn horizontal_distance(edge: &StepEdge, x: [f64; 3]) -> f64 {
    let [from, to] = edge.ends.map(|end| end.xy());
    let (along, d) = (to - from, Vector3::from(x).xy() - from);
    let share = (along.dot(&d) / along.norm_squared()).clamp(0.0, 1.0);
    (d - along * share).norm()
}

/// Distance of a point from a triangle.
pub(crate) fn distance_to_triangle([a, b, c]: &[Vector3<f64>; 3], x: &Vector3<f64>) -> f64 {
    let normal = (b - a).cross(&(c - a));
    let square = normal.norm_squared();
    if square > 1e-18 {
        let side =
            |from: &Vector3<f64>, to: &Vector3<f64>| normal.dot(&(to - from).cross(&(x - from)));
        if side(a, b) >= 0.0 && side(b, c) >= 0.0 && side(c, a) >= 0.0 {
            return normal.dot(&(x - a)).abs() / square.sqrt();
        }
    }
    let segment = |from: &Vector3<f64>, to: &Vector3<f64>| {
        let along = to - from;
        let share = along.dot(&(x - from)) / along.norm_squared().max(1e-18);
        (x - from - along * share.clamp(0.0, 1.0)).norm()
    };
    segment(a, b).min(segment(b, c)).min(segment(c, a))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_from_inside_sides_and_corners() {
        let triangle = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].map(Vector3::from);
        for (x, expected) in [
            ([0.2, 0.2, 0.3], 0.3),
            ([0.5, -0.4, 0.3], 0.5),
            ([-0.3, 0.0, 0.4], 0.5),
            ([1.0, 1.0, 0.0], 0.5_f64.sqrt()),
        ] {
            let found = distance_to_triangle(&triangle, &Vector3::from(x));
            assert!((found - expected).abs() < 1e-12, "{x:?}: {found}");
        }
    }
}
