//! A hand-off, opened for reading.
//!
//! Contract. *Opening* checks the seal, the verdict and every byte that was sealed, and refuses a
//! session that is missing, failed its validation without being accepted, was edited or changed
//! ([`InputError`]); [`Input::notes`] lists what was accepted. *Early to late*: frame sets come in
//! order of time, frames in order of their numbers, each decoded once, cameras side by side on
//! threads; memory is about one GOP per camera. Random access by number or time decodes from the
//! preceding key frame. Both give the same frames. *At a gap*: a camera that has no frame in a set
//! is `None`; no image or sample is interpolated, repeated or shifted. *At the end*: frames in no
//! set come only by [`Input::frames`], samples after the last set only by [`Input::imu`] and
//! [`Input::imu_batches`]. *On failure*: an item that cannot be read is a [`ReadError`] that names
//! it, and reading continues after it.
//!
//! Bytes are checked once more as they are read, against the checksums of the sealed index.

use std::ops::{Range, RangeBounds};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::{io, thread};

use session_archive::handoff::HandOff;
use session_archive::index::{Access, Index};
use session_archive::manifest::Manifest;
use session_archive::record::{CameraCalibration, ClockMap, FrameTransform};
use session_archive::time::HostTime;

mod camera;
mod error;
mod imu;
mod judgement;
mod luma_frame_sets;
mod open;
mod sequence;
mod state;

pub use camera::View;
pub use error::{FrameFault, ImuFault, InputError, ReadError};
pub use imu::ImuSample;
pub use luma_frame_sets::{LumaFrameSet, LumaFrameSets};
pub use sequence::{Frames, Sets};
pub use session_archive::handoff::Check;

use camera::{Camera, GopReader};
use imu::BatchTimes;
use state::State;

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

/// A hand-off that was accepted.
#[derive(Debug)]
pub struct Input {
    root: PathBuf,
    handoff: HandOff,
    notes: Vec<String>,
    manifest: Manifest,
    state: State,
    shared: Arc<Shared>,
    /// For random access, one for each camera; each holds the GOP decoded last.
    readers: Vec<Mutex<GopReader>>,
}

/// What the decoding threads need.
struct Shared {
    index: Index,
    access: Access,
    cameras: Vec<Camera>,
    batch_times: Vec<BatchTimes>,
    threads_per_camera: u32,
}

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Shared")
            .field("session_id", &self.index.session_id)
            .finish_non_exhaustive()
    }
}

impl Input {
    /// Opens the hand-off in a session's folder after checking every byte of it. `path` is the
    /// folder or the `handoff.json` in it.
    ///
    /// # Errors
    /// See [`InputError`].
    pub fn open(path: &Path) -> Result<Self, InputError> {
        Self::open_with(path, Check::Content, |_, _| {})
    }

    /// The session's folder; the rig's files are in it.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The hand-off: sealed files, program, verdict.
    pub fn handoff(&self) -> &HandOff {
        &self.handoff
    }

    /// The session's manifest: cameras and IMUs in the order that everything here follows.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Index: numbers and times of all frames, IMU batches and frame sets.
    pub fn index(&self) -> &Index {
        &self.shared.index
    }

    /// The access units of the frames in the index, as they were recorded.
    pub(crate) fn access(&self) -> &Access {
        &self.shared.access
    }

    /// Calibration of one side, as in `feet/left`; `None` if the session has none.
    pub fn calibration(&self, eye: &str) -> Option<&CameraCalibration> {
        self.state.calibrations.get(eye)
    }

    /// Recorded extrinsics, each `parent_from_child`; empty if the session has none.
    pub fn transforms(&self) -> &[FrameTransform] {
        &self.state.transforms
    }

    /// How the ticks of a device clock, as in `feet` or `feet/imu`, became times: maps by rising
    /// version, the newest last. Of versions that were replaced between two segments only one is
    /// here.
    pub fn clock_maps(&self, clock: &str) -> &[ClockMap] {
        self.state.clock_maps.get(clock).map_or(&[], Vec::as_slice)
    }

