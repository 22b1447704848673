//! Depth from the two images of a stereo frame.
//!
//! Contract: depth is that of the rectified left image, cropped to the largest part in which both
//! are valid. Pixels whose sigma is more than `max_relative_sigma` of their depth have none.
//! Disparities are searched up to that of `min_distance_m`, as far as the matcher can.
//! [`StereoPair::disparity`] is the only function that computes disparity, by the user's network if
//! there is one.

use std::borrow::Cow;

use cad_transforms::RigidTransform;
use camera_models::rectify::{Rectification, Remap, View};
use camera_models::{CameraModel, Eye};
use depth::{Band, BandedMatcher, DisparityMap, Geometry};
use scene_bundle::outputs::depth::DepthImage;
use scene_bundle::outputs::rig::RigCamera;

use super::config::DepthStageConfig;
use crate::pipeline::StageError;
use crate::pipeline::stages::networks::Networks;
use crate::pipeline::stages::rig;

/// Maximum number of disparities that the matcher can search.
const MAX_DISPARITIES: usize = 256;

/// A stereo camera, prepared for its images.
pub(super) struct StereoPair {
    rectification: Rectification,
    remaps: [Remap; 2],
    matcher: BandedMatcher,
    max_relative_sigma: f64,
    rectified: [Vec<u8>; 2],
}

impl StereoPair {
    pub(super) fn new(camera: &RigCamera, config: &DepthStageConfig) -> Result<Self, StageError> {
        let rectification = Rectification::new(&rig::calibration(camera), View::Filled)?;
        let remaps = [(Eye::Left, camera.left), (Eye::Right, camera.right)]
            .map(|(eye, old)| Remap::new(&rectification.map(eye), old.width, old.height));
        let model = rectification.camera;
        let (width, height) = (model.width as usize, model.height as usize);
        let nearest =
            (model.fx * rectification.baseline_m / config.min_distance_m).ceil() as usize + 1;
        let band = Band::full(0, nearest.min(MAX_DISPARITIES), height)?;
        Ok(Self {
            rectified: [(); 2].map(|()| vec![0; width * height]),
            matcher: BandedMatcher::new(config.matching, width, band)?,
            max_relative_sigma: config.max_relative_sigma,
            remaps,
            rectification,
        })
    }

    /// Camera model of the depth maps.
    pub(super) fn model(&self) -> CameraModel {
        self.rectification.camera
    }

    /// Rotates points of the recorded left optical frame to that of the depth maps.
    pub(super) fn view_from_left(&self) -> RigidTransform {
        self.rectification.rectified_from_left
    }

    /// Depth of the next frame; images are luma as recorded.
    pub(super) fn depth(
        &mut self,
        left: &[u8],
        right: &[u8],
        networks: &Networks,
    ) -> Result<DepthImage, StageError> {
        let [to_left, to_right] = &mut self.rectified;
        rayon::join(
            || self.remaps[0].apply_to(left, 0, to_left),
            || self.remaps[1].apply_to(right, 0, to_right),
        );
        let model = self.rectification.camera;
        let geometry = Geometry {
            focal_px: model.fx,
            center: [model.cx, model.cy],
            baseline_m: self.rectification.baseline_m,
            offset_px: 0.0,
        };
        let max_relative_sigma = self.max_relative_sigma;
        let disparity = self.disparity(networks)?;
        let depth = geometry.depth(&disparity, max_relative_sigma)?;
        Ok(DepthImage::from_metres(
            model.width,
            model.height,
            &depth.depth_m,
            &depth.sigma_m,
        ))
    }

    /// Disparity of the rectified images.
    fn disparity(&mut self, networks: &Networks) -> Result<Cow<'_, DisparityMap>, StageError> {
        let model = self.rectification.camera;
        let image =
            |pixels| depth::ImageView::packed(model.width as usize, model.height as usize, pixels);
        let [left, right] = &self.rectified;
        let (left, right) = (image(left)?, image(right)?);
        if let Some(map) = networks.disparity(left, right)? {
            return Ok(Cow::Owned(map));
        }
        let (map, _) = self.matcher.run(&left, &right, None)?;
        Ok(Cow::Borrowed(map))
    }
}

#[cfg(test)]
mod tests {
    use camera_models::Distortion;

    use super::*;
    use crate::pipeline::stages::Preset;

    const WIDTH: usize = 320;
    const HEIGHT: usize = 160;
    const FOCAL: f64 = 200.0;
    const BASELINE_M: f64 = 0.1;

    fn camera() -> RigCamera {
        let lens = CameraModel {
            width: WIDTH as u32,
            height: HEIGHT as u32,
            fx: FOCAL,
            fy: FOCAL,
            cx: 0.5 * (WIDTH - 1) as f64,
            cy: 0.5 * (HEIGHT - 1) as f64,
            distortion: Distortion::None,
        };
        let beside = RigidTransform::from_translation_m([-BASELINE_M, 0.0, 0.0]);
        RigCamera {
            name: "front".to_owned(),
            left: lens,
            right: lens,
            rig_from_left: RigidTransform::identity(),
            rig_from_left_covariance: None,
            right_from_left: beside.expect("finite"),
            right_from_left_covariance: None,
            line_s: 0.0,
        }
    }

    /// A textured wall at a disparity of `shift` pixels.
    fn wall(shift: usize) -> Vec<u8> {
        let pixel = |i: usize| {
            let (x, y) = ((i % WIDTH + shift) as u64, (i / WIDTH) as u64);
            let mixed = (x / 2 * 7919 + y / 2 * 104_729).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            (mixed >> 57) as u8 + 60
        };
        (0..WIDTH * HEIGHT).map(pixel).collect()
    }

    #[test]
    fn a_wall_has_its_depth() {
        let shift = 10;
        let mut pair =
            StereoPair::new(&camera(), &DepthStageConfig::preset(Preset::Fast)).expect("a pair");
        let scale = pair.model().fx / FOCAL;
        let found = pair
            .depth(&wall(0), &wall(shift), &Networks::default())
            .expect("depth");
        let middle = found.depth[WIDTH * HEIGHT / 2 + WIDTH / 2];
        let expected_mm = 1e3 * FOCAL * BASELINE_M / shift as f64;
        assert!(
            (f64::from(middle) - expected_mm).abs() < 0.02 * expected_mm,
            "{middle}"
        );
        assert!((scale - 1.0).abs() < 0.01, "{scale}");
    }

    #[test]
    fn images_without_texture_have_no_depth() {
        let mut pair = StereoPair::new(&camera(), &DepthStageConfig::default()).expect("a pair");
        let flat = vec![120; WIDTH * HEIGHT];
        let found = pair
            .depth(&flat, &flat, &Networks::default())
            .expect("an image");
        assert!(found.depth.iter().all(|d| *d == 0));
    }
}
