//! How far the pixels of an image are outside of what was seen.

use rayon::prelude::*;

use super::coverage::{Coverage, center, focal};
use super::rays;
use crate::camera::Camera;
use crate::error::SplatError;
use crate::render::{Pass, Renderer, TILE};
use crate::scene::{Exposure, Plane, Scene};

/// Instants below which a Gaussian was seen by few.
const FEW_INSTANTS: u32 = 3;

/// Spacing of the directions in a set: angles below it are no angles. rad
const SPACING_RAD: f32 = 0.38;

/// Most octaves of magnification.
const MAX_OCTAVES: f32 = 4.0;

/// Distance before a surface in which space does not count, voxels: they contain the surface.
const SURFACE_VOXELS: f32 = 1.5;

/// Pixels of a row and column for each ray through space.
const STEP_PX: usize = 4;

/// Accumulated alpha below which a pixel shows no Gaussian, and its channels are 0.
const MIN_ALPHA: f32 = 1e-3;

/// Channels of an image, row by row. Those of Gaussians are means over the Gaussians of a pixel by
/// their weights.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CoverageImage {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Accumulated alpha.
    pub alpha: Vec<f32>,
    /// Median depth, m; NaN where there is none.
    pub median_depth_m: Vec<f32>,
    /// Share of the color that neither a Gaussian nor a seen sky gives.
    pub uncovered: Vec<f32>,
    /// Angle between the viewing direction and the nearest seen one, beyond the spacing of
    /// directions, rad.
    pub angle_rad: Vec<f32>,
    /// Share of Gaussians that fewer than three instants saw.
    pub few: Vec<f32>,
    /// Magnification beyond the finest one that was seen, octaves.
    pub magnification: Vec<f32>,
    /// Share of the ray to the surface through which no view looked.
    pub space: Vec<f32>,
    /// Spread of the Gaussians' depths at the pixel, relative to their mean.
    pub spread: Vec<f32>,
    /// Mean squared error of color in the views of the training.
    pub squared_error: Vec<f32>,
    /// Mean relative error of depth in those views.
    pub depth_error: Vec<f32>,
}

/// Sums over the Gaussians of a pixel.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    weight: f32,
    angle: f32,
    few: f32,
    octaves: f32,
    depth: f32,
    squared_depth: f32,
    squared_error: f32,
    depth_error_weight: f32,
    depth_error: f32,
}

/// Values of a Gaussian for a camera.
#[derive(Clone, Copy, Debug)]
struct OfCamera {
    angle: f32,
    few: f32,
    octaves: f32,
    squared_error: f32,
    depth_error: f32,
}

impl Coverage {
    /// The channels of a camera's image.
    ///
    /// # Errors
    /// [`SplatError::Size`] if the scene has another number of Gaussians.
    pub fn render(
        &self,
        renderer: &Renderer,
        scene: &Scene,
        camera: &Camera,
    ) -> Result<CoverageImage, SplatError> {
        if self.gaussians.len() != scene.splats.len() {
            return Err(SplatError::Size {
                what: "coverage",
                found: self.gaussians.len(),
                expected: scene.splats.len(),
            });
        }
        let pass = renderer.forward(scene, camera, &Exposure::NONE);
        let tiles: Vec<[Sums; TILE * TILE]> = (0..pass.tiles())
            .into_par_iter()
            .map(|tile| self.tile(renderer, scene, camera, &pass, tile))
            .collect();
        let pixels = camera.pixels();
        let plane = || vec![0.0; pixels];
        let mut out = CoverageImage {
            width: pass.image.width,
            height: pass.image.height,
            // Where no ray says otherwise: nothing is known there.
            uncovered: pass.image.alpha.iter().map(|alpha| 1.0 - alpha).collect(),
            angle_rad: plane(),
            few: plane(),
            magnification: plane(),
            space: vec![1.0; pixels],
            spread: plane(),
            squared_error: plane(),
            depth_error: plane(),
            alpha: pass.image.alpha,
            median_depth_m: pass.image.median_depth_m,
        };
        let (width, columns) = (out.width, out.width.div_ceil(TILE));
        for pixel in 0..pixels {
            let (row, column) = (pixel / width, pixel % width);
            let tile = &tiles[row / TILE * columns + column / TILE];
            out.set(pixel, &tile[row % TILE * TILE + column % TILE]);
        }
        self.set_rays(camera, &mut out);
        Ok(out)
    }

