//! Where corners of boards are in pictures, without a picture.
//!
//! Contract: exact but for f64. A corner is at its place in the middle of the exposure of its row, seen through the
//! true lens from where the camera really is. It is told only where the picture shows it: inside by
//! half a pixel, from the side of the print, and with no other board before it.

use nalgebra::Vector3;

use super::board::Board;
use crate::camera::Shutter;
use crate::camera::optics::Conditions;
use crate::faults::CameraFaults;
use crate::lens::Lens;
use crate::rig::SimCamera;
use crate::simulation::{Simulation, seconds};

/// What is nearer to the eye than this is behind it, m.
const NEAR_M: f64 = 0.03;
/// Boards seen at a flatter angle than this show nothing: sine.
const FLATTEST: f64 = 0.05;

/// A corner in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenCorner {
    /// Position of its board in [`Simulation::boards`].
    pub board: usize,
    /// Its number on the board: [`calib::target::Corner::id`].
    pub id: u32,
    /// Column and row, px, pixel centres at whole numbers.
    pub pixel: [f64; 2],
}

/// Tells where corners are in the pictures of one camera.
pub struct Sights<'a> {
    simulation: &'a Simulation,
    camera: &'a SimCamera,
    faults: CameraFaults,
    lenses: [Lens; 2],
}

impl<'a> Sights<'a> {
    pub(crate) fn new(simulation: &'a Simulation, camera: usize) -> Self {
        let camera = &simulation.cameras()[camera];
        Self {
            simulation,
            camera,
            faults: CameraFaults::default(),
            lenses: camera.models.each_ref().map(Lens::new),
        }
    }

    /// The same where the camera has these faults: one that has slipped looks elsewhere.
    #[must_use]
    pub fn with_faults(mut self, faults: CameraFaults) -> Self {
        self.faults = faults;
        self
    }

    /// The corners that an eye (0 left, 1 right) sees in frame `number`, by board and number.
    pub fn frame(&self, eye: usize, number: u64) -> Vec<SeenCorner> {
        self.corners(eye, self.simulation.settings().frame_ns(number))
    }

    /// The corners in a picture that the camera says it took at a time, ns since the beginning.
    pub fn corners(&self, eye: usize, time_ns: i64) -> Vec<SeenCorner> {
        let boards = self.simulation.boards();
        let mut found = Vec::new();
        for (number, board) in boards.iter().enumerate() {
            for corner in board.sheet().corners() {
                let point = board.at(corner.at_m, 0.0);
                if let Some((pixel, from)) = self.seen(eye, time_ns, &point)
                    && is_shown(boards, number, &point, &from)
                {
                    found.push(SeenCorner {
                        board: number,
                        id: corner.id,
                        pixel,
                    });
                }
            }
        }
        found
    }

    /// Where an eye has a point of the world in a picture, and where the eye is then.
    fn seen(
        &self,
        eye: usize,
        time_ns: i64,
        point: &Vector3<f64>,
    ) -> Option<([f64; 2], Vector3<f64>)> {
        let (width, height) = (
            f64::from(self.camera.models[eye].width),
            f64::from(self.camera.models[eye].height),
        );
        let taken_s = self.camera.taken_s(time_ns);
        let turned = Conditions::of(&self.faults, seconds(time_ns)).turned;
        let slip = self.camera.slip(&turned);
        let look = |time_s: f64| {
            let rig = self.simulation.walker().rig(time_s);
            let (origin, rotation) = self.camera.world_from_eye(eye, &rig, slip.as_ref());
            let at = rotation.inverse() * (point - origin);
            let (x, y) = (at.x / at.z, at.y / at.z);
            let lens = &self.lenses[eye];
            (at.z > NEAR_M && lens.is_known(x, y)).then(|| (lens.project(x, y), origin))
        };
        let mut seen = look(taken_s)?;
        if let Shutter::Rolling { line_s } = self.camera.shutter {
            // The row that sees the point is exposed when it sees it. A picture moves by far less than a row
            // while a row is read, so that each round gains two digits.
            for _ in 0..6 {
                let row = seen.0.1.clamp(-height, 2.0 * height);
                seen = look(taken_s + line_s * (row - 0.5 * (height - 1.0)))?;
            }
        }
        let ((u, v), from) = seen;
        let inside = (0.0..=width - 1.0).contains(&u) && (0.0..=height - 1.0).contains(&v);
        inside.then_some(([u, v], from))
    }
}

fn is_shown(boards: &[Board], own: usize, point: &Vector3<f64>, eye: &Vector3<f64>) -> bool {
    let arm = eye - point;
    let normal = boards[own].pose().1 * -Vector3::z();
    normal.dot(&arm) > FLATTEST * arm.norm()
        && !boards
            .iter()
            .enumerate()
            .any(|(k, board)| k != own && board.hides(eye, point))
}
