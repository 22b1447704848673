//! Decoding of one run of frames that begins with a key frame: a GOP or its first part.
//!
//! Every reader of images in this crate decodes through this module.

use std::sync::Arc;

use session_archive::index::{Access, FrameEntry, IndexError};
use video::{AccessUnit, DecodeError, Decoder, RawImage};

use crate::error::FrameFault;

/// The decoder gets positions in the run instead of times, this far apart, ns: they identify the
/// images as well, and increase even where mapped times do not.
const STEP_NS: i64 = 1_000_000;

/// Access units of a run, checked against the index.
pub(crate) struct Units {
    /// Up to the first that cannot be read.
    pub(crate) units: Vec<AccessUnit>,
    /// Why the next one cannot be read.
    pub(crate) unread: Option<IndexError>,
}

/// Reads the access units of a run. Later frames depend on earlier ones, so reading ends at the
/// first that cannot be read.
pub(crate) fn read_units(access: &Access, run: &[FrameEntry]) -> Units {
    let mut units = Vec::with_capacity(run.len());
    for (position, entry) in run.iter().enumerate() {
        match access.unit(entry) {
            Ok(data) => units.push(AccessUnit {
                pts_ns: position as i64 * STEP_NS,
                data,
                key: position == 0,
            }),
            Err(error) => {
                let unread = Some(error);
                return Units { units, unread };
            }
        }
    }
    Units {
        units,
        unread: None,
    }
}

/// Position in its run of the frame with this decoder time.
pub(crate) fn position(pts_ns: i64) -> Option<usize> {
    usize::try_from(pts_ns / STEP_NS).ok()
}

/// Decodes a run: one result for each frame.
pub(crate) fn decode(
    decoder: &mut Decoder,
    access: &Access,
    run: &[FrameEntry],
) -> Vec<Result<RawImage, FrameFault>> {
    let Units { units, unread } = read_units(access, run);
    let unread = unread.map(|error| FrameFault::Bytes(Arc::new(error)));
    let (decoded, fault) = match decoder.decode(&units) {
        Ok(images) => (images, FrameFault::NoImage),
        Err(DecodeError::Incomplete { images, .. }) => (images, FrameFault::NoImage),
        Err(error) => (Vec::new(), FrameFault::Decoder(error)),
    };
    let mut decoded = decoded.into_iter().peekable();
    let images = (0..run.len()).map(|at| {
        match decoded.next_if(|(pts_ns, _)| *pts_ns == at as i64 * STEP_NS) {
            Some((_, image)) => Ok(image),
            None if at >= units.len() => Err(unread.clone().unwrap_or(FrameFault::NoImage)),
            None => Err(fault.clone()),
        }
    });
    images.collect()
}
