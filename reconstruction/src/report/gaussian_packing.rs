//! Gaussians in few bytes, for a page.
//!
//! Contract: 24 bytes for each Gaussian, little-endian: position as three f32, m; three natural
//! logarithms of scales in 10 bits each, as steps of a range; the rotation's three smallest
//! components `w x y z` in 10 bits each and the index of the largest one in the highest two; red,
//! green and blue (harmonics of degree 0) in 8 bits each from -0.5 to 1.5, and the opacity in 8
//! bits. Harmonics of degree 1 are nine numbers of 6 bits, five in the first of two u32 and four in
//! the second, steps of 1/31 from 32 on, cut at -1 and 1. Higher degrees are left out. More than
//! `most` Gaussians are reduced to those with the largest product of opacity and cross-section.

use gaussians::harmonics::to_color;
use gaussians::{Splat, Splats};

/// Bytes of a Gaussian.
pub(super) const SHAPE_BYTES: usize = 24;
/// Bytes of the harmonics of degree 1.
pub(super) const HARMONICS_BYTES: usize = 8;

/// Gaussians in bytes.
#[derive(Debug, PartialEq)]
pub(super) struct GaussianBytes {
    pub(super) count: usize,
    /// Degree of the harmonics, 0 or 1.
    pub(super) degree: usize,
    /// Least logarithm of a scale and its step.
    pub(super) scales: [f32; 2],
    pub(super) shapes: Vec<u8>,
    /// Empty for degree 0.
    pub(super) harmonics: Vec<u8>,
}

/// Packs at most `most` Gaussians.
pub(super) fn pack(splats: &Splats, most: usize) -> GaussianBytes {
    let all: Vec<Splat> = important(splats, most)
        .into_iter()
        .map(|index| splats.get(index))
        .collect();
    let logs = || all.iter().flat_map(|splat| splat.log_scale);
    let (low, high) = logs().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), log| {
        (low.min(log), high.max(log))
    });
    let scales = match low <= high {
        true => [low, (high - low) / 1023.0],
        false => [0.0, 0.0],
    };
    let degree = splats.degree().min(1);
    let mut shapes = Vec::with_capacity(all.len() * SHAPE_BYTES);
    let mut harmonics = Vec::with_capacity(all.len() * HARMONICS_BYTES * degree);
    for splat in &all {
        let steps = splat.log_scale.map(|log| match scales[1] > 0.0 {
            true => quantized((log - scales[0]) / scales[1], 1023),
            false => 0,
        });
        let color = splat.harmonics[0].map(|f| quantized(127.5 * (to_color(f) + 0.5), 255));
        let opacity = quantized(255.0 * opacity(splat), 255);
        let words = [
            packed(steps, 10),
            smallest_three(splat.rotation_wxyz),
            packed(color, 8) | opacity << 24,
        ];
        shapes.extend(splat.position_m.iter().flat_map(|x| x.to_le_bytes()));
        shapes.extend(words.iter().flat_map(|word| word.to_le_bytes()));
        if degree == 1 {
            let values: Vec<u32> = splat.harmonics[1..4]
                .as_flattened()
                .iter()
                .map(|f| quantized(31.0 * f.clamp(-1.0, 1.0) + 32.0, 63))
                .collect();
            let (first, second) = values.split_at(5);
            for part in [first, second] {
                let word = (part.iter().rev()).fold(0_u32, |word, value| word << 6 | value);
                harmonics.extend(word.to_le_bytes());
            }
        }
    }
    GaussianBytes {
        count: all.len(),
        degree,
        scales,
        shapes,
        harmonics,
    }
}

/// Indices of the most important Gaussians, in order.
fn important(splats: &Splats, most: usize) -> Vec<usize> {
    let mut indices: Vec<usize> = (0..splats.len()).collect();
    if indices.len() <= most {
        return indices;
    }
    // Logarithms: products could overflow.
    let weights: Vec<f32> = indices
        .iter()
        .map(|index| {
            let splat = splats.get(*index);
            let [a, b, c] = splat.log_scale;
            libm::logf(opacity(&splat)) + a + b + c - a.min(b).min(c)
        })
        .collect();
    indices.sort_by(|a, b| weights[*b].total_cmp(&weights[*a]).then(a.cmp(b)));
    indices.truncate(most);
    indices.sort_unstable();
    indices
}

