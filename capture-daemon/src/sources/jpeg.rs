//! JPEG images to I420: those of cameras that deliver Motion-JPEG, and those in bags.
//!
//! Contract: values are those of the file, full range BT.601 as in every [`RawImage`]; chroma is
//! the mean of each 2x2 block, of which an odd last column or row has half; a gray file has neutral
//! chroma. *Damage*: a truncated or malformed file is an error, never
//! half an image. *Size*: the size in the header is compared with [`MAX_PIXELS`] before anything is
//! allocated. Cameras may omit the Huffman tables, as Motion-JPEG allows: then those of the
//! standard are used (ITU-T T.81, annex K.3).

use std::io::Cursor;

use video::{PixelFormat, RawImage, RawImageError};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::datasets::MAX_PIXELS;

/// Error of decoding a JPEG image.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum JpegError {
    /// The bytes are not a whole JPEG file.
    #[error("the JPEG image is damaged: {0}")]
    Damaged(String),
    /// The header has a size above the maximum.
    #[error("the JPEG image is {width}x{height}, expected at most {MAX_PIXELS} pixels")]
    TooLarge {
        /// Columns found.
        width: u32,
        /// Rows found.
        height: u32,
    },
    /// The decoded size is invalid.
    #[error(transparent)]
    Image(#[from] RawImageError),
}

/// A decoded image.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DecodedImage {
    /// Whether the file has chroma.
    pub(super) colour: bool,
    /// As I420.
    pub(super) image: RawImage,
}

/// Decodes one image. Bytes behind its end are ignored, because cameras pad their buffers.
///
/// # Errors
/// See [`JpegError`].
pub(super) fn decode(bytes: &[u8]) -> Result<DecodedImage, JpegError> {
    let damaged = |error: &dyn std::fmt::Display| JpegError::Damaged(error.to_string());
    let patched = with_tables(bytes);
    let bytes = patched.as_deref().unwrap_or(bytes);
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .jpeg_set_out_colorspace(ColorSpace::YCbCr);
    let mut decoder = JpegDecoder::new_with_options(Cursor::new(bytes), options);
    decoder.decode_headers().map_err(|e| damaged(&e))?;
    let info = decoder.info().ok_or_else(|| damaged(&"it has no size"))?;
    let (width, height) = (u32::from(info.width), u32::from(info.height));
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(JpegError::TooLarge { width, height });
    }
    let colour = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => false,
        Some(ColorSpace::YCbCr) => true,
        other => {
            let found = other.map_or("unknown".to_owned(), |space| format!("{space:?}"));
            return Err(JpegError::Damaged(format!(
                "its colours are {found}, expected YCbCr or grey"
            )));
        }
    };
    if !colour {
        decoder.set_options(options.jpeg_set_out_colorspace(ColorSpace::Luma));
    }
    let pixels = decoder.decode().map_err(|e| damaged(&e))?;
    let samples = if colour { 3 } else { 1 };
    let expected = width as usize * height as usize * samples;
    if pixels.len() != expected {
        let found = pixels.len();
        return Err(RawImageError::WrongLength { found, expected }.into());
    }
    let image = i420(width as usize, height as usize, samples, &pixels)?;
    Ok(DecodedImage { colour, image })
}

/// Interleaved Y Cb Cr, or Y alone, as I420.
fn i420(
    width: usize,
    height: usize,
    samples: usize,
    pixels: &[u8],
) -> Result<RawImage, RawImageError> {
    let length = PixelFormat::I420.bytes(width as u32, height as u32)?;
    let mut data = vec![128; length];
    let (luma, chroma) = data.split_at_mut(width * height);
    let at = |x: usize, y: usize| samples * (y.min(height - 1) * width + x.min(width - 1));
    for (value, pixel) in luma.iter_mut().zip(pixels.chunks_exact(samples)) {
        *value = pixel[0];
    }
    if samples == 3 {
        let columns = width.div_ceil(2);
        let (cb, cr) = chroma.split_at_mut(chroma.len() / 2);
        for (y, (cb, cr)) in (cb.chunks_exact_mut(columns))
            .zip(cr.chunks_exact_mut(columns))
            .enumerate()
        {
            for x in 0..columns {
                let block = [(0, 0), (1, 0), (0, 1), (1, 1)];
                let block = block.map(|(dx, dy)| at(2 * x + dx, 2 * y + dy));
                let mean = |k: usize| {
                    let sum: u32 = block.iter().map(|place| u32::from(pixels[place + k])).sum();
                    ((sum + 2) / 4) as u8
                };
                (cb[x], cr[x]) = (mean(1), mean(2));
            }
        }
    }
    RawImage::new(width as u32, height as u32, PixelFormat::I420, data)
}

/// The file marked as Motion-JPEG if it has no Huffman table before its first scan: for such files
/// the decoder uses the standard's.
fn with_tables(bytes: &[u8]) -> Option<Vec<u8>> {
    const SOI: usize = 2;
    let mut at = SOI;
    loop {
        let [0xff, marker, high, low] = *bytes.get(at..at + 4)? else {
            return None;
        };
        match marker {
            // DHT: it has its own tables.
            0xc4 => return None,
            // SOS: here the data begins.
            0xda => break,
            _ => at += 2 + usize::from(u16::from_be_bytes([high, low])).max(2),
        }
    }
    let mut patched = Vec::with_capacity(bytes.len() + 18);
    patched.extend_from_slice(&bytes[..SOI]);
    patched.extend_from_slice(&[0xff, 0xe0, 0, 16]);
    patched.extend_from_slice(b"AVI1\0\0\0\0\0\0\0\0\0\0");
    patched.extend_from_slice(&bytes[SOI..]);
    Some(patched)
}

