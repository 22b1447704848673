//! Rectified pairs of simulated walks, with ground truth.
//!
//! Contract: images are rendered at the quality for tests and rectified as a reader would do it.
//! The truth of a rectified pixel is that of the surface in the left image: between four neighbours
//! on one plane, the inverse depth is interpolated, which is exact on planes; otherwise the nearest
//! one counts. A pixel is *visible* if the right image shows the same surface: the truth of the
//! right image at the other end of the disparity agrees.

use std::sync::Arc;

use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use cad_transforms::rig::Rig;
use camera_models::rectify::{Rectification, Remap, View};
use camera_models::{Eye, Lens};
use depth::Geometry;
use depth::evaluate::GroundTruth as DepthTruth;
use nalgebra::Vector3;
use rig_sim::calibration_error::CalibrationError;
use rig_sim::camera::Quality;
use rig_sim::camera::truth::Truth;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation};

use super::imperfect::Imperfection;

const RIG: &str = include_str!("../../../../../cad-transforms/rigs/example.toml");
/// Disparity range of images of 672 columns: the wearer's knees are no nearer.
const DISPARITY_RANGE: usize = 128;
/// Maximum relative second difference of inverse depth of neighbours on one plane.
const MAX_CURVATURE_RATIO: f32 = 0.02;
/// Maximum left–right difference of disparities for a visible pixel, px.
const MAX_LR_DIFFERENCE_PX: f32 = 1.0;
/// Maximum disparity step between neighbours on one surface, px; beyond it one of them must agree.
const MAX_SURFACE_STEP_PX: f32 = 3.0;

/// A rectified pair and its truth; all buffers are rows first.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    /// Scene, light, camera and number.
    pub(crate) name: String,
    /// Columns.
    pub(crate) width: usize,
    /// Rows.
    pub(crate) height: usize,
    /// Left and right image.
    pub(crate) eyes: [Vec<u8>; 2],
    /// True disparity, px; 0 for the sky, NaN where the lens shows nothing.
    pub(crate) truth: Vec<f32>,
    /// Whether the pixel is visible in the right image.
    pub(crate) visible: Vec<bool>,
    /// Number of disparities to search, from 0 on.
    pub(crate) range: usize,
    /// The rectified pair of cameras.
    pub(crate) geometry: Geometry,
    /// Takes points in the rectified left frame to the world (z up); the identity where there is
    /// none.
    pub(crate) world_from_left: RigidTransform,
}

impl Frame {
    /// The ground truth, as input of the scores.
    pub(crate) fn truth(&self) -> DepthTruth<'_> {
        DepthTruth {
            disparity: &self.truth,
            visible: &self.visible,
        }
    }

    /// The left and the right image.
    pub(crate) fn images(&self) -> [depth::ImageView<'_>; 2] {
        [0, 1].map(|eye| {
            depth::ImageView::packed(self.width, self.height, &self.eyes[eye])
                .expect("eyes are of the size of the frame")
        })
    }
}

/// A walk whose frames are rendered on demand.
pub(crate) struct Walk {
    simulation: Arc<Simulation>,
    name: String,
    range: usize,
}

impl Walk {
    /// Prepares a walk of `seconds` with images of `size` and an imperfection.
    ///
    /// # Errors
    /// There is no such walk.
    pub(super) fn new(
        kind: Kind,
        light: Lighting,
        seed: u64,
        seconds: f64,
        size: [u32; 2],
        quality: Quality,
        imperfection: &Imperfection,
    ) -> Result<Self> {
        let rig = Rig::parse(RIG).context("reading the example rig")?;
        let settings = Settings {
            kind,
            lighting: light,
            seed,
            seconds,
            rate_hz: 15.0,
            width: size[0],
            height: size[1],
            quality,
        };
        let mut errors = CalibrationError::default();
        for camera in rig.cameras() {
            let rotation = imperfection.right_rotation_deg.map(f64::to_radians);
            errors.of_mut(camera).right_rotation = rotation.into();
        }
        let simulation = Simulation::new(&settings, &rig)
            .and_then(|walk| walk.with_imaging(imperfection.imaging))
            .and_then(|walk| walk.with_scenery(imperfection.scenery))
            .and_then(|walk| walk.with_calibration_error(&rig, &errors));
        Ok(Self::of(Arc::new(
            simulation.context("preparing the walk")?,
        )))
    }

    /// Of a walk that is prepared already.
    pub(crate) fn of(simulation: Arc<Simulation>) -> Self {
        let Settings {
            kind,
            lighting,
            seed,
            width,
            ..
        } = *simulation.settings();
        Self {
            name: format!("{}-{}-{seed}", kind.name(), lighting.name()),
            // OpenCV takes multiples of 16.
            range: (DISPARITY_RANGE * width as usize / 672).next_multiple_of(16),
            simulation,
        }
    }

    /// Number of stereo cameras.
    pub(crate) fn cameras(&self) -> usize {
        self.simulation.cameras().len()
    }

    /// Other images of both sides of a camera, rectified as those of its frames.
    ///
    /// # Errors
    /// The pair cannot be rectified.
    pub(crate) fn rectified(&self, camera: usize, raw: [&[u8]; 2]) -> Result<[Vec<u8>; 2]> {
        let calibration = self.simulation.calibration(camera);
        let rectification = Rectification::new(&calibration, View::Filled)?;
        let (width, height) = (calibration.left.width, calibration.left.height);
        let eyes = [(Eye::Left, raw[0]), (Eye::Right, raw[1])];
        Ok(eyes.map(|(eye, raw)| Remap::new(&rectification.map(eye), width, height).apply(raw, 0)))
    }

