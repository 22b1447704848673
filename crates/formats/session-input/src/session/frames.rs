//! Frames of one camera in order, each GOP decoded once.
//!
//! A camera has a thread of its own that decodes [`AHEAD`] frames ahead of its reader: the key
//! frames of two cameras may be that many frame sets apart and still be decoded in parallel. The
//! result does not depend on the threads. Dropping an iterator ends its thread, after the GOP that
//! it is decoding.

use std::iter::FusedIterator;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::{self, JoinHandle};

use super::content::Content;
use super::frame_reader::{FrameReader, StereoFrame, View};
use crate::error::{FrameFault, ReadError};

/// Number of frames decoded ahead of the reader, per camera.
const AHEAD: usize = 2;

/// Frames of one camera. A frame that cannot be read is an error, and the next one follows.
#[derive(Debug)]
pub struct Frames {
    content: Arc<Content>,
    camera: usize,
    positions: Arc<[usize]>,
    next: usize,
    /// None only while being dropped.
    decoded: Option<Receiver<Result<(StereoFrame, View), ReadError>>>,
    worker: Option<JoinHandle<()>>,
}

impl Frames {
    /// The frames at these positions of the camera's index, all of which must exist.
    pub(crate) fn start(
        content: Arc<Content>,
        camera: usize,
        positions: Arc<[usize]>,
    ) -> Result<Self, ReadError> {
        let reader = FrameReader::new(content.clone(), camera);
        Self::of(reader, content, camera, positions)
    }

    /// The same, of luma alone.
    pub(crate) fn start_luma(
        content: Arc<Content>,
        camera: usize,
        positions: Arc<[usize]>,
    ) -> Result<Self, ReadError> {
        let reader = FrameReader::new(content.clone(), camera).luma();
        Self::of(reader, content, camera, positions)
    }

    fn of(
        mut reader: FrameReader,
        content: Arc<Content>,
        camera: usize,
        positions: Arc<[usize]>,
    ) -> Result<Self, ReadError> {
        let (send, decoded) = sync_channel(AHEAD);
        let requested = positions.clone();
        let worker = thread::Builder::new()
            .name(format!("decode-{}", content.cameras[camera].name))
            .spawn(move || {
                for &position in &*requested {
                    if send.send(reader.frame_and_view(position)).is_err() {
                        return;
                    }
                }
            })
            .map_err(|error| ReadError::Thread(Arc::new(error)))?;
        Ok(Self {
            content,
            camera,
            positions,
            next: 0,
            decoded: Some(decoded),
            worker: Some(worker),
        })
    }

    /// The next view, with the frame that it was split from.
    pub(crate) fn next_frame_and_view(&mut self) -> Option<Result<(StereoFrame, View), ReadError>> {
        let position = *self.positions.get(self.next)?;
        self.next += 1;
        let decoded = self.decoded.as_ref().and_then(|d| d.recv().ok());
        Some(decoded.unwrap_or_else(|| {
            Err(ReadError::Frame {
                camera: self.content.cameras[self.camera].name.clone(),
                number: self.content.index.cameras[self.camera].frames[position].number,
                fault: FrameFault::Ended,
            })
        }))
    }
}

impl Iterator for Frames {
    type Item = Result<View, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        let decoded = self.next_frame_and_view()?;
        Some(decoded.map(|(_, view)| view))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        let left = self.positions.len() - self.next;
        (left, Some(left))
    }
}

impl ExactSizeIterator for Frames {}
impl FusedIterator for Frames {}

impl Drop for Frames {
    fn drop(&mut self) {
        // The worker notices that the receiver was dropped.
        self.decoded = None;
        if let Some(worker) = self.worker.take() {
            // If it panicked, its message is out and its frames came as errors.
            let _ = worker.join();
        }
    }
}

/// Positions of a camera's frames in a run of frame sets.
pub(crate) fn members(
    content: &Content,
    sets: std::ops::Range<usize>,
    camera: usize,
) -> Arc<[usize]> {
    let members = content.index.sets[sets].iter();
    let positions = members.filter_map(|set| set.frames[camera]);
    positions.map(|position| position as usize).collect()
}
