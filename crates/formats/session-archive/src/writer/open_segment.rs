//! The segment that is being written.

use crate::mcap::SegmentEncoder;
use crate::storage::WriteFile;
use crate::time::HostTime;

pub(super) struct OpenSegment {
    pub(super) number: u32,
    pub(super) file: Box<dyn WriteFile>,
    pub(super) encoder: SegmentEncoder,
    /// Earliest log time of its chunks, the head not counted.
    pub(super) start: Option<HostTime>,
}
