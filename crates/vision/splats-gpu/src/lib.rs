//! Scenes of 3D Gaussians on the GPU.

mod backward;
mod device;
mod error;
mod forward;
mod kernel;
mod memory;
mod scene;
mod sort;
mod view;

pub use device::{Adapters, Gpu};
pub use error::GpuError;
pub use forward::GpuRenderer;
pub use scene::GpuScene;
