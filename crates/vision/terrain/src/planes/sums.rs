//! Normal equations of a plane from the depths of one view.
//!
//! The unknowns are the height at the plane's origin and per metre along both axes, against the
//! plane that the depths were assigned to.

use nalgebra::{Matrix3, Vector3};

/// See the module.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ViewSums {
    /// Number of the view.
    pub(crate) view: u32,
    pub(crate) depths: u32,
    /// Sum of weights times 1, s, t, ss, st, tt.
    moments: [f64; 6],
    /// Sum of weights times height times 1, s, t.
    right: [f64; 3],
    /// Sum of weights times squared heights.
    square: f64,
    /// Sum of sigmas, m.
    sigma: f64,
    /// Sum of squared sigmas of the pose, m2.
    pose: f64,
}

impl ViewSums {
    pub(crate) fn add(&mut self, [s, t, height]: [f64; 3], sigma: f64, pose_sigma: f64) {
        let weight = 1.0 / (sigma * sigma);
        let moments = [1.0, s, t, s * s, s * t, t * t];
        for (sum, moment) in self.moments.iter_mut().zip(moments) {
            *sum += weight * moment;
        }
        for (sum, moment) in self.right.iter_mut().zip(moments) {
            *sum += weight * moment * height;
        }
        self.square += weight * height * height;
        self.sigma += sigma;
        self.pose += pose_sigma * pose_sigma;
        self.depths += 1;
    }

    pub(crate) fn merge(&mut self, other: &Self) {
        for (sum, of) in self.moments.iter_mut().zip(other.moments) {
            *sum += of;
        }
        for (sum, of) in self.right.iter_mut().zip(other.right) {
            *sum += of;
        }
        self.square += other.square;
        self.sigma += other.sigma;
        self.pose += other.pose;
        self.depths += other.depths;
    }

    /// Information and right side, for errors that pixels share.
    fn normal_equations(&self, correlated_samples: f64) -> (Matrix3<f64>, Vector3<f64>) {
        let [w, s, t, ss, st, tt] = self.moments.map(|m| m / correlated_samples);
        let matrix = Matrix3::new(w, s, t, s, ss, st, t, st, tt);
        (matrix, Vector3::from(self.right) / correlated_samples)
    }

    /// Information and right side with errors that all pixels of a view share: of its pose, and of
    /// calibration as a share of the sigma.
    pub(crate) fn marginalized(
        &self,
        correlated_samples: f64,
        common_ratio: f64,
        tilt_sigma: f64,
    ) -> (Matrix3<f64>, Vector3<f64>) {
        let (matrix, right) = self.normal_equations(correlated_samples);
        let count = f64::from(self.depths.max(1));
        let common = common_ratio * self.mean_sigma_m();
        let offset = self.pose / count + common * common;
        let tilt = tilt_sigma * tilt_sigma;
        let common = Matrix3::from_diagonal(&Vector3::new(offset, tilt, tilt));
        // (L^-1 + C)^-1 = (1 + L C)^-1 L, which exists for singular L as well.
        let Some(reduction) = (Matrix3::identity() + matrix * common).try_inverse() else {
            return (Matrix3::zeros(), Vector3::zeros());
        };
        let reduced = reduction * matrix;
        (0.5 * (reduced + reduced.transpose()), reduction * right)
    }

    /// Height of the view's own plane at coordinates and its variance, with the tilt of the plane
    /// of all views as prior. Errors of the matcher that all depths of a plane in a view share
    /// count, those of the view's pose do not.
    pub(crate) fn height_at(
        &self,
        correlated_samples: f64,
        common_ratio: f64,
        tilt_sigma: f64,
        plane: &Vector3<f64>,
        [s, t]: [f64; 2],
    ) -> Option<(f64, f64)> {
        let (mut matrix, mut right) = self.normal_equations(correlated_samples);
        for k in [1, 2] {
            let information = 1.0 / (tilt_sigma * tilt_sigma);
            matrix[(k, k)] += information;
            right[k] += information * plane[k];
        }
        let covariance = matrix.try_inverse()?;
        let at = Vector3::new(1.0, s, t);
        let common = common_ratio * self.mean_sigma_m();
        Some((
            at.dot(&(covariance * right)),
            at.dot(&(covariance * at)) + common * common,
        ))
    }

    fn mean_sigma_m(&self) -> f64 {
        self.sigma / f64::from(self.depths.max(1))
    }

    /// Weighted squared heights above the best plane of the view, and their number.
    pub(crate) fn residual(&self) -> (f64, f64) {
        let (matrix, right) = self.normal_equations(1.0);
        let explained = matrix
            .try_inverse()
            .map_or(0.0, |inverse| right.dot(&(inverse * right)));
        (
            (self.square - explained).max(0.0),
            f64::from(self.depths.saturating_sub(3)),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_give_the_plane_and_its_residual() {
        let mut sums = ViewSums::default();
        for i in 0..400 {
            let (s, t) = (0.05 * (i % 20) as f64, 0.05 * (i / 20) as f64);
            let noise = 0.01 * counter_random::bell(1, 0, i);
            sums.add([s, t, 0.02 + 0.1 * s - 0.05 * t + noise], 0.01, 0.0);
        }
        let (matrix, right) = sums.marginalized(1.0, 0.0, 1e-9);
        let solution = matrix.try_inverse().unwrap() * right;
        for (found, expected) in solution.iter().zip([0.02, 0.1, -0.05]) {
            assert!((found - expected).abs() < 0.006, "{solution}");
        }
        let (square, count) = sums.residual();
        assert!((square / count - 1.0).abs() < 0.15, "{}", square / count);
        // A common error bounds the information, however many pixels there are.
        let (matrix, _) = sums.marginalized(1.0, 0.5, 1e-9);
        assert!(matrix[(0, 0)] < 1.0 / (0.005 * 0.005));
    }
}
