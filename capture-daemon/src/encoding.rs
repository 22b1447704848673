//! How many frames of each camera are inside its encoder.
//!
//! The hub counts them in, the encoders' threads count them out after the frame is on its way to the recorder. So a
//! recorder that sees none has every frame that was handed to an encoder before, in its queue or in the session.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The counters of all cameras; clones share them.
#[derive(Clone, Debug)]
pub struct Encoding(Arc<[AtomicUsize]>);

impl Encoding {
    /// Counters for so many cameras; nothing is encoded yet.
    pub fn new(cameras: usize) -> Self {
        Self((0..cameras).map(|_| AtomicUsize::new(0)).collect())
    }

    /// A frame of this camera goes to its encoder.
    pub fn begin(&self, camera: usize) {
        self.0[camera].fetch_add(1, Ordering::SeqCst);
    }

    /// A frame of this camera, or the report of its loss, is in the recorder's queue.
    pub fn end(&self, camera: usize) {
        self.0[camera].fetch_sub(1, Ordering::SeqCst);
    }

    /// Whether a frame of this camera is inside.
    pub fn is_busy(&self, camera: usize) -> bool {
        self.0[camera].load(Ordering::SeqCst) > 0
    }
}
