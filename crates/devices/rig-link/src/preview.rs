//! Preview images for the phone: box-filter downsampling, then JPEG.
//!
//! Contract: the input is the encoder's (planes tightly packed, top row first, full-range BT.601 as
//! in JFIF), and is only read. The result is at least one box wide; rows and columns of incomplete
//! boxes are left out. The cost is one pass over the luma and chroma samples and the encoding of a
//! small image; `cargo run -p rig-link --example preview_cost` measures it.

use jpeg_encoder::{Encoder, ImageBuffer, JpegColorType, SamplingFactor};

/// JPEG quality, 1 to 100: sufficient to check a camera's view.
const QUALITY: u8 = 60;
/// Maximum side of an input image, pixels.
const MAX_SIDE: u32 = 1 << 15;

/// An image in memory.
#[derive(Clone, Copy, Debug)]
pub struct Planes<'a> {
    /// Columns; for side-by-side stereo those of both.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Luma, then for I420 Cb and Cr of half width and height; luma alone is gray.
    pub data: &'a [u8],
}

/// Part of a stereo image to show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Eyes {
    /// The left half.
    Left,
    /// Everything.
    Both,
}

/// A preview cannot be computed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PreviewError {
    /// The number of bytes does not match the size.
    #[error(
        "an image of {width}x{height} has {found} bytes, expected {gray} (gray) or {i420} (I420)"
    )]
    WrongLength {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes found.
        found: usize,
        /// Bytes of a gray image of this size.
        gray: usize,
        /// Bytes of an I420 image of this size.
        i420: usize,
    },
    /// The size is zero or too large.
    #[error("an image of {width}x{height} cannot be downsampled")]
    Size {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The JPEG encoder fails.
    #[error("encoding an image as JPEG: {0}")]
    Jpeg(String),
}

/// A JPEG of the image, at most `width` pixels wide (up to rounding), in color if it has chroma.
///
/// # Errors
/// See [`PreviewError`].
pub fn jpeg(image: Planes<'_>, eyes: Eyes, width: u32) -> Result<Vec<u8>, PreviewError> {
    let small = Small::of(image, eyes, width)?;
    let mut out = Vec::with_capacity(32 << 10);
    let mut encoder = Encoder::new(&mut out, QUALITY);
    encoder.set_sampling_factor(SamplingFactor::F_2_2);
    let coded = encoder.encode_image(small);
    coded.map_err(|e| PreviewError::Jpeg(e.to_string()))?;
    Ok(out)
}

/// A downsampled image: luma and, at half its size, chroma.
struct Small {
    width: usize,
    height: usize,
    luma: Vec<u8>,
    chroma: Option<[Vec<u8>; 2]>,
}

impl Small {
    fn of(image: Planes<'_>, eyes: Eyes, width: u32) -> Result<Self, PreviewError> {
        let Planes {
            width: w,
            height: h,
            data,
        } = image;
        let size = PreviewError::Size {
            width: w,
            height: h,
        };
        if w < 4 || h < 4 || w > MAX_SIDE || h > MAX_SIDE {
            return Err(size);
        }
        let (columns, rows) = (w as usize, h as usize);
        let gray = columns * rows;
        let chroma = columns.div_ceil(2) * rows.div_ceil(2);
        let is_gray = data.len() == gray;
        if !is_gray && data.len() != gray + 2 * chroma {
            return Err(PreviewError::WrongLength {
                width: w,
                height: h,
                found: data.len(),
                gray,
                i420: gray + 2 * chroma,
            });
        }
        let seen = match eyes {
            Eyes::Left => columns / 2,
            Eyes::Both => columns,
        };
        // Chroma is downsampled by the same factor, so the result is I420 again: both sides are
        // even.
        let factor = seen
            .div_ceil(width.max(2) as usize)
            .min(rows / 2)
            .min(seen / 2);
        let (small_w, small_h) = (seen / factor / 2 * 2, rows / factor / 2 * 2);
        let luma = means(&data[..gray], columns, factor, small_w, small_h);
        let chroma = (!is_gray).then(|| {
            let stride = columns.div_ceil(2);
            [0, 1].map(|i| {
                let plane = &data[gray + i * chroma..][..chroma];
                means(plane, stride, factor, small_w / 2, small_h / 2)
            })
        });
        Ok(Self {
            width: small_w,
            height: small_h,
            luma,
            chroma,
        })
    }
}

/// The rounded mean of each box of `factor` x `factor` samples. Rows are summed first, sample by
/// sample, which vectorizes well.
fn means(plane: &[u8], stride: usize, factor: usize, width: usize, height: usize) -> Vec<u8> {
    let mut out = Vec::with_capacity(width * height);
    let mut columns = vec![0_u32; width * factor];
    let area = (factor * factor) as u32;
    for rows in plane.chunks_exact(stride * factor).take(height) {
        columns.fill(0);
        for row in rows.chunks_exact(stride) {
            for (sum, sample) in columns.iter_mut().zip(row) {
                *sum += u32::from(*sample);
            }
        }
        let squares = columns.chunks_exact(factor);
        out.extend(squares.map(|square| ((square.iter().sum::<u32>() + area / 2) / area) as u8));
    }
    out
}

impl ImageBuffer for Small {
    fn get_jpeg_color_type(&self) -> JpegColorType {
        match self.chroma {
            Some(_) => JpegColorType::Ycbcr,
            None => JpegColorType::Luma,
        }
    }

