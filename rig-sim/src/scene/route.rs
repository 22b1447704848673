//! Where and how one walks: what a place suggests to a walker.

/// A closed way on the ground, and how it is walked.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    /// Corners of a closed polygon in x and y, m; the way is the smooth curve that they control.
    pub points: Vec<[f64; 2]>,
    /// A height from which the ground at the first point is found by looking down, m.
    pub start_below: f64,
    /// One after the other, and again from the first.
    pub legs: Vec<Leg>,
}

/// One way of going on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Leg {
    /// Walks, or above some 2 m/s jogs.
    Walk {
        /// How far, m.
        metres: f64,
        /// m/s.
        speed: f64,
    },
    /// Stands still.
    Stand {
        /// How long, s.
        seconds: f64,
    },
    /// Catches a foot while walking.
    Stumble,
}
