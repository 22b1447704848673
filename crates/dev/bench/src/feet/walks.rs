//! Walks and rigs of the benchmark.

use anyhow::{Context as _, Result};
use cad_transforms::rig::Rig;
use rig_sim::camera::Quality;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Imaging, Settings, Simulation};

use super::joint_gait::JointGait;

/// Length of the recorded part of a walk, s.
pub(super) const SECONDS: f64 = 12.0;

/// A part of a simulated walk.
#[derive(Clone, Copy, Debug)]
pub(super) struct Walk {
    pub(super) name: &'static str,
    scene: Kind,
    pub(super) light: Lighting,
    seed: u64,
    /// Beginning of the recorded part, s.
    pub(super) begin_s: f64,
    /// A wearer with another gait than the simulator's own.
    pub(super) wearer: Option<JointGait>,
}

const fn walk(
    name: &'static str,
    scene: Kind,
    light: Lighting,
    seed: u64,
    begin_s: f64,
    wearer: Option<JointGait>,
) -> Walk {
    Walk {
        name,
        scene,
        light,
        seed,
        begin_s,
        wearer,
    }
}

/// Ten walks in the simulator's own gait, and five in that of [`JointGait`].
pub(super) const WALKS: [Walk; 15] = [
    walk("pavement", Kind::Pavement, Lighting::Day, 301, 0.0, None),
    walk("jog", Kind::Pavement, Lighting::Day, 302, 22.0, None),
    walk("stumble", Kind::Pavement, Lighting::Day, 303, 32.0, None),
    walk("plaza", Kind::Plaza, Lighting::Day, 304, 6.0, None),
    walk(
        "plaza at night",
        Kind::Plaza,
        Lighting::Night,
        305,
        4.0,
        None,
    ),
    walk("stairs up", Kind::Stairs, Lighting::Day, 306, 4.0, None),
    walk("stairs down", Kind::Stairs, Lighting::Day, 307, 24.0, None),
    walk("trail", Kind::Trail, Lighting::LowSun, 308, 3.0, None),
    walk(
        "corridor",
        Kind::Corridor,
        Lighting::Flicker,
        309,
        0.0,
        None,
    ),
    walk("room", Kind::Room, Lighting::Day, 310, 1.0, None),
    walk(
        "tall, slow",
        Kind::Plaza,
        Lighting::Day,
        321,
        17.0,
        Some(TALL),
    ),
    walk(
        "short, quick",
        Kind::Pavement,
        Lighting::Day,
        322,
        1.0,
        Some(SHORT),
    ),
    walk("stiff", Kind::Trail, Lighting::Day, 323, 2.0, Some(STIFF)),
    walk(
        "high steps",
        Kind::Corridor,
        Lighting::Day,
        324,
        0.0,
        Some(HIGH),
    ),
    walk("stairs", Kind::Stairs, Lighting::Day, 325, 4.0, Some(USUAL)),
];

/// Walks of other wearers with which the estimator is developed; no result is reported of them.
pub(super) const TUNING: [Walk; 8] = [
    walk(
        "tuning pavement",
        Kind::Pavement,
        Lighting::Day,
        401,
        1.0,
        None,
    ),
    walk(
        "tuning pavement 2",
        Kind::Pavement,
        Lighting::Day,
        402,
        11.0,
        None,
    ),
    walk("tuning jog", Kind::Pavement, Lighting::Day, 403, 20.0, None),
    walk("tuning plaza", Kind::Plaza, Lighting::Day, 404, 15.0, None),
    walk("tuning stairs", Kind::Stairs, Lighting::Day, 405, 6.0, None),
    walk(
        "tuning trail",
        Kind::Trail,
        Lighting::LowSun,
        406,
        8.0,
        None,
    ),
    walk(
        "tuning corridor",
        Kind::Corridor,
        Lighting::Flicker,
        407,
        6.0,
        None,
    ),
    walk("tuning night", Kind::Plaza, Lighting::Night, 408, 6.0, None),
];

