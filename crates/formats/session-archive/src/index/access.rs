//! Reading what an index points to.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;

use bytes::Bytes;

use super::entries::{BatchEntry, FrameEntry, Index, IndexError};
use crate::layout;
use crate::record::{ImuBatch, Protobuf};
use crate::storage::{ReadAt, Storage};

/// Reads what an index points to, from any thread.
pub struct Access {
    files: BTreeMap<u32, Arc<dyn ReadAt>>,
}

impl Access {
    /// Opens the segments of a session.
    ///
    /// # Errors
    /// The file system reports an I/O error, or a segment that was indexed is missing.
    pub fn open(storage: &dyn Storage, index: &Index) -> io::Result<Self> {
        let mut files = BTreeMap::new();
        for (number, _) in &index.segments {
            files.insert(*number, Arc::from(storage.open(&layout::segment(*number))?));
        }
        Ok(Self { files })
    }

    /// The access unit of a frame, checked.
    ///
    /// # Errors
    /// [`IndexError::Mismatch`], or the file system reports an I/O error.
    pub fn unit(&self, frame: &FrameEntry) -> Result<Bytes, IndexError> {
        self.checked(frame.segment, frame.offset, frame.bytes, frame.crc32)
    }

    /// An IMU batch, checked.
    ///
    /// # Errors
    /// [`IndexError::Mismatch`], or the file system reports an I/O error.
    pub fn batch(&self, batch: &BatchEntry) -> Result<ImuBatch, IndexError> {
        let bytes = self.checked(batch.segment, batch.offset, batch.bytes, batch.crc32)?;
        ImuBatch::decode(bytes).map_err(|e| IndexError::Unreadable(e.to_string()))
    }

    fn checked(
        &self,
        segment: u32,
        offset: u64,
        length: u32,
        crc32: u32,
    ) -> Result<Bytes, IndexError> {
        let mismatch = IndexError::Mismatch { segment, offset };
        let Some(file) = self.files.get(&segment) else {
            return Err(mismatch);
        };
        if offset.saturating_add(u64::from(length)) > file.len()? {
            return Err(mismatch);
        }
        // The length lies within the file, but a sparse file can exceed the free memory.
        let mut bytes = plain_file::reserve(length.into())?;
        bytes.resize(length as usize, 0);
        file.read_exact_at(&mut bytes, offset)?;
        if crc32fast::hash(&bytes) == crc32 {
            Ok(bytes.into())
        } else {
            Err(mismatch)
        }
    }
}
