//! A target session: calibration boards that stand still in a room, and a plate that somebody carries
//! before them.
//!
//! Contract: everything follows from the rig, [`Plan`], length and seed. Each camera of the rig has a board
//! that faces it where the plate starts; cameras that look nearly the same way share one, and so do those for which there is none left. The plate's motion is
//! a spline as a walk's is, bounded by what arms do ([`motion`]). Where corners are in pictures is exact
//! ([`observations`]) and needs no picture: thousands of views with their truth take no longer than the projection.
//! The carrier is never seen.

use calib::target::Target;
use nalgebra::{UnitQuaternion, Vector3};

pub mod board;
pub mod motion;
pub mod observations;

use self::board::{Board, Sheet};
use crate::random;
use crate::rig::SimCamera;
use crate::so3;

/// Where the plate starts: the rig's datum above the middle of the floor, m.
pub const HOME: [f64; 3] = [0.0, 0.0, 1.3];
/// From a camera to the board that faces it, m.
const DISTANCE_M: f64 = 1.1;
/// And no nearer than this where the floor is in the way.
const MIN_DISTANCE_M: f64 = 0.6;
/// Least height of a board's lower edge, m.
const MIN_CLEARANCE_M: f64 = 0.06;
/// Cameras whose axes are nearer than this share a board, rad.
const MAX_SHARED_ANGLE_RAD: f64 = 0.6;
/// How far boards are turned from facing their camera, standard deviation, rad.
const FACING_SIGMA_RAD: f64 = 0.08;

/// How the session is done, and what is wrong with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// How the plate is moved.
    pub motion: Motion,
    /// The plate rests for good after so many views; none for going on to the end.
    pub views: Option<usize>,
    /// How far the middle of every board is behind the line between its left and right edge, m.
    pub bow_m: f64,
    /// How much larger boards are than their files say, relative: 0.01 is one percent.
    pub scale_error: f64,
}

/// How the plate is moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Held still for half a second before each of many views, and swung about every axis between.
    Varied,
    /// Held still for the same views with slow ways between: nothing for an IMU.
    Still,
    /// Moved, but never turned: cameras stay parallel to the boards that face them.
    Parallel,
}

impl Motion {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Varied, Self::Still, Self::Parallel];

    /// As the command line calls it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Varied => "varied",
            Self::Still => "still",
            Self::Parallel => "parallel",
        }
    }
}

impl Plan {
    /// A session as it should be done.
    pub const GOOD: Self = Self {
        motion: Motion::Varied,
        views: None,
        bow_m: 0.0,
        scale_error: 0.0,
    };
}

/// The `number`-th board of a session: an AprilGrid of 6 x 6 tags with sides of 9.6 cm and gaps of 2.88 cm,
/// which fits on A0, and whose tags no other board has.
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

/// Boards for the cameras of a rig at [`HOME`], each of the sheets once, and which board faces which camera.
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
