//! Outlines of cells of a grid as polygons.

use std::collections::BTreeMap;

use super::support::SupportGrid;

/// A polygon with holes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Polygon {
    /// Corners, counterclockwise.
    pub outline: Vec<[f64; 2]>,
    /// Corners of each hole, clockwise.
    pub holes: Vec<Vec<[f64; 2]>>,
}

impl Polygon {
    /// Area without holes, in squared units of the corners.
    pub fn area(&self) -> f64 {
        let holes: f64 = self.holes.iter().map(|hole| signed_area(hole)).sum();
        signed_area(&self.outline) + holes
    }

    /// Whether a point is inside, and in no hole.
    pub fn contains(&self, at: [f64; 2]) -> bool {
        is_inside(&self.outline, at) && !self.holes.iter().any(|hole| is_inside(hole, at))
    }
}

/// Outlines of the marked cells of a grid; corners deviate by at most a tolerance. The largest
/// comes first.
pub(crate) fn outlines(grid: &SupportGrid, mask: &[bool], tolerance_m: f64) -> Vec<Polygon> {
    let mut loops: Vec<Vec<[f64; 2]>> = trace(grid, mask)
        .into_iter()
        .map(|corners| simplify(&corners, tolerance_m))
        .filter(|corners| corners.len() >= 3)
        .collect();
    loops.sort_by(|a, b| signed_area(b).total_cmp(&signed_area(a)));
    let mut polygons: Vec<Polygon> = Vec::new();
    for corners in loops {
        if signed_area(&corners) > 0.0 {
            polygons.push(Polygon {
                outline: corners,
                holes: Vec::new(),
            });
            continue;
        }
        // The smallest outline around a hole.
        let around = polygons
            .iter_mut()
            .rev()
            .find(|polygon| is_inside(&polygon.outline, corners[0]));
        if let Some(polygon) = around {
            polygon.holes.push(corners);
        }
    }
    polygons
}

fn signed_area(corners: &[[f64; 2]]) -> f64 {
    let next = corners.iter().cycle().skip(1);
    0.5 * corners
        .iter()
        .zip(next)
        .map(|(a, b)| a[0] * b[1] - a[1] * b[0])
        .sum::<f64>()
}

