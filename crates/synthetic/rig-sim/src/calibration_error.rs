//! Errors of the recorded calibration: true extrinsics, intrinsics and frame times that differ from
//! the recorded (nominal) ones.
//!
//! Contract: an error changes the ground truth; the recorded calibration is unchanged. Without
//! errors the output is byte-identical. Rotations are about the left optical center of the camera
//! and expressed, like translations, in its left optical frame. The additional errors of the right
//! eye are in the right optical frame, about the right optical center. The IMU moves rigidly with
//! its camera.
//!
//! ```toml
//! [[camera]]
//! name = "left_shoulder"
//! rotation_deg = [0.0, 0.5, 0.0]        # rotation vector: x right, y down, z forward; the whole camera
//! translation_mm = [0.0, 0.0, 0.0]
//! right_rotation_deg = [0.0, 0.0, 0.0]  # of the right eye only, in addition
//! right_translation_mm = [0.0, 0.0, 0.0]
//! imu_rotation_deg = [0.0, 0.0, 0.0]    # of the IMU only, in addition, in its own frame
//! time_offset_ms = 3.0                  # frame timestamp minus true exposure time
//! focal_px = [0.0, 0.0]                 # added to the focal lengths of both lenses, x and y
//! principal_point_px = [0.0, 0.0]       # added to their principal points
//! ```
//!
//! All keys except the name are optional.

use std::fmt::Write as _;

use cad_transforms::RigidTransform;
use cad_transforms::frame::{Frame, FramePart};
use cad_transforms::rig::{Rig, TagFamily};
use camera_models::CameraModel;
use nalgebra::Vector3;
use serde::Deserialize;

use cad_transforms::so3;

/// Maximum rotation, degrees, and translation, mm; larger values are taken as mistakes in the file.
const MAX_DEG_MM: (f64, f64) = (45.0, 500.0);
/// Maximum time offset, ms, and maximum change of an intrinsic parameter, px.
const MAX_TIME_OFFSET_MS: f64 = 500.0;
const MAX_CHANGE_PX: f64 = 500.0;

/// Errors of the recorded calibration of a rig; see the module documentation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CalibrationError {
    /// Each camera at most once.
    pub cameras: Vec<CameraCalibrationError>,
}

/// Errors of the calibration of one camera.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraCalibrationError {
    /// Name of the camera.
    pub camera: String,
    /// Rotation of the whole camera: rotation vector, rad.
    pub rotation: Vector3<f64>,
    /// Translation of the whole camera, m.
    pub translation: Vector3<f64>,
    /// Additional rotation of the right eye: rotation vector, rad.
    pub right_rotation: Vector3<f64>,
    /// Additional translation of the right eye, m.
    pub right_translation: Vector3<f64>,
    /// Additional rotation of the IMU: rotation vector, rad, in its own frame.
    pub imu_rotation: Vector3<f64>,
    /// Timestamp minus true frame time, ns.
    pub time_offset_ns: i64,
    /// Added to the focal lengths, px.
    pub focal_px: [f64; 2],
    /// Added to the principal points, px.
    pub principal_point_px: [f64; 2],
}

/// Error of reading the file: correct it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("reading the calibration errors: {0}")]
pub struct ParseError(pub String);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    camera: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    name: String,
    #[serde(default)]
    rotation_deg: [f64; 3],
    #[serde(default)]
    translation_mm: [f64; 3],
    #[serde(default)]
    right_rotation_deg: [f64; 3],
    #[serde(default)]
    right_translation_mm: [f64; 3],
    #[serde(default)]
    imu_rotation_deg: [f64; 3],
    #[serde(default)]
    time_offset_ms: f64,
    #[serde(default)]
    focal_px: [f64; 2],
    #[serde(default)]
    principal_point_px: [f64; 2],
}