#[cfg(test)]
mod tests {
    use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

    use super::*;

    /// A soft gradient in every channel, so that the encoding loss is small.
    fn ycbcr(width: usize, height: usize) -> Vec<u8> {
        let pixel = |i: usize| {
            let (x, y) = (i % width, i / width);
            [40 + 2 * x, 90 + x + y, 160 - y].map(|value| value.min(255) as u8)
        };
        (0..width * height).flat_map(pixel).collect()
    }

    fn encode(width: u16, height: u16, colour: ColorType, sampling: SamplingFactor) -> Vec<u8> {
        let samples = ycbcr(width.into(), height.into());
        let samples: Vec<u8> = match colour {
            ColorType::Luma => samples.iter().step_by(3).copied().collect(),
            _ => samples,
        };
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes, 95);
        encoder.set_sampling_factor(sampling);
        encoder
            .encode(&samples, width, height, colour)
            .expect("encoding");
        bytes
    }

    fn without_tables(bytes: &[u8]) -> Vec<u8> {
        let mut kept = bytes[..2].to_vec();
        let mut at = 2;
        while bytes[at + 1] != 0xda {
            let end = at + 2 + usize::from(u16::from_be_bytes([bytes[at + 2], bytes[at + 3]]));
            if bytes[at + 1] != 0xc4 {
                kept.extend_from_slice(&bytes[at..end]);
            }
            at = end;
        }
        kept.extend_from_slice(&bytes[at..]);
        kept
    }

    /// Luma and chroma in the middle of each block, within the loss of encoding at quality 95.
    fn looks_like(image: &RawImage, width: usize, height: usize, colour: bool) {
        let truth = ycbcr(width, height);
        let (luma, chroma) = image.data.split_at(width * height);
        let (cb, cr) = chroma.split_at(chroma.len() / 2);
        for y in (0..height).step_by(3) {
            for x in (0..width).step_by(3) {
                let pixel = &truth[3 * (y * width + x)..][..3];
                let found = luma[y * width + x];
                assert!(found.abs_diff(pixel[0]) <= 4, "{x} {y}");
                for (k, plane) in [(1, cb), (2, cr)] {
                    let found = plane[y / 2 * width.div_ceil(2) + x / 2];
                    let expected = if colour { pixel[k] } else { 128 };
                    assert!(
                        found.abs_diff(expected) <= 5,
                        "{k} {x} {y}: {found} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn every_chroma_subsampling_decodes_to_the_image() {
        for sampling in [
            SamplingFactor::F_1_1,
            SamplingFactor::F_2_1,
            SamplingFactor::F_2_2,
        ] {
            let decoded = decode(&encode(64, 48, ColorType::Ycbcr, sampling)).expect("an image");
            assert!(decoded.colour);
            looks_like(&decoded.image, 64, 48, true);
        }
        let grey = encode(64, 48, ColorType::Luma, SamplingFactor::F_1_1);
        let decoded = decode(&grey).expect("an image");
        assert!(!decoded.colour);
        looks_like(&decoded.image, 64, 48, false);
    }

    #[test]
    fn odd_size_is_kept() {
        let file = encode(33, 17, ColorType::Ycbcr, SamplingFactor::F_2_1);
        let decoded = decode(&file).expect("an image");
        assert_eq!((decoded.image.width, decoded.image.height), (33, 17));
        looks_like(&decoded.image, 33, 17, true);
    }

    #[test]
    fn huffman_tables_may_be_absent() {
        let file = encode(64, 48, ColorType::Ycbcr, SamplingFactor::F_2_1);
        let bare = without_tables(&file);
        assert!(bare.len() + 400 < file.len(), "nothing was taken out");
        assert_eq!(decode(&bare), decode(&file));
    }

    #[test]
    fn truncated_file_is_an_error_and_padding_is_not() {
        let file = encode(64, 48, ColorType::Ycbcr, SamplingFactor::F_2_1);
        for length in (0..file.len() - 12).step_by(7) {
            let found = decode(&file[..length]);
            assert!(
                matches!(found, Err(JpegError::Damaged(_))),
                "{length}: {found:?}"
            );
        }
        let mut padded = file.clone();
        padded.resize(file.len() + 1000, 0);
        assert_eq!(decode(&padded), decode(&file));
    }

    #[test]
    fn header_alone_allocates_nothing() {
        let mut file = encode(16, 16, ColorType::Luma, SamplingFactor::F_1_1);
        let sof = file
            .windows(2)
            .position(|w| w == [0xff, 0xc0])
            .expect("a frame header");
        file[sof + 5..sof + 9].copy_from_slice(&[0xff, 0xff, 0xff, 0xff]);
        assert!(decode(&file).is_err());
    }

    proptest::proptest! {
        #[test]
        fn never_panics_on_damaged_files(at in 0_usize..2000, value: u8, cut in 0_usize..2000) {
            let mut file = encode(32, 16, ColorType::Ycbcr, SamplingFactor::F_2_2);
            let at = at % file.len();
            file[at] = value;
            file.truncate(file.len() - cut % 8);
            let _ = decode(&file);
        }
    }
}
