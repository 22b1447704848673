//! Imperfect pairs: what two real eyes add to a simulated pair.
//!
//! Contract: the right image of a rectified pair is changed in order of the light: blur,
//! vignetting, gain, an offset of the rectification, and traces of a codec in both images. A
//! strength of 0 changes no byte. The changes act on the rendered 8-bit images, after tone curve
//! and noise: blur also smooths the noise of the right eye.

use super::frames::Frame;

/// Strengths; see [`Imperfections::apply`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Imperfections {
    /// Standard deviation of the additional blur of the right eye, px.
    pub(super) blur_px: f32,
    /// Additional loss of light in the corners of the right eye, 0 to 1; with the square of the
    /// distance from the image center.
    pub(super) vignetting: f32,
    /// Gain of the right eye relative to the left one, minus 1.
    pub(super) gain: f32,
    /// The right image is lower than rectified by this, px.
    pub(super) row_offset_px: f32,
    /// Additional row offset in the lower right and upper left corner, px, with the product of the
    /// distances from the axes of the image; in the other two corners it has the other sign.
    pub(super) corner_offset_px: f32,
    /// The disparities are larger by this, px.
    pub(super) column_offset_px: f32,
    /// Quantization step of the lowest frequencies of 8x8 blocks, gray levels; that of the highest
    /// is four times as large.
    pub(super) codec: f32,
}

/// Combination that the sigma model is fitted with, beside no imperfection.
pub(super) const FOR_FIT: Imperfections = Imperfections {
    blur_px: 0.4,
    vignetting: 0.15,
    gain: -0.05,
    row_offset_px: -0.25,
    corner_offset_px: 0.0,
    column_offset_px: 0.0,
    codec: 4.0,
};

/// A pair as rendered.
const NONE: Imperfections = Imperfections {
    blur_px: 0.0,
    vignetting: 0.0,
    gain: 0.0,
    row_offset_px: 0.0,
    corner_offset_px: 0.0,
    column_offset_px: 0.0,
    codec: 0.0,
};

/// Combinations to test with, and their names.
pub(super) const FOR_TEST: [(&str, Imperfections); 4] = [
    (
        "eyes differ",
        Imperfections {
            blur_px: 0.6,
            vignetting: 0.25,
            gain: 0.08,
            ..NONE
        },
    ),
    (
        "row offset",
        Imperfections {
            row_offset_px: 0.4,
            corner_offset_px: 0.8,
            column_offset_px: 0.1,
            ..NONE
        },
    ),
    ("codec", Imperfections { codec: 6.0, ..NONE }),
    (
        "all at half strength",
        Imperfections {
            blur_px: 0.3,
            vignetting: 0.12,
            gain: 0.04,
            row_offset_px: 0.2,
            corner_offset_px: 0.4,
            column_offset_px: 0.05,
            codec: 3.0,
        },
    ),
];

/// Side length of the codec's blocks, px.
const BLOCK_PX: usize = 8;

impl Imperfections {
    /// The frame with these imperfections; the truth is unchanged.
    pub(super) fn apply(&self, frame: &Frame) -> Frame {
        let size = [frame.width, frame.height];
        let mut frame = frame.clone();
        let before = frame.eyes[1].clone();
        let mut right: Vec<f32> = before.iter().copied().map(f32::from).collect();
        if self.blur_px > 0.0 {
            right = blurred(&right, size, self.blur_px);
        }
        if self.vignetting > 0.0 || self.gain != 0.0 {
            self.darken(&mut right, size);
        }
        if self.column_offset_px != 0.0 {
            let columns = |_: [f32; 2]| self.column_offset_px;
            right = shifted(&right, size, [1, 0], columns);
        }
        if self.row_offset_px != 0.0 || self.corner_offset_px != 0.0 {
            let rows = |[x, y]: [f32; 2]| -self.row_offset_px - self.corner_offset_px * x * y;
            right = shifted(&right, size, [0, 1], rows);
        }
        frame.eyes[1] = right
            .iter()
            .map(|v| v.round().clamp(0.0, 255.0) as u8)
            .collect();
        if self.codec > 0.0 {
            for eye in &mut frame.eyes {
                compress(eye, size, self.codec);
            }
        }
        frame
    }

