//! For tests: a rig with one camera that looks straight down, and a shoe with a tag.

use cad_transforms::RigidTransform;
use cad_transforms::rig::{Foot, TagFamily};
use camera_models::{CameraModel, Distortion};
use scene_bundle::outputs::depth::{DepthKey, DepthView};
use scene_bundle::outputs::rig::{RigCamera, RigModel, RigShoe, RigShoeTag};
use terrain::RowMotion;

use super::depth_frames::DepthFrame;

pub(super) const SIZE: [u32; 2] = [60, 40];
/// Height of the camera above the ground, m.
pub(super) const HEIGHT_M: f64 = 1.2;

pub(super) fn at(x: f64, y: f64, z: f64) -> RigidTransform {
    RigidTransform::from_rotation_vector([0.0; 3], [x, y, z]).expect("finite")
}

fn model() -> CameraModel {
    CameraModel {
        width: SIZE[0],
        height: SIZE[1],
        fx: 60.0,
        fy: 60.0,
        cx: 29.5,
        cy: 19.5,
        distortion: Distortion::None,
    }
}

/// A camera that looks straight down from the origin of the rig, and a shoe with a tag.
pub(super) fn rig() -> RigModel {
    // Columns to the rig's right, rows to its rear.
    let down = [0.0, 0.5_f64.sqrt(), -0.5_f64.sqrt(), 0.0];
    RigModel {
        name: "test".to_owned(),
        revision: "1".to_owned(),
        cameras: vec![RigCamera {
            name: "feet".to_owned(),
            left: model(),
            right: model(),
            rig_from_left: RigidTransform::from_wxyz(down, [0.0; 3]).expect("a pose"),
            rig_from_left_covariance: None,
            right_from_left: at(-0.063, 0.0, 0.0),
            right_from_left_covariance: None,
            line_s: 0.0,
        }],
        imus: Vec::new(),
        shoes: vec![RigShoe {
            foot: Foot::Left,
            outline_m: vec![[-0.12, -0.04], [0.16, -0.04], [0.16, 0.04], [-0.12, 0.04]],
            outline_sigma_m: None,
            tags: vec![RigShoeTag {
                family: TagFamily::Tag36h11,
                id: 7,
                size_m: 0.06,
                size_sigma_m: None,
                foot_from_tag: at(0.08, 0.0, 0.08),
                foot_from_tag_covariance: None,
            }],
        }],
    }
}

/// The left image of the camera.
pub(super) fn view() -> DepthView {
    DepthView {
        camera: "feet".to_owned(),
        model: model(),
        view_from_left: RigidTransform::identity(),
    }
}

/// A depth map of the camera, with the rig at the origin.
pub(super) fn frame(time_ns: i64) -> DepthFrame {
    DepthFrame {
        key: DepthKey {
            view: 0,
            time_ns,
            frame: 3,
            set: 1,
        },
        world_from_view: rig().cameras[0].rig_from_left,
        row_motion: RowMotion::default(),
    }
}
