//! A region of an image: its Gaussians front to back, without lists per tile.
//!
//! Nodes are visited by the depth of their nearest mean, some of them at a time. A Gaussian is
//! blended when no node is left that could have a nearer one. Nodes and Gaussians that reach only
//! complete pixels are left out, before or after their projection.

use super::baked::{self, BakedBlocks, Row, load3};
use super::camera::{Rectangle, RegionCamera};
use super::config::DetailConfig;
use super::nodes::{Candidate, Nodes};
use super::pixels::{BLOCK, Blocks, MAX_BLOCKS, Pixels, Sprite, block_bits};
use crate::config::RenderConfig;
use crate::harmonics;
use crate::lanes::{Kernel, LANES, Lanes};
use crate::render::geometry::{Shape, dot, row_times, splat3x3};
use crate::render::slope::Slope;
use crate::render::view::View;
use crate::scene::coefficients;

/// Gaussians, as blocks of eight, that are projected before the nearest ones are blended.
const BLOCKS_PER_ROUND: usize = 160;

/// Slack of boxes for rounding, px.
const SLACK_PX: f32 = 0.02;

/// Bits of the number of a block.
const MASK: u32 = MAX_BLOCKS as u32 - 1;

/// Largest determinant of a covariance in the image, px⁴; beyond it f32 is not enough.
const MAX_DETERMINANT: f32 = 1e30;

/// What a thread keeps from image to image.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    pub(super) pixels: Pixels,
    /// Nodes to visit.
    open: Vec<usize>,
    candidates: Vec<Candidate>,
    sprites: Vec<Sprite>,
    /// Bits of the depth and index of sprites that are not blended yet.
    waiting: Vec<Key>,
    ready: Vec<Key>,
    other: Vec<Key>,
}

/// Bits of a depth, which is positive, and the index of a sprite.
type Key = (u32, u32);

/// Gaussians of all levels.
#[derive(Clone, Copy)]
pub(super) struct Contents<'a> {
    pub(super) nodes: &'a Nodes,
    pub(super) baked: &'a BakedBlocks,
    pub(super) config: &'a DetailConfig,
}

/// Renders a region into the pixels of a scratch.
pub(super) struct Region<'a> {
    pub(super) contents: Contents<'a>,
    pub(super) view: &'a View,
    pub(super) rectangle: Rectangle,
    pub(super) config: &'a RenderConfig,
    pub(super) scratch: &'a mut Scratch,
}

impl Kernel for Region<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let scratch = self.scratch;
        scratch.pixels.clear(self.rectangle.size);
        scratch.sprites.clear();
        scratch.waiting.clear();
        let Contents {
            nodes,
            baked,
            config: detail,
        } = self.contents;
        let camera = RegionCamera::new(self.view, self.rectangle, self.config, detail);
        nodes.find(
            &camera,
            detail.max_sigma_px,
            &mut scratch.open,
            &mut scratch.candidates,
        );
        let mut next = 0;
        loop {
            let mut blocks = 0;
            while next < scratch.candidates.len() && blocks < BLOCKS_PER_ROUND {
                let candidate = scratch.candidates[next];
                next += 1;
                if !scratch
                    .pixels
                    .is_open(camera.blocks_of(candidate.center, candidate.radius_m))
                {
                    continue;
                }
                let range = nodes.all[candidate.node as usize].blocks.clone();
                blocks += range.len();
                for block in range {
                    camera.project::<V>(baked, block, scratch);
                }
            }
            let end = match scratch.candidates.get(next) {
                Some(candidate) => candidate.z_m.to_bits(),
                None => u32::MAX,
            };
            take_nearer(&mut scratch.waiting, end, &mut scratch.ready);
            sort(&mut scratch.ready, &mut scratch.other);
            for (_, index) in &scratch.ready {
                let sprite = &scratch.sprites[*index as usize];
                scratch
                    .pixels
                    .blend::<V>(sprite, detail, self.config.max_alpha);
            }
            if next == scratch.candidates.len() || scratch.pixels.is_complete() {
                break;
            }
        }
    }
}

/// Eight Gaussians in the region.
struct ProjectedBlock<V> {
    mean: [V; 2],
    /// Half of the box around the ellipse, px.
    extent: [V; 2],
    /// Inverse covariance `a b; b c` and its determinant.
    conic: [V; 4],
    reach: V,
    opacity: V,
    color: [V; 3],
    z: V,
    slope: [V; 2],
}

