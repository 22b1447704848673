//! Lens model: projection from directions to pixels and back.
//!
//! Contract: [`Lens::project`] is exact (f64) inside the image and a margin around it. Farther out,
//! where a polynomial distortion is not monotonic and would fold outside directions into the image,
//! it is continued radially, so directions outside remain outside. [`Lens::project_f32`] is the
//! same for rasterization, to 1e-3 px within the image. [`Lens::rays`] is the inverse at every
//! pixel center.

use camera_models::{CameraModel, Distortion, Rational};

/// Maximum radius at which the distortion model is used, relative to that of the farthest image
/// corner.
const MAX_RADIUS_RATIO: f64 = 1.05;

/// Minimum derivative of the distorted radius where the distortion model is used beyond the corner.
const MIN_RADIAL_SLOPE: f64 = 0.2;

/// A camera model prepared for projection.
#[derive(Clone, Debug)]
pub struct Lens {
    model: CameraModel,
    distortion: DistortionModel,
    /// Maximum radius on the plane z = 1 at which the distortion model is used.
    limit: f64,
    fast: FastProjection,
    bounds: [f64; 4],
}

/// Supported distortion models.
#[derive(Clone, Copy, Debug)]
enum DistortionModel {
    Rational(Rational),
    Fisheye([f64; 4]),
}

/// Projection in f32: all distortion models except the fisheye are a ratio of polynomials.
#[derive(Clone, Copy, Debug)]
struct FastProjection {
    limit: f32,
    focal: [f32; 2],
    center: [f32; 2],
    over: [f32; 3],
    under: [f32; 3],
    tangential: [f32; 2],
    fisheye: Option<[f32; 4]>,
}

impl Lens {
    /// Whether a distortion model is supported.
    pub fn can_draw(distortion: &Distortion) -> bool {
        DistortionModel::of(distortion).is_some()
    }

    /// Prepares a camera model.
    ///
    /// # Panics
    /// If [`Self::can_draw`] does not support the distortion.
    pub fn new(model: &CameraModel) -> Self {
        let distortion =
            DistortionModel::of(&model.distortion).expect("a distortion that can be drawn");
        let mut lens = Self {
            model: *model,
            distortion,
            limit: f64::INFINITY,
            fast: FastProjection::of(model, &distortion, f64::INFINITY),
            bounds: [0.0; 4],
        };
        let (w, h) = (f64::from(model.width), f64::from(model.height));
        let corners = [
            (-0.5, -0.5),
            (w - 0.5, -0.5),
            (-0.5, h - 0.5),
            (w - 0.5, h - 0.5),
        ];
        let reach = corners.map(|(u, v)| {
            let (x, y) = lens.unproject(u, v);
            (x * x + y * y).sqrt()
        });
        let reach = reach.into_iter().fold(0.0, f64::max);
        // Only as far as the polynomial is monotonic.
        let distorted = |r: f64| {
            let (x, y) = distort(&distortion, 0.8 * r, 0.6 * r);
            (x * x + y * y).sqrt()
        };
        let steps = 20;
        let step = (MAX_RADIUS_RATIO - 1.0) * reach / f64::from(steps);
        let grows = (0..steps)
            .map(|k| reach + step * f64::from(k))
            .take_while(|&r| distorted(r + step) - distorted(r) > MIN_RADIAL_SLOPE * step);
        lens.limit = grows.last().map_or(reach, |r| r + step);
        lens.fast = FastProjection::of(model, &distortion, lens.limit);
        lens.bounds = lens.border();
        lens
    }

    /// Bounds of the image, extended by one pixel, on the plane z = 1: minimum x and y, maximum x
    /// and y.
    pub fn bounds(&self) -> [f64; 4] {
        self.bounds
    }

    fn border(&self) -> [f64; 4] {
        let (width, height) = (self.model.width as i32, self.model.height as i32);
        let columns = (-1..=width).flat_map(|u| [(u, -1), (u, height)]);
        let rows = (-1..=height).flat_map(|v| [(-1, v), (width, v)]);
        let all = columns.chain(rows);
        let none = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
        all.fold(none, |[x0, y0, x1, y1], (u, v)| {
            let (x, y) = self.unproject(f64::from(u), f64::from(v));
            [x0.min(x), y0.min(y), x1.max(x), y1.max(y)]
        })
    }

    /// [`Lens::project`] for rasterization. The same direction always gives the same bits.
    #[inline(always)]
    pub fn project_f32(&self, x: f32, y: f32) -> (f32, f32) {
        self.fast.project(x, y)
    }

    /// Image size and intrinsics.
    pub fn model(&self) -> &CameraModel {
        &self.model
    }