impl CalibrationError {
    /// Parses a file. Camera names must be among `cameras`.
    ///
    /// # Errors
    /// [`ParseError`] lists all problems.
    pub fn parse(text: &str, cameras: &[&str]) -> Result<Self, ParseError> {
        let file: File = toml::from_str(text).map_err(|e| ParseError(e.to_string()))?;
        let mut problems = Vec::new();
        for (i, entry) in file.camera.iter().enumerate() {
            let before = &file.camera[..i];
            problems.extend(entry.problems(cameras));
            if before.iter().any(|other| other.name == entry.name) {
                problems.push(format!("camera {:?} is named twice", entry.name));
            }
        }
        match problems.is_empty() {
            true => Ok(Self {
                cameras: file.camera.iter().map(Entry::calibration_error).collect(),
            }),
            false => Err(ParseError(problems.join("\n  "))),
        }
    }

    /// Mutable error of a camera; created if absent.
    pub fn of_mut(&mut self, camera: &str) -> &mut CameraCalibrationError {
        let known = self.cameras.iter().position(|c| c.camera == camera);
        let at = known.unwrap_or_else(|| {
            self.cameras.push(CameraCalibrationError {
                camera: camera.to_owned(),
                ..CameraCalibrationError::default()
            });
            self.cameras.len() - 1
        });
        &mut self.cameras[at]
    }

    /// Error of a camera; zero if absent.
    pub fn of(&self, camera: &str) -> CameraCalibrationError {
        let own = self.cameras.iter().find(|c| c.camera == camera);
        own.cloned().unwrap_or_default()
    }
}

impl Entry {
    fn problems(&self, cameras: &[&str]) -> Vec<String> {
        let name = &self.name;
        let mut problems = Vec::new();
        if !cameras.contains(&name.as_str()) {
            let known = cameras.join(", ");
            problems.push(format!("camera is {name:?}, expected one of {known}"));
        }
        let mut check = |key: &str, found: &[f64], most: f64, unit: &str| {
            // NaN is in no range.
            if !found.iter().all(|v| v.abs() <= most) {
                problems.push(format!(
                    "{key} of {name} is {found:?}, expected {} to {most} {unit}",
                    -most
                ));
            }
        };
        check("rotation_deg", &self.rotation_deg, MAX_DEG_MM.0, "degrees");
        check(
            "right_rotation_deg",
            &self.right_rotation_deg,
            MAX_DEG_MM.0,
            "degrees",
        );
        check(
            "imu_rotation_deg",
            &self.imu_rotation_deg,
            MAX_DEG_MM.0,
            "degrees",
        );
        check("translation_mm", &self.translation_mm, MAX_DEG_MM.1, "mm");
        check(
            "right_translation_mm",
            &self.right_translation_mm,
            MAX_DEG_MM.1,
            "mm",
        );
        check(
            "time_offset_ms",
            &[self.time_offset_ms],
            MAX_TIME_OFFSET_MS,
            "ms",
        );
        check("focal_px", &self.focal_px, MAX_CHANGE_PX, "px");
        check(
            "principal_point_px",
            &self.principal_point_px,
            MAX_CHANGE_PX,
            "px",
        );
        problems
    }

    fn calibration_error(&self) -> CameraCalibrationError {
        let rad = |deg: [f64; 3]| Vector3::from(deg) * (std::f64::consts::PI / 180.0);
        CameraCalibrationError {
            camera: self.name.clone(),
            rotation: rad(self.rotation_deg),
            translation: Vector3::from(self.translation_mm) * 1e-3,
            right_rotation: rad(self.right_rotation_deg),
            right_translation: Vector3::from(self.right_translation_mm) * 1e-3,
            imu_rotation: rad(self.imu_rotation_deg),
            time_offset_ns: (self.time_offset_ms * 1e6).round() as i64,
            focal_px: self.focal_px,
            principal_point_px: self.principal_point_px,
        }
    }
}

impl CameraCalibrationError {
    /// Whether the true extrinsics equal the nominal ones.
    pub(crate) fn has_nominal_extrinsics(&self) -> bool {
        let none = Vector3::zeros();
        [
            self.rotation,
            self.translation,
            self.right_rotation,
            self.right_translation,
            self.imu_rotation,
        ]
        .iter()
        .all(|v| *v == none)
    }

