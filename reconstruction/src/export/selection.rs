//! Selection of the part of a hand-off to write.

use std::num::NonZeroU64;

use session_archive::time::HostTime;

use crate::input::Input;

/// Selection of frames and samples.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection {
    /// Images of frame sets whose number is a multiple of this, and of frames in no set whose own
    /// number is.
    pub every: NonZeroU64,
    /// Nothing before this time after the start of recording, ns.
    pub from_ns: Option<i64>,
    /// Nothing at this time after the start of recording, or later, ns.
    pub to_ns: Option<i64>,
}

impl Default for Selection {
    /// Everything.
    fn default() -> Self {
        Self {
            every: NonZeroU64::MIN,
            from_ns: None,
            to_ns: None,
        }
    }
}

impl Selection {
    /// Whether everything in the hand-off is selected.
    pub fn is_everything(&self) -> bool {
        *self == Self::default()
    }

    /// Whether the span holds a time.
    pub(super) fn holds(&self, input: &Input, time: HostTime) -> bool {
        let since_start = time - input.manifest().started;
        self.from_ns.is_none_or(|from| since_start >= from)
            && self.to_ns.is_none_or(|to| since_start < to)
    }

    /// For each frame of a camera: its set, and whether it is selected.
    pub(super) fn of_camera(&self, input: &Input, camera: usize) -> Vec<(Option<u64>, bool)> {
        let frames = &input.index().cameras[camera].frames;
        let mut sets = vec![None; frames.len()];
        for set in &input.index().sets {
            if let Some(position) = set.frames[camera] {
                sets[position as usize] = Some(set.number);
            }
        }
        let selected = frames.iter().zip(sets).map(|(frame, set)| {
            let counted = set.unwrap_or(frame.number).is_multiple_of(self.every.get());
            (set, counted && self.holds(input, HostTime(frame.time_ns)))
        });
        selected.collect()
    }
}
