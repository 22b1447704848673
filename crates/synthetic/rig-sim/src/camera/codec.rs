//! Traces of a codec: quantized cosine transforms of 8x8 blocks, as of MJPEG and of intra frames.
//!
//! Contract: only luma is quantized; the last columns and rows that fill no block are unchanged. A
//! step of 0 changes no byte.

use std::array::from_fn;
use std::f32::consts::PI;

/// Side length of a block, px.
const BLOCK_PX: usize = 8;
/// Quantization step of the highest frequency relative to that of the lowest.
const HIGHEST_TO_LOWEST: f32 = 4.0;

type Block = [[f32; BLOCK_PX]; BLOCK_PX];

/// Quantizes an image of `[width, height]` with rows of `stride`. `step` is that of the lowest
/// frequency, gray levels; it grows linearly with the frequency to four times as much.
pub fn quantize(luma: &mut [u8], stride: usize, [width, height]: [usize; 2], step: f32) {
    if step <= 0.0 {
        return;
    }
    let basis: Block = from_fn(|k| {
        let scale = if k == 0 { 0.125_f32.sqrt() } else { 0.5 };
        from_fn(|x| scale * libm::cosf(PI * (2 * x + 1) as f32 * k as f32 / 16.0))
    });
    let of_frequency = |k: usize| {
        let highest = (2 * BLOCK_PX - 2) as f32;
        step * (1.0 + (HIGHEST_TO_LOWEST - 1.0) * k as f32 / highest)
    };
    for top in (0..height - height % BLOCK_PX).step_by(BLOCK_PX) {
        for left in (0..width - width % BLOCK_PX).step_by(BLOCK_PX) {
            let at = |row: usize, column: usize| (top + row) * stride + left + column;
            let block = from_fn(|row| from_fn(|column| f32::from(luma[at(row, column)])));
            let mut found = product(&product(&basis, &block), &transpose(&basis));
            for (row, values) in found.iter_mut().enumerate() {
                for (column, value) in values.iter_mut().enumerate() {
                    let step = of_frequency(row + column);
                    *value = (*value / step).round() * step;
                }
            }
            let decoded = product(&product(&transpose(&basis), &found), &basis);
            for (row, values) in decoded.iter().enumerate() {
                for (column, value) in values.iter().enumerate() {
                    luma[at(row, column)] = value.round().clamp(0.0, 255.0) as u8;
                }
            }
        }
    }
}

fn product(a: &Block, b: &Block) -> Block {
    from_fn(|i| from_fn(|j| (0..BLOCK_PX).map(|k| a[i][k] * b[k][j]).sum()))
}

fn transpose(a: &Block) -> Block {
    from_fn(|i| from_fn(|j| a[j][i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two eyes of 20 x 17 pixels side by side.
    const SIZE: [usize; 2] = [20, 17];
    const STRIDE: usize = 40;

    fn image() -> Vec<u8> {
        let pixel = |i: usize| (100.0 + 60.0 * libm::sinf(0.7 * i as f32)) as u8;
        (0..STRIDE * SIZE[1]).map(pixel).collect()
    }

    #[test]
    fn step_of_zero_changes_no_byte() {
        let mut quantized = image();
        quantize(&mut quantized, STRIDE, SIZE, 0.0);
        assert_eq!(quantized, image());
    }

    #[test]
    fn whole_blocks_of_one_eye_change_by_no_more_than_the_steps_allow() {
        let mut quantized = image();
        quantize(&mut quantized[20..], STRIDE, SIZE, 6.0);
        let mut changed = 0;
        for (i, (new, old)) in quantized.iter().zip(&image()).enumerate() {
            let (x, y) = (i % STRIDE, i / STRIDE);
            if !(20..36).contains(&x) || y >= 16 {
                assert_eq!(new, old, "{x} {y}");
            }
            // Half a step in each of 64 orthonormal components.
            assert!(new.abs_diff(*old) < 96, "{x} {y}");
            changed += usize::from(new != old);
        }
        assert!(changed > 100, "{changed}");
        // Decoded blocks are multiples of the steps, up to rounding to whole gray levels.
        let mut again = quantized.clone();
        quantize(&mut again[20..], STRIDE, SIZE, 6.0);
        let differ = again
            .iter()
            .zip(&quantized)
            .filter(|(a, b)| a.abs_diff(**b) > 1);
        assert!(differ.count() < changed / 10);
    }
}
