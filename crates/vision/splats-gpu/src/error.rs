//! Errors of the GPU.

use splats::SplatError;

/// Reasons why the GPU cannot render or train.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter of Vulkan, Metal or DirectX 12.
    #[error(
        "no GPU: no adapter of Vulkan, Metal or DirectX 12. Install the GPU's driver; in a \
         container, its entry for Vulkan has to be there too"
    )]
    NoAdapter,
    /// Only adapters that compute on the processor, which is slower than the renderer for it.
    #[error(
        "no GPU: the adapters ({names}) compute on the processor, which is slower than the \
         renderer for the processor"
    )]
    OnlySoftware {
        /// Names of the adapters.
        names: String,
    },
    /// The adapter does not open, or lacks what the kernels need.
    #[error("the GPU {name} cannot be used: {reason}")]
    Adapter {
        /// Name of the adapter.
        name: String,
        /// What is missing.
        reason: String,
    },
    /// The scene, image or list of pairs is larger than the device's buffers can be.
    #[error("{what} of {bytes} B, more than the {limit} B of a buffer of the GPU {name}")]
    TooLarge {
        /// Name of the buffer.
        what: &'static str,
        /// Bytes needed.
        bytes: u64,
        /// Bytes that a buffer may have.
        limit: u64,
        /// Name of the adapter.
        name: String,
    },
    /// The GPU has no memory left.
    #[error("the GPU {name} has no memory left for {what}")]
    OutOfMemory {
        /// Name of the buffer, or the work.
        what: &'static str,
        /// Name of the adapter.
        name: String,
    },
    /// The driver refuses work that other drivers accept.
    #[error("the GPU {name} fails at {what}: {reason}")]
    Failed {
        /// Name of the adapter.
        name: String,
        /// The work.
        what: &'static str,
        /// What the driver says.
        reason: String,
    },
    /// The device does not answer any more: reset, removed, or a fault of its driver.
    #[error("the GPU {name} is lost: {reason}")]
    Lost {
        /// Name of the adapter.
        name: String,
        /// What the driver says.
        reason: String,
    },
    /// A buffer does not fit the image, or a setting is outside of its domain.
    #[error(transparent)]
    Splats(#[from] SplatError),
}