    /// Sums of the pixels of a tile.
    fn tile(
        &self,
        renderer: &Renderer,
        scene: &Scene,
        camera: &Camera,
        pass: &Pass,
        tile: usize,
    ) -> [Sums; TILE * TILE] {
        let (center, focal) = (center(camera), focal(camera));
        let positions = &scene.splats.planes()[Plane::POSITION..];
        let entries = pass.entries(tile).map(|(index, z)| {
            let k = index as usize;
            let seen = &self.gaussians[k];
            let to_camera = [0, 1, 2].map(|axis| center[axis] - positions[axis][k]);
            let magnification = match seen.instants {
                0 => f32::INFINITY,
                _ => seen.finest_m * focal / z,
            };
            OfCamera {
                angle: (seen.directions.angle_rad(to_camera) - SPACING_RAD).max(0.0),
                few: f32::from(u8::from(seen.instants < FEW_INSTANTS)),
                octaves: libm::log2f(magnification).clamp(0.0, MAX_OCTAVES),
                squared_error: seen.color_error * seen.color_error,
                depth_error: seen.depth_error,
            }
        });
        let of_camera: Vec<OfCamera> = entries.collect();
        let mut of_pixel = [Sums::default(); TILE * TILE];
        renderer.visit_weights(pass, tile, |at| {
            of_pixel[at.cell].add(at.weight, at.depth, &of_camera[at.entry]);
        });
        of_pixel
    }

    /// Fills in the channels of rays: space, and sky behind the Gaussians.
    fn set_rays(&self, camera: &Camera, out: &mut CoverageImage) {
        let center = center(camera);
        let rays = rays::rays(camera, STEP_PX);
        let (width, height) = (out.width, out.height);
        let found: Vec<(usize, f32, f32)> = rays
            .par_iter()
            .map(|ray| {
                let depth_m = out.median_depth_m[ray.pixel];
                let length_m = match depth_m.is_finite() {
                    true => depth_m * ray.length_per_depth - SURFACE_VOXELS * self.space.voxel_m(),
                    false => self.space.range_m(),
                };
                let space = self.space.unseen_share(center, ray.direction, length_m);
                let sky = f32::from(u8::from(!self.sky.contains(ray.direction)));
                (ray.pixel, space, sky)
            })
            .collect();
        for (middle, space, sky) in found {
            let (left, top) = (middle % width / STEP_PX, middle / width / STEP_PX);
            for row in (top * STEP_PX..height).take(STEP_PX) {
                for column in (left * STEP_PX..width).take(STEP_PX) {
                    let pixel = row * width + column;
                    out.space[pixel] = space;
                    out.uncovered[pixel] = (1.0 - out.alpha[pixel]) * sky;
                }
            }
        }
    }
}

impl Sums {
    fn add(&mut self, weight: f32, depth: f32, of: &OfCamera) {
        self.weight += weight;
        self.angle += weight * of.angle;
        self.few += weight * of.few;
        self.octaves += weight * of.octaves;
        self.depth += weight * depth;
        self.squared_depth += weight * depth * depth;
        self.squared_error += weight * of.squared_error;
        if of.depth_error.is_finite() {
            self.depth_error_weight += weight;
            self.depth_error += weight * of.depth_error;
        }
    }
}

impl CoverageImage {
    fn set(&mut self, pixel: usize, sums: &Sums) {
        if sums.weight < MIN_ALPHA {
            return;
        }
        let mean = |sum: f32| sum / sums.weight;
        let depth = mean(sums.depth);
        let variance = mean(sums.squared_depth) - depth * depth;
        self.angle_rad[pixel] = mean(sums.angle);
        self.few[pixel] = mean(sums.few);
        self.magnification[pixel] = mean(sums.octaves);
        self.spread[pixel] = variance.max(0.0).sqrt() / depth;
        self.squared_error[pixel] = mean(sums.squared_error);
        if sums.depth_error_weight > 0.0 {
            self.depth_error[pixel] = sums.depth_error / sums.depth_error_weight;
        }
    }
}
