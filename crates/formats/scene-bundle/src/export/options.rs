//! How to export.

use std::path::PathBuf;

/// How to write it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Whether the causal trajectory is exported instead of the offline one. No effect on
    /// keyframes, which have their own poses.
    pub causal: bool,
    /// Folder of the images, as `paws-reconstruct frames` writes them: `CAMERA/left/NNNNNN.png`,
    /// named by the number of the frame. With it, keyframes without an image are left out.
    pub images: Option<PathBuf>,
    /// Whether right images are included.
    pub right: bool,
    /// Only these cameras; all where it is empty.
    pub cameras: Vec<String>,
}
