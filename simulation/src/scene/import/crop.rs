//! Parts of maps.

use scene_bundle::outputs::grid::Grid;
use scene_bundle::outputs::maps::MapLevel;

use crate::scene::sector::Area;

/// The cells of a level whose centers are within a distance of an area; `None` if there are none.
pub(super) fn cropped(level: &MapLevel, area: &Area, reach_m: f64) -> Option<MapLevel> {
    let grid = level.grid;
    let [columns, rows] = [(0, grid.columns), (1, grid.rows)].map(|(k, count)| {
        let is_kept = |cell: &usize| {
            let center_m = grid.origin_m[k] + *cell as f64 * grid.cell_m;
            (area.min_m[k] - reach_m..=area.max_m[k] + reach_m).contains(&center_m)
        };
        (0..count).filter(is_kept).collect::<Vec<_>>()
    });
    let (first_column, first_row) = (*columns.first()?, *rows.first()?);
    let cells: Vec<usize> = rows
        .iter()
        .flat_map(|row| {
            columns
                .iter()
                .map(move |column| row * grid.columns + column)
        })
        .collect();
    let numbers = |of: &[f32]| cells.iter().map(|cell| of[*cell]).collect();
    let bytes = |of: &[u8]| cells.iter().map(|cell| of[*cell]).collect();
    Some(MapLevel {
        grid: Grid {
            cell_m: grid.cell_m,
            origin_m: grid.center_m(first_row * grid.columns + first_column),
            columns: columns.len(),
            rows: rows.len(),
        },
        elevation: numbers(&level.elevation),
        lower: numbers(&level.lower),
        upper: numbers(&level.upper),
        sigma: numbers(&level.sigma),
        normal: cells.iter().map(|cell| level.normal[*cell]).collect(),
        slope: numbers(&level.slope),
        step: numbers(&level.step),
        roughness: numbers(&level.roughness),
        clearance: numbers(&level.clearance),
        traversability: numbers(&level.traversability),
        distance: numbers(&level.distance),
        occupancy: cells.iter().map(|cell| level.occupancy[*cell]).collect(),
        views: bytes(&level.views),
        flags: bytes(&level.flags),
    })
}
