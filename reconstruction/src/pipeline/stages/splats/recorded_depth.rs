//! Depth of the pixels of a recorded left image.
//!
//! Depth maps are of rectified views. A recorded pixel takes the depth of the nearest pixel of the
//! view: a mean of several would put surfaces into the air at edges.

use camera_models::{CameraModel, Lens};
use rayon::prelude::*;
use scene_bundle::outputs::depth::{DEPTH_UNIT_M, DepthImage, DepthView, SIGMA_UNIT_M};

/// For each pixel of the recorded left image the pixel of the view, and the depth along the axis of
/// the left image for a unit of depth along that of the view.
pub struct RecordedDepth {
    pixels: Vec<Option<(u32, f32)>>,
}

/// Depth and its standard deviation by recorded pixel, m; NaN where unknown.
#[derive(Debug, Default)]
pub struct DepthOfPixels {
    /// Depth along the optical axis.
    pub depth_m: Vec<f32>,
    /// Its standard deviation.
    pub sigma_m: Vec<f32>,
}

impl RecordedDepth {
    /// For a view and the lens of the recorded left image.
    pub fn new(view: &DepthView, left: &CameraModel) -> Self {
        let (recorded, pinhole) = (Lens::new(left), Lens::new(&view.model));
        let left_from_view = view.view_from_left.inverse();
        let [width, height] = [view.model.width, view.model.height];
        let pixel = |pixel: u32| {
            let at = [pixel % left.width, pixel / left.width].map(f64::from);
            let in_view = view.view_from_left.rotate(recorded.unproject(at)?);
            let [x, y] = pinhole.project(in_view)?.map(f64::round);
            let inside =
                (0.0..f64::from(width)).contains(&x) && (0.0..f64::from(height)).contains(&y);
            let ray = in_view.map(|v| v / in_view[2]);
            let along_left = left_from_view.rotate(ray)[2];
            inside.then_some((y as u32 * width + x as u32, along_left as f32))
        };
        let pixels = (0..left.width * left.height).into_par_iter();
        Self {
            pixels: pixels.map(pixel).collect(),
        }
    }

    /// Depth of an image. Errors of poses enlarge its standard deviation.
    pub fn of(&self, image: &DepthImage, pose_sigma_m: f32) -> DepthOfPixels {
        let units = |of: &[u16], pixel: u32, unit_m: f64| {
            let value = of.get(pixel as usize).copied().unwrap_or(0);
            (value > 0).then_some((f64::from(value) * unit_m) as f32)
        };
        let one = |pixel: &Option<(u32, f32)>| {
            let (pixel, along_left) = (*pixel)?;
            let depth_m = units(&image.depth, pixel, DEPTH_UNIT_M)? * along_left;
            let sigma_m = units(&image.sigma, pixel, SIGMA_UNIT_M)? * along_left;
            Some([depth_m, sigma_m.hypot(pose_sigma_m)])
        };
        let both = self
            .pixels
            .iter()
            .map(|pixel| one(pixel).unwrap_or([f32::NAN; 2]));
        let (depth_m, sigma_m) = both.map(|[depth, sigma]| (depth, sigma)).unzip();
        DepthOfPixels { depth_m, sigma_m }
    }
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;
    use camera_models::Distortion;

    use super::*;

    #[test]
    fn depth_is_along_the_axis_of_the_recorded_image() {
        let left = CameraModel::new((60, 40), [50.0, 50.0, 29.5, 19.5], Distortion::None);
        let turn = RigidTransform::from_rotation_vector([0.0, 0.1, 0.0], [0.0; 3]);
        let view = DepthView {
            camera: "front".to_owned(),
            model: left,
            view_from_left: turn.expect("finite"),
        };
        // A wall across the axis of the left image, 2 m away.
        let pinhole = Lens::new(&left);
        let left_from_view = view.view_from_left.inverse();
        let depth: Vec<f32> = (0..60 * 40)
            .map(|pixel| {
                let ray = pinhole.unproject([pixel % 60, pixel / 60].map(f64::from));
                let ray = ray.expect("a pinhole");
                let ray = ray.map(|v| v / ray[2]);
                (2.0 / left_from_view.rotate(ray)[2]) as f32
            })
            .collect();
        let image = DepthImage::from_metres(60, 40, &depth, &[0.004; 60 * 40]);
        let found = RecordedDepth::new(&view, &left).of(&image, 0.003);
        let known: Vec<usize> = (0..2400).filter(|k| found.depth_m[*k] > 0.0).collect();
        assert!(known.len() > 2000, "{}", known.len());
        for pixel in known {
            // Of the nearest pixel: the wall is oblique to the view.
            assert!((found.depth_m[pixel] - 2.0).abs() < 0.005, "{pixel}");
            assert!((found.sigma_m[pixel] - 0.005).abs() < 5e-4, "{pixel}");
        }
        let none = DepthImage::from_metres(60, 40, &[f32::NAN; 2400], &[f32::NAN; 2400]);
        let found = RecordedDepth::new(&view, &left).of(&none, 0.003);
        assert!(
            found
                .depth_m
                .iter()
                .chain(&found.sigma_m)
                .all(|v| v.is_nan())
        );
    }
}
