//! Depth and masks by neural networks of the user's, through ONNX Runtime (`docs/learned.md`).
//!
//! Contract: no network and no library comes along; the library is loaded when [`Runtime::load`] is called and never before. A
//! network is checked when it is opened, as far as its file says what it takes and gives; the rest is checked at every picture. What
//! does not fit is an error that names the file, the tensor, what was found and what was expected; pictures are padded, never
//! resized. A network is a function of its pictures: it remembers nothing from one to the next.

mod error;
mod image;
mod input;
mod network;
mod output;
mod runtime;
mod segmentation;
mod settings;
mod sigma;
mod stereo;

pub use error::LearnedError;
pub use image::ImageView;
pub use runtime::{RUNTIME_PATH_VARIABLE, Runtime};
pub use segmentation::{MovableMask, SegmentationNetwork};
pub use settings::{Enlarge, InputSettings, SegmentationSettings, StereoSettings};
pub use stereo::StereoNetwork;
