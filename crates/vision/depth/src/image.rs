//! A grey picture, lent.

use crate::error::DepthError;

/// 8 bits per pixel, rows first, without gaps.
#[derive(Clone, Copy, Debug)]
pub struct ImageView<'a> {
    width: usize,
    height: usize,
    pixels: &'a [u8],
}

impl<'a> ImageView<'a> {
    /// # Errors
    /// [`DepthError::Image`] where the number of pixels is not that of the size, or is 0.
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

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All of it.
    pub fn pixels(&self) -> &'a [u8] {
        self.pixels
    }

    /// One row.
    ///
    /// # Panics
    /// There is no such row.
    pub fn row(&self, y: usize) -> &'a [u8] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }
}
