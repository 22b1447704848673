//! Path on the ground: a closed smooth curve, parametrized by distance.

/// Approximate distance between entries of the table, m.
const STEP_M: f64 = 0.02;

/// A closed curve with continuous curvature.
#[derive(Clone, Debug)]
pub struct Path {
    /// Position and direction at every `step_m`.
    table: Vec<([f64; 2], [f64; 2])>,
    step_m: f64,
}

impl Path {
    /// The uniform cubic B-spline with these control points, closed.
    pub fn closed(points: &[[f64; 2]]) -> Self {
        let n = points.len();
        let at = |u: f64| {
            let i = u.floor() as usize;
            let s = u - i as f64;
            let weights = [
                (1.0 - s).powi(3) / 6.0,
                (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0,
                (1.0 + 3.0 * s + 3.0 * s * s - 3.0 * s * s * s) / 6.0,
                s * s * s / 6.0,
            ];
            let mut p = [0.0; 2];
            for (k, w) in weights.into_iter().enumerate() {
                let q = points[(i + k + n - 1) % n];
                p[0] += w * q[0];
                p[1] += w * q[1];
            }
            p
        };
        // Short chords, resampled at equal distances.
        let fine = 400 * n;
        let chain: Vec<[f64; 2]> = (0..=fine)
            .map(|k| at((k % fine) as f64 * n as f64 / fine as f64))
            .collect();
        let chord = |pair: &[[f64; 2]]| {
            let d = [0, 1].map(|i| pair[1][i] - pair[0][i]);
            (d[0] * d[0] + d[1] * d[1]).sqrt()
        };
        let length: f64 = chain.windows(2).map(chord).sum();
        let count = (length / STEP_M).ceil().max(4.0) as usize;
        let step_m = length / count as f64;
        let mut places = Vec::with_capacity(count);
        let mut gone = 0.0;
        for pair in chain.windows(2) {
            let chord = chord(pair);
            while places.len() < count && step_m * places.len() as f64 <= gone + chord {
                let t = (step_m * places.len() as f64 - gone) / chord;
                places.push([0, 1].map(|i| pair[0][i] + (pair[1][i] - pair[0][i]) * t));
            }
            gone += chord;
        }
        let count = places.len();
        let with_direction = (0..count).map(|i| {
            let (a, b) = (places[(i + count - 1) % count], places[(i + 1) % count]);
            let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
            let length = (dx * dx + dy * dy).sqrt();
            (places[i], [dx / length, dy / length])
        });
        Self {
            table: with_direction.collect(),
            step_m,
        }
    }

    /// Length of one lap, m.
    pub(crate) fn length_m(&self) -> f64 {
        self.step_m * self.table.len() as f64
    }

    /// Position and unit direction after a distance.
    pub fn at(&self, distance_m: f64) -> ([f64; 2], [f64; 2]) {
        let u = (distance_m / self.step_m).rem_euclid(self.table.len() as f64);
        let i = u.floor() as usize;
        let (a, b) = (
            self.table[i % self.table.len()],
            self.table[(i + 1) % self.table.len()],
        );
        let t = u - i as f64;
        let mix = |p: [f64; 2], q: [f64; 2]| [0, 1].map(|k| p[k] + (q[k] - p[k]) * t);
        (mix(a.0, b.0), mix(a.1, b.1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curve_is_parametrized_by_distance_and_closed() {
        let path = Path::closed(&[[0.0, 0.0], [10.0, 0.0], [10.0, 6.0], [0.0, 6.0]]);
        let length = path.length_m();
        assert!((15.0..30.0).contains(&length), "{length}");
        for k in 0..1000 {
            let s = length * f64::from(k) / 1000.0;
            let ((a, direction), (b, _)) = (path.at(s), path.at(s + 0.01));
            let step = [b[0] - a[0], b[1] - a[1]];
            assert!(
                (step[0].hypot(step[1]) - 0.01).abs() < 2e-4,
                "{s}: {step:?}"
            );
            assert!(
                step[0] * direction[0] + step[1] * direction[1] > 0.0099,
                "{s}"
            );
        }
    }
}
