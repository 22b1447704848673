//! Projection and unprojection of a lens model.
//!
//! Contract: [`Lens::project`] returns a pixel for exactly those points in the domain of the model:
//! in front of the camera for pinhole models, and not beyond the radius at which the distortion is
//! no longer monotonic and would fold the outside into the image. Everything else is `None`, as is
//! a pixel without a direction in [`Lens::unproject`]. Inside the domain the two are inverse to
//! each other to 1e-9 px. A pixel may be outside the image; whether that counts is the caller's
//! decision.
//!
//! Jacobians are analytic. Their order of parameters is [`CameraModel::parameters`].
//!
//! ```
//! use camera_models::{CameraModel, Distortion, Lens};
//! let model = CameraModel {
//!     width: 640, height: 480, fx: 500.0, fy: 500.0, cx: 319.5, cy: 239.5,
//!     distortion: Distortion::RadTan4 { k1: -0.2, k2: 0.03, p1: 0.0, p2: 0.0 },
//! };
//! let lens = Lens::new(&model);
//! let pixel = lens.project([0.3, -0.1, 1.0]).unwrap();
//! let [x, y, z] = lens.unproject(pixel).unwrap();
//! assert!((x / z - 0.3).abs() < 1e-12 && (y / z + 0.1).abs() < 1e-12);
//! ```

use nalgebra::{Matrix2x3, SMatrix};

use crate::camera::{CameraModel, Distortion};

mod distorted;
mod domain;
#[cfg(test)]
mod dual;
mod fisheye;
mod radial;
mod spheres;
#[cfg(test)]
mod tests;

/// Jacobian of a pixel with respect to the camera's parameters; columns beyond the model's own are
/// 0.
pub type ByParameters = SMatrix<f64, 2, { CameraModel::MAX_PARAMETERS }>;

/// A camera model, ready for projection.
#[derive(Clone, Copy, Debug)]
pub struct Lens {
    model: CameraModel,
    shape: Shape,
}

/// A pixel and its Jacobians.
#[derive(Clone, Copy, Debug)]
pub struct ProjectedPoint {
    /// x and y, pixels.
    pub pixel: [f64; 2],
    /// Jacobian with respect to the point, pixels per metre.
    pub by_point: Matrix2x3<f64>,
    /// Jacobian with respect to the parameters, in the order of [`CameraModel::parameters`].
    pub by_parameters: ByParameters,
}

/// One family of models with its domain.
#[derive(Clone, Copy, Debug)]
enum Shape {
    Radial(radial::Radial),
    Fisheye(fisheye::Fisheye),
    DoubleSphere(spheres::DoubleSphere),
    Eucm(spheres::Eucm),
}

impl Lens {
    /// Prepares a model: determines its domain.
    pub fn new(model: &CameraModel) -> Self {
        let shape = match model.distortion {
            Distortion::KannalaBrandt4 { k1, k2, k3, k4 } => {
                Shape::Fisheye(fisheye::Fisheye::new([k1, k2, k3, k4]))
            }
            Distortion::DoubleSphere { xi, alpha } => {
                Shape::DoubleSphere(spheres::DoubleSphere { xi, alpha })
            }
            Distortion::Eucm { alpha, beta } => Shape::Eucm(spheres::Eucm { alpha, beta }),
            ref other => {
                let rational = other.rational().expect("all others are radial-tangential");
                Shape::Radial(radial::Radial::new(rational, &other.coefficients()))
            }
        };
        Self {
            model: *model,
            shape,
        }
    }

    /// Image size and parameters.
    pub fn model(&self) -> &CameraModel {
        &self.model
    }

    /// Projects a point in the optical frame, metres.
    pub fn project(&self, x_in_camera: [f64; 3]) -> Option<[f64; 2]> {
        let at = match &self.shape {
            Shape::Radial(s) => s.distort(x_in_camera),
            Shape::Fisheye(s) => s.distort(x_in_camera),
            Shape::DoubleSphere(s) => s.distort(x_in_camera),
            Shape::Eucm(s) => s.distort(x_in_camera),
        }?;
        let m = &self.model;
        Some([m.fx * at[0] + m.cx, m.fy * at[1] + m.cy])
    }

