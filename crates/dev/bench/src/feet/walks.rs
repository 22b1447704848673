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
    pub(super) seed: u64,
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

/// Ten walks in the simulator's own gait, and five in that of [`JointGait`]. Nothing was developed
/// with them.
pub(super) const WALKS: [Walk; 15] = [
    walk("pavement", Kind::Pavement, Lighting::Day, 551, 3.0, None),
    walk("jog", Kind::Pavement, Lighting::Day, 552, 21.5, None),
    walk("stumble", Kind::Pavement, Lighting::Day, 553, 31.0, None),
    walk("plaza", Kind::Plaza, Lighting::Day, 554, 12.0, None),
    walk(
        "plaza at night",
        Kind::Plaza,
        Lighting::Night,
        555,
        9.0,
        None,
    ),
    walk("stairs up", Kind::Stairs, Lighting::Day, 556, 5.0, None),
    walk("stairs down", Kind::Stairs, Lighting::Day, 557, 23.0, None),
    walk("trail", Kind::Trail, Lighting::LowSun, 558, 12.0, None),
    walk(
        "corridor",
        Kind::Corridor,
        Lighting::Flicker,
        559,
        5.0,
        None,
    ),
    walk("room", Kind::Room, Lighting::Day, 560, 2.0, None),
    walk(
        "long steps",
        Kind::Plaza,
        Lighting::Day,
        561,
        20.0,
        Some(LONG),
    ),
    walk(
        "small, quick",
        Kind::Pavement,
        Lighting::Day,
        562,
        2.0,
        Some(SMALL),
    ),
    walk(
        "bent knees",
        Kind::Trail,
        Lighting::Day,
        563,
        4.0,
        Some(BENT),
    ),
    walk(
        "shuffling",
        Kind::Corridor,
        Lighting::Day,
        564,
        3.0,
        Some(SHUFFLING),
    ),
    walk("stairs", Kind::Stairs, Lighting::Day, 565, 5.0, Some(USUAL)),
];

/// Walks of other wearers with which the estimator is developed; no result is reported of them.
pub(super) const TUNING: [Walk; 15] = [
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
    walk(
        "tuning stumble",
        Kind::Pavement,
        Lighting::Day,
        503,
        31.0,
        None,
    ),
    walk(
        "tuning stumble 2",
        Kind::Pavement,
        Lighting::Day,
        411,
        31.0,
        None,
    ),
    walk(
        "tuning night 2",
        Kind::Plaza,
        Lighting::Night,
        505,
        9.0,
        None,
    ),
    walk(
        "tuning night 3",
        Kind::Pavement,
        Lighting::Night,
        412,
        4.0,
        None,
    ),
    walk(
        "tuning long",
        Kind::Plaza,
        Lighting::Day,
        521,
        20.0,
        Some(LONG),
    ),
    walk(
        "tuning stairs 2",
        Kind::Stairs,
        Lighting::Day,
        506,
        5.0,
        None,
    ),
    walk(
        "tuning stairs 3",
        Kind::Stairs,
        Lighting::Day,
        525,
        5.0,
        Some(USUAL),
    ),
];

const LONG: JointGait = JointGait {
    height_m: 1.86,
    cadence_ratio: 0.95,
    duty_offset: -0.012,
    toe_out_rad: [0.05, 0.09],
    excursions: [1.1, 1.02, 1.05],
    knee_delay: 0.006,
    clearance_m: 0.018,
    rolls_s: [0.09, 0.23],
    circumduction: [0.006, 0.01],
};
const SMALL: JointGait = JointGait {
    height_m: 1.59,
    cadence_ratio: 1.06,
    duty_offset: 0.01,
    toe_out_rad: [0.17, 0.13],
    excursions: [0.97, 1.0, 0.95],
    knee_delay: -0.005,
    clearance_m: 0.024,
    rolls_s: [0.07, 0.21],
    circumduction: [0.01, 0.025],
};
const BENT: JointGait = JointGait {
    height_m: 1.71,
    cadence_ratio: 0.98,
    duty_offset: 0.018,
    toe_out_rad: [0.12, 0.15],
    excursions: [1.0, 1.12, 0.9],
    knee_delay: 0.01,
    clearance_m: 0.028,
    rolls_s: [0.08, 0.25],
    circumduction: [0.015, 0.0],
};
const SHUFFLING: JointGait = JointGait {
    height_m: 1.66,
    cadence_ratio: 0.94,
    duty_offset: 0.024,
    toe_out_rad: [0.2, 0.14],
    excursions: [0.9, 0.88, 0.8],
    knee_delay: 0.012,
    clearance_m: 0.011,
    rolls_s: [0.06, 0.24],
    circumduction: [0.02, 0.04],
};
const USUAL: JointGait = JointGait {
    height_m: 1.77,
    cadence_ratio: 1.01,
    duty_offset: 0.004,
    toe_out_rad: [0.1, 0.12],
    excursions: [1.0; 3],
    knee_delay: 0.0,
    clearance_m: 0.02,
    rolls_s: [0.082, 0.225],
    circumduction: [0.008, 0.015],
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
