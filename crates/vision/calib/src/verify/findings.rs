//! Findings: decisions on nominal parameters, as numbers and as text.

use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion, Vector3};
use serde::Serialize;

use super::camera::{Camera, Tolerances};
use super::camera_estimate::CameraEstimate;
use super::config::DecisionConfig;
use super::decision::{Decision, Estimate, Measurements, ParameterBlock};
use super::gyro_pairs::GyroAlignment;

/// A nominal parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Parameter {
    /// Rotation of the right eye against the left one.
    StereoRotation,
    /// Rotation of a camera, with its IMU, on the plate.
    Camera,
    /// Rotation of an IMU in its camera.
    Imu,
    /// Timestamps of a camera's images.
    ImageTime,
    /// Timestamps of an IMU's samples.
    ImuTime,
    /// Clock of a camera and its IMU against the others.
    Clock,
}

/// Decision on a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Nominal value confirmed, within tolerance and measurement uncertainty.
    Consistent,
    /// Nominal value contradicted.
    Inconsistent,
    /// The recording does not constrain the parameter.
    Undetermined,
}

/// Finding on one nominal parameter.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Which number.
    pub parameter: Parameter,
    /// The camera.
    pub camera: String,
    /// Decision.
    pub status: Status,
    /// Deviation from the nominal value: rotation in rad about the axes of the left optical frame
    /// (stereo: of the right one), time offset in s, positive if timestamps are late. Relative to
    /// all others if nothing else is observable. Empty without a measurement.
    pub estimate: Vec<f64>,
    /// Measurement sigma along `estimate`, rad or s.
    pub sigma: f64,
    /// Tolerance along `estimate`, one standard deviation, rad or s.
    pub tolerance_sigma: f64,
    /// Minimum detectable deviation, in any direction with a probability of 39/40, rad or s.
    pub min_detectable: f64,
    /// Excess over tolerance and measurement uncertainty together, rad or s; 0 if consistent.
    pub excess: f64,
    /// Cameras that may be the cause instead.
    pub alternatives: Vec<String>,
    /// Description.
    pub text: String,
}