    fn darken(&self, image: &mut [f32], [width, height]: [usize; 2]) {
        let center = [width, height].map(|side| 0.5 * (side - 1) as f32);
        let corner = center[0] * center[0] + center[1] * center[1];
        for (i, value) in image.iter_mut().enumerate() {
            let (x, y) = (
                (i % width) as f32 - center[0],
                (i / width) as f32 - center[1],
            );
            let loss = self.vignetting * (x * x + y * y) / corner;
            *value *= (1.0 + self.gain) * (1.0 - loss);
        }
    }
}

/// Pixel of an image whose border is repeated.
fn at(image: &[f32], [width, height]: [usize; 2], x: i64, y: i64) -> f32 {
    let x = x.clamp(0, width as i64 - 1) as usize;
    let y = y.clamp(0, height as i64 - 1) as usize;
    image[y * width + x]
}

/// Convolution with a Gaussian, along rows and then along columns.
fn blurred(image: &[f32], size: [usize; 2], sigma: f32) -> Vec<f32> {
    let reach = (3.0 * sigma).ceil() as i64;
    let weight = |k: i64| (-0.5 * (k as f32 / sigma).powi(2)).exp();
    let whole: f32 = (-reach..=reach).map(weight).sum();
    let along = |image: &[f32], [dx, dy]: [i64; 2]| -> Vec<f32> {
        let pixel = |i: usize| {
            let (x, y) = ((i % size[0]) as i64, (i / size[0]) as i64);
            let of = |k: i64| weight(k) / whole * at(image, size, x + k * dx, y + k * dy);
            (-reach..=reach).map(of).sum::<f32>()
        };
        (0..image.len()).map(pixel).collect()
    };
    along(&along(image, [1, 0]), [0, 1])
}

/// Image whose pixels come from places farther along an axis, px; cubic interpolation (Catmull and
/// Rom). The offset is a function of the place, which is -1 to 1 along both sides.
fn shifted(
    image: &[f32],
    size: [usize; 2],
    [dx, dy]: [i64; 2],
    offset: impl Fn([f32; 2]) -> f32,
) -> Vec<f32> {
    let cubic = |t: f32| {
        [
            0.5 * (-t + 2.0 * t * t - t * t * t),
            0.5 * (2.0 - 5.0 * t * t + 3.0 * t * t * t),
            0.5 * (t + 4.0 * t * t - 3.0 * t * t * t),
            0.5 * (-t * t + t * t * t),
        ]
    };
    let pixel = |i: usize| {
        let at_pixel = [i % size[0], i / size[0]];
        let place = [0, 1].map(|k| 2.0 * at_pixel[k] as f32 / (size[k] - 1) as f32 - 1.0);
        let offset = offset(place);
        let whole = offset.floor();
        let [x, y] = at_pixel.map(|at| at as i64);
        let of = |(k, weight): (i64, &f32)| {
            let k = whole as i64 + k;
            weight * at(image, size, x + k * dx, y + k * dy)
        };
        let weights = cubic(offset - whole);
        (-1..).zip(&weights).map(of).sum::<f32>()
    };
    (0..image.len()).map(pixel).collect()
}

