//! Borrowed gray image.

use crate::error::DepthError;

/// Gray image: 8 bits per pixel, row-major, without padding.
///
/// ```
/// use depth::ImageView;
///
/// let pixels = [10, 20, 30, 40, 50, 60];
/// let image = ImageView::new(3, 2, &pixels)?;
/// assert_eq!(image.row(1), [40, 50, 60]);
///
/// let short = ImageView::new(4, 2, &pixels).unwrap_err();
/// assert_eq!(
///     short.to_string(),
///     "reading an image: found 6 pixels, expected 4 x 2 and at least one"
/// );
/// # Ok::<(), depth::DepthError>(())
/// ```
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
