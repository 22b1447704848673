//! The images of a session, decoded: every image, or a run of them; with the progress of a console.

use std::ops::Range;

use anyhow::{Context, Result};
use console_output::Progress;
use session_archive::index::{Access, CameraIndex, FrameEntry, Index};
use session_archive::manifest::Camera;
use session_archive::reader::SessionReader;
use session_input::visit;
use video::Picture;

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
        let ignore = |_: &FrameEntry, _: &Picture| Ok(());
        let decoded = visit_images(camera, frames, &access, threads, progress, &ignore)?;
        all.push(decoded);
    }
    Ok(all)
}

/// Callback for each correctly decoded image; called from several threads, in no order.
pub type Visit<'a> = visit::Visit<'a, anyhow::Error>;

/// As [`visit::visit_images`].
///
/// # Errors
/// There is no decoder, or `visit` failed.
pub fn visit_images(
    camera: &Camera,
    index: &CameraIndex,
    access: &Access,
    threads: usize,
    progress: &Progress,
    visit: Visit<'_>,
) -> Result<DecodeCheck> {
    let add = |bytes| progress.add(bytes);
    visit::visit_images(camera, index, access, threads, &add, visit)
        .with_context(|| format!("decoding {}", camera.name))
}

/// As [`visit::visit_run`].
///
/// # Errors
/// There is no decoder.
pub fn visit_run(
    camera: &Camera,
    index: &CameraIndex,
    access: &Access,
    run: Range<usize>,
    visit: &mut dyn FnMut(&FrameEntry, &Picture),
) -> Result<()> {
    visit::visit_run(camera, index, access, run, visit)
        .with_context(|| format!("decoding {}", camera.name))
}
