//! Decoding of a marker in a square of the image.
//!
//! Contract: a square is decoded only if the marker's border is black all around except for a few
//! cells, and if dark and bright are clearly separated. The marker is the nearest code of the
//! dictionary in any of four rotations, if it is close enough and no other is as close. A mirrored
//! marker decodes as noise.

use boards::{Dictionary, quarter_turn};
use estimator_config::config;
use imaging::ImageView;

use crate::square::{Square, distance};

config! {
    /// How the cells of a marker are read.
    pub struct ReadConfig {
        /// Minimum contrast between the border and white, gray levels.
        pub min_contrast: f64 = 8.0,
        /// Minimum side of a cell that is averaged over nine samples, px. Smaller ones are blurred
        /// already.
        pub averaged_cell_px: f64 = 3.5,
        /// Distance of these samples from each other along both axes, as a fraction of the side.
        pub sample_spacing_ratio: f64 = 0.25,
        /// Side of a cell below which a part of its neighbors is subtracted, px.
        pub sharpened_cell_px: f64 = 5.0,
        /// That part.
        pub sharpening: f64 = 0.25,
    }
}

/// Position of a marker in its square.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    /// Where the marker begins along both axes of the unit square.
    pub from: f64,
    /// Where it ends.
    pub to: f64,
    /// Bits along a side.
    pub bits: u32,
    /// Cells of the border on each side.
    pub border: u32,
    /// Width of the white area outside the marker's edge, in units of the square.
    pub white: f64,
}

/// The bits of a square, row by row from its corner (0, 0).
#[derive(Clone, Copy, Debug)]
pub struct Reading {
    /// The bits, most significant first; white is 1.
    pub code: u64,
    /// Number of border cells that are white.
    pub border_errors: u32,
}

/// Decodes a square; `None` without contrast or if the square leaves the image.
pub fn read(
    image: &ImageView<'_>,
    square: &Square,
    layout: &Layout,
    config: &ReadConfig,
) -> Option<Reading> {
    let cells = (layout.bits + 2 * layout.border) as usize;
    let side = (layout.to - layout.from) / cells as f64;
    let place = |i: f64| layout.from + i * side;
    // Large cells are averaged; small ones are already blurred.
    let [across, down] = [[0.5 + side, 0.5], [0.5, 0.5 + side]]
        .map(|uv| distance(square.at([0.5, 0.5]), square.at(uv)));
    let spacing = config.sample_spacing_ratio;
    let averaged = [-spacing, 0.0, spacing];
    let offsets: &[f64] = if across.min(down) > config.averaged_cell_px {
        &averaged
    } else {
        &[0.0]
    };
    let mut values = vec![0.0; cells * cells];
    for (i, value) in values.iter_mut().enumerate() {
        let (row, column) = ((i / cells) as f64 + 0.5, (i % cells) as f64 + 0.5);
        for dy in offsets {
            for dx in offsets {
                *value += image.sample(square.at([place(column + dx), place(row + dy)]))?;
            }
        }
        *value /= (offsets.len() * offsets.len()) as f64;
    }
    let is_border = |i: usize| {
        let inside = layout.border as usize..cells - layout.border as usize;
        !inside.contains(&(i / cells)) || !inside.contains(&(i % cells))
    };
    let middle = 0.5 * (cells as f64 - 1.0);
    let uv = |i: usize| [(i % cells) as f64 - middle, (i / cells) as f64 - middle];
    let border: Vec<([f64; 2], f64)> = (0..cells * cells)
        .filter(|i| is_border(*i))
        .map(|i| (uv(i), values[i]))
        .collect();
    let black = Plane::of(&border);
    // White next to the four sides. Near the image edge some of it may be missing.
    let mut outside = Vec::new();
    let out = 0.5 * layout.white;
    for i in 0..cells {
        let along = place(i as f64 + 0.5);
        for at in [
            [along, layout.from - out],
            [along, layout.to + out],
            [layout.from - out, along],
            [layout.to + out, along],
        ] {
            if let Some(value) = image.sample(square.at(at)) {
                outside.push((at.map(|v| (v - layout.from) / side - 0.5 - middle), value));
            }
        }
    }
    let complete = outside.len() == 4 * cells;
    let mut white = Plane::of(&outside);
    if !complete {
        if outside.len() < cells {
            return None;
        }
        white.slope = black.slope;
    }
    if white.mean - black.mean < config.min_contrast {
        return None;
    }
    // Small cells are blurred with their neighbours: a part of them is subtracted.
    let share = if across.min(down) < config.sharpened_cell_px {
        config.sharpening
    } else {
        0.0
    };
    let mut code = 0;
    let mut border_errors = 0;
    for i in 0..cells * cells {
        let (row, column) = (i / cells, i % cells);
        let mut value = values[i];
        if row > 0 && column > 0 && row + 1 < cells && column + 1 < cells {
            let around = values[i - 1] + values[i + 1] + values[i - cells] + values[i + cells];
            value += share * (4.0 * values[i] - around);
        }
        let at = uv(i);
        let is_white = value > 0.5 * (black.at(at) + white.at(at));
        if is_border(i) {
            border_errors += u32::from(is_white);
        } else {
            code = code << 1 | u64::from(is_white);
        }
    }
    Some(Reading {
        code,
        border_errors,
    })
}

