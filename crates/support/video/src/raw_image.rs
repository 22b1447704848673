//! Uncompressed images: one kind of memory layout, and the few operations between a camera and
//! an encoder.
//!
//! Contract: planes are tightly packed (no row padding), top row first, 8 bits per sample. Every
//! function checks what it is given and answers with a [`RawImageError`]; none panics, and none
//! changes its input. Values are full range (0..=255) and mean what they mean in a JPEG file
//! (JFIF 1.02: full-range BT.601); nothing here rescales them.

use std::fmt;

use bytes::Bytes;
use thiserror::Error;

mod colour;
mod psnr;
pub(crate) mod rows;

pub use colour::{i420_to_rgb, nv12_to_i420, rgb_to_i420, yuyv_to_i420};
pub use psnr::{psnr, psnr_all};

/// How the bytes of a [`RawImage`] are to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// One byte per pixel: luma.
    Grey8,
    /// Planar 4:2:0: width·height luma, then Cb of half the columns and half the rows, then as
    /// much Cr. Halves of odd sizes are rounded up: the last chroma sample is of one pixel or two.
    I420,
}

impl PixelFormat {
    /// Bytes of a `width` x `height` image.
    ///
    /// # Errors
    /// [`RawImageError::Empty`], [`RawImageError::TooLarge`].
    pub fn bytes(self, width: u32, height: u32) -> Result<usize, RawImageError> {
        if width == 0 || height == 0 {
            return Err(RawImageError::Empty { width, height });
        }
        let luma = (width as usize)
            .checked_mul(height as usize)
            .filter(|&pixels| pixels <= isize::MAX as usize / 4)
            .ok_or(RawImageError::TooLarge { width, height })?;
        match self {
            PixelFormat::Grey8 => Ok(luma),
            PixelFormat::I420 => {
                let [columns, rows] = chroma_size(width, height);
                Ok(luma + 2 * columns * rows)
            }
        }
    }
}

/// Columns and rows of each chroma plane of an I420 image.
pub(crate) fn chroma_size(width: u32, height: u32) -> [usize; 2] {
    [width, height].map(|n| n.div_ceil(2) as usize)
}

/// Columns and rows of an image in compressed form.
///
/// H.264 and H.265 with 4:2:0 chroma code even sizes, and their cropping and conformance windows
/// count in steps of two luma samples: an odd last row or column is repeated once by
/// [`crate::Encoder`] and removed by [`without_padding`].
///
/// ```
/// use video::raw_image::coded_size;
///
/// assert_eq!(coded_size(2482, 375), (2482, 376));
/// ```
pub fn coded_size(width: u32, height: u32) -> (u32, u32) {
    (width.next_multiple_of(2), height.next_multiple_of(2))
}

/// The `width` x `height` image that was encoded, from the decoded one. Shares the bytes if there
/// is no padding. `None` if the decoded image does not have the [`coded_size`] of that size.
pub fn without_padding(decoded: &RawImage, width: u32, height: u32) -> Option<RawImage> {
    if (decoded.width, decoded.height) == (width, height) {
        return Some(decoded.clone());
    }
    if (decoded.width, decoded.height) != coded_size(width, height) {
        return None;
    }
    let planes = decoded.planes().ok()?;
    let mut data = Vec::with_capacity(decoded.format.bytes(width, height).ok()?);
    // Chroma has no padding: its size is that of the coded one.
    let sizes = [[width, height].map(|n| n as usize)]
        .into_iter()
        .chain([chroma_size(width, height); 2]);
    for (plane, [columns, rows]) in planes.iter().zip(sizes) {
        for row in plane.data.chunks_exact(plane.width).take(rows) {
            data.extend_from_slice(&row[..columns]);
        }
    }
    RawImage::new(width, height, decoded.format, data).ok()
}

/// One uncompressed image. Cloning is cheap: the bytes are shared.
#[derive(Clone, PartialEq, Eq)]
pub struct RawImage {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Layout of `data`.
    pub format: PixelFormat,
    /// The planes, tightly packed, exactly [`PixelFormat::bytes`] long.
    pub data: Bytes,
}

impl fmt::Debug for RawImage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Image({}x{} {:?})", self.width, self.height, self.format)
    }
}

