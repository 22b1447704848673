//! The walks: scenes, what of them is rendered, the nominal rig and true poses.

use std::sync::Arc;

use anyhow::{Context as _, Result};
use cad_transforms::RigidTransform;
use cad_transforms::rig::Rig;
use rig_sim::camera::{Quality, Shutter};
use rig_sim::faults::Faults;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{FrameSource as _, Imaging, Settings, Simulation, StereoFrame, seconds};
use scene_bundle::outputs::rig::{RigCamera, RigModel};
use scene_bundle::{Pose, Trajectory};

use crate::terrain::walks::transform;

const RIG: &str = include_str!("../../../../../cad-transforms/rigs/recommended.toml");
/// The camera that sees the shoes.
pub(super) const CAMERA: &str = "feet";
pub(super) const RATE_HZ: f64 = 15.0;
/// Columns and rows of an eye.
pub(super) const SIZE: [u32; 2] = [672, 376];
/// Exposure that the rig file recommends, s.
const EXPOSURE_S: f64 = 0.004;
/// Two samples of the exposure of a camera that moves as usual, and more of a long one.
const QUALITY: Quality = Quality {
    samples: 2,
    max_samples: 8,
    noise: true,
};
/// Length of what is rendered with a fault, s.
pub(super) const SHORT_S: f64 = 6.0;

/// A part of a simulated walk. No other benchmark and no test of an estimator uses these seeds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Walk {
    pub(super) name: &'static str,
    pub(super) scene: Kind,
    pub(super) seed: u64,
    /// Beginning, s.
    pub(super) begin_s: f64,
    /// Length of what is rendered without a fault, s.
    pub(super) long_s: f64,
    /// Whether it has level ground, on which tags slip and people jump.
    pub(super) has_plane_ground: bool,
    /// Whether the stages know its ground; without, it says nothing.
    pub(super) has_depth: bool,
}

/// On level ground, and up stairs. On level ground it is long: a tag that slips is found from eight
/// contacts before and after it on.
pub(super) const WALKS: [Walk; 2] = [
    Walk {
        name: "pavement",
        scene: Kind::Pavement,
        seed: 771,
        begin_s: 0.0,
        long_s: 22.0,
        has_plane_ground: true,
        has_depth: true,
    },
    Walk {
        name: "stairs",
        scene: Kind::Stairs,
        seed: 772,
        begin_s: 4.0,
        long_s: 10.0,
        has_plane_ground: false,
        has_depth: true,
    },
];
/// Parts of the pavement with another gait.
pub(super) const JOG: Walk = Walk {
    begin_s: 22.0,
    ..other(0, 773)
};
pub(super) const STUMBLE: Walk = Walk {
    begin_s: 32.0,
    ..other(0, 774)
};

/// Walks without a fault beside the same references.
pub(super) const OTHERS: [Walk; 4] = [other(0, 781), other(0, 782), other(1, 783), other(1, 784)];

const fn other(of: usize, seed: u64) -> Walk {
    Walk {
        seed,
        long_s: SHORT_S,
        has_plane_ground: false,
        has_depth: false,
        ..WALKS[of]
    }
}

impl Walk {
    /// The simulation, with faults of the wearer and an exposure, s. Its motion does not depend on
    /// how much of it is rendered.
    ///
    /// # Errors
    /// A setting that cannot be simulated.
    pub(super) fn simulation(
        &self,
        faults: &Faults,
        exposure_s: Option<f64>,
    ) -> Result<Arc<Simulation>> {
        let settings = Settings {
            kind: self.scene,
            lighting: Lighting::Day,
            seed: self.seed,
            seconds: self.begin_s + self.long_s,
            rate_hz: RATE_HZ,
            width: SIZE[0],
            height: SIZE[1],
            quality: QUALITY,
        };
        let imaging = Imaging {
            exposure_s: Some(exposure_s.unwrap_or(EXPOSURE_S)),
            ..Imaging::USUAL
        };
        let rig = Rig::parse(RIG)?;
        let simulation = Simulation::with_wearer_faults(&settings, &rig, &faults.of_wearer());
        let simulation = simulation.and_then(|own| own.with_imaging(imaging));
        let simulation = simulation.with_context(|| format!("preparing the walk {}", self.name))?;
        Ok(Arc::new(simulation))
    }

    /// Numbers of the frames of its first seconds.
    pub(super) fn numbers(&self, length_s: f64) -> std::ops::Range<u64> {
        let at = |s: f64| (s * RATE_HZ).round() as u64;
        at(self.begin_s)..at(self.begin_s + length_s)
    }

    /// Images of its first seconds, with faults of the camera.
    ///
    /// # Errors
    /// The rig has no such camera.
    pub(super) fn render(
        &self,
        simulation: &Arc<Simulation>,
        faults: &Faults,
        length_s: f64,
    ) -> Result<Vec<Arc<StereoFrame>>> {
        let position = position(simulation)?;
        let mut renderer = simulation.frames(position).with_faults(faults.of(CAMERA));
        let numbers = self.numbers(length_s);
        if numbers.start > 0 {
            renderer.settle(simulation.settings().frame_ns(numbers.start));
        }
        let frame = |number| {
            let time_ns = simulation.settings().frame_ns(number);
            Arc::new(renderer.render_frame(number, time_ns))
        };
        Ok(numbers.map(frame).collect())
    }

    /// True poses of the rig at the frames of its first seconds, and one frame before and after.
    ///
    /// # Errors
    /// A pose that is not finite.
    pub(super) fn trajectory(&self, simulation: &Simulation, length_s: f64) -> Result<Trajectory> {
        let numbers = self.numbers(length_s);
        let numbers = numbers.start.saturating_sub(1)..numbers.end + 1;
        let pose = |number| {
            let time_ns = simulation.settings().frame_ns(number);
            Ok(Pose::new(time_ns, rig_pose(simulation, time_ns)?))
        };
        let poses = numbers.map(pose).collect::<Result<Vec<Pose>>>()?;
        Ok(Trajectory::new(poses)?)
    }
}

/// Index of the camera that sees the shoes.
pub(super) fn position(simulation: &Simulation) -> Result<usize> {
    let mut cameras = simulation.cameras().iter();
    let position = cameras.position(|camera| camera.name == CAMERA);
    position.context("the rig has no camera of the feet")
}

/// True pose of the rig.
pub(super) fn rig_pose(simulation: &Simulation, time_ns: i64) -> Result<RigidTransform> {
    let rig = simulation.walker().rig(seconds(time_ns));
    transform(&rig.position, &rig.rotation)
}

/// The nominal rig with its camera of the feet only.
///
/// # Errors
/// The rig has no such camera.
pub(super) fn rig_model(simulation: &Simulation) -> Result<RigModel> {
    let position = position(simulation)?;
    let calibration = simulation.calibration(position);
    let camera = &simulation.cameras()[position];
    let [rig_from_left, rig_from_right] = camera.rig_from_eye;
    let rig = Rig::parse(RIG)?;
    Ok(RigModel {
        name: rig.name().to_owned(),
        revision: rig.revision().to_owned(),
        cameras: vec![RigCamera {
            name: CAMERA.to_owned(),
            left: calibration.left,
            right: calibration.right,
            rig_from_left,
            rig_from_left_covariance: None,
            right_from_left: rig_from_right.inverse() * rig_from_left,
            right_from_left_covariance: None,
            line_s: match camera.shutter {
                Shutter::Global => 0.0,
                Shutter::Rolling { line_s } => line_s,
            },
        }],
        imus: Vec::new(),
        shoes: reconstruction::pipeline::stages::rig::shoes(&rig),
    })
}