    /// Whether the distortion model is used for the direction `(x, y, 1)`, rather than its radial
    /// continuation.
    #[inline]
    pub fn is_known(&self, x: f64, y: f64) -> bool {
        x * x + y * y <= self.limit * self.limit
    }

    /// Pixel of the direction `(x, y, 1)` in the optical frame.
    #[inline]
    pub fn project(&self, x: f64, y: f64) -> (f64, f64) {
        let square = x * x + y * y;
        let (x, y) = if square <= self.limit * self.limit {
            distort(&self.distortion, x, y)
        } else {
            let beyond = square.sqrt() / self.limit;
            let (x, y) = distort(&self.distortion, x / beyond, y / beyond);
            (x * beyond, y * beyond)
        };
        (
            self.model.fx * x + self.model.cx,
            self.model.fy * y + self.model.cy,
        )
    }

    /// Direction `(x, y, 1)` of a pixel, to 1e-12 where the distortion is invertible.
    pub fn unproject(&self, u: f64, v: f64) -> (f64, f64) {
        let (goal_x, goal_y) = (
            (u - self.model.cx) / self.model.fx,
            (v - self.model.cy) / self.model.fy,
        );
        let (mut x, mut y) = (goal_x, goal_y);
        for _ in 0..30 {
            let (dx, dy) = distort(&self.distortion, x, y);
            let (ex, ey) = (goal_x - dx, goal_y - dy);
            if ex.abs().max(ey.abs()) < 1e-13 {
                break;
            }
            // Newton step with numerical derivatives.
            let h = 1e-6;
            let (ax, ay) = distort(&self.distortion, x + h, y);
            let (bx, by) = distort(&self.distortion, x, y + h);
            let (xx, yx) = ((ax - dx) / h, (ay - dy) / h);
            let (xy, yy) = ((bx - dx) / h, (by - dy) / h);
            let determinant = xx * yy - xy * yx;
            x += (ex * yy - ey * xy) / determinant;
            y += (ey * xx - ex * yx) / determinant;
        }
        (x, y)
    }

    /// Directions of all pixel centers, offset by `shift` px; row-major.
    pub fn rays(&self, shift: (f64, f64)) -> Vec<[f32; 2]> {
        let rows = 0..self.model.height;
        rows.flat_map(|v| (0..self.model.width).map(move |u| (u, v)))
            .map(|(u, v)| {
                let (x, y) = self.unproject(f64::from(u) + shift.0, f64::from(v) + shift.1);
                [x as f32, y as f32]
            })
            .collect()
    }
}

impl DistortionModel {
    fn of(distortion: &Distortion) -> Option<Self> {
        match *distortion {
            Distortion::KannalaBrandt4 { k1, k2, k3, k4 } => Some(Self::Fisheye([k1, k2, k3, k4])),
            _ => distortion.rational().map(Self::Rational),
        }
    }
}

impl FastProjection {
    fn of(model: &CameraModel, distortion: &DistortionModel, limit: f64) -> Self {
        let (rational, fisheye) = match *distortion {
            DistortionModel::Rational(rational) => (rational, None),
            DistortionModel::Fisheye(k) => (Rational::default(), Some(k.map(|k| k as f32))),
        };
        Self {
            limit: limit as f32,
            focal: [model.fx as f32, model.fy as f32],
            center: [model.cx as f32, model.cy as f32],
            over: rational.over.map(|k| k as f32),
            under: rational.under.map(|k| k as f32),
            tangential: rational.tangential.map(|p| p as f32),
            fisheye,
        }
    }

    #[inline(always)]
    fn project(&self, x: f32, y: f32) -> (f32, f32) {
        // Beyond the limit the distortion is that at the limit.
        let radius = (x * x + y * y).sqrt();
        let beyond = match radius > self.limit {
            true => radius / self.limit,
            false => 1.0,
        };
        let (x, y) = (x / beyond, y / beyond);
        let (x, y) = match &self.fisheye {
            None => self.distorted(x, y),
            Some(k) => {
                let radial = radial_f32(k, x * x + y * y);
                (x * radial, y * radial)
            }
        };
        (
            self.focal[0] * (x * beyond) + self.center[0],
            self.focal[1] * (y * beyond) + self.center[1],
        )
    }

    #[inline(always)]
    fn distorted(&self, x: f32, y: f32) -> (f32, f32) {
        let r2 = x * x + y * y;
        let poly = |[a, b, c]: [f32; 3]| 1.0 + r2 * (a + r2 * (b + r2 * c));
        let radial = poly(self.over) / poly(self.under);
        let [p1, p2] = self.tangential;
        (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }
}

/// Radial factor of a fisheye by the squared radius on the plane z = 1.
fn radial_f32(k: &[f32; 4], r2: f32) -> f32 {
    let r = r2.sqrt();
    if r < 1e-5 {
        return 1.0;
    }
    let angle = libm::atanf(r);
    let a2 = angle * angle;
    angle * (1.0 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3])))) / r
}

