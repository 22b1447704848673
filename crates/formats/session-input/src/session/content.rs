//! What the decoding threads share: the index of a session and access to what it points to.

use std::ops::{Range, RangeBounds};
use std::sync::Arc;
use std::thread;

use session_archive::index::{Access, BatchEntry, Index, IndexError};
use session_archive::manifest::Manifest;
use session_archive::storage::Storage;
use session_archive::time::HostTime;

use super::camera_format::CameraFormat;
use super::kept_frames::KeptFrames;
use crate::error::{ImuFault, ReadError, SessionError};
use crate::imu::batch_times::BatchTimes;
use crate::imu::{self, ImuSample};

/// See the module.
pub(crate) struct Content {
    pub(crate) index: Index,
    pub(crate) access: Access,
    pub(crate) cameras: Vec<CameraFormat>,
    pub(crate) batch_times: Vec<BatchTimes>,
    pub(crate) threads_per_camera: u32,
    pub(crate) kept_frames: KeptFrames,
}

impl std::fmt::Debug for Content {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Content")
            .field("session_id", &self.index.session_id)
            .finish_non_exhaustive()
    }
}

impl Content {
    /// Opens the segments of a session after checking its index.
    pub(crate) fn open(
        storage: &dyn Storage,
        manifest: &Manifest,
        index: Index,
    ) -> Result<Self, SessionError> {
        check_index(&index, manifest)?;
        let access = Access::open(storage, &index).map_err(IndexError::from)?;
        let cameras = manifest.cameras.iter().map(CameraFormat::new);
        let cameras = cameras.collect::<Result<Vec<_>, _>>()?;
        let processors = thread::available_parallelism().map_or(1, usize::from);
        let batch_times = index.imus.iter().map(|i| BatchTimes::new(&i.batches));
        Ok(Self {
            batch_times: batch_times.collect(),
            threads_per_camera: (processors / cameras.len().max(1)).clamp(1, 16) as u32,
            kept_frames: KeptFrames::default(),
            index,
            access,
            cameras,
        })
    }

    /// Positions of the sets with a time in `times`.
    pub(crate) fn sets_in(&self, times: impl RangeBounds<HostTime>) -> Range<usize> {
        let sets = &self.index.sets;
        let start = sets.partition_point(|s| is_before(HostTime(s.time_ns), &times));
        let length = sets[start..].partition_point(|s| times.contains(&HostTime(s.time_ns)));
        start..start + length
    }

    /// The samples of one batch, in the order of their numbers.
    pub(crate) fn batch(
        &self,
        imu: usize,
        entry: &BatchEntry,
    ) -> Result<Vec<ImuSample>, ReadError> {
        let failed = |fault| ReadError::Imu {
            imu: self.index.imus[imu].name.clone(),
            first: entry.first_number,
            last: (entry.first_number).saturating_add(u64::from(entry.samples.max(1)) - 1),
            fault,
        };
        let batch = self.access.batch(entry);
        let batch = batch.map_err(|error| failed(ImuFault::Bytes(Arc::new(error))))?;
        imu::samples(&batch).map_err(|error| failed(error.into()))
    }

    /// The samples of an IMU with a time in `times`, in the order of their numbers.
    pub(crate) fn imu(
        &self,
        imu: usize,
        times: impl RangeBounds<HostTime>,
    ) -> Result<Vec<ImuSample>, ReadError> {
        let candidates = self.batch_times[imu].candidates(&times);
        let mut samples = Vec::new();
        for entry in &self.index.imus[imu].batches[candidates] {
            let batch = self.batch(imu, entry)?.into_iter();
            samples.extend(batch.filter(|s| times.contains(&HostTime(s.time_ns))));
        }
        Ok(samples)
    }
}

/// Whether a time is before the range.
fn is_before(time: HostTime, times: &impl RangeBounds<HostTime>) -> bool {
    match times.start_bound() {
        std::ops::Bound::Included(start) => time < *start,
        std::ops::Bound::Excluded(start) => time <= *start,
        std::ops::Bound::Unbounded => false,
    }
}

/// Checks that everything the index refers to exists, so that later accesses need no checks.
fn check_index(index: &Index, manifest: &Manifest) -> Result<(), IndexError> {
    let cameras = index.cameras.iter().map(|c| &c.name);
    let imus = index.imus.iter().map(|i| &i.name);
    let member_exists = |(camera, member): (usize, &Option<u32>)| {
        let frames = index.cameras[camera].frames.len();
        member.is_none_or(|position| (position as usize) < frames)
    };
    let fits = cameras.eq(manifest.cameras.iter().map(|c| &c.name))
        && imus.eq(manifest.imus.iter().map(|i| &i.name))
        && index.sets.iter().all(|set| {
            set.frames.len() == index.cameras.len()
                && set.frames.iter().enumerate().all(member_exists)
        })
        && index.cameras.iter().all(|camera| {
            let frames = &camera.frames;
            let keys_first = frames.iter().enumerate().all(|(position, frame)| {
                let key = frame.key as usize;
                key <= position && frames[key].key == frame.key
            });
            keys_first && frames.is_sorted_by_key(|frame| frame.key)
        });
    if fits {
        Ok(())
    } else {
        Err(IndexError::Stale(
            "it refers to items that the session does not have".to_owned(),
        ))
    }
}
