//! Weights of single Gaussians at pixels: the blending of a tile once more, in scalar code.
//!
//! Contract: the same order, ends and thresholds as the blending of an image, up to rounding. Slow;
//! for measures of single images, and to compare `observe` with.

use super::forward::{Pass, Renderer};
use super::view::TILE;

/// A Gaussian at a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Weight {
    /// Number of the Gaussian in the list of the tile, nearest first.
    pub(crate) entry: usize,
    /// Pixel of the image, row by row.
    pub(crate) pixel: usize,
    /// Pixel of the tile, row by row.
    pub(crate) cell: usize,
    /// Share of the pixel's color that is the Gaussian's.
    pub(crate) weight: f32,
    /// Of the Gaussian at the pixel, m.
    pub(crate) depth: f32,
}

impl Pass {
    /// Number of tiles.
    pub(crate) fn tiles(&self) -> usize {
        self.bins.tiles()
    }

    /// Indices and depths (m) of the means of the Gaussians of a tile, nearest first.
    pub(crate) fn entries(&self, tile: usize) -> impl Iterator<Item = (u32, f32)> {
        let entries = self.bins.entries(tile).iter();
        entries.map(|entry| {
            let f = &self.footprints[*entry as usize];
            (f.index, f.z)
        })
    }
}

impl Renderer {
    /// Visits all weights of a tile of a rendered image: Gaussian by Gaussian, nearest first.
    pub(crate) fn visit_weights(&self, pass: &Pass, tile: usize, mut visit: impl FnMut(Weight)) {
        let (width, height) = (pass.image.width, pass.image.height);
        let tiles = width.div_ceil(TILE);
        let (left, top) = (tile % tiles * TILE, tile / tiles * TILE);
        let columns = TILE.min(width - left);
        let rows = TILE.min(height - top);
        let mut transmittance = [1.0_f32; TILE * TILE];
        let mut live = rows * columns;
        for (entry, footprint) in pass.bins.entries(tile).iter().enumerate() {
            let f = &pass.footprints[*footprint as usize];
            let [a, b, c] = f.conic;
            for row in 0..rows {
                let dy = (top + row) as f32 - f.mean[1];
                if dy.abs() > f.extent[1] + 1.0 {
                    continue;
                }
                for column in 0..columns {
                    let before = &mut transmittance[row * TILE + column];
                    let dx = (left + column) as f32 - f.mean[0];
                    // Negative where the pixel is complete.
                    if *before < 0.0 || dx.abs() > f.extent[0] + 1.0 {
                        continue;
                    }
                    let sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy;
                    let alpha = (f.opacity * libm::expf(-sigma)).min(self.config.max_alpha);
                    if alpha < self.config.min_alpha {
                        continue;
                    }
                    let weight = *before * alpha;
                    let next = *before - weight;
                    if next <= self.config.min_transmittance {
                        *before = -*before;
                        live -= 1;
                        continue;
                    }
                    *before = next;
                    visit(Weight {
                        entry,
                        pixel: (top + row) * width + left + column,
                        cell: row * TILE + column,
                        weight,
                        depth: f.z + f.slope[0] * dx + f.slope[1] * dy,
                    });
                }
            }
            if live == 0 {
                break;
            }
        }
    }
}
