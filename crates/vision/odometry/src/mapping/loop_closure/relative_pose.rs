//! Relative pose of two keyframes from keypoint matches, of which some are wrong.
//!
//! A match is the point of one keyframe and its bearing in the other one. From the predicted pose
//! least squares with a decreasing robust loss finds the nearest optimum. Where few matches of near
//! points determine the translation, some wrong ones are enough for a wrong optimum, and minimal
//! samples of three matches start it elsewhere (Fischler and Bolles 1981). Of the plausible poses
//! that with the smallest truncated cost is taken (Torr and Zisserman 2000).

use cad_transforms::so3;
use nalgebra::{Matrix2, Matrix3, SMatrix, UnitQuaternion, Vector2, Vector3};

use crate::backend::landmark_elimination::{PoseMatrix, PoseVector};
use crate::backend::observation::BearingMeasurement;
use crate::backend::state::{POSE_DIM, State};
use crate::config::LoopClosureConfig;

/// A keypoint of one keyframe that the other one observes.
pub(super) struct Match {
    /// Ray of the keypoint and origin of its camera in the body frame of its keyframe: the point
    /// is `ray + origin rho`, scaled by its inverse range.
    pub(super) ray: Vector3<f64>,
    pub(super) origin: Vector3<f64>,
    pub(super) rho: f64,
    /// Standard deviation of the inverse range, 1/m.
    pub(super) rho_sigma: f64,
    /// Extrinsics of the observing camera, and the measured bearing.
    pub(super) body_from_left: Matrix3<f64>,
    pub(super) arm: Vector3<f64>,
    pub(super) bearing: BearingMeasurement,
    /// Whether the point belongs to the later keyframe and is observed by the earlier one.
    pub(super) is_back: bool,
    /// Weight: if both keypoints have a range, each observes the other, and the information is
    /// counted twice.
    pub(super) weight: f64,
}

/// Residual of a match, px, with its Jacobians.
struct Residual {
    residual: Vector2<f64>,
    by_pose: SMatrix<f64, 2, POSE_DIM>,
    /// Inverse covariance, px⁻².
    information: Matrix2<f64>,
}

/// Rotation and translation: first body from second.
#[derive(Clone, Copy, Debug)]
pub(super) struct RelativePose {
    pub(super) rotation: UnitQuaternion<f64>,
    pub(super) translation: Vector3<f64>,
}

/// Result of the robust estimation.
pub(super) struct RobustPose {
    pub(super) pose: RelativePose,
    /// Of translation in the axes of the first body, and rotation in those of the second.
    pub(super) information: PoseMatrix,
    /// Sum of the weights of inliers.
    pub(super) inlier_weight: f64,
}

impl RelativePose {
    /// Of two states.
    pub(super) fn between(first: &State, second: &State) -> Self {
        let back = first.rotation.inverse();
        Self {
            rotation: back * second.rotation,
            translation: back * (second.position - first.position),
        }
    }

    fn residual(&self, config: &LoopClosureConfig, m: &Match) -> Option<Residual> {
        let r: Matrix3<f64> = self.rotation.to_rotation_matrix().into_inner();
        let point = m.ray + m.origin * m.rho;
        // Forward: first to second body. Backward: second to first.
        let (in_body, by_translation, by_rotation, by_rho) = if m.is_back {
            (
                r * point + self.translation * m.rho,
                Matrix3::identity() * m.rho,
                -r * point.cross_matrix(),
                r * m.origin + self.translation,
            )
        } else {
            let back = r.transpose() * (point - self.translation * m.rho);
            (
                back,
                -r.transpose() * m.rho,
                back.cross_matrix(),
                r.transpose() * (m.origin - self.translation),
            )
        };
        let x = m.body_from_left.transpose() * (in_body - m.arm * m.rho);
        let (residual, by_x) = m.bearing.residual(&x)?;
        let by_body = by_x * m.body_from_left.transpose();
        let mut by_pose = SMatrix::<f64, 2, POSE_DIM>::zeros();
        by_pose
            .fixed_columns_mut::<3>(0)
            .copy_from(&(by_body * by_translation));
        by_pose
            .fixed_columns_mut::<3>(3)
            .copy_from(&(by_body * by_rotation));
        let by_range = by_body * (by_rho - m.arm) * m.rho_sigma;
        let covariance =
            Matrix2::identity() * config.sigma_px.powi(2) + by_range * by_range.transpose();
        Some(Residual {
            residual,
            by_pose,
            information: covariance.try_inverse()?,
        })
    }

    /// Pose after a step of the normal equations.
    fn step(&self, information: &PoseMatrix, gradient: &PoseVector) -> Option<Self> {
        let step = -information.cholesky()?.solve(gradient);
        step.iter().all(|v| v.is_finite()).then(|| Self {
            rotation: self.rotation * so3::exp(step.fixed_rows::<3>(3).into_owned()),
            translation: self.translation + step.fixed_rows::<3>(0),
        })
    }

