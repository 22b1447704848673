//! Planes from their outlines, as files have them.

use nalgebra::{Matrix3, Vector3};

use super::frame::PlaneFrame;
use super::plane::Plane;
use super::polygon::Polygon;
use super::support::SupportGrid;
use crate::config::PlaneConfig;

/// What files have of a plane; see [`Plane`] for the fields.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlaneOutline {
    /// A point near its middle, in the world, m.
    pub center: [f64; 3],
    /// Outward normal, of length 1.
    pub normal: [f64; 3],
    /// Axes on the plane for the coordinates of the polygons.
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
    /// Outlines of the observed parts.
    pub polygons: Vec<Polygon>,
}

impl From<&Plane> for PlaneOutline {
    fn from(plane: &Plane) -> Self {
        Self {
            center: plane.center,
            normal: plane.normal,
            axes: plane.axes,
            sigma_m: plane.sigma_m,
            tilt_sigma_rad: plane.tilt_sigma_rad,
            depths: plane.depths,
            views: plane.views,
            chi_square: plane.chi_square,
            polygons: plane.polygons.clone(),
        }
    }
}

impl Plane {
    /// The plane of outlines. It has what maps and collision parts need; the depths of its views,
    /// which edges need, it has not. Its observed cells differ from the original ones by at most
    /// the tolerance of the outlines, about a cell.
    pub fn of_outline(outline: &PlaneOutline, config: &PlaneConfig) -> Self {
        let frame = PlaneFrame {
            origin: outline.center.into(),
            u: outline.axes[0].into(),
            v: outline.axes[1].into(),
            normal: outline.normal.into(),
        };
        let corners = outline.polygons.iter().flat_map(|polygon| &polygon.outline);
        let cell_m = config.support_cell_m;
        let support = SupportGrid::around(cell_m, corners.copied(), 3.0 * cell_m);
        let is_observed = |index: usize| {
            let center = support.center(index);
            let mut polygons = outline.polygons.iter();
            polygons.any(|polygon| polygon.contains(center))
        };
        let observed: Vec<bool> = (0..support.counts.len()).map(is_observed).collect();
        let cells = observed.iter().filter(|is| **is).count();
        let variances = [
            outline.sigma_m,
            outline.tilt_sigma_rad[0],
            outline.tilt_sigma_rad[1],
        ];
        Self {
            center: outline.center,
            normal: outline.normal,
            axes: outline.axes,
            sigma_m: outline.sigma_m,
            tilt_sigma_rad: outline.tilt_sigma_rad,
            depths: outline.depths,
            views: outline.views,
            chi_square: outline.chi_square,
            area_m2: cells as f64 * cell_m * cell_m,
            polygons: outline.polygons.clone(),
            frame,
            sums_frame: frame,
            height: Vector3::zeros(),
            covariance: Matrix3::from_diagonal(&Vector3::from(variances.map(|s| s * s))),
            sums: Vec::new(),
            support,
            observed,
            ends: Vec::new(),
            end_pose_sigma_m: 0.0,
        }
    }
}
