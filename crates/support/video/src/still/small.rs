//! Making an image small: the mean of each square of pixels, then JPEG.

use jpeg_encoder::{ColorType, Encoder};

use super::StillError;
use crate::raw_image::i420_to_rgb;
use crate::{PixelFormat, RawImage};

/// A JPEG at most `width` pixels wide. Rows and columns that fill no whole square are left out.
pub(super) fn jpeg(image: &RawImage, width: u32, quality: u8) -> Result<Vec<u8>, StillError> {
    let failed = |e: &dyn std::fmt::Display| StillError::Image(e.to_string());
    let (pixels, channels, colour) = match image.format {
        PixelFormat::I420 => {
            let rgb = i420_to_rgb(image).map_err(|e| failed(&e))?;
            (rgb, 3, ColorType::Rgb)
        }
        _ => {
            let luma = image.luma().map_err(|e| failed(&e))?;
            (luma.to_vec(), 1, ColorType::Luma)
        }
    };
    let (columns, rows) = (image.width as usize, image.height as usize);
    let side = columns
        .div_ceil(width.max(1) as usize)
        .min(columns)
        .min(rows)
        .max(1);
    let (wide, high) = (columns / side, rows / side);
    let mut small = Vec::with_capacity(wide * high * channels);
    for (y, x) in (0..high).flat_map(|y| (0..wide).map(move |x| (y, x))) {
        for channel in 0..channels {
            let from = (y * side * columns + x * side) * channels + channel;
            let square = (0..side).flat_map(|dy| {
                let row = from + dy * columns * channels;
                (0..side).map(move |dx| row + dx * channels)
            });
            let sum: usize = square.map(|at| usize::from(pixels[at])).sum();
            small.push((sum / (side * side)) as u8);
        }
    }
    let size = |n: usize| u16::try_from(n).map_err(|e| failed(&e));
    let mut out = Vec::new();
    let encoder = Encoder::new(&mut out, quality);
    let encoded = encoder.encode(&small, size(wide)?, size(high)?, colour);
    encoded.map_err(|e| failed(&e))?;
    Ok(out)
}