/// Quantizes the cosine transform of each whole block.
fn compress(image: &mut [u8], [width, height]: [usize; 2], step: f32) {
    let basis: Vec<[f32; BLOCK_PX]> = (0..BLOCK_PX)
        .map(|k| {
            let scale = if k == 0 { 0.125_f32.sqrt() } else { 0.5 };
            std::array::from_fn(|x| {
                let angle = std::f32::consts::PI * (2 * x + 1) as f32 * k as f32 / 16.0;
                scale * angle.cos()
            })
        })
        .collect();
    let transform = |block: &[[f32; BLOCK_PX]; BLOCK_PX], inverse: bool| {
        let of = |i: usize, j: usize| if inverse { basis[j][i] } else { basis[i][j] };
        let half: [[f32; BLOCK_PX]; BLOCK_PX] = std::array::from_fn(|i| {
            std::array::from_fn(|x| (0..BLOCK_PX).map(|k| of(i, k) * block[k][x]).sum())
        });
        std::array::from_fn::<[f32; BLOCK_PX], BLOCK_PX, _>(|i| {
            std::array::from_fn(|j| (0..BLOCK_PX).map(|k| of(j, k) * half[i][k]).sum())
        })
    };
    for top in (0..height - height % BLOCK_PX).step_by(BLOCK_PX) {
        for left in (0..width - width % BLOCK_PX).step_by(BLOCK_PX) {
            let place = |i: usize, j: usize| (top + i) * width + left + j;
            let block =
                std::array::from_fn(|i| std::array::from_fn(|j| f32::from(image[place(i, j)])));
            let mut found = transform(&block, false);
            for (i, row) in found.iter_mut().enumerate() {
                for (j, value) in row.iter_mut().enumerate() {
                    let step = step * (1.0 + 3.0 * (i + j) as f32 / 14.0);
                    *value = (*value / step).round() * step;
                }
            }
            for (i, row) in transform(&found, true).iter().enumerate() {
                for (j, value) in row.iter().enumerate() {
                    image[place(i, j)] = value.round().clamp(0.0, 255.0) as u8;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [64, 48];

    fn frame() -> Frame {
        let pixel = |i: usize| {
            let (x, y) = ((i % SIZE[0]) as f32, (i / SIZE[0]) as f32);
            (120.0 + 60.0 * (0.5 * x).sin() + 40.0 * (0.4 * y).cos()) as u8
        };
        let image: Vec<u8> = (0..SIZE[0] * SIZE[1]).map(pixel).collect();
        Frame {
            name: String::new(),
            width: SIZE[0],
            height: SIZE[1],
            eyes: [image.clone(), image],
            truth: vec![0.0; SIZE[0] * SIZE[1]],
            visible: vec![true; SIZE[0] * SIZE[1]],
            range: 16,
            geometry: depth::Geometry {
                focal_px: 100.0,
                center: [31.5, 23.5],
                baseline_m: 0.1,
                offset_px: 0.0,
            },
            world_from_left: cad_transforms::RigidTransform::identity(),
        }
    }

    #[test]
    fn no_strength_changes_no_byte() {
        assert_eq!(Imperfections::default().apply(&frame()).eyes, frame().eyes);
    }

    #[test]
    fn each_strength_changes_the_images_and_spares_the_left_one_but_for_the_codec() {
        let none = Imperfections::default();
        let each = [
            Imperfections {
                blur_px: 1.0,
                ..none
            },
            Imperfections {
                vignetting: 0.2,
                ..none
            },
            Imperfections { gain: 0.1, ..none },
            Imperfections {
                corner_offset_px: 0.9,
                ..none
            },
            Imperfections {
                row_offset_px: 0.5,
                ..none
            },
            Imperfections {
                column_offset_px: 0.5,
                ..none
            },
        ];
        for one in each {
            let changed = one.apply(&frame());
            assert_ne!(changed.eyes[1], frame().eyes[1], "{one:?}");
            assert_eq!(changed.eyes[0], frame().eyes[0], "{one:?}");
        }
        let codec = Imperfections { codec: 8.0, ..none }.apply(&frame());
        let differ = |eye: usize| {
            let before = &frame().eyes[eye];
            let pairs = codec.eyes[eye].iter().zip(before);
            pairs.map(|(a, b)| u32::from(a.abs_diff(*b))).max()
        };
        assert!((1..40).contains(&differ(0).unwrap()) && differ(1) == differ(0));
    }

    #[test]
    fn whole_offset_moves_pixels() {
        let offset = Imperfections {
            row_offset_px: 2.0,
            column_offset_px: 3.0,
            ..Imperfections::default()
        };
        let [left, right] = offset.apply(&frame()).eyes;
        assert_eq!(right[20 * SIZE[0] + 30], left[18 * SIZE[0] + 33]);
    }
}
