//! Frame sets for motion estimation.
//!
//! Contract: as [`Sets`](super::Sets), except that images are luma only, that an image or IMU batch
//! that cannot be read is reported once along with the set ([`LumaFrameSet::losses`]), and that
//! samples of an IMU are returned up to the first one that is not older than the set and its
//! images, each once, in the order of their times. Samples after the last set are not returned.

use std::collections::BTreeMap;
use std::iter::FusedIterator;
use std::ops::Range;
use std::sync::Arc;

use session_archive::time::HostTime;

use super::content::Content;
use super::frame_reader::{StereoFrame, View};
use super::frames::{self, Frames};
use crate::error::ReadError;
use crate::imu::{ImuSample, sort_by_time};

/// Maximum time after a set in which its last sample is searched, ns.
const MAX_SAMPLE_DELAY_NS: i64 = 100_000_000;

/// See the module.
#[derive(Clone, Debug)]
pub struct LumaFrameSet {
    /// Number of the set.
    pub number: u64,
    /// Its time, host clock.
    pub time: HostTime,
    /// One for each camera, in the order of the manifest; `None` where the camera has no frame for
    /// this instant, or none that can be read.
    pub views: Vec<Option<View>>,
    /// The frames that `views` are the luma of.
    pub frames: Vec<Option<StereoFrame>>,
    /// One list for each IMU, in the order of the manifest.
    pub imu: Vec<Vec<ImuSample>>,
    /// Items up to this set that could not be read.
    pub losses: Vec<ReadError>,
}

/// Frame sets in order of time. See the module.
#[derive(Debug)]
pub struct LumaFrameSets {
    content: Arc<Content>,
    /// Positions of the sets still to come.
    sets: Range<usize>,
    /// One for each camera.
    cameras: Vec<Frames>,
    /// One for each IMU.
    imus: Vec<Samples>,
}

/// State of an IMU's samples.
#[derive(Debug, Default)]
struct Samples {
    /// Time of the newest sample returned, ns.
    given_ns: Option<i64>,
    /// Batches that may be needed again, by position; empty if one cannot be read.
    batches: BTreeMap<usize, Vec<ImuSample>>,
}

impl LumaFrameSets {
    /// The sets at these positions of the index, all of which must exist.
    pub(crate) fn start(content: Arc<Content>, sets: Range<usize>) -> Result<Self, ReadError> {
        let cameras = (0..content.cameras.len()).map(|camera| {
            let positions = frames::members(&content, sets.clone(), camera);
            Frames::start_luma(content.clone(), camera, positions)
        });
        let before_first = sets.start.checked_sub(1);
        let given_ns = before_first.map(|before| content.index.sets[before].time_ns);
        let imus = (content.index.imus.iter()).map(|_| Samples {
            given_ns,
            batches: BTreeMap::new(),
        });
        Ok(Self {
            cameras: cameras.collect::<Result<_, _>>()?,
            imus: imus.collect(),
            content,
            sets,
        })
    }
}

impl Iterator for LumaFrameSets {
    type Item = LumaFrameSet;

    fn next(&mut self) -> Option<LumaFrameSet> {
        let position = self.sets.next()?;
        let content = &self.content;
        let set = &content.index.sets[position];
        let mut losses = Vec::new();
        let (mut frames, mut views) = (Vec::new(), Vec::new());
        for (member, camera) in set.frames.iter().zip(&mut self.cameras) {
            let decoded = member.and_then(|_| camera.next_frame_and_view());
            let (frame, view) = match decoded {
                Some(Ok((frame, view))) => (Some(frame), Some(view)),
                Some(Err(error)) => {
                    losses.push(error);
                    (None, None)
                }
                None => (None, None),
            };
            frames.push(frame);
            views.push(view);
        }
        let times = views.iter().flatten().map(|view| view.time.0);
        let latest_ns = times.fold(set.time_ns, i64::max);
        let imus = self.imus.iter_mut().enumerate();
        let imu = imus.map(|(imu, samples)| samples.up_to(latest_ns, content, imu, &mut losses));
        Some(LumaFrameSet {
            number: set.number,
            time: HostTime(set.time_ns),
            imu: imu.collect(),
            views,
            frames,
            losses,
        })
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.sets.size_hint()
    }
}

impl ExactSizeIterator for LumaFrameSets {}
impl FusedIterator for LumaFrameSets {}

impl Samples {
    /// Samples not returned yet, up to the first one that is not older than a time.
    fn up_to(
        &mut self,
        latest_ns: i64,
        content: &Content,
        imu: usize,
        losses: &mut Vec<ReadError>,
    ) -> Vec<ImuSample> {
        let from = self
            .given_ns
            .map_or(i64::MIN, |given| given.saturating_add(1));
        let to = latest_ns.saturating_add(MAX_SAMPLE_DELAY_NS);
        let candidates = content.batch_times[imu].candidates(&(HostTime(from)..=HostTime(to)));
        self.batches = self.batches.split_off(&candidates.start);
        let entry = &content.index.imus[imu];
        let mut found = Vec::new();
        for position in candidates {
            let batch = self.batches.entry(position).or_insert_with(|| {
                let read = content.batch(imu, &entry.batches[position]);
                read.unwrap_or_else(|error| {
                    losses.push(error);
                    Vec::new()
                })
            });
            found.extend(batch.iter().filter(|s| (from..=to).contains(&s.time_ns)));
        }
        sort_by_time(&mut found);
        let older = found.partition_point(|s| s.time_ns < latest_ns);
        found.truncate(older + 1);
        self.given_ns = found.last().map(|s| s.time_ns).or(self.given_ns);
        found
    }
}
