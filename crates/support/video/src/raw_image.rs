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
    /// Planar 4:2:0: width·height luma, then width/2·height/2 Cb, then as much Cr.
    /// Width and height are even.
    I420,
}

impl PixelFormat {
    /// Bytes of a `width` x `height` image.
    ///
    /// # Errors
    /// [`RawImageError::Empty`], [`RawImageError::OddSize`] (I420 only),
    /// [`RawImageError::TooLarge`].
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
            PixelFormat::I420 if !width.is_multiple_of(2) || !height.is_multiple_of(2) => {
                Err(RawImageError::OddSize { width, height })
            }
            PixelFormat::I420 => Ok(luma + luma / 2),
        }
    }
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
    /// Pad or crop the image: 4:2:0 chroma needs an even size.
    #[error("{width}x{height} cannot be I420: both width and height must be even")]
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
            let (cb, cr) = self.data[luma.len()..].split_at(luma.len() / 4);
            planes.extend([cb, cr].map(|data| Plane {
                width: width / 2,
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
    for (left, right) in left.planes()?.iter().zip(right.planes()?) {
        let rows = left
            .data
            .chunks_exact(left.width)
            .zip(right.data.chunks_exact(right.width));
        for (left, right) in rows {
            data.extend_from_slice(left);
            data.extend_from_slice(right);
        }
    }
    RawImage::new(doubled, height, left.format, data)
}

/// Cuts a side-by-side image into its left and right half.
///
/// # Errors
/// [`RawImageError::OddSize`] if the halves would not be whole, or not whole in chroma (an I420
/// width must be a multiple of four); and what [`RawImage::check`] gives.
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
    for plane in both.planes()? {
        for row in plane.data.chunks_exact(plane.width) {
            let (first, second) = row.split_at(plane.width / 2);
            left.extend_from_slice(first);
            right.extend_from_slice(second);
        }
    }
    Ok((
        RawImage::new(width, height, format, left)?,
        RawImage::new(width, height, format, right)?,
    ))
}

/// Adds neutral chroma (128) to a grey image.
///
/// # Errors
/// [`RawImageError::WrongFormat`] unless the image is grey, [`RawImageError::OddSize`], and what
/// [`RawImage::check`] gives.
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
