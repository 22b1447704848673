//! Number of frames of each camera inside its encoder.
//!
//! The hub increments the counters; the encoders' threads decrement them after the frame was sent
//! to the recorder. If the recorder reads zero, every frame that was passed to an encoder before is
//! in its queue or in the session.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The counters of all cameras; clones share them.
#[derive(Clone, Debug)]
pub struct Encoding(Arc<[AtomicUsize]>);

impl Encoding {
    /// Counters for this number of cameras, all zero.
    pub fn new(cameras: usize) -> Self {
        Self((0..cameras).map(|_| AtomicUsize::new(0)).collect())
    }

    /// Counts a frame of this camera that goes to its encoder.
    pub fn begin(&self, camera: usize) {
        self.0[camera].fetch_add(1, Ordering::SeqCst);
    }

    /// Counts a frame of this camera, or the report of its loss, that is in the recorder's queue.
    pub fn end(&self, camera: usize) {
        self.0[camera].fetch_sub(1, Ordering::SeqCst);
    }

    /// Whether a frame of this camera is in its encoder.
    pub fn is_busy(&self, camera: usize) -> bool {
        self.0[camera].load(Ordering::SeqCst) > 0
    }
}
