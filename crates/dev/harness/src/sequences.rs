//! Sequences for odometry with ground truth: real recordings and simulated walks, with one
//! interface.
//!
//! Contract: a [`Sequence`] has its nominal rig, all IMU samples, and the true pose of the rig at
//! any time that it covers. Images come in frame sets, in order of time, a few in memory
//! simultaneously ([`Sequence::frame_sets`]). *Early*: IMU samples before the first set come with
//! it. *Late*: a set includes all samples up to the first one that is not older than the set and
//! its images, so that motion is known to the last image. *At a gap*: a camera without image is
//! `None`; a set without any image is returned all the same. *At the end*: IMU samples after the
//! last set are in [`Sequence::imu`] only. The same settings give the same bytes.
//!
//! - [`kitti`], [`euroc`]: the available real recordings.
//! - [`walk`]: simulated walks; rendering is slower than tracking, [`Sequence::cached`] renders
//!   once.
//! - [`named`]: walks that are used in several tests.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, Result, ensure};
use cad_transforms::RigidTransform;
use imaging::ImageView;
use odometry::ImuSample;
use odometry::input::{FrameSet, View};
use odometry::rig::Rig;

mod cache;
mod datasets;
pub mod named;
mod prerendered;
mod truth;
mod walk;

pub use self::datasets::{euroc, kitti};
pub use self::truth::Truth;
pub use self::walk::{WalkSettings, walk};

/// A sequence for odometry; see the module documentation.
#[derive(Clone, Debug)]
pub struct Sequence {
    name: String,
    rig: Rig,
    imu: Vec<Vec<ImuSample>>,
    truth: Truth,
    sets: Vec<PlannedSet>,
    images: ImageSource,
}

/// A set before its images are read.
#[derive(Clone, Debug, PartialEq)]
struct PlannedSet {
    time_ns: i64,
    /// Times of the images, one entry per camera.
    views: Vec<Option<i64>>,
}

/// Source of images.
#[derive(Clone, Debug)]
enum ImageSource {
    /// Left and right image files of each camera, in order.
    Files(Vec<Vec<[PathBuf; 2]>>),
    /// Rendered on demand.
    Rendered(walk::Walk),
    /// Rendered before.
    Cached(Vec<cache::CachedCamera>),
}

/// Reader of the images of one camera in order: left and right.
type Reader = Box<dyn FnMut() -> Result<[Vec<u8>; 2]> + Send>;

/// A frame set with its images.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnedFrameSet {
    /// Time of the set, ns.
    pub time_ns: i64,
    /// One entry for each camera of the rig.
    pub views: Vec<Option<OwnedView>>,
    /// Per IMU of the rig, the samples since the previous set.
    pub imu: Vec<Vec<ImuSample>>,
}

/// Stereo image of one camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OwnedView {
    /// Middle of the exposure of the middle row, ns.
    pub time_ns: i64,
    /// Columns of one eye.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Left eye, row-major, without gaps.
    pub left: Vec<u8>,
    /// Right eye.
    pub right: Vec<u8>,
}

impl OwnedFrameSet {
    /// Borrows the data for odometry.
    pub fn borrowed(&self) -> FrameSet<'_> {
        let views = self.views.iter();
        FrameSet {
            time_ns: self.time_ns,
            views: views.map(|v| v.as_ref().map(View::from)).collect(),
        }
    }
}

/// Borrows the data for odometry.
impl<'a> From<&'a OwnedView> for View<'a> {
    fn from(view: &'a OwnedView) -> Self {
        let gray = |pixels: &'a [u8]| {
            ImageView::new(view.width, view.height, view.width, pixels).expect("a complete image")
        };
        View {
            time_ns: view.time_ns,
            left: gray(&view.left),
            right: gray(&view.right),
            mask: None,
        }
    }
}

impl Sequence {
    /// Name for tables.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Nominal rig, which may differ from the true one.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// All samples of each IMU.
    pub fn imu(&self) -> &[Vec<ImuSample>] {
        &self.imu
    }

    /// Ground truth.
    pub fn truth(&self) -> &Truth {
        &self.truth
    }

    /// True `world_from_rig`; `None` outside the span of the ground truth.
    pub fn world_from_rig(&self, time_ns: i64) -> Option<RigidTransform> {
        self.truth.at(time_ns)
    }

