//! Frame sets of a hand-off, as input of the odometry.
//!
//! Contract: cameras and IMUs are those of the rig, in its order; others are left out. Images are
//! decoded a few at a time, whatever the length of the session. Items that cannot be read are
//! reported with the set.

use imaging::ImageView;
use odometry::ImuSample;
use odometry::input::{FrameSet, View};
use scene_bundle::outputs::rig::RigModel;
use session_input::{Image, LumaFrameSets, ReadError, StereoFrame};

use crate::input::Input;

/// A frame set of the rig with its images. See the module.
#[derive(Clone, Debug)]
pub struct RigFrameSet {
    /// Number of the set in the session.
    pub number: u64,
    /// Its time, ns.
    pub time_ns: i64,
    /// One for each camera of the rig.
    pub views: Vec<Option<session_input::View>>,
    /// The frames that they are the luma of.
    pub frames: Vec<Option<StereoFrame>>,
    /// Samples of each IMU of the rig since the previous set, up to the first one that is not older
    /// than the images.
    pub imu: Vec<Vec<ImuSample>>,
    /// Items that could not be read.
    pub losses: Vec<ReadError>,
}

impl RigFrameSet {
    /// The frames with their times, ns.
    pub(super) fn timed_frames(self) -> Vec<Option<(i64, StereoFrame)>> {
        let timed = self.frames.into_iter().zip(&self.views);
        let timed = timed.map(|(frame, view)| Some((view.as_ref()?.time.ns(), frame?)));
        timed.collect()
    }

    /// Borrowed view, as input of the odometry.
    pub fn borrowed(&self) -> FrameSet<'_> {
        FrameSet {
            time_ns: self.time_ns,
            views: (self.views.iter())
                .map(|v| v.as_ref().map(borrowed))
                .collect(),
        }
    }
}

fn borrowed(view: &session_input::View) -> View<'_> {
    View {
        time_ns: view.time.ns(),
        left: luma_view(&view.left),
        right: luma_view(&view.right),
        mask: None,
    }
}

fn luma_view(image: &Image) -> ImageView<'_> {
    let (width, height) = (image.width as usize, image.height as usize);
    ImageView::new(width, height, width, &image.data).expect("a decoded luma image is complete")
}

/// All frame sets of a hand-off, in order of time.
#[derive(Debug)]
pub struct FrameSetReader {
    sets: LumaFrameSets,
    /// Positions in the manifest of the rig's cameras and IMUs.
    cameras: Vec<usize>,
    imus: Vec<usize>,
}

impl FrameSetReader {
    /// Starts reading. Every camera and IMU of the rig must be one of the session, as those of the
    /// stage `rig` are.
    ///
    /// # Errors
    /// [`ReadError::NoSuch`], [`ReadError::Thread`].
    pub fn new(input: &Input, rig: &RigModel) -> Result<Self, ReadError> {
        let manifest = input.manifest();
        let camera = |name: &String| manifest.cameras.iter().position(|c| c.name == *name);
        let imu = |name: &String| manifest.imus.iter().position(|i| i.name == *name);
        let missing = |name: &String| ReadError::NoSuch(name.clone());
        let cameras = rig
            .cameras
            .iter()
            .map(|c| camera(&c.name).ok_or_else(|| missing(&c.name)));
        let imus = rig
            .imus
            .iter()
            .map(|i| imu(&i.name).ok_or_else(|| missing(&i.name)));
        Ok(Self {
            cameras: cameras.collect::<Result<_, _>>()?,
            imus: imus.collect::<Result<_, _>>()?,
            sets: input.session().luma_frame_sets(..)?,
        })
    }
}

impl Iterator for FrameSetReader {
    type Item = RigFrameSet;

    fn next(&mut self) -> Option<RigFrameSet> {
        let mut set = self.sets.next()?;
        let imus = self
            .imus
            .iter()
            .map(|k| set.imu[*k].iter().map(ImuSample::from).collect());
        Some(RigFrameSet {
            number: set.number,
            time_ns: set.time.ns(),
            imu: imus.collect(),
            views: self.cameras.iter().map(|k| set.views[*k].take()).collect(),
            frames: self.cameras.iter().map(|k| set.frames[*k].take()).collect(),
            losses: set.losses,
        })
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.sets.size_hint()
    }
}

impl ExactSizeIterator for FrameSetReader {}
