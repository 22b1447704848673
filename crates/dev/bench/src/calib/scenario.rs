//! Simulated recordings of boards: input of the calibration, and errors of its result against the
//! truth.

use anyhow::Result;
use cad_transforms::RigidTransform;
use cad_transforms::frame::{Frame, FramePart};
use cad_transforms::rig::Rig;
use calib::cameras::{Calibration, Camera, ExtrinsicsPrior, Eye, Input, TargetDetection};
use calib::target::DetectedCorner;
use camera_models::{CameraModel, Distortion, Lens};
use nalgebra::{Matrix6, Vector3, Vector6};
use rig_sim::calibration_error::CalibrationError;
use rig_sim::camera::Quality;
use rig_sim::faults::{Fault, Faults, Kind as FaultKind};
use rig_sim::random;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation};
use rig_sim::targets::{Plan, april_grid};

const RIG: &str = include_str!("../../../../../cad-transforms/rigs/example.toml");
/// Long enough for one round of all motions.
const SECONDS: f64 = 72.0;
const RATE_HZ: f64 = 8.0;
/// Deviations of plates and lenses from their files: m, rad, px; and of right cameras, m and rad.
const PLATE_DEVIATION: (f64, f64) = (1e-3, 4e-3);
const LENS_DEVIATION_PX: f64 = 2.0;
const RIGHT_DEVIATION: (f64, f64) = (5e-5, 1.5e-3);
/// Nominal sigmas of these deviations in the files.
const NOMINAL_PLATE_SIGMA: (f64, f64) = (1.5e-3, 5e-3);
const NOMINAL_RIGHT_SIGMA: (f64, f64) = (1e-4, 2e-3);
/// The stream of random numbers that this uses.
const STREAM: u64 = 0xca11b;

/// Impairments of a recording.
#[derive(Clone)]
pub(super) struct Impairments {
    pub(super) sigma_px: f64,
    pub(super) plan: Plan,
    pub(super) knock_deg: f64,
    /// Of the true lens, as a multiple of the usual.
    pub(super) distortion: f64,
    /// Time offset of each camera's timestamps.
    pub(super) late_ms: [f64; 3],
}

impl Default for Impairments {
    fn default() -> Self {
        Self {
            sigma_px: 0.1,
            plan: Plan::GOOD,
            knock_deg: 0.0,
            distortion: 1.0,
            late_ms: [0.0; 3],
        }
    }
}

/// A recording with its truth.
pub(super) struct Recording {
    pub(super) simulation: Simulation,
    pub(super) rig: Rig,
    faults: Faults,
}

/// Error of a pose: its largest coordinates.
pub(super) struct Error {
    pub(super) metres: f64,
    pub(super) degrees: f64,
    /// The largest of its coordinates in stated sigmas.
    pub(super) sigmas: f64,
    /// Coordinates within two sigma, of six.
    pub(super) inside: u32,
}

/// Settings of a recording of boards.
pub(super) fn settings(seed: u64) -> Settings {
    Settings {
        kind: Kind::Targets,
        lighting: Lighting::Day,
        seed,
        seconds: SECONDS,
        rate_hz: RATE_HZ,
        width: 672,
        height: 376,
        quality: Quality::ACCURATE,
    }
}

impl Recording {
    pub(super) fn new(seed: u64, impairments: &Impairments) -> Result<Self> {
        let rig = Rig::parse(RIG)?;
        let simulation =
            Simulation::with_targets(&settings(seed), &rig, &impairments.plan, &|n| {
                Some(april_grid(n))
            })?;
        let simulation = scale_distortion(simulation, impairments.distortion)?;
        let mut deviation = deviation(seed, &rig);
        for (camera, late_ms) in simulation.cameras().iter().zip(impairments.late_ms) {
            deviation.of_mut(&camera.name).time_offset_ns = (1e6 * late_ms) as i64;
        }
        let simulation = simulation.with_calibration_error(&rig, &deviation)?;
        let mut faults = Faults::default();
        if impairments.knock_deg > 0.0 {
            faults.list.push(Fault {
                kind: FaultKind::ShiftedCamera,
                strength: impairments.knock_deg,
                from_s: 0.5 * SECONDS,
                to_s: f64::INFINITY,
                camera: Some("left_shoulder".to_owned()),
                foot: None,
            });
        }
        Ok(Self {
            simulation,
            rig,
            faults,
        })
    }

