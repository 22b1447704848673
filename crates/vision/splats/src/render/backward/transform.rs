//! From gradients of footprints to those of parameters and of the camera's motion, eight Gaussians
//! at a time.
//!
//! The root of the covariance in the image is `N = S J R A diag(s)`: shear of the shutter, lens,
//! camera, axes and scales. With `G` the gradient of the covariance, that of the root is `2 G N`,
//! and the factors follow by the product rule. The root of the depth, the row of depth of `R A
//! diag(s)`, is a third row of it that neither lens nor shutter change.

mod factors;
mod lens;
mod motion;

use factors::{Factors, quaternion_gradient};
use lens::add_lens;
use motion::{motion, times_transposed};
use rayon::prelude::*;

use super::tile::Slot;
use crate::config::RenderConfig;
use crate::harmonics;
use crate::lanes::{Kernel, LANES, Lanes};
use crate::render::forward::{Pass, Renderer};
use crate::render::geometry::{
    Linear, Placement, Shape, Shear, axes, directions, dot, row_times, sigmoid, splat3x3,
};
use crate::render::gradients::Gradients;
use crate::render::project::Footprint;
use crate::render::slope::{Slope, depth_root};
use crate::render::view::View;
use crate::scene::{Plane, Scene, coefficients};

/// Gaussians of a task. A constant, so that results do not depend on the number of threads.
const CHUNK: usize = 1024;

pub(super) fn transform(
    renderer: &Renderer,
    scene: &Scene,
    view: &View,
    pass: &Pass,
    slots: &[Slot],
    out: &mut Gradients,
) {
    let chunks = pass.footprints.len().div_ceil(CHUNK);
    let mut planes: Vec<Vec<&mut [f32]>> = (0..chunks).map(|_| Vec::new()).collect();
    for plane in &mut out.planes {
        for (of_chunk, slice) in planes.iter_mut().zip(plane.chunks_mut(CHUNK)) {
            of_chunk.push(slice);
        }
    }
    let motions: Vec<[f64; 6]> = planes
        .into_par_iter()
        .zip(out.absolute.par_chunks_mut(CHUNK))
        .zip(out.error.par_chunks_mut(CHUNK))
        .zip(out.weight.par_chunks_mut(CHUNK))
        .enumerate()
        .map(|(chunk, (((planes, absolute), error), weight))| {
            renderer.level.run(Transform {
                scene,
                view,
                config: &renderer.config,
                pass,
                slots,
                start: chunk * CHUNK,
                planes,
                absolute,
                error,
                weight,
            })
        })
        .collect();
    for motion in motions {
        for (sum, value) in out.motion.iter_mut().zip(motion) {
            *sum += value;
        }
    }
}

struct Transform<'a> {
    scene: &'a Scene,
    view: &'a View,
    config: &'a RenderConfig,
    pass: &'a Pass,
    slots: &'a [Slot],
    start: usize,
    planes: Vec<&'a mut [f32]>,
    absolute: &'a mut [[f32; 2]],
    error: &'a mut [f32],
    weight: &'a mut [f32],
}

impl Kernel for Transform<'_> {
    type Output = [f64; 6];

    #[inline(always)]
    fn run<V: Lanes>(mut self) -> [f64; 6] {
        let mut motion = [0.0; 6];
        for start in (0..self.absolute.len()).step_by(LANES) {
            let count = LANES.min(self.absolute.len() - start);
            let gathered = self.gather(start, count);
            let of_block = self.block::<V>(&gathered, start, count);
            for k in 0..6 {
                let mut lanes = [0.0; LANES];
                of_block[k].store(&mut lanes);
                for lane in 0..count {
                    motion[k] += f64::from(lanes[lane]);
                }
            }
        }
        motion
    }
}

/// Eight Gaussians: their sums over pixels and their parameters, by lane.
struct BlockGradients {
    /// The moments, then red, green, blue, depth and its slope.
    sums: [[f32; LANES]; 12],
    /// Colors, to know where they are cut at 0.
    color: [[f32; LANES]; 3],
    /// Planes before the harmonics.
    parameters: [[f32; LANES]; Plane::HARMONICS],
    harmonics: [[f32; LANES]; 48],
}

