//! Whether both eyes agree about tags of known size.
//!
//! Contract: each eye alone has the direction of a tag, and its distance by its size. At that
//! distance both rays meet where the size of the tag and the calibration of the eyes are right. A
//! tag that is 1 % larger than stated moves them apart by 1 % of the baseline, as does a baseline
//! that is 1 % wrong; a right eye that is rotated by an angle moves them by the distance of the tag
//! times that.

use cad_transforms::RigidTransform;
use fiducials::{Config, Motion, Tag, View, refine};
use nalgebra::Vector3;

/// From the ray of the left eye to that of the right one at the distance by size: to the right and
/// down in the axes of the left eye, m; `None` if one of them alone does not show the tag.
pub(crate) fn between_eyes(
    views: &[View<'_>; 2],
    tag: &Tag,
    reference_from_tag: &RigidTransform,
    motion: &Motion,
    config: &Config,
) -> Option<[f64; 2]> {
    let left_from_reference = views[0].eye_from_reference;
    let of_eye = |eye: usize| {
        let view = [views[eye]];
        let alone = refine(&view, tag, reference_from_tag, motion, config)?;
        let at = |point: [f64; 3]| Vector3::from(left_from_reference.apply(point));
        let eye = at(views[eye].eye_from_reference.inverse().translation_m());
        let middle = at(alone.translation_m());
        Some((eye, middle))
    };
    let [(left, a), (right, b)] = [of_eye(0)?, of_eye(1)?];
    let distance = 0.5 * ((a - left).z + (b - right).z);
    let on_ray = |eye: Vector3<f64>, middle: Vector3<f64>| {
        let ray = middle - eye;
        eye + ray * (distance / ray.z)
    };
    let between = on_ray(right, b) - on_ray(left, a);
    Some([between.x, between.y])
}

#[cfg(test)]
mod tests {
    use boards::Dictionary;
    use camera_models::{CameraModel, Distortion, Lens};
    use imaging::ImageView;

    use super::*;

    const SIZE: [usize; 2] = [120, 100];
    const BASELINE_M: f64 = 0.063;

    /// A tag of 30 px seen by an eye, 16 rays per pixel.
    fn image(lens: &Lens, tag: &Tag, eye_from_tag: &RigidTransform) -> Vec<u8> {
        let tag_from_eye = eye_from_tag.inverse();
        let eye = Vector3::from(tag_from_eye.translation_m());
        let half_m = 0.5 * tag.size_m + tag.cell_m();
        let light = |pixel: [f64; 2]| {
            let ray = Vector3::from(lens.unproject(pixel).expect("inside"));
            let ray = tag_from_eye.rotation() * ray;
            let at = eye - ray * (eye.z / ray.z);
            let cell = [at.x, at.y].map(|v| ((v + half_m) / tag.cell_m()).floor());
            match cell.iter().all(|v| (0.0..10.0).contains(v)) {
                true if tag.is_white(cell[1] as usize, cell[0] as usize) => 0.6,
                true => 0.03,
                false => 0.2,
            }
        };
        let level = |k: usize| {
            let [column, row] = [k % SIZE[0], k / SIZE[0]].map(|v| v as f64);
            let part = |k: usize| 0.25 * (k as f64 + 0.5) - 0.5;
            let parts = (0..16).map(|k| light([column + part(k % 4), row + part(k / 4)]));
            (255.0 * libm::pow(parts.sum::<f64>() / 16.0, 0.45)) as u8
        };
        (0..SIZE[0] * SIZE[1]).map(level).collect()
    }

    fn between(stated_m: f64, yaw_rad: f64) -> [f64; 2] {
        let lens = Lens::new(&CameraModel::new(
            (SIZE[0] as u32, SIZE[1] as u32),
            [367.0, 367.0, 60.0, 50.0],
            Distortion::None,
        ));
        let tag = |size_m| Tag::new(Dictionary::AprilTag36h11, 3, size_m).expect("a tag");
        let pose = RigidTransform::from_rotation_vector([0.3, 0.1, 0.4], [0.02, 0.01, 1.0]);
        let pose = pose.expect("a pose");
        let right = |yaw| {
            let rotation = RigidTransform::from_rotation_vector([0.0, yaw, 0.0], [0.0; 3]);
            let moved = RigidTransform::from_translation_m([-BASELINE_M, 0.0, 0.0]);
            rotation.expect("a rotation") * moved.expect("a translation")
        };
        let eyes = [RigidTransform::identity(), right(yaw_rad)];
        let images = eyes.map(|eye| image(&lens, &tag(0.08), &(eye * pose)));
        let stated = [RigidTransform::identity(), right(0.0)];
        let views = [0, 1].map(|eye| View {
            image: ImageView::packed(SIZE[0], SIZE[1], &images[eye]).expect("an image"),
            lens: &lens,
            eye_from_reference: stated[eye],
            line_s: 0.0,
            exposure_s: 0.0,
        });
        let motion = Motion::default();
        between_eyes(&views, &tag(stated_m), &pose, &motion, &Config::default()).expect("fits")
    }

    #[test]
    fn rays_meet_where_size_and_calibration_are_right() {
        let right = between(0.08, 0.0);
        assert!(right.iter().all(|v| v.abs() < 4e-4), "{right:?}");
        // 4 % of the baseline.
        let larger = between(0.0832, 0.0);
        assert!(
            (larger[0].abs() - 0.04 * BASELINE_M).abs() < 5e-4,
            "{larger:?}"
        );
        // 0.2 degrees at one metre.
        let rotated = between(0.08, 0.0035);
        assert!((rotated[0].abs() - 0.0035).abs() < 5e-4, "{rotated:?}");
    }
}
