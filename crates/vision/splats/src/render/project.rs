//! Projection of Gaussians into the image, eight neighbors at a time.
//!
//! With `J` the lens's Jacobian and `R` the camera's rotation, the covariance in the image is
//! `N Nᵀ + ε I` with `N = J R axes scales`, a matrix of 2x3. Its determinant is computed as
//! `det(N Nᵀ) + ε tr(N Nᵀ) + ε²`, and the first term as the sum of the squares of the minors of N
//! (Cauchy and Binet): no cancellation, however thin the Gaussian.

use std::ops::Range;

use rayon::prelude::*;

use super::geometry::{Linear, Placement, Shape, Shear, axes, directions, dot, root, sigmoid};
use super::slope::{Slope, depth_root};
use super::view::View;
use crate::config::RenderConfig;
use crate::harmonics;
use crate::lanes::{Kernel, LANES, Lanes, Level};
use crate::scene::{Plane, Splats, coefficients};

/// Gaussians of a task. A constant, so that results do not depend on the number of threads.
const CHUNK: usize = 4096;

/// Largest determinant of a covariance in the image, px⁴; beyond it f32 is not enough.
const MAX_DETERMINANT: f32 = 1e30;

/// A Gaussian in the image.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Footprint {
    /// px
    pub(super) mean: [f32; 2],
    /// Inverse covariance `a b; b c`, px⁻².
    pub(super) conic: [f32; 3],
    /// Its determinant, px⁻⁴.
    pub(super) determinant: f32,
    /// `dᵀ Q d` at which alpha falls to its minimum.
    pub(super) reach: f32,
    /// Half of the box around the ellipse of that value, px.
    pub(super) extent: [f32; 2],
    /// Opacity, after compensation.
    pub(super) opacity: f32,
    pub(super) color: [f32; 3],
    /// Depth of the mean, m.
    pub(super) z: f32,
    /// Change of depth along x and y, m/px.
    pub(super) slope: [f32; 2],
    /// Index of the Gaussian.
    pub(super) index: u32,
}

/// All visible Gaussians of some ranges, in their order, and the number of degenerate ones.
/// `ranges_per_task` ranges are one task.
pub(super) fn project(
    splats: &Splats,
    ranges: &[Range<usize>],
    ranges_per_task: usize,
    view: &View,
    config: &RenderConfig,
    level: Level,
) -> (Vec<Footprint>, usize) {
    let chunks: Vec<(Vec<Footprint>, usize)> = ranges
        .par_chunks(ranges_per_task)
        .map(|ranges| {
            level.run(Project {
                splats,
                view,
                config,
                ranges,
                reach: 2.0 * libm::logf(1.0 / config.min_alpha) * 1.001,
            })
        })
        .collect();
    let mut footprints = Vec::with_capacity(chunks.iter().map(|chunk| chunk.0.len()).sum());
    let mut degenerate = 0;
    for (chunk, dropped) in chunks {
        footprints.extend(chunk);
        degenerate += dropped;
    }
    (footprints, degenerate)
}

/// All Gaussians, in ranges of one task each.
pub(super) fn whole(splats: &Splats) -> Vec<Range<usize>> {
    let starts = (0..splats.len()).step_by(CHUNK);
    starts
        .map(|start| start..splats.len().min(start + CHUNK))
        .collect()
}

struct Project<'a> {
    splats: &'a Splats,
    view: &'a View,
    config: &'a RenderConfig,
    ranges: &'a [Range<usize>],
    /// `dᵀ Q d` at which the alpha of an opaque Gaussian falls to its minimum, and a margin.
    reach: f32,
}

impl Kernel for Project<'_> {
    type Output = (Vec<Footprint>, usize);

    #[inline(always)]
    fn run<V: Lanes>(self) -> Self::Output {
        let mut out = Vec::new();
        let mut degenerate = 0;
        for range in self.ranges {
            for start in range.clone().step_by(LANES) {
                let count = (range.end - start).min(LANES);
                degenerate += self.block::<V>(start, count, &mut out);
            }
        }
        (out, degenerate)
    }
}