    /// The frames with these numbers of a camera, in order.
    ///
    /// # Errors
    /// The pair cannot be rectified.
    pub(crate) fn frames(&self, camera: usize, numbers: &[u64]) -> Result<Vec<Frame>> {
        let calibration = self.simulation.calibration(camera);
        let rectification = Rectification::new(&calibration, View::Filled)?;
        let name = &self.simulation.cameras()[camera].name;
        let (width, height) = (calibration.left.width, calibration.left.height);
        let maps = [Eye::Left, Eye::Right].map(|eye| rectification.map(eye));
        let remaps = maps.each_ref().map(|map| Remap::new(map, width, height));
        let lenses = [Lens::new(&calibration.left), Lens::new(&calibration.right)];
        let turns = [
            rectification.rectified_from_left,
            rectification.rectified_from_right,
        ];
        let mut images = self.simulation.frames(camera);
        let mut truths = self.simulation.ground_truth(camera);
        let mut frames = Vec::new();
        let mut last = None;
        for &number in numbers {
            let time_ns = self.simulation.settings().frame_ns(number);
            // Consecutive images continue the exposure control; after a gap it settles again.
            if last.is_none_or(|last| last + 1 != number) {
                images.settle(time_ns);
            }
            last = Some(number);
            let shot = images.expose(number, time_ns);
            let eyes = [0, 1].map(|eye| remaps[eye].apply(&shot.gray(eye), 0));
            let disparity = [0, 1].map(|eye| {
                let seen = truths.render(eye, time_ns);
                let inverse = inverse_depth(&seen, &lenses[eye], &turns[eye], width as usize);
                let scale = (rectification.camera.fx * rectification.baseline_m) as f32;
                let of = |(x, y): (&f32, &f32)| scale * sample(&inverse, width as usize, *x, *y);
                let places = maps[eye].x.iter().zip(&maps[eye].y);
                places.map(of).collect::<Vec<f32>>()
            });
            let [truth, right] = disparity;
            let visible = visible(&truth, &right, width as usize);
            let rig = self.simulation.walker().rig(time_ns as f64 * 1e-9);
            let (position, rotation) =
                self.simulation.cameras()[camera].world_from_eye(0, &rig, None);
            let q = rotation.quaternion();
            let world_from_eye = RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], position.into())?;
            frames.push(Frame {
                name: format!("{}-{name}-{number}", self.name),
                width: width as usize,
                height: height as usize,
                eyes,
                truth,
                visible,
                range: self.range,
                geometry: Geometry {
                    focal_px: rectification.camera.fx,
                    center: [rectification.camera.cx, rectification.camera.cy],
                    baseline_m: rectification.baseline_m,
                    offset_px: 0.0,
                },
                world_from_left: world_from_eye * turns[0].inverse(),
            });
        }
        Ok(frames)
    }
}

/// Inverse depth along the rectified axis for each pixel of the raw image, 1/m; NaN where the lens
/// has no direction.
pub(crate) fn inverse_depth(
    seen: &Truth,
    lens: &Lens,
    turn: &RigidTransform,
    width: usize,
) -> Vec<f32> {
    let of = |(i, depth): (usize, &f32)| {
        let pixel = [(i % width) as f64, (i / width) as f64];
        let Some(ray) = lens.unproject(pixel) else {
            return f32::NAN;
        };
        if depth.is_infinite() {
            return 0.0;
        }
        let reach = f64::from(*depth) / ray[2];
        let point = turn.rotate(Vector3::from(ray).scale(reach).into());
        (1.0 / point[2]) as f32
    };
    seen.depth.iter().enumerate().map(of).collect()
}

/// Value between pixels.
pub(crate) fn sample(of: &[f32], width: usize, x: f32, y: f32) -> f32 {
    let height = of.len() / width;
    if !(x >= 0.0 && y >= 0.0 && x <= (width - 1) as f32 && y <= (height - 1) as f32) {
        return f32::NAN;
    }
    let at = |x: usize, y: usize| of[y.min(height - 1) * width + x.min(width - 1)];
    let (left, top) = (x.floor() as usize, y.floor() as usize);
    let (u, v) = (x - left as f32, y - top as f32);
    let [a, b] = [at(left, top), at(left + 1, top)];
    let [c, d] = [at(left, top + 1), at(left + 1, top + 1)];
    let most = a.max(b).max(c).max(d);
    let least = a.min(b).min(c).min(d);
    let bend = (a + d - b - c).abs();
    // On a plane the four have no second difference and differ by little.
    if bend <= MAX_CURVATURE_RATIO * most * 0.25 && most - least <= MAX_CURVATURE_RATIO * 4.0 * most
    {
        let upper = a + (b - a) * u;
        let lower = c + (d - c) * u;
        return upper + (lower - upper) * v;
    }
    at((x + 0.5) as usize, (y + 0.5) as usize)
}

fn visible(left: &[f32], right: &[f32], width: usize) -> Vec<bool> {
    let of = |(i, d): (usize, &f32)| {
        let (x, row) = (i % width, i / width * width);
        let there = x as f32 - d;
        if !(there >= 0.0 && there <= (width - 1) as f32) {
            return false;
        }
        // The disparity of an oblique surface changes from pixel to pixel.
        let near = [there.floor() as usize, there.ceil() as usize].map(|k| right[row + k]);
        let (low, high) = (near[0].min(near[1]), near[0].max(near[1]));
        match high - low < MAX_SURFACE_STEP_PX {
            true => low - MAX_LR_DIFFERENCE_PX < *d && *d < high + MAX_LR_DIFFERENCE_PX,
            false => near
                .iter()
                .any(|other| (other - d).abs() < MAX_LR_DIFFERENCE_PX),
        }
    };
    left.iter().enumerate().map(of).collect()
}