    /// True pose of an eye or the IMU in the rig frame, from the nominal poses of the left eye and
    /// of the part itself.
    pub fn true_pose(
        &self,
        part: FramePart,
        rig_from_left: &RigidTransform,
        rig_from_part: &RigidTransform,
    ) -> RigidTransform {
        if self.has_nominal_extrinsics() {
            return *rig_from_part;
        }
        let left_from_part = rig_from_left.inverse() * *rig_from_part;
        let own = match part {
            FramePart::Left => RigidTransform::identity(),
            FramePart::Right => transform(&self.right_rotation, &self.right_translation),
            FramePart::Imu => transform(&self.imu_rotation, &Vector3::zeros()),
        };
        *rig_from_left * transform(&self.rotation, &self.translation) * left_from_part * own
    }

    /// True intrinsics.
    pub(crate) fn true_lens(&self, nominal: &CameraModel) -> CameraModel {
        CameraModel {
            fx: nominal.fx + self.focal_px[0],
            fy: nominal.fy + self.focal_px[1],
            cx: nominal.cx + self.principal_point_px[0],
            cy: nominal.cy + self.principal_point_px[1],
            ..*nominal
        }
    }
}

fn transform(rotation: &Vector3<f64>, translation: &Vector3<f64>) -> RigidTransform {
    let q = so3::exp(*rotation);
    RigidTransform::from_wxyz(
        [q.w, q.i, q.j, q.k],
        [translation.x, translation.y, translation.z],
    )
    .expect("a rotation and a bounded translation are a rigid transform")
}

/// True pose in the rig frame: by frame name, nominal pose of the frame, and nominal pose of its
/// camera's left eye; `None` where the nominal pose is true.
type TruePose<'a> = dyn Fn(&Frame, &RigidTransform, &RigidTransform) -> Option<RigidTransform> + 'a;

/// Rig file (TOML) with the true extrinsics; the parent of every frame is `rig`.
pub(crate) fn true_rig_toml(nominal: &Rig, true_pose: &TruePose<'_>) -> String {
    let mut text = format!(
        "# The true rig of the simulation; the recorded rig file may differ.\n\
         format = 1\nname = {:?}\nrevision = {:?}\n\n\
         [provenance]\nkind = \"measured\"\nnote = \"truth of a simulation\"\n",
        nominal.name(),
        format!("{} in truth", nominal.revision()),
    );
    let rig = Frame::rig();
    for frame in nominal.frames().filter(|frame| *frame != rig) {
        let nominal_pose =
            |frame: &Frame| nominal.transform(&rig, frame).expect("a frame of the rig");
        let mut here = nominal_pose(&frame);
        if let Some((camera, _)) = frame.camera() {
            let left = Frame::of_camera(camera, FramePart::Left).expect("a camera's name");
            here = true_pose(&frame, &here, &nominal_pose(&left)).unwrap_or(here);
        }
        // Writing to a string does not fail.
        let _ = write!(
            text,
            "\n[[parent_from_child]]\nparent = \"rig\"\nchild = {:?}\nrotation_wxyz = {:?}\n\
             translation_m = {:?}\n",
            frame.as_str(),
            here.rotation_wxyz(),
            here.translation_m(),
        );
    }
    for tag in nominal.shoe_tags() {
        let (TagFamily::Tag36h11, foot) = (tag.family, tag.foot.as_str());
        let _ = write!(
            text,
            "\n[[shoe_tag]]\nfamily = \"36h11\"\nid = {}\nfoot = {foot:?}\nsize_m = {:?}\n\
             rotation_wxyz = {:?}\ntranslation_m = {:?}\n",
            tag.id,
            tag.size_m,
            tag.foot_from_tag.rotation_wxyz(),
            tag.foot_from_tag.translation_m(),
        );
    }
    for sole in nominal.soles() {
        let (foot, outline_m) = (sole.foot.as_str(), &sole.outline_m);
        let _ = write!(
            text,
            "\n[[sole]]\nfoot = {foot:?}\noutline_m = {outline_m:?}\n"
        );
    }
    text
}

#[cfg(test)]
mod tests;
