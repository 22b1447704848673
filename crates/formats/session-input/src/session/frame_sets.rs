//! Frame sets in order, each GOP decoded once; see [`Frames`].

use std::iter::FusedIterator;
use std::ops::Bound::{Excluded, Included, Unbounded};
use std::ops::Range;
use std::sync::Arc;

use session_archive::time::HostTime;

use super::content::Content;
use super::frame_reader::View;
use super::frames::{self, Frames};
use crate::error::ReadError;
use crate::imu::ImuSample;

/// The frames of all cameras that belong to one instant, with the IMU samples since the previous
/// set.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameSet {
    /// Number of the set.
    pub number: u64,
    /// Its time, host clock.
    pub time: HostTime,
    /// One for each camera, in the order of the manifest; `None` where the camera has no frame for
    /// this instant, or none that can be decoded.
    pub views: Vec<Option<View>>,
    /// One list for each IMU, in the order of the manifest: its samples after the set before, up to
    /// and with this one's time. The first set of a session has all before it.
    pub imu: Vec<Vec<ImuSample>>,
}

impl FrameSet {
    /// A set from its views, with the IMU samples since the previous set.
    pub(crate) fn of(
        content: &Content,
        position: usize,
        views: Vec<Result<Option<View>, ReadError>>,
    ) -> Result<Self, ReadError> {
        let set = &content.index.sets[position];
        let before = position
            .checked_sub(1)
            .map(|p| HostTime(content.index.sets[p].time_ns));
        let times = (
            before.map_or(Unbounded, Excluded),
            Included(HostTime(set.time_ns)),
        );
        let imus = 0..content.index.imus.len();
        Ok(Self {
            number: set.number,
            time: HostTime(set.time_ns),
            views: views.into_iter().collect::<Result<_, _>>()?,
            imu: imus
                .map(|imu| content.imu(imu, times))
                .collect::<Result<_, _>>()?,
        })
    }
}

/// Frame sets in order of time. A set with a frame or an IMU batch that cannot be read is an error,
/// and the next one follows.
#[derive(Debug)]
pub struct Sets {
    content: Arc<Content>,
    /// Positions of the sets still to come.
    sets: Range<usize>,
    /// One for each camera.
    cameras: Vec<Frames>,
}

impl Sets {
    /// The sets at these positions of the index, all of which must exist.
    pub(crate) fn start(content: Arc<Content>, sets: Range<usize>) -> Result<Self, ReadError> {
        let cameras = (0..content.cameras.len()).map(|camera| {
            let positions = frames::members(&content, sets.clone(), camera);
            Frames::start(content.clone(), camera, positions)
        });
        Ok(Self {
            cameras: cameras.collect::<Result<_, _>>()?,
            content,
            sets,
        })
    }
}

impl Iterator for Sets {
    type Item = Result<FrameSet, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        let position = self.sets.next()?;
        let members = &self.content.index.sets[position].frames;
        // Every camera advances by its member, also after one that fails.
        let views: Vec<_> = members
            .iter()
            .zip(&mut self.cameras)
            .map(|(member, frames)| member.and_then(|_| frames.next()).transpose())
            .collect();
        Some(FrameSet::of(&self.content, position, views))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.sets.size_hint()
    }
}

impl ExactSizeIterator for Sets {}
impl FusedIterator for Sets {}
