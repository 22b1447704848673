//! The two images of a frame, from PNG files to one I420 image side by side.
//!
//! Contract: samples are those of the file (gray unchanged with neutral chroma; color through
//! [`rgb_to_i420`]). All images of a data set have the same size, which may be odd.

use video::raw_image::{
    PixelFormat, RawImage, RawImageError, grey_to_i420, rgb_to_i420, side_by_side,
};

use super::ReplayError;
use crate::sources::datasets::{DecodedPng, Samples, StereoFrameRef, load_png, probe_png};

/// Size of one eye's images in the files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct EyeSize {
    pub(super) width: u32,
    pub(super) height: u32,
}

impl EyeSize {
    /// Bytes of a stereo frame.
    pub(super) fn stereo_bytes(self) -> usize {
        PixelFormat::I420
            .bytes(2 * self.width, self.height)
            .unwrap_or(usize::MAX)
    }
}

/// The size of all images, and RGB if any of them has color.
pub(super) fn probe(frames: &[StereoFrameRef]) -> Result<(EyeSize, Samples), ReplayError> {
    let first = probe_png(&frames[0].left)?;
    let mut samples = first.samples;
    for path in frames.iter().flat_map(|frame| [&frame.left, &frame.right]) {
        let shape = probe_png(path)?;
        if (shape.width, shape.height) != (first.width, first.height) {
            return Err(ReplayError::Size {
                path: path.clone(),
                found: (shape.width, shape.height),
                expected: (first.width, first.height),
            });
        }
        if shape.samples == Samples::Rgb8 {
            samples = Samples::Rgb8;
        }
    }
    let eye = EyeSize {
        width: first.width,
        height: first.height,
    };
    Ok((eye, samples))
}

/// Loads both images of a frame.
pub(super) fn load(frame: &StereoFrameRef, eye: EyeSize) -> Result<RawImage, ReplayError> {
    let convert = |path: &std::path::Path| {
        let png = load_png(path)?;
        if (png.width, png.height) != (eye.width, eye.height) {
            // The file has changed since it was probed.
            return Err(ReplayError::Size {
                path: path.to_owned(),
                found: (png.width, png.height),
                expected: (eye.width, eye.height),
            });
        }
        i420(png).map_err(|source| ReplayError::Convert {
            path: path.to_owned(),
            source,
        })
    };
    let (left, right) = (convert(&frame.left)?, convert(&frame.right)?);
    side_by_side(&left, &right).map_err(|source| ReplayError::Convert {
        path: frame.left.clone(),
        source,
    })
}

/// An image of any size as I420.
pub(in crate::sources) fn i420(png: DecodedPng) -> Result<RawImage, RawImageError> {
    match png.samples {
        Samples::Rgb8 => rgb_to_i420(png.width, png.height, &png.data),
        Samples::Grey8 => grey_to_i420(&RawImage::new(
            png.width,
            png.height,
            PixelFormat::Grey8,
            png.data,
        )?),
    }
}
