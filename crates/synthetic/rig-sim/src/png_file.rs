//! Images as PNG files.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use png::{BitDepth, ColorType, Compression};

/// Writes 8-bit gray, row-major.
pub(crate) fn gray8(path: &Path, size: [usize; 2], pixels: &[u8]) -> io::Result<()> {
    write(path, size, ColorType::Grayscale, BitDepth::Eight, pixels)
}

/// Writes 16-bit gray, row-major.
pub(crate) fn gray16(
    path: &Path,
    size: [usize; 2],
    pixels: impl Iterator<Item = u16>,
) -> io::Result<()> {
    // PNG is big endian.
    let bytes: Vec<u8> = pixels.flat_map(u16::to_be_bytes).collect();
    write(path, size, ColorType::Grayscale, BitDepth::Sixteen, &bytes)
}

/// Writes 16-bit RGB, row-major.
pub(crate) fn rgb16(
    path: &Path,
    size: [usize; 2],
    pixels: impl Iterator<Item = [u16; 3]>,
) -> io::Result<()> {
    let bytes: Vec<u8> = pixels.flatten().flat_map(u16::to_be_bytes).collect();
    write(path, size, ColorType::Rgb, BitDepth::Sixteen, &bytes)
}

fn write(
    path: &Path,
    [width, height]: [usize; 2],
    color: ColorType,
    depth: BitDepth,
    bytes: &[u8],
) -> io::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    let mut encoder = png::Encoder::new(&mut file, width as u32, height as u32);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(bytes)?;
    writer.finish()?;
    file.flush()
}