impl Project<'_> {
    /// Appends the visible ones of eight Gaussians; returns the number of degenerate ones.
    #[inline(always)]
    fn block<V: Lanes>(&self, start: usize, count: usize, out: &mut Vec<Footprint>) -> usize {
        let s = V::splat;
        let config = self.config;
        let block = Block {
            planes: self.splats.planes(),
            start,
            count,
        };
        let place = Placement::new(block.load3::<V>(Plane::POSITION), self.view);
        let z = place.p[2];
        let hidden = z.less(s(config.near_m)).or(s(config.far_m).less(z));
        let mut visible = (hidden.bits() ^ 0xff) & ((1 << count) - 1);
        if visible == 0 {
            return 0;
        }
        let [sx, sy, sz] = block.load3::<V>(Plane::SCALE);
        let scale = [sx.exp(), sy.exp(), sz.exp()];
        let linear = Linear::new(&place, self.view);
        visible &= linear.valid;
        if self.view.rolling.is_none() {
            visible &= self.near_image(&linear, &scale);
        }
        if visible == 0 {
            return 0;
        }
        let axes = axes(block.load4::<V>(Plane::ROTATION));
        let mut root = root(&linear.jacobian, self.view, &axes, &scale);
        let mut mean = linear.mean;
        if let Some(rolling) = &self.view.rolling {
            let shear = Shear::new(rolling, &place.p, &linear);
            visible &= s(config.min_shear).less(shear.denominator).bits();
            mean = shear.mean(&mean);
            root = shear.apply(&root);
        }
        let shape = Shape::new(&root, config.dilation_px2);
        let determinant = shape.determinant;
        let representable = s(0.0)
            .less(determinant)
            .and(determinant.less(s(MAX_DETERMINANT)));
        let degenerate = (visible & !representable.bits()).count_ones() as usize;
        visible &= representable.bits();
        let compensation = match config.compensate {
            true => shape.compensation(config.min_compensation),
            false => s(1.0),
        };
        let opacity = sigmoid(block.load::<V>(Plane::OPACITY)) * compensation;
        visible &= opacity.less(s(config.min_alpha)).bits() ^ 0xff;
        if visible == 0 {
            return degenerate;
        }
        let [red, green, blue] = color(&place, self.splats.degree(), &block);
        let depth_root = depth_root(self.view, &axes, &scale);
        let slope = Slope::new(&root, &depth_root, &shape, z, (self.view, config));
        let inverse = s(1.0) / determinant;
        let [xx, xy, yy] = shape.covariance;
        let mut values = [[0.0; LANES]; 15];
        mean[0].store(&mut values[0]);
        mean[1].store(&mut values[1]);
        (yy * inverse).store(&mut values[2]);
        (-xy * inverse).store(&mut values[3]);
        (xx * inverse).store(&mut values[4]);
        inverse.store(&mut values[5]);
        xx.store(&mut values[6]);
        yy.store(&mut values[7]);
        opacity.store(&mut values[8]);
        red.store(&mut values[9]);
        green.store(&mut values[10]);
        blue.store(&mut values[11]);
        z.store(&mut values[12]);
        slope.value[0].store(&mut values[13]);
        slope.value[1].store(&mut values[14]);
        while visible != 0 {
            let lane = visible.trailing_zeros() as usize;
            visible &= visible - 1;
            let mut of_lane = [0.0; 15];
            for (value, lanes) in of_lane.iter_mut().zip(&values) {
                *value = lanes[lane % LANES];
            }
            out.extend(self.footprint(of_lane, (start + lane) as u32));
        }
        degenerate
    }

    /// Lanes whose ellipse can reach the image: the largest scale bounds it in every direction.
    #[inline(always)]
    fn near_image<V: Lanes>(&self, linear: &Linear<V>, scale: &[V; 3]) -> u32 {
        let s = V::splat;
        let largest = scale[0].max(scale[1]).max(scale[2]);
        // The ellipse of an opacity of 1, with a margin for rounding.
        let reach = s(self.reach);
        let size = [self.view.width as f32, self.view.height as f32];
        let mut near = 0xff;
        for k in 0..2 {
            let row = linear.jacobian[k];
            let variance = dot(&row, &row).mul_add(largest * largest, s(self.config.dilation_px2));
            let extent = (variance * reach).sqrt() + s(1.0);
            near &= (-extent).less(linear.mean[k]).bits();
            near &= linear.mean[k].less(s(size[k]) + extent).bits();
        }
        near
    }

    /// The footprint of one lane, if it contains the center of a pixel.
    #[inline(always)]
    fn footprint(&self, values: [f32; 15], index: u32) -> Option<Footprint> {
        let [
            x,
            y,
            a,
            b,
            c,
            determinant,
            xx,
            yy,
            opacity,
            red,
            green,
            blue,
            z,
            slope_x,
            slope_y,
        ] = values;
        let reach = 2.0 * libm::logf(opacity / self.config.min_alpha);
        let extent = [(reach * xx).sqrt(), (reach * yy).sqrt()];
        let outside = |m: f32, e: f32, size: usize| !(m + e >= 0.0 && m - e <= (size - 1) as f32);
        if outside(x, extent[0], self.view.width) || outside(y, extent[1], self.view.height) {
            return None;
        }
        Some(Footprint {
            mean: [x, y],
            conic: [a, b, c],
            determinant,
            reach,
            extent,
            opacity,
            color: [red, green, blue],
            z,
            slope: [slope_x, slope_y],
            index,
        })
    }
}

/// Eight neighboring Gaussians, fewer at the end.
pub(super) struct Block<'a> {
    pub(super) planes: &'a [Vec<f32>],
    pub(super) start: usize,
    pub(super) count: usize,
}

impl Block<'_> {
    /// Eight values of a plane; zeros beyond `count`.
    #[inline(always)]
    fn load<V: Lanes>(&self, plane: usize) -> V {
        let from = &self.planes[plane][self.start..];
        match from.first_chunk::<LANES>() {
            Some(values) => V::load(values),
            None => {
                let mut values = [0.0; LANES];
                values[..self.count].copy_from_slice(&from[..self.count]);
                V::load(&values)
            }
        }
    }

    #[inline(always)]
    fn load3<V: Lanes>(&self, plane: usize) -> [V; 3] {
        [self.load(plane), self.load(plane + 1), self.load(plane + 2)]
    }

    #[inline(always)]
    fn load4<V: Lanes>(&self, plane: usize) -> [V; 4] {
        let [a, b, c] = self.load3(plane);
        [a, b, c, self.load(plane + 3)]
    }
}

/// Colors towards the camera.
#[inline(always)]
fn color<V: Lanes>(place: &Placement<V>, degree: usize, block: &Block<'_>) -> [V; 3] {
    let (direction, _) = directions(place);
    let basis = harmonics::basis(direction, degree);
    let half = V::splat(0.5);
    let [mut red, mut green, mut blue] = [half; 3];
    for k in 0..coefficients(degree) {
        let [r, g, b] = block.load3::<V>(Plane::HARMONICS + 3 * k);
        red = basis[k].mul_add(r, red);
        green = basis[k].mul_add(g, green);
        blue = basis[k].mul_add(b, blue);
    }
    let zero = V::splat(0.0);
    [red.max(zero), green.max(zero), blue.max(zero)]
}
