//! Cross-fade of the images of two sectors at a border between recordings.
//!
//! Colors are blended by the weight of each sector, premultiplied and with what is behind, depths
//! by weight and alpha. With levels of detail the side of the smaller weight has half the columns
//! and rows, about 0.45 of the processor time of the other side.

use splats::Image;

/// Depths of neighboring pixels that differ by more, relative to the least, belong to two surfaces.
const MAX_DEPTH_STEP: f32 = 0.05;

/// Half of a size, rounded up, px.
pub(super) fn half(size: [u32; 2]) -> [u32; 2] {
    size.map(|edge| edge.div_ceil(2))
}

/// Blends another image of the same camera into one; its depths are multiplied by a factor.
pub(super) fn cross_fade(image: &mut Image, there: &Image, weight: f32, depth_factor: f32) {
    let here = 1.0 - weight;
    for (plane, other) in image.rgb.iter_mut().zip(&there.rgb) {
        for (value, other) in plane.iter_mut().zip(other) {
            *value = here * *value + weight * other;
        }
    }
    for pixel in 0..image.alpha.len() {
        let weights = [here * image.alpha[pixel], weight * there.alpha[pixel]];
        for (plane, other) in [
            (&mut image.median_depth_m, &there.median_depth_m),
            (&mut image.expected_depth_m, &there.expected_depth_m),
        ] {
            let depths = [plane[pixel], depth_factor * other[pixel]];
            plane[pixel] = mean_depth(depths, weights);
        }
        image.alpha[pixel] = weights[0] + weights[1];
    }
}

/// Mean of those depths that exist, by weights.
fn mean_depth(depths: [f32; 2], weights: [f32; 2]) -> f32 {
    let (mut sum, mut total) = (0.0, 0.0);
    for (depth, weight) in depths.into_iter().zip(weights) {
        if depth.is_finite() {
            sum += weight * depth;
            total += weight;
        }
    }
    match total > 0.0 {
        true => sum / total,
        false => f32::NAN,
    }
}

/// An image at a larger size, bilinear. Between two surfaces there is no depth: that of the other
/// side of the cross-fade counts there.
pub(super) fn enlarge(image: &Image, [width, height]: [usize; 2]) -> Image {
    let columns = neighbors(image.width, width);
    let rows = neighbors(image.height, height);
    let colors = |plane: &Vec<f32>| resample(plane, image.width, &columns, &rows);
    let depths = |plane: &Vec<f32>| resample_depth(plane, image.width, &columns, &rows);
    Image {
        width,
        height,
        rgb: image.rgb.each_ref().map(colors),
        expected_depth_m: depths(&image.expected_depth_m),
        median_depth_m: depths(&image.median_depth_m),
        alpha: colors(&image.alpha),
    }
}

/// The two nearest of `from` pixels for each of `to`, and the weight of the second.
fn neighbors(from: usize, to: usize) -> Vec<(usize, usize, f32)> {
    let scale = from as f64 / to as f64;
    let last = from - 1;
    let of = |pixel: usize| {
        // Centers of pixels are at integers.
        let at = ((pixel as f64 + 0.5) * scale - 0.5).clamp(0.0, last as f64);
        let first = at as usize;
        (first, (first + 1).min(last), (at - first as f64) as f32)
    };
    (0..to).map(of).collect()
}

fn resample(
    plane: &[f32],
    width: usize,
    columns: &[(usize, usize, f32)],
    rows: &[(usize, usize, f32)],
) -> Vec<f32> {
    let mut all = Vec::with_capacity(columns.len() * rows.len());
    let mut between = vec![0.0; width];
    for (first, second, weight) in rows {
        let [first, second] = [first, second].map(|row| &plane[width * row..][..width]);
        for (value, (a, b)) in between.iter_mut().zip(first.iter().zip(second)) {
            *value = a + weight * (b - a);
        }
        let of = |(first, second, weight): &(usize, usize, f32)| {
            between[*first] + weight * (between[*second] - between[*first])
        };
        all.extend(columns.iter().map(of));
    }
    all
}

