//! Borrowed gray image.

use crate::error::DepthError;

/// Gray image: 8 bits per pixel, row-major, without padding.
#[derive(Clone, Copy, Debug)]
pub struct ImageView<'a> {
    width: usize,
    height: usize,
    pixels: &'a [u8],
}

impl<'a> ImageView<'a> {
    /// # Errors
    /// [`DepthError::Image`] if the number of pixels is not `width * height`, or is 0.
    pub fn new(width: usize, height: usize, pixels: &'a [u8]) -> Result<Self, DepthError> {
        if pixels.is_empty() || width.checked_mul(height) != Some(pixels.len()) {
            return Err(DepthError::Image {
                width,
                height,
                found: pixels.len(),
            });
        }
        Ok(Self {
            width,
            height,
            pixels,
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

    /// All pixels, row-major.
    pub fn pixels(&self) -> &'a [u8] {
        self.pixels
    }

    /// One row.
    ///
    /// # Panics
    /// If `y` is not below [`ImageView::height`].
    pub fn row(&self, y: usize) -> &'a [u8] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }
}