impl RegionCamera<'_> {
    /// Appends the sprites of a block.
    #[inline(always)]
    fn project<V: Lanes>(&self, baked: &BakedBlocks, block: usize, scratch: &mut Scratch) {
        let s = V::splat;
        let (view, rows) = (self.view, baked.block(block));
        let position = load3::<V>(rows, baked::POSITION);
        let mut offset = position;
        for k in 0..3 {
            offset[k] = position[k] - s(view.center[k]);
        }
        let rotation = splat3x3::<V>(&view.rotation);
        let z = dot(&rotation[2], &offset);
        let hidden = z
            .less(s(self.config.near_m))
            .or(s(self.config.far_m).less(z));
        let mut visible = hidden.bits() ^ 0xff;
        if visible == 0 {
            return;
        }
        let at = [dot(&rotation[0], &offset), dot(&rotation[1], &offset)];
        let inverse = s(1.0) / z;
        let largest = V::load(&rows[baked::LARGEST]);
        let mut reach = V::load(&rows[baked::LOG_OPACITY]) - s(self.log_min_alpha);
        let dilation = s(self.config.dilation_px2);
        let mut mean = at;
        let mut jacobian = rotation;
        for k in 0..2 {
            let slope = at[k] * inverse;
            let bounded = slope.max(s(view.slope_min[k])).min(s(view.slope_max[k]));
            let scale = s(view.focal[k]) * inverse;
            let center = view.principal[k] - self.rectangle.origin[k] as f32;
            mean[k] = s(view.focal[k]).mul_add(slope, s(center));
            let along = -(scale * bounded);
            for i in 0..3 {
                jacobian[k][i] = scale.mul_add(rotation[k][i], along * rotation[2][i]);
            }
            // The largest scale bounds the ellipse in every direction.
            let square =
                (scale * scale).mul_add(bounded.mul_add(bounded, s(1.0)) * largest, dilation);
            let extent = (square * reach.max(s(0.0))).sqrt();
            let last = s((self.rectangle.size[k] - 1) as f32);
            visible &= (-extent).less(mean[k]).bits() & mean[k].less(last + extent).bits();
        }
        visible &= s(0.0).less(reach).bits();
        if visible == 0 {
            return;
        }
        let root = [
            load3::<V>(rows, baked::ROOT),
            load3::<V>(rows, baked::ROOT + 3),
            load3::<V>(rows, baked::ROOT + 6),
        ];
        let depth_root = row_times(&rotation[2], &root);
        let root = [
            row_times(&jacobian[0], &root),
            row_times(&jacobian[1], &root),
        ];
        let shape = Shape::new(&root, self.config.dilation_px2);
        let determinant = shape.determinant;
        visible &= s(0.0).less(determinant).bits();
        visible &= determinant.less(s(MAX_DETERMINANT)).bits();
        let mut opacity = V::load(&rows[baked::OPACITY]);
        if self.config.compensate {
            let factor = shape.compensation(self.config.min_compensation);
            opacity = opacity * factor;
            reach = reach + twice_log(factor);
            visible &= s(0.0).less(reach).bits();
        }
        let [xx, xy, yy] = shape.covariance;
        let extent = [
            (xx * reach.max(s(0.0))).sqrt(),
            (yy * reach.max(s(0.0))).sqrt(),
        ];
        for k in 0..2 {
            let last = s((self.rectangle.size[k] - 1) as f32);
            visible &= (-extent[k]).less(mean[k]).bits();
            visible &= mean[k].less(last + extent[k]).bits();
        }
        if visible == 0 {
            return;
        }
        let slope = Slope::new(&root, &depth_root, &shape, z, (view, self.config));
        let inverse = s(1.0) / determinant;
        self.append(
            &ProjectedBlock {
                mean,
                extent,
                conic: [yy * inverse, -xy * inverse, xx * inverse, inverse],
                reach,
                opacity,
                color: color(&offset, baked.degree(), rows),
                z,
                slope: slope.value,
            },
            visible,
            scratch,
        );
    }

    /// Appends those of eight Gaussians that reach pixels that are not complete.
    #[inline(always)]
    fn append<V: Lanes>(&self, of: &ProjectedBlock<V>, mut visible: u32, scratch: &mut Scratch) {
        let (mean, extent) = (&of.mean, &of.extent);
        let size = self.rectangle.size;
        let slack = V::splat(SLACK_PX);
        let left = block_bits(mean[0] - extent[0] - slack, size[0]);
        let right = block_bits(mean[0] + extent[0] + slack, size[0]);
        let top = block_bits(mean[1] - extent[1] - slack, size[1]);
        let bottom = block_bits(mean[1] + extent[1] + slack, size[1]);
        let mut values: [Row; 14] = [[0.0; LANES]; 14];
        mean[0].store(&mut values[0]);
        mean[1].store(&mut values[1]);
        of.conic[0].store(&mut values[2]);
        of.conic[1].store(&mut values[3]);
        of.conic[2].store(&mut values[4]);
        of.conic[3].store(&mut values[5]);
        of.reach.store(&mut values[6]);
        of.opacity.store(&mut values[7]);
        of.color[0].store(&mut values[8]);
        of.color[1].store(&mut values[9]);
        of.color[2].store(&mut values[10]);
        of.z.store(&mut values[11]);
        of.slope[0].store(&mut values[12]);
        of.slope[1].store(&mut values[13]);
        while visible != 0 {
            let i = visible.trailing_zeros() as usize % LANES;
            visible &= visible - 1;
            let blocks = Blocks::new(
                left[i] & MASK,
                right[i] & MASK,
                top[i] & MASK,
                bottom[i] & MASK,
            );
            if !scratch.pixels.is_open(blocks) {
                continue;
            }
            let v = &values;
            let index = scratch.sprites.len() as u32;
            scratch.waiting.push((v[11][i].to_bits(), index));
            scratch.sprites.push(Sprite {
                mean: [v[0][i], v[1][i]],
                conic: [v[2][i], v[3][i], v[4][i], v[5][i]],
                reach: v[6][i],
                opacity: v[7][i],
                color: [v[8][i], v[9][i], v[10][i]],
                z: v[11][i],
                slope: [v[12][i], v[13][i]],
                blocks,
            });
        }
    }
}

