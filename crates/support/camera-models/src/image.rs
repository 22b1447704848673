//! Grey images as cameras deliver them.

/// A borrowed grey image.
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

    /// Columns and rows.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// One row of pixels.
    ///
    /// # Panics
    /// There is no such row.
    pub fn row(&self, y: usize) -> &'a [u8] {
        &self.pixels[y * self.stride..][..self.width]
    }
}
