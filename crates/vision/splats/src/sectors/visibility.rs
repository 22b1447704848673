//! Which views see a cell from outside of it, by their measured points.

use super::cells::Cells;
use super::config::SectorConfig;

/// Points of a view by the cell in which they are.
///
/// ```
/// use splats::{Cells, CellVisibility, SectorConfig};
///
/// let config = SectorConfig::default();
/// let positions: Vec<[f64; 3]> = (0..20).map(|k| [f64::from(k), 0.0, 0.0]).collect();
/// let cells = Cells::of_positions(&positions, 10, &config);
/// // Each view measured one point, 3 m ahead.
/// let ahead = |p: &[f64; 3]| CellVisibility::of_points(&cells, [[p[0] + 3.0, p[1], p[2]]]);
/// let seen: Vec<CellVisibility> = positions.iter().map(ahead).collect();
/// let inside = |view: usize, cell: usize| cells.cell_of(positions[view]) == cell;
/// let of = |cell, most| {
///     CellVisibility::from_outside(&seen, cell, most, &config, |v| inside(v, cell))
/// };
/// assert_eq!(of(1, 5), [7, 8, 9]);
/// assert_eq!(of(1, 2), [7, 8]);
/// assert_eq!(of(0, 5), [0; 0]);
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CellVisibility {
    /// Cells and numbers of points in them, by cell.
    counts: Vec<(usize, u32)>,
    points: u32,
}

impl CellVisibility {
    /// Counts points, world, m. Those that are not finite are left out.
    pub fn of_points(cells: &Cells, points: impl IntoIterator<Item = [f64; 3]>) -> Self {
        let mut seen = Self::default();
        for point in points {
            if !point.iter().all(|v| v.is_finite()) {
                continue;
            }
            let cell = cells.cell_of(point);
            seen.points += 1;
            match seen.counts.binary_search_by_key(&cell, |(of, _)| *of) {
                Ok(place) => seen.counts[place].1 += 1,
                Err(place) => seen.counts.insert(place, (cell, 1)),
            }
        }
        seen
    }

    /// Number of points in a cell.
    fn points_in(&self, cell: usize) -> u32 {
        let place = self.counts.binary_search_by_key(&cell, |(of, _)| *of);
        place.map_or(0, |place| self.counts[place].1)
    }

    /// Views, in order, that see a cell and are not left out, at most `most` of them: those with
    /// most points in it.
    pub fn from_outside(
        views: &[Self],
        cell: usize,
        most: usize,
        config: &SectorConfig,
        is_left_out: impl Fn(usize) -> bool,
    ) -> Vec<usize> {
        let mut found: Vec<(u32, usize)> = Vec::new();
        for (view, seen) in views.iter().enumerate() {
            let count = seen.points_in(cell);
            let is_enough = f64::from(count) >= config.min_seen * f64::from(seen.points);
            if count > 0 && is_enough && !is_left_out(view) {
                found.push((count, view));
            }
        }
        found.sort_by(|(a, i), (b, j)| b.cmp(a).then(i.cmp(j)));
        found.truncate(most);
        let mut found: Vec<usize> = found.into_iter().map(|(_, view)| view).collect();
        found.sort_unstable();
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(count: u32) -> Cells {
        let positions: Vec<[f64; 3]> = (0..count).map(|k| [f64::from(k), 0.0, 0.0]).collect();
        let cells = Cells::of_positions(&positions, 10, &SectorConfig::default());
        assert_eq!(cells.count(), count as usize / 10);
        cells
    }

    /// Numbers of points in the cells of a row.
    fn seen(cells: &Cells, counts: &[u32]) -> CellVisibility {
        let points = counts.iter().enumerate().flat_map(|(cell, count)| {
            let point = [10.0 * cell as f64 + 5.0, 3.0, 1.0];
            std::iter::repeat_n(point, *count as usize)
        });
        CellVisibility::of_points(cells, points)
    }

    #[test]
    fn points_are_counted_by_cell() {
        let cells = row(30);
        let mut points = vec![[2.0, 0.0, 0.0], [25.0, 9.0, 0.0], [1.0, 0.0, 7.0]];
        points.push([f64::NAN, 0.0, 0.0]);
        let seen = CellVisibility::of_points(&cells, points);
        assert_eq!([0, 1, 2, 3].map(|cell| seen.points_in(cell)), [2, 0, 1, 0]);
        assert_eq!(seen.points, 3);
    }

    #[test]
    fn views_with_most_points_come_first_and_a_few_points_are_not_enough() {
        let cells = row(20);
        let config = SectorConfig {
            min_seen: 0.1,
            ..SectorConfig::default()
        };
        let views = [
            seen(&cells, &[90, 10]),
            seen(&cells, &[91, 9]),
            seen(&cells, &[0, 30]),
            seen(&cells, &[0, 0]),
            seen(&cells, &[10, 50]),
            seen(&cells, &[10, 50]),
        ];
        let found = |most, out: &[usize]| {
            CellVisibility::from_outside(&views, 1, most, &config, |view| out.contains(&view))
        };
        assert_eq!(found(9, &[]), [0, 2, 4, 5]);
        assert_eq!(found(3, &[]), [2, 4, 5]);
        // Of equal ones the first.
        assert_eq!(found(1, &[]), [4]);
        assert_eq!(found(2, &[4]), [2, 5]);
        assert_eq!(found(0, &[]), [0; 0]);
    }
}
