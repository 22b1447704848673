//! A simulated stereo camera: rendering of both images.
//!
//! Contract: an image is a function of scene, walk, camera, seed and frame number, independent of
//! what was rendered before, except for the exposure, which follows the previous images as in a
//! device. A camera's timestamp is the middle of the exposure of its middle row.

pub mod codec;
pub mod glass;
mod gloss;
pub mod optics;
pub mod placed;
pub mod raster;
mod rows;
pub mod sensor;
pub mod shade;
pub mod truth;

use camera_models::CameraModel;
use nalgebra::{UnitQuaternion, Vector3};

use self::optics::Conditions;
pub use self::placed::{Motion, SceneBody, placed};
use self::raster::{View, Visibility};
use self::rows::Rows;
use self::sensor::{AutoExposure, Exposure, Sensor, SensorModel};
use self::shade::{Radiance, VisibleBody};
use crate::lens::Lens;
use crate::random;
use crate::scene::Scene;
use cad_transforms::so3;

/// A small camera without distortion, for tests: x right, y down, z forward.
#[cfg(test)]
const TEST_CAMERA: CameraModel = CameraModel {
    width: 160,
    height: 120,
    fx: 100.0,
    fy: 100.0,
    cx: 79.5,
    cy: 59.5,
    distortion: camera_models::Distortion::None,
};

/// Shutter: exposure times of the rows of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shutter {
    /// All rows simultaneously.
    Global,
    /// One row after the other.
    Rolling {
        /// Readout line time, s.
        line_s: f64,
    },
}

impl Shutter {
    /// Exposure time of a row relative to the middle of the image, s.
    pub fn row_s(self, row: usize, height: usize) -> f64 {
        match self {
            Self::Global => 0.0,
            Self::Rolling { line_s } => line_s * (row as f64 - 0.5 * (height - 1) as f64),
        }
    }
}

/// Rendering quality.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Samples per image without motion, at different positions within the pixel; from about 4 on
    /// edges are smooth.
    pub samples: u32,
    /// Maximum samples over an exposure with motion.
    pub max_samples: u32,
    /// Whether sensors have noise.
    pub noise: bool,
}

impl Quality {
    /// For recording in real time.
    pub const FAST: Self = Self {
        samples: 1,
        max_samples: 1,
        noise: true,
    };
    /// For evaluation.
    pub const ACCURATE: Self = Self {
        samples: 4,
        max_samples: 12,
        noise: true,
    };
}

/// Renderer of one eye of a stereo camera.
#[derive(Debug)]
pub struct MonoCamera {
    lens: Lens,
    shutter: Shutter,
    /// Ray grids: the pixel center, and one per sample.
    grids: Vec<Grid>,
    sensor: Sensor,
    visibility: Visibility,
    /// Visibility of the nearest panes; [`glass`].
    panes: Visibility,
    radiance: Radiance,
    /// A single sample, where panes have to be blended before averaging.
    sample: Radiance,
}

/// Stages of rendering an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Poses of eye and bodies.
    Poses,
    /// Visible triangle of each pixel.
    Visibility,
    /// Light of each pixel.
    Shading,
}

/// Parameters of one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot {
    /// Middle of the exposure of the middle row, s.
    pub time_s: f64,
    /// Exposure time and gain.
    pub exposure: Exposure,
    /// Rendering quality.
    pub quality: Quality,
    /// Seed of the noise; different for every image.
    pub noise: u64,
}

/// Rays of all pixel centers, offset by the same fraction of a pixel.
#[derive(Debug)]
struct Grid {
    /// Offset, px.
    shift: (f32, f32),
    /// Row-major.
    rays: Vec<[f32; 2]>,
}

/// Sample offsets within a pixel: its center, then pairs on opposite sides of it, evenly spread
/// (Roberts' R2 sequence, 2018). The mean of an even number of them from 1 on is the center, so
/// images do not shift with the number of samples.
fn shift(k: u32) -> (f32, f32) {
    if k == 0 {
        return (0.0, 0.0);
    }
    let side = if k % 2 == 1 { 1.0 } else { -1.0 };
    let part = |step: f64| {
        let v = 0.5 + step * f64::from(k.div_ceil(2));
        (side * (v - v.floor() - 0.5)) as f32
    };
    (part(0.754_877_666_246_693), part(0.569_840_290_998_053))
}

