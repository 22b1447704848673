//! Changes of rendered pairs that the sigma model is fitted with, beside pairs as rendered.
//!
//! Contract: an implementation apart from that of the simulator, which tests use: images are
//! changed after tone curve and noise, so that blur also smooths the noise of the right eye. A
//! strength of 0 changes no byte.

use rig_sim::camera::codec;

use super::frames::Frame;

/// Changes of a rendered pair; see [`Changes::apply`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Changes {
    /// Standard deviation of the additional blur of the right eye, px.
    pub(super) blur_px: f32,
    /// Additional loss of light in the corners of the right eye, 0 to 1; with the square of the
    /// distance from the image center.
    pub(super) vignetting: f32,
    /// Gain of the right eye relative to the left one, minus 1.
    pub(super) gain: f32,
    /// The right image is lower than rectified by this, px.
    pub(super) row_offset_px: f32,
    /// See [`codec::quantize`], of both eyes.
    pub(super) codec_step: f32,
}

/// Combination that the sigma model is fitted with, beside no change.
pub(super) const FOR_FIT: Changes = Changes {
    blur_px: 0.4,
    vignetting: 0.15,
    gain: -0.05,
    row_offset_px: -0.25,
    codec_step: 4.0,
};

impl Changes {
    /// The frame with these changes, in order of the light; the truth is unchanged.
    pub(super) fn apply(&self, frame: &Frame) -> Frame {
        let size = [frame.width, frame.height];
        let mut frame = frame.clone();
        let mut right: Vec<f32> = frame.eyes[1].iter().copied().map(f32::from).collect();
        if self.blur_px > 0.0 {
            right = blurred(&right, size, self.blur_px);
        }
        self.darken(&mut right, size);
        if self.row_offset_px != 0.0 {
            right = lowered(&right, size, self.row_offset_px);
        }
        frame.eyes[1] = right
            .iter()
            .map(|v| v.round().clamp(0.0, 255.0) as u8)
            .collect();
        for eye in &mut frame.eyes {
            codec::quantize(eye, size[0], size, self.codec_step);
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

/// Image moved down by an offset, px; cubic interpolation (Catmull and Rom).
fn lowered(image: &[f32], size: [usize; 2], offset_px: f32) -> Vec<f32> {
    let whole = (-offset_px).floor();
    let t = -offset_px - whole;
    let weights = [
        0.5 * (-t + 2.0 * t * t - t * t * t),
        0.5 * (2.0 - 5.0 * t * t + 3.0 * t * t * t),
        0.5 * (t + 4.0 * t * t - 3.0 * t * t * t),
        0.5 * (-t * t + t * t * t),
    ];
    let pixel = |i: usize| {
        let (x, y) = ((i % size[0]) as i64, (i / size[0]) as i64 + whole as i64);
        let of = |(k, weight): (i64, &f32)| weight * at(image, size, x, y + k);
        (-1..).zip(&weights).map(of).sum::<f32>()
    };
    (0..image.len()).map(pixel).collect()
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
        assert_eq!(Changes::default().apply(&frame()).eyes, frame().eyes);
    }

    #[test]
    fn each_strength_changes_the_images_and_spares_the_left_one_but_for_the_codec() {
        let none = Changes::default();
        let each = [
            Changes {
                blur_px: 1.0,
                ..none
            },
            Changes {
                vignetting: 0.2,
                ..none
            },
            Changes { gain: 0.1, ..none },
            Changes {
                row_offset_px: 0.5,
                ..none
            },
        ];
        for one in each {
            let changed = one.apply(&frame());
            assert_ne!(changed.eyes[1], frame().eyes[1], "{one:?}");
            assert_eq!(changed.eyes[0], frame().eyes[0], "{one:?}");
        }
        let codec = Changes {
            codec_step: 8.0,
            ..none
        };
        let [left, right] = codec.apply(&frame()).eyes;
        assert!(left == right && left != frame().eyes[0]);
    }

    #[test]
    fn whole_offset_moves_rows() {
        let lower = Changes {
            row_offset_px: 2.0,
            ..Changes::default()
        };
        let [left, right] = lower.apply(&frame()).eyes;
        assert_eq!(right[20 * SIZE[0] + 30], left[18 * SIZE[0] + 30]);
    }
}
