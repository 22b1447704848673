//! The walks, and which frames of them are keyframes.

use std::sync::Arc;

use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use cad_transforms::rig::Rig;
use rig_sim::camera::Quality;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation, seconds};

const EXAMPLE_RIG: &str = include_str!("../../../../../cad-transforms/rigs/example.toml");
const RATE_HZ: f64 = 15.0;
/// Spacing of keyframes of the preset `balanced` of `paws-reconstruct`.
const SPACING_M: f64 = 0.5;
const SPACING_DEG: f64 = 20.0;
/// Image sizes of one eye.
pub(crate) const SMALL: [u32; 2] = [672, 376];
pub(crate) const LARGE: [u32; 2] = [1280, 720];

/// Part of a simulated walk. No test uses these seeds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Walk {
    pub(crate) kind: Kind,
    pub(crate) light: Lighting,
    pub(crate) seed: u64,
    /// Begin and end, s: the walk before it is not rendered.
    pub(crate) span_s: [f64; 2],
    pub(crate) size: [u32; 2],
}

const fn walk(kind: Kind, light: Lighting, seed: u64, span_s: [f64; 2], size: [u32; 2]) -> Walk {
    Walk {
        kind,
        light,
        seed,
        span_s,
        size,
    }
}

/// Down a kerb and up the other one; up and down stairs; roots and stones; between furniture.
pub(crate) const WALKS: [Walk; 8] = [
    walk(Kind::Pavement, Lighting::Day, 301, [10.0, 25.0], SMALL),
    walk(Kind::Stairs, Lighting::Day, 302, STAIRS_S, SMALL),
    walk(Kind::Trail, Lighting::Day, 303, [3.0, 18.0], SMALL),
    walk(Kind::Room, Lighting::Day, 304, [0.0, 15.0], SMALL),
    walk(Kind::Stairs, Lighting::Night, 305, STAIRS_S, SMALL),
    walk(Kind::Pavement, Lighting::Day, 301, [10.0, 25.0], LARGE),
    walk(Kind::Stairs, Lighting::Day, 302, STAIRS_S, LARGE),
    walk(Kind::Trail, Lighting::Day, 303, [3.0, 13.0], LARGE),
];
const STAIRS_S: [f64; 2] = [4.0, 24.0];

/// A walk that is prepared for rendering.
pub(crate) struct WalkInputs {
    pub(crate) walk: Walk,
    pub(crate) simulation: Arc<Simulation>,
}

/// A frame of a camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KeyframeId {
    pub(crate) camera: usize,
    pub(crate) frame: u64,
    pub(crate) time_ns: i64,
}

impl Walk {
    /// The walk with another seed, if one is given: what is tuned is tuned on other walks.
    pub(crate) fn with_seed(self, seed: Option<u64>) -> Self {
        Self {
            seed: seed.unwrap_or(self.seed),
            ..self
        }
    }

    /// Scene, light, seed and columns.
    pub(crate) fn name(&self) -> String {
        let [width, height] = self.size;
        let (kind, light) = (self.kind.name(), self.light.name());
        format!("{kind}-{light}-{}-{width}x{height}", self.seed)
    }

    /// # Errors
    /// There is no such walk.
    pub(crate) fn prepare(self) -> Result<WalkInputs> {
        let rig = Rig::parse(EXAMPLE_RIG).context("reading the example rig")?;
        let settings = Settings {
            kind: self.kind,
            lighting: self.light,
            seed: self.seed,
            seconds: self.span_s[1],
            rate_hz: RATE_HZ,
            width: self.size[0],
            height: self.size[1],
            quality: Quality::ACCURATE,
        };
        let simulation = Simulation::new(&settings, &rig).context("preparing the walk")?;
        Ok(WalkInputs {
            walk: self,
            simulation: Arc::new(simulation),
        })
    }
}

impl WalkInputs {
    /// Keyframes in the order in which the stage fuses them: by time, then camera.
    pub(crate) fn keyframes(&self) -> Result<Vec<KeyframeId>> {
        let settings = self.simulation.settings();
        let first = (self.walk.span_s[0] * RATE_HZ).ceil() as u64;
        let mut last: Option<RigidTransform> = None;
        let mut found = Vec::new();
        for frame in first..settings.frame_count() {
            let time_ns = settings.frame_ns(frame);
            let rig = self.simulation.walker().rig(seconds(time_ns));
            let now = transform(&rig.position, &rig.rotation)?;
            let is_near = last.is_some_and(|last| {
                let motion = last.inverse() * now;
                motion.distance_m() < SPACING_M && motion.angle_rad().to_degrees() < SPACING_DEG
            });
            if is_near {
                continue;
            }
            last = Some(now);
            let cameras = 0..self.simulation.cameras().len();
            found.extend(cameras.map(|camera| KeyframeId {
                camera,
                frame,
                time_ns,
            }));
        }
        Ok(found)
    }
}

/// A pose of the simulator.
pub(crate) fn transform(
    position: &nalgebra::Vector3<f64>,
    rotation: &nalgebra::UnitQuaternion<f64>,
) -> Result<RigidTransform> {
    let q = rotation.quaternion();
    Ok(RigidTransform::from_wxyz(
        [q.w, q.i, q.j, q.k],
        (*position).into(),
    )?)
}