fn resample_depth(
    plane: &[f32],
    width: usize,
    columns: &[(usize, usize, f32)],
    rows: &[(usize, usize, f32)],
) -> Vec<f32> {
    let mut all = Vec::with_capacity(columns.len() * rows.len());
    for (first, second, down) in rows {
        let [first, second] = [first, second].map(|row| &plane[width * row..][..width]);
        let of = |(left, right, along): &(usize, usize, f32)| {
            let [a, b, c, d] = [first[*left], first[*right], second[*left], second[*right]];
            let [least, most] = [a.min(b).min(c.min(d)), a.max(b).max(c.max(d))];
            // NaN, of pixels without a surface, is in no sum that is finite.
            let above = a + along * (b - a);
            let below = c + along * (d - c);
            match most - least <= MAX_DEPTH_STEP * least {
                true => above + down * (below - above),
                false => f32::NAN,
            }
        };
        all.extend(columns.iter().map(of));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_are_weighted_by_alpha_where_both_exist() {
        assert_eq!(mean_depth([2.0, 4.0], [0.25, 0.75]), 3.5);
        assert_eq!(mean_depth([2.0, f32::NAN], [0.25, 0.75]), 2.0);
        assert!(mean_depth([f32::NAN; 2], [0.5; 2]).is_nan());
        assert!(mean_depth([2.0, 3.0], [0.0; 2]).is_nan());
    }

    /// A ramp of values, and of depths with a step and a hole.
    fn ramp(width: usize, height: usize) -> Image {
        let at = |pixel: usize| [(pixel % width) as f32, (pixel / width) as f32];
        let plane = |of: fn([f32; 2]) -> f32| (0..width * height).map(|p| of(at(p))).collect();
        let color: fn([f32; 2]) -> f32 = |[x, y]| 0.02 * x + 0.01 * y;
        Image {
            width,
            height,
            rgb: [color, color, color].map(plane),
            expected_depth_m: plane(|_| 2.0),
            median_depth_m: plane(|[x, y]| match (x < 5.0, y < 1.0) {
                (true, true) => f32::NAN,
                (true, false) => 2.0 + 0.01 * x,
                (false, _) => 4.0,
            }),
            alpha: plane(|_| 1.0),
        }
    }

    #[test]
    fn what_is_linear_in_the_image_keeps_its_values() {
        assert_eq!(half([7, 4]), [4, 2]);
        for (size, into) in [([8, 6], [16, 12]), ([8, 6], [15, 11]), ([1, 1], [2, 1])] {
            let small = ramp(size[0], size[1]);
            let large = enlarge(&small, into);
            assert_eq!((large.width, large.height), (into[0], into[1]));
            for row in 0..into[1] {
                for column in 0..into[0] {
                    let [x, y] = [(column, 0), (row, 1)].map(|(pixel, axis)| {
                        let scale = size[axis] as f32 / into[axis] as f32;
                        ((pixel as f32 + 0.5) * scale - 0.5).clamp(0.0, size[axis] as f32 - 1.0)
                    });
                    let pixel = into[0] * row + column;
                    let color = 0.02 * x + 0.01 * y;
                    assert!((large.rgb[1][pixel] - color).abs() < 1e-5);
                    let depth = large.median_depth_m[pixel];
                    match y {
                        // Beside pixels without a surface, and between two surfaces.
                        y if y < 1.0 && x < 5.0 => assert!(depth.is_nan(), "{x} {y}: {depth}"),
                        _ if x > 4.0 && x < 5.0 => assert!(depth.is_nan(), "{x} {y}: {depth}"),
                        _ if x >= 5.0 => assert_eq!(depth, 4.0),
                        _ => assert!((depth - 2.0 - 0.01 * x).abs() < 1e-5),
                    }
                }
            }
        }
    }
}
