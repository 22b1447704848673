//! What an image shows of each of its Gaussians: its largest weight, and sums over its pixels.
//!
//! The blending is repeated without colors. Each pair of a Gaussian and a tile has a slot of its
//! own, as in `backward`; those of a Gaussian are added in the order of its tiles.
//! `Renderer::visit_weights` is the slow twin.

use rayon::prelude::*;

use super::blend::{Batch, CELLS, Cells, Local, cell_of, cells, origin, start};
use super::forward::{Pass, Renderer};
use super::project::Footprint;
use super::view::{TILE, View};
use crate::camera::Camera;
use crate::config::RenderConfig;
use crate::lanes::{Kernel, LANES, Lanes};

/// Errors of the pixels of an image, row by row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PixelErrors<'a> {
    /// Pixels that count; empty for all.
    pub(crate) usable: &'a [bool],
    /// Squared errors of color.
    pub(crate) color: &'a [f32],
    /// Errors of depth; NaN where none is known.
    pub(crate) depth: &'a [f32],
}

/// A Gaussian in the usable pixels of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Observation {
    /// Largest weight at a pixel.
    pub(crate) largest: f32,
    /// Sum of the weights.
    pub(crate) weight: f32,
    /// Sum of weights times squared errors of color.
    pub(crate) color: f32,
    /// Sum of the weights where errors of depth are known.
    pub(crate) depth_weight: f32,
    /// Sum of weights times errors of depth.
    pub(crate) depth: f32,
}

impl Observation {
    fn add(&mut self, other: &Self) {
        self.largest = self.largest.max(other.largest);
        self.weight += other.weight;
        self.color += other.color;
        self.depth_weight += other.depth_weight;
        self.depth += other.depth;
    }
}

impl Renderer {
    /// Index, depth of the mean (m) and observation of each Gaussian of a rendered image.
    pub(crate) fn observe(
        &self,
        camera: &Camera,
        pass: &Pass,
        errors: &PixelErrors<'_>,
    ) -> Vec<(u32, f32, Observation)> {
        let view = View::new(camera, &self.config);
        let mut slots = vec![Observation::default(); pass.bins.pairs()];
        pass.bins
            .split(&mut slots)
            .into_par_iter()
            .enumerate()
            .for_each(|(tile, slots)| {
                self.level.run(ObserveTile {
                    footprints: &pass.footprints,
                    entries: pass.bins.entries(tile),
                    view: &view,
                    tile,
                    config: &self.config,
                    errors: &TileErrors::new(errors, &view, tile),
                    slots,
                });
            });
        let footprints = pass.footprints.par_iter().enumerate();
        footprints
            .map(|(number, f)| {
                let mut sum = Observation::default();
                for entry in pass.bins.entries_of(number) {
                    sum.add(&slots[*entry as usize]);
                }
                (f.index, f.z, sum)
            })
            .collect()
    }
}

/// Errors of a tile's pixels, by cell.
struct TileErrors {
    /// 1 or 0.
    usable: Cells,
    color: Cells,
    /// 1 or 0.
    is_depth_known: Cells,
    /// 0 where it is not known.
    depth: Cells,
}

impl TileErrors {
    fn new(of: &PixelErrors<'_>, view: &View, tile: usize) -> Self {
        let zero = [[0.0; LANES]; CELLS];
        let mut out = Self {
            usable: zero,
            color: zero,
            is_depth_known: zero,
            depth: zero,
        };
        let [x, y] = origin(view, tile);
        for row in 0..TILE.min(view.height - y) {
            for column in 0..TILE.min(view.width - x) {
                let (cell, lane) = cell_of(row, column);
                let pixel = (y + row) * view.width + x + column;
                if !of.usable.get(pixel).copied().unwrap_or(true) {
                    continue;
                }
                out.usable[cell][lane] = 1.0;
                out.color[cell][lane] = of.color[pixel];
                if !of.depth[pixel].is_nan() {
                    out.is_depth_known[cell][lane] = 1.0;
                    out.depth[cell][lane] = of.depth[pixel];
                }
            }
        }
        out
    }
}

struct ObserveTile<'a> {
    footprints: &'a [Footprint],
    entries: &'a [u32],
    view: &'a View,
    tile: usize,
    config: &'a RenderConfig,
    errors: &'a TileErrors,
    /// One per entry.
    slots: &'a mut [Observation],
}

/// Sums over cells, one vector each.
#[derive(Clone, Copy)]
struct Sums<V> {
    largest: V,
    weight: V,
    color: V,
    depth_weight: V,
    depth: V,
}

impl Kernel for ObserveTile<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let s = V::splat;
        let (mut transmittance, mut live) = start(self.view, self.tile);
        let origin = origin(self.view, self.tile).map(|v| v as f32);
        let (max_alpha, min_alpha) = (s(self.config.max_alpha), s(self.config.min_alpha));
        let least = s(self.config.min_transmittance);
        let mut batch = Batch::new(self.footprints, self.entries);
        for slot in self.slots {
            let Some(f) = batch.next() else {
                break;
            };
            let mut bits = cells::<V>(f, origin) & live;
            if bits == 0 {
                continue;
            }
            let local = Local::<V>::new(f, origin);
            let zero = s(0.0);
            let mut sums = Sums {
                largest: zero,
                weight: zero,
                color: zero,
                depth_weight: zero,
                depth: zero,
            };
            while bits != 0 {
                let cell = bits.trailing_zeros() as usize % CELLS;
                bits &= bits - 1;
                let alpha = local.alpha(cell).min(max_alpha);
                let skipped = alpha.less(min_alpha);
                if skipped.bits() == 0xff {
                    continue;
                }
                let before = V::load(&transmittance[cell]);
                let product = before * alpha;
                let next = before - product;
                let kept = least.less(next);
                let after = skipped.select(before, kept.select(next, -before.abs()));
                after.store(&mut transmittance[cell]);
                if s(0.0).less(after).bits() == 0 {
                    live &= !(1 << cell);
                }
                let weight = product.and(kept).and_not(skipped);
                let weight = weight * V::load(&self.errors.usable[cell]);
                sums.largest = sums.largest.max(weight);
                sums.weight = sums.weight + weight;
                sums.color = weight.mul_add(V::load(&self.errors.color[cell]), sums.color);
                let known = V::load(&self.errors.is_depth_known[cell]);
                sums.depth_weight = weight.mul_add(known, sums.depth_weight);
                sums.depth = weight.mul_add(V::load(&self.errors.depth[cell]), sums.depth);
            }
            let mut largest = [0.0; LANES];
            sums.largest.store(&mut largest);
            for lane in largest {
                slot.largest = slot.largest.max(lane);
            }
            slot.weight = sums.weight.sum();
            slot.color = sums.color.sum();
            slot.depth_weight = sums.depth_weight.sum();
            slot.depth = sums.depth.sum();
            if live == 0 {
                break;
            }
        }
    }
}
