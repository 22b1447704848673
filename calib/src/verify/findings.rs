//! From comparisons to findings: what is off, in words and numbers.

use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion, Vector3};
use serde::Serialize;

use super::gyros::Gyros;
use super::judge::{Estimate, Judged, Measured, SHORT, TOLERATED, Thing};
use super::{Camera, CameraFound, Tolerances};

/// Turns and delays that a walk must be able to show, so that not having seen one says something: rad and s.
const WANTED_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;
const WANTED_S: f64 = 3e-3;
/// Comparisons of each two of three are not independent: each counts for two thirds, of `n` for `2 / n`.
const SHARED: f64 = 0.5;

/// A told number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum What {
    /// How the right eye of a camera is turned against the left one.
    Eyes,
    /// How a camera, with the IMU in it, is turned on the plate.
    Camera,
    /// How an IMU is turned in its camera.
    Imu,
    /// When a camera's pictures were taken.
    Pictures,
    /// When an IMU's samples were taken.
    Samples,
    /// What the clock of a camera and its IMU shows against the others'.
    Clock,
}

/// What the walk says of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// As told, as far as tolerance and measurement go.
    Fine,
    /// Not as told.
    Off,
    /// This walk does not tell.
    Undetermined,
}

/// A told number and what was found of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Which number.
    pub what: What,
    /// The camera.
    pub camera: String,
    /// What became of it.
    pub state: State,
    /// What is found against what is told: turns in rad about the axes of the left optical frame (eyes: of the right one),
    /// delays in s, positive where stamps are late. Relative to all others where nothing else can be known. None where nothing was seen.
    pub found: Vec<f64>,
    /// Standard deviation of the length of that by the measurement, rad or s.
    pub sigma: f64,
    /// Tolerance along it, one standard deviation, rad or s.
    pub tolerated: f64,
    /// What would be noticed 39 times in 40, whatever its direction, rad or s.
    pub noticed: f64,
    /// By how much it is beyond tolerance and measurement together, rad or s; 0 where it is not off.
    pub beyond: f64,
    /// Cameras one of which it may be instead.
    pub or: Vec<String>,
    /// In words.
    pub text: String,
}

