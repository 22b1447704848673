//! A plane and what is known of it.

use nalgebra::{Matrix3, Vector3};

use super::frame::PlaneFrame;
use super::polygon::Polygon;
use super::sums::ViewSums;
use super::support::SupportGrid;

/// A plane part of the surface, fitted to depths.
#[derive(Clone, Debug, PartialEq)]
pub struct Plane {
    /// A point near its middle, in the world, m.
    pub center: [f64; 3],
    /// Outward normal, of length 1.
    pub normal: [f64; 3],
    /// Axes on the plane for the coordinates of the polygons; the first is horizontal.
    pub axes: [[f64; 3]; 2],
    /// One standard deviation of the position along the normal at the center, m.
    pub sigma_m: f64,
    /// One standard deviation of the slope along both axes, rad.
    pub tilt_sigma_rad: [f64; 2],
    /// Depths that the plane was fitted to.
    pub depths: u64,
    /// Views of these depths.
    pub views: usize,
    /// Chi-square per depth.
    pub chi_square: f64,
    /// Observed area, m2.
    pub area_m2: f64,
    /// Outlines of the observed parts, in coordinates along the axes from the center, m.
    pub polygons: Vec<Polygon>,
    pub(crate) frame: PlaneFrame,
    /// The plane that the sums refer to.
    pub(crate) sums_frame: PlaneFrame,
    /// Height above it at its origin and per metre along both axes, and the covariance.
    pub(crate) height: Vector3<f64>,
    pub(crate) covariance: Matrix3<f64>,
    pub(crate) sums: Vec<ViewSums>,
    pub(crate) support: SupportGrid,
    /// Observed cells of the support.
    pub(crate) observed: Vec<bool>,
    /// Means and numbers of points where depths leave the plane for something farther.
    pub(crate) ends: Vec<([f64; 2], u32)>,
    /// One standard deviation of their place from errors of poses, m.
    pub(crate) end_pose_sigma_m: f64,
}

impl Plane {
    /// Height of the plane at a place, m; `None` for vertical planes.
    pub fn height_at(&self, x: f64, y: f64) -> Option<f64> {
        let n = &self.frame.normal;
        let d = self.frame.origin - Vector3::new(x, y, 0.0);
        (n.z.abs() > 1e-6).then(|| n.dot(&d) / n.z)
    }

    /// One standard deviation along the normal at a point near the plane, m.
    pub(crate) fn sigma_at(&self, x: [f64; 3]) -> f64 {
        let [s, t, _] = self.sums_frame.coordinates(&Vector3::from(x));
        let at = Vector3::new(1.0, s, t);
        at.dot(&(self.covariance * at)).max(0.0).sqrt()
    }

    /// Whether the plane was observed at the foot of a point.
    pub fn is_observed(&self, x: [f64; 3]) -> bool {
        let [s, t, _] = self.frame.coordinates(&Vector3::from(x));
        self.support
            .index([s, t])
            .is_some_and(|index| self.observed[index])
    }
}