    /// Times of the sets, ns.
    pub fn times(&self) -> impl ExactSizeIterator<Item = i64> + '_ {
        self.sets.iter().map(|set| set.time_ns)
    }

    /// Number of sets.
    pub fn len(&self) -> usize {
        self.sets.len()
    }

    /// Whether there are no sets.
    pub fn is_empty(&self) -> bool {
        self.sets.is_empty()
    }

    /// True poses at the times of all sets that the ground truth covers.
    pub fn truth_at_sets(&self) -> Vec<(i64, RigidTransform)> {
        let at = |time_ns: i64| Some((time_ns, self.truth.at(time_ns)?));
        self.times().filter_map(at).collect()
    }

    /// The first sets only.
    #[must_use]
    pub fn first(mut self, sets: usize) -> Self {
        self.sets.truncate(sets);
        self
    }

    /// The same with another nominal rig.
    #[must_use]
    pub fn with_nominal_rig(mut self, change: impl FnOnce(&mut Rig)) -> Self {
        change(&mut self.rig);
        self
    }

    /// The same with the images of a walk cached below a folder: those of its sets are rendered now
    /// on two threads unless they exist. Other sequences are unchanged.
    ///
    /// # Errors
    /// The folder cannot be written, or an existing file is not a complete file of this walk.
    pub fn cached(mut self, folder: &Path) -> Result<Self> {
        if let ImageSource::Rendered(walk) = &self.images {
            let stored = cache::store(walk, &self.pairs(), folder)
                .with_context(|| format!("caching the images of {}", self.name))?;
            self.images = ImageSource::Cached(stored);
        }
        Ok(self)
    }

    /// Stereo pairs of each camera.
    fn pairs(&self) -> Vec<usize> {
        let of = |camera: usize| {
            let views = self.sets.iter().map(|set| set.views[camera]);
            views.flatten().count()
        };
        (0..self.rig.cameras.len()).map(of).collect()
    }

    /// The same walk with existing images, from a sequence of it in which every camera has every
    /// frame. Device faults (dropped, late, frozen, torn) are applied to these; faults of light and
    /// lenses are not. Unlike in a real device, the exposure continues to adapt during a
    /// disconnection. Sequences other than uncached walks are unchanged.
    ///
    /// # Errors
    /// An image is absent.
    pub fn with_images(mut self, sets: &Arc<Vec<OwnedFrameSet>>) -> Result<Self> {
        if let ImageSource::Rendered(walk) = &mut self.images {
            let whole = |set: &OwnedFrameSet| {
                set.views.len() == self.rig.cameras.len() && set.views.iter().all(Option::is_some)
            };
            let found = sets.iter().take_while(|set| whole(set)).count();
            let expected = walk.simulation.settings().frame_count() as usize;
            ensure!(
                found >= expected,
                "replacing images: found {found} complete sets, expected {expected}"
            );
            walk.prerendered = Some(sets.clone());
        }
        Ok(self)
    }

    /// Reads or renders all sets, in order.
    ///
    /// # Errors
    /// Files that cannot be read. Each set has its own error.
    pub fn frame_sets(&self) -> Result<FrameSets<'_>> {
        let readers = match &self.images {
            ImageSource::Files(files) => files.iter().cloned().map(datasets::reader).collect(),
            ImageSource::Rendered(walk) => walk.readers(),
            ImageSource::Cached(stored) => {
                let readers = stored.iter().map(cache::CachedCamera::reader);
                readers.collect::<Result<_>>()?
            }
        };
        Ok(FrameSets {
            sequence: self,
            next: 0,
            readers,
            given: vec![0; self.imu.len()],
        })
    }

    /// Calls `each` with all sets, in order, until it fails.
    ///
    /// # Errors
    /// Those of [`Sequence::frame_sets`] and of `each`.
    pub fn for_each(&self, mut each: impl FnMut(OwnedFrameSet) -> Result<()>) -> Result<()> {
        self.frame_sets()?.try_for_each(|set| each(set?))
    }
}

/// The sets of a sequence. See [`Sequence::frame_sets`].
pub struct FrameSets<'a> {
    sequence: &'a Sequence,
    next: usize,
    readers: Vec<Reader>,
    /// Number of samples returned, per IMU.
    given: Vec<usize>,
}

impl Iterator for FrameSets<'_> {
    type Item = Result<OwnedFrameSet>;

    fn next(&mut self) -> Option<Self::Item> {
        let planned = self.sequence.sets.get(self.next)?;
        self.next += 1;
        Some(self.read(planned))
    }
}

impl FrameSets<'_> {
    fn read(&mut self, planned: &PlannedSet) -> Result<OwnedFrameSet> {
        let mut views = Vec::with_capacity(planned.views.len());
        for (camera, time_ns) in planned.views.iter().enumerate() {
            let Some(time_ns) = *time_ns else {
                views.push(None);
                continue;
            };
            let model = &self.sequence.rig.cameras[camera];
            let [left, right] = (self.readers[camera])()
                .with_context(|| format!("reading the images of {}", model.name))?;
            let (width, height) = (model.left.width as usize, model.left.height as usize);
            for (eye, pixels) in [("left", &left), ("right", &right)] {
                let (found, expected) = (pixels.len(), width * height);
                ensure!(
                    found == expected,
                    "the {eye} image of {} at {time_ns} ns has {found} pixels, expected {expected}",
                    model.name
                );
            }
            views.push(Some(OwnedView {
                time_ns,
                width,
                height,
                left,
                right,
            }));
        }
        let latest = planned.views.iter().flatten().copied();
        let latest = latest.fold(planned.time_ns, i64::max);
        let mut imu = Vec::with_capacity(self.given.len());
        for (samples, given) in self.sequence.imu.iter().zip(&mut self.given) {
            let older = samples.partition_point(|s| s.time_ns < latest);
            let until = (older + 1).min(samples.len()).max(*given);
            imu.push(samples[*given..until].to_vec());
            *given = until;
        }
        Ok(OwnedFrameSet {
            time_ns: planned.time_ns,
            views,
            imu,
        })
    }
}

#[cfg(test)]
mod tests;
