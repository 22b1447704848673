//! Decoded frames kept in a file, so that later readers of the same session do not decode them
//! again.
//!
//! Contract: a kept frame is returned exactly as it was decoded, or not at all: without a file,
//! above the limit, or after an error of the file, readers decode instead. So what is kept changes
//! the time of reading and nothing else. Memory is one entry per kept frame.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use video::{PixelFormat, RawImage};

/// See the module. The default keeps nothing.
#[derive(Debug, Default)]
pub(crate) struct KeptFrames {
    store: Mutex<Option<Store>>,
}

#[derive(Debug)]
struct Store {
    file: Arc<File>,
    max_bytes: u64,
    bytes: u64,
    /// By camera and position in its index.
    entries: BTreeMap<(usize, usize), Entry>,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    offset: u64,
    width: u32,
    height: u32,
    crc32: u32,
}

impl KeptFrames {
    /// Keeps frames in a file from now on; those kept before are dropped.
    pub(crate) fn start(&self, file: File, max_bytes: u64) {
        *self.lock() = Some(Store {
            file: Arc::new(file),
            max_bytes,
            bytes: 0,
            entries: BTreeMap::new(),
        });
    }

    /// Keeps a frame, if there is a file with room for it.
    pub(crate) fn keep(&self, camera: usize, position: usize, image: &RawImage) {
        if image.format != PixelFormat::I420 {
            return;
        }
        let (length, crc32) = (image.data.len() as u64, crc32fast::hash(&image.data));
        let mut store = self.lock();
        let Some(open) = &mut *store else { return };
        let key = (camera, position);
        if length > open.max_bytes - open.bytes || open.entries.contains_key(&key) {
            return;
        }
        let entry = Entry {
            offset: open.bytes,
            width: image.width,
            height: image.height,
            crc32,
        };
        match open.file.write_all_at(&image.data, entry.offset) {
            Ok(()) => {
                open.bytes += length;
                open.entries.insert(key, entry);
            }
            Err(error) => {
                log::warn!("keeping decoded frames: {error}; later stages decode them again");
                // Closing the file frees the disk for what must be written.
                *store = None;
            }
        }
    }

    /// A kept frame; `None` if it is not kept or cannot be read.
    pub(crate) fn read(&self, camera: usize, position: usize) -> Option<RawImage> {
        let (file, entry) = {
            let store = self.lock();
            let open = store.as_ref()?;
            let entry = *open.entries.get(&(camera, position))?;
            (Arc::clone(&open.file), entry)
        };
        let length = PixelFormat::I420.bytes(entry.width, entry.height).ok()?;
        let mut data = vec![0; length];
        file.read_exact_at(&mut data, entry.offset).ok()?;
        if crc32fast::hash(&data) != entry.crc32 {
            return None;
        }
        RawImage::new(entry.width, entry.height, PixelFormat::I420, data).ok()
    }

    fn lock(&self) -> MutexGuard<'_, Option<Store>> {
        // Entries are added after their bytes: the store is valid after a panic.
        self.store.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(value: u8) -> RawImage {
        RawImage::new(4, 2, PixelFormat::I420, vec![value; 12]).expect("4 x 2")
    }

    #[test]
    fn kept_frames_are_returned_up_to_the_limit() {
        let kept = KeptFrames::default();
        kept.keep(0, 0, &image(1));
        assert_eq!(kept.read(0, 0), None);
        kept.start(tempfile::tempfile().expect("a file"), 30);
        kept.keep(0, 7, &image(1));
        kept.keep(1, 7, &image(2));
        kept.keep(1, 8, &image(3));
        assert_eq!(kept.read(0, 7), Some(image(1)));
        assert_eq!(kept.read(1, 7), Some(image(2)));
        assert_eq!((kept.read(1, 8), kept.read(0, 8)), (None, None));
    }

    #[test]
    fn a_frame_whose_bytes_changed_is_not_returned() {
        let kept = KeptFrames::default();
        let file = tempfile::tempfile().expect("a file");
        kept.start(file.try_clone().expect("a second handle"), 100);
        kept.keep(0, 0, &image(1));
        kept.keep(0, 1, &image(2));
        file.write_all_at(&[9], 13).expect("written");
        assert_eq!(kept.read(0, 0), Some(image(1)));
        assert_eq!(kept.read(0, 1), None);
    }

    #[test]
    fn nothing_is_kept_after_a_write_that_fails() {
        let kept = KeptFrames::default();
        let named = tempfile::NamedTempFile::new().expect("a file");
        kept.start(File::open(named.path()).expect("for reading only"), 100);
        kept.keep(0, 0, &image(1));
        assert_eq!(kept.read(0, 0), None);
        assert!(kept.lock().is_none());
    }
}
