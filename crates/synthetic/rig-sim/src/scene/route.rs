//! Route of a walker through a scene.

use crate::walker::path::Path;

/// A closed path on the ground, with the legs of the walk.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    /// Corners of a closed polygon in x and y, m: control points of the smooth path.
    pub points: Vec<[f64; 2]>,
    /// Height from which the ground below the first point is searched, m.
    pub start_below: f64,
    /// Legs in order, repeated from the first.
    pub legs: Vec<Leg>,
}

/// A leg of the walk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Leg {
    /// Walk, or above about 2 m/s jog.
    Walk {
        /// Distance, m.
        metres: f64,
        /// Speed, m/s.
        speed: f64,
    },
    /// Stand.
    Stand {
        /// Duration, s.
        seconds: f64,
    },
    /// Stumble while walking.
    Stumble,
}

impl Leg {
    /// A walk of `metres` m at `speed` m/s.
    pub const fn walk(metres: f64, speed: f64) -> Self {
        Self::Walk { metres, speed }
    }
}

/// Lengths of the parts into which positions divide a closed path, m: from its start to the point
/// nearest to the first position, from there to that of the next, and finally back to the start.
/// Positions are in the order of the path. With legs of these lengths every lap is the same.
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
    fn parts_add_up_to_a_lap() {
        let square = [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]];
        let parts = parts(&square, &[[9.0, 1.0], [5.0, 9.0]]);
        let round = Path::closed(&square).length_m();
        assert!(
            (parts.iter().sum::<f64>() - round).abs() < 1e-9,
            "{parts:?}"
        );
        // From one corner to the next is a quarter of a lap; from there to the middle of a side is
        // more.
        let quarter = 0.25 * round;
        assert!((parts[0] - quarter).abs() < 0.1, "{parts:?} {quarter}");
        assert!(
            (parts[1] - 1.5 * quarter).abs() < 0.1,
            "{parts:?} {quarter}"
        );
    }
}
