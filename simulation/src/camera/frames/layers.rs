//! Colors and depth of one pose: one sector, or two that are cross-faded.
//!
//! Inside of a recording all sectors show the same Gaussians. Only near a border to another
//! recording two images are rendered: colors are blended by the weight of each sector,
//! premultiplied and with what is behind, depths by weight and alpha.

use std::collections::BTreeMap;
use std::sync::Arc;

use cad_transforms::RigidTransform;
use camera_models::CameraModel;
use splats::{Camera, Exposure, Image, Renderer, Shutter};

use super::{FrameRequest, refused};
use crate::camera::CameraConfig;
use crate::camera::sensor::Quality;
use crate::error::SimulationError;
use crate::scene::{GaussianStore, SceneData, SectorGaussians, Similarity};

/// Gaussians of all sectors of a batch, in memory until it is rendered.
pub(super) struct Contents(BTreeMap<usize, Arc<SectorGaussians>>);

impl Contents {
    /// Loads or waits for what a batch needs.
    pub(super) fn load<'a>(
        store: &GaussianStore,
        batch: impl Iterator<Item = &'a Layers>,
    ) -> Result<Self, SimulationError> {
        let mut places = Vec::new();
        let mut sectors = BTreeMap::new();
        for layers in batch {
            places.push((
                layers.sector(),
                layers.request.world_from_camera.translation_m(),
            ));
            for sector in layers.sectors() {
                sectors.insert(sector, ());
            }
        }
        store.update(&places)?;
        let content = |sector: usize| Ok((sector, store.content(sector)?));
        let loaded = sectors.into_keys().map(content);
        Ok(Self(loaded.collect::<Result<_, SimulationError>>()?))
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }
}

/// Sectors that a frame shows.
pub(super) struct Layers {
    request: FrameRequest,
    fade: Option<Fade>,
}

/// The other sector.
struct Fade {
    sector: usize,
    there_from_here: Similarity,
    /// Its weight, 0 to 1.
    weight: f32,
}

impl Layers {
    pub(super) fn new(scene: &SceneData, request: &FrameRequest) -> Self {
        let at_m = request.world_from_camera.translation_m();
        let fade = scene.fade(request.sector, at_m).map(|(edge, weight)| Fade {
            sector: edge.to,
            there_from_here: edge.to_from_here,
            weight: weight as f32,
        });
        Self {
            request: *request,
            fade,
        }
    }

    pub(super) fn request(&self) -> &FrameRequest {
        &self.request
    }

    pub(super) fn sector(&self) -> usize {
        self.request.sector
    }

    pub(super) fn is_faded(&self) -> bool {
        self.fade.is_some()
    }

    fn sectors(&self) -> impl Iterator<Item = usize> {
        [
            Some(self.sector()),
            self.fade.as_ref().map(|fade| fade.sector),
        ]
        .into_iter()
        .flatten()
    }

    /// The image at a time against that of the request, s, with an exposure.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for a motion that is too fast to be finite.
    pub(super) fn image(
        &self,
        config: &CameraConfig,
        renderers: &[Renderer; 2],
        contents: &Contents,
        time_s: f64,
        exposure: &Exposure,
    ) -> Result<Image, SimulationError> {
        let pose = pose_at(&self.request, time_s);
        let render = |sector: usize, pose: &RigidTransform, scale: f64| {
            let camera = camera(config, &self.request, pose, scale)?;
            let content = &contents.0[&sector];
            let renderer = &renderers[usize::from(content.is_compensated)];
            Ok(match config.quality {
                Quality::Exact => renderer.render(&content.exact, &camera, exposure),
                Quality::Detail => renderer.render_detail(&content.detail, &camera, exposure),
            })
        };
        let mut image = render(self.sector(), &pose, 1.0)?;
        if let Some(fade) = &self.fade {
            let scale = fade.there_from_here.scale();
            let there = render(fade.sector, &fade.there_from_here.carry(&pose), scale)?;
            cross_fade(&mut image, &there, fade.weight, 1.0 / scale as f32);
        }
        Ok(image)
    }
}