impl Transform<'_> {
    /// Sums the slots of eight Gaussians in order. Lanes beyond `count` repeat the first one.
    #[inline(always)]
    fn gather(&mut self, start: usize, count: usize) -> BlockGradients {
        let mut out = BlockGradients {
            sums: [[0.0; LANES]; 12],
            color: [[0.0; LANES]; 3],
            parameters: [[0.0; LANES]; Plane::HARMONICS],
            harmonics: [[0.0; LANES]; 48],
        };
        let harmonics = 3 * coefficients(self.scene.splats.degree());
        let planes = self.scene.splats.planes();
        for lane in 0..LANES {
            let at = start + if lane < count { lane } else { 0 };
            let footprint: &Footprint = &self.pass.footprints[self.start + at];
            let index = footprint.index as usize;
            for plane in 0..Plane::HARMONICS {
                out.parameters[plane][lane] = planes[plane][index];
            }
            for k in 0..harmonics {
                out.harmonics[k][lane] = planes[Plane::HARMONICS + k][index];
            }
            for c in 0..3 {
                out.color[c][lane] = footprint.color[c];
            }
            let mut sum = Slot::default();
            for entry in self.pass.bins.entries_of(self.start + at) {
                sum.add(&self.slots[*entry as usize]);
            }
            for k in 0..6 {
                out.sums[k][lane] = sum.moments[k];
            }
            for k in 0..4 {
                out.sums[6 + k][lane] = sum.color[k];
            }
            for k in 0..2 {
                out.sums[10 + k][lane] = sum.slope[k];
            }
            self.absolute[at] = sum.absolute;
            self.error[at] = sum.error;
            self.weight[at] = sum.weight;
        }
        out
    }

    /// Stores the gradients of eight Gaussians; returns those of the motion, by lane.
    #[inline(always)]
    fn block<V: Lanes>(&mut self, g: &BlockGradients, start: usize, count: usize) -> [V; 6] {
        let parameter = |plane: usize| V::load(&g.parameters[plane]);
        let position = [parameter(0), parameter(1), parameter(2)];
        let scale = [parameter(3).exp(), parameter(4).exp(), parameter(5).exp()];
        let quaternion = [parameter(6), parameter(7), parameter(8), parameter(9)];
        let place = Placement::new(position, self.view);
        let linear = Linear::new(&place, self.view);
        let axes = axes(quaternion);
        let rotation = splat3x3::<V>(&self.view.rotation);
        let in_world = [
            row_times(&linear.jacobian[0], &rotation),
            row_times(&linear.jacobian[1], &rotation),
            rotation[2],
        ];
        let mut still = [
            row_times(&in_world[0], &axes),
            row_times(&in_world[1], &axes),
        ];
        for row in 0..2 {
            for k in 0..3 {
                still[row][k] = still[row][k] * scale[k];
            }
        }
        let rolling = self.view.rolling.as_ref();
        let shear = rolling.map(|rolling| (Shear::new(rolling, &place.p, &linear), rolling.rate));
        let root = match &shear {
            Some((shear, _)) => shear.apply(&still),
            None => still,
        };
        let opacity = sigmoid(parameter(Plane::OPACITY));
        let depth_root = depth_root(self.view, &axes, &scale);
        let image = self.image(g, &root, &depth_root, place.p[2], opacity);
        let mut mean = image.mean;
        let mut by_root = image.root;
        let mut by_jacobian = [[V::splat(0.0); 3]; 2];
        let mut by_point = [V::splat(0.0), V::splat(0.0), image.z];
        if let Some((shear, rate)) = &shear {
            let of = shear.backward(&mean, &by_root, &still, &linear, *rate);
            (mean, by_root, by_jacobian) = (of.mean, of.root, of.jacobian);
            for k in 0..3 {
                by_point[k] = by_point[k] + of.point[k];
            }
        }
        let factors = Factors::new(
            &[by_root[0], by_root[1], image.depth_root],
            &[still[0], still[1], depth_root],
            &in_world,
            &axes,
            &scale,
        );
        let by_camera = [
            times_transposed(&factors.in_world[0], &rotation),
            times_transposed(&factors.in_world[1], &rotation),
            times_transposed(&factors.in_world[2], &rotation),
        ];
        for row in 0..2 {
            for k in 0..3 {
                by_jacobian[row][k] = by_jacobian[row][k] + by_camera[row][k];
            }
        }
        add_lens(
            &place,
            &linear,
            self.view,
            &mean,
            &by_jacobian,
            &mut by_point,
        );
        let by_direction = self.color(g, &place, start, count);
        let to_world = row_times(&by_point, &rotation);
        for k in 0..3 {
            self.put(
                Plane::POSITION + k,
                start,
                count,
                to_world[k] + by_direction[k],
            );
            self.put(Plane::SCALE + k, start, count, factors.scale[k]);
        }
        let by_quaternion = quaternion_gradient(&quaternion, &factors.axes);
        for (k, value) in by_quaternion.into_iter().enumerate() {
            self.put(Plane::ROTATION + k, start, count, value);
        }
        let by_logit = image.opacity * opacity * (V::splat(1.0) - opacity);
        self.put(Plane::OPACITY, start, count, by_logit);
        motion(
            &place,
            &linear,
            &rotation,
            &by_camera,
            &by_point,
            &by_direction,
        )
    }

    #[inline(always)]
    fn put<V: Lanes>(&mut self, plane: usize, start: usize, count: usize, value: V) {
        let to = &mut self.planes[plane][start..];
        match to.first_chunk_mut::<LANES>() {
            Some(to) => value.store(to),
            None => {
                let mut lanes = [0.0; LANES];
                value.store(&mut lanes);
                to[..count].copy_from_slice(&lanes[..count]);
            }
        }
    }

    /// Gradients with respect to mean, roots, depth and opacity before compensation.
    #[inline(always)]
    fn image<V: Lanes>(
        &self,
        g: &BlockGradients,
        root: &[[V; 3]; 2],
        depth_root: &[V; 3],
        z: V,
        opacity: V,
    ) -> ByImage<V> {
        let s = V::splat;
        let shape = Shape::new(root, self.config.dilation_px2);
        let inverse = s(1.0) / shape.determinant;
        let [xx, xy, yy] = shape.covariance;
        let (a, b, c) = (yy * inverse, -xy * inverse, xx * inverse);
        let [m0, mx, my] = [
            V::load(&g.sums[0]),
            V::load(&g.sums[1]),
            V::load(&g.sums[2]),
        ];
        let half = s(0.5);
        let qxx = V::load(&g.sums[3]) * half;
        let qxy = V::load(&g.sums[4]) * half;
        let qyy = V::load(&g.sums[5]) * half;
        let compensation = match self.config.compensate {
            true => shape.compensation(self.config.min_compensation),
            false => s(1.0),
        };
        let by_opacity = -m0 / (opacity * compensation);
        // -Q G Q, symmetric.
        let (t00, t01) = (a * qxx + b * qxy, a * qxy + b * qyy);
        let (t10, t11) = (b * qxx + c * qxy, b * qxy + c * qyy);
        let mut gxx = -(t00 * a + t01 * b);
        let mut gxy = -(t00 * b + t01 * c);
        let mut gyy = -(t10 * b + t11 * c);
        if self.config.compensate {
            let floor = s(self.config.min_compensation);
            let by_square = half * by_opacity * opacity / compensation;
            let by_square = by_square.and(floor.less(compensation));
            let rest = s(1.0) - compensation * compensation;
            let dilation = s(self.config.dilation_px2) * inverse;
            gxx = by_square.mul_add(rest * a - dilation, gxx);
            gxy = by_square.mul_add(rest * b, gxy);
            gyy = by_square.mul_add(rest * c - dilation, gyy);
        }
        let two = s(2.0);
        let mut by_root = *root;
        for k in 0..3 {
            by_root[0][k] = two * (gxx * root[0][k] + gxy * root[1][k]);
            by_root[1][k] = two * (gxy * root[0][k] + gyy * root[1][k]);
        }
        let slope = Slope::new(root, depth_root, &shape, z, (self.view, self.config));
        let by_depth = V::load(&g.sums[9]);
        let by_slope = [V::load(&g.sums[10]), V::load(&g.sums[11])];
        let by_slope = slope.backward(&by_slope, root, depth_root, z, self.config);
        for row in 0..2 {
            for k in 0..3 {
                by_root[row][k] = by_root[row][k] + by_slope.root[row][k];
            }
        }
        ByImage {
            mean: [
                -(a * mx + b * my + slope.value[0] * by_depth),
                -(b * mx + c * my + slope.value[1] * by_depth),
            ],
            root: by_root,
            depth_root: by_slope.depth_root,
            z: by_depth + by_slope.z,
            opacity: by_opacity * compensation,
        }
    }

    /// Stores the gradients of the harmonics; returns that of the position through the direction.
    #[inline(always)]
    fn color<V: Lanes>(
        &mut self,
        g: &BlockGradients,
        place: &Placement<V>,
        start: usize,
        count: usize,
    ) -> [V; 3] {
        let degree = self.scene.splats.degree();
        let zero = V::splat(0.0);
        let (direction, distance) = directions(place);
        let mut gradient = [zero; 3];
        for c in 0..3 {
            let positive = zero.less(V::load(&g.color[c]));
            gradient[c] = V::load(&g.sums[6 + c]).and(positive);
        }
        let basis = harmonics::basis(direction, degree);
        let mut weights = [zero; 16];
        for k in 0..coefficients(degree) {
            for c in 0..3 {
                self.put(
                    Plane::HARMONICS + 3 * k + c,
                    start,
                    count,
                    basis[k] * gradient[c],
                );
                let of = V::load(&g.harmonics[3 * k + c]);
                weights[k] = gradient[c].mul_add(of, weights[k]);
            }
        }
        let by = harmonics::gradient(direction, &weights, degree);
        let along = dot(&by, &direction);
        let inverse = V::splat(1.0) / distance;
        [
            (by[0] - direction[0] * along) * inverse,
            (by[1] - direction[1] * along) * inverse,
            (by[2] - direction[2] * along) * inverse,
        ]
    }
}

struct ByImage<V> {
    mean: [V; 2],
    root: [[V; 3]; 2],
    depth_root: [V; 3],
    z: V,
    opacity: V,
}
