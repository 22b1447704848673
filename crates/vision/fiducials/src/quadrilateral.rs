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
    for _ in 0..config.rounds {
        let sides = sides(&boundary, &corners, config)?;
        corners = [3, 0, 1, 2].map(|k: usize| intersection(&sides[k], &sides[(k + 1) % 4]));
        if corners.iter().flatten().any(|v| !v.is_finite()) {
            return None;
        }
    }
    let lengths = [0, 1, 2, 3].map(|k: usize| distance(corners[k], corners[(k + 1) % 4]));
    let shortest = lengths.iter().copied().fold(f64::INFINITY, f64::min);
    let longest = lengths.iter().copied().fold(0.0, f64::max);
    let is_square = shortest > config.min_side_px && longest < config.max_side_ratio * shortest;
    let near = boundary.iter().filter(|p| {
        let to_side = |k: usize| {
            Line::through(corners[k], corners[(k + 1) % 4])
                .distance(p)
                .abs()
        };
        (0..4).map(to_side).fold(f64::INFINITY, f64::min) < config.max_distance_px
    });
    let is_filled = near.count() as f64 > config.min_share * boundary.len() as f64;
    (is_square && is_filled).then_some(corners)
}

/// Points between the outermost dark pixels and their bright neighbors.
fn boundary(region: &Region) -> Vec<Point> {
    let rows = region
        .rows
        .iter()
        .zip(region.top..)
        .flat_map(|([from, to], row)| {
            let row = row as f64;
            [[*from as f64 - 0.5, row], [*to as f64 + 0.5, row]]
        });
    let columns = region
        .columns
        .iter()
        .zip(region.left..)
        .flat_map(|([from, to], column)| {
            let column = column as f64;
            [[column, *from as f64 - 0.5], [column, *to as f64 + 0.5]]
        });
    rows.chain(columns).collect()
}

/// The ends of the longest diagonal and the points farthest from it on both sides, clockwise.
fn extremes(boundary: &[Point]) -> Option<[Point; 4]> {
    let farthest = |from: Point| {
        let by_distance =
            |a: &&Point, b: &&Point| distance(**a, from).total_cmp(&distance(**b, from));
        boundary.iter().max_by(by_distance).copied()
    };
    let a = farthest(*boundary.first()?)?;
    let c = farthest(a)?;
    let diagonal = Line::through(a, c);
    let by_side = |p: &&Point, q: &&Point| diagonal.distance(p).total_cmp(&diagonal.distance(q));
    let b = *boundary.iter().max_by(by_side)?;
    let d = *boundary.iter().min_by(by_side)?;
    // The normal of a line is on its left where rows grow downwards.
    Some([a, b, c, d])
}

/// Lines through the boundary points next to each side.
fn sides(
    boundary: &[Point],
    corners: &[Point; 4],
    config: &QuadrilateralConfig,
) -> Option<[Line; 4]> {
    let rough = [0, 1, 2, 3].map(|k: usize| Line::through(corners[k], corners[(k + 1) % 4]));
    let mut own: [Vec<Point>; 4] = Default::default();
    for point in boundary {
        let to_side = rough.map(|line| line.distance(point).abs());
        let nearest = (0..4).min_by(|&a, &b| to_side[a].total_cmp(&to_side[b]))?;
        // Corners are rounded by blur.
        let is_inside = [corners[nearest], corners[(nearest + 1) % 4]]
            .iter()
            .all(|corner| distance(*corner, *point) > config.max_distance_px);
        if is_inside && to_side[nearest] < 2.0 * config.max_distance_px {
            own[nearest].push(*point);
        }
    }
    let [a, b, c, d] = own;
    Some([
        Line::fitted(&a, &rough[0])?,
        Line::fitted(&b, &rough[1])?,
        Line::fitted(&c, &rough[2])?,
        Line::fitted(&d, &rough[3])?,
    ])
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

    /// Total least squares; the direction is that of a rough line.
    fn fitted(points: &[Point], rough: &Self) -> Option<Self> {
        if points.len() < 3 {
            return None;
        }
        let n = points.len() as f64;
        let mean = [0, 1].map(|k: usize| points.iter().map(|p| p[k]).sum::<f64>() / n);
        let moment = |i: usize, j: usize| {
            points
                .iter()
                .map(|p| (p[i] - mean[i]) * (p[j] - mean[j]))
                .sum::<f64>()
        };
        let (xx, xy, yy) = (moment(0, 0), moment(0, 1), moment(1, 1));
        let angle = 0.5 * libm::atan2(2.0 * xy, xx - yy);
        let mut normal = [-libm::sin(angle), libm::cos(angle)];
        if normal[0] * rough.normal[0] + normal[1] * rough.normal[1] < 0.0 {
            normal = normal.map(|v| -v);
        }
        Some(Self {
            normal,
            offset: normal[0] * mean[0] + normal[1] * mean[1],
        })
    }
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
