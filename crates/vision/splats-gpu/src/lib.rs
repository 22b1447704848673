//! Scenes of 3D Gaussians on the GPU.

mod adam;
mod backward;
mod device;
mod error;
mod forward;
mod kernel;
mod loss;
mod memory;
mod scene;
mod sort;
mod trainer;
mod view;

pub use device::{Adapters, Gpu};
pub use error::GpuError;
pub use forward::GpuRenderer;
pub use loss::Losses;
pub use scene::GpuScene;
pub use trainer::GpuTrainer;
