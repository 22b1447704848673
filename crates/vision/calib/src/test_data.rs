//! Files for tests: real ones outside the project.

pub(crate) use ::test_data::shared;

use std::path::Path;

/// An image file as grey: width, height, pixels.
pub(crate) fn grey(path: &Path) -> (usize, usize, Vec<u8>) {
    let bytes = std::fs::read(path).expect("an image can be read");
    let bytes = std::io::Cursor::new(bytes);
    let (width, height, data) = if path.extension().is_some_and(|e| e == "png") {
        let mut decoder = png::Decoder::new(bytes);
        decoder.set_transformations(png::Transformations::normalize_to_color8());
        let mut reader = decoder.read_info().expect("a PNG file");
        let mut data = vec![0; reader.output_buffer_size().expect("a size")];
        let info = reader.next_frame(&mut data).expect("a whole PNG file");
        data.truncate(info.buffer_size());
        (info.width as usize, info.height as usize, data)
    } else {
        let mut decoder = zune_jpeg::JpegDecoder::new(bytes);
        let data = decoder.decode().expect("a JPEG file");
        let info = decoder.info().expect("a decoded file has a header");
        (usize::from(info.width), usize::from(info.height), data)
    };
    let luma = |p: &[u8]| match p {
        [r, g, b, ..] => {
            ((299 * u32::from(*r) + 587 * u32::from(*g) + 114 * u32::from(*b) + 500) / 1000) as u8
        }
        _ => p[0],
    };
    let pixels = data
        .chunks_exact(data.len() / (width * height))
        .map(luma)
        .collect();
    (width, height, pixels)
}