    /// All target observations.
    pub(super) fn input(&self, sigma_px: f64) -> Input {
        let mut input = self.nominal_input();
        let frames = self.simulation.settings().frame_count();
        for number in 0..frames {
            input
                .times_ns
                .push(self.simulation.settings().frame_ns(number));
        }
        for camera in 0..self.simulation.cameras().len() {
            let name = &self.simulation.cameras()[camera].name;
            let observations = self
                .simulation
                .target_observations(camera)
                .with_faults(self.faults.of(name));
            for number in 0..frames {
                for side in 0..2 {
                    let mut by_board: Vec<Vec<DetectedCorner>> =
                        vec![Vec::new(); input.targets.len()];
                    for corner in observations.observed(side, number, sigma_px) {
                        by_board[corner.board].push(DetectedCorner {
                            id: corner.id,
                            pixel: corner.pixel,
                            sigma_px: 0.05,
                        });
                    }
                    for (target, corners) in by_board.into_iter().enumerate() {
                        if corners.len() >= 8 {
                            input.detections.push(TargetDetection {
                                instant: number as usize,
                                eye: 2 * camera + side,
                                target,
                                corners,
                            });
                        }
                    }
                }
            }
        }
        input
            .detections
            .sort_by_key(|s| (s.instant, s.eye, s.target));
        input
    }

    /// Observations of its own board by the left shoulder camera alone, at `count` instants spread
    /// over the recording.
    pub(super) fn one_camera(&self, sigma_px: f64, count: usize) -> Input {
        let mut input = self.input(sigma_px);
        input
            .detections
            .retain(|s| s.eye < 2 && s.target == 0 && s.corners.len() >= 40);
        let both: Vec<usize> = {
            let of = |eye: usize| {
                input
                    .detections
                    .iter()
                    .filter(move |s| s.eye == eye)
                    .map(|s| s.instant)
            };
            let right: Vec<usize> = of(1).collect();
            of(0).filter(|i| right.contains(i)).collect()
        };
        let step = both.len() as f64 / count as f64;
        let kept: Vec<usize> = (0..count.min(both.len()))
            .map(|k| both[(k as f64 * step.max(1.0)) as usize])
            .collect();
        input.detections.retain(|s| kept.contains(&s.instant));
        input.eyes.truncate(2);
        input.cameras.truncate(1);
        input.cameras[0].rig_from_left = None;
        input.targets.truncate(1);
        input
    }

    fn nominal_input(&self) -> Input {
        let mut input = Input::default();
        let boards = self.simulation.boards().iter();
        input.targets = boards.map(|b| b.sheet().target().clone()).collect();
        for (number, camera) in self.simulation.cameras().iter().enumerate() {
            let nominal = self.simulation.calibration(number);
            for (side, model) in [("left", nominal.left), ("right", nominal.right)] {
                input.eyes.push(Eye {
                    name: format!("{}/{side}", camera.name),
                    size: (model.width, model.height),
                    factory: Some(model),
                });
            }
            let left =
                Frame::of_camera(&camera.name, FramePart::Left).expect("a camera of the rig");
            let rig_from_left = self
                .rig
                .transform(&Frame::rig(), &left)
                .expect("a frame of the rig");
            input.cameras.push(Camera {
                name: camera.name.clone(),
                left: 2 * number,
                right: Some(2 * number + 1),
                left_from_right: Some(ExtrinsicsPrior {
                    transform: nominal.right_from_left.inverse(),
                    covariance: even(NOMINAL_RIGHT_SIGMA),
                }),
                rig_from_left: Some(ExtrinsicsPrior {
                    transform: rig_from_left,
                    covariance: even(NOMINAL_PLATE_SIGMA),
                }),
            });
        }
        input
    }

    /// Errors of camera poses in the first camera, and of right cameras in their left ones.
    pub(super) fn errors(&self, found: &Calibration) -> Vec<Error> {
        let cameras = self.simulation.cameras();
        let mut errors = Vec::new();
        for (number, camera) in cameras.iter().enumerate() {
            let [left, right] = camera.rig_from_eye;
            if let Some(place) = found.poses.pairs[number] {
                let (at, covariance) = found.pose(place);
                errors.push(error(&(left.inverse() * right), &at, &covariance));
            }
            if number > 0
                && let Some((at, covariance)) = found.left_from_left(0, number)
            {
                let truth = cameras[0].rig_from_eye[0].inverse() * left;
                errors.push(error(&truth, &at, &covariance));
            }
        }
        errors
    }

