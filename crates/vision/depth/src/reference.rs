//! Reference implementation of the matcher: loops over pixels, disparities and paths, directly from
//! the definitions.

use crate::aggregation::{MAX_DISPARITIES, NONE, Paths, Range, Weights, Winner};
use crate::census::Census;
use crate::lanes::Level;
use imaging::ImageView;

/// Pseudorandom numbers (xorshift64*).
pub(crate) struct Random(pub(crate) u64);

impl Random {
    /// A random integer below `most`.
    pub(crate) fn below(&mut self, most: u64) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 32) % most
    }

    /// An image of random gray levels.
    pub(crate) fn image(&mut self, width: usize, height: usize) -> Vec<u8> {
        (0..width * height).map(|_| self.below(256) as u8).collect()
    }

    /// A random image with detail at several scales.
    pub(crate) fn scene(&mut self, width: usize, height: usize) -> Vec<u8> {
        let mut image = vec![0u16; width * height];
        for (side, most) in [(1, 40), (3, 80), (9, 80), (24, 40)] {
            let columns = width.div_ceil(side);
            let cells: Vec<u16> = (0..columns * height.div_ceil(side))
                .map(|_| self.below(most) as u16)
                .collect();
            for (i, pixel) in image.iter_mut().enumerate() {
                *pixel += cells[i / width / side * columns + i % width / side];
            }
        }
        image.into_iter().map(|v| v as u8).collect()
    }

    /// An image, and the same image shifted to the left by `shift` columns, both with a little
    /// noise.
    pub(crate) fn pair(&mut self, width: usize, height: usize, shift: usize) -> [Vec<u8>; 2] {
        let wide = width + shift;
        let long = self.scene(wide, height);
        let mut cut = |from: usize| -> Vec<u8> {
            let rows = long.chunks_exact(wide);
            let pixels = rows.flat_map(|row| &row[from..from + width]);
            pixels.map(|v| v + self.below(4) as u8).collect()
        };
        [cut(0), cut(shift)]
    }
}

/// All combinations of instruction sets and values.
pub(crate) fn with_levels<T: Copy, const N: usize>(values: [T; N]) -> Vec<(Level, T)> {
    let of = |level: Level| values.map(|value| (level, value));
    Level::all().into_iter().flat_map(of).collect()
}

/// Census code of a pixel, with the first pair in the highest bit.
pub(crate) fn code(image: &ImageView<'_>, census: Census, x: usize, y: usize) -> u64 {
    let at = |(dx, dy): (i32, i32)| {
        let column = (x as i32 + dx).clamp(0, image.width() as i32 - 1);
        let row = (y as i32 + dy).clamp(0, image.height() as i32 - 1);
        image.row(row as usize)[column as usize]
    };
    let bits = census.pairs().into_iter().map(|[a, b]| at(a) > at(b));
    bits.fold(0, |code, bit| code << 1 | u64::from(bit))
}

/// Matching cost of a disparity of a pixel.
pub(crate) fn cost(
    left: &ImageView<'_>,
    right: &ImageView<'_>,
    census: Census,
    max_gray_cost: u8,
    x: usize,
    y: usize,
    disparity: i32,
) -> u8 {
    let there = x as i32 - disparity;
    if there < 0 || there >= left.width() as i32 {
        return u8::MAX;
    }
    let bits = code(left, census, x, y) ^ code(right, census, there as usize, y);
    let half = |image: &ImageView<'_>, x: usize| image.row(y)[x] / 2;
    let apart = half(left, x).abs_diff(half(right, there as usize));
    bits.count_ones() as u8 + apart.min(max_gray_cost)
}

