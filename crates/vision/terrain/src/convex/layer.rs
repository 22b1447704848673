//! Height layer: ground of a level on a grid.

/// Weight below which a corner of a triangle does not count.
const MIN_WEIGHT: f64 = 1e-9;

/// Heights of the ground of a level, with two triangles between each four of them.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightLayer {
    /// Edge of a cell, m.
    pub cell_m: f64,
    /// Center of the first cell, x and y in the world, m.
    pub origin: [f64; 2],
    /// Columns and rows.
    pub size: [usize; 2],
    /// Heights at the centers of cells, row-major, m; NaN where unknown.
    pub heights: Vec<f32>,
}

impl HeightLayer {
    /// Height of the triangles at a place in the world, m; `None` beside the grid, and where a
    /// corner of the triangle is not known.
    ///
    /// The triangles are those of MuJoCo's height fields (`mjc_ConvexHField`, `mj_ray`): the edge
    /// between both goes from the corner of least x and y to that of greatest x and y.
    pub fn height_at(&self, x: f64, y: f64) -> Option<f64> {
        let corners = corners(self.cell_m, self.origin, self.size, [x, y])?;
        let height = weighted(&corners, |index| f64::from(self.heights[index]));
        height.is_finite().then_some(height)
    }
}

/// The samples of a grid whose triangle contains a place, with their weights. Their sum is 1.
pub(super) fn corners(
    cell_m: f64,
    origin: [f64; 2],
    size: [usize; 2],
    at: [f64; 2],
) -> Option<[(usize, f64); 3]> {
    let place = [0, 1].map(|k| (at[k] - origin[k]) / cell_m);
    let inside = |k: usize| {
        let last = size[k].saturating_sub(1) as f64;
        size[k] >= 2 && place[k] >= -MIN_WEIGHT && place[k] <= last + MIN_WEIGHT
    };
    if !inside(0) || !inside(1) {
        return None;
    }
    let first = [0, 1].map(|k| (place[k].max(0.0) as usize).min(size[k] - 2));
    let [u, v] = [0, 1].map(|k| (place[k] - first[k] as f64).clamp(0.0, 1.0));
    let index = |right: usize, up: usize| (first[1] + up) * size[0] + first[0] + right;
    Some(match u >= v {
        true => [
            (index(0, 0), 1.0 - u),
            (index(1, 0), u - v),
            (index(1, 1), v),
        ],
        false => [
            (index(0, 0), 1.0 - v),
            (index(0, 1), v - u),
            (index(1, 1), u),
        ],
    })
}

/// Mean of a triangle's values; NaN where one that counts is.
pub(super) fn weighted(corners: &[(usize, f64); 3], value: impl Fn(usize) -> f64) -> f64 {
    corners
        .iter()
        .filter(|(_, weight)| *weight > MIN_WEIGHT)
        .map(|(index, weight)| weight * value(*index))
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_between_samples_are_those_of_mujocos_triangles() {
        let layer = HeightLayer {
            cell_m: 0.5,
            origin: [1.0, -2.0],
            size: [3, 2],
            heights: vec![0.0, 1.0, 7.0, 2.0, 8.0, f32::NAN],
        };
        let height = |u: f64, v: f64| layer.height_at(1.0 + 0.5 * u, -2.0 + 0.5 * v);
        let near = |found: Option<f64>, expected: f64| {
            assert!((found.unwrap() - expected).abs() < 1e-9, "{found:?}");
        };
        // On the edge between both triangles, from (0, 0) to (1, 1).
        near(height(0.5, 0.5), 4.0);
        near(height(0.75, 0.25), 0.25 * 0.0 + 0.5 * 1.0 + 0.25 * 8.0);
        near(height(0.25, 0.75), 0.25 * 0.0 + 0.5 * 2.0 + 0.25 * 8.0);
        // Both triangles of the second cell have an unknown corner; its first edge has none.
        assert_eq!((height(1.6, 0.5), height(1.5, 0.9)), (None, None));
        near(height(1.0, 0.5), 4.5);
        near(height(2.0, 0.0), 7.0);
        assert_eq!(height(-0.01, 0.0), None);
        assert_eq!(height(0.5, 1.01), None);
        assert_eq!(height(f64::NAN, 0.0), None);
        let row = HeightLayer {
            size: [6, 1],
            ..layer
        };
        assert_eq!(row.height_at(1.0, -2.0), None);
    }
}