/// The lens of a frame.
pub(super) fn model(config: &CameraConfig, request: &FrameRequest) -> CameraModel {
    let [fx, fy, cx, cy] = request.intrinsics_px;
    let model = config.model;
    let key = request.noise;
    let scale = config
        .variation
        .focal_scale_of(key.seed, key.episode, key.camera);
    CameraModel {
        fx: scale * model.fx + fx,
        fy: scale * model.fy + fy,
        cx: model.cx + cx,
        cy: model.cy + cy,
        ..model
    }
}

/// The camera in a sector whose lengths are `scale` times those of the request.
fn camera(
    config: &CameraConfig,
    request: &FrameRequest,
    pose: &RigidTransform,
    scale: f64,
) -> Result<Camera, SimulationError> {
    let camera = Camera::new(model(config, request), pose.inverse());
    let camera = camera.map_err(|error| refused(&error))?;
    let is_at_rest = request.velocity_m_s == [0.0; 3] && request.rate_rad_s == [0.0; 3];
    if config.shutter.line_s == 0.0 || is_at_rest {
        return Ok(camera);
    }
    let velocity_m_s = request.velocity_m_s.map(|v| v * scale);
    let (line_s, height) = (config.shutter.line_s, config.model.height);
    let shutter = Shutter::rows(line_s, height, velocity_m_s, request.rate_rad_s);
    camera
        .with_shutter(shutter)
        .map_err(|error| refused(&error))
}

/// The pose at a time against that of the request, s, at constant velocity and rate.
fn pose_at(request: &FrameRequest, time_s: f64) -> RigidTransform {
    let [translation, rotation] =
        [request.velocity_m_s, request.rate_rad_s].map(|rate| rate.map(|v| v * time_s));
    match RigidTransform::from_rotation_vector(rotation, translation) {
        Ok(motion) if time_s != 0.0 => request.world_from_camera * motion,
        _ => request.world_from_camera,
    }
}

/// Blends another image of the same camera into one; its depths are multiplied by a factor.
fn cross_fade(image: &mut Image, there: &Image, weight: f32, depth_factor: f32) {
    let here = 1.0 - weight;
    for (plane, other) in image.rgb.iter_mut().zip(&there.rgb) {
        for (value, other) in plane.iter_mut().zip(other) {
            *value = here * *value + weight * other;
        }
    }
    for pixel in 0..image.alpha.len() {
        let weights = [here * image.alpha[pixel], weight * there.alpha[pixel]];
        for (plane, other) in [
            (&mut image.median_depth_m, &there.median_depth_m),
            (&mut image.expected_depth_m, &there.expected_depth_m),
        ] {
            let depths = [plane[pixel], depth_factor * other[pixel]];
            plane[pixel] = mean_depth(depths, weights);
        }
        image.alpha[pixel] = weights[0] + weights[1];
    }
}

/// Mean of those depths that exist, by weights.
fn mean_depth(depths: [f32; 2], weights: [f32; 2]) -> f32 {
    let (mut sum, mut total) = (0.0, 0.0);
    for (depth, weight) in depths.into_iter().zip(weights) {
        if depth.is_finite() {
            sum += weight * depth;
            total += weight;
        }
    }
    match total > 0.0 {
        true => sum / total,
        false => f32::NAN,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_are_weighted_by_alpha_where_both_exist() {
        assert_eq!(mean_depth([2.0, 4.0], [0.25, 0.75]), 3.5);
        assert_eq!(mean_depth([2.0, f32::NAN], [0.25, 0.75]), 2.0);
        assert!(mean_depth([f32::NAN; 2], [0.5; 2]).is_nan());
        assert!(mean_depth([2.0, 3.0], [0.0; 2]).is_nan());
    }
}
