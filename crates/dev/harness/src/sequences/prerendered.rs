//! Existing images as a frame source for devices.

use std::sync::Arc;

use rig_sim::camera::sensor::Exposure;
use rig_sim::simulation::{FrameSource, StereoFrame};

use super::OwnedFrameSet;

/// The images of one camera, by frame number, without color.
#[derive(Clone, Debug)]
pub(super) struct PrerenderedFrames {
    pub(super) sets: Arc<Vec<OwnedFrameSet>>,
    pub(super) camera: usize,
}

impl FrameSource for PrerenderedFrames {
    fn render_frame(&mut self, number: u64, time_ns: i64) -> StereoFrame {
        let view = self.sets[number as usize].views[self.camera].as_ref();
        let view = view.expect("only complete sets are used");
        let rows = (view.left.chunks_exact(view.width)).zip(view.right.chunks_exact(view.width));
        let mut i420: Vec<u8> = rows.flat_map(|(l, r)| [l, r]).flatten().copied().collect();
        i420.resize(3 * view.width * view.height, 128);
        StereoFrame {
            number,
            time_ns,
            exposure: Exposure {
                seconds: 0.0,
                gain: 1.0,
            },
            width: 2 * view.width,
            height: view.height,
            i420,
        }
    }
}
