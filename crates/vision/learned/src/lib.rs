//! Depth, masks and distances of images from user-supplied neural networks, through ONNX Runtime
//! (`docs/reference/learned.md`).
//!
//! Contract: neither networks nor the library are bundled; [`Runtime::load`] loads the library, and
//! nothing loads it earlier. A network is validated when it is opened, as far as its file declares
//! inputs and outputs; the rest is validated at every image. A mismatch is an error that names the
//! file, the tensor, what was found and what was expected. Images are padded and never resized. A
//! network is a function of its images and keeps no state between them.

mod error;
mod image;
mod input;
mod lpips;
mod network;
mod output;
mod pair;
mod runtime;
mod segmentation;
mod settings;
mod sigma;
mod stereo;

pub use error::LearnedError;
pub use image::ImageView;
pub use lpips::LpipsNetwork;
pub use runtime::{RUNTIME_PATH_VARIABLE, Runtime};
pub use segmentation::{MovableMask, SegmentationNetwork};
pub use settings::{Enlarge, InputSettings, SegmentationSettings, StereoSettings};
pub use stereo::StereoNetwork;
