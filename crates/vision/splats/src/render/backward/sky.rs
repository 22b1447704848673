//! Gradients of the background.

use rayon::prelude::*;

use super::pixels::Pixels;
use crate::render::blend::{TileImage, cell_of};
use crate::render::finish::SkyView;
use crate::render::view::TILE;
use crate::scene::{Background, Sky};

/// Gradients with respect to the texels of a sky, or one color.
pub(super) fn background(pixels: &Pixels<'_>, tiles: &[TileImage]) -> Vec<[f32; 3]> {
    let (sky, len) = match &pixels.scene.background {
        Background::Constant(_) => (None, 1),
        Background::Sky(sky) => (Some(sky), sky.texels().len()),
    };
    // A partial sum per row of tiles, added in order.
    let rows: Vec<Vec<[f32; 3]>> = (0..pixels.view.tile_rows())
        .into_par_iter()
        .map(|row| {
            let mut sums = vec![[0.0; 3]; len];
            of_row(pixels, tiles, sky, row, &mut sums);
            sums
        })
        .collect();
    let mut sums = vec![[0.0; 3]; len];
    for row in rows {
        for (sum, value) in sums.as_flattened_mut().iter_mut().zip(row.as_flattened()) {
            *sum += value;
        }
    }
    sums
}

fn of_row(
    pixels: &Pixels<'_>,
    tiles: &[TileImage],
    sky: Option<&Sky>,
    tile_row: usize,
    sums: &mut [[f32; 3]],
) {
    let view = pixels.view;
    let sky_view = SkyView::new(pixels.scene, view);
    let top = tile_row * TILE;
    for row in top..view.height.min(top + TILE) {
        for column in 0..view.width {
            let tile = &tiles[tile_row * view.tile_columns() + column / TILE];
            let (cell, lane) = cell_of(row - top, column % TILE);
            let transmittance = tile.transmittance[cell][lane].abs();
            if transmittance <= pixels.config.min_transmittance {
                continue;
            }
            let outer = pixels.outer(row * view.width + column);
            let gradient = pixels.exposure.transposed(outer).map(|g| g * transmittance);
            let mut add = |index: usize, weight: f32| {
                for (sum, value) in sums[index].iter_mut().zip(gradient) {
                    *sum += weight * value;
                }
            };
            match sky {
                None => add(0, 1.0),
                Some(sky) => {
                    if let Some(direction) = sky_view.direction(column, row) {
                        for (index, weight) in sky.taps(direction) {
                            add(index, weight);
                        }
                    }
                }
            }
        }
    }
}