/// Why an image could not be used. The caller passed something that cannot work; trying again
/// with the same image will not help.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum RawImageError {
    /// Crop the image: two eyes side by side, and two pixels that share their chroma, need an even
    /// width.
    #[error("{width}x{height} cannot be divided: its width must be even")]
    OddSize {
        /// Columns found.
        width: u32,
        /// Rows found.
        height: u32,
    },
    /// An image has at least one pixel.
    #[error("{width}x{height} image has no pixels")]
    Empty {
        /// Columns found.
        width: u32,
        /// Rows found.
        height: u32,
    },
    /// The size does not fit in memory.
    #[error("{width}x{height} image is too large to hold in memory")]
    TooLarge {
        /// Columns found.
        width: u32,
        /// Rows found.
        height: u32,
    },
    /// The bytes do not belong to the size and format that go with them.
    #[error("image data is {found} bytes long, expected {expected}")]
    WrongLength {
        /// Bytes found.
        found: usize,
        /// Bytes that size and format ask for.
        expected: usize,
    },
    /// Convert first.
    #[error("image is {found:?}, expected {expected:?}")]
    WrongFormat {
        /// The image's format.
        found: PixelFormat,
        /// The requested format.
        expected: PixelFormat,
    },
    /// Left and right come from one stereo camera: same size, same format.
    #[error("left is {left:?} and right is {right:?}, expected the same size and format")]
    Unequal {
        /// Width, height and format of the left image.
        left: (u32, u32, PixelFormat),
        /// Width, height and format of the right image.
        right: (u32, u32, PixelFormat),
    },
}

/// One plane: its rows follow one another without padding.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plane<'a> {
    pub(crate) width: usize,
    pub(crate) data: &'a [u8],
}

impl RawImage {
    /// An image whose length has been checked.
    ///
    /// # Errors
    /// What [`PixelFormat::bytes`] gives, and [`RawImageError::WrongLength`].
    pub fn new(
        width: u32,
        height: u32,
        format: PixelFormat,
        data: impl Into<Bytes>,
    ) -> Result<RawImage, RawImageError> {
        let image = RawImage {
            width,
            height,
            format,
            data: data.into(),
        };
        image.check()?;
        Ok(image)
    }

    /// Whether size, format and length of the data belong together.
    ///
    /// # Errors
    /// As [`RawImage::new`].
    pub fn check(&self) -> Result<(), RawImageError> {
        let expected = self.format.bytes(self.width, self.height)?;
        if self.data.len() != expected {
            return Err(RawImageError::WrongLength {
                found: self.data.len(),
                expected,
            });
        }
        Ok(())
    }

    /// The luma plane, `width * height` bytes.
    ///
    /// # Errors
    /// As [`RawImage::new`].
    pub fn luma(&self) -> Result<&[u8], RawImageError> {
        self.check()?;
        Ok(&self.data[..self.width as usize * self.height as usize])
    }

    /// All planes in order: one for grey, three for I420.
    pub(crate) fn planes(&self) -> Result<Vec<Plane<'_>>, RawImageError> {
        let luma = self.luma()?;
        let width = self.width as usize;
        let mut planes = vec![Plane { width, data: luma }];
        if self.format == PixelFormat::I420 {
            let [columns, rows] = chroma_size(self.width, self.height);
            let (cb, cr) = self.data[luma.len()..].split_at(columns * rows);
            planes.extend([cb, cr].map(|data| Plane {
                width: columns,
                data,
            }));
        }
        Ok(planes)
    }

    fn expect(&self, expected: PixelFormat) -> Result<(), RawImageError> {
        if self.format != expected {
            return Err(RawImageError::WrongFormat {
                found: self.format,
                expected,
            });
        }
        self.check()
    }
}

