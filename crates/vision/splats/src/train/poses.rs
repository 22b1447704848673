//! Refinement of poses: one small motion per view, with a prior.
//!
//! `world_from_camera · exp(motion)`, the motion in the camera's axes, in sigmas. It is small, so
//! that the gradient at the refined pose is taken as that with respect to the motion.

use cad_transforms::RigidTransform;

use super::adam::update;
use super::codec::{Codec, State};
use super::config::{OptimizerConfig, PoseConfig};
use crate::camera::Camera;
use crate::error::SplatError;

#[derive(Clone, Debug)]
pub(super) struct Poses {
    views: Vec<Motion>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Motion {
    values: [f32; 6],
    first: [f32; 6],
    second: [f32; 6],
    steps: usize,
}

impl Poses {
    pub(super) fn new(views: usize) -> Self {
        Self {
            views: vec![Motion::default(); views],
        }
    }

    pub(super) fn len(&self) -> usize {
        self.views.len()
    }

    /// The camera of a view at its refined pose.
    pub(super) fn of(
        &self,
        view: usize,
        camera: &Camera,
        config: &PoseConfig,
    ) -> Result<Camera, SplatError> {
        let values = self.views[view].values;
        if values == [0.0; 6] {
            return Ok(camera.clone());
        }
        let motion: [f64; 6] = std::array::from_fn(|k| f64::from(values[k] * sigma(k, config)));
        let [x, y, z, a, b, c] = motion;
        let motion = RigidTransform::from_rotation_vector([a, b, c], [x, y, z]);
        let motion = motion.map_err(|error| SplatError::Camera {
            reason: format!("its refined pose: {error}"),
        })?;
        let pose = motion.inverse() * *camera.camera_from_world();
        Ok(camera.clone().with_pose(pose))
    }

    /// Follows the gradient with respect to the motion of a view.
    pub(super) fn step(
        &mut self,
        view: usize,
        gradient: &[f64; 6],
        config: &PoseConfig,
        optimizer: &OptimizerConfig,
        corrections: &[f32],
    ) {
        let motion = &mut self.views[view];
        let correction = corrections[motion.steps.min(corrections.len() - 1)];
        motion.steps += 1;
        for k in 0..6 {
            let prior = config.prior_weight * motion.values[k];
            let gradient = gradient[k] as f32 * sigma(k, config) + prior;
            let (first, second) = (&mut motion.first[k], &mut motion.second[k]);
            motion.values[k] -=
                config.rate * update(first, second, gradient, correction, optimizer);
        }
    }
}

impl State for Motion {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        self.values.visit(codec)?;
        self.first.visit(codec)?;
        self.second.visit(codec)?;
        self.steps.visit(codec)
    }
}

impl State for Poses {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        self.views.visit(codec)
    }
}

fn sigma(component: usize, config: &PoseConfig) -> f32 {
    match component < 3 {
        true => config.position_sigma_m,
        false => config.rotation_sigma_rad,
    }
}
