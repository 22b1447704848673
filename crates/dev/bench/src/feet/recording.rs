//! What the feet camera of a walk shows of the shoe tags, and the truth about it.
//!
//! Contract: images are rendered, or read from a folder in which an earlier run kept them
//! ([`images`]); tags are tracked in them in every run.

use std::path::Path;
use std::sync::Arc;

use super::ground::ground;
use super::images::{self, Image};
use super::walks::{FeetRig, SECONDS, Walk};
use anyhow::{Context as _, Result};
use boards::Dictionary;
use cad_transforms::{Covariance, RigidTransform};
use camera_models::Lens;
use feet::Config;
use feet::shoe::{Shoe, ShoeTag, Side as FootSide};
use feet::tag_tracker::{Camera, Detection, Frame, RigState, TagTracker};
use feet::track::GroundHeights;
use fiducials::{Motion, Tag};
use nalgebra::{UnitQuaternion, Vector3};
use rig_sim::camera::Shutter;
use rig_sim::scene::wearer::Part;
use rig_sim::simulation::{Simulation, seconds};
use rig_sim::walker::{Footfall, Phase, Side};
use rustix::time::ClockId;

/// Time between true poses of the feet, s.
pub(super) const TRUTH_STEP_S: f64 = 0.01;
/// Both feet, left first.
pub(super) const SIDES: [Side; 2] = [Side::Left, Side::Right];

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct Recording {
    pub(super) begin_s: f64,
    pub(super) frames: Vec<FrameTruth>,
    pub(super) sightings: Vec<Sighting>,
    /// True contacts of the left and the right foot.
    pub(super) contacts: [Vec<TrueContact>; 2],
    /// True poses from the beginning to the end of the recorded part.
    pub(super) feet: [Vec<TruePose>; 2],
    /// Around these.
    pub(super) ground: GroundHeights,
    /// Of the tag on each shoe.
    pub(super) foot_from_tag: [RigidTransform; 2],
}

/// Truth of a frame.
#[derive(Clone, Debug)]
pub(super) struct FrameTruth {
    pub(super) time_ns: i64,
    pub(super) world_from_rig: RigidTransform,
    pub(super) rig_from_tag: [RigidTransform; 2],
    /// Visible share of the tag of each foot by eye.
    pub(super) visible: [[f64; 2]; 2],
    pub(super) feet: [TruePose; 2],
    pub(super) exposure_ms: f64,
    /// Processor time of the tracker, ms.
    pub(super) ms: f64,
}

/// A tag that the tracker found.
#[derive(Clone, Debug)]
pub(super) struct Sighting {
    /// Index of the frame.
    pub(super) frame: usize,
    pub(super) foot: usize,
    pub(super) rig_from_tag: RigidTransform,
    /// Of a small motion of the tag in its own axes.
    pub(super) covariance: Covariance,
    /// Another pose and its excess cost.
    pub(super) second: Option<(RigidTransform, f64)>,
    pub(super) visible_share: [f64; 2],
}

/// A contact.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrueContact {
    pub(super) strike_s: f64,
    pub(super) flat_s: f64,
    pub(super) heel_off_s: f64,
    pub(super) toe_off_s: f64,
    pub(super) world_from_foot: RigidTransform,
}

/// Pose of a foot.
#[derive(Clone, Copy, Debug)]
pub(super) struct TruePose {
    pub(super) world_from_foot: RigidTransform,
    pub(super) is_flat: bool,
}

impl Recording {
    /// The recording of a walk, with images that are kept in a folder if there is one.
    pub(super) fn of(rig: &FeetRig, walk: &Walk, kept: Option<&Path>) -> Result<Self> {
        let simulation = Arc::new(rig.simulation(walk)?);
        let position = (simulation.cameras().iter()).position(|camera| camera.name == "feet");
        let position = position.context("the rig has a camera of the feet")?;
        let shoes = shoes(&simulation)?;
        let camera = camera(&simulation, position);
        let mut tracker = TagTracker::new(shoes.clone(), vec![camera], Config::default());
        let feet = [
            true_poses(&simulation, 0, walk)?,
            true_poses(&simulation, 1, walk)?,
        ];
        // A foot moves by some centimeters from one of these to the next.
        let places = feet.iter().flat_map(|poses| poses.iter().step_by(4));
        let places = places.map(|pose| pose.world_from_foot.translation_m());
        let mut recording = Self {
            begin_s: walk.begin_s,
            ground: ground(&simulation, walk.seed, places),
            frames: Vec::new(),
            sightings: Vec::new(),
            contacts: [contacts(&simulation, 0)?, contacts(&simulation, 1)?],
            feet,
            foot_from_tag: [0, 1].map(|k: usize| shoes[k].tags[0].foot_from_tag),
        };
        images::for_each(rig, walk, &simulation, position, kept, |image| {
            let mut truth = frame_truth(&simulation, image)?;
            let state = simulation.walker().rig(seconds(image.time_ns));
            let frame = Frame {
                camera: 0,
                time_ns: image.time_ns,
                images: image.views(rig.size)?,
                exposure_s: image.exposure_s,
                rig: Some(RigState {
                    world_from_rig: truth.world_from_rig,
                    motion: Motion {
                        linear: state.velocity.into(),
                        angular: (state.rotation * state.angular_rate).into(),
                    },
                }),
            };
            let begin_ms = thread_ms();
            let found = tracker.add(&frame);
            truth.ms = thread_ms() - begin_ms;
            for seen in &found {
                let own = sighting(recording.frames.len(), seen)?;
                recording.sightings.push(own);
            }
            recording.frames.push(truth);
            Ok(())
        })?;
        Ok(recording)
    }
}

