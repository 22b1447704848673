//! Division of the observed part of a plane into convex pieces.

use crate::config::ConvexConfig;
use crate::hull::{area, convex_hull, perimeter};
use crate::planes::Plane;

/// Maximum number of cuts after each other.
const MAX_DEPTH: u32 = 12;
/// Cuts that are tried along each axis.
const CUTS: usize = 24;

/// Marked cells with tables for rectangles of them.
struct Cells {
    size: [usize; 2],
    /// Number of marked cells above and to the left.
    counts: Vec<u32>,
    /// First marked cell of a row from a column on, and number of cells to the last marked one
    /// before a column.
    next: Vec<u32>,
    previous: Vec<u32>,
}

/// From a column and row to another one, not included.
type Rectangle = [[usize; 2]; 2];

/// Convex outlines, counterclockwise, in coordinates of the plane.
pub(super) fn pieces(plane: &Plane, config: &ConvexConfig) -> Vec<Vec<[f64; 2]>> {
    let cells = Cells::new(&plane.observed, plane.support.size);
    let mut found = Vec::new();
    cells.divide(plane, [[0, 0], cells.size], 0, config, &mut found);
    found
}

impl Cells {
    fn new(mask: &[bool], size: [usize; 2]) -> Self {
        let [width, height] = size;
        let mut cells = Self {
            size,
            counts: vec![0; (width + 1) * (height + 1)],
            next: vec![u32::MAX; (width + 1) * height],
            previous: vec![u32::MAX; (width + 1) * height],
        };
        for y in 0..height {
            let mut in_row = 0;
            for x in 0..width {
                let is_marked = mask[y * width + x];
                in_row += u32::from(is_marked);
                let above = cells.counts[y * (width + 1) + x + 1];
                cells.counts[(y + 1) * (width + 1) + x + 1] = above + in_row;
                let at = y * (width + 1) + x;
                cells.previous[at + 1] = if is_marked {
                    x as u32
                } else {
                    cells.previous[at]
                };
            }
            for x in (0..width).rev() {
                let at = y * (width + 1) + x;
                cells.next[at] = if mask[y * width + x] {
                    x as u32
                } else {
                    cells.next[at + 1]
                };
            }
        }
        cells
    }

    fn count(&self, [from, to]: Rectangle) -> u32 {
        let at = |x: usize, y: usize| self.counts[y * (self.size[0] + 1) + x];
        at(to[0], to[1]) + at(from[0], from[1]) - at(from[0], to[1]) - at(to[0], from[1])
    }

    /// Convex hull of the marked cells of a rectangle, in cells.
    fn hull(&self, [from, to]: Rectangle) -> Vec<[f64; 2]> {
        let mut corners = Vec::new();
        for y in from[1]..to[1] {
            let row = y * (self.size[0] + 1);
            let first = self.next[row + from[0]];
            if first == u32::MAX || first as usize >= to[0] {
                continue;
            }
            let last = self.previous[row + to[0]] + 1;
            for y in [y, y + 1] {
                corners.push([f64::from(first), y as f64]);
                corners.push([f64::from(last), y as f64]);
            }
        }
        convex_hull(corners)
    }

    /// Area of the hull that is not observed, beyond the steps of cells along its border, in cells.
    fn uncovered(&self, rectangle: Rectangle, hull: &[[f64; 2]]) -> f64 {
        area(hull) - f64::from(self.count(rectangle)) - 0.75 * perimeter(hull)
    }

    fn divide(
        &self,
        plane: &Plane,
        rectangle: Rectangle,
        depth: u32,
        config: &ConvexConfig,
        found: &mut Vec<Vec<[f64; 2]>>,
    ) {
        let cell_m = plane.support.cell_m;
        let cell_m2 = cell_m * cell_m;
        if f64::from(self.count(rectangle)) * cell_m2 < config.min_part_m2 {
            return;
        }
        let hull = self.hull(rectangle);
        let limit = config
            .max_uncovered_m2
            .max(config.max_uncovered_share * area(&hull) * cell_m2);
        let is_convex = self.uncovered(rectangle, &hull) * cell_m2 <= limit;
        let is_final = is_convex || depth == MAX_DEPTH;
        let cut = if is_final {
            None
        } else {
            self.best_cut(rectangle)
        };
        if let Some([first, second]) = cut {
            self.divide(plane, first, depth + 1, config, found);
            self.divide(plane, second, depth + 1, config, found);
            return;
        }
        let to_plane =
            |at: &[f64; 2]| [0, 1].map(|k| (f64::from(plane.support.from[k]) + at[k]) * cell_m);
        found.push(hull.iter().map(to_plane).collect());
    }

    /// The cut that leaves least unobserved area in the hulls of both sides.
    fn best_cut(&self, [from, to]: Rectangle) -> Option<[Rectangle; 2]> {
        let mut best: Option<(f64, [Rectangle; 2])> = None;
        for axis in 0..2 {
            let extent = to[axis] - from[axis];
            let stride = (extent / CUTS).max(1);
            for at in (from[axis] + stride..to[axis]).step_by(stride) {
                let (mut end, mut start) = (to, from);
                (end[axis], start[axis]) = (at, at);
                let sides = [[from, end], [start, to]];
                // An empty side only shrinks the rectangle.
                let cost: f64 = sides
                    .iter()
                    .map(|side| area(&self.hull(*side)) - f64::from(self.count(*side)))
                    .sum();
                // Cuts near the middle are better than as good ones elsewhere.
                let from_middle = (2.0 * (at - from[axis]) as f64 / extent as f64 - 1.0).abs();
                let cost = cost + 1e-3 * from_middle;
                if best.is_none_or(|(least, _)| cost < least) {
                    best = Some((cost, sides));
                }
            }
        }
        best.map(|(_, sides)| sides)
    }
}
