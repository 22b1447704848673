//! Memory of a training, known before it starts.

use splats::Plane;

use super::config::SplatsConfig;
use super::views::BATCH;
use crate::pipeline::StageError;

/// Bytes of a pixel of an image: colors and mask; with depth and its standard deviation.
const PIXEL: u64 = 3 + 1;
const DEPTH: u64 = 4 + 4;

/// Bytes of a pixel while an image is rendered, compared and differentiated.
const RENDERED: u64 = 160;

/// Copies of the Gaussians: that of the training, the two of a check, a checkpoint.
const COPIES: u64 = 4;

/// Bytes of a Gaussian beside its parameters: steps and what growth gathers.
const GATHERED: u64 = 48;

/// Bytes of a voxel at the start, and voxels for each point: voxels double above that.
const VOXEL: u64 = 400;
const VOXELS_PER_POINT: u64 = splats::MAX_VOXELS_PER_POINT as u64;

/// Bytes of a Gaussian of a sector that was trained before, beside its parameters.
const OBSERVED: u64 = 32;

/// Compares the memory that the largest sector needs, while all others are kept, with what is
/// available, bytes. `sectors` are the sizes of their stereo images (left and right, px).
///
/// # Errors
/// If there is less, with both numbers.
pub(super) fn check(
    sectors: &[Vec<[u64; 2]>],
    config: &SplatsConfig,
    available: Option<u64>,
) -> Result<(), StageError> {
    let needed = sectors
        .iter()
        .map(|of| (needed_bytes(of, config), of.len()));
    let (largest, images) = needed.max().unwrap_or_default();
    let others = (sectors.len() as u64).saturating_sub(1);
    let planes = Plane::count(config.train.degree) as u64;
    let gaussians = config.train.growth.max_splats as u64;
    let needed = largest + others * gaussians * (4 * planes + OBSERVED);
    let (of, remedy) = match others {
        0 => (String::new(), ""),
        _ => (
            format!(" of the largest of {} sectors", sectors.len()),
            "less for `--splat-sector-views`, ",
        ),
    };
    match available {
        Some(available) if needed > available => Err(format!(
            "training from {images} stereo images{of} needs up to {needed} bytes of memory, found \
             {available} available: take {remedy}`--preset fast`, or end at the stage before with \
             `--to maps`"
        )
        .into()),
        _ => Ok(()),
    }
}

/// Bytes that a training of stereo images of these sizes (left and right, px) can take.
fn needed_bytes(pixels: &[[u64; 2]], config: &SplatsConfig) -> u64 {
    let area = u64::from(config.reduction) * u64::from(config.reduction);
    // Pixels for each sample of the combined depth.
    let sample = (config.start.step_px as u64).max(1).pow(2);
    let image = |[left, right]: &[u64; 2]| {
        let right = if config.right_images { *right } else { 0 };
        (left * (PIXEL + DEPTH) + left / sample * DEPTH + right * PIXEL) / area
    };
    let images: u64 = pixels.iter().map(image).sum();
    // Whole images while they are read.
    let largest = pixels.iter().flatten().copied().max().unwrap_or(0);
    let read = BATCH as u64 * 2 * largest * (PIXEL + DEPTH);
    let planes = Plane::count(config.train.degree) as u64;
    let gaussian = 3 * 4 * planes + GATHERED;
    let gaussians = config.train.growth.max_splats as u64 * (COPIES * gaussian + 4 * planes);
    let start = config.start.max_points as u64 * VOXELS_PER_POINT * VOXEL;
    images + read + gaussians.max(start) + largest / area * RENDERED
}
