//! Depth of a rectified view, warped to the image as it was recorded.
//!
//! Contract: each pixel of the target takes the depth of the nearest pixel of the view, no
//! interpolation: there is no surface between foreground and background. Depth is along the
//! target's own z axis.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Lens};

use crate::outputs::depth::{DepthImage, DepthView};

/// For each pixel of the target: index of the source pixel, and factor on its depth.
pub(super) struct DepthWarp {
    width: u32,
    height: u32,
    from: Vec<Option<(usize, f32)>>,
}

impl DepthWarp {
    /// From a view to an image with the same optical center.
    pub(super) fn new(view: &DepthView, target: &CameraModel) -> Self {
        let same = view.model == *target && view.view_from_left == RigidTransform::identity();
        let lens = Lens::new(target);
        let source = &view.model;
        let look = |column: u32, row: u32| {
            if same {
                return Some((row as usize * source.width as usize + column as usize, 1.0));
            }
            let ray = lens.unproject([f64::from(column), f64::from(row)])?;
            let [x, y, z] = view.view_from_left.rotate(ray);
            if z <= 0.0 {
                return None;
            }
            let at = [source.fx * x / z + source.cx, source.fy * y / z + source.cy].map(f64::round);
            let inside = (0.0..f64::from(source.width)).contains(&at[0])
                && (0.0..f64::from(source.height)).contains(&at[1]);
            // The point is ray * depth / z, and its depth in the target the third of that.
            inside.then(|| {
                (
                    at[1] as usize * source.width as usize + at[0] as usize,
                    (ray[2] / z) as f32,
                )
            })
        };
        let pixels =
            (0..target.height).flat_map(|row| (0..target.width).map(move |column| (column, row)));
        Self {
            width: target.width,
            height: target.height,
            from: pixels.map(|(column, row)| look(column, row)).collect(),
        }
    }

    /// Depth for each pixel in the units it is stored in; 0 is none.
    pub(super) fn depth(&self, image: &DepthImage) -> Vec<u16> {
        let taken = self.from.iter().map(|from| match from {
            Some((at, factor)) => {
                let units = (f32::from(image.depth[*at]) * factor).round();
                if (1.0..=65535.0).contains(&units) {
                    units as u16
                } else {
                    0
                }
            }
            None => 0,
        });
        taken.collect()
    }

    pub(super) fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }
}

#[cfg(test)]
mod tests {
    use camera_models::Distortion;

    use super::*;

    /// An oblique plane in the view, warped to a distorted image that is rotated against it: the
    /// depth must be that of the plane.
    #[test]
    fn the_depth_of_a_plane_is_that_of_the_target_image() {
        let view = DepthView {
            camera: "feet".to_owned(),
            model: CameraModel::new((320, 240), [200.0, 200.0, 159.5, 119.5], Distortion::None),
            view_from_left: RigidTransform::from_rotation_vector([0.02, -0.05, 0.03], [0.0; 3])
                .unwrap(),
        };
        let distortion = Distortion::RadTan4 {
            k1: -0.1,
            k2: 0.01,
            p1: 0.001,
            p2: 0.0,
        };
        let target = CameraModel::new((300, 200), [220.0, 221.0, 150.0, 101.0], distortion);
        // In the view: normal . x = 2 m.
        let normal = [0.3, -0.2, 0.9];
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let depth_m: Vec<f32> = (0..240 * 320)
            .map(|i| {
                let (x, y) = (f64::from(i % 320), f64::from(i / 320));
                let ray = [(x - 159.5) / 200.0, (y - 119.5) / 200.0, 1.0];
                (2.0 / dot(normal, ray)) as f32
            })
            .collect();
        let image = DepthImage::from_metres(320, 240, &depth_m, &vec![0.01; depth_m.len()]);
        let depth_warp = DepthWarp::new(&view, &target);
        let drawn = depth_warp.depth(&image);
        assert_eq!(depth_warp.size(), (300, 200));
        let lens = Lens::new(&target);
        let mut compared = 0;
        for row in 0..200_u32 {
            for column in 0..300_u32 {
                let found = drawn[(row * 300 + column) as usize];
                if found == 0 {
                    continue;
                }
                let ray = lens.unproject([f64::from(column), f64::from(row)]).unwrap();
                let true_m = 2.0 / dot(normal, view.view_from_left.rotate(ray)) * ray[2];
                // Half a pixel of the view changes the depth of the plane by up to 0.5 / 200 * 0.6
                // of it; rounding twice loses a millimetre.
                let off = (f64::from(found) * 1e-3 - true_m).abs();
                assert!(
                    off < 0.003 * true_m + 0.001,
                    "({column}, {row}): {found} mm, {true_m} m"
                );
                compared += 1;
            }
        }
        assert!(compared > 50_000, "{compared}");
    }

    #[test]
    fn depth_of_an_identical_view_is_unchanged() {
        let model = CameraModel::new((3, 2), [2.0, 2.0, 1.0, 0.5], Distortion::None);
        let view = DepthView {
            camera: "feet".to_owned(),
            model,
            view_from_left: RigidTransform::identity(),
        };
        let image =
            DepthImage::from_metres(3, 2, &[1.0, 2.0, 0.0, 65.535, 66.0, f32::NAN], &[0.1; 6]);
        assert_eq!(
            DepthWarp::new(&view, &model).depth(&image),
            [1000, 2000, 0, 65535, 0, 0]
        );
    }
}
