//! Gray images as cameras deliver them.

use std::borrow::Cow;

/// The pixels of an image do not match its size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("reading an image: found {found} pixels, expected {width} x {height} and at least one")]
pub struct ImageSizeError {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Number of pixels.
    pub found: usize,
}

/// Borrowed gray image: 8 bits per pixel, row-major.
#[derive(Clone, Copy, Debug)]
pub struct ImageView<'a> {
    /// Columns.
    width: usize,
    /// Rows.
    height: usize,
    /// Pixels from one row to the next.
    stride: usize,
    /// Row-major.
    pixels: &'a [u8],
}

impl<'a> ImageView<'a> {
    /// An image; `None` if it is empty or `pixels` is too short.
    pub fn new(width: usize, height: usize, stride: usize, pixels: &'a [u8]) -> Option<Self> {
        let needed = height
            .checked_sub(1)?
            .checked_mul(stride)?
            .checked_add(width)?;
        let fits = width > 0 && width <= stride && needed <= pixels.len();
        fits.then_some(Self {
            width,
            height,
            stride,
            pixels,
        })
    }

    /// An image without padding between rows.
    ///
    /// ```
    /// use imaging::ImageView;
    ///
    /// let pixels = [10, 20, 30, 40, 50, 60];
    /// let image = ImageView::packed(3, 2, &pixels)?;
    /// assert_eq!(image.row(1), [40, 50, 60]);
    ///
    /// let short = ImageView::packed(4, 2, &pixels).unwrap_err();
    /// assert_eq!(
    ///     short.to_string(),
    ///     "reading an image: found 6 pixels, expected 4 x 2 and at least one"
    /// );
    /// # Ok::<(), imaging::ImageSizeError>(())
    /// ```
    ///
    /// # Errors
    /// The number of pixels is not `width * height`, or is 0.
    pub fn packed(width: usize, height: usize, pixels: &'a [u8]) -> Result<Self, ImageSizeError> {
        if pixels.is_empty() || width.checked_mul(height) != Some(pixels.len()) {
            return Err(ImageSizeError {
                width,
                height,
                found: pixels.len(),
            });
        }
        Ok(Self {
            width,
            height,
            stride: width,
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

    /// Columns and rows.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// All pixels without padding, row-major; a copy if the rows are padded.
    pub fn packed_pixels(&self) -> Cow<'a, [u8]> {
        if self.stride == self.width {
            return Cow::Borrowed(&self.pixels[..self.width * self.height]);
        }
        (0..self.height)
            .flat_map(|y| self.row(y))
            .copied()
            .collect()
    }

    /// One row of pixels.
    ///
    /// # Panics
    /// There is no such row.
    pub fn row(&self, y: usize) -> &'a [u8] {
        &self.pixels[y * self.stride..][..self.width]
    }
}
