//! A calibration session: static boards in a room, and a rig that is carried in front of them.
//!
//! Contract: everything is a function of the rig, [`Plan`], length and seed. Each camera of the rig
//! has a board that faces it at the start pose; cameras with nearly the same viewing direction
//! share one, and so do those for which no board remains. The motion of the rig is a spline as on a
//! walk, within the limits of human arms ([`motion`]). Corner positions in images are exact
//! ([`observations`]) and need no rendering: thousands of views with ground truth take no longer
//! than the projection. The carrier is never visible.

use boards::Target;
use nalgebra::{UnitQuaternion, Vector3};

pub mod board;
pub mod motion;
pub mod observations;

use self::board::{Board, Sheet};
use crate::random;
use crate::rig::SimCamera;
use cad_transforms::so3;

/// Start position: the rig's datum above the middle of the floor, m.
pub const HOME: [f64; 3] = [0.0, 0.0, 1.3];
/// Distance from a camera to its board, m.
const DISTANCE_M: f64 = 1.1;
/// Minimum distance where the floor limits it, m.
const MIN_DISTANCE_M: f64 = 0.6;
/// Minimum height of a board's lower edge, m.
const MIN_CLEARANCE_M: f64 = 0.06;
/// Maximum angle between the axes of cameras that share a board, rad.
const MAX_SHARED_ANGLE_RAD: f64 = 0.6;
/// Standard deviation of the rotation of boards from facing their camera, rad.
const FACING_SIGMA_RAD: f64 = 0.08;

/// Plan of a calibration session, with its defects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Motion of the rig.
    pub motion: Motion,
    /// Number of views, after which the rig is at rest; `None` for views until the end.
    pub views: Option<usize>,
    /// Bow of every board: distance of its middle behind the line between its left and right edge,
    /// m.
    pub bow_m: f64,
    /// Scale error of the boards relative to their files: 0.01 is one percent larger.
    pub scale_error: f64,
}

/// Motion of the rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// At rest for half a second in each of many views, with excitation about every axis between.
    Varied,
    /// At rest in the same views with slow transfers: no excitation for an IMU.
    Still,
    /// Translation without rotation: cameras remain parallel to the boards that face them.
    Parallel,
}

impl Motion {
    /// All motions.
    pub const ALL: [Self; 3] = [Self::Varied, Self::Still, Self::Parallel];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Varied => "varied",
            Self::Still => "still",
            Self::Parallel => "parallel",
        }
    }
}

impl Plan {
    /// A recommended session.
    pub const GOOD: Self = Self {
        motion: Motion::Varied,
        views: None,
        bow_m: 0.0,
        scale_error: 0.0,
    };
}

/// The `number`-th board of a session: an AprilGrid of 6 x 6 tags with sides of 9.6 cm and gaps of
/// 2.88 cm, which fits on A0, with tag ids that no other board has.
pub fn april_grid(number: usize) -> Target {
    let (columns, rows) = (6, 6);
    Target::AprilGrid {
        columns,
        rows,
        tag_m: 0.096,
        spacing: 0.3,
        first_id: columns * rows * number as u32,
    }
}

/// Boards for the cameras of a rig at [`HOME`], each sheet used once, and the index of the board of
/// each camera.
pub(crate) fn boards(
    cameras: &[SimCamera],
    sheet: &dyn Fn(usize) -> Option<Sheet>,
    plan: &Plan,
    seed: u64,
) -> (Vec<Board>, Vec<usize>) {
    let mut boards: Vec<Board> = Vec::new();
    let mut axes: Vec<Vector3<f64>> = Vec::new();
    let mut facing = Vec::new();
    for camera in cameras {
        let [left, right] = &camera.rig_from_eye;
        let axis = left.rotation() * Vector3::z();
        let angle = |other: &Vector3<f64>| other.angle(&axis);
        let near = (0..axes.len()).min_by(|a, b| angle(&axes[*a]).total_cmp(&angle(&axes[*b])));
        let shared = near.filter(|near| angle(&axes[*near]) < MAX_SHARED_ANGLE_RAD);
        let sheet = match shared {
            Some(_) => None,
            None => sheet(boards.len()),
        };
        let Some(sheet) = sheet else {
            facing.push(near.unwrap_or(0));
            continue;
        };
        facing.push(boards.len());
        axes.push(axis);
        let number = boards.len();
        let eye = Vector3::from(HOME) + 0.5 * (left.translation() + right.translation());
        let draw = |k: u64| {
            let index = 3 * number as u64 + k;
            FACING_SIGMA_RAD * random::bell(seed, random::SCENE + 0x40, index)
        };
        let careless = match plan.motion {
            Motion::Parallel => UnitQuaternion::identity(),
            _ => so3::exp(Vector3::new(draw(0), draw(1), draw(2))),
        };
        let rotation = left.rotation() * careless;
        let at = |distance: f64| {
            let pose = (eye + axis * distance, rotation);
            Board::new(sheet.clone(), pose, plan.bow_m, plan.scale_error)
        };
        let steps = ((DISTANCE_M - MIN_DISTANCE_M) / 0.02) as u32;
        let nearer = (0..=steps).map(|k| at(DISTANCE_M - 0.02 * f64::from(k)));
        let clear = nearer.into_iter().find(|b| b.lowest_m() >= MIN_CLEARANCE_M);
        boards.push(clear.unwrap_or_else(|| at(MIN_DISTANCE_M)));
    }
    (boards, facing)
}

#[cfg(test)]
mod tests;