pub(super) fn judge(
    cameras: &[Camera<'_>],
    found: &[CameraFound],
    pairs: &[(usize, usize, Gyros)],
    tolerances: &Tolerances,
) -> Vec<Finding> {
    let mut findings = eyes(found, tolerances);
    findings.extend(turns(cameras, found, pairs, tolerances));
    findings.extend(delays(cameras, found, pairs, tolerances));
    findings.sort_by_key(|f| f.what);
    findings
}

fn square(m: &Matrix3<f64>) -> DMatrix<f64> {
    DMatrix::from_iterator(3, 3, m.iter().copied())
}

fn eyes(found: &[CameraFound], tolerances: &Tolerances) -> Vec<Finding> {
    let of = |camera: &CameraFound| {
        let mut measured = Measured::default();
        if let Some(eyes) = &camera.eyes {
            measured.add(
                DMatrix::identity(3, 3),
                DVector::from_column_slice(&eyes.turned_rad),
                square(&eyes.covariance),
            );
        }
        let thing = Thing {
            first: 0,
            size: 3,
            sigma: tolerances.eyes_rad,
        };
        let judged = measured.judge(&[thing]).remove(0);
        finding(What::Eyes, &camera.name, judged, &[], |v| v)
    };
    found.iter().map(of).collect()
}

/// Cameras on the plate, and IMUs in cameras.
fn turns(
    cameras: &[Camera<'_>],
    found: &[CameraFound],
    pairs: &[(usize, usize, Gyros)],
    tolerances: &Tolerances,
) -> Vec<Finding> {
    let count = cameras.len();
    let columns = 6 * count;
    // Column 3k: camera k on the plate, about the rig's axes; 3 (count + k): IMU k in its camera, about the left eye's.
    let mut measured = Measured::default();
    for (k, camera) in found.iter().enumerate() {
        let Some(imu) = &camera.imu else { continue };
        let mut by = DMatrix::zeros(3, columns);
        by.view_mut((0, 3 * (count + k)), (3, 3))
            .fill_with_identity();
        measured.add(
            by,
            DVector::from_column_slice(&imu.turned_rad),
            square(&imu.covariance),
        );
    }
    let rig_from_left =
        |k: usize| -> Option<UnitQuaternion<f64>> { Some(*cameras[k].rig_from_left?.rotation()) };
    let on_plate = pairs.iter().flat_map(|p| [p.0, p.1]);
    let share = SHARED * on_plate.collect::<std::collections::BTreeSet<_>>().len() as f64;
    for (a, b, gyros) in pairs {
        let (Some(rig_a), Some(rig_b), Some(imu)) =
            (rig_from_left(*a), rig_from_left(*b), &cameras[*b].told.imu)
        else {
            continue;
        };
        let rig_from_imu = rig_b * imu.imu_from_left.rotation().inverse();
        let rotate = rig_from_imu.to_rotation_matrix();
        let covariance = rotate.matrix() * gyros.covariance * rotate.matrix().transpose();
        let value = rig_from_imu * Vector3::from(gyros.turned_rad);
        // Camera a turned, camera b turned the other way, IMU b and IMU a in theirs.
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
    let things: Vec<Thing> = (0..2 * count)
        .map(|k| Thing {
            first: 3 * k,
            size: 3,
            sigma: match k < count {
                true => cameras[k].joint_sigma_rad.unwrap_or(tolerances.joint_rad),
                false => tolerances.imu_rad,
            },
        })
        .collect();
    let names: Vec<&str> = cameras.iter().map(|c| c.name).collect();
    let judged = measured.judge(&things).into_iter().enumerate();
    let finding = |(k, judged): (usize, Judged)| {
        let own = k % count;
        let what = if k < count { What::Camera } else { What::Imu };
        if what == What::Camera && cameras[own].rig_from_left.is_none() {
            return None;
        }
        if what == What::Imu && cameras[own].gyro.is_none() {
            return None;
        }
        let into_left = rig_from_left(own).filter(|_| k < count).unwrap_or_default();
        Some(finding(what, names[own], judged, &names, |v| {
            let v = into_left.inverse() * Vector3::new(v[0], v[1], v[2]);
            vec![v.x, v.y, v.z]
        }))
    };
    judged.filter_map(finding).collect()
}

/// Clocks.
fn delays(
    cameras: &[Camera<'_>],
    found: &[CameraFound],
    pairs: &[(usize, usize, Gyros)],
    tolerances: &Tolerances,
) -> Vec<Finding> {
    let count = cameras.len();
    let columns = 3 * count;
    let one = |variance: f64| DMatrix::from_element(1, 1, variance);
    let mut measured = Measured::default();
    // Column k: pictures, count + k: samples, 2 count + k: the clock of both.
    for (k, camera) in found.iter().enumerate() {
        let Some(imu) = &camera.imu else { continue };
        let mut by = DMatrix::zeros(1, columns);
        by[(0, k)] = 1.0;
        by[(0, count + k)] = -1.0;
        let value = DVector::from_element(1, imu.late_s);
        measured.add(by, value, one(imu.late_sigma_s.powi(2)));
    }
    let compared = pairs.iter().flat_map(|p| [p.0, p.1]);
    let share = SHARED * compared.collect::<std::collections::BTreeSet<_>>().len() as f64;
    for (a, b, gyros) in pairs {
        let mut by = DMatrix::zeros(1, columns);
        for offset in [count, 2 * count] {
            by[(0, offset + b)] = 1.0;
            by[(0, offset + a)] = -1.0;
        }
        let value = DVector::from_element(1, gyros.late_s);
        let variance = gyros.late_sigma_s.powi(2) * share.max(1.0);
        measured.add(by, value, one(variance));
    }
    let things: Vec<Thing> = (0..columns)
        .map(|first| Thing {
            first,
            size: 1,
            sigma: tolerances.clock_s,
        })
        .collect();
    let names: Vec<&str> = cameras.iter().map(|c| c.name).collect();
    let judged = measured.judge(&things).into_iter().enumerate();
    let finding = |(k, judged): (usize, Judged)| {
        let what = [What::Pictures, What::Samples, What::Clock][k / count];
        cameras[k % count].gyro?;
        Some(finding(what, names[k % count], judged, &names, |v| v))
    };
    judged.filter_map(finding).collect()
}

/// A finding of what was judged. `names` are those of things, by their number modulo their count.
fn finding(
    what: What,
    camera: &str,
    judged: Judged,
    names: &[&str],
    shown: impl Fn(Vec<f64>) -> Vec<f64>,
) -> Finding {
    let (state, estimate, close) = match judged {
        Judged::Unseen => (State::Undetermined, None, Vec::new()),
        Judged::Off(estimate, close) => (State::Off, Some(estimate), close),
        Judged::Within(estimate) => {
            let wanted = what.wanted();
            // Who tolerates more wants to see less.
            let wanted = f64::max(wanted, 2.0 * TOLERATED * estimate.loosest);
            let is_seen = estimate.bound + SHORT * estimate.largest <= wanted;
            let state = if is_seen {
                State::Fine
            } else {
                State::Undetermined
            };
            (state, Some(estimate), Vec::new())
        }
    };
    let mut or: Vec<String> = close
        .iter()
        .map(|k| names[k % names.len()].to_owned())
        .filter(|name| name != camera)
        .collect();
    or.dedup();
    let number = |of: fn(&Estimate) -> f64| estimate.as_ref().map_or(0.0, of);
    let mut finding = Finding {
        what,
        camera: camera.to_owned(),
        state,
        sigma: number(|e| e.sigma),
        tolerated: number(|e| e.tolerated),
        noticed: number(|e| e.noticed),
        beyond: match state {
            State::Off => number(Estimate::beyond),
            _ => 0.0,
        },
        found: estimate.map(|e| shown(e.off)).unwrap_or_default(),
        or,
        text: String::new(),
    };
    finding.text = finding.words();
    finding
}

impl What {
    /// Whether it is a turn; a delay if not.
    pub fn is_turn(self) -> bool {
        matches!(self, Self::Eyes | Self::Camera | Self::Imu)
    }

    /// What a walk should be able to show, rad or s.
    fn wanted(self) -> f64 {
        if self.is_turn() { WANTED_RAD } else { WANTED_S }
    }
}

impl Finding {
    /// Length of what was found, rad or s; none where nothing was seen.
    pub fn size(&self) -> Option<f64> {
        let square = self.found.iter().map(|v| v * v).sum::<f64>();
        (!self.found.is_empty()).then_some(square.sqrt())
    }

    fn words(&self) -> String {
        let camera = &self.camera;
        let shown = |v: f64| match self.what.is_turn() {
            true => format!("{:.2}\u{b0}", v.to_degrees()),
            false => format!("{:.1} ms", v * 1e3),
        };
        let thing = match self.what {
            What::Eyes => format!("{camera}: right eye against left"),
            What::Camera => format!("{camera} on the plate"),
            What::Imu => format!("{camera}: IMU in the camera"),
            What::Pictures => format!("{camera}: times of pictures"),
            What::Samples => format!("{camera}: times of IMU samples"),
            What::Clock => format!("{camera}: clock"),
        };
        let Some(size) = self.size() else {
            return format!("{thing}: not determined by this walk, too little was seen");
        };
        let sigma = shown(self.sigma);
        match self.state {
            State::Fine if 2.0 * self.tolerated > self.what.wanted() => format!(
                "{thing}: as told within {} (sigma {sigma}), and within its tolerance of {}",
                shown(size),
                shown(2.0 * self.tolerated)
            ),
            State::Fine => format!("{thing}: as told within {} (sigma {sigma})", shown(size)),
            State::Undetermined => format!(
                "{thing}: not determined by this walk, which would have shown no less than {}",
                shown(self.noticed)
            ),
            State::Off => {
                let mut text = match self.what.is_turn() {
                    true => format!("{thing}: turned by {}{}", shown(size), self.axis(size)),
                    false => {
                        let late = if self.found[0] > 0.0 { "late" } else { "early" };
                        format!("{thing}: {} {late}", shown(size))
                    }
                };
                text.push_str(&format!(" (sigma {sigma})"));
                if !self.or.is_empty() {
                    text.push_str(&format!(", or it is {}", self.or.join(" or ")));
                }
                text
            }
        }
    }

    /// About which axis.
    fn axis(&self, size: f64) -> String {
        let [x, y, z] = [0, 1, 2].map(|k| self.found[k] / size);
        for (value, name) in [(x, "x"), (y, "y"), (z, "z")] {
            if value.abs() > 0.9 {
                let sign = if value < 0.0 { "-" } else { "" };
                return format!(" about its {sign}{name}");
            }
        }
        format!(" about ({x:.1}, {y:.1}, {z:.1})")
    }
}
