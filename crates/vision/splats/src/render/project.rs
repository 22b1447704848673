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
        let planes = self.splats.planes();
        let count = (self.end - start).min(LANES);
        let load = |plane: usize| load_padded::<V>(&planes[plane], start, count);
        let place = Placement::new(
            std::array::from_fn(|k| load(Plane::POSITION + k)),
            self.view,
        );
        let z = place.p[2];
        let mut visible = z.less(s(config.near_m)).or(s(config.far_m).less(z)).bits() ^ 0xff;
        visible &= (1 << count) - 1;
        if visible == 0 {
            return 0;
        }
        let scale: [V; 3] = std::array::from_fn(|k| load(Plane::SCALE + k).exp());
        let Linear {
            mean,
            jacobian,
            valid,
        } = Linear::new(&place, self.view);
        visible &= valid;
        if self.view.rolling.is_none() {
            visible &= self.near_image(&mean, &jacobian, &scale);
        }
        if visible == 0 {
            return 0;
        }
        let rotation = axes(std::array::from_fn(|k| load(Plane::ROTATION + k)));
        let root = root(&jacobian, self.view, &rotation, &scale);
        let shear = self
            .view
            .rolling
            .map(|rolling| Shear::new(&rolling, &place.p, &jacobian, &mean));
        let (mean, root) = match &shear {
            None => (mean, root),
            Some(shear) => {
                visible &= s(config.min_shear).less(shear.denominator).bits();
                (shear.mean(&mean), shear.apply(&root))
            }
        };
        let Shape {
            covariance: [xx, xy, yy],
            determinant,
            still,
        } = Shape::new(&root, config.dilation_px2);
        let representable = s(0.0)
            .less(determinant)
            .and(determinant.less(s(MAX_DETERMINANT)))
            .bits();
        let degenerate = (visible & !representable).count_ones() as usize;
        visible &= representable;
        let compensation = match config.compensate {
            true => (still / determinant)
                .max(s(0.0))
                .sqrt()
                .max(s(config.min_compensation)),
            false => s(1.0),
        };
        let opacity = sigmoid(load(Plane::OPACITY)) * compensation;
        visible &= opacity.less(s(config.min_alpha)).bits() ^ 0xff;
        if visible == 0 {
            return degenerate;
        }
        let color = color(&place, self.splats.degree(), load);
        let inverse = s(1.0) / determinant;
        let values = [
            mean[0],
            mean[1],
            yy * inverse,
            -xy * inverse,
            xx * inverse,
            inverse,
            xx,
            yy,
            opacity,
            color[0],
            color[1],
            color[2],
            z,
        ];
        let values = values.map(|value| {
            let mut lanes = [0.0; LANES];
            value.store(&mut lanes);
            lanes
        });
        while visible != 0 {
            let lane = visible.trailing_zeros() as usize;
            visible &= visible - 1;
            out.extend(self.footprint(values.map(|lanes| lanes[lane]), (start + lane) as u32));
        }
        degenerate
    }

    /// Lanes whose ellipse can reach the image: the largest scale bounds it in every direction.
    #[inline(always)]
    fn near_image<V: Lanes>(&self, mean: &[V; 2], jacobian: &[[V; 3]; 2], scale: &[V; 3]) -> u32 {
        let s = V::splat;
        let largest = scale[0].max(scale[1]).max(scale[2]);
        // The ellipse of an opacity of 1, with a margin for rounding.
        let reach = s(2.0 * libm::logf(1.0 / self.config.min_alpha) * 1.001);
        let mut near = 0xff;
        for (k, size) in [self.view.width, self.view.height].into_iter().enumerate() {
            let [a, b, c] = jacobian[k];
            let square = a.mul_add(a, b.mul_add(b, c * c));
            let variance = square.mul_add(largest * largest, s(self.config.dilation_px2));
            let extent = (variance * reach).sqrt() + s(1.0);
            near &= (s(0.0) - extent).less(mean[k]).bits();
            near &= mean[k].less(s(size as f32) + extent).bits();
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

/// Eight values of a plane; zeros beyond `count`.
#[inline(always)]
pub(super) fn load_padded<V: Lanes>(plane: &[f32], start: usize, count: usize) -> V {
    match plane[start..].first_chunk::<LANES>() {
        Some(values) => V::load(values),
        None => {
            let mut values = [0.0; LANES];
            values[..count].copy_from_slice(&plane[start..start + count]);
            V::load(&values)
        }
    }
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
        let offset: [V; 3] = std::array::from_fn(|k| position[k] - V::splat(view.center[k]));
        let along = |row: [f32; 3]| {
            let [a, b, c] = row.map(V::splat);
            a.mul_add(offset[0], b.mul_add(offset[1], c * offset[2]))
        };
        Self {
            offset,
            p: view.rotation.map(along),
        }
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

/// `J R`: the lens's Jacobian in the axes of the world.
#[inline(always)]
pub(super) fn jacobian_in_world<V: Lanes>(jacobian: &[[V; 3]; 2], view: &View) -> [[V; 3]; 2] {
    jacobian.map(|row| {
        std::array::from_fn(|k| {
            let column: [V; 3] = std::array::from_fn(|i| V::splat(view.rotation[i][k]));
            row[0].mul_add(column[0], row[1].mul_add(column[1], row[2] * column[2]))
        })
    })
}

/// The root `N` of the covariance in the image.
#[inline(always)]
pub(super) fn root<V: Lanes>(
    jacobian: &[[V; 3]; 2],
    view: &View,
    axes: &[[V; 3]; 3],
    scale: &[V; 3],
) -> [[V; 3]; 2] {
    jacobian_in_world(jacobian, view).map(|row| {
        std::array::from_fn(|k| {
            let along = row[0].mul_add(axes[0][k], row[1].mul_add(axes[1][k], row[2] * axes[2][k]));
            along * scale[k]
        })
    })
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
    pub(super) fn new(
        rolling: &Rolling,
        p: &[V; 3],
        jacobian: &[[V; 3]; 2],
        mean: &[V; 2],
    ) -> Self {
        let s = V::splat;
        let [vx, vy, vz] = rolling.velocity.map(s);
        let [wx, wy, wz] = rolling.rate.map(s);
        let u = [
            vx + wy * p[2] - wz * p[1],
            vy + wz * p[0] - wx * p[2],
            vz + wx * p[1] - wy * p[0],
        ];
        let velocity = jacobian.map(|row| -(row[0] * u[0] + row[1] * u[1] + row[2] * u[2]));
        let gradient = rolling.gradient.map(s);
        let denominator = s(1.0) - gradient[0] * velocity[0] - gradient[1] * velocity[1];
        let time = gradient[0] * (mean[0] - s(rolling.reference[0]))
            + gradient[1] * (mean[1] - s(rolling.reference[1]));
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
        std::array::from_fn(|k| self.velocity[k].mul_add(by, mean[k]))
    }

    /// The sheared root: `(I + stretch v gᵀ) N`.
    #[inline(always)]
    pub(super) fn apply(&self, root: &[[V; 3]; 2]) -> [[V; 3]; 2] {
        let along: [V; 3] = std::array::from_fn(|k| {
            (self.gradient[0] * root[0][k] + self.gradient[1] * root[1][k]) * self.stretch
        });
        std::array::from_fn(|row| {
            std::array::from_fn(|k| self.velocity[row].mul_add(along[k], root[row][k]))
        })
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
        let [a, b] = *root;
        let dot = |a: [V; 3], b: [V; 3]| a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]));
        let minor = |i: usize, j: usize| a[i] * b[j] - a[j] * b[i];
        let (xx, xy, yy) = (dot(a, a), dot(a, b), dot(b, b));
        let minors = [minor(1, 2), minor(2, 0), minor(0, 1)];
        let still = dot(minors, minors);
        let e = V::splat(dilation);
        let determinant = e.mul_add(xx + yy + e, still);
        Self {
            covariance: [xx + e, xy, yy + e],
            determinant,
            still,
        }
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
fn color<V: Lanes>(place: &Placement<V>, degree: usize, load: impl Fn(usize) -> V) -> [V; 3] {
    let (direction, _) = directions(place);
    let basis = harmonics::basis(direction, degree);
    let mut color = [V::splat(0.5); 3];
    for (k, value) in basis.iter().take(coefficients(degree)).enumerate() {
        for (c, sum) in color.iter_mut().enumerate() {
            *sum = value.mul_add(load(Plane::HARMONICS + 3 * k + c), *sum);
        }
    }
    color.map(|value| value.max(V::splat(0.0)))
}
