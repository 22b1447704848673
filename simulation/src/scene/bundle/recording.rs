//! What a bundle says of the recording: cameras, views and reference poses.

use cad_transforms::RigidTransform;
use camera_models::Eye;
use scene_bundle::outputs;
use scene_bundle::outputs::rig::RigModel;

use crate::scene::sector::{RecordedView, Recording, RecordingCamera};

/// Both cameras of each stereo camera.
pub(super) fn cameras(rig: &RigModel) -> Vec<RecordingCamera> {
    let both = rig.cameras.iter().flat_map(|camera| {
        let rig_from_right = camera.rig_from_left * camera.right_from_left.inverse();
        [
            (Eye::Left, "left", camera.left, camera.rig_from_left),
            (Eye::Right, "right", camera.right, rig_from_right),
        ]
        .map(|(eye, side, model, rig_from_camera)| RecordingCamera {
            name: format!("{}/{side}", camera.name),
            eye,
            model,
            rig_from_camera,
            line_s: camera.line_s,
        })
    });
    both.collect()
}

/// A view as the training used it.
pub(super) fn view(view: &outputs::splats::SplatView) -> RecordedView {
    let side = match view.eye {
        Eye::Left => "left",
        Eye::Right => "right",
    };
    RecordedView {
        camera: format!("{}/{side}", view.camera),
        time_ns: view.time_ns,
        world_from_camera: view.world_from_camera,
        held_out_psnr_db: view.held_out.map(|held_out| held_out.psnr_db),
    }
}

/// Poses of cameras of the training, or else those of the rig's left cameras along the trajectory.
pub(super) fn references(recording: &Recording) -> Vec<RigidTransform> {
    if !recording.views.is_empty() {
        let trained = recording
            .views
            .iter()
            .filter(|view| view.held_out_psnr_db.is_none());
        return trained.map(|view| view.world_from_camera).collect();
    }
    let poses = recording
        .trajectory
        .iter()
        .flat_map(|trajectory| trajectory.usable());
    let cameras = || {
        recording
            .cameras
            .iter()
            .filter(|camera| camera.eye == Eye::Left)
    };
    poses
        .flat_map(|pose| cameras().map(|camera| pose.world_from_rig * camera.rig_from_camera))
        .collect()
}
