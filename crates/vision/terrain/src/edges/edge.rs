//! Types of edges.

use nalgebra::Vector3;

/// What an edge is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgeKind {
    /// Two planes meet, and one steps down from one to the other: a tread and the riser below it.
    Convex,
    /// Two planes meet in a corner: a riser and the tread at its foot.
    Concave,
    /// A plane ends, and what is behind its end was not seen: a tread seen from above.
    End,
}

/// A straight edge of a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// What the edge is.
    pub kind: EdgeKind,
    /// Ends, in the world, m.
    pub from: [f64; 3],
    /// The other end.
    pub to: [f64; 3],
    /// One standard deviation of its place on the first plane, across the edge, m.
    pub sigma_m: f64,
    /// The plane, and the one that it meets. The more level one is first.
    pub planes: (u32, Option<u32>),
    /// The step down from the first plane, if there is ground below.
    pub step: Option<Step>,
}

/// Height of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The plane below.
    pub below: u32,
    /// Vertical distance at the middle of the edge, m.
    pub height_m: f64,
    /// One standard deviation, m.
    pub sigma_m: f64,
    /// Views that saw both planes.
    pub views: usize,
    /// Horizontal direction down the step.
    pub direction: [f64; 2],
}

impl Edge {
    /// Length, m.
    pub fn length_m(&self) -> f64 {
        (Vector3::from(self.to) - Vector3::from(self.from)).norm()
    }

    /// Numbers of the planes whose edge it is.
    pub(crate) fn plane_numbers(&self) -> impl Iterator<Item = usize> {
        let (first, second) = self.planes;
        std::iter::once(first)
            .chain(second)
            .map(|number| number as usize)
    }

    /// Middle, m.
    pub fn middle(&self) -> [f64; 3] {
        [0, 1, 2].map(|k| 0.5 * (self.from[k] + self.to[k]))
    }

    /// Distance of a point from the edge, m.
    pub fn distance_m(&self, x: [f64; 3]) -> f64 {
        let [from, to, x] = [self.from, self.to, x].map(Vector3::from);
        let along = to - from;
        let share = along.dot(&(x - from)) / along.norm_squared().max(1e-12);
        (x - from - along * share.clamp(0.0, 1.0)).norm()
    }
}