fn opacity(splat: &Splat) -> f32 {
    1.0 / (1.0 + libm::expf(-splat.opacity_logit))
}

fn quantized(value: f32, most: u32) -> u32 {
    // The cast saturates, and makes 0 of NaN.
    (libm::roundf(value) as u32).min(most)
}

/// Three numbers of a few bits each, the first in the lowest bits.
fn packed([a, b, c]: [u32; 3], bits: u32) -> u32 {
    a | b << bits | c << (2 * bits)
}

fn smallest_three(wxyz: [f32; 4]) -> u32 {
    let norm = wxyz.iter().map(|v| v * v).sum::<f32>().sqrt();
    let q = wxyz.map(|v| v / norm);
    let larger = |a: usize, b: usize| if q[b].abs() > q[a].abs() { b } else { a };
    let largest = (0..4).fold(0, larger);
    let sign = if q[largest] < 0.0 { -1.0 } else { 1.0 };
    let rest = |k: usize| q[k + usize::from(k >= largest)] * sign;
    let steps = [0, 1, 2].map(|k| {
        let share = rest(k) * std::f32::consts::SQRT_2 * 0.5 + 0.5;
        quantized(1023.0 * share, 1023)
    });
    packed(steps, 10) | (largest as u32) << 30
}

#[cfg(test)]
mod tests {
    use super::*;

    fn word(bytes: &[u8], at: usize) -> u32 {
        u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
    }

    fn bits(word: u32, low: u32, count: u32) -> f32 {
        (word >> low & ((1 << count) - 1)) as f32
    }

    /// As the page reads it: largest deviations of logarithm of scale, rotation, color, opacity and
    /// harmonics.
    fn deviations(packed: &GaussianBytes, index: usize, splat: &Splat) -> [f32; 5] {
        let row = &packed.shapes[SHAPE_BYTES * index..][..SHAPE_BYTES];
        for k in 0..3 {
            assert_eq!(f32::from_bits(word(row, 4 * k)), splat.position_m[k]);
        }
        let mut off = [0.0_f32; 5];
        let three: Vec<f32> = [0, 10, 20]
            .iter()
            .map(|low| (bits(word(row, 16), *low, 10) / 511.5 - 1.0) / std::f32::consts::SQRT_2)
            .collect();
        let largest = (1.0 - three.iter().map(|v| v * v).sum::<f32>()).sqrt();
        let mut q = three;
        q.insert((word(row, 16) >> 30) as usize, largest);
        let norm = (splat.rotation_wxyz.iter().map(|v| v * v).sum::<f32>()).sqrt();
        let cosine: f32 = (q.iter().zip(splat.rotation_wxyz))
            .map(|(a, b)| a * b / norm)
            .sum();
        off[1] = 2.0 * cosine.abs().min(1.0).acos();
        for k in 0..3 {
            let low = 10 * k as u32;
            let log = packed.scales[0] + packed.scales[1] * bits(word(row, 12), low, 10);
            off[0] = off[0].max((log - splat.log_scale[k]).abs());
            let color = bits(word(row, 20), 8 * k as u32, 8) / 127.5 - 0.5;
            off[2] = off[2].max((color - to_color(splat.harmonics[0][k])).abs());
        }
        off[3] = (bits(word(row, 20), 24, 8) / 255.0 - opacity(splat)).abs();
        for (k, f) in splat.harmonics[1..4].as_flattened().iter().enumerate() {
            let at = HARMONICS_BYTES * index + 4 * (k / 5);
            let value = match packed.degree {
                0 => 0.0,
                _ => (bits(word(&packed.harmonics, at), 6 * (k as u32 % 5), 6) - 32.0) / 31.0,
            };
            off[4] = off[4].max((value - f).abs());
        }
        off
    }