/// Processor time of this thread, ms.
#[expect(clippy::disallowed_methods, reason = "a benchmark measures time")]
fn thread_ms() -> f64 {
    let time = rustix::time::clock_gettime(ClockId::ThreadCPUTime);
    1e3 * time.tv_sec as f64 + 1e-6 * time.tv_nsec as f64
}

fn camera(simulation: &Simulation, position: usize) -> Camera {
    let calibration = simulation.calibration(position);
    let camera = &simulation.cameras()[position];
    Camera {
        lenses: [Lens::new(&calibration.left), Lens::new(&calibration.right)],
        rig_from_eye: camera.rig_from_eye,
        line_s: match camera.shutter {
            Shutter::Global => 0.0,
            Shutter::Rolling { line_s } => line_s,
        },
    }
}

fn shoes(simulation: &Simulation) -> Result<Vec<Shoe>> {
    let tags = simulation.scene().wearer.tags.iter();
    tags.map(|tag| {
        let printed = Tag::new(Dictionary::AprilTag36h11, tag.id as u32, tag.size_m);
        Ok(Shoe {
            side: match tag.side {
                Side::Left => FootSide::Left,
                Side::Right => FootSide::Right,
            },
            tags: vec![ShoeTag {
                tag: printed.context("a tag of the dictionary")?,
                foot_from_tag: transform(&tag.position, &tag.rotation)?,
            }],
        })
    })
    .collect()
}

fn transform(position: &Vector3<f64>, rotation: &UnitQuaternion<f64>) -> Result<RigidTransform> {
    let q = rotation;
    Ok(RigidTransform::from_wxyz(
        [q.w, q.i, q.j, q.k],
        (*position).into(),
    )?)
}

fn contacts(simulation: &Simulation, foot: usize) -> Result<Vec<TrueContact>> {
    let falls = simulation.walker().contacts(SIDES[foot]).iter();
    falls
        .map(|fall: &Footfall| {
            let (flat_s, heel_off_s) = fall.flat_phase();
            Ok(TrueContact {
                strike_s: fall.strike_s,
                flat_s,
                // The last contact never ends.
                heel_off_s: heel_off_s.min(1e6),
                toe_off_s: fall.off_s.min(1e6),
                world_from_foot: transform(&fall.position, &fall.rotation)?,
            })
        })
        .collect()
}

fn true_pose(simulation: &Simulation, foot: usize, time_s: f64) -> Result<TruePose> {
    let state = simulation.walker().foot(SIDES[foot], time_s);
    Ok(TruePose {
        world_from_foot: transform(&state.position, &state.rotation)?,
        is_flat: state.phase == Phase::Flat,
    })
}

fn true_poses(simulation: &Simulation, foot: usize, walk: &Walk) -> Result<Vec<TruePose>> {
    let count = (SECONDS / TRUTH_STEP_S).round() as usize;
    let time_s = |n: usize| walk.begin_s + n as f64 * TRUTH_STEP_S;
    (0..=count)
        .map(|n| true_pose(simulation, foot, time_s(n)))
        .collect()
}

fn frame_truth(simulation: &Simulation, image: &Image) -> Result<FrameTruth> {
    let time_s = seconds(image.time_ns);
    let rig = simulation.walker().rig(time_s);
    let world_from_rig = transform(&rig.position, &rig.rotation)?;
    let wearer = &simulation.scene().wearer;
    let tag = |foot: usize| {
        let (position, rotation) = wearer.pose(Part::Tag(foot), simulation.walker(), time_s);
        Ok::<_, anyhow::Error>(world_from_rig.inverse() * transform(&position, &rotation)?)
    };
    let foot = |foot: usize| true_pose(simulation, foot, time_s);
    Ok(FrameTruth {
        time_ns: image.time_ns,
        world_from_rig,
        rig_from_tag: [tag(0)?, tag(1)?],
        visible: image.visible,
        feet: [foot(0)?, foot(1)?],
        exposure_ms: 1e3 * image.exposure_s,
        ms: 0.0,
    })
}

fn sighting(frame: usize, seen: &Detection) -> Result<Sighting> {
    let fit = &seen.fit;
    // Rotation first in a fit.
    let place = |k: usize| (k + 3) % 6;
    let rows =
        std::array::from_fn(|i| std::array::from_fn(|j| fit.covariance[(place(i), place(j))]));
    let second = fit.other.as_ref();
    let share = |eye: usize| fit.visible_share.get(eye).copied().unwrap_or(0.0);
    Ok(Sighting {
        frame,
        foot: seen.shoe,
        rig_from_tag: fit.reference_from_tag,
        covariance: Covariance::from_rows(rows)?,
        second: second.map(|own| (own.reference_from_tag, own.excess_cost)),
        visible_share: [share(0), share(1)],
    })
}