/// Puts two images of the same size and format beside each other, left one left.
///
/// The width of the result is even. If that of an image is odd, chroma of the right one lies
/// between the samples of the result and is interpolated (mean of the two pixels of a sample); luma
/// is never changed.
///
/// # Errors
/// [`RawImageError::Unequal`], and what [`RawImage::check`] gives.
pub fn side_by_side(left: &RawImage, right: &RawImage) -> Result<RawImage, RawImageError> {
    let shape = |image: &RawImage| (image.width, image.height, image.format);
    if shape(left) != shape(right) {
        return Err(RawImageError::Unequal {
            left: shape(left),
            right: shape(right),
        });
    }
    let (width, height) = (left.width, left.height);
    let doubled = width
        .checked_mul(2)
        .ok_or(RawImageError::TooLarge { width, height })?;
    let mut data = Vec::with_capacity(left.format.bytes(doubled, height)?);
    let planes = left.planes()?.into_iter().zip(right.planes()?);
    for (number, (left, right)) in planes.enumerate() {
        let rows = left
            .data
            .chunks_exact(left.width)
            .zip(right.data.chunks_exact(right.width));
        let is_between = number > 0 && !width.is_multiple_of(2);
        for (left, right) in rows {
            if is_between {
                let columns = width as usize;
                let pixel = |x: usize| match x.checked_sub(columns) {
                    None => left[x / 2],
                    Some(x) => right[x / 2],
                };
                data.extend((0..columns).map(|k| mean(pixel(2 * k), pixel(2 * k + 1))));
            } else {
                data.extend_from_slice(left);
                data.extend_from_slice(right);
            }
        }
    }
    RawImage::new(doubled, height, left.format, data)
}

/// Cuts a side-by-side image into its left and right half. Chroma of the right half is interpolated
/// if the width of a half is odd, as in [`side_by_side`].
///
/// # Errors
/// [`RawImageError::OddSize`] if the halves would not be whole; and what [`RawImage::check`] gives.
pub fn split(both: &RawImage) -> Result<(RawImage, RawImage), RawImageError> {
    let (width, height, format) = (both.width / 2, both.height, both.format);
    if !both.width.is_multiple_of(2) {
        return Err(RawImageError::OddSize {
            width: both.width,
            height,
        });
    }
    let length = format.bytes(width, height)?;
    let (mut left, mut right) = (Vec::with_capacity(length), Vec::with_capacity(length));
    for (number, plane) in both.planes()?.into_iter().enumerate() {
        let is_between = number > 0 && !width.is_multiple_of(2);
        for row in plane.data.chunks_exact(plane.width) {
            let (first, second) = row.split_at(plane.width / 2);
            if is_between {
                // The sample in the middle is of the last left and the first right pixel.
                left.extend_from_slice(&row[..plane.width / 2 + 1]);
                let next = second[1..].iter().chain(second.last());
                right.extend(second.iter().zip(next).map(|(a, b)| mean(*a, *b)));
            } else {
                left.extend_from_slice(first);
                right.extend_from_slice(second);
            }
        }
    }
    Ok((
        RawImage::new(width, height, format, left)?,
        RawImage::new(width, height, format, right)?,
    ))
}

/// Mean of two samples, halves rounded up.
fn mean(a: u8, b: u8) -> u8 {
    (u16::from(a) + u16::from(b)).div_ceil(2) as u8
}

/// Adds neutral chroma (128) to a grey image.
///
/// # Errors
/// [`RawImageError::WrongFormat`] unless the image is grey, and what [`RawImage::check`] gives.
pub fn grey_to_i420(grey: &RawImage) -> Result<RawImage, RawImageError> {
    grey.expect(PixelFormat::Grey8)?;
    let length = PixelFormat::I420.bytes(grey.width, grey.height)?;
    let mut data = Vec::with_capacity(length);
    data.extend_from_slice(&grey.data);
    data.resize(length, 128);
    RawImage::new(grey.width, grey.height, PixelFormat::I420, data)
}

/// The luma plane of an I420 image as a grey image. Shares the bytes, copies nothing.
///
/// # Errors
/// [`RawImageError::WrongFormat`] unless the image is I420, and what [`RawImage::check`] gives.
pub fn i420_to_grey(image: &RawImage) -> Result<RawImage, RawImageError> {
    image.expect(PixelFormat::I420)?;
    let luma = image.width as usize * image.height as usize;
    RawImage::new(
        image.width,
        image.height,
        PixelFormat::Grey8,
        image.data.slice(..luma),
    )
}

#[cfg(test)]
mod tests;
