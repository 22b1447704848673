//! Whether every recorded image can be decoded.

use anyhow::{Context, Result};
use console_output::Progress;
use session_archive::index::{Access, FrameEntry, Index};
use session_archive::reader::SessionReader;
use video::RawImage;

use crate::decode::visit_images;

/// Result of decoding one camera.
pub use session_input::visit::DecodedCamera as DecodeCheck;

/// Decodes all images of a session with up to `threads` threads.
///
/// # Errors
/// An I/O error occurs, or this machine has no decoder for a camera's codec.
pub fn decode_all(
    reader: &SessionReader,
    index: &Index,
    threads: usize,
    progress: &Progress,
) -> Result<Vec<DecodeCheck>> {
    let access = Access::open(&**reader.storage(), index).context("opening the segments")?;
    let cameras = &reader.manifest().cameras;
    let mut all = Vec::new();
    for (camera, frames) in cameras.iter().zip(&index.cameras) {
        let ignore = |_: &FrameEntry, _: &RawImage| Ok(());
        let decoded = visit_images(camera, frames, &access, threads, progress, &ignore)?;
        all.push(decoded);
    }
    Ok(all)
}