    /// Least squares with a Tukey loss of decreasing scale, in standard deviations.
    fn refine(
        mut self,
        config: &LoopClosureConfig,
        matches: &[Match],
        loss_scales: &[f64],
    ) -> Option<RobustPose> {
        let mut information = PoseMatrix::zeros();
        let mut inlier_weight = 0.0;
        for loss_scale in loss_scales {
            information = PoseMatrix::identity() * 1e-6;
            let mut gradient = PoseVector::zeros();
            inlier_weight = 0.0;
            for m in matches {
                let Some(found) = self.residual(config, m) else {
                    continue;
                };
                let size = found.sigmas() / loss_scale;
                if size >= 1.0 {
                    continue;
                }
                inlier_weight += m.weight;
                let weight = m.weight * (1.0 - size * size).powi(2);
                found.add_to(weight, &mut information, &mut gradient);
            }
            self = self.step(&information, &gradient)?;
        }
        Some(RobustPose {
            pose: self,
            information,
            inlier_weight,
        })
    }

    /// Least squares of a minimal sample.
    fn fit(mut self, config: &LoopClosureConfig, sample: [&Match; SAMPLE]) -> Option<Self> {
        for _ in 0..FIT_ITERATIONS {
            let mut information = PoseMatrix::identity() * 1e-6;
            let mut gradient = PoseVector::zeros();
            for m in sample {
                let found = self.residual(config, m)?;
                found.add_to(1.0, &mut information, &mut gradient);
            }
            self = self.step(&information, &gradient)?;
        }
        Some(self)
    }

    /// Truncated cost of all matches: twice the negative logarithm of their likelihood, with the
    /// determinant of the covariance, which grows with the distance between both keyframes.
    fn cost(&self, config: &LoopClosureConfig, matches: &[Match], inlier_sigmas: f64) -> f64 {
        let limit = inlier_sigmas * inlier_sigmas;
        let each = matches.iter().map(|m| {
            let cost = self.residual(config, m).map_or(limit, |found| {
                let keypoint = config.sigma_px.powi(4) * found.information.determinant();
                found.sigmas().powi(2) - keypoint.ln()
            });
            m.weight * if cost < limit { cost } else { limit }
        });
        each.sum()
    }

    /// Robust estimation from a predicted pose; `None` if matches do not determine a plausible
    /// one.
    pub(super) fn estimate(
        self,
        config: &LoopClosureConfig,
        matches: &[Match],
        is_plausible: impl Fn(&Self) -> bool,
    ) -> Option<RobustPose> {
        let inlier_sigmas = config.tukey_sigma[config.tukey_sigma.len() - 1];
        let cost = |pose: &Self| pose.cost(config, matches, inlier_sigmas);
        // Of a pair of keypoints that observe each other, one match is enough.
        let pairs = matches.iter().filter(|m| m.weight == 1.0 || !m.is_back);
        let pairs: Vec<&Match> = pairs.collect();
        let sampled = (0..config.samples)
            .filter_map(|number| self.fit(config, sample(&pairs, number)?))
            .filter(&is_plausible)
            .map(|pose| (cost(&pose), pose))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let final_scales = &config.tukey_sigma[config.tukey_sigma.len() / 2..];
        let nearest = self.refine(config, matches, &config.tukey_sigma);
        let sampled = sampled.and_then(|(_, pose)| pose.refine(config, matches, final_scales));
        ([nearest, sampled].into_iter().flatten())
            .filter(|found| is_plausible(&found.pose))
            .min_by(|a, b| cost(&a.pose).total_cmp(&cost(&b.pose)))
    }
}

/// Number of matches of a minimal sample, and of iterations to fit one.
const SAMPLE: usize = 3;
const FIT_ITERATIONS: usize = 5;

