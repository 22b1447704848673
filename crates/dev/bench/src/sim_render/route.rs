//! Routes of a camera through the sectors of a scene, frame by frame.

use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use cad_transforms::RigidTransform;
use simulation::{Place, SceneData, Similarity};

/// Path length between two frames, m: of a person who walks, at 10 frames per second.
pub(super) const FRAME_M: f64 = 0.14;
/// Frames from one side of a border to the other and beyond its hysteresis, also where a route
/// meets it at 45 degrees.
const PASS_FRAMES: usize = 4;
/// Corners of the path through the synthetic loop of four sectors, m, and height of the eye.
const CORNERS_M: [[f64; 2]; 4] = [[1.0, 1.0], [11.0, 1.0], [11.0, 11.0], [1.0, 11.0]];
const EYE_M: f64 = 1.4;

/// A frame of a route.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub(super) sector: usize,
    pub(super) sector_from_body: RigidTransform,
    /// Whether its sector is another one than that of the frame before.
    pub(super) is_change: bool,
    /// Whether the camera goes to and fro across a border, which it has just crossed.
    pub(super) is_pass: bool,
}

/// The frames at poses in the frame of the first sector. After each change of sector the camera
/// goes back and forth `passes` times.
///
/// # Errors
/// A change over an edge that does not exist.
pub(super) fn route(
    scene: &Arc<SceneData>,
    poses: &[RigidTransform],
    passes: usize,
) -> Result<Vec<Step>> {
    let mut walker = Walker::new(scene);
    let mut steps = Vec::new();
    for (at, pose) in poses.iter().enumerate() {
        let step = walker.go_to(pose, false)?;
        steps.push(step);
        // The first frame only finds its sector.
        if !step.is_change || at < PASS_FRAMES {
            continue;
        }
        for _ in 0..passes {
            let back = (1..=PASS_FRAMES).map(|k| at - k);
            let forth = (0..PASS_FRAMES).rev().map(|k| at - k);
            for number in back.chain(forth) {
                steps.push(walker.go_to(&poses[number], true)?);
            }
        }
    }
    Ok(steps)
}

/// Number of changes of sector.
pub(super) fn changes(steps: &[Step]) -> usize {
    steps.iter().skip(1).filter(|step| step.is_change).count()
}

/// Poses of an eye that goes around the loop of [`simulation::testing::SyntheticScene`].
///
/// # Errors
/// None that a finite number of laps could have.
pub(super) fn around_loop(laps: usize, frame_m: f64) -> Result<Vec<RigidTransform>> {
    let side_m = CORNERS_M[1][0] - CORNERS_M[0][0];
    let count = (laps as f64 * CORNERS_M.len() as f64 * side_m / frame_m) as usize;
    let eye = |number: usize| {
        let sides = number as f64 * frame_m / side_m;
        let [from, to] = [0, 1].map(|next| CORNERS_M[(sides as usize + next) % CORNERS_M.len()]);
        let [x, y] = [0, 1].map(|k| from[k] + sides.fract() * (to[k] - from[k]));
        let yaw_rad = libm::atan2(to[1] - from[1], to[0] - from[0]);
        facing([x, y, EYE_M], yaw_rad)
    };
    (0..count).map(eye).collect()
}

/// Poses of an eye that walks where the person of a recording walked, there and back.
///
/// # Errors
/// A scene without trajectory, or one with several recordings.
pub(super) fn along_recording(
    scene: &SceneData,
    laps: usize,
    frame_m: f64,
) -> Result<Vec<RigidTransform>> {
    let edges = scene.sectors.iter().flat_map(|sector| &sector.edges);
    ensure!(
        edges.clone().all(|edge| !edge.is_imported),
        "expected a scene bundle, whose sectors have one world; found edges between recordings"
    );
    let trajectory = scene.sectors[0].recording.trajectory.as_ref();
    let trajectory = trajectory.context("the scene has no output trajectory")?;
    let mut points: Vec<[f64; 3]> = Vec::new();
    for pose in trajectory.usable() {
        let at = pose.world_from_rig.translation_m();
        let is_far = |last: &[f64; 3]| f64::hypot(at[0] - last[0], at[1] - last[1]) >= frame_m;
        if points.last().is_none_or(is_far) {
            points.push(at);
        }
    }
    let back: Vec<[f64; 3]> = points.iter().rev().skip(1).copied().collect();
    points.extend(back);
    let yaw_rad = |number: usize| {
        let [from, to] = [points[number], points[(number + 1) % points.len()]];
        libm::atan2(to[1] - from[1], to[0] - from[0])
    };
    let lap: Vec<RigidTransform> = (0..points.len())
        .map(|number| facing(points[number], yaw_rad(number)))
        .collect::<Result<_>>()?;
    Ok(lap.iter().cycle().take(laps * lap.len()).copied().collect())
}

fn facing(at_m: [f64; 3], yaw_rad: f64) -> Result<RigidTransform> {
    Ok(RigidTransform::from_rotation_vector(
        [0.0, 0.0, yaw_rad],
        at_m,
    )?)
}

/// A camera that goes from sector to sector.
struct Walker<'a> {
    scene: &'a SceneData,
    sector: usize,
    /// Transforms from the first sector to this one, in their order.
    chain: Vec<Similarity>,
}

impl<'a> Walker<'a> {
    fn new(scene: &'a SceneData) -> Self {
        Self {
            scene,
            sector: 0,
            chain: Vec::new(),
        }
    }

    /// The frame at a pose in the frame of the first sector.
    fn go_to(&mut self, pose: &RigidTransform, is_pass: bool) -> Result<Step> {
        let chained = self
            .chain
            .iter()
            .fold(*pose, |pose, next| next.carry(&pose));
        let place = Place {
            sector: self.sector,
            sector_from_body: chained,
        };
        let next = self.scene.cross(&place);
        let is_change = next.sector != self.sector;
        if is_change {
            let edges = &self.scene.sectors[self.sector].edges;
            let edge = edges.iter().find(|edge| edge.to == next.sector);
            let edge = edge.context("no edge to the next sector")?;
            self.chain.push(edge.to_from_here);
            self.sector = next.sector;
            if self.sector == 0 {
                self.chain.clear();
            }
        }
        Ok(Step {
            sector: next.sector,
            sector_from_body: next.sector_from_body,
            is_change,
            is_pass,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use simulation::testing::SyntheticScene;

    #[test]
    fn each_pass_crosses_the_border_and_leads_back() {
        let scene = SyntheticScene::corridor_loop().unwrap().scene;
        let lap = around_loop(1, FRAME_M).unwrap();
        let plain = route(&scene, &lap, 0).unwrap();
        assert_eq!((plain.len(), changes(&plain)), (lap.len(), 3));
        let passing = route(&scene, &lap, 5).unwrap();
        assert!(changes(&passing) >= 3 + 3 * 2 * 5);
        let [last, of_passing] = [&plain, &passing].map(|steps| *steps.last().unwrap());
        assert_eq!(last.sector, of_passing.sector);
        let [a, b] = [last, of_passing].map(|step| step.sector_from_body.translation_m());
        assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-9));
    }
}
