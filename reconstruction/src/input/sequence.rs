//! Frames and frame sets in order, each GOP decoded once.
//!
//! Every camera has a thread of its own that decodes [`AHEAD`] frames ahead of its reader: the key
//! frames of two cameras may be that many frame sets apart and still be decoded in parallel. The
//! result does not depend on the threads. Dropping an iterator ends its threads, after the group
//! that each is decoding.

use std::iter::FusedIterator;
use std::ops::Range;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::{self, JoinHandle};

use super::camera::{GopReader, View};
use super::error::{FrameFault, ReadError};
use super::{FrameSet, Shared};

/// Number of frames decoded ahead of the reader, per camera.
const AHEAD: usize = 2;

/// Frames of one camera. A frame that cannot be read is an error, and the next one follows.
#[derive(Debug)]
pub struct Frames {
    shared: Arc<Shared>,
    camera: usize,
    positions: Arc<[usize]>,
    next: usize,
    /// None only while being dropped.
    views: Option<Receiver<Result<View, ReadError>>>,
    worker: Option<JoinHandle<()>>,
}

impl Frames {
    /// The frames at these positions of the camera's index, all of which must exist.
    pub(super) fn start(
        shared: Arc<Shared>,
        camera: usize,
        positions: Arc<[usize]>,
    ) -> Result<Self, ReadError> {
        let reader = GopReader::new(shared.clone(), camera);
        Self::of(reader, shared, camera, positions)
    }

    /// The same, of luma alone.
    pub(super) fn start_luma(
        shared: Arc<Shared>,
        camera: usize,
        positions: Arc<[usize]>,
    ) -> Result<Self, ReadError> {
        let reader = GopReader::new(shared.clone(), camera).luma();
        Self::of(reader, shared, camera, positions)
    }

    fn of(
        mut reader: GopReader,
        shared: Arc<Shared>,
        camera: usize,
        positions: Arc<[usize]>,
    ) -> Result<Self, ReadError> {
        let (send, views) = sync_channel(AHEAD);
        let wanted = positions.clone();
        let worker = thread::Builder::new()
            .name(format!("decode-{}", shared.cameras[camera].name))
            .spawn(move || {
                for &position in &*wanted {
                    if send.send(reader.view(position)).is_err() {
                        return;
                    }
                }
            })
            .map_err(|error| ReadError::Thread(Arc::new(error)))?;
        Ok(Self {
            shared,
            camera,
            positions,
            next: 0,
            views: Some(views),
            worker: Some(worker),
        })
    }
}

impl Iterator for Frames {
    type Item = Result<View, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        let position = *self.positions.get(self.next)?;
        self.next += 1;
        let view = self.views.as_ref().and_then(|views| views.recv().ok());
        Some(view.unwrap_or_else(|| {
            Err(ReadError::Frame {
                camera: self.shared.cameras[self.camera].name.clone(),
                number: self.shared.index.cameras[self.camera].frames[position].number,
                fault: FrameFault::Ended,
            })
        }))
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
        self.views = None;
        if let Some(worker) = self.worker.take() {
            // If it panicked, its message is out and its frames came as errors.
            let _ = worker.join();
        }
    }
}

/// Frame sets in order of time. A set with a frame or an IMU batch that cannot be read is an error,
/// and the next one follows.
#[derive(Debug)]
pub struct Sets {
    shared: Arc<Shared>,
    /// Positions of the sets still to come.
    sets: Range<usize>,
    /// One for each camera.
    cameras: Vec<Frames>,
}

impl Sets {
    /// The sets at these positions of the index, all of which must exist.
    pub(super) fn start(shared: Arc<Shared>, sets: Range<usize>) -> Result<Self, ReadError> {
        let cameras = (0..shared.cameras.len()).map(|camera| {
            let members = shared.index.sets[sets.clone()].iter();
            let positions = members.filter_map(|set| set.frames[camera]);
            let positions = positions.map(|position| position as usize).collect();
            Frames::start(shared.clone(), camera, positions)
        });
        Ok(Self {
            cameras: cameras.collect::<Result<_, _>>()?,
            shared,
            sets,
        })
    }
}

impl Iterator for Sets {
    type Item = Result<FrameSet, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        let position = self.sets.next()?;
        let members = &self.shared.index.sets[position].frames;
        // Every camera advances by its member, also after one that fails.
        let views: Vec<_> = members
            .iter()
            .zip(&mut self.cameras)
            .map(|(member, frames)| member.and_then(|_| frames.next()).transpose())
            .collect();
        Some(self.shared.set(position, views))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.sets.size_hint()
    }
}

impl ExactSizeIterator for Sets {}
impl FusedIterator for Sets {}
