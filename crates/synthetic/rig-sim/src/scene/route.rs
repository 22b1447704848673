//! Where and how one walks: what a place suggests to a walker.

use crate::walker::path::Path;

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

impl Leg {
    /// A walk of so many metres at so many m/s.
    pub const fn walk(metres: f64, speed: f64) -> Self {
        Self::Walk { metres, speed }
    }
}

/// Lengths of the parts into which places cut a closed way, m: from its start to the point nearest to
/// the first place, from there to that of the next, and at last back to the start. Places come in the
/// order in which they are passed. Legs that are as long make every round the same.
pub fn parts(points: &[[f64; 2]], places: &[[f64; 2]]) -> Vec<f64> {
    const STEP_M: f64 = 0.05;
    let path = Path::closed(points);
    let length = path.length_m();
    let steps = (length / STEP_M) as usize;
    let nearest = |place: &[f64; 2]| {
        let square = |step: usize| {
            let ([x, y], _) = path.at(STEP_M * step as f64);
            (x - place[0]) * (x - place[0]) + (y - place[1]) * (y - place[1])
        };
        let best = (0..steps).min_by(|&a, &b| square(a).total_cmp(&square(b)));
        STEP_M * best.unwrap_or(0) as f64
    };
    let mut cuts = vec![0.0];
    cuts.extend(places.iter().map(nearest));
    cuts.push(length);
    cuts.windows(2).map(|pair| pair[1] - pair[0]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_make_up_a_round() {
        let square = [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]];
        let parts = parts(&square, &[[9.0, 1.0], [5.0, 9.0]]);
        let round = Path::closed(&square).length_m();
        assert!(
            (parts.iter().sum::<f64>() - round).abs() < 1e-9,
            "{parts:?}"
        );
        // From a corner to the next is a quarter; from there to the middle of a side is more.
        let quarter = 0.25 * round;
        assert!((parts[0] - quarter).abs() < 0.1, "{parts:?} {quarter}");
        assert!(
            (parts[1] - 1.5 * quarter).abs() < 0.1,
            "{parts:?} {quarter}"
        );
    }
}
