//! An indexed session, opened for reading.
//!
//! Contract. *Opening* checks that everything the index refers to exists. *Early to late*: frame
//! sets come in order of time, frames in order of their numbers, each decoded once, cameras side by
//! side on threads; memory is about one GOP per camera. Random access by number or time decodes
//! from the preceding key frame. Both give the same frames. *At a gap*: a camera that has no frame
//! in a set is `None`; no image or sample is interpolated, repeated or shifted. *At the end*:
//! frames in no set come only by [`Session::frames`], samples after the last set only by
//! [`Session::imu`] and [`Session::imu_batches`]. *On failure*: an item that cannot be read is a
//! [`ReadError`] that names it, and reading continues after it.
//!
//! Bytes are checked as they are read, against the checksums of the index.

use std::ops::RangeBounds;
use std::sync::{Arc, Mutex, PoisonError};
use std::{fs, io, thread};

use session_archive::index::{Access, Index};
use session_archive::manifest::Manifest;
use session_archive::storage::Storage;
use session_archive::time::HostTime;

mod camera_format;
mod content;
mod frame_reader;
mod frame_sets;
mod frames;
mod kept_frames;
mod luma_frame_sets;

pub use frame_reader::{StereoFrame, View};
pub use frame_sets::{FrameSet, Sets};
pub use frames::Frames;
pub use luma_frame_sets::{LumaFrameSet, LumaFrameSets};

use content::Content;
use frame_reader::FrameReader;

use crate::error::{ReadError, SessionError};
use crate::imu::ImuSample;

/// See the module.
#[derive(Debug)]
pub struct Session {
    content: Arc<Content>,
    /// For random access, one for each camera; each holds the GOP decoded last.
    readers: Vec<Mutex<FrameReader>>,
}

impl Session {
    /// Opens the segments of a session.
    ///
    /// # Errors
    /// See [`SessionError`].
    pub fn open(
        storage: &dyn Storage,
        manifest: &Manifest,
        index: Index,
    ) -> Result<Self, SessionError> {
        let content = Arc::new(Content::open(storage, manifest, index)?);
        let readers = (0..content.cameras.len())
            .map(|camera| Mutex::new(FrameReader::new(content.clone(), camera)));
        Ok(Self {
            readers: readers.collect(),
            content,
        })
    }

    /// Index: numbers and times of all frames, IMU batches and frame sets.
    pub fn index(&self) -> &Index {
        &self.content.index
    }

    /// The access units of the frames in the index, as they were recorded.
    pub fn access(&self) -> &Access {
        &self.content.access
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
        Sets::start(self.content.clone(), self.content.sets_in(times))
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
        LumaFrameSets::start(self.content.clone(), self.content.sets_in(times))
    }

    /// The frame set with this number.
    ///
    /// # Errors
    /// Something in it cannot be read.
    pub fn set(&self, number: u64) -> Result<Option<FrameSet>, ReadError> {
        let found = self.content.index.set(number);
        found
            .map(|position| self.set_at_position(position))
            .transpose()
    }

    /// The frame set nearest to a time, the earlier one of two; `None` if there are no sets.
    ///
    /// # Errors
    /// Something in it cannot be read.
    pub fn set_at(&self, time: HostTime) -> Result<Option<FrameSet>, ReadError> {
        let nearest = self.content.index.set_at(time);
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
        let position = self.content.index.cameras[camera].position(number);
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
        Frames::start(self.content.clone(), camera, positions)
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
        Frames::start_luma(self.content.clone(), camera, positions)
    }

    fn positions_where(&self, camera: usize, keep: &mut dyn FnMut(usize) -> bool) -> Arc<[usize]> {
        let all = 0..self.content.index.cameras[camera].frames.len();
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
        self.content.imu(self.imu_position(imu)?, times)
    }

    /// All samples of one IMU, batch by batch, in the order of their numbers.
    ///
    /// # Errors
    /// [`ReadError::NoSuch`]; of an item: that batch cannot be read.
    pub fn imu_batches(
        &self,
        imu: &str,
    ) -> Result<impl Iterator<Item = Result<Vec<ImuSample>, ReadError>> + '_, ReadError> {
        let imu = self.imu_position(imu)?;
        let batches = self.content.index.imus[imu].batches.iter();
        Ok(batches.map(move |batch| self.content.batch(imu, batch)))
    }

    /// Lets [`Self::keep`] store frames in a file of at most `max_bytes`, which all readers then
    /// take them from. The file should have no name, so that it ends with the process.
    pub fn keep_frames_in(&self, file: fs::File, max_bytes: u64) {
        self.content.kept_frames.start(file, max_bytes);
    }

    /// Keeps a frame that will probably be read again, so that it is not decoded again. Does
    /// nothing without a file, above its limit, or if writing fails.
    pub fn keep(&self, frame: &StereoFrame) {
        let StereoFrame {
            camera,
            position,
            image,
        } = frame;
        self.content.kept_frames.keep(*camera, *position, image);
    }

    fn camera(&self, name: &str) -> Result<usize, ReadError> {
        let mut cameras = self.content.cameras.iter();
        let found = cameras.position(|c| *c.name == *name);
        found.ok_or_else(|| ReadError::NoSuch(name.to_owned()))
    }

    fn imu_position(&self, name: &str) -> Result<usize, ReadError> {
        let mut imus = self.content.index.imus.iter();
        let found = imus.position(|i| i.name == name);
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
        let members = &self.content.index.sets[position].frames;
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
        FrameSet::of(&self.content, position, views)
    }
}
