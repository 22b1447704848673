//! The faults and their strengths.

use rig_sim::faults::{Fault, Faults, Kind};
use rig_sim::walker::Side;

use super::inputs::Edit;
use super::walks::{CAMERA, JOG, SHORT_S, STUMBLE, Walk};

/// Begin and end of a fault of the camera, s from the beginning of the walk's part.
const DURING_S: [f64; 2] = [2.0, 4.5];
/// A jump, likewise.
const JUMP_S: f64 = 2.0;

/// How a fault is injected.
#[derive(Clone, Copy, Debug)]
pub(super) enum Injection {
    /// Images are rendered with it: a fault of the camera during a part of the walk.
    Light(Kind),
    /// Images are rendered with it: a fault of the wearer, on this foot or on both, throughout.
    Wearer(Kind, Option<Side>),
    /// Likewise, and the walk is long: a tag of the left shoe slips in the middle.
    Slip,
    /// Images are rendered with this exposure, ms, throughout.
    Exposure,
    /// A part of the walk with another gait.
    Gait(Walk),
    /// The device delivers images of the walk without a fault with it during a part of the walk.
    Device(Kind),
    /// An input of the stages is wrong.
    Input(Edit),
}

/// A fault with its strengths, weakest first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sweep {
    pub(super) name: &'static str,
    pub(super) unit: &'static str,
    pub(super) injection: Injection,
    pub(super) strengths: &'static [f64],
}

const fn sweep(
    name: &'static str,
    unit: &'static str,
    injection: Injection,
    strengths: &'static [f64],
) -> Sweep {
    Sweep {
        name,
        unit,
        injection,
        strengths,
    }
}

const LEFT: Option<Side> = Some(Side::Left);

/// Faults, in the order of the charts.
pub(super) const SWEEPS: [Sweep; 39] = [
    sweep("exposure", "ms", Injection::Exposure, &[8.0, 30.0]),
    sweep(
        "blur",
        "share of the width",
        Injection::Light(Kind::Blur),
        &[0.005, 0.02],
    ),
    sweep(
        "darkness",
        "stops",
        Injection::Light(Kind::Darkness),
        &[4.0, 10.0],
    ),
    sweep(
        "flash",
        "times the light",
        Injection::Light(Kind::Flash),
        &[100.0],
    ),
    sweep(
        "covered lens",
        "share",
        Injection::Light(Kind::CoveredLens),
        &[0.4, 1.0],
    ),
    sweep(
        "dirty lens",
        "share",
        Injection::Light(Kind::DirtyLens),
        &[0.3, 0.8],
    ),
    sweep(
        "camera shifted",
        "degrees",
        Injection::Light(Kind::ShiftedCamera),
        &[0.3, 2.0],
    ),
    sweep(
        "dropped frames",
        "share",
        Injection::Device(Kind::Dropped),
        &[0.3, 0.7, 1.0],
    ),
    sweep(
        "torn frames",
        "share",
        Injection::Device(Kind::Torn),
        &[0.2, 0.6, 1.0],
    ),
    sweep(
        "frozen frames",
        "share",
        Injection::Device(Kind::Frozen),
        &[0.1, 0.4, 1.0],
    ),
    sweep("late frames", "s", Injection::Device(Kind::Late), &[1.0]),
    sweep(
        "tag dirt",
        "share of cells",
        Injection::Wearer(Kind::TagDirt, None),
        &[0.15, 0.5],
    ),
    sweep(
        "tag covered",
        "share",
        Injection::Wearer(Kind::TagCovered, None),
        &[0.2, 0.4, 0.6],
    ),
    sweep(
        "trousers",
        "m",
        Injection::Wearer(Kind::Trousers, None),
        &[0.08, 0.2],
    ),
    sweep(
        "one tag lost",
        "0 or 1",
        Injection::Wearer(Kind::TagLost, LEFT),
        &[1.0],
    ),
    sweep(
        "both tags lost",
        "0 or 1",
        Injection::Wearer(Kind::TagLost, None),
        &[1.0],
    ),
    sweep(
        "tag slips",
        "m and 0.6 degrees per mm",
        Injection::Slip,
        &[0.005, 0.015, 0.05],
    ),
    sweep(
        "foot slips",
        "m",
        Injection::Wearer(Kind::FootSlip, None),
        &[0.01, 0.03, 0.1],
    ),
    sweep(
        "soft ground",
        "m",
        Injection::Wearer(Kind::SoftGround, None),
        &[0.01, 0.05],
    ),
    sweep("jump", "m", Injection::Wearer(Kind::Jump, None), &[0.3]),
    sweep("jog", "0 or 1", Injection::Gait(JOG), &[1.0]),
    sweep("stumble", "0 or 1", Injection::Gait(STUMBLE), &[1.0]),
    sweep(
        "tags exchanged",
        "0 or 1",
        Injection::Input(Edit::ExchangedTags),
        &[1.0],
    ),
    sweep(
        "tag size, too large",
        "ratio - 1",
        Injection::Input(Edit::TagSize),
        &[0.02, 0.05, 0.1, 0.3],
    ),
    sweep(
        "tag size, too small",
        "ratio - 1",
        Injection::Input(Edit::TagSize),
        &[-0.02, -0.05, -0.1, -0.3],
    ),
    sweep(
        "tag height",
        "m",
        Injection::Input(Edit::TagHeight),
        &[0.003, 0.01, 0.03],
    ),
    sweep(
        "tag tilt",
        "degrees",
        Injection::Input(Edit::TagTilt),
        &[2.0, 5.0, 15.0],
    ),
    sweep(
        "sole outline",
        "m at both ends",
        Injection::Input(Edit::SoleOutline),
        &[0.02, 0.05],
    ),
    sweep(
        "camera clock",
        "ms late",
        Injection::Input(Edit::Clock),
        &[5.0, 10.0, 20.0, 30.0],
    ),
    sweep(
        "pose drift",
        "share of the path",
        Injection::Input(Edit::PoseDrift),
        &[0.01, 0.03, 0.1],
    ),
    sweep(
        "pose jump",
        "m",
        Injection::Input(Edit::PoseJump),
        &[0.05, 0.2, 0.5],
    ),
    sweep(
        "dead reckoned",
        "s",
        Injection::Input(Edit::DeadReckoned),
        &[0.4, 1.0, 3.0],
    ),
    sweep(
        "right eye, yaw",
        "degrees",
        Injection::Input(Edit::RightEyeYaw),
        &[0.05, 0.1, 0.2, 0.5],
    ),
    sweep(
        "right eye, yaw out",
        "degrees",
        Injection::Input(Edit::RightEyeYaw),
        &[-0.05, -0.1, -0.2, -0.5],
    ),
    sweep(
        "right eye, pitch",
        "degrees",
        Injection::Input(Edit::RightEyePitch),
        &[0.05, 0.1, 0.2, 0.5],
    ),
    sweep(
        "baseline",
        "ratio - 1",
        Injection::Input(Edit::Baseline),
        &[0.005, 0.02, 0.05],
    ),
    sweep(
        "right eye black",
        "share of the walk",
        Injection::Input(Edit::BlackEye),
        &[0.3, 1.0],
    ),
    sweep(
        "cover on one shoe",
        "share",
        Injection::Wearer(Kind::TagCovered, LEFT),
        &[0.8],
    ),
    sweep(
        "mud on one shoe",
        "share of cells",
        Injection::Wearer(Kind::TagDirt, LEFT),
        &[0.7],
    ),
];

