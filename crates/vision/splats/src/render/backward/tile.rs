//! Gradients of a tile: the sums over its pixels for each of its Gaussians, front to back.
//!
//! The blending is repeated. What lies behind a Gaussian is what was behind the one before it,
//! minus its own part. With `s = ∂L/∂σ = -α ∂L/∂α` and `d = u - m`, the sums of `s`, `s d` and `s d
//! dᵀ` give the gradients with respect to opacity, mean and conic.

use super::pixels::TileGradient;
use crate::config::RenderConfig;
use crate::lanes::{Kernel, LANES, Lanes};
use crate::render::blend::{Batch, CELLS, Local, cells, origin, start};
use crate::render::project::Footprint;
use crate::render::view::View;

/// Sums over the pixels of a tile.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::render) struct Slot {
    /// `s`, `s dx`, `s dy`, `s dx²`, `s dx dy`, `s dy²`.
    pub(super) moments: [f32; 6],
    /// Absolute values of the gradient with respect to the mean through alpha, x and y, 1/px.
    pub(super) absolute: [f32; 2],
    /// With respect to red, green, blue and the depth of the mean.
    pub(super) color: [f32; 4],
    /// With respect to the slope of depth.
    pub(super) slope: [f32; 2],
    /// Weight times error.
    pub(super) error: f32,
    pub(super) weight: f32,
}

impl Slot {
    #[inline(always)]
    pub(super) fn add(&mut self, other: &Self) {
        for k in 0..6 {
            self.moments[k] += other.moments[k];
        }
        for k in 0..2 {
            self.absolute[k] += other.absolute[k];
        }
        for k in 0..4 {
            self.color[k] += other.color[k];
        }
        for k in 0..2 {
            self.slope[k] += other.slope[k];
        }
        self.error += other.error;
        self.weight += other.weight;
    }
}

pub(super) struct TileBackward<'a> {
    pub(super) footprints: &'a [Footprint],
    pub(super) entries: &'a [u32],
    pub(super) view: &'a View,
    pub(super) tile: usize,
    pub(super) config: &'a RenderConfig,
    pub(super) gradient: &'a TileGradient,
    /// One per entry.
    pub(super) slots: &'a mut [Slot],
}

/// Sums over cells, one vector each.
#[derive(Clone, Copy)]
struct Sums<V> {
    moments: [V; 6],
    absolute: [V; 2],
    color: [V; 4],
    slope: [V; 2],
    error: V,
    weight: V,
}

impl<V: Lanes> Sums<V> {
    #[inline(always)]
    fn zero() -> Self {
        let zero = V::splat(0.0);
        Self {
            moments: [zero; 6],
            absolute: [zero; 2],
            color: [zero; 4],
            slope: [zero; 2],
            error: zero,
            weight: zero,
        }
    }

    #[inline(always)]
    fn store(&self, slot: &mut Slot) {
        for k in 0..6 {
            slot.moments[k] = self.moments[k].sum();
        }
        for k in 0..2 {
            slot.absolute[k] = self.absolute[k].sum();
            slot.slope[k] = self.slope[k].sum();
        }
        for k in 0..4 {
            slot.color[k] = self.color[k].sum();
        }
        slot.error = self.error.sum();
        slot.weight = self.weight.sum();
    }
}

/// State of a tile's pixels.
struct State {
    transmittance: [[f32; LANES]; CELLS],
    behind: [[f32; LANES]; CELLS],
    /// Cells with incomplete pixels.
    live: u32,
}