    /// All frame sets, in order of time.
    ///
    /// # Errors
    /// [`ReadError::Thread`].
    pub fn sets(&self) -> Result<Sets, ReadError> {
        self.sets_in(..)
    }

    /// The frame sets with a time in `times`, in order.
    ///
    /// # Errors
    /// [`ReadError::Thread`].
    pub fn sets_in(&self, times: impl RangeBounds<HostTime>) -> Result<Sets, ReadError> {
        Sets::start(self.shared.clone(), self.positions_of(times))
    }

    /// Positions of the sets with a time in `times`.
    fn positions_of(&self, times: impl RangeBounds<HostTime>) -> Range<usize> {
        let sets = &self.shared.index.sets;
        let start = sets.partition_point(|s| is_before(HostTime(s.time_ns), &times));
        let length = sets[start..].partition_point(|s| times.contains(&HostTime(s.time_ns)));
        start..start + length
    }

    /// The frame sets with a time in `times`, in order, for motion estimation: luma images, IMU
    /// samples up to the last image of each set, and losses along with each set.
    ///
    /// # Errors
    /// [`ReadError::Thread`].
    pub fn luma_frame_sets(
        &self,
        times: impl RangeBounds<HostTime>,
    ) -> Result<LumaFrameSets, ReadError> {
        LumaFrameSets::start(self.shared.clone(), self.positions_of(times))
    }

    /// The frame set with this number.
    ///
    /// # Errors
    /// Something in it cannot be read.
    pub fn set(&self, number: u64) -> Result<Option<FrameSet>, ReadError> {
        let found = self.shared.index.set(number);
        found
            .map(|position| self.set_at_position(position))
            .transpose()
    }

    /// The frame set nearest to a time, the earlier one of two; `None` if there are no sets.
    ///
    /// # Errors
    /// Something in it cannot be read.
    pub fn set_at(&self, time: HostTime) -> Result<Option<FrameSet>, ReadError> {
        let nearest = self.shared.index.set_at(time);
        nearest
            .map(|position| self.set_at_position(position))
            .transpose()
    }

    /// One frame of one camera, whether or not it is in a set; `None` if the session has none of
    /// this number that can be decoded.
    ///
    /// # Errors
    /// [`ReadError::NoSuch`], or it cannot be read.
    pub fn frame(&self, camera: &str, number: u64) -> Result<Option<View>, ReadError> {
        let camera = self.camera(camera)?;
        let position = self.shared.index.cameras[camera].position(number);
        position
            .map(|position| self.view(camera, position))
            .transpose()
    }

    /// All frames of one camera in order of their numbers, whether or not they are in a set.
    ///
    /// # Errors
    /// [`ReadError::NoSuch`], [`ReadError::Thread`].
    pub fn frames(&self, camera: &str) -> Result<Frames, ReadError> {
        self.frames_where(camera, |_| true)
    }

    /// As [`Self::frames`], restricted to positions of the camera's index that `keep` accepts. GOPs
    /// without any are not decoded.
    ///
    /// # Errors
    /// [`ReadError::NoSuch`], [`ReadError::Thread`].
    pub fn frames_where(
        &self,
        camera: &str,
        mut keep: impl FnMut(usize) -> bool,
    ) -> Result<Frames, ReadError> {
        let camera = self.camera(camera)?;
        let positions = self.positions_where(camera, &mut keep);
        Frames::start(self.shared.clone(), camera, positions)
    }

    /// As [`Self::frames_where`], with luma images, whatever the camera delivers.
    ///
    /// # Errors
    /// [`ReadError::NoSuch`], [`ReadError::Thread`].
    pub fn luma_frames_where(
        &self,
        camera: &str,
        mut keep: impl FnMut(usize) -> bool,
    ) -> Result<Frames, ReadError> {
        let camera = self.camera(camera)?;
        let positions = self.positions_where(camera, &mut keep);
        Frames::start_luma(self.shared.clone(), camera, positions)
    }

    fn positions_where(&self, camera: usize, keep: &mut dyn FnMut(usize) -> bool) -> Arc<[usize]> {
        let all = 0..self.shared.index.cameras[camera].frames.len();
        all.filter(|&position| keep(position)).collect()
    }