    /// Errors of the right camera's position, m, its rotation, degrees, and the focal length of the
    /// left one, px.
    pub(super) fn pair_errors(
        &self,
        left: &CameraModel,
        left_from_right: &RigidTransform,
    ) -> (f64, f64, f64) {
        let camera = &self.simulation.cameras()[0];
        let [l, r] = camera.rig_from_eye;
        let off = error(&(l.inverse() * r), left_from_right, &Matrix6::identity());
        (
            off.metres,
            off.degrees,
            (left.fx - camera.models[0].fx).abs(),
        )
    }

    /// Largest pixel error of an estimated lens against the true lens, anywhere in the image; px.
    pub(super) fn worst_pixel(&self, found: &CameraModel) -> f64 {
        let truth = Lens::new(&self.simulation.cameras()[0].models[0]);
        let found = Lens::new(found);
        let mut worst = 0.0f64;
        for i in 0..=16 {
            for j in 0..=9 {
                let pixel = [671.0 * f64::from(i) / 16.0, 375.0 * f64::from(j) / 9.0];
                let other = truth.unproject(pixel).and_then(|d| found.project(d));
                worst = worst
                    .max(other.map_or(f64::INFINITY, |o| (o[0] - pixel[0]).hypot(o[1] - pixel[1])));
            }
        }
        worst
    }
}

fn even((metres, radians): (f64, f64)) -> Matrix6<f64> {
    let (v, w) = (metres * metres, radians * radians);
    Matrix6::from_diagonal(&[v, v, v, w, w, w].into())
}

fn error(truth: &RigidTransform, found: &RigidTransform, covariance: &Matrix6<f64>) -> Error {
    let turn = (found.rotation() * truth.rotation().inverse()).scaled_axis();
    let shift = found.translation() - truth.translation();
    let off = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
    let sigmas =
        Vector6::from_fn(|k, _| off[k].abs() / covariance[(k, k)].max(0.0).sqrt().max(1e-12));
    Error {
        metres: shift.norm(),
        degrees: turn.norm().to_degrees(),
        sigmas: sigmas.max(),
        inside: sigmas.iter().filter(|s| **s <= 2.0).count() as u32,
    }
}

/// The same recording with lenses of more or less distortion than usual; the files agree.
fn scale_distortion(mut simulation: Simulation, strength: f64) -> Result<Simulation> {
    if strength == 1.0 {
        return Ok(simulation);
    }
    for camera in simulation.cameras().to_vec() {
        let number = simulation
            .cameras()
            .iter()
            .position(|c| c.name == camera.name)
            .expect("itself");
        let mut calibration = simulation.calibration(number);
        for model in [&mut calibration.left, &mut calibration.right] {
            let coefficients: Vec<f64> = model
                .distortion
                .coefficients()
                .iter()
                .map(|k| k * strength)
                .collect();
            if !matches!(model.distortion, Distortion::None) {
                model.distortion = model.distortion.with_coefficients(&coefficients);
            }
        }
        simulation = simulation.with_lenses(&camera.name, &calibration)?;
    }
    Ok(simulation)
}

/// A rig as it comes from the workshop.
fn deviation(seed: u64, rig: &Rig) -> CalibrationError {
    let mut counter = 0;
    let mut normal = |sigma: f64| {
        counter += 1;
        // A sum of twelve uniform numbers.
        let sum: f64 = (0..12)
            .map(|k| random::uniform(seed, STREAM, 12 * counter + k))
            .sum();
        sigma * (sum - 6.0)
    };
    let mut all = CalibrationError::default();
    for camera in rig.cameras() {
        let of = all.of_mut(camera);
        let mut three = |sigma: f64| Vector3::new(normal(sigma), normal(sigma), normal(sigma));
        of.rotation = three(PLATE_DEVIATION.1);
        of.translation = three(PLATE_DEVIATION.0);
        of.right_rotation = three(RIGHT_DEVIATION.1);
        of.right_translation = three(RIGHT_DEVIATION.0);
        of.focal_px = [normal(LENS_DEVIATION_PX), normal(LENS_DEVIATION_PX)];
        of.principal_point_px = [normal(LENS_DEVIATION_PX), normal(LENS_DEVIATION_PX)];
    }
    all
}