/// Sample with this number, of different matches; `None` if there are too few.
fn sample<'a>(matches: &[&'a Match], number: u64) -> Option<[&'a Match; SAMPLE]> {
    if matches.len() < SAMPLE {
        return None;
    }
    let mut chosen = [0; SAMPLE];
    for k in 0..SAMPLE {
        // Mixed as in SplitMix64 (Steele et al. 2014).
        let mut mixed = (number * SAMPLE as u64 + k as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^= mixed >> 31;
        // Of those that remain: skips the ones before it, in ascending order.
        let mut index = (mixed % (matches.len() - k) as u64) as usize;
        let mut taken = chosen;
        taken[..k].sort_unstable();
        for earlier in &taken[..k] {
            index += usize::from(index >= *earlier);
        }
        chosen[k] = index;
    }
    Some(chosen.map(|index| matches[index]))
}

impl Residual {
    /// Adds to the normal equations of the pose.
    fn add_to(&self, weight: f64, information: &mut PoseMatrix, gradient: &mut PoseVector) {
        let weighted = self.by_pose.transpose() * self.information * weight;
        *information += weighted * self.by_pose;
        *gradient += weighted * self.residual;
    }

    /// Mahalanobis distance.
    fn sigmas(&self) -> f64 {
        let squared = self.residual.dot(&(self.information * self.residual));
        if squared.is_finite() {
            squared.max(0.0).sqrt()
        } else {
            f64::INFINITY
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::observation::Camera;
    use crate::backend::solver::tests::camera;
    use camera_models::Eye;

    fn pose(translation: [f64; 3], yaw: f64) -> RelativePose {
        RelativePose {
            rotation: so3::exp(Vector3::new(0.0, yaw, 0.0)),
            translation: translation.into(),
        }
    }

    /// Points of the first camera frame at about this distance, m, as the second camera observes
    /// them from a pose.
    fn observe(camera: &Camera, from: &RelativePose, count: usize, distance_m: f64) -> Vec<Match> {
        let (body_from_left, arm) = camera.body_from_left;
        let each = (0..count).filter_map(|k| {
            let part = |by: f64| (k as f64 * by + 0.1 * distance_m).fract();
            let direction = Vector3::new(0.9 * part(0.618) - 0.45, 0.5 * part(0.414) - 0.25, 1.0);
            let range = distance_m * (1.0 + part(0.732));
            let ray = body_from_left * direction.normalize();
            let rho = 1.0 / range;
            let in_second = from.rotation.inverse() * (ray + (arm - from.translation) * rho);
            let x = body_from_left.transpose() * (in_second - arm * rho);
            let pixel = camera.left.project(x.into())?.map(|v| v as f32);
            Some(Match {
                ray,
                origin: arm,
                rho,
                rho_sigma: LoopClosureConfig::default().disparity_sigma_px / (350.0 * 0.06),
                body_from_left,
                arm,
                bearing: camera.bearing(Eye::Left, pixel)?,
                is_back: false,
                weight: 1.0,
            })
        });
        each.collect()
    }

    /// On a pavement whose pattern repeats, wrong matches of near points agree with the predicted
    /// pose, while right ones are too far from it for the loss.
    #[test]
    fn few_wrong_matches_of_near_points_do_not_decide() {
        let config = LoopClosureConfig::default();
        let camera = camera(0.0, 0.0);
        let (truth, predicted) = (pose([0.26, 0.0, 0.02], 0.01), pose([0.0; 3], 0.0));
        let mut matches = observe(&camera, &truth, 40, 15.0);
        matches.extend(observe(&camera, &truth, 14, 0.5));
        matches.extend(observe(&camera, &predicted, 6, 0.52));
        let error = |found: &RobustPose| (found.pose.translation - truth.translation).norm();
        let nearest = predicted.refine(&config, &matches, &config.tukey_sigma);
        let nearest = nearest.expect("a pose");
        assert!(error(&nearest) > 0.1, "{}", error(&nearest));
        let found = predicted
            .estimate(&config, &matches, |_| true)
            .expect("a pose");
        assert!(error(&found) < 1e-3, "{}", error(&found));
        // A pose that drift cannot explain is no alternative.
        let is_near = |pose: &RelativePose| pose.translation.norm() < 0.2;
        let near = predicted.estimate(&config, &matches, is_near);
        assert!(
            near.is_some_and(
                |near| (near.pose.translation - nearest.pose.translation).norm() < 1e-3
            )
        );
        assert!(found.inlier_weight >= 50.0, "{}", found.inlier_weight);
    }

    /// Uncertain ranges matter the more, the farther apart both keyframes are.
    #[test]
    fn information_contains_the_uncertainty_of_ranges() {
        let config = LoopClosureConfig::default();
        let camera = camera(0.0, 0.0);
        let sigma = |distance_m: f64, rho_sigma_factor: f64| {
            let truth = pose([0.0, 0.0, distance_m], 0.0);
            let mut matches = observe(&camera, &truth, 60, 4.0);
            for m in &mut matches {
                m.rho_sigma *= rho_sigma_factor;
            }
            let found = truth.estimate(&config, &matches, |_| true).expect("a pose");
            let covariance = found.information.try_inverse().expect("determined");
            covariance[(2, 2)].sqrt()
        };
        let ratio = |distance_m: f64| sigma(distance_m, 1.0) / sigma(distance_m, 0.0);
        assert!(ratio(0.1) < 1.1, "{}", ratio(0.1));
        assert!(ratio(1.5) > 2.0, "{}", ratio(1.5));
    }

    #[test]
    fn samples_are_of_different_matches() {
        let camera = camera(0.0, 0.0);
        let matches = observe(&camera, &pose([0.0; 3], 0.0), 5, 4.0);
        let matches: Vec<&Match> = matches.iter().collect();
        for number in 0..200 {
            let some = sample(&matches, number).expect("enough matches");
            for k in 0..SAMPLE {
                assert!(!std::ptr::eq(some[k], some[(k + 1) % SAMPLE]), "{number}");
            }
        }
        assert!(sample(&matches[..2], 0).is_none());
    }
}