/// OpenCV's models (documentation of `calib3d` and `fisheye`).
#[inline]
fn distort(distortion: &DistortionModel, x: f64, y: f64) -> (f64, f64) {
    let r2 = x * x + y * y;
    match distortion {
        DistortionModel::Rational(rational) => {
            let poly = |[a, b, c]: [f64; 3]| 1.0 + r2 * (a + r2 * (b + r2 * c));
            let radial = poly(rational.over) / poly(rational.under);
            let [p1, p2] = rational.tangential;
            (
                x * radial + (2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)),
                y * radial + (p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y),
            )
        }
        DistortionModel::Fisheye([k1, k2, k3, k4]) => {
            let r = r2.sqrt();
            if r < 1e-9 {
                return (x, y);
            }
            let angle = libm::atan(r);
            let a2 = angle * angle;
            let distorted = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))));
            (x * (distorted / r), y * (distorted / r))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model(distortion: Distortion) -> CameraModel {
        CameraModel {
            width: 672,
            height: 376,
            fx: 350.0,
            fy: 351.0,
            cx: 330.0,
            cy: 190.0,
            distortion,
        }
    }

    const K: [f64; 5] = [-0.17, 0.026, 3e-4, -2e-4, 1e-3];

    fn distortions() -> [Distortion; 5] {
        let [k1, k2, p1, p2, k3] = K;
        [
            Distortion::None,
            Distortion::RadTan4 { k1, k2, p1, p2 },
            Distortion::RadTan5 { k1, k2, p1, p2, k3 },
            Distortion::Rational8 {
                k1: 0.3,
                k2: 0.1,
                p1,
                p2,
                k3,
                k4: 0.5,
                k5: 0.1,
                k6: 0.01,
            },
            Distortion::KannalaBrandt4 {
                k1: 0.02,
                k2: -0.01,
                k3: 1e-3,
                k4: -1e-4,
            },
        ]
    }

    /// f32 has 24 bits: about 1e-4 px after these few operations.
    #[test]
    fn f32_projection_agrees_to_a_thousandth_of_a_pixel() {
        for distortion in distortions() {
            let lens = Lens::new(&model(distortion));
            let [x0, y0, x1, y1] = lens.bounds();
            for i in 0..=40 {
                for k in 0..=40 {
                    let part = |a: f64, b: f64, i: i32| a + (b - a) * f64::from(i) / 40.0;
                    let (x, y) = (part(x0, x1, i) as f32, part(y0, y1, k) as f32);
                    let (u, v) = lens.project(f64::from(x), f64::from(y));
                    let (found_u, found_v) = lens.project_f32(x, y);
                    let off = (f64::from(found_u) - u).hypot(f64::from(found_v) - v);
                    assert!(off < 1e-3, "{distortion:?}: {u} {v}: {off}");
                }
            }
        }
    }

    #[test]
    fn image_rays_are_within_bounds() {
        for distortion in distortions() {
            let lens = Lens::new(&model(distortion));
            let [x0, y0, x1, y1] = lens.bounds();
            for ray in lens.rays((0.49, -0.49)) {
                let (x, y) = (f64::from(ray[0]), f64::from(ray[1]));
                assert!(x0 < x && x < x1 && y0 < y && y < y1, "{distortion:?}");
            }
        }
    }

    #[test]
    fn unproject_inverts_project_for_every_model() {
        for distortion in distortions() {
            let lens = Lens::new(&model(distortion));
            for (u, v) in [(0.0, 0.0), (671.0, 375.0), (330.0, 190.0), (12.5, 300.25)] {
                let (x, y) = lens.unproject(u, v);
                let (found_u, found_v) = lens.project(x, y);
                assert!(
                    (found_u - u).abs() < 1e-8 && (found_v - v).abs() < 1e-8,
                    "{distortion:?}: {u} {v} became {found_u} {found_v}"
                );
            }
        }
    }

    #[test]
    fn directions_outside_project_outside() {
        // This polynomial has its maximum at a radius of 1.8 and is zero again at 3.2.
        let lens = Lens::new(&model(Distortion::RadTan4 {
            k1: -0.1,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
        }));
        for angle in 0..360 {
            let (s, c) = f64::from(angle).to_radians().sin_cos();
            let mut last = 0.0;
            for step in 1..2000 {
                let r = 0.01 * f64::from(step);
                let (u, v) = lens.project(r * c, r * s);
                let out = (u - 330.0).hypot(v - 190.0);
                assert!(out > last, "angle {angle}, radius {r}");
                last = out;
            }
        }
    }
}