    fn width(&self) -> u16 {
        self.width as u16
    }

    fn height(&self) -> u16 {
        self.height as u16
    }

    fn fill_buffers(&self, y: u16, buffers: &mut [Vec<u8>; 4]) {
        let y = usize::from(y);
        let row = |plane: &'_ [u8], width: usize, y: usize| plane[y * width..][..width].to_vec();
        buffers[0].extend(row(&self.luma, self.width, y));
        if let Some(chroma) = &self.chroma {
            for (plane, buffer) in chroma.iter().zip(&mut buffers[1..]) {
                for sample in row(plane, self.width / 2, y / 2) {
                    buffer.extend([sample, sample]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use zune_jpeg::JpegDecoder;
    use zune_jpeg::zune_core::bytestream::ZCursor;
    use zune_jpeg::zune_core::colorspace::ColorSpace;
    use zune_jpeg::zune_core::options::DecoderOptions;

    use super::*;

    /// Left half bright red, right half dark; a darker band at the bottom.
    fn stereo(width: usize, height: usize) -> Vec<u8> {
        let mut data = Vec::new();
        for y in 0..height {
            for x in 0..width {
                data.push(match (x < width / 2, y < height / 2) {
                    (true, true) => 150,
                    (true, false) => 90,
                    (false, _) => 30,
                });
            }
        }
        for value in [110, 200] {
            data.extend(std::iter::repeat_n(
                value,
                width.div_ceil(2) * height.div_ceil(2),
            ));
        }
        data
    }

    fn decode(jpeg: &[u8], color: ColorSpace) -> (usize, usize, Vec<u8>) {
        let options = DecoderOptions::default().jpeg_set_out_colorspace(color);
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(jpeg), options);
        let pixels = decoder.decode().unwrap();
        let (width, height) = decoder.dimensions().unwrap();
        (width, height, pixels)
    }

    #[test]
    fn preview_has_the_requested_eye_colors_and_size() {
        let data = stereo(1344, 376);
        let image = Planes {
            width: 1344,
            height: 376,
            data: &data,
        };
        let left = jpeg(image, Eyes::Left, 320).unwrap();
        let (width, height, pixels) = decode(&left, ColorSpace::YCbCr);
        assert_eq!((width, height), (224, 124));
        let at = |x: usize, y: usize| &pixels[(y * width + x) * 3..][..3];
        for (found, expected) in [
            (at(10, 10), [150, 110, 200]),
            (at(200, 110), [90, 110, 200]),
        ] {
            for (f, e) in found.iter().zip(expected) {
                assert!(f.abs_diff(e) <= 6, "{found:?} is not {expected:?}");
            }
        }
        let both = jpeg(image, Eyes::Both, 320).unwrap();
        assert_eq!(decode(&both, ColorSpace::YCbCr).0, 268);

        let gray = Planes {
            data: &data[..1344 * 376],
            ..image
        };
        let gray = jpeg(gray, Eyes::Left, 320).unwrap();
        let (_, _, pixels) = decode(&gray, ColorSpace::Luma);
        assert!(pixels[width * 10 + 10].abs_diff(150) <= 6);
    }

    #[test]
    fn box_mean_matches_the_reference() {
        let (stride, height, factor) = (37, 23, 5);
        let plane: Vec<u8> = (0..stride * height)
            .map(|i| (i * 7919 % 251) as u8)
            .collect();
        let (w, h) = (stride / factor, height / factor);
        let fast = means(&plane, stride, factor, w, h);
        let mut slow = Vec::new();
        for y in 0..h {
            for x in 0..w {
                let mut sum = 0.0;
                for (i, j) in (0..factor).flat_map(|i| (0..factor).map(move |j| (i, j))) {
                    sum += f64::from(plane[(y * factor + i) * stride + x * factor + j]);
                }
                slow.push((sum / (factor * factor) as f64).round() as u8);
            }
        }
        assert_eq!(fast, slow);
    }

    #[test]
    fn any_size_and_length_gives_an_image_or_an_error() {
        let data = vec![7; 64 * 64 * 2];
        for width in 0..40_u32 {
            for height in [0_u32, 1, 2, 3, 4, 5, 7, 16, 33] {
                let gray = (width * height) as usize;
                let chroma = 2 * (width.div_ceil(2) * height.div_ceil(2)) as usize;
                for length in [gray, gray + chroma] {
                    let image = Planes {
                        width,
                        height,
                        data: &data[..length],
                    };
                    for eyes in [Eyes::Left, Eyes::Both] {
                        for target in [0, 1, 8, 1000] {
                            let made = jpeg(image, eyes, target);
                            assert_eq!(made.is_ok(), width >= 4 && height >= 4, "{width}x{height}");
                        }
                    }
                }
            }
        }
        let image = Planes {
            width: 64,
            height: 32,
            data: &data[..100],
        };
        let error = jpeg(image, Eyes::Left, 100).unwrap_err().to_string();
        assert_eq!(
            error,
            "an image of 64x32 has 100 bytes, expected 2048 (gray) or 3072 (I420)"
        );
        let huge = Planes {
            width: u32::MAX,
            height: u32::MAX,
            data: &data,
        };
        assert!(matches!(
            jpeg(huge, Eyes::Left, 100),
            Err(PreviewError::Size { .. })
        ));
    }
}