/// By the parity of crossings of a ray.
fn is_inside(corners: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let next = corners.iter().cycle().skip(1);
    let crossed = corners.iter().zip(next).filter(|(a, b)| {
        (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
    });
    crossed.count() % 2 == 1
}

/// Borders of the marked cells as closed loops with the cells on their left.
fn trace(grid: &SupportGrid, mask: &[bool]) -> Vec<Vec<[f64; 2]>> {
    let [width, height] = grid.size;
    let marked = |x: i32, y: i32| {
        let inside = x >= 0 && y >= 0 && (x as usize) < width && (y as usize) < height;
        inside && mask[y as usize * width + x as usize]
    };
    // From a corner to the directions of the borders that leave it: right, up, left, down.
    const STEPS: [[i32; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];
    let mut leaving: BTreeMap<[i32; 2], u8> = BTreeMap::new();
    for y in 0..height as i32 {
        for x in 0..width as i32 {
            if !marked(x, y) {
                continue;
            }
            let sides = [([x, y], [x, y - 1]), ([x + 1, y], [x + 1, y])];
            let sides = sides
                .into_iter()
                .chain([([x + 1, y + 1], [x, y + 1]), ([x, y + 1], [x - 1, y])]);
            for (direction, (corner, neighbor)) in sides.enumerate() {
                if !marked(neighbor[0], neighbor[1]) {
                    *leaving.entry(corner).or_default() |= 1 << direction;
                }
            }
        }
    }
    let mut loops = Vec::new();
    while let Some((start, directions)) = leaving.first_key_value() {
        let (start, mut direction) = (*start, directions.trailing_zeros() as usize);
        let (mut at, mut corners) = (start, Vec::new());
        while let Some(rest) = leaving.get_mut(&at) {
            // Cells that touch at a corner are apart: turn left first.
            let turns = [direction + 1, direction, direction + 3];
            let Some(next) = turns
                .into_iter()
                .map(|d| d % 4)
                .find(|d| *rest >> d & 1 == 1)
            else {
                break;
            };
            *rest &= !(1 << next);
            if *rest == 0 {
                leaving.remove(&at);
            }
            if next != direction || corners.is_empty() {
                let place = [0, 1].map(|k| f64::from(grid.from[k] + at[k]) * grid.cell_m);
                corners.push(place);
            }
            direction = next;
            at = [0, 1].map(|k| at[k] + STEPS[next][k]);
            if at == start {
                break;
            }
        }
        loops.push(corners);
    }
    loops
}

/// Corners without those that deviate by at most a tolerance (Douglas and Peucker 1973).
fn simplify(corners: &[[f64; 2]], tolerance: f64) -> Vec<[f64; 2]> {
    if corners.len() < 4 {
        return corners.to_vec();
    }
    // The loop is cut at its first corner and at the one farthest from it.
    let distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let farthest = (0..corners.len())
        .max_by(|a, b| {
            distance(corners[*a], corners[0]).total_cmp(&distance(corners[*b], corners[0]))
        })
        .unwrap_or(0);
    let mut closed = corners.to_vec();
    closed.push(corners[0]);
    let mut keep = vec![false; closed.len()];
    (keep[0], keep[farthest]) = (true, true);
    let mut open = vec![(0, farthest), (farthest, closed.len() - 1)];
    while let Some((from, to)) = open.pop() {
        let (a, b) = (closed[from], closed[to]);
        let length = distance(a, b);
        let away = |i: usize| {
            let d = [closed[i][0] - a[0], closed[i][1] - a[1]];
            match length > 0.0 {
                true => ((b[0] - a[0]) * d[1] - (b[1] - a[1]) * d[0]).abs() / length,
                false => d[0].hypot(d[1]),
            }
        };
        let worst = (from + 1..to).max_by(|i, j| away(*i).total_cmp(&away(*j)));
        if let Some(worst) = worst.filter(|worst| away(*worst) > tolerance) {
            keep[worst] = true;
            open.extend([(from, worst), (worst, to)]);
        }
    }
    let kept = corners.iter().zip(&keep).filter(|(_, keep)| **keep);
    kept.map(|(corner, _)| *corner).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outlines_have_holes_and_areas() {
        let cells = |y: i32| (0..12).map(move |x| (x, y));
        let all = (0..8).flat_map(cells);
        let mut grid = SupportGrid::around(0.1, [[0.0, 0.0], [1.3, 0.9]].into_iter(), 0.1);
        for (x, y) in all {
            let is_hole = (4..6).contains(&x) && (3..5).contains(&y);
            // A separate cell that touches at a corner.
            let is_apart = (x == 11 && y < 7) || (x < 11 && y == 7);
            if !is_hole && !is_apart {
                grid.add([0.1 * f64::from(x) + 0.05, 0.1 * f64::from(y) + 0.05]);
            }
        }
        let polygons = outlines(&grid, &grid.mask(1), 0.01);
        assert_eq!(polygons.len(), 2, "{polygons:?}");
        assert_eq!((polygons[0].outline.len(), polygons[0].holes.len()), (4, 1));
        assert!((polygons[0].area() - 0.73).abs() < 1e-9);
        assert!((polygons[1].area() - 0.01).abs() < 1e-9);
        assert!(polygons[0].contains([0.2, 0.2]) && !polygons[0].contains([0.5, 0.4]));
    }

    #[test]
    fn slanted_borders_become_straight() {
        let mut grid = SupportGrid::around(0.01, [[0.0, 0.0], [1.0, 1.0]].into_iter(), 0.05);
        for i in 0..10_000 {
            let at = [
                0.01 * (i % 100) as f64 + 0.005,
                0.01 * (i / 100) as f64 + 0.005,
            ];
            if at[1] < 0.3 + 0.4 * at[0] {
                grid.add(at);
            }
        }
        let polygons = outlines(&grid, &grid.mask(1), 0.011);
        assert!(polygons[0].outline.len() <= 6, "{:?}", polygons[0].outline);
        assert!((polygons[0].area() - 0.5).abs() < 0.01);
    }
}
