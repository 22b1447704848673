//! How a tag is blurred in an eye: by lens and sensor, the width of a pixel, and its motion.

use cad_transforms::RigidTransform;

use crate::pattern::{self, Profile};
use crate::tag::Tag;
use crate::view::{Motion, PlanePoint, RowPose, View, pixel_axes};

/// Motion between samples of the pattern along a blur by motion, cells.
const MOTION_STEP_CELLS: f64 = 0.4;
/// Standard deviation of a pixel's own width, px.
const PIXEL_SIGMA: f64 = 0.288_675;
/// Maximum number of these samples.
const MAX_MOTION_SAMPLES: usize = 11;

/// Blur along the axes of a tag.
#[derive(Clone, Debug)]
pub(crate) struct Blur {
    /// Sigmas along both axes, cells, and what cells contribute with them.
    sigma: [f64; 2],
    profiles: [Profile; 2],
    /// Share of the lens in the squares of these.
    lens_share: f64,
    /// Motion during the exposure, cells, and the number of samples along it.
    motion: [f64; 2],
    samples: usize,
}

/// The blurred pattern at a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlurSample {
    /// From 0, black, to 1, white.
    pub(crate) value: f64,
    /// Gradient, 1/m.
    pub(crate) gradient: [f64; 2],
    /// Derivative by the logarithm of the lens's blur.
    pub(crate) by_log_blur: f64,
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
        let samples = (libm::hypot(moved[0], moved[1]) / MOTION_STEP_CELLS).ceil();
        let sigma = [0, 1].map(|k| (square * (x[k] * x[k] + y[k] * y[k])).sqrt() / cell);
        Some(Self {
            sigma,
            profiles: sigma.map(Profile::new),
            lens_share: lens_px * lens_px / square,
            motion: moved,
            samples: (samples.max(1.0) as usize).min(MAX_MOTION_SAMPLES),
        })
    }

    /// How far the blur reaches along both axes, with these sigmas of lens and pixel, cells.
    pub(crate) fn reach_cells(&self, sigmas: f64) -> [f64; 2] {
        [0, 1].map(|k| sigmas * self.sigma[k] + 0.5 * self.motion[k].abs())
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

    /// The pattern at a point of the plane.
    pub(crate) fn sample(&self, tag: &Tag, point: &PlanePoint) -> BlurSample {
        let cell = tag.cell_m();
        let mut sum = BlurSample {
            value: 0.0,
            gradient: [0.0; 2],
            by_log_blur: 0.0,
        };
        let share = 1.0 / self.samples as f64;
        for n in 0..self.samples {
            let t = (n as f64 + 0.5) * share - 0.5;
            let place = [0, 1].map(|k| point.at[k] / cell + t * self.motion[k]);
            let [across, down] = &self.profiles;
            let sample = pattern::sample(tag, place, [across, down]);
            sum.value += share * sample.value;
            for k in 0..2 {
                sum.gradient[k] += share * sample.gradient[k] / cell;
                sum.by_log_blur += share * self.lens_share * sample.by_log_blur[k];
            }
        }
        sum
    }
}
