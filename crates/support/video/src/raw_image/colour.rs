//! Between colour layouts.
//!
//! The formulas are those of JFIF 1.02 (and ITU-T T.871, clause 7), full-range BT.601:
//!
//! ```text
//! Y  =  0.299 R    + 0.587 G    + 0.114 B            R = Y + 1.402 (Cr - 128)
//! Cb = -0.168736 R - 0.331264 G + 0.5 B      + 128   G = Y - 0.344136 (Cb - 128) - 0.714136 (Cr - 128)
//! Cr =  0.5 R      - 0.418688 G - 0.081312 B + 128   B = Y + 1.772 (Cb - 128)
//! ```
//!
//! in 16-bit fixed point, rounded to nearest and clamped. Chroma is the mean of each 2x2 block,
//! taken before rounding; the inverse repeats it, so the chroma site is the middle of the block,
//! as in JPEG.

use super::rows::{self, Layout, PlaneView, Window};
use super::{PixelFormat, RawImage, RawImageError};

/// Fractional bits of the coefficients.
const BITS: i32 = 16;
const HALF: i32 = 1 << (BITS - 1);

/// An RGB image (three bytes per pixel, rows packed) as I420.
///
/// # Errors
/// What [`PixelFormat::bytes`] gives for I420, and [`RawImageError::WrongLength`].
pub fn rgb_to_i420(width: u32, height: u32, rgb: &[u8]) -> Result<RawImage, RawImageError> {
    let mut data = blank(width, height)?;
    let columns = width as usize;
    let pixels = columns * height as usize;
    expect_length(rgb, 3 * pixels)?;
    let (luma, chroma) = data.split_at_mut(pixels);
    let (cb, cr) = chroma.split_at_mut(chroma.len() / 2);
    for (rgb, luma) in rgb.chunks_exact(3).zip(luma) {
        let [r, g, b] = [rgb[0], rgb[1], rgb[2]].map(i32::from);
        *luma = ((19595 * r + 38470 * g + 7471 * b + HALF) >> BITS) as u8;
    }
    let chroma_rows = cb
        .chunks_exact_mut(columns.div_ceil(2))
        .zip(cr.chunks_exact_mut(columns.div_ceil(2)));
    for (rows, (cb, cr)) in rgb.chunks(6 * columns).zip(chroma_rows) {
        let (upper, lower) = rows.split_at(3 * columns);
        // An odd last row or column counts twice.
        let lower = if lower.is_empty() { upper } else { lower };
        let blocks = upper.chunks(6).zip(lower.chunks(6));
        for ((upper, lower), (cb, cr)) in blocks.zip(cb.iter_mut().zip(cr)) {
            let next = upper.len() - 3;
            // Sums of four pixels, hence two more fractional bits.
            let [r, g, b] = [0, 1, 2].map(|channel| {
                [
                    upper[channel],
                    upper[channel + next],
                    lower[channel],
                    lower[channel + next],
                ]
                .into_iter()
                .map(i32::from)
                .sum::<i32>()
            });
            let offset = (128 << (BITS + 2)) + (HALF << 2);
            // Pure blue or red would round up to 256.
            *cb = ((-11058 * r - 21710 * g + 32768 * b + offset) >> (BITS + 2)).min(255) as u8;
            *cr = ((32768 * r - 27439 * g - 5329 * b + offset) >> (BITS + 2)).min(255) as u8;
        }
    }
    RawImage::new(width, height, PixelFormat::I420, data)
}

/// An I420 image as RGB, three bytes per pixel, `3 * width * height` long.
///
/// # Errors
/// [`RawImageError::WrongFormat`] unless the image is I420, and what [`RawImage::check`] gives.
pub fn i420_to_rgb(image: &RawImage) -> Result<Vec<u8>, RawImageError> {
    image.expect(PixelFormat::I420)?;
    let width = image.width as usize;
    let planes = image.planes()?;
    let (luma, cb, cr) = (planes[0].data, planes[1].data, planes[2].data);
    let mut rgb = vec![0; luma.len() * 3];
    for (row, (luma, rgb)) in luma
        .chunks_exact(width)
        .zip(rgb.chunks_exact_mut(3 * width))
        .enumerate()
    {
        let columns = width.div_ceil(2);
        let chroma = row / 2 * columns..(row / 2 + 1) * columns;
        let chroma = cb[chroma.clone()].iter().zip(&cr[chroma]);
        for ((luma, rgb), (&cb, &cr)) in luma.chunks(2).zip(rgb.chunks_mut(6)).zip(chroma) {
            let (cb, cr) = (i32::from(cb) - 128, i32::from(cr) - 128);
            let red = 91881 * cr + HALF;
            let green = -22553 * cb - 46802 * cr + HALF;
            let blue = 116_130 * cb + HALF;
            for (&luma, rgb) in luma.iter().zip(rgb.chunks_exact_mut(3)) {
                let luma = i32::from(luma) << BITS;
                rgb[0] = ((luma + red) >> BITS).clamp(0, 255) as u8;
                rgb[1] = ((luma + green) >> BITS).clamp(0, 255) as u8;
                rgb[2] = ((luma + blue) >> BITS).clamp(0, 255) as u8;
            }
        }
    }
    Ok(rgb)
}

/// An NV12 image (luma plane, then interleaved Cb Cr, rows packed) as I420. Loses nothing.
///
/// # Errors
/// What [`PixelFormat::bytes`] gives for I420, and [`RawImageError::WrongLength`].
pub fn nv12_to_i420(width: u32, height: u32, nv12: &[u8]) -> Result<RawImage, RawImageError> {
    let mut data = blank(width, height)?;
    expect_length(nv12, data.len())?;
    let stride = width as usize;
    let (luma, chroma) = nv12.split_at(stride * height as usize);
    let planes = [(luma, stride), (chroma, 2 * stride.div_ceil(2))];
    let planes = planes.map(|(data, stride)| PlaneView { data, stride });
    rows::write(
        Layout::Nv12(planes),
        Window::whole(&mut data, width, height),
    )?;
    RawImage::new(width, height, PixelFormat::I420, data)
}

/// A YUYV image (4:2:2, bytes Y Cb Y Cr, rows packed) as I420: luma as it is, chroma the mean of
/// two rows, halves rounded up.
///
/// # Errors
/// What [`PixelFormat::bytes`] gives for I420, [`RawImageError::OddSize`] for an odd width, and
/// [`RawImageError::WrongLength`].
pub fn yuyv_to_i420(width: u32, height: u32, yuyv: &[u8]) -> Result<RawImage, RawImageError> {
    let mut data = blank(width, height)?;
    if !width.is_multiple_of(2) {
        return Err(RawImageError::OddSize { width, height });
    }
    expect_length(yuyv, 2 * width as usize * height as usize)?;
    let plane = PlaneView {
        data: yuyv,
        stride: 2 * width as usize,
    };
    rows::write(Layout::Yuyv(plane), Window::whole(&mut data, width, height))?;
    RawImage::new(width, height, PixelFormat::I420, data)
}

/// Room for an I420 image.
fn blank(width: u32, height: u32) -> Result<Vec<u8>, RawImageError> {
    Ok(vec![0; PixelFormat::I420.bytes(width, height)?])
}

fn expect_length(bytes: &[u8], expected: usize) -> Result<(), RawImageError> {
    if bytes.len() != expected {
        return Err(RawImageError::WrongLength {
            found: bytes.len(),
            expected,
        });
    }
    Ok(())
}