impl MonoCamera {
    /// A camera with this lens model and shutter.
    pub fn new(
        model: &CameraModel,
        shutter: Shutter,
        sensor: SensorModel,
        quality: Quality,
    ) -> Self {
        let lens = Lens::new(model);
        let grid = |k: u32| {
            let shift = shift(k);
            let rays = lens.rays((f64::from(shift.0), f64::from(shift.1)));
            Grid { shift, rays }
        };
        let shifted = match quality.samples.max(quality.max_samples) {
            0 | 1 => 0,
            most => most,
        };
        let grids: Vec<Grid> = (0..=shifted).map(grid).collect();
        let (width, height) = (model.width as usize, model.height as usize);
        Self {
            sensor: Sensor::new(
                SensorModel {
                    noiseless: !quality.noise || sensor.noiseless,
                    ..sensor
                },
                &grids[0].rays,
            ),
            visibility: Visibility::new(&lens),
            panes: Visibility::new(&lens),
            lens,
            shutter,
            grids,
            radiance: Radiance::new(width, height),
            sample: Radiance::new(width, height),
        }
    }

    /// The lens model.
    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// Renders the light of a shot. `eye_pose` is the pose of the optical frame in the world; the
    /// first body is [`Scene::fixed`], at the world origin.
    pub fn expose(
        &mut self,
        scene: &Scene,
        placed: &[SceneBody<'_>],
        eye_pose: &dyn Fn(f64) -> (Vector3<f64>, UnitQuaternion<f64>),
        shot: &Shot,
    ) -> &Radiance {
        self.expose_in_stages(scene, placed, eye_pose, shot, &mut |_| {})
    }

    /// As [`MonoCamera::expose`]; `done` is called after each stage of each sample.
    pub fn expose_in_stages(
        &mut self,
        scene: &Scene,
        placed: &[SceneBody<'_>],
        eye_pose: &dyn Fn(f64) -> (Vector3<f64>, UnitQuaternion<f64>),
        shot: &Shot,
        done: &mut dyn FnMut(Stage),
    ) -> &Radiance {
        let samples = self.samples(eye_pose, shot);
        self.radiance.clear();
        for k in 0..samples {
            let part = (f64::from(k) + 0.5) / f64::from(samples) - 0.5;
            let at = shot.time_s + shot.exposure.seconds * part;
            let views = self.views_of_seen(placed, eye_pose, at);
            done(Stage::Poses);
            // A single sample is at the center.
            let grid = match self.grids.len() - 1 {
                0 => 0,
                _ if samples == 1 => 0,
                shifted => 1 + k as usize % shifted,
            };
            let Grid { shift, rays } = &self.grids[grid];
            self.visibility.clear();
            for (body, views) in placed.iter().zip(&views) {
                self.visibility
                    .draw(body.body, body.first, &self.lens, *shift, views);
            }
            done(Stage::Visibility);
            let seen: Vec<VisibleBody<'_>> = placed
                .iter()
                .zip(&views)
                .map(|(p, views)| VisibleBody {
                    first: p.first,
                    surfaces: &p.body.surfaces,
                    views,
                })
                .collect();
            let has_glass = !scene.glass.triangles.is_empty();
            let into = match has_glass {
                true => &mut self.sample,
                false => &mut self.radiance,
            };
            let weight = 1.0 / samples as f32;
            let noise = random::bits(shot.noise, random::SENSOR + 3, u64::from(k));
            if has_glass {
                into.clear();
            }
            shade::add(into, scene, &self.visibility, &seen, rays, weight, noise);
            if scene.gloss > 0.0 {
                gloss::add(into, scene, &self.visibility, &views[0], rays, weight);
            }
            if has_glass {
                self.panes.clear();
                self.panes
                    .draw(&scene.glass, 0, &self.lens, *shift, &views[0]);
                glass::cover(
                    into,
                    scene,
                    &self.visibility,
                    &self.panes,
                    &views[0],
                    rays,
                    weight,
                );
                self.radiance.add(&self.sample);
            }
            done(Stage::Shading);
        }
        self.flicker(scene, shot.time_s, &shot.exposure);
        &self.radiance
    }

    /// Applies flare, dirt, blur and covers to the last exposed light, in a shot from `eye_pose`;
    /// `which` is 0 for a left eye, 1 for a right one.
    pub fn degrade(
        &mut self,
        scene: &Scene,
        eye_pose: &(Vector3<f64>, UnitQuaternion<f64>),
        conditions: &Conditions,
        which: u64,
    ) {
        if let Some(sun) = optics::sun(scene, eye_pose) {
            let at = sun.position(&self.lens);
            self.radiance.flare(&sun, &self.grids[0].rays, at);
        }
        self.radiance.soften();
        self.radiance.degrade(conditions, which);
    }

    /// Applies the softness of the lens alone.
    pub(crate) fn soften(&mut self) {
        self.radiance.soften();
    }

    /// Blurs the luminance of the last exposed light by about a Gaussian of this sigma.
    pub(crate) fn blur(&mut self, sigma_px: f32) {
        self.radiance.blur(sigma_px);
    }

    /// Converts the last exposed light to pixel values; see [`Sensor::develop`].
    pub fn develop(
        &self,
        exposure: &Exposure,
        noise: u64,
        luma: &mut [u8],
        chroma: [&mut [u8]; 2],
        stride: usize,
    ) -> f64 {
        self.sensor
            .develop(&self.radiance, exposure, noise, luma, chroma, stride)
    }

    /// Number of samples of an exposure, such that nothing moves by more than about 0.7 px between
    /// two, by the camera's own motion and a scene 1.5 m away.
    fn samples(
        &self,
        eye_pose: &dyn Fn(f64) -> (Vector3<f64>, UnitQuaternion<f64>),
        shot: &Shot,
    ) -> u32 {
        let half = 0.5 * shot.exposure.seconds;
        let quality = &shot.quality;
        let (a, b) = (eye_pose(shot.time_s - half), eye_pose(shot.time_s + half));
        let rotation = so3::log(&(a.1.inverse() * b.1)).norm();
        let moved = (a.0 - b.0).norm() / 1.5;
        let px = self.lens.model().fx * (rotation + moved);
        let wanted = (px / 0.7).ceil() as u32;
        let most = quality.max_samples.max(quality.samples).max(1);
        match wanted.clamp(quality.samples.max(1), most) {
            1 => 1,
            // Pairs: see `shift`.
            several => several.next_multiple_of(2).min(most),
        }
    }

    /// Pose of the camera in each body's frame: once, or for each row; only a few rows for bodies
    /// outside the view.
    fn views_of_seen(
        &self,
        placed: &[SceneBody<'_>],
        eye_pose: &dyn Fn(f64) -> (Vector3<f64>, UnitQuaternion<f64>),
        time_s: f64,
    ) -> Vec<Vec<View>> {
        let rows = Rows::new(self.shutter, self.visibility.height, eye_pose, time_s);
        let of = |body: &SceneBody<'_>| {
            let few = rows.few(body.pose);
            match few.len() > 1 && self.visibility.may_see(body.body, &few) {
                true => rows.views(body.pose),
                false => few,
            }
        };
        placed.iter().map(of).collect()
    }

    /// Flicker varies brightness by row, or by frame.
    fn flicker(&mut self, scene: &Scene, time_s: f64, exposure: &Exposure) {
        if scene.light.flicker.is_none() {
            return;
        }
        let (width, height) = (self.visibility.width, self.visibility.height);
        for row in 0..height {
            let off = match self.shutter {
                Shutter::Global => 0.0,
                Shutter::Rolling { line_s } => line_s * (row as f64 - 0.5 * (height - 1) as f64),
            };
            let from = time_s + off - 0.5 * exposure.seconds;
            let factor = scene.light.flicker_factor(from, exposure.seconds) as f32;
            for v in &mut self.radiance.luminance[row * width..(row + 1) * width] {
                *v *= factor;
            }
            if row % 2 == 0 {
                let half = width / 2;
                for c in &mut self.radiance.color[row / 2 * half..(row / 2 + 1) * half] {
                    *c = c.map(|v| v * factor);
                }
            }
        }
    }
}

/// Automatic exposure of a camera, shared by both eyes.
pub(crate) fn auto_exposure(max_s: f64) -> AutoExposure {
    AutoExposure::new(max_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sample_offsets_are_balanced_about_the_pixel_center() {
        assert_eq!(shift(0), (0.0, 0.0));
        for count in [2, 4, 8, 12] {
            let all: Vec<(f32, f32)> = (1..=count).map(shift).collect();
            let sum = all
                .iter()
                .fold((0.0, 0.0), |sum, s| (sum.0 + s.0, sum.1 + s.1));
            assert_eq!(sum, (0.0, 0.0), "{count}");
            assert!(all.iter().all(|s| s.0.abs() <= 0.5 && s.1.abs() <= 0.5));
            // All offsets differ.
            let far = |a: &(f32, f32), b: &(f32, f32)| (a.0 - b.0).abs() + (a.1 - b.1).abs() > 0.05;
            assert!((1..all.len()).all(|i| all[..i].iter().all(|other| far(&all[i], other))));
        }
    }
}
