//! The simulated rig: cameras, their extrinsics and their models.

use cad_transforms::RigidTransform;
use cad_transforms::frame::{Frame, FramePart};
use cad_transforms::rig::{Foot, Rig, RigError, TagFamily};
use camera_models::{CameraModel, Distortion};
use nalgebra::{UnitQuaternion, Vector3};

use crate::camera::Shutter;
use crate::scene::tag;
use crate::scene::wearer::ShoeTag;
use crate::spline::State;
use crate::walker::Side;

/// A stereo camera on the rig.
#[derive(Clone, Debug, PartialEq)]
pub struct SimCamera {
    /// `left_shoulder`, `right_shoulder`, `feet`.
    pub name: String,
    /// Intrinsics of left and right eye.
    pub models: [CameraModel; 2],
    /// Takes points in the left and the right optical frame to the rig's.
    pub rig_from_eye: [RigidTransform; 2],
    /// Shutter.
    pub shutter: Shutter,
    /// Maximum exposure, s.
    pub max_exposure_s: f64,
    /// Pixel layout of delivered frames.
    pub format: PixelFormat,
    /// Frame timestamp minus true middle of the exposure, ns.
    pub time_offset_ns: i64,
}

/// Pixel layout of a device, left and right eye side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFormat {
    /// Y Cb Y Cr for two pixels each (4:2:2): USB cameras.
    Yuyv,
    /// All Y, then Cb Cr for two by two pixels each (4:2:0): GMSL cameras.
    Nv12,
}

impl SimCamera {
    /// True middle of the exposure of a frame with timestamp `said_ns` (ns since the beginning), s.
    pub(crate) fn taken_s(&self, said_ns: i64) -> f64 {
        (said_ns - self.time_offset_ns) as f64 * 1e-9
    }

    /// Pose of an eye's optical frame in the world for a state of the rig and a displacement of the
    /// camera on it.
    pub fn world_from_eye(
        &self,
        eye: usize,
        rig: &State,
        slip: Option<&RigidTransform>,
    ) -> (Vector3<f64>, UnitQuaternion<f64>) {
        let rig_from_eye = match slip {
            None => self.rig_from_eye[eye],
            Some(slip) => *slip * self.rig_from_eye[eye],
        };
        (
            rig.position + rig.rotation * rig_from_eye.translation(),
            rig.rotation * rig_from_eye.rotation(),
        )
    }

    /// Displacement on the rig of a camera that has rotated about its left eye: maps a point from
    /// its position by the rig file to its true position. `rotation` maps the true left optical
    /// frame to the nominal one; `None` for the identity.
    pub fn slip(&self, rotation: &UnitQuaternion<f64>) -> Option<RigidTransform> {
        if *rotation == UnitQuaternion::identity() {
            return None;
        }
        let q = rotation.quaternion();
        let turn = RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], [0.0; 3])
            .expect("a rotation is a rigid transform");
        let left = self.rig_from_eye[0];
        Some(left * turn * left.inverse())
    }
}

/// Vertical part of a ZED's 16:9 image.
fn model(
    width: u32,
    height: u32,
    focal: f64,
    distortion: Distortion,
    off: [f64; 2],
) -> CameraModel {
    CameraModel {
        width,
        height,
        fx: focal,
        fy: focal,
        cx: 0.5 * f64::from(width - 1) + off[0],
        cy: 0.5 * f64::from(height - 1) + off[1],
        distortion,
    }
}

/// The shoe tags, or the id of one that cannot be drawn.
pub(crate) fn shoe_tags(rig: &Rig) -> Result<Vec<ShoeTag>, u32> {
    let tags = rig.shoe_tags().iter().map(|tag| {
        let TagFamily::Tag36h11 = tag.family;
        let id = usize::try_from(tag.id).ok().filter(|id| *id < tag::COUNT);
        Ok(ShoeTag {
            id: id.ok_or(tag.id)?,
            side: match tag.foot {
                Foot::Left => Side::Left,
                Foot::Right => Side::Right,
            },
            size_m: tag.size_m,
            position: *tag.foot_from_tag.translation(),
            rotation: *tag.foot_from_tag.rotation(),
        })
    });
    tags.collect()
}

/// The cameras of a rig file: those named `feet` are ZED Minis with a rolling shutter, all others
/// ZED X Minis with a global one. Intrinsics are nominal: focal lengths of the vendors' example
/// files (ZED X Mini 736.9 px at 1920 columns, ZED Mini 700 px at 1280), and distortions of typical
/// size.
///
/// # Errors
/// [`RigError`] if the rig lacks an eye of a camera that it names.
pub fn cameras(rig: &Rig, width: u32, height: u32) -> Result<Vec<SimCamera>, RigError> {
    let scale = f64::from(width);
    let mut cameras = Vec::new();
    for name in rig.cameras() {
        let frame =
            |part| Frame::of_camera(name, part).expect("a rig names its cameras by valid names");
        let pose = |part| rig.transform(&Frame::rig(), &frame(part));
        let (left, right) = (pose(FramePart::Left)?, pose(FramePart::Right)?);
        let is_mini = name == "feet";
        let focal = if is_mini {
            700.0 / 1280.0
        } else {
            736.9 / 1920.0
        } * scale;
        let lens = |k1: f64, k2: f64, p1: f64, p2: f64| Distortion::RadTan5 {
            k1,
            k2,
            p1,
            p2,
            k3: 0.0,
        };
        let models = match is_mini {
            true => [
                model(
                    width,
                    height,
                    focal,
                    lens(-0.172, 0.0255, 2.1e-4, -1.3e-4),
                    [2.3, -3.1],
                ),
                model(
                    width,
                    height,
                    focal * 1.0007,
                    lens(-0.171, 0.0249, -1.1e-4, 2.2e-4),
                    [-1.7, 1.9],
                ),
            ],
            false => [
                model(
                    width,
                    height,
                    focal,
                    lens(-0.052, 0.0061, 1.2e-4, 0.8e-4),
                    [-2.6, 1.4],
                ),
                model(
                    width,
                    height,
                    focal * 0.9996,
                    lens(-0.0525, 0.0063, -0.9e-4, -1.7e-4),
                    [3.1, -0.8],
                ),
            ],
        };
        cameras.push(SimCamera {
            name: name.to_owned(),
            models,
            rig_from_eye: [left, right],
            shutter: match is_mini {
                // 376 rows in the time of a 100 Hz mode's frame, less a pause.
                true => Shutter::Rolling {
                    line_s: 0.0085 / f64::from(height),
                },
                false => Shutter::Global,
            },
            max_exposure_s: 0.012,
            format: match is_mini {
                true => PixelFormat::Yuyv,
                false => PixelFormat::Nv12,
            },
            time_offset_ns: 0,
        });
    }
    Ok(cameras)
}
