//! The images of a camera, decoded: every image, or a run of them; with the progress of a console.

use std::ops::Range;

use anyhow::{Context, Result};
use console_output::Progress;
use session_archive::index::{Access, CameraIndex, FrameEntry};
use session_archive::manifest::Camera;
use session_input::visit::{self, DecodedCamera};
use video::RawImage;

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
) -> Result<DecodedCamera> {
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
    visit: &mut dyn FnMut(&FrameEntry, &RawImage),
) -> Result<()> {
    visit::visit_run(camera, index, access, run, visit)
        .with_context(|| format!("decoding {}", camera.name))
}
