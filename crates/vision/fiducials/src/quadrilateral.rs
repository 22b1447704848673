//! Quadrilaterals around dark regions.

use estimator_config::config;

use crate::regions::Region;
use crate::square::distance;

config! {
    /// Quadrilaterals around dark regions.
    pub struct QuadrilateralConfig {
        /// Maximum distance of a boundary point from its side that counts, px.
        pub max_distance_px: f64 = 1.5,
        /// Minimum share of boundary points that count.
        pub min_share: f64 = 0.8,
        /// Minimum share of boundary points within twice that distance of the sides through the
        /// outermost points, from which sides are fitted.
        pub min_first_share: f64 = 0.5,
        /// Minimum length of a side, px.
        pub min_side_px: f64 = 6.0,
        /// Maximum ratio of two sides.
        pub max_side_ratio: f64 = 4.0,
        /// Rounds in which sides are fitted again.
        pub rounds: usize = 3,
    }
}

type Point = [f64; 2];

/// A line: points `p` with `normal · p = offset`.
#[derive(Clone, Copy, Debug)]
struct Line {
    normal: Point,
    offset: f64,
}

/// Corners of the quadrilateral that a region fills, clockwise in the image; `None` if it fills
/// none. Borders are where dark pixels end.
pub(crate) fn around(region: &Region, config: &QuadrilateralConfig) -> Option<[Point; 4]> {
    let boundary = boundary(region);
    let mut corners = extremes(&boundary)?;
    let mut owners = Vec::with_capacity(boundary.len());
    for round in 0..config.rounds {
        let sides = sides(&boundary, &corners, config, &mut owners)?;
        corners = [3, 0, 1, 2].map(|k: usize| intersection(&sides[k], &sides[(k + 1) % 4]));
        let near = || owners.iter().filter(|owner| **owner < NO_SIDE).count();
        let least = config.min_first_share * boundary.len() as f64;
        if round == 0 && (near() as f64) < least {
            return None;
        }
        if corners.iter().flatten().any(|v| !v.is_finite()) {
            return None;
        }
    }
    let lengths = [0, 1, 2, 3].map(|k: usize| distance(corners[k], corners[(k + 1) % 4]));
    let shortest = lengths.iter().copied().fold(f64::INFINITY, f64::min);
    let longest = lengths.iter().copied().fold(0.0, f64::max);
    if shortest <= config.min_side_px || longest >= config.max_side_ratio * shortest {
        return None;
    }
    let sides = lines(&corners);
    let near = boundary.iter().filter(|p| {
        let to_side = sides.map(|side| side.distance(p).abs());
        to_side.iter().copied().fold(f64::INFINITY, f64::min) < config.max_distance_px
    });
    let is_filled = near.count() as f64 > config.min_share * boundary.len() as f64;
    is_filled.then_some(corners)
}

/// Points between the outermost dark pixels and their bright neighbors.
fn boundary(region: &Region) -> Vec<Point> {
    let mut points = Vec::with_capacity(2 * (region.rows.len() + region.columns.len()));
    for ([from, to], row) in region.rows.iter().zip(region.top..) {
        let row = row as f64;
        points.extend([[*from as f64 - 0.5, row], [*to as f64 + 0.5, row]]);
    }
    for ([from, to], column) in region.columns.iter().zip(region.left..) {
        let column = column as f64;
        points.extend([[column, *from as f64 - 0.5], [column, *to as f64 + 0.5]]);
    }
    points
}

/// The ends of the longest diagonal and the points farthest from it on both sides, clockwise.
fn extremes(boundary: &[Point]) -> Option<[Point; 4]> {
    let first = *boundary.first()?;
    let farthest = |from: Point| {
        let mut farthest = (first, 0.0);
        for &point in boundary {
            let square = square_distance(point, from);
            if square >= farthest.1 {
                farthest = (point, square);
            }
        }
        farthest.0
    };
    let a = farthest(first);
    let c = farthest(a);
    let diagonal = Line::through(a, c);
    let (mut b, mut d) = ((first, f64::NEG_INFINITY), (first, f64::INFINITY));
    for &point in boundary {
        let side = diagonal.distance(&point);
        if side >= b.1 {
            b = (point, side);
        }
        if side < d.1 {
            d = (point, side);
        }
    }
    // The normal of a line is on its left where rows grow downwards.
    Some([a, b.0, c, d.0])
}

/// Lines through neighboring corners.
fn lines(corners: &[Point; 4]) -> [Line; 4] {
    [0, 1, 2, 3].map(|k: usize| Line::through(corners[k], corners[(k + 1) % 4]))
}

/// Of boundary points that are next to no side.
const NO_SIDE: u8 = 4;

