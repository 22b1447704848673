//! How a camera's lens maps directions to pixels and back.
//!
//! Contract: [`Lens::project`] is exact (f64) inside the picture and a margin around it. Farther out,
//! where a polynomial distortion turns back and would bring the outside in, it goes on radially, so
//! that what is outside stays outside. [`Lens::rays`] is the inverse at every pixel centre.

use calib::{CameraModel, Distortion};

/// How far beyond the picture's farthest corner the distortion is used, as a ratio of radii.
const MARGIN: f64 = 1.05;

/// Least growth of the distorted radius with the radius where the distortion is used beyond the corner.
const STIFF: f64 = 0.2;

/// A camera model, ready for projection.
#[derive(Clone, Debug)]
pub struct Lens {
    model: CameraModel,
    /// Radius on the plane z = 1 up to which the distortion is used.
    limit: f64,
}

impl Lens {
    /// For a model.
    pub fn new(model: &CameraModel) -> Self {
        let mut lens = Self {
            model: *model,
            limit: f64::INFINITY,
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
        // Not so far that the polynomial turns back.
        let bent = |r: f64| {
            let (x, y) = distort(&model.distortion, 0.8 * r, 0.6 * r);
            (x * x + y * y).sqrt()
        };
        let steps = 20;
        let step = (MARGIN - 1.0) * reach / f64::from(steps);
        let grows = (0..steps)
            .map(|k| reach + step * f64::from(k))
            .take_while(|&r| bent(r + step) - bent(r) > STIFF * step);
        lens.limit = grows.last().map_or(reach, |r| r + step);
        lens
    }

    /// Size and numbers.
    pub fn model(&self) -> &CameraModel {
        &self.model
    }

    /// Whether the model is used for the direction `(x, y, 1)`, and not what it is continued by.
    #[inline]
    pub fn is_known(&self, x: f64, y: f64) -> bool {
        x * x + y * y <= self.limit * self.limit
    }

    /// Pixel of the direction `(x, y, 1)` in the optical frame.
    #[inline]
    pub fn project(&self, x: f64, y: f64) -> (f64, f64) {
        let square = x * x + y * y;
        let (x, y) = if square <= self.limit * self.limit {
            distort(&self.model.distortion, x, y)
        } else {
            let beyond = square.sqrt() / self.limit;
            let (x, y) = distort(&self.model.distortion, x / beyond, y / beyond);
            (x * beyond, y * beyond)
        };
        (
            self.model.fx * x + self.model.cx,
            self.model.fy * y + self.model.cy,
        )
    }

    /// The direction `(x, y, 1)` that a pixel sees, to 1e-12 where the distortion can be inverted.
    pub fn unproject(&self, u: f64, v: f64) -> (f64, f64) {
        let (goal_x, goal_y) = (
            (u - self.model.cx) / self.model.fx,
            (v - self.model.cy) / self.model.fy,
        );
        let (mut x, mut y) = (goal_x, goal_y);
        for _ in 0..30 {
            let (dx, dy) = distort(&self.model.distortion, x, y);
            let (ex, ey) = (goal_x - dx, goal_y - dy);
            if ex.abs().max(ey.abs()) < 1e-13 {
                break;
            }
            // Newton's step, its derivatives by differences.
            let h = 1e-6;
            let (ax, ay) = distort(&self.model.distortion, x + h, y);
            let (bx, by) = distort(&self.model.distortion, x, y + h);
            let (xx, yx) = ((ax - dx) / h, (ay - dy) / h);
            let (xy, yy) = ((bx - dx) / h, (by - dy) / h);
            let determinant = xx * yy - xy * yx;
            x += (ex * yy - ey * xy) / determinant;
            y += (ey * xx - ex * yx) / determinant;
        }
        (x, y)
    }

    /// The directions of all pixel centres, moved by `shift` pixels; rows first.
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

/// OpenCV's models (documentation of `calib3d` and `fisheye`).
#[inline]
fn distort(distortion: &Distortion, x: f64, y: f64) -> (f64, f64) {
    let r2 = x * x + y * y;
    let tangential = |p1: f64, p2: f64| {
        (
            2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    };
    let (radial, (tx, ty)) = match *distortion {
        Distortion::None => (1.0, (0.0, 0.0)),
        Distortion::RadTan4 { k1, k2, p1, p2 } => (1.0 + r2 * (k1 + r2 * k2), tangential(p1, p2)),
        Distortion::RadTan5 { k1, k2, p1, p2, k3 } => {
            (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), tangential(p1, p2))
        }
        Distortion::Rational8 {
            k1,
            k2,
            p1,
            p2,
            k3,
            k4,
            k5,
            k6,
        } => (
            (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))),
            tangential(p1, p2),
        ),
        Distortion::KannalaBrandt4 { k1, k2, k3, k4 } => {
            let r = r2.sqrt();
            if r < 1e-9 {
                (1.0, (0.0, 0.0))
            } else {
                let angle = libm::atan(r);
                let a2 = angle * angle;
                let bent = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))));
                (bent / r, (0.0, 0.0))
            }
        }
    };
    (x * radial + tx, y * radial + ty)
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

    #[test]
    fn projection_and_its_inverse_agree_for_every_model() {
        let (k1, k2, p1, p2, k3) = (-0.17, 0.026, 3e-4, -2e-4, 1e-3);
        for distortion in [
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
        ] {
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
    fn what_is_outside_stays_outside() {
        // This polynomial turns back at a radius of 1.8 and is zero again at 3.2.
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
