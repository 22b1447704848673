//! BRIEF descriptor: 256 bits that are robust to small changes of light and position.
//!
//! Each bit compares two pixels (Calonder, Lepetit, Strecha and Fua, BRIEF, 2010), sampled once
//! from a normal distribution over a patch 15 px wide on a level of half size. The rig is carried
//! upright, so that rotation is not compensated.

use imaging::Level;

/// Maximum offset from the center, px of the level.
const PATTERN_RADIUS_PX: i32 = 7;

/// Compared pixels: 256 pairs of offsets.
fn pattern() -> &'static [[i8; 4]; 256] {
    static PLACES: std::sync::OnceLock<[[i8; 4]; 256]> = std::sync::OnceLock::new();
    PLACES.get_or_init(|| {
        // Knuth's LCG; sums of four uniform numbers are approximately normal.
        let mut state = 0x2545_f491_4f6c_dd1d_u64;
        let mut uniform = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1 << 24) - 0.5
        };
        let mut normal = || {
            let sum = uniform() + uniform() + uniform() + uniform();
            ((sum * 6.0).round() as i32).clamp(-PATTERN_RADIUS_PX, PATTERN_RADIUS_PX) as i8
        };
        let mut pairs = [[0; 4]; 256];
        for pair in &mut pairs {
            while pair[0] == pair[2] && pair[1] == pair[3] {
                *pair = [normal(), normal(), normal(), normal()];
            }
        }
        pairs
    })
}

/// Descriptor at a position, px of the level; `None` near the border.
pub(crate) fn describe(level: &Level, x: f32, y: f32) -> Option<[u64; 4]> {
    let (x, y) = (x.round() as i32, y.round() as i32);
    let inside = x >= PATTERN_RADIUS_PX
        && y >= PATTERN_RADIUS_PX
        && x + PATTERN_RADIUS_PX < level.width as i32
        && y + PATTERN_RADIUS_PX < level.height as i32;
    if !inside {
        return None;
    }
    let value = |dx: i8, dy: i8| {
        let (u, v) = (x + i32::from(dx), y + i32::from(dy));
        level.data[v as usize * level.width + u as usize]
    };
    let mut bits = [0_u64; 4];
    for (k, [ax, ay, bx, by]) in pattern().iter().enumerate() {
        if value(*ax, *ay) < value(*bx, *by) {
            bits[k / 64] |= 1 << (k % 64);
        }
    }
    Some(bits)
}

/// Number of differing bits.
pub(crate) fn hamming_distance(a: &[u64; 4], b: &[u64; 4]) -> u32 {
    a.iter().zip(b).map(|(a, b)| (a ^ b).count_ones()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descriptors_match_under_small_changes_and_differ_elsewhere() {
        let (width, height) = (120, 90);
        let image = |dx: f64, gain: f64| Level {
            width,
            height,
            data: (0..width * height)
                .map(|i| {
                    let (x, y) = ((i % width) as f64 - dx, (i / width) as f64);
                    let v = (0.5 * x + 0.3 * y).sin() + (0.7 * y - 0.2 * x).cos() * (0.1 * x).sin();
                    (gain * (100.0 + 40.0 * v)) as u8
                })
                .collect(),
        };
        let here = describe(&image(0.0, 1.0), 60.0, 40.0).unwrap();
        let there = describe(&image(0.3, 1.3), 60.0, 40.0).unwrap();
        let other = describe(&image(0.0, 1.0), 71.0, 52.0).unwrap();
        assert!(
            hamming_distance(&here, &there) < 40,
            "{}",
            hamming_distance(&here, &there)
        );
        assert!(
            hamming_distance(&here, &other) > 80,
            "{}",
            hamming_distance(&here, &other)
        );
        assert!(describe(&image(0.0, 1.0), 3.0, 40.0).is_none());
    }
}
