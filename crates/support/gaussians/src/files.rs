//! Files of Gaussians: [`ply`], [`spz`] and [`dot_splat`] as bytes in and bytes out, [`glb`] as
//! bytes out.
//!
//! Contract: readers accept any bytes. They return what the file contains, or an error that names
//! what was found and expected; they do not panic, and their memory is bounded by the given maximum
//! number of Gaussians. Coordinates are those of the file: formats that prescribe axes say so, and
//! [`Splats::transformed`](crate::Splats::transformed) rotates Gaussians with their harmonics.

pub mod dot_splat;
pub mod glb;
pub mod ply;
pub mod spz;
#[cfg(test)]
mod tests;

use crate::error::GaussianError;
use crate::splats::Splats;

/// Content of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct SplatFile {
    /// The Gaussians.
    pub splats: Splats,
    /// Whether they were trained with compensated dilation:
    /// `RenderConfig::compensate` of the crate `splats`.
    pub compensated: bool,
}

/// Reasons why bytes are not Gaussians.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FileError {
    /// The file ends early, or is longer than its header says: it is damaged.
    #[error("{what}: {found} bytes, expected {expected}")]
    Length {
        /// Part of the file.
        what: &'static str,
        /// Bytes found.
        found: u64,
        /// Bytes expected.
        expected: u64,
    },
    /// The header is not one of this format, or of a variant that is not read.
    #[error("header: {reason}")]
    Header {
        /// What was found and expected.
        reason: String,
    },
    /// More Gaussians than the caller allows.
    #[error("{found} Gaussians, expected at most {max}")]
    TooMany {
        /// Number in the file.
        found: u64,
        /// The maximum.
        max: usize,
    },
    /// A compressed part cannot be decompressed: it is damaged.
    #[error("{what} cannot be decompressed: {reason}")]
    Compression {
        /// Part of the file.
        what: &'static str,
        /// The decoder's message.
        reason: String,
    },
    /// A parameter is invalid.
    #[error("{0}")]
    Splats(GaussianError),
}

impl From<GaussianError> for FileError {
    fn from(error: GaussianError) -> Self {
        Self::Splats(error)
    }
}

fn header(reason: impl Into<String>) -> FileError {
    FileError::Header {
        reason: reason.into(),
    }
}

/// Logit of an opacity stored in 8 bits; the ends are taken as half a step from 0 and 1.
fn logit(byte: u8) -> f32 {
    let opacity = (f32::from(byte) / 255.0).clamp(0.5 / 255.0, 254.5 / 255.0);
    libm::logf(opacity / (1.0 - opacity))
}

/// Opacity of a logit in 8 bits.
fn opacity_byte(logit: f32) -> u8 {
    byte(255.0 / (1.0 + libm::expf(-logit)))
}

/// Rounded to 8 bits.
fn byte(value: f32) -> u8 {
    // The cast saturates.
    libm::roundf(value) as u8
}

/// A rotation of length 1.
fn unit(rotation: [f32; 4]) -> [f32; 4] {
    let norm = rotation.iter().map(|v| v * v).sum::<f32>().sqrt();
    rotation.map(|v| v / norm)
}