/// Lines through the boundary points next to each side; `owners` is overwritten with these sides.
fn sides(
    boundary: &[Point],
    corners: &[Point; 4],
    config: &QuadrilateralConfig,
    owners: &mut Vec<u8>,
) -> Option<[Line; 4]> {
    let rough = lines(corners);
    let near_corner = config.max_distance_px * config.max_distance_px;
    let mut sums = [PointSum::default(); 4];
    owners.clear();
    for point in boundary {
        let to_side = rough.map(|line| line.distance(point).abs());
        let mut nearest = 0;
        for k in 1..4 {
            if to_side[k] < to_side[nearest] {
                nearest = k;
            }
        }
        // Corners are rounded by blur.
        let is_inside = to_side[nearest] < 2.0 * config.max_distance_px
            && square_distance(corners[nearest], *point) > near_corner
            && square_distance(corners[(nearest + 1) % 4], *point) > near_corner;
        if is_inside {
            owners.push(nearest as u8);
            sums[nearest].add(point);
        } else {
            owners.push(NO_SIDE);
        }
    }
    let means = sums.map(|sum| sum.mean());
    let mut moments = [Moments::default(); 4];
    for (point, owner) in boundary.iter().zip(owners) {
        let k = usize::from(*owner);
        if k < 4 {
            moments[k].add(&means[k], point);
        }
    }
    if sums.iter().any(|sum| sum.count < 3) {
        return None;
    }
    Some([0, 1, 2, 3].map(|k: usize| moments[k].line(&means[k], &rough[k])))
}

/// A number of points and their sum.
#[derive(Clone, Copy, Debug, Default)]
struct PointSum {
    count: usize,
    sum: Point,
}

impl PointSum {
    fn add(&mut self, point: &Point) {
        self.count += 1;
        self.sum = [self.sum[0] + point[0], self.sum[1] + point[1]];
    }

    fn mean(&self) -> Point {
        self.sum.map(|v| v / self.count as f64)
    }
}

/// Second moments of points about their mean.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    xx: f64,
    xy: f64,
    yy: f64,
}

impl Moments {
    fn add(&mut self, mean: &Point, point: &Point) {
        let [x, y] = [point[0] - mean[0], point[1] - mean[1]];
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
    }

    /// Total least squares; the direction is that of a rough line.
    fn line(&self, mean: &Point, rough: &Line) -> Line {
        let angle = 0.5 * libm::atan2(2.0 * self.xy, self.xx - self.yy);
        let mut normal = [-libm::sin(angle), libm::cos(angle)];
        if normal[0] * rough.normal[0] + normal[1] * rough.normal[1] < 0.0 {
            normal = normal.map(|v| -v);
        }
        Line {
            normal,
            offset: normal[0] * mean[0] + normal[1] * mean[1],
        }
    }
}

impl Line {
    fn through(a: Point, b: Point) -> Self {
        let length = distance(a, b).max(1e-12);
        let normal = [(b[1] - a[1]) / length, (a[0] - b[0]) / length];
        Self {
            normal,
            offset: normal[0] * a[0] + normal[1] * a[1],
        }
    }

    fn distance(&self, p: &Point) -> f64 {
        self.normal[0] * p[0] + self.normal[1] * p[1] - self.offset
    }
}

fn square_distance(a: Point, b: Point) -> f64 {
    let [x, y] = [a[0] - b[0], a[1] - b[1]];
    x * x + y * y
}

fn intersection(a: &Line, b: &Line) -> Point {
    let determinant = a.normal[0] * b.normal[1] - a.normal[1] * b.normal[0];
    [
        (a.offset * b.normal[1] - b.offset * a.normal[1]) / determinant,
        (b.offset * a.normal[0] - a.offset * b.normal[0]) / determinant,
    ]
}

#[cfg(test)]
mod tests {
    use imaging::ImageView;

    use super::*;
    use crate::regions::{RegionConfig, dark};

    fn corners_of(inside: impl Fn(f64, f64) -> bool) -> Option<[Point; 4]> {
        let light = |i: usize, j: usize| {
            let dark = (0..64).filter(|k| {
                let at = |v: usize, k: usize| v as f64 - 0.5 + (k as f64 + 0.5) / 8.0;
                inside(at(i, k % 8), at(j, k / 8))
            });
            200 - (dark.count() * 180 / 64) as u8
        };
        let pixels: Vec<u8> = (0..60 * 60).map(|i| light(i % 60, i / 60)).collect();
        let image = ImageView::packed(60, 60, &pixels).expect("an image");
        let regions = dark(&image, &RegionConfig::default());
        around(regions.first()?, &QuadrilateralConfig::default())
    }

    #[test]
    fn corners_of_a_rotated_square_are_found() {
        for degrees in [0.0_f64, 17.0, 45.0, 80.0] {
            let (s, c) = degrees.to_radians().sin_cos();
            let found = corners_of(|x, y| {
                let (x, y) = (x - 30.2, y - 29.4);
                (c * x + s * y).abs() < 14.0 && (c * y - s * x).abs() < 11.0
            });
            let found = found.expect("a quadrilateral");
            for (x, y) in [(-14.0, -11.0), (14.0, -11.0), (14.0, 11.0), (-14.0, 11.0)] {
                let corner = [30.2 + c * x - s * y, 29.4 + s * x + c * y];
                let error = found
                    .iter()
                    .map(|f| distance(*f, corner))
                    .fold(f64::INFINITY, f64::min);
                assert!(error < 0.35, "{degrees}: {error} {found:?}");
            }
            assert!(
                crate::square::Square::new(found).is_some(),
                "clockwise: {found:?}"
            );
        }
    }

    #[test]
    fn disks_are_no_quadrilaterals() {
        assert!(corners_of(|x, y| (x - 30.0).hypot(y - 30.0) < 15.0).is_none());
    }
}
