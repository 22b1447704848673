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

    /// A part of the image; `None` if it is empty or reaches beyond it.
    ///
    /// ```
    /// use imaging::ImageView;
    ///
    /// let image = ImageView::packed(3, 2, &[10, 20, 30, 40, 50, 60])?;
    /// let part = image.part([1, 0], [2, 2]).unwrap();
    /// assert_eq!((part.row(0), part.row(1)), (&[20, 30][..], &[50, 60][..]));
    /// assert!(image.part([1, 0], [3, 1]).is_none());
    /// # Ok::<(), imaging::ImageSizeError>(())
    /// ```
    pub fn part(&self, [left, top]: [usize; 2], [width, height]: [usize; 2]) -> Option<Self> {
        let fits =
            left.checked_add(width)? <= self.width && top.checked_add(height)? <= self.height;
        if !fits || width == 0 || height == 0 {
            return None;
        }
        Self::new(
            width,
            height,
            self.stride,
            &self.pixels[top * self.stride + left..],
        )
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

    /// Gray value between pixel centers, bilinear; `None` outside.
    pub fn sample(&self, [x, y]: [f64; 2]) -> Option<f64> {
        let (x, y) = (x as f32, y as f32);
        if !(x >= 0.0 && y >= 0.0) {
            return None;
        }
        let (i, j) = (x as usize, y as usize);
        if i + 1 >= self.width || j + 1 >= self.height {
            return None;
        }
        let at = j * self.stride + i;
        let below = at + self.stride;
        let p = |i: usize| f32::from(self.pixels[i]);
        let (u, v) = (x - i as f32, y - j as f32);
        let top = p(at) + u * (p(at + 1) - p(at));
        let bottom = p(below) + u * (p(below + 1) - p(below));
        Some(f64::from(top + v * (bottom - top)))
    }

    /// The image at half the size: means of 2 x 2 pixels, rounded. Pixel (x, y) of the result is at
    /// (2 x + 0.5, 2 y + 0.5) of this image.
    pub fn halved(&self) -> Vec<u8> {
        let mut half = Vec::with_capacity(self.width / 2 * (self.height / 2));
        for y in 0..self.height / 2 {
            let (a, b) = (self.row(2 * y), self.row(2 * y + 1));
            half.extend(a.chunks_exact(2).zip(b.chunks_exact(2)).map(|(a, b)| {
                let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
                ((sum + 2) / 4) as u8
            }));
        }
        half
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_has_all_its_rows() {
        let pixels = [0; 10];
        assert!(ImageView::new(4, 2, 6, &pixels).is_some());
        assert!(ImageView::new(5, 2, 6, &pixels).is_none());
        assert!(ImageView::new(7, 1, 6, &pixels).is_none());
        assert!(ImageView::new(0, 0, 0, &[]).is_none());
    }

    #[test]
    fn values_between_pixels_are_bilinear() {
        let image = ImageView::new(2, 2, 3, &[10, 20, 0, 30, 60]).unwrap();
        assert_eq!(image.sample([0.5, 0.0]), Some(15.0));
        assert_eq!(image.sample([0.5, 0.5]), Some(30.0));
        assert_eq!(image.sample([1.0, 0.0]), None);
        assert_eq!(image.sample([f64::NAN, 0.0]), None);
        assert_eq!(image.halved(), [30]);
    }
}
