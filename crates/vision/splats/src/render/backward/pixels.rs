//! From the gradient of an image to that of the blended tiles: exposure, depth, background.

use crate::config::RenderConfig;
use crate::lanes::LANES;
use crate::render::blend::{CELLS, Cells, TileImage, cell_of, origin};
use crate::render::finish::SkyView;
use crate::render::gradients::ImageGradient;
use crate::render::view::{TILE, View};
use crate::scene::{Exposure, Scene};

/// What a tile's gradients start from, by cell.
pub(super) struct TileGradient {
    /// With respect to the blended color.
    pub(super) rgb: [Cells; 3],
    /// With respect to the sum of weights times depths.
    pub(super) depth: Cells,
    /// What lies behind the present Gaussian, at the start behind none: colors and depth times
    /// their gradients, and minus the part of transmittance.
    pub(super) behind: Cells,
    pub(super) error: Cells,
}

impl Default for TileGradient {
    fn default() -> Self {
        let zero = [[0.0; LANES]; CELLS];
        Self {
            rgb: [zero; 3],
            depth: zero,
            behind: zero,
            error: zero,
        }
    }
}

pub(super) struct Pixels<'a> {
    pub(super) scene: &'a Scene,
    pub(super) view: &'a View,
    pub(super) exposure: &'a Exposure,
    pub(super) config: &'a RenderConfig,
    pub(super) gradient: &'a ImageGradient,
}

impl Pixels<'_> {
    /// Fills a tile's start; returns the gradient with respect to the exposure's matrix.
    pub(super) fn tile(&self, tile: usize, image: &TileImage, out: &mut TileGradient) -> [f64; 12] {
        let [x, y] = origin(self.view, tile);
        let sky = SkyView::new(self.scene, self.view);
        let mut exposure = [0.0; 12];
        for row in 0..TILE.min(self.view.height - y) {
            // In f32 over a row, in f64 over rows.
            let mut of_row = [0.0_f32; 12];
            for column in 0..TILE.min(self.view.width - x) {
                let (cell, lane) = cell_of(row, column);
                let pixel = (y + row) * self.view.width + x + column;
                let at = |cells: &Cells| cells[cell][lane];
                let optional = |plane: &Vec<f32>| plane.get(pixel).copied().unwrap_or(0.0);
                let transmittance = at(&image.transmittance).abs();
                let background = sky.color(x + column, y + row, transmittance, self.config);
                let outer = self.outer(pixel);
                let g = self.exposure.transposed(outer);
                let mut g_alpha = optional(&self.gradient.alpha);
                let mut g_depth = 0.0;
                let alpha = 1.0 - transmittance;
                let depth = at(&image.depth);
                if alpha >= self.config.min_depth_alpha {
                    g_depth = optional(&self.gradient.expected_depth) / alpha;
                    g_alpha -= g_depth * depth / alpha;
                }
                let mut behind = g_depth * depth;
                let mut by_background = 0.0;
                for c in 0..3 {
                    let blended = at(&image.rgb[c]);
                    behind += g[c] * blended;
                    by_background += g[c] * background[c];
                    out.rgb[c][cell][lane] = g[c];
                    let color = blended + background[c] * transmittance;
                    for (row, outer) in outer.into_iter().enumerate() {
                        of_row[4 * row + c] += outer * color;
                    }
                }
                for (row, outer) in outer.into_iter().enumerate() {
                    of_row[4 * row + 3] += outer;
                }
                out.depth[cell][lane] = g_depth;
                out.behind[cell][lane] = behind - transmittance * (g_alpha - by_background);
                out.error[cell][lane] = optional(&self.gradient.error);
            }
            for (sum, value) in exposure.iter_mut().zip(of_row) {
                *sum += f64::from(value);
            }
        }
        exposure
    }

    /// Gradient with respect to the color of a pixel, after the exposure.
    pub(super) fn outer(&self, pixel: usize) -> [f32; 3] {
        let [red, green, blue] = &self.gradient.rgb;
        [red[pixel], green[pixel], blue[pixel]]
    }
}
