//! An agent that a page drives, and the film of what it saw.

use std::collections::VecDeque;

use anyhow::Result;
use charts::FilmFrame;

use super::server::{Control, Session, View};
use crate::commands::film::{self, STEPS_PER_IMAGE};
use crate::commands::walk::Walk;

/// Images that a film has at most; the oldest ones leave. 15 MB or so.
const MAX_IMAGES: usize = 1200;

/// An agent that a page drives.
pub(super) struct Drive {
    walk: Walk,
    /// Whether the next view is that of a start.
    is_start: bool,
    /// Start of the episode on the map, px.
    start_px: [f64; 2],
    /// Steps since the first start.
    steps: u64,
    frames: VecDeque<FilmFrame>,
}

impl Drive {
    pub(super) fn new(walk: Walk) -> Self {
        Self {
            walk,
            is_start: true,
            start_px: [0.0; 2],
            steps: 0,
            frames: VecDeque::new(),
        }
    }

    fn advance(&mut self, control: &Control) -> Result<()> {
        if control.reset {
            self.walk.reset()?;
            self.is_start = true;
        } else if control.wearer {
            self.is_start = self.walk.follow_wearer()?;
        } else if !self.is_start {
            let action = match control.autopilot {
                true => self.walk.guide(),
                false => [control.forward, control.turn],
            };
            let ends = self.walk.ends();
            self.walk.step(action)?;
            self.is_start = self.walk.ends() > ends;
        }
        Ok(())
    }
}

impl Session for Drive {
    fn step(&mut self, control: Control) -> Result<View> {
        self.advance(&control)?;
        let frame = film::frame(&mut self.walk)?;
        if self.is_start {
            self.start_px = frame.map_px;
        }
        let view = View {
            jpeg_base64: frame.jpeg_base64.clone(),
            map_px: frame.map_px,
            heading_rad: frame.heading_rad,
            start_px: self.start_px,
            goal_px: self.walk.goal_px().filter(|_| control.autopilot),
            caption: frame.caption.clone(),
            is_start: std::mem::take(&mut self.is_start),
            step_s: self.walk.step_s(),
        };
        if self.steps.is_multiple_of(u64::from(STEPS_PER_IMAGE)) {
            self.frames.push_back(frame);
            if self.frames.len() > MAX_IMAGES {
                self.frames.pop_front();
            }
        }
        self.steps += 1;
        Ok(view)
    }

    fn film(&self) -> Result<String> {
        let summary = film::summary(&self.walk, self.steps as f64 * self.walk.step_s());
        let frames = self.frames.iter().cloned().collect();
        Ok(film::page(&film::scene_film(&summary, &self.walk, frames)?))
    }
}

#[cfg(test)]
mod tests {
    use simulation::testing::SyntheticScene;

    use super::*;

    #[test]
    fn the_agent_follows_the_recorded_wearer_and_drives_on_from_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("room.scene");
        let room = SyntheticScene::room().unwrap();
        room.write_bundle(&path).unwrap();
        let mut drive = Drive::new(Walk::open(&path, 0, 0.0).unwrap());
        let wearer = Control {
            wearer: true,
            ..Control::default()
        };
        let trajectory = room.scene.sectors[0].recording.trajectory.as_ref();
        let poses = trajectory.unwrap().poses();
        // 10 Hz, as the steps; after the last pose the walk begins again.
        for (step, pose) in poses.iter().chain(&poses[..3]).enumerate() {
            let view = drive.step(wearer).unwrap();
            let [x, y, _] = pose.world_from_rig.translation_m();
            let expected = drive.walk.map.px([x, y]);
            let off = (view.map_px[0] - expected[0]).hypot(view.map_px[1] - expected[1]);
            assert!(off < 1e-6, "step {step}: {off} px");
            assert_eq!(view.is_start, step % poses.len() == 0);
            assert!(
                view.caption.starts_with("the wearer at "),
                "{}",
                view.caption
            );
        }
        let before = drive.walk.state().position_m;
        let view = drive.step(Control {
            forward: 1.0,
            ..Control::default()
        });
        assert!(view.unwrap().caption.contains("m walked"));
        let after = drive.walk.state().position_m;
        let moved_m = (after[0] - before[0]).hypot(after[1] - before[1]);
        assert!(moved_m > 0.0 && moved_m < 0.2, "{moved_m}");
    }
}
