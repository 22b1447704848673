//! Faults of the device on frames that were rendered before.

use std::sync::Arc;

use anyhow::Result;
use rig_sim::device::{Delivery, Device};
use rig_sim::faults::Faults;
use rig_sim::simulation::{FrameSource, Simulation, StereoFrame};

use super::walks;

/// Frames of a walk as its camera delivers them with faults, each once.
///
/// # Errors
/// The rig has no such camera.
pub(super) fn delivered(
    simulation: &Arc<Simulation>,
    frames: &[Arc<StereoFrame>],
    faults: &Faults,
) -> Result<Vec<Arc<StereoFrame>>> {
    let [Some(first), Some(last)] = [frames.first(), frames.last()] else {
        return Ok(Vec::new());
    };
    let (first, last) = (first.number, last.number);
    let source = Box::new(FrameStore(frames.to_vec()));
    let camera = walks::position(simulation)?;
    let mut device = Device::new(simulation, camera, faults.of(walks::CAMERA), source);
    let mut delivered: Vec<Arc<StereoFrame>> = Vec::new();
    while let Some(delivery) = device.deliver() {
        let Delivery::Frame(frame) = delivery else {
            continue;
        };
        if frame.index > last {
            break;
        }
        if frame.index >= first {
            delivered.push(Arc::new(frame.image));
        }
    }
    Ok(delivered)
}

/// Frames that were rendered before; the first and the last one stand for those outside of them.
struct FrameStore(Vec<Arc<StereoFrame>>);

impl FrameSource for FrameStore {
    fn render_frame(&mut self, number: u64, _: i64) -> StereoFrame {
        let first = self.0[0].number;
        let at = number.saturating_sub(first) as usize;
        let frame = &self.0[at.min(self.0.len() - 1)];
        StereoFrame::clone(frame)
    }
}
