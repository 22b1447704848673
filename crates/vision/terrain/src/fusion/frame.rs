//! A depth image prepared for fusion: normals, sigmas along them, usable pixels.
//!
//! Inverse depth is affine in pixel coordinates on a plane, so the normal of a cell of pixels
//! follows from a fit of inverse depths of the cells around it. The distance of a voxel from the
//! surface of a pixel is measured along that normal: along the ray it would be too long on ground
//! seen at a shallow angle.

use rayon::prelude::*;

use super::cells::{self, Cells};
use super::fit::Planes;
use super::pixels::{Pixel, Row, Rules};
use crate::config::FusionConfig;
use crate::view::{DepthView, Pose};

/// Cells across the width of an image, at least. Their edge is a power of 2.
const CELLS_ACROSS: usize = 160;

/// Images of the size of a view, which the next view uses again.
#[derive(Clone, Debug, Default)]
pub(crate) struct Images {
    /// Depths, m; 0 for none and for pixels that are excluded, negative for those that are not
    /// known to be static.
    pub(crate) depth: Vec<f32>,
    pub(crate) pixels: Vec<Pixel>,
    pub(crate) cells: Cells,
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Frame<'a> {
    pub(crate) view: &'a DepthView<'a>,
    pub(crate) pose: Pose,
    pub(crate) images: Images,
    /// Edge of a cell, px.
    pub(crate) cell_px: usize,
    /// Planes of the cells.
    pub(crate) planes: Planes,
}

impl<'a> Frame<'a> {
    pub(crate) fn new(config: &FusionConfig, view: &'a DepthView<'a>, mut images: Images) -> Self {
        let cell_px = 1 << (view.size[0] / CELLS_ACROSS).max(2).ilog2();
        let [width, height] = view.size;
        images.depth.resize(width * height, 0.0);
        images.pixels.resize(width * height, Pixel::default());
        images
            .cells
            .resize(view.size.map(|size| size.div_ceil(cell_px)));
        let Images {
            depth,
            pixels,
            cells,
        } = &mut images;
        let stripes = depth
            .par_chunks_mut(cell_px * width)
            .zip(cells.rows.par_iter_mut());
        stripes.enumerate().with_min_len(4).for_each(|(row, of)| {
            simd_dispatch::run(cells::Means {
                config,
                view,
                first_row: row * cell_px,
                cell_px,
                depth: of.0,
                cells: of.1,
            });
        });
        let planes = Planes::new(config, view, cell_px, cells);
        let rules = Rules::new(config, view);
        let ray_squares = rules.ray_squares(width);
        let depth = &*depth;
        let cells = &*cells;
        pixels
            .par_chunks_mut(width)
            .enumerate()
            .with_min_len(16)
            .for_each(|(row, pixels)| {
                simd_dispatch::run(Row {
                    rules: &rules,
                    view,
                    row,
                    cell_px,
                    cells,
                    planes: &planes,
                    depth,
                    ray_squares: &ray_squares,
                    pixels,
                });
            });
        Self {
            view,
            pose: Pose::new(&view.world_from_view),
            images,
            cell_px,
            planes,
        }
    }
}