    fn splats(degree: usize, count: usize) -> Splats {
        let mut splats = Splats::empty(degree).expect("a degree");
        for i in 0..count {
            let wave = |k: usize| ((1 + k) as f32 * 0.7 * (1.0 + i as f32)).sin();
            let mut splat = Splat::sphere(0.1, [0.1, 0.5, 0.9].map(|c| c + 0.1 * wave(1)));
            splat.position_m = [wave(2) * 50.0, wave(3) * 50.0, wave(4)];
            splat.log_scale = [-4.0 + wave(5), -3.0 + wave(6), -7.0 + 2.0 * wave(7)];
            splat.rotation_wxyz = [wave(8), wave(9), wave(10), 0.1 + wave(11)];
            splat.opacity_logit = 3.0 * wave(12);
            for (k, f) in splat.harmonics.iter_mut().enumerate().skip(1) {
                *f = match degree {
                    0 => [0.0; 3],
                    _ => [0.9 * wave(k), 0.3 * wave(2 * k), 0.1 * wave(3 * k)],
                };
            }
            splats.push(&splat).expect("a Gaussian");
        }
        splats
    }

    #[test]
    fn packed_gaussians_deviate_by_half_a_step_at_most() {
        for degree in [0, 1, 2] {
            let splats = splats(degree, 200);
            let packed = pack(&splats, 1000);
            assert_eq!((packed.count, packed.degree), (200, degree.min(1)));
            assert_eq!(packed.shapes.len(), 200 * SHAPE_BYTES);
            assert_eq!(
                packed.harmonics.len(),
                200 * HARMONICS_BYTES * degree.min(1)
            );
            for i in 0..200 {
                let off = deviations(&packed, i, &splats.get(i));
                // A step of a rotation's three components, and what the fourth follows from them.
                let limits = [
                    0.501 * packed.scales[1],
                    0.005,
                    0.501 / 127.5,
                    0.501 / 255.0,
                    0.501 / 31.0,
                ];
                for (off, limit) in off.into_iter().zip(limits) {
                    assert!(off <= limit, "Gaussian {i}: {off} above {limit}");
                }
            }
        }
    }

    #[test]
    fn too_many_are_reduced_to_the_largest_and_most_opaque() {
        let splats = splats(0, 300);
        let packed = pack(&splats, 100);
        assert_eq!(packed.count, 100);
        let weight = |i: usize| {
            let splat = splats.get(i);
            let mut scales = splat.log_scale.map(f32::exp);
            scales.sort_by(f32::total_cmp);
            opacity(&splat) * scales[1] * scales[2]
        };
        let is_kept: Vec<bool> = (0..300)
            .map(|i| {
                let position = splats.get(i).position_m.map(f32::to_le_bytes);
                (packed.shapes.chunks(SHAPE_BYTES)).any(|row| row[..12] == *position.as_flattened())
            })
            .collect();
        let of = |kept: bool| (0..300).filter(move |i| is_kept[*i] == kept);
        let least = of.clone()(true).map(weight).fold(f32::INFINITY, f32::min);
        let most = of(false).map(weight).fold(0.0, f32::max);
        assert!(least >= most, "{least} {most}");
        assert_eq!(pack(&splats, 100), packed);
        // No Gaussians, and Gaussians of one size.
        let none = pack(&Splats::empty(1).expect("a degree"), 10);
        assert_eq!((none.count, none.scales), (0, [0.0, 0.0]));
        let mut one = Splats::empty(0).expect("a degree");
        one.push(&Splat::sphere(0.2, [2.0, -1.0, 0.5]))
            .expect("one");
        let one = pack(&one, 10);
        assert!((one.scales[0] - 0.2_f32.ln()).abs() < 1e-6 && one.scales[1] == 0.0);
        assert_eq!(word(&one.shapes, 20) & 0xffff, 0x00ff);
    }
}
