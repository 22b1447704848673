//! From blended tiles to an image: background, exposure, depths.

use rayon::prelude::*;

use super::blend::{Cells, TileImage, cell_of};
use super::image::Image;
use super::view::{TILE, View};
use crate::config::RenderConfig;
use crate::scene::{Background, Exposure, Scene};

/// A band of rows of an image that one task writes.
pub(super) struct Band<'a> {
    pub(super) rgb: [&'a mut [f32]; 3],
    pub(super) expected: &'a mut [f32],
    pub(super) median: &'a mut [f32],
    pub(super) alpha: &'a mut [f32],
}

impl<'a> Band<'a> {
    /// Bands of some rows each.
    pub(super) fn of(image: &'a mut Image, rows: usize) -> impl Iterator<Item = Self> {
        let size = image.width * rows;
        let [red, green, blue] = &mut image.rgb;
        red.chunks_mut(size)
            .zip(green.chunks_mut(size))
            .zip(blue.chunks_mut(size))
            .zip(image.expected_depth_m.chunks_mut(size))
            .zip(image.median_depth_m.chunks_mut(size))
            .zip(image.alpha.chunks_mut(size))
            .map(|(((((red, green), blue), expected), median), alpha)| Self {
                rgb: [red, green, blue],
                expected,
                median,
                alpha,
            })
    }
}

pub(super) fn finish(
    tiles: &[TileImage],
    scene: &Scene,
    view: &View,
    exposure: &Exposure,
    config: &RenderConfig,
) -> Image {
    let mut image = Image::zeros(view.width, view.height);
    let sky = SkyView::new(scene, view);
    let bands: Vec<Band<'_>> = Band::of(&mut image, TILE).collect();
    bands.into_par_iter().enumerate().for_each(|(row, band)| {
        let tiles = &tiles[row * view.tile_columns()..(row + 1) * view.tile_columns()];
        finish_band(band, tiles, row * TILE, view, &sky, exposure, config);
    });
    image
}

fn finish_band(
    mut band: Band<'_>,
    tiles: &[TileImage],
    top: usize,
    view: &View,
    sky: &SkyView<'_>,
    exposure: &Exposure,
    config: &RenderConfig,
) {
    let rows = band.alpha.len() / view.width;
    for row in 0..rows {
        for column in 0..view.width {
            let tile = &tiles[column / TILE];
            let (cell, lane) = cell_of(row, column % TILE);
            let at = |of: &Cells| of[cell][lane];
            let transmittance = at(&tile.transmittance).abs();
            let alpha = 1.0 - transmittance;
            let background = sky.color(column, top + row, transmittance, config);
            let color = std::array::from_fn(|c| at(&tile.rgb[c]) + background[c] * transmittance);
            let color = exposure.apply(color);
            let pixel = row * view.width + column;
            for (plane, value) in band.rgb.iter_mut().zip(color) {
                plane[pixel] = value;
            }
            band.expected[pixel] = match alpha >= config.min_depth_alpha {
                true => at(&tile.depth) / alpha,
                false => f32::NAN,
            };
            let median = at(&tile.median);
            band.median[pixel] = if median > 0.0 { median } else { f32::NAN };
            band.alpha[pixel] = alpha;
        }
    }
}

/// The background as a camera sees it.
pub(super) struct SkyView<'a> {
    background: &'a Background,
    view: &'a View,
}

impl<'a> SkyView<'a> {
    pub(super) fn new(scene: &'a Scene, view: &'a View) -> Self {
        Self {
            background: &scene.background,
            view,
        }
    }

    /// Color at a pixel. A sky behind a complete pixel is not evaluated, but black.
    pub(super) fn color(
        &self,
        column: usize,
        row: usize,
        transmittance: f32,
        config: &RenderConfig,
    ) -> [f32; 3] {
        match self.background {
            Background::Constant(color) => *color,
            Background::Sky(_) if transmittance <= config.min_transmittance => [0.0; 3],
            Background::Sky(sky) => match self.direction(column, row) {
                Some(direction) => sky.color(direction),
                None => [0.0; 3],
            },
        }
    }

    /// Direction of a pixel in the world, of any length.
    pub(super) fn direction(&self, column: usize, row: usize) -> Option<[f32; 3]> {
        let v = self.view;
        let [x, y, z] = match &v.rays {
            None => [
                (column as f32 - v.principal[0]) / v.focal[0],
                (row as f32 - v.principal[1]) / v.focal[1],
                1.0,
            ],
            Some(rays) => rays.get(row * v.width + column)?,
        };
        let r = &v.rotation;
        Some(std::array::from_fn(|k| {
            r[0][k] * x + r[1][k] * y + r[2][k] * z
        }))
    }
}
