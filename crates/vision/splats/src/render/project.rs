//! Projection of Gaussians into the image, eight neighbors at a time.
//!
//! With `J` the lens's Jacobian and `R` the camera's rotation, the covariance in the image is
//! `N Nᵀ + ε I` with `N = J R axes scales`, a matrix of 2x3. Its determinant is computed as
//! `det(N Nᵀ) + ε tr(N Nᵀ) + ε²`, and the first term as the sum of the squares of the minors of N
//! (Cauchy and Binet): no cancellation, however thin the Gaussian.

use rayon::prelude::*;

use super::view::{Rolling, View};
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
    /// m
    pub(super) z: f32,
    /// Index of the Gaussian.
    pub(super) index: u32,
}

/// All visible Gaussians in the order of their indices, and the number of degenerate ones.
pub(super) fn project(
    splats: &Splats,
    view: &View,
    config: &RenderConfig,
    level: Level,
) -> (Vec<Footprint>, usize) {
    let starts: Vec<usize> = (0..splats.len()).step_by(CHUNK).collect();
    let chunks: Vec<(Vec<Footprint>, usize)> = starts
        .into_par_iter()
        .map(|start| {
            level.run(Project {
                splats,
                view,
                config,
                start,
                end: splats.len().min(start + CHUNK),
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

struct Project<'a> {
    splats: &'a Splats,
    view: &'a View,
    config: &'a RenderConfig,
    start: usize,
    end: usize,
    /// `dᵀ Q d` at which the alpha of an opaque Gaussian falls to its minimum, and a margin.
    reach: f32,
}

impl Kernel for Project<'_> {
    type Output = (Vec<Footprint>, usize);

    #[inline(always)]
    fn run<V: Lanes>(self) -> Self::Output {
        let mut out = Vec::new();
        let mut degenerate = 0;
        for start in (self.start..self.end).step_by(LANES) {
            degenerate += self.block::<V>(start, &mut out);
        }
        (out, degenerate)
    }
}

impl Project<'_> {
    /// Appends the visible ones of eight Gaussians; returns the number of degenerate ones.
    #[inline(always)]
    fn block<V: Lanes>(&self, start: usize, out: &mut Vec<Footprint>) -> usize {
        let s = V::splat;
        let config = self.config;
        let count = (self.end - start).min(LANES);
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
        let inverse = s(1.0) / determinant;
        let [xx, xy, yy] = shape.covariance;
        let mut values = [[0.0; LANES]; 13];
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
        while visible != 0 {
            let lane = visible.trailing_zeros() as usize;
            visible &= visible - 1;
            let mut of_lane = [0.0; 13];
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
    fn footprint(&self, values: [f32; 13], index: u32) -> Option<Footprint> {
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

/// Scalar product.
#[inline(always)]
pub(super) fn dot<V: Lanes>(a: &[V; 3], b: &[V; 3]) -> V {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

/// Row times matrix.
#[inline(always)]
pub(super) fn row_times<V: Lanes>(row: &[V; 3], matrix: &[[V; 3]; 3]) -> [V; 3] {
    let [a, b, c] = matrix;
    [
        row[0].mul_add(a[0], row[1].mul_add(b[0], row[2] * c[0])),
        row[0].mul_add(a[1], row[1].mul_add(b[1], row[2] * c[1])),
        row[0].mul_add(a[2], row[1].mul_add(b[2], row[2] * c[2])),
    ]
}

/// A matrix in all lanes.
#[inline(always)]
pub(super) fn splat3x3<V: Lanes>(of: &[[f32; 3]; 3]) -> [[V; 3]; 3] {
    let mut out = [[V::splat(0.0); 3]; 3];
    for i in 0..3 {
        for j in 0..3 {
            out[i][j] = V::splat(of[i][j]);
        }
    }
    out
}

/// `1 / (1 + exp(-x))`.
#[inline(always)]
pub(super) fn sigmoid<V: Lanes>(logit: V) -> V {
    V::splat(1.0) / (V::splat(1.0) + (-logit).exp())
}

/// Positions relative to the camera, m.
pub(super) struct Placement<V> {
    /// In the axes of the world.
    pub(super) offset: [V; 3],
    /// In those of the camera.
    pub(super) p: [V; 3],
}

impl<V: Lanes> Placement<V> {
    #[inline(always)]
    pub(super) fn new(position: [V; 3], view: &View) -> Self {
        let mut offset = position;
        for k in 0..3 {
            offset[k] = position[k] - V::splat(view.center[k]);
        }
        let [a, b, c] = splat3x3(&view.rotation);
        let p = [dot(&a, &offset), dot(&b, &offset), dot(&c, &offset)];
        Self { offset, p }
    }
}

/// The lens at eight points.
pub(super) struct Linear<V> {
    /// px
    pub(super) mean: [V; 2],
    pub(super) jacobian: [[V; 3]; 2],
    /// Lanes in the domain of the lens.
    pub(super) valid: u32,
}

impl<V: Lanes> Linear<V> {
    #[inline(always)]
    pub(super) fn new(place: &Placement<V>, view: &View) -> Self {
        if let Some(lens) = &view.lens {
            return Self::of_lens(&place.p, lens);
        }
        let [x, y, z] = place.p;
        let inverse = V::splat(1.0) / z;
        let mut mean = [V::splat(0.0); 2];
        let mut jacobian = [[V::splat(0.0); 3]; 2];
        for (k, at) in [x, y].into_iter().enumerate() {
            let slope = at * inverse;
            let focal = V::splat(view.focal[k]);
            let bounded = slope
                .max(V::splat(view.slope_min[k]))
                .min(V::splat(view.slope_max[k]));
            mean[k] = focal.mul_add(slope, V::splat(view.principal[k]));
            jacobian[k][k] = focal * inverse;
            jacobian[k][2] = -(focal * inverse) * bounded;
        }
        Self {
            mean,
            jacobian,
            valid: 0xff,
        }
    }

    /// In f64, one lane after the other.
    #[inline(always)]
    fn of_lens(p: &[V; 3], lens: &camera_models::Lens) -> Self {
        let mut points = [[0.0; LANES]; 3];
        for (values, p) in points.iter_mut().zip(p) {
            p.store(values);
        }
        let mut values = [[0.0; LANES]; 8];
        let mut valid = 0;
        for lane in 0..LANES {
            let point = points.map(|values| f64::from(values[lane]));
            if let Some(at) = lens.project_with_jacobians(point) {
                valid |= 1 << lane;
                let j = |row, column| at.by_point[(row, column)] as f32;
                let [x, y] = at.pixel.map(|v| v as f32);
                let all = [x, y, j(0, 0), j(0, 1), j(0, 2), j(1, 0), j(1, 1), j(1, 2)];
                for (values, value) in values.iter_mut().zip(all) {
                    values[lane] = value;
                }
            }
        }
        let [x, y, a, b, c, d, e, f] = values.map(|values| V::load(&values));
        Self {
            mean: [x, y],
            jacobian: [[a, b, c], [d, e, f]],
            valid,
        }
    }
}

/// Rotation matrices of quaternions of any length, rows.
#[inline(always)]
pub(super) fn axes<V: Lanes>(quaternion: [V; 4]) -> [[V; 3]; 3] {
    let [w, x, y, z] = quaternion;
    let square = w.mul_add(w, x.mul_add(x, y.mul_add(y, z * z)));
    // Twice the inverse of the squared length.
    let two = V::splat(2.0) / square;
    let one = V::splat(1.0);
    let (xx, yy, zz) = (x * x * two, y * y * two, z * z * two);
    let (xy, xz, yz) = (x * y * two, x * z * two, y * z * two);
    let (wx, wy, wz) = (w * x * two, w * y * two, w * z * two);
    [
        [one - (yy + zz), xy - wz, xz + wy],
        [xy + wz, one - (xx + zz), yz - wx],
        [xz - wy, yz + wx, one - (xx + yy)],
    ]
}

/// The root `N` of the covariance in the image.
#[inline(always)]
pub(super) fn root<V: Lanes>(
    jacobian: &[[V; 3]; 2],
    view: &View,
    axes: &[[V; 3]; 3],
    scale: &[V; 3],
) -> [[V; 3]; 2] {
    let rotation = splat3x3(&view.rotation);
    let mut root = *jacobian;
    for row in 0..2 {
        root[row] = row_times(&row_times(&jacobian[row], &rotation), axes);
        for k in 0..3 {
            root[row][k] = root[row][k] * scale[k];
        }
    }
    root
}

/// The shear of a rolling shutter.
pub(super) struct Shear<V> {
    /// Motion of the point, negated, m/s.
    pub(super) u: [V; 3],
    /// Velocity of the mean, px/s.
    pub(super) velocity: [V; 2],
    pub(super) gradient: [V; 2],
    /// Time of the mean without shutter, s.
    pub(super) time: V,
    pub(super) denominator: V,
    /// Its inverse.
    pub(super) stretch: V,
}

impl<V: Lanes> Shear<V> {
    #[inline(always)]
    pub(super) fn new(rolling: &Rolling, p: &[V; 3], linear: &Linear<V>) -> Self {
        let s = V::splat;
        let [vx, vy, vz] = [
            s(rolling.velocity[0]),
            s(rolling.velocity[1]),
            s(rolling.velocity[2]),
        ];
        let [wx, wy, wz] = [s(rolling.rate[0]), s(rolling.rate[1]), s(rolling.rate[2])];
        let u = [
            vx + wy * p[2] - wz * p[1],
            vy + wz * p[0] - wx * p[2],
            vz + wx * p[1] - wy * p[0],
        ];
        let [first, second] = &linear.jacobian;
        let velocity = [-dot(first, &u), -dot(second, &u)];
        let gradient = [s(rolling.gradient[0]), s(rolling.gradient[1])];
        let denominator = s(1.0) - gradient[0] * velocity[0] - gradient[1] * velocity[1];
        let time = gradient[0] * (linear.mean[0] - s(rolling.reference[0]))
            + gradient[1] * (linear.mean[1] - s(rolling.reference[1]));
        Self {
            u,
            velocity,
            gradient,
            time,
            denominator,
            stretch: s(1.0) / denominator,
        }
    }

    #[inline(always)]
    fn mean(&self, mean: &[V; 2]) -> [V; 2] {
        let by = self.stretch * self.time;
        [
            self.velocity[0].mul_add(by, mean[0]),
            self.velocity[1].mul_add(by, mean[1]),
        ]
    }

    /// The sheared root: `(I + stretch v gᵀ) N`.
    #[inline(always)]
    pub(super) fn apply(&self, root: &[[V; 3]; 2]) -> [[V; 3]; 2] {
        let mut out = *root;
        for k in 0..3 {
            let along = self.gradient[0] * root[0][k] + self.gradient[1] * root[1][k];
            let along = along * self.stretch;
            out[0][k] = self.velocity[0].mul_add(along, root[0][k]);
            out[1][k] = self.velocity[1].mul_add(along, root[1][k]);
        }
        out
    }
}

/// The covariance in the image.
pub(super) struct Shape<V> {
    /// xx, xy, yy with dilation, px².
    pub(super) covariance: [V; 3],
    /// Of the covariance with dilation, px⁴.
    pub(super) determinant: V,
    /// Without dilation.
    pub(super) still: V,
}

impl<V: Lanes> Shape<V> {
    #[inline(always)]
    pub(super) fn new(root: &[[V; 3]; 2], dilation: f32) -> Self {
        let [a, b] = root;
        let (xx, xy, yy) = (dot(a, a), dot(a, b), dot(b, b));
        let minors = [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ];
        let still = dot(&minors, &minors);
        let e = V::splat(dilation);
        let determinant = e.mul_add(xx + yy + e, still);
        Self {
            covariance: [xx + e, xy, yy + e],
            determinant,
            still,
        }
    }

    /// Factor on the opacity, not below `min`.
    #[inline(always)]
    pub(super) fn compensation(&self, min: f32) -> V {
        (self.still / self.determinant).sqrt().max(V::splat(min))
    }
}

/// Unit directions from the camera and distances, m.
#[inline(always)]
pub(super) fn directions<V: Lanes>(place: &Placement<V>) -> ([V; 3], V) {
    let [x, y, z] = place.offset;
    let distance = x.mul_add(x, y.mul_add(y, z * z)).sqrt();
    let inverse = V::splat(1.0) / distance;
    ([x * inverse, y * inverse, z * inverse], distance)
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