impl Injection {
    /// Whether images are rendered with it.
    pub(super) fn is_rendered(self) -> bool {
        !matches!(self, Self::Device(_) | Self::Input(_))
    }

    /// Whether the wearer's steps are those of the walk without a fault.
    pub(super) fn is_same_walk(self) -> bool {
        !matches!(self, Self::Gait(_) | Self::Wearer(Kind::Jump, _))
    }
}

impl Sweep {
    /// Whether it can be injected into a walk.
    pub(super) fn applies_to(&self, walk: &Walk) -> bool {
        match self.injection {
            // Jumps are on the spot, which is no place on a stair.
            Injection::Wearer(Kind::Jump, _) => walk.has_plane_ground,
            Injection::Slip => walk.has_plane_ground,
            Injection::Gait(gait) => walk.name == gait.name,
            _ => true,
        }
    }

    /// Seconds of the walk that it is scored on.
    pub(super) fn length_s(&self, walk: &Walk) -> f64 {
        match self.injection {
            Injection::Slip | Injection::Input(_) => walk.long_s,
            _ => SHORT_S,
        }
    }

    /// The plan for the simulator; empty where inputs are edited.
    pub(super) fn faults(&self, walk: &Walk, strength: f64) -> Faults {
        let [from_s, to_s] = DURING_S.map(|s| walk.begin_s + s);
        let fault = |kind, from_s, to_s, foot| Fault {
            kind,
            strength,
            from_s,
            to_s,
            camera: Some(CAMERA.to_owned()),
            foot,
        };
        let list = match self.injection {
            // A camera that has shifted does not shift back.
            Injection::Light(Kind::ShiftedCamera) => {
                vec![fault(Kind::ShiftedCamera, from_s, f64::INFINITY, None)]
            }
            Injection::Light(kind) | Injection::Device(kind) => {
                vec![fault(kind, from_s, to_s, None)]
            }
            Injection::Wearer(Kind::Jump, _) => {
                vec![fault(
                    Kind::Jump,
                    walk.begin_s + JUMP_S,
                    f64::INFINITY,
                    None,
                )]
            }
            Injection::Wearer(kind, foot) => vec![fault(kind, 0.0, f64::INFINITY, foot)],
            Injection::Slip => {
                let middle_s = walk.begin_s + 0.5 * walk.long_s;
                vec![fault(Kind::TagSlip, middle_s, f64::INFINITY, LEFT)]
            }
            Injection::Exposure | Injection::Gait(_) | Injection::Input(_) => Vec::new(),
        };
        Faults { list, seed: 1 }
    }
}
