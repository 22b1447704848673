//! How a tag is blurred in an eye: by lens and sensor, the width of a pixel, and its motion.

use cad_transforms::RigidTransform;

use crate::tag::Tag;
use crate::view::{Motion, RowPose, View, pixel_axes};

/// Standard deviation of a pixel's own width, px.
const PIXEL_SIGMA: f64 = 0.288_675;

/// Relative difference of sigmas, and difference of motion, cells, up to which patterns are
/// extrapolated: by less than a gray level.
const NEAR_SHARE: f64 = 0.1;
const NEAR_CELLS: f64 = 0.05;

/// Blur along the axes of a tag.
#[derive(Clone, Debug)]
pub(crate) struct Blur {
    /// Sigmas along both axes, cells.
    pub(crate) sigma: [f64; 2],
    /// Share of the lens in the squares of these.
    pub(crate) lens_share: f64,
    /// Motion during the exposure, cells.
    pub(crate) motion: [f64; 2],
}

impl Blur {
    /// The blur in a view; `None` if the tag is behind it.
    pub(crate) fn new(
        view: &View<'_>,
        tag: &Tag,
        pose: &RigidTransform,
        motion: &Motion,
        lens_px: f64,
    ) -> Option<Self> {
        let cell = tag.cell_m();
        let [x, y] = pixel_axes(view, pose, motion)?;
        let square = lens_px * lens_px + PIXEL_SIGMA * PIXEL_SIGMA;
        let drift = RowPose::new(view, pose, motion, 0.0).drift(motion, view);
        let moved = drift.map(|speed| speed * view.exposure_s / cell);
        let sigma = [0, 1].map(|k| (square * (x[k] * x[k] + y[k] * y[k])).sqrt() / cell);
        Some(Self {
            sigma,
            lens_share: lens_px * lens_px / square,
            motion: moved,
        })
    }

    /// Change of the logarithm of the lens's blur that gives another one, if a pattern can be
    /// extrapolated to that.
    pub(crate) fn log_growth_to(&self, other: &Self) -> Option<f64> {
        let growth = [0, 1].map(|k| other.sigma[k] / self.sigma[k] - 1.0);
        let is_near = (0..2).all(|k| {
            growth[k].abs() < NEAR_SHARE && (self.motion[k] - other.motion[k]).abs() < NEAR_CELLS
        });
        is_near.then(|| 0.5 * (growth[0] + growth[1]) / self.lens_share)
    }

    /// How far the blur reaches along both axes, with these sigmas of lens and pixel, cells.
    pub(crate) fn reach_cells(&self, sigmas: f64) -> [f64; 2] {
        [0, 1].map(|k| sigmas * self.sigma[k] + 0.5 * self.motion[k].abs())
    }

    /// Motion during the exposure, cells.
    pub(crate) fn motion_cells(&self) -> f64 {
        libm::hypot(self.motion[0], self.motion[1])
    }

    /// Share of a cell in the pattern at its middle.
    pub(crate) fn own_share(&self) -> f64 {
        let root = std::f64::consts::FRAC_1_SQRT_2;
        let [x, y] = [0, 1].map(|k| {
            let gaussian = libm::erf(0.5 * root / self.sigma[k]);
            gaussian / self.motion[k].abs().max(1.0)
        });
        x * y
    }
}
