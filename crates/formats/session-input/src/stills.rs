//! A few small images of one camera, chosen and decoded by [`video::still`].

use session_archive::index::{Access, CameraIndex};
use session_archive::manifest::Camera;
use video::Codec;
use video::still::{Candidate, Settings, StillError, Stills, stills};

/// Why there are no images of a camera.
#[derive(Debug, thiserror::Error)]
pub enum StillsError {
    /// A codec that this program does not know: update it.
    #[error("found the codec {0:?}, expected h264 or h265")]
    Codec(String),
    /// This machine cannot decode it, or cannot make small images.
    #[error(transparent)]
    Still(#[from] StillError),
}

/// Selects and decodes some frames of a camera. Frames that cannot be read or decoded are counted.
/// The work is bounded, independent of the session's length.
///
/// # Errors
/// See [`StillsError`].
pub fn camera_stills(
    camera: &Camera,
    index: &CameraIndex,
    access: &Access,
) -> Result<Stills, StillsError> {
    let codec = Codec::from_foxglove_format(&camera.codec)
        .ok_or_else(|| StillsError::Codec(camera.codec.clone()))?;
    let frames = index.frames.iter();
    let candidates: Vec<Candidate> = frames
        .map(|frame| Candidate {
            number: frame.number,
            time_ns: frame.time_ns,
            key: frame.key as usize,
        })
        .collect();
    let mut read = |position: usize| access.unit(&index.frames[position]).ok();
    Ok(stills(codec, &candidates, &Settings::default(), &mut read)?)
}
