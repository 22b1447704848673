//! One PNG file as raw samples.
//!
//! Contract: returns the content of the file as 8-bit gray or 8-bit RGB and nothing else. Palettes
//! are resolved and 1, 2 and 4-bit gray is expanded to 0..=255; an alpha channel is removed without
//! blending, the colors below it unchanged, because a camera records no alpha. 16-bit images are
//! rejected: a conversion to 8 bits loses information and must be an explicit decision of the user.
//! Damage is an error (checksums are verified), and nothing larger than [`MAX_PIXELS`] is
//! allocated, whatever the header claims.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Seek};
use std::path::Path;

use png::{BitDepth, ColorType, Transformations};

use super::DatasetError;

/// Maximum size of an image, pixels: 8192 x 8192.
pub const MAX_PIXELS: u64 = 1 << 26;

/// A decoded image, rows from the top, no padding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DecodedPng {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Sample format of `data`.
    pub samples: Samples,
    /// `width * height * samples.per_pixel()` bytes.
    pub data: Vec<u8>,
}

/// Samples per pixel and their meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Samples {
    /// One byte of grey.
    Grey8,
    /// Three bytes: red, green, blue.
    Rgb8,
}

impl Samples {
    /// Bytes per pixel.
    pub fn per_pixel(self) -> usize {
        match self {
            Self::Grey8 => 1,
            Self::Rgb8 => 3,
        }
    }
}

/// Information from the header of a PNG file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PngShape {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Sample format of [`load_png`]'s result.
    pub samples: Samples,
}

/// Reads the header of a PNG file, some 30 bytes.
///
/// # Errors
/// As [`load_png`], as far as the header is concerned.
pub fn probe_png(path: &Path) -> Result<PngShape, DatasetError> {
    open(path).map(|(shape, _)| shape)
}

/// Loads a PNG file.
///
/// # Errors
/// [`DatasetError::Read`] if it cannot be opened, [`DatasetError::Image`] if it is damaged, has 16
/// bits per sample, or is too large.
pub fn load_png(path: &Path) -> Result<DecodedPng, DatasetError> {
    let (shape, decoder) = open(path)?;
    decode(path, shape, decoder)
}

/// Decodes a PNG file in memory; `name` is its name in errors.
///
/// # Errors
/// As [`load_png`].
pub fn decode_png(name: &Path, bytes: &[u8]) -> Result<DecodedPng, DatasetError> {
    let (shape, decoder) = begin(name, Cursor::new(bytes))?;
    decode(name, shape, decoder)
}

fn decode<R: BufRead + Seek>(
    path: &Path,
    shape: PngShape,
    decoder: png::Decoder<R>,
) -> Result<DecodedPng, DatasetError> {
    let PngShape {
        width,
        height,
        samples,
    } = shape;
    let damaged = |error| damaged(path, &error);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let (colour, _) = reader.output_color_type();
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| refuse(path, format!("{width}x{height} pixels"), "less"))?;
    let mut data = vec![0; size];
    reader.next_frame(&mut data).map_err(damaged)?;

    if matches!(colour, ColorType::GrayscaleAlpha | ColorType::Rgba) {
        let kept = samples.per_pixel();
        let pixels = data.len() / (kept + 1);
        for pixel in 0..pixels {
            data.copy_within(pixel * (kept + 1)..pixel * (kept + 1) + kept, pixel * kept);
        }
        data.truncate(pixels * kept);
    }
    Ok(DecodedPng {
        width,
        height,
        samples,
        data,
    })
}

/// The header, and the decoder behind it.
fn open(path: &Path) -> Result<(PngShape, png::Decoder<BufReader<File>>), DatasetError> {
    let file = plain_file::open(path).map_err(|source| DatasetError::Read {
        path: path.to_owned(),
        source,
    })?;
    begin(path, BufReader::new(file))
}

fn begin<R: BufRead + Seek>(
    path: &Path,
    file: R,
) -> Result<(PngShape, png::Decoder<R>), DatasetError> {
    let mut decoder = png::Decoder::new(file);
    decoder.ignore_checksums(false);
    decoder.set_transformations(Transformations::EXPAND);
    let header = decoder
        .read_header_info()
        .map_err(|error| damaged(path, &error))?;
    let (width, height) = header.size();
    if header.bit_depth == BitDepth::Sixteen {
        return Err(refuse(
            path,
            "16 bits per sample".to_owned(),
            "8 bits (convert the image first)",
        ));
    }
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(refuse(
            path,
            format!("{width}x{height} pixels"),
            &format!("at most {MAX_PIXELS} pixels"),
        ));
    }
    let samples = match header.color_type {
        ColorType::Grayscale | ColorType::GrayscaleAlpha => Samples::Grey8,
        // A palette contains colors and is resolved by EXPAND.
        ColorType::Rgb | ColorType::Rgba | ColorType::Indexed => Samples::Rgb8,
    };
    let shape = PngShape {
        width,
        height,
        samples,
    };
    Ok((shape, decoder))
}