const TALL: JointGait = JointGait {
    height_m: 1.91,
    cadence_ratio: 0.92,
    duty_offset: 0.022,
    toe_out_rad: [0.16, 0.2],
    excursions: [1.04, 0.97, 0.9],
    knee_delay: 0.01,
    clearance_m: 0.016,
    rolls_s: [0.1, 0.26],
    circumduction: [0.008, 0.03],
};
const SHORT: JointGait = JointGait {
    height_m: 1.56,
    cadence_ratio: 1.08,
    duty_offset: -0.018,
    toe_out_rad: [0.06, 0.04],
    excursions: [1.06, 1.05, 1.1],
    knee_delay: -0.008,
    clearance_m: 0.021,
    rolls_s: [0.065, 0.19],
    circumduction: [0.004, -0.02],
};
const STIFF: JointGait = JointGait {
    height_m: 1.74,
    cadence_ratio: 1.0,
    duty_offset: 0.015,
    toe_out_rad: [0.1, 0.18],
    excursions: [0.92, 0.86, 0.75],
    knee_delay: 0.015,
    clearance_m: 0.012,
    rolls_s: [0.075, 0.2],
    circumduction: [0.025, 0.06],
};
const HIGH: JointGait = JointGait {
    height_m: 1.68,
    cadence_ratio: 0.97,
    duty_offset: 0.0,
    toe_out_rad: [0.14, 0.1],
    excursions: [1.12, 1.1, 1.15],
    knee_delay: 0.0,
    clearance_m: 0.034,
    rolls_s: [0.085, 0.24],
    circumduction: [0.012, 0.0],
};
const USUAL: JointGait = JointGait {
    height_m: 1.79,
    cadence_ratio: 1.03,
    duty_offset: -0.006,
    toe_out_rad: [0.11, 0.13],
    excursions: [1.0; 3],
    knee_delay: 0.0,
    clearance_m: 0.019,
    rolls_s: [0.08, 0.22],
    circumduction: [0.008, 0.02],
};

/// A rig with its feet camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct FeetRig {
    pub(super) name: &'static str,
    toml: &'static str,
    pub(super) size: [u32; 2],
    pub(super) rate_hz: f64,
    exposure_s: Option<f64>,
}

pub(super) const RIGS: [FeetRig; 2] = [
    FeetRig {
        name: "example",
        toml: include_str!("../../../../../cad-transforms/rigs/example.toml"),
        size: [672, 376],
        rate_hz: 15.0,
        exposure_s: None,
    },
    FeetRig {
        name: "recommended",
        toml: include_str!("../../../../../cad-transforms/rigs/recommended.toml"),
        size: [1280, 720],
        rate_hz: 30.0,
        exposure_s: Some(0.004),
    },
];

impl FeetRig {
    /// The rig file.
    pub(super) fn rig(&self) -> Result<Rig> {
        Ok(Rig::parse(self.toml)?)
    }

    /// A walk with this rig.
    pub(super) fn simulation(&self, walk: &Walk) -> Result<Simulation> {
        let settings = Settings {
            kind: walk.scene,
            lighting: walk.light,
            seed: walk.seed,
            seconds: walk.begin_s + SECONDS,
            rate_hz: self.rate_hz,
            width: self.size[0],
            height: self.size[1],
            quality: Quality::ACCURATE,
        };
        let rig = self.rig()?;
        let simulation = match &walk.wearer {
            Some(wearer) => Simulation::with_gait(&settings, &rig, wearer),
            None => Simulation::new(&settings, &rig),
        };
        let imaging = Imaging {
            exposure_s: self.exposure_s,
            ..Imaging::USUAL
        };
        let simulation = simulation.and_then(|walk| walk.with_imaging(imaging));
        simulation.with_context(|| format!("preparing the walk {:?}", walk.name))
    }
}