/// Moves the keys of sprites nearer than a depth, given by its bits, into another list.
fn take_nearer(waiting: &mut Vec<Key>, end: u32, nearer: &mut Vec<Key>) {
    nearer.clear();
    let mut kept = 0;
    for at in 0..waiting.len() {
        let key = waiting[at];
        match key.0 < end {
            true => nearer.push(key),
            false => {
                waiting[kept] = key;
                kept += 1;
            }
        }
    }
    waiting.truncate(kept);
}

/// Twice the natural logarithms, one lane after the other.
#[inline(always)]
fn twice_log<V: Lanes>(of: V) -> V {
    let mut values = [0.0; LANES];
    of.store(&mut values);
    for value in &mut values {
        *value = 2.0 * libm::logf(*value);
    }
    V::load(&values)
}

/// Colors towards the camera.
#[inline(always)]
fn color<V: Lanes>(offset: &[V; 3], degree: usize, rows: &[Row]) -> [V; 3] {
    let mut direction = *offset;
    if degree > 0 {
        let inverse = V::splat(1.0) / dot(offset, offset).sqrt();
        for k in 0..3 {
            direction[k] = offset[k] * inverse;
        }
    }
    let basis = harmonics::basis(direction, degree);
    let mut color = [V::splat(0.5); 3];
    for k in 0..coefficients(degree) {
        let of_channel = load3::<V>(rows, baked::HARMONICS + 3 * k);
        for c in 0..3 {
            color[c] = basis[k].mul_add(of_channel[c], color[c]);
        }
    }
    let zero = V::splat(0.0);
    [color[0].max(zero), color[1].max(zero), color[2].max(zero)]
}

/// Bits of a digit of the sort.
const BITS: u32 = 8;
const BUCKETS: usize = 1 << BITS;

/// Sorts by depth to one part in 2^16 of the range that the keys span, or better; equal ones stay
/// in their order. Two passes of a radix sort (Knuth, The Art of Computer Programming 3, 5.2.5).
fn sort(keys: &mut Vec<Key>, other: &mut Vec<Key>) {
    let mut low = u32::MAX;
    let mut high = 0;
    for (z, _) in keys.iter() {
        low = low.min(*z);
        high = high.max(*z);
    }
    if low >= high {
        return;
    }
    let shift = (32 - (high - low).leading_zeros()).saturating_sub(2 * BITS);
    other.clear();
    other.resize(keys.len(), (0, 0));
    for pass in 0..2 {
        let digit = |key: &Key| ((key.0 - low) >> (shift + pass * BITS)) as usize % BUCKETS;
        let mut starts = [0_u32; BUCKETS];
        for key in keys.iter() {
            starts[digit(key)] += 1;
        }
        let mut sum = 0;
        for start in &mut starts {
            sum += std::mem::replace(start, sum);
        }
        for key in keys.iter() {
            let at = &mut starts[digit(key)];
            other[*at as usize] = *key;
            *at += 1;
        }
        std::mem::swap(keys, other);
    }
}

/// First pixels and sizes of regions along an edge of an image.
pub(super) fn split(size: usize) -> Vec<(usize, usize)> {
    let parts = size.div_ceil(MAX_BLOCKS * BLOCK);
    let edge = size.div_ceil(parts * BLOCK) * BLOCK;
    let starts = (0..size).step_by(edge);
    starts
        .map(|start| (start, edge.min(size - start)))
        .collect()
}
