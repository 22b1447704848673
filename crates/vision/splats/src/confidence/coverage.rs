//! What the views of a training saw of a scene.

use rayon::prelude::*;

use super::config::CoverageConfig;
use super::directions::Directions;
use super::rays;
use super::sky::ObservedSky;
use super::space::ObservedSpace;
use crate::camera::Camera;
use crate::error::SplatError;
use crate::render::{Observation, Pass, PixelErrors, Renderer};
use crate::scene::{Exposure, Plane, Scene};
use crate::train::TrainingView;

/// What views saw of a Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ObservedGaussian {
    /// Instants that saw it.
    pub instants: u32,
    /// Directions from its mean to the cameras that saw it.
    pub directions: Directions,
    /// Finest size of a pixel at its mean, depth over focal length, m; 0 if no instant saw it.
    pub finest_m: f32,
    /// Root of the mean squared error of the colors to which it contributes, 0 to 1.
    pub color_error: f32,
    /// Mean relative error of the median depth where it contributes and depth was measured, at most
    /// 1; NaN where none was.
    pub depth_error: f32,
}

/// What views saw of a scene: of each Gaussian, of the space between cameras and surfaces, and of
/// the sky.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage {
    pub(super) gaussians: Vec<ObservedGaussian>,
    pub(super) space: ObservedSpace,
    pub(super) sky: ObservedSky,
}

/// Sums over the pixels of all views, of one Gaussian.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    weight: f64,
    color: f64,
    depth_weight: f64,
    depth: f64,
}

impl Sums {
    fn add(&mut self, of_view: &Observation) {
        self.weight += f64::from(of_view.weight);
        self.color += f64::from(of_view.color);
        self.depth_weight += f64::from(of_view.depth_weight);
        self.depth += f64::from(of_view.depth);
    }
}

/// A Gaussian in a view.
struct SeenGaussian {
    index: usize,
    /// Of its mean, m.
    depth_m: f32,
    /// To the camera.
    direction: Directions,
    observation: Observation,
}

impl Coverage {
    /// From its parts, one record for each Gaussian of the scene.
    pub fn new(gaussians: Vec<ObservedGaussian>, space: ObservedSpace, sky: ObservedSky) -> Self {
        Self {
            gaussians,
            space,
            sky,
        }
    }

    /// What was seen of each Gaussian, in the order of the scene.
    pub fn gaussians(&self) -> &[ObservedGaussian] {
        &self.gaussians
    }

    /// Space through which views looked.
    pub fn space(&self) -> &ObservedSpace {
        &self.space
    }

    /// Directions in which views saw sky.
    pub fn sky(&self) -> &ObservedSky {
        &self.sky
    }

    /// Gathers from the views of a training, at their poses and exposures. Masked pixels see
    /// nothing. The result does not depend on the order of views of different instants, but for
    /// rounding.
    ///
    /// # Errors
    /// [`SplatError::Size`] if a buffer of a view does not fit its image, [`SplatError::Setting`].
    pub fn gather(
        renderer: &Renderer,
        scene: &Scene,
        views: &[TrainingView],
        config: &CoverageConfig,
    ) -> Result<Self, SplatError> {
        let posed: Vec<(Camera, Exposure)> = views
            .iter()
            .map(|view| (view.camera.clone(), view.exposure))
            .collect();
        Self::gather_at(renderer, scene, views, &posed, config)
    }

    /// The same with a camera and exposure of each view in place of its own.
    pub(crate) fn gather_at(
        renderer: &Renderer,
        scene: &Scene,
        views: &[TrainingView],
        posed: &[(Camera, Exposure)],
        config: &CoverageConfig,
    ) -> Result<Self, SplatError> {
        config.check()?;
        for view in views {
            view.check()?;
        }
        // Images of one instant one after the other.
        let mut order: Vec<usize> = (0..views.len()).collect();
        order.sort_by_key(|k| views[*k].instant);
        let count = scene.splats.len();
        let mut sums = vec![Sums::default(); count];
        let mut last_instant: Vec<Option<u32>> = vec![None; count];
        let mut coverage = Self {
            gaussians: vec![ObservedGaussian::default(); count],
            space: ObservedSpace::new(config.voxel_m, config.range_m),
            sky: ObservedSky::none(config.sky_texels),
        };
        for number in order {
            let (view, (camera, exposure)) = (&views[number], &posed[number]);
            let pass = renderer.forward(scene, camera, exposure);
            for of_view in seen(renderer, scene, camera, &pass, view) {
                let k = of_view.index;
                sums[k].add(&of_view.observation);
                if of_view.observation.largest <= config.min_weight {
                    continue;
                }
                let seen = &mut coverage.gaussians[k];
                seen.directions.insert_all(of_view.direction);
                let size_m = of_view.depth_m / focal(camera);
                seen.finest_m = match seen.instants {
                    0 => size_m,
                    _ => seen.finest_m.min(size_m),
                };
                if last_instant[k] != Some(view.instant) {
                    seen.instants += 1;
                    last_instant[k] = Some(view.instant);
                }
            }
            coverage.insert_rays(&pass, view, camera, config);
        }
        for (seen, sums) in coverage.gaussians.iter_mut().zip(&sums) {
            let mean = |sum: f64, weight: f64| (weight > 0.0).then(|| sum / weight);
            let color = mean(sums.color, sums.weight).unwrap_or(1.0);
            seen.color_error = libm::sqrt(color) as f32;
            seen.depth_error = mean(sums.depth, sums.depth_weight).map_or(f32::NAN, |v| v as f32);
        }
        Ok(coverage)
    }

