//! How a rig is not what its files say: cameras that have turned or moved, eyes that have, lenses that are not
//! the factory's, pictures whose times are off.
//!
//! Contract: a deviation changes what is true; what is told stays. With nothing in it every byte comes out as
//! without it. Turns are about the left eye of the camera and, like the axes of moves, in its left optical
//! frame; the right eye's own are in the right optical frame, about the right eye. A camera takes its IMU with it.
//!
//! ```toml
//! [[camera]]
//! name = "left_shoulder"
//! rotation_deg = [0.0, 0.5, 0.0]        # rotation vector: x right, y down, z forward; the whole camera
//! translation_mm = [0.0, 0.0, 0.0]
//! right_rotation_deg = [0.0, 0.0, 0.0]  # of the right eye alone, on top
//! right_translation_mm = [0.0, 0.0, 0.0]
//! imu_rotation_deg = [0.0, 0.0, 0.0]    # of the IMU alone, on top, in its own frame
//! time_offset_ms = 3.0                       # pictures were taken so much earlier than they say
//! focal_px = [0.0, 0.0]               # added to the focal lengths of both lenses, x and y
//! centre_px = [0.0, 0.0]              # added to their principal points
//! ```
//!
//! Every key but the name may be left out.

use std::fmt::Write as _;

use cad_transforms::RigidTransform;
use cad_transforms::frame::{Frame, FramePart};
use cad_transforms::rig::{Foot, Rig, TagFamily};
use calib::CameraModel;
use nalgebra::Vector3;
use serde::Deserialize;

use crate::so3;

/// Turns and moves beyond these are mistakes in the file, degrees and mm.
const MAX_DEG_MM: (f64, f64) = (45.0, 500.0);
/// So are times beyond this, ms, and changes of a lens beyond this, px.
const MAX_TIME_OFFSET_MS: f64 = 500.0;
const MAX_CHANGE_PX: f64 = 500.0;

/// See the module.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CalibrationError {
    /// Each camera at most once.
    pub cameras: Vec<CameraCalibrationError>,
}

/// How one camera deviates.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraCalibrationError {
    /// Which.
    pub camera: String,
    /// Of the whole camera: rotation vector, rad, and m.
    pub rotation: Vector3<f64>,
    /// See `rotation`.
    pub translation: Vector3<f64>,
    /// Of the right eye alone.
    pub right_rotation: Vector3<f64>,
    /// See `right_rotation`.
    pub right_translation: Vector3<f64>,
    /// Of the IMU alone.
    pub imu_rotation: Vector3<f64>,
    /// How much later than it was a picture says it was taken, ns.
    pub time_offset_ns: i64,
    /// Added to the focal lengths, px.
    pub focal_px: [f64; 2],
    /// Added to the principal points, px.
    pub centre_px: [f64; 2],
}

/// Why there is no deviation: correct the file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("reading how the rig deviates: {0}")]
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
    centre_px: [f64; 2],
}

impl CalibrationError {
    /// Reads a file. Cameras must be among `cameras`.
    ///
    /// # Errors
    /// [`ParseError`] with everything that is wrong.
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

    /// That of a camera, to be changed.
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

    /// That of a camera.
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
            // Not a number is in no range.
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
        check("centre_px", &self.centre_px, MAX_CHANGE_PX, "px");
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
            centre_px: self.centre_px,
        }
    }
}

impl CameraCalibrationError {
    /// Whether anything sits elsewhere than told.
    pub fn has_nominal_extrinsics(&self) -> bool {
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

    /// Where an eye or the IMU really is, told where it and the left eye are.
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

    /// What a lens really is.
    pub fn true_lens(&self, nominal: &CameraModel) -> CameraModel {
        CameraModel {
            fx: nominal.fx + self.focal_px[0],
            fy: nominal.fy + self.focal_px[1],
            cx: nominal.cx + self.centre_px[0],
            cy: nominal.cy + self.centre_px[1],
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
    .expect("a rotation and a bounded move are a rigid transform")
}

/// Where a frame really is on the rig, by its name, by where the told rig has it, and where that has its camera's
/// left eye; none where it is as told.
type TruePose<'a> = dyn Fn(&Frame, &RigidTransform, &RigidTransform) -> Option<RigidTransform> + 'a;

/// The text of a rig file of the rig as it really is: every frame hangs on `rig`.
pub(crate) fn true_rig_toml(nominal: &Rig, true_pose: &TruePose<'_>) -> String {
    let mut text = format!(
        "# The rig as it was simulated: not what the recording was told.\n\
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
        let (TagFamily::Tag36h11, foot) = (
            tag.family,
            match tag.foot {
                Foot::Left => "left_foot",
                Foot::Right => "right_foot",
            },
        );
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
    text
}

#[cfg(test)]
mod tests;
