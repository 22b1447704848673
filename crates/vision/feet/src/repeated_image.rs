//! Images of a camera that repeat the one before, whole or in part.
//!
//! Contract: noise differs from image to image, so rows with the same gray levels as in the image
//! before are that image's: the camera delivered it again (frozen), or the rest of it (torn). Rows
//! of one level, which a covered or dark camera delivers, say nothing.

use imaging::ImageView;

use crate::config::RepeatedConfig;

/// The last image of a camera.
#[derive(Clone, Debug, Default)]
pub(crate) struct LastImage {
    width: usize,
    pixels: Vec<u8>,
}

impl LastImage {
    /// Whether too many rows of the next image are those of the last one.
    pub(crate) fn is_repeated(&mut self, image: &ImageView<'_>, config: &RepeatedConfig) -> bool {
        let (width, height) = (image.width(), image.height());
        let has_last = self.width == width && self.pixels.len() == width * height;
        let mut repeated = 0;
        let mut pixels = Vec::with_capacity(width * height);
        for row in 0..height {
            let own = image.row(row);
            let says_something = own.windows(2).any(|pair| pair[0] != pair[1]);
            let last = self.pixels.get(row * width..(row + 1) * width);
            repeated += usize::from(has_last && says_something && last == Some(own));
            pixels.extend_from_slice(own);
        }
        (self.width, self.pixels) = (width, pixels);
        repeated as f64 > config.max_share * height as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_noise::Noise;

    const SIZE: [usize; 2] = [40, 30];

    fn image(noise: &mut Noise) -> Vec<u8> {
        let level = |_| (128.0 + 10.0 * noise.next()) as u8;
        (0..SIZE[0] * SIZE[1]).map(level).collect()
    }

    fn repeated(images: &[Vec<u8>]) -> Vec<bool> {
        let mut last = LastImage::default();
        let config = RepeatedConfig::default();
        let each = |own: &Vec<u8>| {
            let view = ImageView::packed(SIZE[0], SIZE[1], own).expect("whole");
            last.is_repeated(&view, &config)
        };
        images.iter().map(each).collect()
    }

    #[test]
    fn frozen_and_torn_images_are_found() {
        let mut noise = Noise::new(1);
        let [a, b] = [0, 1].map(|_| image(&mut noise));
        // The lower third is still that of the first image.
        let at = 20 * SIZE[0];
        let torn = [&b[..at], &a[at..]].concat();
        assert_eq!(
            repeated(&[a.clone(), a.clone(), b.clone()]),
            [false, true, false]
        );
        assert_eq!(repeated(&[a, torn]), [false, true]);
    }

    #[test]
    fn black_images_do_not_repeat() {
        let black = vec![0; SIZE[0] * SIZE[1]];
        assert_eq!(repeated(&[black.clone(), black]), [false, false]);
    }
}
