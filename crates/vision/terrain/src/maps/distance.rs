//! Distances of cells from edges, obstacles and unknown cells.

use super::level::{FREE, Level};
use crate::config::MapConfig;
use crate::edges::Edge;

/// Fills the layer of signed distances. Borders are between cells, so the grid is doubled: centers
/// of cells have odd coordinates, borders even ones.
pub(super) fn measure(level: &mut Level, edges: &[Edge], config: &MapConfig) {
    let [width, height] = level.size;
    let size = [2 * width + 1, 2 * height + 1];
    let mut squares = vec![f64::INFINITY; size[0] * size[1]];
    let is_free = |index: usize| level.occupancy[index] == FREE;
    for index in 0..width * height {
        let (x, y) = (index % width, index / width);
        let node = (2 * y + 1) * size[0] + 2 * x + 1;
        let beside = [
            ((x + 1 < width).then(|| index + 1), node + 1),
            ((y + 1 < height).then(|| index + width), node + size[0]),
        ];
        for (other, border) in beside {
            let Some(other) = other else {
                continue;
            };
            let differs = is_free(index) != is_free(other);
            let is_edge =
                is_free(index) && is_free(other) && jump(level, index, other) > config.min_edge_m;
            if differs || is_edge {
                squares[border] = 0.0;
            }
        }
    }
    transform(&mut squares, size);
    for index in 0..width * height {
        let (x, y) = (index % width, index / width);
        let square = squares[(2 * y + 1) * size[0] + 2 * x + 1];
        let distance = 0.5 * level.cell_m * square.sqrt();
        level.distance[index] = match is_free(index) {
            true => distance as f32,
            false => -distance as f32,
        };
    }
    refine(level, edges);
}

/// Height difference of neighboring cells beyond their slopes, m.
fn jump(level: &Level, index: usize, other: usize) -> f64 {
    let [from, to] = [index, other].map(|i| level.center(i));
    let offset = [to[0] - from[0], to[1] - from[1]];
    let difference = f64::from(level.elevation[other] - level.elevation[index]);
    let of = |i: usize| {
        let [nx, ny, nz] = level.normal[i].map(f64::from);
        -(nx * offset[0] + ny * offset[1]) / nz.max(0.05)
    };
    // Either slope may explain it.
    [index, other]
        .map(|i| (difference - of(i)).abs())
        .into_iter()
        .fold(f64::INFINITY, f64::min)
}

/// Distances from edges that are known better than by cells.
fn refine(level: &mut Level, edges: &[Edge]) {
    let reach = 0.4;
    let [width, height] = level.size;
    for edge in edges {
        let cells = [0, 1].map(|k| {
            let low = edge.from[k].min(edge.to[k]) - reach - level.origin[k];
            let high = edge.from[k].max(edge.to[k]) + reach - level.origin[k];
            let last = [width, height][k] as f64 - 1.0;
            [low, high].map(|v| (v / level.cell_m).round().clamp(0.0, last) as usize)
        });
        for y in cells[1][0]..=cells[1][1] {
            for x in cells[0][0]..=cells[0][1] {
                let index = y * width + x;
                let [cx, cy] = level.center(index);
                let z = f64::from(level.elevation[index]);
                let is_on_plane = (z - edge.from[2]).abs() < 0.06 || (z - edge.to[2]).abs() < 0.06;
                if level.occupancy[index] != FREE || !is_on_plane {
                    continue;
                }
                let distance = edge.distance_m([cx, cy, z]);
                let by_cells = f64::from(level.distance[index]);
                // The same edge, known by cells to half of one; or one that cells did not show.
                if distance < by_cells + 0.75 * level.cell_m && distance < reach {
                    level.distance[index] = distance as f32;
                }
            }
        }
    }
}

/// Squared distances from the zeros of a grid, in squared nodes (Felzenszwalb and Huttenlocher
/// 2012).
fn transform(squares: &mut [f64], [width, height]: [usize; 2]) {
    let mut line = Vec::new();
    for x in 0..width {
        line.clear();
        line.extend((0..height).map(|y| squares[y * width + x]));
        let transformed = lower_envelope(&line);
        for (y, value) in transformed.into_iter().enumerate() {
            squares[y * width + x] = value;
        }
    }
    for row in squares.chunks_mut(width) {
        let transformed = lower_envelope(row);
        row.copy_from_slice(&transformed);
    }
}

/// Least value of all parabolas of a line at each of its places.
fn lower_envelope(values: &[f64]) -> Vec<f64> {
    let mut parabolas: Vec<(usize, f64)> = Vec::new();
    for (at, value) in values
        .iter()
        .enumerate()
        .filter(|(_, value)| value.is_finite())
    {
        let meets = |other: usize| {
            let [a, b] = [at, other].map(|k| k as f64);
            ((value + a * a) - (values[other] + b * b)) / (2.0 * (a - b))
        };
        while parabolas
            .last()
            .is_some_and(|(other, from)| meets(*other) <= *from)
        {
            parabolas.pop();
        }
        let from = parabolas
            .last()
            .map_or(f64::NEG_INFINITY, |(other, _)| meets(*other));
        parabolas.push((at, from));
    }
    let mut current = 0;
    let at = |place: usize| {
        if parabolas.is_empty() {
            return f64::INFINITY;
        }
        while current + 1 < parabolas.len() && parabolas[current + 1].1 <= place as f64 {
            current += 1;
        }
        let (center, _) = parabolas[current];
        let away = place as f64 - center as f64;
        values[center] + away * away
    };
    (0..values.len()).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transform_agrees_with_all_pairs() {
        let size = [23, 17];
        let zeros: Vec<usize> = (0..9)
            .map(|i| (counter_random::bits(1, 2, i) % 391) as usize)
            .collect();
        let mut squares = vec![f64::INFINITY; size[0] * size[1]];
        zeros.iter().for_each(|zero| squares[*zero] = 0.0);
        transform(&mut squares, size);
        for (i, found) in squares.iter().enumerate() {
            let square = |zero: &usize| {
                let dx = (zero % size[0]) as f64 - (i % size[0]) as f64;
                let dy = (zero / size[0]) as f64 - (i / size[0]) as f64;
                dx * dx + dy * dy
            };
            let expected = zeros.iter().map(square).fold(f64::INFINITY, f64::min);
            assert_eq!(*found, expected);
        }
    }
}
