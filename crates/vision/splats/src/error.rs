//! Errors of scenes, cameras, renderers and training.

use gaussians::GaussianError;

/// Reasons why a scene, a camera or a training cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SplatError {
    /// The Gaussians are invalid.
    #[error(transparent)]
    Gaussians(#[from] GaussianError),
    /// The map of the sky has another size, or values that are not finite.
    #[error(
        "a sky of {texels} texels with an edge of {size}, expected 2 to 4096 squared finite ones"
    )]
    Sky {
        /// Edge.
        size: usize,
        /// Number of texels.
        texels: usize,
    },
    /// The camera cannot be rendered: correct its model or motion.
    #[error("the camera cannot be rendered: {reason}")]
    Camera {
        /// What is wrong, with the values found.
        reason: String,
    },
    /// A buffer has another number of values than the image has pixels.
    #[error("{what} of {found} values, expected {expected}")]
    Size {
        /// Name of the buffer.
        what: &'static str,
        /// Values found.
        found: usize,
        /// Values expected.
        expected: usize,
    },
    /// A setting is outside of its domain.
    #[error("the setting {name} is {found}, expected {expected}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// Value as found.
        found: f64,
        /// The domain.
        expected: &'static str,
    },
    /// The views cannot train a scene: too few of them, or no valid pixel.
    #[error("the views cannot train a scene: {reason}")]
    Views {
        /// What is wrong, with the values found.
        reason: String,
    },
    /// Training reached values that are not finite; the scene before the step is kept.
    #[error("training failed at step {step}: {reason}")]
    Diverged {
        /// Step.
        step: usize,
        /// What is not finite.
        reason: String,
    },
    /// A device that runs the steps of a training failed; the state before them is kept.
    #[error("training on a device failed: {reason}")]
    Device {
        /// What the device says.
        reason: String,
    },
    /// A checkpoint is not one of this training: start from the beginning.
    #[error("the checkpoint of a training cannot be used: {reason}")]
    Checkpoint {
        /// What is wrong, with the values found.
        reason: String,
    },
}
