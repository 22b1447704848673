//! Features of a track segment with their distances, for the estimation of its motion.

use cad_transforms::so3;
use camera_models::Lens;
use nalgebra::{UnitQuaternion, Vector3};

use super::config::MotionConfig;
use super::gyro::IntegratedGyro;
use super::motion::{ByLine, SegmentFeature};
use super::pair::StereoPair;
use super::tracks::TrackSegment;

/// Rotation of the left optical frame over time.
pub(super) trait Attitude {
    /// Takes directions in the frame at one time to the one at another, ns; `None` if unknown.
    fn to_from(&self, to_ns: f64, from_ns: f64) -> Option<UnitQuaternion<f64>>;
    /// Angular rate, rad/s.
    fn rate(&self, time_ns: f64) -> Option<Vector3<f64>>;
}

/// Attitude by a gyroscope.
pub(super) struct GyroAttitude<'a> {
    pub(super) imu_from_left: UnitQuaternion<f64>,
    /// Image times minus times of samples, ns.
    pub(super) late_ns: f64,
    pub(super) gyro: &'a IntegratedGyro<'a>,
}

impl Attitude for GyroAttitude<'_> {
    fn to_from(&self, to_ns: f64, from_ns: f64) -> Option<UnitQuaternion<f64>> {
        let turn = self
            .gyro
            .to_from(to_ns - self.late_ns, from_ns - self.late_ns)?;
        Some(self.imu_from_left.inverse() * turn * self.imu_from_left)
    }

    fn rate(&self, time_ns: f64) -> Option<Vector3<f64>> {
        Some(self.imu_from_left.inverse() * self.gyro.rate(time_ns - self.late_ns)?)
    }
}

/// Rotation at a constant rate, rad/s.
pub(super) struct ConstantRate(pub(super) Vector3<f64>);

impl Attitude for ConstantRate {
    fn to_from(&self, to_ns: f64, from_ns: f64) -> Option<UnitQuaternion<f64>> {
        Some(so3::exp(self.0 * (-(to_ns - from_ns) * 1e-9)))
    }

    fn rate(&self, _: f64) -> Option<Vector3<f64>> {
        Some(self.0)
    }
}

/// The features of a segment that are matched and tracked, at the exposure of the middle row.
/// `line_s` is the line time.
pub(super) fn segment_features(
    of: &TrackSegment,
    pair: &StereoPair,
    line_s: f64,
    attitude: &dyn Attitude,
    config: &MotionConfig,
) -> Vec<SegmentFeature> {
    let lens = pair.left();
    let middle = 0.5 * f64::from(lens.model().height - 1);
    let seconds = (of.to_ns - of.from_ns) as f64 * 1e-9;
    let seen = of.features.iter().filter_map(|feature| {
        let later = feature.later?;
        let first = Vector3::from(lens.unproject(feature.left)?);
        let placed = pair.triangulate(&first, feature.right?)?;
        let px_per_rad = px_per_rad(lens, later)?;
        let ray = Vector3::from(lens.unproject(later)?);
        let rows = [feature.left[1], later[1]].map(|row| row - middle);
        // Transfers a ray from the exposure of its row to that of the middle row; with the
        // derivative with respect to the line time.
        let at_once = |ray: Vector3<f64>, time_ns: i64, row: f64| {
            let time_ns = time_ns as f64;
            let row_ns = row * line_s * 1e9;
            let at_once = attitude.to_from(time_ns + row_ns, time_ns)? * ray;
            let rate = attitude.rate(time_ns)?;
            Some((at_once, rate.cross(&at_once) * row))
        };
        let (first, first_by_line) = at_once(first, of.from_ns, rows[0])?;
        let (ray, later_by_line) = at_once(ray, of.to_ns, rows[1])?;
        let by_line = ByLine {
            ray: first_by_line,
            later: later_by_line,
            motion_ratio: (rows[1] - rows[0]) / seconds,
            after_s: 0.5 * (rows[0] + rows[1]),
        };
        Some(SegmentFeature {
            pixel: feature.left,
            ray: first,
            per_metre: placed.per_metre,
            sigma_per_metre: config.disparity_sigma_px / placed.px_per,
            per_metre_by: placed.per_metre_by,
            later: ray,
            px_per_rad,
            motion_ratio: 1.0 + by_line.motion_ratio * line_s,
            after_s: by_line.after_s * line_s,
            by_line,
        })
    });
    seen.collect()
}

/// Pixels per radian around a pixel.
fn px_per_rad(lens: &Lens, pixel: [f64; 2]) -> Option<f64> {
    let ray = lens.unproject(pixel)?;
    let by_point = lens.project_with_jacobians(ray)?.by_point;
    // Both singular values belong to directions normal to the ray, which has length 1.
    Some(
        (by_point * by_point.transpose())
            .determinant()
            .sqrt()
            .sqrt(),
    )
}
