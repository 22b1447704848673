//! Decoded images, one per side.
//!
//! Rows are packed, top row first, 8 bits per sample, full range; color is RGB by the full-range
//! BT.601 formulas of JFIF 1.02. The stereo frame is split in its middle: its left half is the left
//! image, unchanged.

use std::borrow::Cow;
use std::fmt;

use bytes::Bytes;
use video::RawImageError;
use video::raw_image::i420_to_rgb;

/// Pixel format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Color {
    /// One byte: luma as the camera delivered it.
    Grey,
    /// Three bytes: red, green, blue.
    Rgb,
}

impl Color {
    /// Bytes per pixel.
    pub fn channels(self) -> usize {
        match self {
            Self::Grey => 1,
            Self::Rgb => 3,
        }
    }
}

/// Image of one side. Cloning is cheap: the bytes are shared.
#[derive(Clone, PartialEq, Eq)]
pub struct Image {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Pixel format.
    pub color: Color,
    /// `width * height * channels` bytes, row by row.
    pub data: Bytes,
}

impl fmt::Debug for Image {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { width, height, .. } = self;
        write!(f, "Image({width}x{height} {:?})", self.color)
    }
}

impl Image {
    /// Left and right image of a stereo frame (I420, side by side).
    pub(crate) fn halves(
        both: &video::RawImage,
        color: Color,
    ) -> Result<(Self, Self), RawImageError> {
        if !both.width.is_multiple_of(2) {
            let (width, height) = (both.width, both.height);
            return Err(RawImageError::OddSize { width, height });
        }
        let pixels = match color {
            Color::Grey => Cow::Borrowed(both.luma()?),
            Color::Rgb => Cow::Owned(i420_to_rgb(both)?),
        };
        let half_row = both.width as usize / 2 * color.channels();
        let (mut left, mut right) = (Vec::new(), Vec::new());
        left.reserve_exact(pixels.len() / 2);
        right.reserve_exact(pixels.len() / 2);
        for row in pixels.chunks_exact(2 * half_row) {
            let (first, second) = row.split_at(half_row);
            left.extend_from_slice(first);
            right.extend_from_slice(second);
        }
        let image = |data: Vec<u8>| Self {
            width: both.width / 2,
            height: both.height,
            color,
            data: data.into(),
        };
        Ok((image(left), image(right)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use video::PixelFormat;

    /// 4 x 2, luma 0..8, left half blue, right half red.
    fn both() -> video::RawImage {
        let data = [
            &[10, 20, 30, 40, 50, 60, 70, 80][..],
            &[200, 60],
            &[60, 200],
        ]
        .concat();
        video::RawImage::new(4, 2, PixelFormat::I420, data).expect("4 x 2")
    }

    #[test]
    fn grey_is_the_luma_of_each_half() {
        let (left, right) = Image::halves(&both(), Color::Grey).expect("halves");
        assert_eq!((left.width, left.height), (2, 2));
        assert_eq!(left.data[..], [10, 20, 50, 60]);
        assert_eq!(right.data[..], [30, 40, 70, 80]);
    }

    #[test]
    fn colour_is_rgb_row_by_row() {
        let both = both();
        let rgb = i420_to_rgb(&both).expect("rgb");
        let (left, right) = Image::halves(&both, Color::Rgb).expect("halves");
        assert_eq!(left.data[..], [&rgb[0..6], &rgb[12..18]].concat());
        assert_eq!(right.data[..], [&rgb[6..12], &rgb[18..24]].concat());
        assert!(left.data[2] > left.data[0], "blue {:?}", left.data);
        assert!(right.data[0] > right.data[2], "red {:?}", right.data);
    }
}