fn refuse(path: &Path, found: String, expected: &str) -> DatasetError {
    DatasetError::Image {
        path: path.to_owned(),
        found,
        expected: expected.to_owned(),
    }
}

fn damaged(path: &Path, error: &png::DecodingError) -> DatasetError {
    refuse(path, error.to_string(), "a whole PNG file")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn encode(width: u32, height: u32, colour: ColorType, depth: BitDepth, data: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(colour);
        encoder.set_depth(depth);
        if colour == ColorType::Indexed {
            encoder.set_palette(vec![10, 20, 30, 40, 50, 60]);
        }
        encoder
            .write_header()
            .unwrap()
            .write_image_data(data)
            .unwrap();
        bytes
    }

    fn load(bytes: &[u8]) -> Result<DecodedPng, DatasetError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("picture.png");
        std::fs::write(&path, bytes).unwrap();
        load_png(&path)
    }

    #[test]
    fn every_kind_becomes_grey_or_rgb() {
        let check = |colour, depth, data: &[u8], samples, expected: &[u8]| {
            let found = load(&encode(2, 1, colour, depth, data)).unwrap();
            assert_eq!((found.width, found.height, found.samples), (2, 1, samples));
            assert_eq!(found.data, expected, "{colour:?} {depth:?}");
        };
        let eight = BitDepth::Eight;
        check(
            ColorType::Grayscale,
            eight,
            &[7, 200],
            Samples::Grey8,
            &[7, 200],
        );
        check(
            ColorType::GrayscaleAlpha,
            eight,
            &[7, 0, 200, 128],
            Samples::Grey8,
            &[7, 200],
        );
        check(
            ColorType::Rgb,
            eight,
            &[1, 2, 3, 4, 5, 6],
            Samples::Rgb8,
            &[1, 2, 3, 4, 5, 6],
        );
        check(
            ColorType::Rgba,
            eight,
            &[1, 2, 3, 0, 4, 5, 6, 255],
            Samples::Rgb8,
            &[1, 2, 3, 4, 5, 6],
        );
        check(
            ColorType::Indexed,
            eight,
            &[1, 0],
            Samples::Rgb8,
            &[40, 50, 60, 10, 20, 30],
        );
        check(
            ColorType::Grayscale,
            BitDepth::One,
            &[0b1000_0000],
            Samples::Grey8,
            &[255, 0],
        );
        check(
            ColorType::Grayscale,
            BitDepth::Four,
            &[0x1f],
            Samples::Grey8,
            &[17, 255],
        );
    }

    #[test]
    fn sixteen_bits_and_damage_are_rejected() {
        let sixteen = encode(1, 1, ColorType::Grayscale, BitDepth::Sixteen, &[1, 2]);
        let error = load(&sixteen).unwrap_err().to_string();
        assert!(
            error.contains("found 16 bits per sample, expected 8 bits"),
            "{error}"
        );

        let good = encode(16, 16, ColorType::Grayscale, BitDepth::Eight, &[9; 256]);
        for length in 0..good.len() - 12 {
            assert!(
                matches!(load(&good[..length]), Err(DatasetError::Image { .. })),
                "cut to {length}"
            );
        }
        // A byte of the image data: its checksum detects the change.
        let mut flipped = good.clone();
        let data = good.windows(4).position(|w| w == b"IDAT").unwrap() + 8;
        flipped[data] ^= 1;
        assert!(matches!(load(&flipped), Err(DatasetError::Image { .. })));
        assert!(matches!(
            load(b"not a png"),
            Err(DatasetError::Image { .. })
        ));
    }

    #[test]
    fn header_alone_allocates_nothing() {
        let mut bytes = encode(1, 1, ColorType::Grayscale, BitDepth::Eight, &[1]);
        bytes[16..24].copy_from_slice(&[0x00, 0x10, 0, 0, 0x00, 0x10, 0, 0]); // 1048576 x 1048576
        let crc = crc32fast::hash(&bytes[12..29]);
        bytes[29..33].copy_from_slice(&crc.to_be_bytes());
        let error = load(&bytes).unwrap_err().to_string();
        assert!(
            error.contains("found 1048576x1048576 pixels, expected at most"),
            "{error}"
        );
    }
}
