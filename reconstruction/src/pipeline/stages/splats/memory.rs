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

/// Bytes of a Gaussian of a trained sector, beside its parameters: what the views saw of it.
const OBSERVED: u64 = 32;

/// Bytes of the normal of a Gaussian in a file.
const NORMAL: u64 = 3 * 4;

/// Compares the memory that a stage needs with what is available, bytes: that of the training of
/// the largest sector while all others are kept, and that of all sectors at the end, when held-out
/// images are compared and files are written. `sectors` are the sizes of their stereo images (left
/// and right, px), `held_out` those of held-out ones.
///
/// # Errors
/// If there is less, with both numbers.
pub(super) fn check(
    sectors: &[Vec<[u64; 2]>],
    held_out: &[Vec<[u64; 2]>],
    config: &SplatsConfig,
    available: Option<u64>,
) -> Result<(), StageError> {
    let needed = sectors
        .iter()
        .map(|of| (needed_bytes(of, config), of.len()));
    let (largest, images) = needed.max().unwrap_or_default();
    let count = sectors.len() as u64;
    let planes = Plane::count(config.train.degree) as u64;
    let trained = config.train.growth.max_splats as u64 * (4 * planes + OBSERVED);
    let training = largest + count.saturating_sub(1) * trained;
    let end = end_bytes(sectors.len(), held_out, config);
    let (what, remedy) = match count {
        0 | 1 => (format!("training from {images} stereo images"), ""),
        _ if end > training => (
            format!("comparing and writing {count} sectors"),
            "more for `--splat-sector-views`, ",
        ),
        _ => (
            format!("training from {images} stereo images of the largest of {count} sectors"),
            "less for `--splat-sector-views`, ",
        ),
    };
    let needed = training.max(end);
    match available {
        Some(available) if needed > available => Err(format!(
            "{what} needs up to {needed} bytes of memory, found {available} available: take \
             {remedy}`--preset fast`, or end at the stage before with `--to maps`"
        )
        .into()),
        _ => Ok(()),
    }
}

/// Bytes that trained sectors can take at the end: all of them, and at one time the scene around a
/// sector with its held-out images, at another copies of all with the file of one.
fn end_bytes(count: usize, held_out: &[Vec<[u64; 2]>], config: &SplatsConfig) -> u64 {
    let splats = config.train.growth.max_splats as u64;
    let parameters = splats * 4 * Plane::count(config.train.degree) as u64;
    let observed = splats * OBSERVED;
    let count = count as u64;
    let of_sector = |of: &Vec<[u64; 2]>| image_bytes(of, config) + rendered_bytes(of, config);
    let images = held_out.iter().map(of_sector).max().unwrap_or(0);
    let compared = count * parameters + images;
    let written = count * (parameters + observed) + parameters + splats * NORMAL;
    count * (parameters + observed) + compared.max(written)
}

/// Bytes of images of these sizes in memory.
fn image_bytes(pixels: &[[u64; 2]], config: &SplatsConfig) -> u64 {
    // Pixels for each sample of the combined depth.
    let sample = (config.start.step_px as u64).max(1).pow(2);
    let image = |[left, right]: &[u64; 2]| {
        let right = if config.right_images { *right } else { 0 };
        (left * (PIXEL + DEPTH) + left / sample * DEPTH + right * PIXEL) / area(config)
    };
    pixels.iter().map(image).sum()
}

/// Bytes of the largest of these images while it is rendered.
fn rendered_bytes(pixels: &[[u64; 2]], config: &SplatsConfig) -> u64 {
    largest(pixels) / area(config) * RENDERED
}

/// Pixels of a recorded image for each of a reduced one.
fn area(config: &SplatsConfig) -> u64 {
    u64::from(config.reduction) * u64::from(config.reduction)
}

fn largest(pixels: &[[u64; 2]]) -> u64 {
    pixels.iter().flatten().copied().max().unwrap_or(0)
}

/// Bytes that a training of stereo images of these sizes (left and right, px) can take.
fn needed_bytes(pixels: &[[u64; 2]], config: &SplatsConfig) -> u64 {
    // Whole images while they are read.
    let read = BATCH as u64 * 2 * largest(pixels) * (PIXEL + DEPTH);
    let planes = Plane::count(config.train.degree) as u64;
    let gaussian = 3 * 4 * planes + GATHERED;
    let gaussians = config.train.growth.max_splats as u64 * (COPIES * gaussian + 4 * planes);
    let start = config.start.max_points as u64 * VOXELS_PER_POINT * VOXEL;
    let images = image_bytes(pixels, config) + rendered_bytes(pixels, config);
    images + read + gaussians.max(start)
}
