//! Colors and depth of one pose: one sector, or two that are cross-faded.
//!
//! Inside of a recording all sectors show the same Gaussians. Only near a border to another
//! recording two images are rendered.

use std::collections::BTreeMap;
use std::sync::Arc;

use cad_transforms::RigidTransform;
use camera_models::CameraModel;
use splats::{Camera, Exposure, Image, Renderer, Shutter};

use super::fade::{cross_fade, enlarge, half};
use super::{FrameRequest, refused};
use crate::camera::CameraConfig;
use crate::camera::sensor::{Quality, scaled_model};
use crate::error::SimulationError;
use crate::scene::{GaussianStore, SceneData, SectorGaussians, Similarity};

/// Weights this near to a half are those of equal sides.
const EQUAL_WEIGHTS: f32 = 0.05;

/// Gaussians of all sectors of a batch, in memory until it is rendered.
pub(super) struct Contents(BTreeMap<usize, Arc<SectorGaussians>>);

impl Contents {
    /// Loads or waits for what a batch needs.
    pub(super) fn load(store: &GaussianStore, batch: &[Layers]) -> Result<Self, SimulationError> {
        let places = batch.iter().map(|layers| {
            let at_m = layers.request.world_from_camera.translation_m();
            (layers.sector(), at_m)
        });
        let contents = store.contents(&places.collect::<Vec<_>>())?;
        Ok(Self(contents))
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

    /// # Errors
    /// [`SimulationError::Setting`] for a motion that is too fast to be finite at a time against
    /// that of the request, s.
    pub(super) fn check(&self, config: &CameraConfig, time_s: f64) -> Result<(), SimulationError> {
        if is_at_rest(&self.request) {
            return Ok(());
        }
        let pose = pose_at(&self.request, time_s);
        let scale = self
            .fade
            .as_ref()
            .map_or(1.0, |fade| fade.there_from_here.scale());
        camera(config, &self.request, &pose, scale.max(1.0), false).map(drop)
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
        let render = |sector: usize, pose: &RigidTransform, scale: f64, is_half: bool| {
            let camera = camera(config, &self.request, pose, scale, is_half)?;
            let content = &contents.0[&sector];
            let renderer = &renderers[usize::from(content.is_compensated)];
            let image = match config.quality {
                Quality::Exact => renderer.render(&content.exact, &camera, exposure),
                Quality::Detail => renderer.render_detail(&content.detail, &camera, exposure),
            };
            let size = [config.model.width, config.model.height].map(|edge| edge as usize);
            Ok(match is_half {
                true => enlarge(&image, size),
                false => image,
            })
        };
        let Some(fade) = &self.fade else {
            return render(self.sector(), &pose, 1.0, false);
        };
        let is_fast = config.quality == Quality::Detail;
        // Along a border of equal depths both weights are nearly a half: the sides do not take
        // turns there.
        let here_is_less = match (fade.weight - 0.5).abs() < EQUAL_WEIGHTS {
            true => fade.sector < self.sector(),
            false => fade.weight > 0.5,
        };
        let scale = fade.there_from_here.scale();
        let pose_there = fade.there_from_here.carry(&pose);
        let mut image = render(self.sector(), &pose, 1.0, is_fast && here_is_less)?;
        let there = render(fade.sector, &pose_there, scale, is_fast && !here_is_less)?;
        cross_fade(&mut image, &there, fade.weight, 1.0 / scale as f32);
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

/// The camera in a sector whose lengths are `scale` times those of the request, with all pixels or
/// half the columns and rows.
fn camera(
    config: &CameraConfig,
    request: &FrameRequest,
    pose: &RigidTransform,
    scale: f64,
    is_half: bool,
) -> Result<Camera, SimulationError> {
    let whole = model(config, request);
    let model = match is_half {
        true => scaled_model(&whole, half([whole.width, whole.height]))?,
        false => whole,
    };
    let camera = Camera::new(model, pose.inverse());
    let camera = camera.map_err(|error| refused(&error))?;
    if config.shutter.line_s == 0.0 || is_at_rest(request) {
        return Ok(camera);
    }
    let velocity_m_s = request.velocity_m_s.map(|v| v * scale);
    // Fewer rows take the same time.
    let line_s = config.shutter.line_s * f64::from(whole.height) / f64::from(model.height);
    let shutter = Shutter::rows(line_s, model.height, velocity_m_s, request.rate_rad_s);
    camera
        .with_shutter(shutter)
        .map_err(|error| refused(&error))
}

fn is_at_rest(request: &FrameRequest) -> bool {
    request.velocity_m_s == [0.0; 3] && request.rate_rad_s == [0.0; 3]
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
