//! Geometry of eight Gaussians: positions, lens, axes, shutter, covariance.

use super::view::{Rolling, View};
use crate::lanes::{LANES, Lanes};

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
            return Self::of_lens(&place.p, lens, view);
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

    /// In f64, one lane after the other. Lanes far beyond the image are not valid.
    #[inline(always)]
    fn of_lens(p: &[V; 3], lens: &camera_models::Lens, view: &View) -> Self {
        let mut points = [[0.0; LANES]; 3];
        for (values, p) in points.iter_mut().zip(p) {
            p.store(values);
        }
        let mut values = [[0.0; LANES]; 8];
        let mut valid = 0;
        for lane in 0..LANES {
            let point = points.map(|values| f64::from(values[lane]));
            let at = lens.project_with_jacobians(point).filter(|at| {
                let inside =
                    |k: usize| (view.pixel_min[k]..=view.pixel_max[k]).contains(&at.pixel[k]);
                inside(0) && inside(1)
            });
            if let Some(at) = at {
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
    pub(super) fn mean(&self, mean: &[V; 2]) -> [V; 2] {
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
