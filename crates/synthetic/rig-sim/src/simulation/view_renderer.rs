//! Renders the static scene from any pose, without the errors of a sensor.

use camera_models::CameraModel;

use crate::camera::placed::placed;
use crate::camera::sensor::{Exposure, SensorModel};
use crate::camera::truth::{Pose, TruthCamera};
use crate::camera::{MonoCamera, Quality, Shot, Shutter};
use crate::scene::surface::Class;

use super::Simulation;
use super::frame_renderer::rgb_of;

/// Samples per pixel.
const SAMPLES: u32 = 4;
/// Time over which nothing moves, s.
const INSTANT_S: f64 = 1e-7;

/// An image of the static scene, rows first.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewImage {
    /// Red, green, blue.
    pub rgb: Vec<[u8; 3]>,
    /// Depth along the optical axis, m; infinite for the sky. Panes count as surfaces.
    pub depth_m: Vec<f32>,
    /// Class of the surface.
    pub class: Vec<Class>,
}

/// Renders the static scene from any pose: without people and wearer, noise, motion blur, flare and
/// dirt, at a given exposure. Vignetting, softness of the lens and subsampled colors are those of
/// the simulated cameras.
pub struct ViewRenderer<'a> {
    simulation: &'a Simulation,
    camera: MonoCamera,
    truth: TruthCamera,
    size: [usize; 2],
}

impl<'a> ViewRenderer<'a> {
    /// A camera with an even number of columns and rows.
    pub(super) fn new(simulation: &'a Simulation, model: &CameraModel, shutter: Shutter) -> Self {
        let sensor = SensorModel {
            noiseless: true,
            ..simulation.imaging.sensor(0)
        };
        let quality = Quality {
            samples: SAMPLES,
            max_samples: SAMPLES,
            noise: false,
        };
        Self {
            simulation,
            camera: MonoCamera::new(model, shutter, sensor, quality),
            truth: TruthCamera::new(model, shutter),
            size: [model.width as usize, model.height as usize],
        }
    }

    /// Renders the image of a time, s. `eye_pose` is the pose of the optical frame in the world,
    /// which a rolling shutter takes at the time of each row.
    pub fn render(
        &mut self,
        eye_pose: &dyn Fn(f64) -> Pose,
        time_s: f64,
        exposure: &Exposure,
    ) -> ViewImage {
        let scene = self.simulation.scene();
        let mut still = placed(scene);
        still.truncate(still.len() - scene.moving.len());
        let shot = Shot {
            time_s,
            exposure: Exposure {
                seconds: INSTANT_S,
                gain: exposure.gain,
            },
            quality: Quality {
                samples: SAMPLES,
                max_samples: SAMPLES,
                noise: false,
            },
            noise: 0,
        };
        self.camera.expose(scene, &still, eye_pose, &shot);
        self.camera.soften();
        let [width, height] = self.size;
        let mut i420 = vec![0; width * height * 3 / 2];
        let (luma, chroma) = i420.split_at_mut(width * height);
        let (cb, cr) = chroma.split_at_mut(width * height / 4);
        self.camera.develop(exposure, 0, luma, [cb, cr], width);
        let truth = self.truth.render(scene, &still, eye_pose, time_s);
        ViewImage {
            rgb: rgb_of(&i420, [width, height], 0..width),
            depth_m: truth.depth,
            class: truth.class,
        }
    }
}