/// Winners of all pixels of the left and of the right image.
pub(crate) fn winners(
    weights: Weights,
    [left, right]: [&ImageView<'_>; 2],
    range: Range<'_>,
) -> (Vec<Winner>, Vec<u16>) {
    let (width, height) = (left.width(), left.height());
    let count = range.count;
    let is_in = |y: usize, lane: usize| {
        let [low, high] = range.rows[y];
        (usize::from(low)..usize::from(high)).contains(&lane)
    };
    let mut costs = vec![u8::MAX; width * height * count];
    for (i, cost) in costs.iter_mut().enumerate() {
        let (x, y, lane) = (i / count % width, i / count / width, i % count);
        if is_in(y, lane) {
            let disparity = range.first + lane as i32;
            *cost = self::cost(
                left,
                right,
                weights.census,
                weights.max_gray_cost,
                x,
                y,
                disparity,
            );
        }
    }
    let path = |step: [i32; 2]| path(weights, left, &costs, count, step);
    let (from_left, from_right) = (path([1, 0]), path([-1, 0]));
    let straight_or_diagonal = |dy: i32| -> Vec<Vec<u8>> {
        match weights.paths {
            Paths::Three | Paths::Four => vec![path([0, dy])],
            Paths::Eight => [0, 1, -1].map(|dx| path([dx, dy])).to_vec(),
        }
    };
    let (from_above, from_below) = (straight_or_diagonal(1), straight_or_diagonal(-1));
    let sum = |paths: &[&Vec<u8>], i: usize| {
        let costs = paths.iter().map(|path| path[i]);
        u16::from(costs.fold(0, u8::saturating_add))
    };
    let mut winners = Vec::new();
    let mut right_winners = vec![NONE; width * height];
    for y in 0..height {
        let is_upper = y < height / 2;
        // The paths that are added last belong to the sweep that ends in this half.
        let (mut own, mut other): (Vec<&Vec<u8>>, Vec<&Vec<u8>>) = match is_upper {
            true => (from_below.iter().collect(), from_above.iter().collect()),
            false => (from_above.iter().collect(), from_below.iter().collect()),
        };
        if weights.paths == Paths::Three {
            std::mem::swap(&mut own, &mut other);
            other.clear();
        }
        own.push(&from_left);
        let out = if weights.paths == Paths::Three { 2 } else { 3 } * 255;
        let mut of_right = vec![NONE; width];
        for x in 0..width {
            let total: Vec<u16> = (0..count)
                .map(|lane| {
                    let i = (y * width + x) * count + lane;
                    sum(&own, i) + sum(&other, i) + u16::from(from_right[i])
                })
                .collect();
            winners.push(winner(&total, out));
        }
        for x in (0..width).rev() {
            for lane in 0..count {
                let there = x as i32 - range.first - lane as i32;
                if there < 0 || there >= width as i32 {
                    continue;
                }
                let i = (y * width + x) * count + lane;
                let total = sum(&own, i) + sum(&other, i) + u16::from(from_right[i]);
                if total < out.min(of_right[there as usize]) {
                    of_right[there as usize] = total;
                    right_winners[y * width + there as usize] = lane as u16;
                }
            }
        }
    }
    (winners, right_winners)
}

/// The smallest sum, the first among equals, with the adjacent sums.
fn winner(total: &[u16], out: u16) -> Winner {
    let least = *total.iter().min().unwrap();
    let lane = total.iter().position(|sum| *sum == least).unwrap();
    let away = |other: &usize| other.abs_diff(lane) > 1;
    let others = (0..total.len()).filter(away).map(|k| total[k]);
    let at = |k: usize| total.get(k).copied();
    Winner {
        lane: if least < out { lane as u16 } else { NONE },
        least,
        second: others.min().unwrap_or(out),
        beside: [at(lane.wrapping_sub(1)), at(lane + 1)].map(|sum| sum.unwrap_or(NONE)),
    }
}

/// Costs along one path, for every pixel and disparity.
fn path(
    weights: Weights,
    left: &ImageView<'_>,
    costs: &[u8],
    count: usize,
    [dx, dy]: [i32; 2],
) -> Vec<u8> {
    assert!(count <= MAX_DISPARITIES);
    let (width, height) = (left.width() as i32, left.height() as i32);
    let mut path = costs.to_vec();
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let mut pixels: Vec<(i32, i32)> = pixels.collect();
    if (dy, dx) < (0, 0) {
        pixels.reverse();
    }
    let penalties = weights.penalties;
    for (x, y) in pixels {
        let (from_x, from_y) = (x - dx, y - dy);
        if from_x < 0 || from_x >= width || from_y < 0 || from_y >= height {
            continue;
        }
        let gray = |x: i32, y: i32| left.row(y as usize)[x as usize];
        let apart = gray(x, y).abs_diff(gray(from_x, from_y));
        let less = (0..penalties.slope).fold(penalties.large, |l, _| l.saturating_sub(apart));
        let large = less.max(penalties.min_large);
        let at = |x: i32, y: i32| (y * width + x) as usize * count;
        let before: Vec<u8> = path[at(from_x, from_y)..][..count].to_vec();
        let least = *before.iter().min().unwrap();
        for lane in 0..count {
            let step = |from: usize, penalty: u8| {
                let before = before.get(from).copied().unwrap_or(u8::MAX);
                before.saturating_add(penalty)
            };
            let best = step(lane, 0)
                .min(step(lane.wrapping_sub(1), penalties.small))
                .min(step(lane + 1, penalties.small))
                .min(least.saturating_add(large));
            let i = at(x, y) + lane;
            path[i] = (best - least).saturating_add(costs[i]);
        }
    }
    path
}
