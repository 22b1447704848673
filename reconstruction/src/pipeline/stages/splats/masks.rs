//! Pixels that may train the scene: not the wearer, nothing that moves.
//!
//! Masks are of left images. The mask of a right image is where a masked surface can appear in it:
//! at the depth of its pixel, or anywhere from the nearest distance on where it has none.

use camera_models::{Eye, Lens};
use scene_bundle::outputs::masks::{self, Mask};
use scene_bundle::outputs::rig::RigCamera;
use scene_bundle::{BundleError, OutputReader};

/// Relative error of the depth of a masked pixel: of edges, not of the matcher.
const DEPTH_ERROR: f64 = 0.1;

/// Margin of the mask of a right image, px.
const MARGIN_PX: f64 = 1.0;

/// Usable pixels of a left image; empty if all are.
pub(super) fn left(
    reader: &OutputReader,
    camera: &RigCamera,
    frame: u64,
) -> Result<Vec<bool>, BundleError> {
    let pixels = camera.left.width as usize * camera.left.height as usize;
    let masks = [
        masks::read(reader, &camera.name, Eye::Left)?,
        masks::read_dynamic(reader, &camera.name, frame)?,
    ];
    let mut usable = Vec::new();
    for Mask { pixels: mask, .. } in masks.into_iter().flatten() {
        usable.resize(pixels, true);
        for (usable, value) in usable.iter_mut().zip(mask) {
            *usable &= value > 0;
        }
    }
    Ok(usable)
}

/// Usable pixels of the right image that belongs to a left one with its depth, m.
pub(super) fn right(
    camera: &RigCamera,
    left_mask: &[bool],
    depth_m: &[f32],
    min_distance_m: f64,
) -> Vec<bool> {
    if left_mask.is_empty() {
        return Vec::new();
    }
    let (left, right) = (Lens::new(&camera.left), Lens::new(&camera.right));
    let size = [camera.right.width, camera.right.height];
    let mut usable = vec![true; size[0] as usize * size[1] as usize];
    let masked = left_mask.iter().enumerate().filter(|(_, usable)| !**usable);
    for (pixel, _) in masked {
        let pixel = pixel as u32;
        let at = [pixel % camera.left.width, pixel / camera.left.width].map(f64::from);
        let Some(ray) = left.unproject(at).filter(|ray| ray[2] > 0.0) else {
            continue;
        };
        let z = depth_m
            .get(pixel as usize)
            .copied()
            .map_or(f64::NAN, f64::from);
        let distances = match z > 0.0 {
            true => [z * (1.0 - DEPTH_ERROR), z * (1.0 + DEPTH_ERROR)],
            false => [min_distance_m, 1e4],
        };
        let ends = distances.map(|z| {
            let in_left = ray.map(|v| v * z / ray[2]);
            right.project(camera.right_from_left.apply(in_left))
        });
        // What is too near to be in the right image has one end only.
        let ends = ends.into_iter().flatten();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for end in ends {
            for k in 0..2 {
                low[k] = low[k].min(end[k] - MARGIN_PX);
                high[k] = high[k].max(end[k] + MARGIN_PX);
            }
        }
        let range = |k: usize| {
            let from = low[k].round().max(0.0);
            let to = high[k].round().min(f64::from(size[k]) - 1.0);
            (from <= to).then_some((from as usize, to as usize))
        };
        if let (Some((left, right)), Some((top, bottom))) = (range(0), range(1)) {
            for row in top..=bottom {
                let row = row * size[0] as usize;
                usable[row + left..=row + right].fill(false);
            }
        }
    }
    usable
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;
    use camera_models::{CameraModel, Distortion};

    use super::*;

    fn camera() -> RigCamera {
        let model = CameraModel::new((120, 60), [100.0, 100.0, 59.5, 29.5], Distortion::None);
        let beside = RigidTransform::from_translation_m([-0.1, 0.0, 0.0]);
        RigCamera {
            name: "front".to_owned(),
            left: model,
            right: model,
            rig_from_left: RigidTransform::identity(),
            rig_from_left_covariance: None,
            right_from_left: beside.expect("finite"),
            right_from_left_covariance: None,
            line_s: 0.0,
        }
    }

    /// Columns of a row that are masked.
    fn masked(mask: &[bool], row: usize) -> Vec<usize> {
        (0..120).filter(|x| !mask[row * 120 + x]).collect()
    }

    #[test]
    fn masks_follow_the_disparity() {
        let mut mask = vec![true; 120 * 60];
        mask[30 * 120 + 80] = false;
        let mut depth = vec![f32::NAN; 120 * 60];
        // 10 px of disparity at 1 m.
        depth[30 * 120 + 80] = 1.0;
        let found = right(&camera(), &mask, &depth, 0.25);
        let columns = masked(&found, 30);
        assert!(
            columns.contains(&70) && !columns.contains(&80),
            "{columns:?}"
        );
        assert!(columns.len() < 8, "{columns:?}");
        assert!(masked(&found, 26).is_empty() && masked(&found, 34).is_empty());
        // Without depth anywhere from 0.25 m on: 40 px.
        let found = right(&camera(), &mask, &[], 0.25);
        let columns = masked(&found, 30);
        assert_eq!((columns.first(), columns.last()), (Some(&39), Some(&81)));
        assert!(right(&camera(), &[], &depth, 0.25).is_empty());
    }
}