impl Kernel for TileBackward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let (transmittance, live) = start(self.view, self.tile);
        let mut state = State {
            transmittance,
            behind: self.gradient.behind,
            live,
        };
        let origin = origin(self.view, self.tile).map(|v| v as f32);
        let mut batch = Batch::new(self.footprints, self.entries);
        for slot in self.slots {
            let Some(f) = batch.next() else {
                break;
            };
            let mut bits = cells::<V>(f, origin) & state.live;
            if bits == 0 {
                continue;
            }
            let local = Local::<V>::new(f, origin);
            let mut sums = Sums::zero();
            while bits != 0 {
                let cell = bits.trailing_zeros() as usize % CELLS;
                bits &= bits - 1;
                pixels(
                    f,
                    &local,
                    cell,
                    self.gradient,
                    self.config,
                    &mut state,
                    &mut sums,
                );
            }
            sums.store(slot);
            if state.live == 0 {
                break;
            }
        }
    }
}

/// Adds the pixels of a cell.
#[inline(always)]
fn pixels<V: Lanes>(
    f: &Footprint,
    local: &Local<V>,
    cell: usize,
    gradient: &TileGradient,
    config: &RenderConfig,
    state: &mut State,
    sums: &mut Sums<V>,
) {
    let s = V::splat;
    let unbounded = local.alpha(cell);
    let alpha = unbounded.min(s(config.max_alpha));
    let skipped = alpha.less(s(config.min_alpha));
    if skipped.bits() == 0xff {
        return;
    }
    let before = V::load(&state.transmittance[cell]);
    let product = before * alpha;
    let next = before - product;
    let kept = s(config.min_transmittance).less(next);
    let weight = product.and(kept).and_not(skipped);
    let after = skipped.select(before, kept.select(next, -before.abs()));
    after.store(&mut state.transmittance[cell]);
    if s(0.0).less(after).bits() == 0 {
        state.live &= !(1 << cell);
    }

    let red = V::load(&gradient.rgb[0][cell]);
    let green = V::load(&gradient.rgb[1][cell]);
    let blue = V::load(&gradient.rgb[2][cell]);
    let depth = V::load(&gradient.depth[cell]);
    sums.color[0] = weight.mul_add(red, sums.color[0]);
    sums.color[1] = weight.mul_add(green, sums.color[1]);
    sums.color[2] = weight.mul_add(blue, sums.color[2]);
    let (dx, dy) = local.offset(cell);
    let dy = s(dy);
    let by_depth = weight * depth;
    sums.color[3] = sums.color[3] + by_depth;
    sums.slope[0] = by_depth.mul_add(dx, sums.slope[0]);
    sums.slope[1] = by_depth.mul_add(dy, sums.slope[1]);
    sums.error = weight.mul_add(V::load(&gradient.error[cell]), sums.error);
    sums.weight = sums.weight + weight;
    let own = red.mul_add(
        s(f.color[0]),
        green.mul_add(
            s(f.color[1]),
            blue.mul_add(s(f.color[2]), depth * local.depth(cell)),
        ),
    );
    let behind = V::load(&state.behind[cell]) - weight * own;
    behind.store(&mut state.behind[cell]);

    let by_alpha = before * own - behind / (s(1.0) - alpha);
    // Where alpha is bounded, nothing that it depends on matters.
    let bounded = s(config.max_alpha).less(unbounded);
    let by_sigma = (-(alpha * by_alpha))
        .and(kept)
        .and_not(skipped)
        .and_not(bounded);
    let (sx, sy) = (by_sigma * dx, by_sigma * dy);
    sums.moments[0] = sums.moments[0] + by_sigma;
    sums.moments[1] = sums.moments[1] + sx;
    sums.moments[2] = sums.moments[2] + sy;
    sums.moments[3] = sx.mul_add(dx, sums.moments[3]);
    sums.moments[4] = sx.mul_add(dy, sums.moments[4]);
    sums.moments[5] = sy.mul_add(dy, sums.moments[5]);
    let [a, b, c] = f.conic;
    let along_x = s(a).mul_add(sx, s(b) * sy);
    let along_y = s(b).mul_add(sx, s(c) * sy);
    sums.absolute[0] = sums.absolute[0] + along_x.abs();
    sums.absolute[1] = sums.absolute[1] + along_y.abs();
}
