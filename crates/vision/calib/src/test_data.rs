//! Files for tests: synthetic ones in a temporary folder, real ones outside the project.

pub(crate) use ::test_data::shared;

use std::path::{Path, PathBuf};

/// A folder that is deleted with the test.
pub(crate) struct Folder(tempfile::TempDir);

impl Folder {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().expect("a temporary folder can be made"))
    }

    pub(crate) fn path(&self) -> &Path {
        self.0.path()
    }

    /// Writes a file, with the folders above it.
    pub(crate) fn file(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a file is in a folder"))
            .expect("a folder can be made");
        std::fs::write(&path, text).expect("a file can be written");
        path
    }
}

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
