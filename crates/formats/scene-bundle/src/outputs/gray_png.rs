//! Gray images as PNG, in memory.

use std::io::Cursor;
use std::path::Path;

use crate::error::BundleError;

/// Maximum number of pixels that are decoded: a file of a few bytes may claim any number.
const MAX_PIXELS: u64 = 1 << 26;

/// Sample values of a gray image, row by row from the top.
pub(crate) enum GraySamples {
    Bits8(Vec<u8>),
    Bits16(Vec<u16>),
}

/// Encodes an image of 8 bits; one sample per pixel.
pub(crate) fn encode8(width: u32, height: u32, samples: &[u8]) -> Vec<u8> {
    encode(width, height, png::BitDepth::Eight, samples)
}

/// Encodes an image of 16 bits; one sample per pixel.
pub(crate) fn encode16(width: u32, height: u32, samples: &[u16]) -> Vec<u8> {
    // PNG is big-endian.
    let bytes: Vec<u8> = samples.iter().flat_map(|s| s.to_be_bytes()).collect();
    encode(width, height, png::BitDepth::Sixteen, &bytes)
}

fn encode(width: u32, height: u32, depth: png::BitDepth, bytes: &[u8]) -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(depth);
    // Half the time of the default, with ten percent more bytes.
    encoder.set_compression(png::Compression::Fast);
    let written = encoder.write_header().and_then(|mut writer| {
        writer.write_image_data(bytes)?;
        writer.finish()
    });
    written.expect("memory takes all, and the caller gave one sample per pixel");
    file
}

/// Width, height and samples of a gray image. `path` is for messages.
pub(crate) fn decode(bytes: &[u8], path: &Path) -> Result<(u32, u32, GraySamples), BundleError> {
    let wrong = |found: String| BundleError::Malformed {
        path: path.to_owned(),
        place: "image".to_owned(),
        found,
        expected: "a grey PNG of 8 or 16 bits".to_owned(),
    };
    let decoder = png::Decoder::new(Cursor::new(bytes));
    let mut reader = decoder.read_info().map_err(|e| wrong(e.to_string()))?;
    let info = reader.info();
    let kind = (info.color_type, info.bit_depth);
    if !matches!(
        kind,
        (
            png::ColorType::Grayscale,
            png::BitDepth::Eight | png::BitDepth::Sixteen
        )
    ) {
        return Err(wrong(format!("{:?} of {:?} bits", kind.0, kind.1)));
    }
    let (width, height) = info.size();
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(BundleError::Malformed {
            path: path.to_owned(),
            place: "image".to_owned(),
            found: format!("{width}x{height} pixels"),
            expected: format!("at most {MAX_PIXELS} pixels"),
        });
    }
    let size = reader.output_buffer_size();
    let mut data = vec![0; size.ok_or_else(|| wrong("a size beyond memory".to_owned()))?];
    let info = reader
        .next_frame(&mut data)
        .map_err(|e| wrong(e.to_string()))?;
    data.truncate(info.buffer_size());
    let samples = match (info.color_type, info.bit_depth) {
        (png::ColorType::Grayscale, png::BitDepth::Eight) => GraySamples::Bits8(data),
        (png::ColorType::Grayscale, png::BitDepth::Sixteen) => {
            let pairs = data.chunks_exact(2);
            GraySamples::Bits16(pairs.map(|p| u16::from_be_bytes([p[0], p[1]])).collect())
        }
        (color, depth) => return Err(wrong(format!("{color:?} of {depth:?} bits"))),
    };
    Ok((info.width, info.height, samples))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The file of an image with other numbers in its header.
    fn forged(width: u32, height: u32, depth: u8, color: u8) -> Vec<u8> {
        let mut bytes = encode8(2, 2, &[1, 2, 3, 4]);
        bytes[16..20].copy_from_slice(&width.to_be_bytes());
        bytes[20..24].copy_from_slice(&height.to_be_bytes());
        (bytes[24], bytes[25]) = (depth, color);
        // CRC-32 of type and content (PNG, section 5.5).
        let mut crc = u32::MAX;
        for byte in &bytes[12..29] {
            crc ^= u32::from(*byte);
            for _ in 0..8 {
                crc = (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg());
            }
        }
        bytes[29..33].copy_from_slice(&(!crc).to_be_bytes());
        bytes
    }

    #[test]
    fn an_excessive_size_is_refused_before_allocation() {
        let path = Path::new("p.png");
        let whole = decode(&forged(2, 2, 8, 0), path).unwrap();
        assert_eq!((whole.0, whole.1), (2, 2));
        let why = |bytes: &[u8]| decode(bytes, path).map(drop).unwrap_err().to_string();
        for (width, height) in [(8193, 8192), (1 << 30, 1 << 30), (1 << 26, 2)] {
            let said = why(&forged(width, height, 8, 0));
            let ours = format!("{width}x{height} pixels, expected at most 67108864 pixels");
            // Beyond its own limits the decoder refuses first.
            assert!(
                said.contains(&ours) || said.contains("limits are exceeded"),
                "{said}"
            );
        }
        // Of another kind: six bytes a pixel that nobody would use.
        let said = why(&forged(8192, 8192, 16, 2));
        assert!(said.contains("Rgb of Sixteen bits"), "{said}");
    }
}