pub(super) fn judge(
    cameras: &[Camera<'_>],
    found: &[CameraEstimate],
    pairs: &[(usize, usize, GyroAlignment)],
    tolerances: &Tolerances,
    config: &DecisionConfig,
) -> Vec<Finding> {
    let mut findings = eyes(found, tolerances, config);
    findings.extend(rotations(cameras, found, pairs, tolerances, config));
    findings.extend(time_offsets(cameras, found, pairs, tolerances, config));
    findings.sort_by_key(|f| f.parameter);
    findings
}

fn square(m: &Matrix3<f64>) -> DMatrix<f64> {
    DMatrix::from_iterator(3, 3, m.iter().copied())
}

/// Rotations of right eyes. Directions that are not determined do not hide an error in the others,
/// which are tested alone.
fn eyes(
    found: &[CameraEstimate],
    tolerances: &Tolerances,
    config: &DecisionConfig,
) -> Vec<Finding> {
    let of = |camera: &CameraEstimate| {
        let finding = |decision, basis: &DMatrix<f64>| {
            let shown = |v: Vec<f64>| (basis * DVector::from_vec(v)).as_slice().to_vec();
            let name = &camera.name;
            finding(
                Parameter::StereoRotation,
                name,
                decision,
                &[],
                shown,
                config,
            )
        };
        let whole = DMatrix::identity(3, 3);
        let Some(eyes) = &camera.eyes else {
            return finding(Decision::Unmeasured, &whole);
        };
        let judge = |basis: &DMatrix<f64>| {
            let size = basis.ncols();
            let mut measured = Measurements::default();
            measured.add(
                DMatrix::identity(size, size),
                basis.transpose() * DVector::from_column_slice(&eyes.rotation_rad),
                basis.transpose() * square(&eyes.covariance) * basis,
            );
            let block = ParameterBlock {
                first: 0,
                size,
                sigma: tolerances.eyes_rad,
            };
            finding(measured.judge(&[block], config).remove(0), basis)
        };
        let mut all = judge(&whole);
        let axes = eyes.covariance.symmetric_eigen();
        let is_determined = |k: &usize| {
            let axis = axes.eigenvectors.column(*k).into_owned();
            judge(&DMatrix::from_column_slice(3, 1, axis.as_slice())).status != Status::Undetermined
        };
        let (seen, unseen): (Vec<usize>, Vec<usize>) = (0..3).partition(is_determined);
        if all.status == Status::Consistent || seen.is_empty() || unseen.is_empty() {
            if all.status == Status::Undetermined {
                all.text = format!("{}: {}", all.text, eyes.remedy());
            }
            return all;
        }
        let basis = DMatrix::from_fn(3, seen.len(), |row, k| axes.eigenvectors[(row, seen[k])]);
        let part = judge(&basis);
        let largest = |axis: Vector3<f64>| ["x", "y", "z"][axis.iamax()];
        let unseen: Vec<&str> = unseen
            .iter()
            .map(|k| largest(axes.eigenvectors.column(*k).into_owned()))
            .collect();
        let unseen = format!(
            "about its {} not determined by this recording, minimum detectable {:.2}\u{b0}: {}",
            unseen.join(" and "),
            all.min_detectable.to_degrees(),
            eyes.remedy()
        );
        match (all.status, part.status) {
            (_, Status::Inconsistent) => Finding {
                text: format!("{}; {unseen}", part.text),
                min_detectable: all.min_detectable,
                ..part
            },
            (Status::Undetermined, _) => {
                let others = part.text.replacen("nominal", "otherwise nominal", 1);
                all.text = format!("{others}; {unseen}");
                all
            }
            _ => all,
        }
    };
    found.iter().map(of).collect()
}

/// Rotations of cameras on the plate, and of IMUs in cameras.
fn rotations(
    cameras: &[Camera<'_>],
    found: &[CameraEstimate],
    pairs: &[(usize, usize, GyroAlignment)],
    tolerances: &Tolerances,
    config: &DecisionConfig,
) -> Vec<Finding> {
    let count = cameras.len();
    let columns = 6 * count;
    // Column 3k: camera k on the plate, about the rig's axes; 3 (count + k): IMU k in its camera,
    // about the left eye's.
    let mut measured = Measurements::default();
    for (k, camera) in found.iter().enumerate() {
        let Some(imu) = &camera.imu else { continue };
        let mut by = DMatrix::zeros(3, columns);
        by.view_mut((0, 3 * (count + k)), (3, 3))
            .fill_with_identity();
        measured.add(
            by,
            DVector::from_column_slice(&imu.rotation_rad),
            square(&imu.covariance),
        );
    }
    let rig_from_left =
        |k: usize| -> Option<UnitQuaternion<f64>> { Some(*cameras[k].rig_from_left?.rotation()) };
    let on_plate = pairs.iter().flat_map(|p| [p.0, p.1]);
    let share = config.pair_covariance_factor
        * on_plate.collect::<std::collections::BTreeSet<_>>().len() as f64;
    for (a, b, gyros) in pairs {
        let (Some(rig_a), Some(rig_b), Some(imu)) = (
            rig_from_left(*a),
            rig_from_left(*b),
            &cameras[*b].nominal.imu,
        ) else {
            continue;
        };
        let rig_from_imu = rig_b * imu.imu_from_left.rotation().inverse();
        let rotate = rig_from_imu.to_rotation_matrix();
        let covariance = rotate.matrix() * gyros.covariance * rotate.matrix().transpose();
        let value = rig_from_imu * Vector3::from(gyros.rotation_rad);
        // Rotation of camera a, negative rotation of camera b, rotations of IMU b and IMU a in
        // their cameras.
        let mut by = DMatrix::zeros(3, columns);
        let mut put = |column: usize, m: &Matrix3<f64>| {
            by.view_mut((0, column), (3, 3)).copy_from(m);
        };
        put(3 * a, &Matrix3::identity());
        put(3 * b, &-Matrix3::identity());
        put(3 * (count + b), rig_b.to_rotation_matrix().matrix());
        put(3 * (count + a), &-rig_a.to_rotation_matrix().into_inner());
        measured.add(
            by,
            DVector::from_column_slice(value.as_slice()),
            square(&covariance) * share.max(1.0),
        );
    }
    let blocks: Vec<ParameterBlock> = (0..2 * count)
        .map(|k| ParameterBlock {
            first: 3 * k,
            size: 3,
            sigma: match k < count {
                true => cameras[k].joint_sigma_rad.unwrap_or(tolerances.joint_rad),
                false => tolerances.imu_rad,
            },
        })
        .collect();
    let names: Vec<&str> = cameras.iter().map(|c| c.name).collect();
    let decision = measured.judge(&blocks, config).into_iter().enumerate();
    let finding = |(k, decision): (usize, Decision)| {
        let own = k % count;
        let parameter = if k < count {
            Parameter::Camera
        } else {
            Parameter::Imu
        };
        if parameter == Parameter::Camera && cameras[own].rig_from_left.is_none() {
            return None;
        }
        if parameter == Parameter::Imu && cameras[own].gyro.is_none() {
            return None;
        }
        let into_left = rig_from_left(own).filter(|_| k < count).unwrap_or_default();
        let shown = |v: Vec<f64>| {
            let v = into_left.inverse() * Vector3::new(v[0], v[1], v[2]);
            vec![v.x, v.y, v.z]
        };
        Some(finding(
            parameter, names[own], decision, &names, shown, config,
        ))
    };
    decision.filter_map(finding).collect()
}

/// Time offsets.
fn time_offsets(
    cameras: &[Camera<'_>],
    found: &[CameraEstimate],
    pairs: &[(usize, usize, GyroAlignment)],
    tolerances: &Tolerances,
    config: &DecisionConfig,
) -> Vec<Finding> {
    let count = cameras.len();
    let columns = 3 * count;
    let one = |variance: f64| DMatrix::from_element(1, 1, variance);
    let mut measured = Measurements::default();
    // Column k: images, count + k: samples, 2 count + k: the clock of both.
    for (k, camera) in found.iter().enumerate() {
        let Some(imu) = &camera.imu else { continue };
        let mut by = DMatrix::zeros(1, columns);
        by[(0, k)] = 1.0;
        by[(0, count + k)] = -1.0;
        let value = DVector::from_element(1, imu.time_offset_s);
        measured.add(by, value, one(imu.time_offset_sigma_s.powi(2)));
    }
    let compared = pairs.iter().flat_map(|p| [p.0, p.1]);
    let share = config.pair_covariance_factor
        * compared.collect::<std::collections::BTreeSet<_>>().len() as f64;
    for (a, b, gyros) in pairs {
        let mut by = DMatrix::zeros(1, columns);
        for offset in [count, 2 * count] {
            by[(0, offset + b)] = 1.0;
            by[(0, offset + a)] = -1.0;
        }
        let value = DVector::from_element(1, gyros.time_offset_s);
        let variance = gyros.time_offset_sigma_s.powi(2) * share.max(1.0);
        measured.add(by, value, one(variance));
    }
    let blocks: Vec<ParameterBlock> = (0..columns)
        .map(|first| ParameterBlock {
            first,
            size: 1,
            sigma: tolerances.clock_s,
        })
        .collect();
    let names: Vec<&str> = cameras.iter().map(|c| c.name).collect();
    let decision = measured.judge(&blocks, config).into_iter().enumerate();
    let finding = |(k, decision): (usize, Decision)| {
        let parameter = [Parameter::ImageTime, Parameter::ImuTime, Parameter::Clock][k / count];
        cameras[k % count].gyro?;
        Some(finding(
            parameter,
            names[k % count],
            decision,
            &names,
            |v| v,
            config,
        ))
    };
    decision.filter_map(finding).collect()
}

/// The finding of a decision. `names` are those of the blocks, by index modulo their count.
fn finding(
    parameter: Parameter,
    camera: &str,
    decision: Decision,
    names: &[&str],
    shown: impl Fn(Vec<f64>) -> Vec<f64>,
    config: &DecisionConfig,
) -> Finding {
    let (status, estimate, close) = match decision {
        Decision::Unmeasured => (Status::Undetermined, None, Vec::new()),
        Decision::Inconsistent(estimate, close) => (Status::Inconsistent, Some(estimate), close),
        Decision::Consistent(estimate) => {
            let required = parameter.required(config);
            // A larger tolerance lowers the requirement.
            let required = f64::max(required, 2.0 * config.tolerance_sigma * estimate.loosest);
            let is_detectable = estimate.bound + config.power_sigma * estimate.largest <= required;
            let status = if is_detectable {
                Status::Consistent
            } else {
                Status::Undetermined
            };
            (status, Some(estimate), Vec::new())
        }
    };
    let mut alternatives: Vec<String> = close
        .iter()
        .map(|k| names[k % names.len()].to_owned())
        .filter(|name| name != camera)
        .collect();
    alternatives.dedup();
    let number = |of: &dyn Fn(&Estimate) -> f64| estimate.as_ref().map_or(0.0, of);
    let mut finding = Finding {
        parameter,
        camera: camera.to_owned(),
        status,
        sigma: number(&|e| e.sigma),
        tolerance_sigma: number(&|e| e.tolerated),
        min_detectable: number(&|e| e.min_detectable),
        excess: match status {
            Status::Inconsistent => number(&|e| e.excess(config)),
            _ => 0.0,
        },
        estimate: estimate.map(|e| shown(e.error)).unwrap_or_default(),
        alternatives,
        text: String::new(),
    };
    finding.text = finding.describe(config);
    finding
}

impl Parameter {
    /// Whether the parameter is a rotation; otherwise a time offset.
    pub fn is_rotation(self) -> bool {
        matches!(self, Self::StereoRotation | Self::Camera | Self::Imu)
    }

    /// Deviation that a recording should be able to detect, rad or s.
    fn required(self, config: &DecisionConfig) -> f64 {
        if self.is_rotation() {
            config.required_rotation_rad
        } else {
            config.required_time_s
        }
    }
}

impl Finding {
    /// Norm of the deviation, rad or s; `None` without a measurement.
    pub fn size(&self) -> Option<f64> {
        let square = self.estimate.iter().map(|v| v * v).sum::<f64>();
        (!self.estimate.is_empty()).then_some(square.sqrt())
    }

    fn describe(&self, config: &DecisionConfig) -> String {
        let camera = &self.camera;
        let shown = |v: f64| match self.parameter.is_rotation() {
            true => format!("{:.2}\u{b0}", v.to_degrees()),
            false => format!("{:.1} ms", v * 1e3),
        };
        let block = match self.parameter {
            Parameter::StereoRotation => format!("{camera}: right eye against left"),
            Parameter::Camera => format!("{camera} on the plate"),
            Parameter::Imu => format!("{camera}: IMU in the camera"),
            Parameter::ImageTime => format!("{camera}: timestamps of images"),
            Parameter::ImuTime => format!("{camera}: timestamps of IMU samples"),
            Parameter::Clock => format!("{camera}: clock"),
        };
        let Some(size) = self.size() else {
            return format!("{block}: not determined by this recording, too few observations");
        };
        let sigma = shown(self.sigma);
        let tolerance = config.tolerance_sigma * self.tolerance_sigma;
        match self.status {
            Status::Consistent if tolerance > self.parameter.required(config) => {
                format!(
                    "{block}: nominal within {} (sigma {sigma}), and within its tolerance of {}",
                    shown(size),
                    shown(tolerance)
                )
            }
            Status::Consistent => {
                format!("{block}: nominal within {} (sigma {sigma})", shown(size))
            }
            Status::Undetermined => format!(
                "{block}: not determined by this recording, minimum detectable {}",
                shown(self.min_detectable)
            ),
            Status::Inconsistent => {
                let mut text = match self.parameter.is_rotation() {
                    true => format!("{block}: rotated by {}{}", shown(size), self.axis(size)),
                    false => {
                        let late = if self.estimate[0] > 0.0 {
                            "late"
                        } else {
                            "early"
                        };
                        format!("{block}: {} {late}", shown(size))
                    }
                };
                text.push_str(&format!(" (sigma {sigma})"));
                if !self.alternatives.is_empty() {
                    text.push_str(&format!(", or it is {}", self.alternatives.join(" or ")));
                }
                text
            }
        }
    }

    /// Description of the rotation axis.
    fn axis(&self, size: f64) -> String {
        let [x, y, z] = [0, 1, 2].map(|k| self.estimate[k] / size);
        for (value, name) in [(x, "x"), (y, "y"), (z, "z")] {
            if value.abs() > 0.9 {
                let sign = if value < 0.0 { "-" } else { "" };
                return format!(" about its {sign}{name}");
            }
        }
        format!(" about ({x:.1}, {y:.1}, {z:.1})")
    }
}