/// A level that varies linearly over the marker.
struct Plane {
    mean: f64,
    slope: [f64; 2],
}

impl Plane {
    /// Fits samples that are symmetric about the origin.
    fn of(values: &[([f64; 2], f64)]) -> Self {
        let count = values.len().max(1) as f64;
        let mean = values.iter().map(|(_, v)| v).sum::<f64>() / count;
        let slope = [0, 1].map(|k| {
            let (up, down) = values.iter().fold((0.0, 0.0), |(up, down), (at, v)| {
                (up + at[k] * (v - mean), down + at[k] * at[k])
            });
            if down > 0.0 { up / down } else { 0.0 }
        });
        Self { mean, slope }
    }

    fn at(&self, [u, v]: [f64; 2]) -> f64 {
        self.mean + u * self.slope[0] + v * self.slope[1]
    }
}

/// A decoded marker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Match {
    /// Its number.
    pub id: u32,
    /// Rotation of the marker in the square, quarter turns clockwise.
    pub turns: usize,
    /// Number of wrong bits.
    pub errors: u32,
}

/// The codes of a dictionary in their four rotations.
#[derive(Clone, Debug)]
pub struct Book {
    codes: Vec<[u64; 4]>,
}

impl Book {
    /// All codes of a dictionary.
    pub fn of(dictionary: Dictionary) -> Self {
        let bits = dictionary.bits();
        let codes = (0..dictionary.count())
            .filter_map(|id| dictionary.code(id))
            .map(|code| {
                let turn = |code| quarter_turn(code, bits);
                [code, turn(code), turn(turn(code)), turn(turn(turn(code)))]
            })
            .collect();
        Self { codes }
    }

    /// The nearest marker with at most `most` wrong bits; `None` if another is as close.
    pub fn find(&self, code: u64, most: u32) -> Option<Match> {
        let mut best: Option<Match> = None;
        let mut alone = true;
        for (id, rotated) in (0..).zip(&self.codes) {
            for (turns, other) in rotated.iter().enumerate() {
                let errors = (other ^ code).count_ones();
                if errors > best.map_or(most, |b| b.errors) {
                    continue;
                }
                alone = best.is_none_or(|b| errors < b.errors);
                best = Some(Match { id, turns, errors });
            }
        }
        best.filter(|_| alone)
    }

    /// Number of wrong bits for this marker at this rotation.
    pub fn errors(&self, code: u64, id: u32, turns: usize) -> Option<u32> {
        let rotated = self.codes.get(id as usize)?;
        Some((rotated[turns % 4] ^ code).count_ones())
    }
}
