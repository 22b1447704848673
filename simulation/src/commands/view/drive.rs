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