    /// The samples of one IMU with a time in `times`, in the order of their numbers. They are all
    /// in memory simultaneously.
    ///
    /// # Errors
    /// [`ReadError::NoSuch`], or one of the batches cannot be read.
    pub fn imu(
        &self,
        imu: &str,
        times: impl RangeBounds<HostTime>,
    ) -> Result<Vec<ImuSample>, ReadError> {
        self.shared.imu(self.imu_position(imu)?, times)
    }

    /// All samples of one IMU, batch by batch, in the order of their numbers.
    ///
    /// # Errors
    /// [`ReadError::NoSuch`]; of an item: that batch cannot be read.
    pub fn imu_batches(
        &self,
        imu: &str,
    ) -> Result<impl Iterator<Item = Result<Vec<ImuSample>, ReadError>> + '_, ReadError> {
        let imu = &self.shared.index.imus[self.imu_position(imu)?];
        let read = |batch| imu::samples(&imu.name, &self.shared.access, batch);
        Ok(imu.batches.iter().map(read))
    }

    fn camera(&self, name: &str) -> Result<usize, ReadError> {
        let mut cameras = self.shared.cameras.iter();
        let found = cameras.position(|c| *c.name == *name);
        found.ok_or_else(|| ReadError::NoSuch(name.to_owned()))
    }

    fn imu_position(&self, name: &str) -> Result<usize, ReadError> {
        let found = self.shared.index.imus.iter().position(|i| i.name == name);
        found.ok_or_else(|| ReadError::NoSuch(name.to_owned()))
    }

    fn view(&self, camera: usize, position: usize) -> Result<View, ReadError> {
        // A reader is valid after a panic.
        let mut reader = self.readers[camera]
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        reader.view(position)
    }

    /// A set by random access, its cameras side by side.
    fn set_at_position(&self, position: usize) -> Result<FrameSet, ReadError> {
        let members = &self.shared.index.sets[position].frames;
        let views = thread::scope(|scope| {
            let mut threads = Vec::new();
            for (camera, member) in members.iter().enumerate() {
                let view = move || member.map(|p| self.view(camera, p as usize)).transpose();
                threads.push(thread::Builder::new().spawn_scoped(scope, view));
            }
            let view = |thread: io::Result<thread::ScopedJoinHandle<'_, _>>| match thread {
                Ok(thread) => thread
                    .join()
                    .unwrap_or_else(|e| std::panic::resume_unwind(e)),
                Err(error) => Err(ReadError::Thread(Arc::new(error))),
            };
            threads.into_iter().map(view).collect()
        });
        self.shared.set(position, views)
    }
}

impl Shared {
    /// A set from its views, with the IMU samples since the previous set.
    fn set(
        &self,
        position: usize,
        views: Vec<Result<Option<View>, ReadError>>,
    ) -> Result<FrameSet, ReadError> {
        use std::ops::Bound::{Excluded, Included, Unbounded};
        let set = &self.index.sets[position];
        let before = position
            .checked_sub(1)
            .map(|p| HostTime(self.index.sets[p].time_ns));
        let times = (
            before.map_or(Unbounded, Excluded),
            Included(HostTime(set.time_ns)),
        );
        let imus = 0..self.index.imus.len();
        Ok(FrameSet {
            number: set.number,
            time: HostTime(set.time_ns),
            views: views.into_iter().collect::<Result<_, _>>()?,
            imu: imus
                .map(|imu| self.imu(imu, times))
                .collect::<Result<_, _>>()?,
        })
    }

    fn imu(
        &self,
        imu: usize,
        times: impl RangeBounds<HostTime>,
    ) -> Result<Vec<ImuSample>, ReadError> {
        let candidates = self.batch_times[imu].candidates(&times);
        let imu = &self.index.imus[imu];
        let mut samples = Vec::new();
        for batch in &imu.batches[candidates] {
            let batch = imu::samples(&imu.name, &self.access, batch)?;
            samples.extend(batch.into_iter().filter(|s| times.contains(&s.time)));
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
