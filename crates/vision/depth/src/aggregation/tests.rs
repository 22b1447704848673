//! Bit-exact comparison with the reference implementation.

use super::*;
use crate::reference::{self, Random};

const PENALTIES: Penalties = Penalties {
    small: 6,
    large: 70,
    slope: 2,
    min_large: 18,
};

fn check(level: Level, weights: Weights, pixels: &[Vec<u8>; 2], width: usize, range: Range<'_>) {
    let height = pixels[0].len() / width;
    let images = [0, 1].map(|eye| ImageView::packed(width, height, &pixels[eye]).unwrap());
    let images = [&images[0], &images[1]];
    let mut aggregation = Aggregation::default();
    // Twice: buffers of the first run must not affect the second one.
    for _ in 0..2 {
        aggregation.run(level, weights, images, range);
    }
    let (winners, right) = reference::winners(weights, images, range);
    for (i, (found, expected)) in aggregation.winners.iter().zip(&winners).enumerate() {
        let sums = |w: &Winner| (w.lane, w.least, w.second);
        let (x, y) = (i % width, i / width);
        assert_eq!(sums(found), sums(expected), "{level:?} {weights:?} {x} {y}");
        if expected.lane == NONE {
            continue;
        }
        // The reference has no sums outside the range.
        for (side, lane) in [(0, expected.lane.wrapping_sub(1)), (1, expected.lane + 1)] {
            if usize::from(lane) < range.count {
                assert_eq!(found.beside[side], expected.beside[side], "{x} {y}");
            } else {
                assert!(found.beside[side] >= 2 * 255, "{x} {y}");
            }
        }
    }
    assert_eq!(aggregation.right, right, "{level:?} {weights:?}");
}

#[test]
fn winners_equal_those_of_the_reference() {
    let mut random = Random(11);
    let (width, height) = (61, 17);
    for (k, paths) in [Paths::Three, Paths::Four, Paths::Eight]
        .into_iter()
        .enumerate()
    {
        for (count, first) in [(1, 0), (16, -2), (40, 0), (64, 3), (100, 0)] {
            let rows = vec![[0, count as u16]; height];
            let range = Range {
                first,
                count,
                rows: &rows,
            };
            let weights = Weights {
                census: [Census::Full5x5, Census::Opposite9x7, Census::Full7x7][k],
                max_gray_cost: [8, 0, 12][k],
                paths,
                penalties: PENALTIES,
            };
            for level in Level::all() {
                let pair = random.pair(width, height, 9);
                check(level, weights, &pair, width, range);
                let noise = [(); 2].map(|()| random.image(width, height));
                check(level, weights, &noise, width, range);
            }
        }
    }
}

#[test]
fn banded_winners_equal_those_of_the_reference() {
    let mut random = Random(12);
    let (width, height) = (50, 24);
    for count in [70, 140, 256] {
        for round in 0..6 {
            let rows: Vec<[u16; 2]> = (0..height)
                .map(|y| {
                    // Bands of all widths, touching the ends of the range or not, that change every
                    // third row.
                    let mut of = Random(1 + y as u64 / 3 + 100 * round);
                    let low = of.below(count);
                    let high = low + 1 + of.below(count - low);
                    [low as u16, high as u16]
                })
                .collect();
            let range = Range {
                first: 0,
                count: count as usize,
                rows: &rows,
            };
            let weights = Weights {
                census: Census::Full5x5,
                max_gray_cost: 8,
                paths: [Paths::Three, Paths::Four, Paths::Eight][round as usize % 3],
                penalties: PENALTIES,
            };
            let pair = random.pair(width, height, 20);
            for level in Level::all() {
                check(level, weights, &pair, width, range);
            }
        }
    }
}

#[test]
fn result_does_not_depend_on_the_number_of_threads() {
    let mut random = Random(13);
    let (width, height) = (90, 31);
    let pair = random.pair(width, height, 12);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.unwrap().install(|| {
            let images = [0, 1].map(|eye| ImageView::packed(width, height, &pair[eye]).unwrap());
            let mut aggregation = Aggregation::default();
            let weights = Weights {
                census: Census::Full7x7,
                max_gray_cost: 8,
                paths: Paths::Eight,
                penalties: PENALTIES,
            };
            let range = Range {
                first: 0,
                count: 64,
                rows: &vec![[0, 64]; height],
            };
            aggregation.run(Level::best(), weights, [&images[0], &images[1]], range);
            (aggregation.winners, aggregation.right)
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5));
}
