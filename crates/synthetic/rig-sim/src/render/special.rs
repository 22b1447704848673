//! Files of calibration sessions and of recordings whose ground truth differs from the recorded
//! calibration.

use std::fmt::Write as _;

use cad_transforms::rig::Rig;
use camera_models::{CameraInfo, Eye};

use crate::camera::Shutter;
use crate::faults::CameraFaults;
use crate::simulation::Simulation;

/// Names and contents; empty for a walk whose calibration is exact.
///
/// * `target.N.toml`: each board as designed;
/// * `truth.targets.csv`: a row for each board (`corner` empty; position and quaternion of
///   `world_from_target`) and for each of its corners (true position in the world);
/// * `truth.rig.toml`: true extrinsics;
/// * `truth.cameras.toml`: true intrinsics, shutters and time offsets.
pub(super) fn files(simulation: &Simulation, nominal: &Rig) -> Vec<(String, String)> {
    let boards = simulation.boards();
    let mut files = Vec::new();
    for (number, board) in boards.iter().enumerate() {
        let text = calibration_files::board::to_toml(board.sheet().target());
        files.push((format!("target.{number}.toml"), text));
    }
    if !boards.is_empty() {
        files.push(("truth.targets.csv".to_owned(), board_poses(simulation)));
    }
    if !boards.is_empty() || simulation.differs_from_calibration() {
        let rig = simulation.true_rig_toml(nominal);
        files.push(("truth.rig.toml".to_owned(), rig));
        files.push(("truth.cameras.toml".to_owned(), cameras(simulation)));
    }
    files
}

fn board_poses(simulation: &Simulation) -> String {
    let mut text = "#board,corner,p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z []\n".to_owned();
    for (number, board) in simulation.boards().iter().enumerate() {
        let (p, q) = board.world_from_target();
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "{number},,{},{},{},{},{},{},{}",
            p.x, p.y, p.z, q.w, q.i, q.j, q.k
        );
        for corner in board.sheet().corners() {
            let p = board.at(corner.at_m, 0.0);
            let _ = writeln!(text, "{number},{},{},{},{},,,,", corner.id, p.x, p.y, p.z);
        }
    }
    text
}

fn cameras(simulation: &Simulation) -> String {
    let mut text =
        "# The true cameras of the simulation; the recorded calibration may differ.\n".to_owned();
    for (number, camera) in simulation.cameras().iter().enumerate() {
        let line_s = match camera.shutter {
            Shutter::Global => 0.0,
            Shutter::Rolling { line_s } => line_s,
        };
        let _ = write!(
            text,
            "\n[[camera]]\nname = {:?}\ntime_offset_ns = {} # frame timestamp minus true exposure time\n\
             line_s = {line_s:?} # from row to row; 0 for a global shutter\n",
            camera.name, camera.time_offset_ns
        );
        let truth = simulation.true_calibration(number);
        for (eye, which) in [("left", Eye::Left), ("right", Eye::Right)] {
            let (model, info) = (truth.eye(which), CameraInfo::of(&truth, which));
            let _ = write!(
                text,
                "\n[camera.{eye}]\nwidth = {}\nheight = {}\nfx = {:?}\nfy = {:?}\ncx = {:?}\ncy = {:?}\n\
                 distortion = {:?} # as ROS names it\ncoefficients = {:?}\n",
                model.width,
                model.height,
                model.fx,
                model.fy,
                model.cx,
                model.cy,
                info.distortion_model,
                info.d,
            );
        }
    }
    text
}

/// Every corner in every image of a camera, both eyes.
pub(super) fn corners(simulation: &Simulation, camera: usize, faults: &CameraFaults) -> String {
    let target_observations = simulation
        .target_observations(camera)
        .with_faults(faults.clone());
    let mut text = "#frame,timestamp [ns],eye,board,corner,u [px],v [px]\n".to_owned();
    for frame in 0..simulation.settings().frame_count() {
        let time_ns = simulation.settings().frame_ns(frame);
        for eye in 0..2 {
            for seen in target_observations.corners(eye, time_ns) {
                let ([u, v], board, id) = (seen.pixel, seen.board, seen.id);
                let _ = writeln!(text, "{frame},{time_ns},{eye},{board},{id},{u:.4},{v:.4}");
            }
        }
    }
    text
}
