//! Ground truth of the images of one stereo camera.

use crate::camera::optics::Conditions;
use crate::camera::truth::{Flow, Pose, Truth, TruthCamera};
use crate::faults::CameraFaults;
use crate::rig::SimCamera;
use crate::scene::tag;
use crate::scene::wearer::{Part, ShoeTag};

use super::{Limb, Simulation, seconds};

/// Visibility samples along a side of a tag.
const SAMPLES_PER_SIDE: u32 = 9;
/// Extent of those samples relative to the tag size; 1 is the black square.
const SAMPLE_EXTENT: f64 = 1.0;

/// Ground truth of the images of one camera.
pub struct GroundTruth<'a> {
    simulation: &'a Simulation,
    camera: &'a SimCamera,
    faults: CameraFaults,
    limbs: Vec<Limb<'a>>,
    eyes: [TruthCamera; 2],
}

/// Observation of a shoe tag in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TagObservation {
    /// Id in the family 36h11.
    pub id: usize,
    /// Share of the tag that faces the camera, is inside the image and unoccluded.
    pub visible_share: f64,
    /// Corners of the black square: column and row, px, pixel centers at integers, in the order of
    /// [`tag::corners`].
    pub corners: [[f64; 2]; 4],
}

impl TagObservation {
    /// Whether the whole tag is visible.
    pub fn is_visible(&self) -> bool {
        self.visible_share == 1.0
    }
}

impl<'a> GroundTruth<'a> {
    pub(super) fn new(simulation: &'a Simulation, camera: usize) -> Self {
        let camera = &simulation.cameras[camera];
        Self {
            simulation,
            camera,
            faults: CameraFaults::default(),
            limbs: simulation.limbs(),
            eyes: [0, 1].map(|eye| TruthCamera::new(&camera.models[eye], camera.shutter)),
        }
    }

    /// The same for a camera with these faults; a shifted camera has another pose.
    #[must_use]
    pub fn with_faults(mut self, faults: CameraFaults) -> Self {
        self.faults = faults;
        self
    }

    /// Ground truth of the image of an eye (0 left, 1 right) at a time, ns.
    pub fn render(&mut self, eye: usize, time_ns: i64) -> Truth {
        let rotation = Conditions::of(&self.faults, seconds(time_ns)).rotation;
        let slip = self.camera.slip(&rotation);
        let pose = |t: f64| -> Pose {
            let rig = self.simulation.walker.rig(t);
            self.camera.world_from_eye(eye, &rig, slip.as_ref())
        };
        let placed = self.simulation.placed(&self.limbs);
        let taken_s = self.camera.taken_s(time_ns);
        self.eyes[eye].render(self.simulation.scene(), &placed, &pose, taken_s)
    }

    /// Optical flow from one image of an eye to another.
    pub fn flow(&self, eye: usize, from: &Truth, to: &Truth) -> Flow {
        let placed = self.simulation.placed(&self.limbs);
        self.eyes[eye].flow(self.simulation.scene(), &placed, from, to)
    }

    /// The shoe tags in front of an eye, wherever the lens model is defined, including those
    /// outside the image.
    pub fn tags(&self, eye: usize, truth: &Truth) -> Vec<TagObservation> {
        let tags = self.simulation.scene().wearer.tags.iter();
        tags.enumerate()
            .filter_map(|(index, tag)| self.tag(eye, truth, index, tag))
            .collect()
    }

    fn tag(
        &self,
        eye: usize,
        truth: &Truth,
        index: usize,
        tag: &ShoeTag,
    ) -> Option<TagObservation> {
        let scene = self.simulation.scene();
        let placed = self.simulation.placed(&self.limbs);
        let limb = self.limbs.iter().position(|l| l.part == Part::Tag(index))?;
        // The limbs are the last bodies.
        let body = placed.len() - self.limbs.len() + limb;
        let project = |x: f64, y: f64| {
            let point = nalgebra::Vector3::new(x, y, 0.0);
            self.eyes[eye].project(scene, &placed, truth, body, point)
        };
        let mut corners = [[0.0; 2]; 4];
        for (to, corner) in corners.iter_mut().zip(tag::corners(tag.size_m)) {
            let found = project(corner.x, corner.y)?;
            *to = [found.u, found.v];
        }
        let [a, b, c, _] = corners;
        // Rows grow downwards: a print seen from its front, counter-clockwise, has this sign.
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        let at = |k: u32| {
            (f64::from(k) / f64::from(SAMPLES_PER_SIDE - 1) - 0.5) * tag.size_m * SAMPLE_EXTENT
        };
        let shown = |k: &u32| {
            project(at(k % SAMPLES_PER_SIDE), at(k / SAMPLES_PER_SIDE))
                .is_some_and(|point| point.shown)
        };
        let samples = SAMPLES_PER_SIDE * SAMPLES_PER_SIDE;
        let visible = match area < 0.0 {
            true => (0..samples).filter(shown).count(),
            false => 0,
        };
        Some(TagObservation {
            id: tag.id,
            visible_share: visible as f64 / f64::from(samples),
            corners,
        })
    }
}
