//! Borrowed image.

use std::borrow::Cow;

use crate::error::LearnedError;

/// Image with 8 bits per channel, row-major with interleaved channels, without padding.
#[derive(Clone, Debug)]
pub struct ImageView<'a> {
    width: usize,
    height: usize,
    channels: usize,
    values: Cow<'a, [u8]>,
}

impl<'a> ImageView<'a> {
    /// Gray image: one value per pixel.
    ///
    /// # Errors
    /// [`LearnedError::Image`] if the number of values does not match the size, or is 0.
    pub fn gray(width: usize, height: usize, values: &'a [u8]) -> Result<Self, LearnedError> {
        Self::new(width, height, 1, values)
    }

    /// RGB image: three values per pixel.
    ///
    /// # Errors
    /// [`LearnedError::Image`] if the number of values does not match the size, or is 0.
    pub fn rgb(width: usize, height: usize, values: &'a [u8]) -> Result<Self, LearnedError> {
        Self::new(width, height, 3, values)
    }

    fn new(
        width: usize,
        height: usize,
        channels: usize,
        values: &'a [u8],
    ) -> Result<Self, LearnedError> {
        let expected = width
            .checked_mul(height)
            .and_then(|n| n.checked_mul(channels));
        if values.is_empty() || expected != Some(values.len()) {
            return Err(LearnedError::Image {
                found: format!("{} values", values.len()),
                expected: format!("{width} x {height} pixels of {channels}, at least one"),
            });
        }
        Ok(Self {
            width,
            height,
            channels,
            values: Cow::Borrowed(values),
        })
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The image mirrored left to right.
    pub(crate) fn mirrored(&self) -> ImageView<'static> {
        let rows = self.values.chunks_exact(self.width * self.channels);
        let pixels = rows.flat_map(|row| row.rchunks_exact(self.channels));
        ImageView {
            values: pixels.flatten().copied().collect(),
            ..*self
        }
    }

    /// Value of a pixel, 0 to 255, as one of `channels` channels: a gray image has the same value
    /// in all three, and the gray value of a color is its luma by ITU-R BT.601.
    pub(crate) fn value(&self, x: usize, y: usize, channel: usize, channels: usize) -> u8 {
        let at = (y * self.width + x) * self.channels;
        match (self.channels, channels) {
            (1, _) => self.values[at],
            (_, 1) => {
                let [r, g, b] = [0, 1, 2].map(|c| u32::from(self.values[at + c]));
                ((299 * r + 587 * g + 114 * b + 500) / 1000) as u8
            }
            _ => self.values[at + channel],
        }
    }
}

impl<'a> From<imaging::ImageView<'a>> for ImageView<'a> {
    fn from(image: imaging::ImageView<'a>) -> Self {
        Self {
            width: image.width(),
            height: image.height(),
            channels: 1,
            values: image.packed_pixels(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gray_and_rgb_are_converted_into_each_other() {
        let values = [10, 200, 30, 255, 255, 255];
        let color = ImageView::rgb(2, 1, &values).unwrap();
        assert_eq!([0, 1, 2].map(|c| color.value(0, 0, c, 3)), [10, 200, 30]);
        // 0.299 * 10 + 0.587 * 200 + 0.114 * 30 = 123.8
        assert_eq!(color.value(0, 0, 0, 1), 124);
        assert_eq!(color.value(1, 0, 0, 1), 255);
        let gray = ImageView::gray(2, 3, &values).unwrap();
        assert_eq!([0, 1, 2].map(|c| gray.value(1, 0, c, 3)), [200; 3]);
    }

    #[test]
    fn mirroring_preserves_the_order_of_channels() {
        let values = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12];
        let mirror = ImageView::rgb(2, 2, &values).unwrap().mirrored();
        assert_eq!(*mirror.values, [4, 5, 6, 1, 2, 3, 10, 11, 12, 7, 8, 9]);
    }

    #[test]
    fn invalid_image_size_is_rejected() {
        assert!(ImageView::gray(0, 0, &[]).is_err());
        assert!(ImageView::gray(usize::MAX, 2, &[1]).is_err());
        let error = ImageView::rgb(2, 1, &[1, 2]).unwrap_err();
        assert!(error.to_string().contains("2 x 1 pixels of 3"), "{error}");
    }
}
