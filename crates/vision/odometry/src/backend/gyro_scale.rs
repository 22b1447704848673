//! Scale error of the gyroscope about each axis, estimated with the states.
//!
//! It is the same in all motions: 0.5 % of 180 degrees are 16 mrad, which a bias, almost
//! constant, can only spread over the whole walk. Errors are in sigmas of
//! [`gyro_scale_sigma`](crate::config::InertialConfig). In the normal equations they are a border
//! of three columns beside those of states and calibrations. An IMU that takes over from another
//! one gets the errors of that one.

use nalgebra::{DMatrix, DVector, Matrix3, MatrixXx3, SMatrix, Vector3};

/// Information on the errors before any image, if they are not estimated.
const FIXED: f64 = 1e12;

/// The columns of the errors in normal equations.
#[derive(Clone, Debug)]
pub(crate) struct Border {
    /// Coupling with the other rows.
    pub(crate) by: MatrixXx3<f64>,
    pub(crate) information: Matrix3<f64>,
    pub(crate) gradient: Vector3<f64>,
}

/// The errors and their prior.
#[derive(Clone, Debug)]
pub(crate) struct GyroScale {
    /// The errors, sigmas.
    pub(crate) error: Vector3<f64>,
    /// Linearization point of the prior.
    pub(crate) at: Vector3<f64>,
    /// Prior of the errors, and their coupling with the rows of the prior.
    pub(crate) border: Border,
}

/// Solution of normal equations with a border.
pub(crate) struct BorderedStep {
    pub(crate) step: DVector<f64>,
    pub(crate) scale_step: Vector3<f64>,
    /// Change of the solution by one sigma of each error.
    pub(crate) by_scale: MatrixXx3<f64>,
    /// Covariance of the errors.
    pub(crate) covariance: Matrix3<f64>,
}

impl Border {
    pub(crate) fn zeros(rows: usize) -> Self {
        Self {
            by: MatrixXx3::zeros(rows),
            information: Matrix3::zeros(),
            gradient: Vector3::zeros(),
        }
    }

    /// Adds a motion factor whose rows begin at `row`.
    pub(crate) fn add<const R: usize>(
        &mut self,
        row: usize,
        by: &SMatrix<f64, R, 3>,
        information: &Matrix3<f64>,
        gradient: &Vector3<f64>,
    ) {
        let mut rows = self.by.fixed_rows_mut::<R>(row);
        rows += by;
        self.information += information;
        self.gradient += gradient;
    }

    /// Solves the normal equations; `solve` does so without the border. `None` if there is no
    /// unique solution.
    pub(crate) fn solve(
        &self,
        gradient: &DVector<f64>,
        solve: impl Fn(&DMatrix<f64>) -> DMatrix<f64>,
    ) -> Option<BorderedStep> {
        let (rows, by) = (gradient.len(), &self.by);
        let right = DMatrix::from_fn(
            rows,
            4,
            |i, j| if j < 3 { by[(i, j)] } else { -gradient[i] },
        );
        let solved = solve(&right);
        let by_scale = solved.fixed_columns::<3>(0).into_owned();
        let without_border = solved.column(3);
        let covariance = (self.information - by.transpose() * &by_scale).try_inverse()?;
        let scale_step = -(covariance * (self.gradient + by.transpose() * without_border));
        Some(BorderedStep {
            step: without_border - &by_scale * scale_step,
            scale_step,
            by_scale,
            covariance: (covariance + covariance.transpose()) * 0.5,
        })
    }
}

impl GyroScale {
    /// No error, and none is estimated.
    pub(crate) fn fixed(rows: usize) -> Self {
        let mut border = Border::zeros(rows);
        border.information = Matrix3::identity() * FIXED;
        Self {
            error: Vector3::zeros(),
            at: Vector3::zeros(),
            border,
        }
    }

    /// Errors to be estimated, with this information at these errors.
    pub(crate) fn estimated(rows: usize, error: Vector3<f64>, information: Matrix3<f64>) -> Self {
        let mut border = Border::zeros(rows);
        border.information = information;
        Self {
            error,
            at: error,
            border,
        }
    }

    /// Information before any image: a sigma of one after the inflation of covariances.
    pub(crate) fn prior_information(sigma_inflation: f64) -> Matrix3<f64> {
        Matrix3::identity() * sigma_inflation.powi(2)
    }

    /// Deviation from the linearization point.
    pub(crate) fn deviation(&self) -> Vector3<f64> {
        self.error - self.at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solution_is_that_of_the_whole_system() {
        // A random symmetric positive definite matrix of five rows and a border of three.
        let factor = DMatrix::from_fn(8, 8, |i, j| ((i * 5 + j * 3 + i * j) as f64).sin());
        let whole = &factor * factor.transpose() + DMatrix::identity(8, 8);
        let gradient = DVector::from_fn(8, |i, _| (i as f64 * 0.7).cos());
        let border = Border {
            by: whole
                .view((0, 5), (5, 3))
                .fixed_columns::<3>(0)
                .into_owned(),
            information: whole.fixed_view::<3, 3>(5, 5).into_owned(),
            gradient: gradient.fixed_rows::<3>(5).into_owned(),
        };
        let own = whole.view((0, 0), (5, 5)).into_owned();
        let inverse = own.clone().try_inverse().expect("an invertible matrix");
        let solved = border.solve(&gradient.rows(0, 5).into_owned(), |right| &inverse * right);
        let solved = solved.expect("a solution");
        let covariance = whole.try_inverse().expect("an invertible matrix");
        let expected = -(&covariance * gradient);
        assert!((expected.rows(0, 5) - &solved.step).amax() < 1e-9);
        assert!((expected.fixed_rows::<3>(5) - solved.scale_step).amax() < 1e-9);
        assert!((covariance.fixed_view::<3, 3>(5, 5) - solved.covariance).amax() < 1e-9);
        // Covariance of the other rows.
        let by = &solved.by_scale;
        let joint = inverse + by * solved.covariance * by.transpose();
        assert!((covariance.view((0, 0), (5, 5)) - joint).amax() < 1e-9);
    }
}