    /// Adds the space and the sky that a view shows.
    fn insert_rays(
        &mut self,
        pass: &Pass,
        view: &TrainingView,
        camera: &Camera,
        config: &CoverageConfig,
    ) {
        let rays = rays::rays(camera, config.step_px);
        let center = center(camera);
        let usable = |pixel: usize| view.mask.get(pixel).copied().unwrap_or(true);
        // Parts in a fixed number, so that the work is the same on any number of threads.
        let parts: Vec<ObservedSpace> = rays
            .par_chunks(1024)
            .map(|rays| {
                let mut space = ObservedSpace::new(config.voxel_m, config.range_m);
                for ray in rays.iter().filter(|ray| usable(ray.pixel)) {
                    let depth_m = pass.image.median_depth_m[ray.pixel];
                    let length_m = match depth_m.is_finite() {
                        true => depth_m * ray.length_per_depth,
                        false => config.range_m,
                    };
                    space.insert_ray(center, ray.direction, length_m);
                }
                space
            })
            .collect();
        for part in &parts {
            self.space.insert_all(part);
        }
        for ray in rays.iter().filter(|ray| usable(ray.pixel)) {
            if pass.image.alpha[ray.pixel] < 0.5 {
                self.sky.insert(ray.direction);
            }
        }
    }
}

/// Position of a camera in the world, m.
pub(super) fn center(camera: &Camera) -> [f32; 3] {
    let center = camera.camera_from_world().inverse().translation_m();
    center.map(|v| v as f32)
}

/// Mean focal length, px.
pub(super) fn focal(camera: &Camera) -> f32 {
    let model = camera.model();
    (0.5 * (model.fx + model.fy)) as f32
}

/// Gaussians that contribute to usable pixels of a view.
fn seen(
    renderer: &Renderer,
    scene: &Scene,
    camera: &Camera,
    pass: &Pass,
    view: &TrainingView,
) -> Vec<SeenGaussian> {
    let image = &pass.image;
    let color = (0..image.alpha.len()).into_par_iter().map(|pixel| {
        let squares = [0, 1, 2].map(|c| {
            let recorded = f32::from(view.rgb[3 * pixel + c]) / 255.0;
            let error = image.rgb[c][pixel].clamp(0.0, 1.0) - recorded;
            error * error
        });
        (squares[0] + squares[1] + squares[2]) / 3.0
    });
    let depth = (0..image.alpha.len()).into_par_iter().map(|pixel| {
        let Some(measured) = view.depth_m.get(pixel).filter(|d| **d > 0.0) else {
            return f32::NAN;
        };
        let rendered = image.median_depth_m[pixel];
        match rendered.is_finite() {
            true => ((rendered - measured).abs() / measured).min(1.0),
            false => 1.0,
        }
    });
    let errors = PixelErrors {
        usable: &view.mask,
        color: &color.collect::<Vec<f32>>(),
        depth: &depth.collect::<Vec<f32>>(),
    };
    let center = center(camera);
    let positions = &scene.splats.planes()[Plane::POSITION..];
    let observed = renderer.observe(camera, pass, &errors).into_par_iter();
    observed
        .filter(|(_, _, observation)| observation.weight > 0.0)
        .map(|(index, depth_m, observation)| {
            let index = index as usize;
            let mut direction = Directions::default();
            direction.insert([0, 1, 2].map(|axis| center[axis] - positions[axis][index]));
            SeenGaussian {
                index,
                depth_m,
                direction,
                observation,
            }
        })
        .collect()
}
