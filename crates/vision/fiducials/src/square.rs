//! Perspective mapping of the unit square, and distances.

/// Maps (u, v) of the unit square to the image: (0, 0), (1, 0), (1, 1), (0, 1) go to the four
/// corners. Heckbert (1989), section 2.2.3.
#[derive(Clone, Copy, Debug)]
pub struct Square([f64; 8]);

impl Square {
    /// `None` for corners of which three are on a line, or that are not convex.
    pub fn new(corners: [[f64; 2]; 4]) -> Option<Self> {
        let [p0, p1, p2, p3] = corners;
        let turns = [0, 1, 2, 3].map(|i| {
            let (a, b, c) = (corners[i], corners[(i + 1) % 4], corners[(i + 2) % 4]);
            (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
        });
        if !turns.iter().all(|t| *t > 0.0) {
            return None;
        }
        let sum = [0, 1].map(|k| p0[k] - p1[k] + p2[k] - p3[k]);
        let d1 = [0, 1].map(|k| p1[k] - p2[k]);
        let d2 = [0, 1].map(|k| p3[k] - p2[k]);
        let determinant = d1[0] * d2[1] - d1[1] * d2[0];
        let g = (sum[0] * d2[1] - sum[1] * d2[0]) / determinant;
        let h = (d1[0] * sum[1] - d1[1] * sum[0]) / determinant;
        let row = |k: usize| [p1[k] - p0[k] + g * p1[k], p3[k] - p0[k] + h * p3[k], p0[k]];
        let ([a, b, c], [d, e, f]) = (row(0), row(1));
        let all = [a, b, c, d, e, f, g, h];
        all.iter().all(|v| v.is_finite()).then_some(Self(all))
    }

    /// Position of (u, v) in the image; also outside the square, as long as it is in front of the
    /// camera.
    pub fn at(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let [a, b, c, d, e, f, g, h] = self.0;
        let w = g * u + h * v + 1.0;
        [(a * u + b * v + c) / w, (d * u + e * v + f) / w]
    }
}

/// Distance of two points.
pub fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    let [x, y] = [a[0] - b[0], a[1] - b[1]];
    (x * x + y * y).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn perspective_map_preserves_corners_and_lines() {
        let corners = [[10.0, 12.0], [50.0, 8.0], [61.0, 44.0], [7.0, 39.0]];
        let square = Square::new(corners).unwrap();
        for (uv, corner) in [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
            .iter()
            .zip(corners)
        {
            assert!(distance(square.at(*uv), corner) < 1e-12);
        }
        // The diagonals meet in the middle of the square.
        let middle = square.at([0.5, 0.5]);
        let turn = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
            (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        };
        assert!(turn(corners[0], corners[2], middle).abs() < 1e-9);
        assert!(turn(corners[1], corners[3], middle).abs() < 1e-9);
    }

    #[test]
    fn invalid_quadrilateral_is_rejected() {
        assert!(
            Square::new([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]]).is_none(),
            "mirrored"
        );
        assert!(
            Square::new([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [0.0, 1.0]]).is_none(),
            "three on a line"
        );
        assert!(
            Square::new([[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]).is_none(),
            "crossed"
        );
    }
}
