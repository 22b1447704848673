//! Convex polygons.

/// Twice the area of a triangle, positive if counterclockwise.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Convex hull, counterclockwise (Andrew's monotone chain).
pub(crate) fn convex_hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for point in points {
            while chain.len() >= 2
                && turn(chain[chain.len() - 2], chain[chain.len() - 1], point) <= 0.0
            {
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut hull = chain(&mut points.iter().copied());
    hull.extend(chain(&mut points.iter().rev().copied()));
    hull
}

/// Area of a polygon.
pub(crate) fn area(corners: &[[f64; 2]]) -> f64 {
    let next = corners.iter().cycle().skip(1);
    0.5 * corners
        .iter()
        .zip(next)
        .map(|(a, b)| a[0] * b[1] - a[1] * b[0])
        .sum::<f64>()
}

/// Length of the border of a polygon.
pub(crate) fn perimeter(corners: &[[f64; 2]]) -> f64 {
    let next = corners.iter().cycle().skip(1);
    corners
        .iter()
        .zip(next)
        .map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]))
        .sum()
}

/// Whether a point is inside a convex polygon, or on its border.
pub(crate) fn contains(corners: &[[f64; 2]], at: [f64; 2]) -> bool {
    let next = corners.iter().cycle().skip(1);
    corners.len() >= 3
        && corners
            .iter()
            .zip(next)
            .all(|(a, b)| turn(*a, *b, at) >= -1e-12)
}

/// Leaves out corners that change the area least until at most a number remain.
pub(crate) fn with_at_most(mut corners: Vec<[f64; 2]>, count: usize) -> Vec<[f64; 2]> {
    while corners.len() > count.max(3) {
        let at = |i: usize| corners[i % corners.len()];
        let n = corners.len();
        let lost = |i: usize| turn(at(i + n - 1), at(i), at(i + 1)).abs();
        let least = (0..n)
            .min_by(|a, b| lost(*a).total_cmp(&lost(*b)))
            .unwrap_or(0);
        corners.remove(least);
    }
    corners
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hulls_contain_their_points() {
        let points: Vec<[f64; 2]> = (0..60)
            .map(|i| [0, 1].map(|k| counter_random::uniform(4, k, i)))
            .collect();
        let hull = convex_hull(points.clone());
        assert!(points.iter().all(|point| contains(&hull, *point)));
        assert!(!contains(&hull, [1.2, 0.5]));
        assert!(area(&hull) > 0.5 && area(&hull) < 1.0);
        let fewer = with_at_most(hull.clone(), 5);
        assert_eq!(fewer.len(), 5);
        assert!(area(&fewer) < area(&hull) && area(&fewer) > 0.8 * area(&hull));
        let square = convex_hull(vec![
            [0.0, 0.0],
            [1.0, 0.0],
            [0.5, 0.0],
            [1.0, 1.0],
            [0.0, 1.0],
        ]);
        assert_eq!(
            (square.len(), area(&square), perimeter(&square)),
            (4, 1.0, 4.0)
        );
    }
}