    /// The same with its Jacobians.
    ///
    /// ```
    /// use camera_models::{CameraModel, Distortion, Lens};
    ///
    /// let distortion = Distortion::KannalaBrandt4 { k1: 0.02, k2: -0.01, k3: 0.0, k4: 0.0 };
    /// let lens = Lens::new(&CameraModel::new((640, 480), [300.0, 300.0, 319.5, 239.5], distortion));
    /// let projected = lens.project_with_jacobians([0.4, -0.2, 1.0]).ok_or("outside")?;
    /// assert_eq!(Some(projected.pixel), lens.project([0.4, -0.2, 1.0]));
    ///
    /// // The point moved by a hundredth of a millimetre along x.
    /// let moved = lens.project([0.4 + 1e-5, -0.2, 1.0]).ok_or("outside")?;
    /// let px_per_m = (moved[0] - projected.pixel[0]) / 1e-5;
    /// assert!((projected.by_point[(0, 0)] - px_per_m).abs() < 0.01);
    /// # Ok::<(), &str>(())
    /// ```
    pub fn project_with_jacobians(&self, x_in_camera: [f64; 3]) -> Option<ProjectedPoint> {
        let bent = match &self.shape {
            Shape::Radial(s) => s.distort_with_jacobians(x_in_camera),
            Shape::Fisheye(s) => s.distort_with_jacobians(x_in_camera),
            Shape::DoubleSphere(s) => s.distort_with_jacobians(x_in_camera),
            Shape::Eucm(s) => s.distort_with_jacobians(x_in_camera),
        }?;
        let m = &self.model;
        let mut by_point = bent.by_point;
        let mut by_parameters = ByParameters::zeros();
        for (row, f) in [m.fx, m.fy].into_iter().enumerate() {
            by_point.row_mut(row).scale_mut(f);
            by_parameters[(row, row)] = bent.at[row];
            by_parameters[(row, 2 + row)] = 1.0;
            for k in 0..Distortion::MAX_COEFFICIENTS {
                by_parameters[(row, 4 + k)] = f * bent.by_coefficients[(row, k)];
            }
        }
        Some(ProjectedPoint {
            pixel: [m.fx * bent.at[0] + m.cx, m.fy * bent.at[1] + m.cy],
            by_point,
            by_parameters,
        })
    }

    /// Direction of a pixel, of length 1, in the optical frame.
    pub fn unproject(&self, pixel: [f64; 2]) -> Option<[f64; 3]> {
        let m = &self.model;
        let at = [(pixel[0] - m.cx) / m.fx, (pixel[1] - m.cy) / m.fy];
        match &self.shape {
            Shape::Radial(s) => s.undistort(at),
            Shape::Fisheye(s) => s.undistort(at),
            Shape::DoubleSphere(s) => s.undistort(at),
            Shape::Eucm(s) => s.undistort(at),
        }
    }

    /// Largest angle off the axis in the domain of the model, radians. Below π/2 for pinhole
    /// models.
    pub fn widest_rad(&self) -> f64 {
        match &self.shape {
            Shape::Radial(s) => s.widest_rad(),
            Shape::Fisheye(s) => s.widest_rad(),
            Shape::DoubleSphere(s) => s.widest_rad(),
            Shape::Eucm(s) => s.widest_rad(),
        }
    }

    /// Whether every pixel of the image has a direction: the corners are the farthest.
    ///
    /// ```
    /// use camera_models::{CameraModel, Distortion, Lens};
    ///
    /// let lens = |k1| {
    ///     let distortion = Distortion::RadTan4 { k1, k2: 0.0, p1: 0.0, p2: 0.0 };
    ///     Lens::new(&CameraModel::new((640, 480), [300.0, 300.0, 319.5, 239.5], distortion))
    /// };
    /// assert!(lens(-0.05).covers_image());
    /// // A strong barrel distortion without higher terms folds back before the corners.
    /// assert!(!lens(-0.4).covers_image());
    /// assert!(lens(-0.4).widest_rad() < lens(-0.05).widest_rad());
    /// ```
    pub fn covers_image(&self) -> bool {
        let right = f64::from(self.model.width) - 0.5;
        let bottom = f64::from(self.model.height) - 0.5;
        [[-0.5, -0.5], [right, -0.5], [-0.5, bottom], [right, bottom]]
            .into_iter()
            .all(|corner| self.unproject(corner).is_some())
    }
}
