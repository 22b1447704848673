//! Soles of the wearer's shoes as the rig file has them, or usual ones.

use ::feet::FootConfig;
use ::feet::swing::SoleEdges;
use cad_transforms::rig::Foot;
use scene_bundle::outputs::rig::{RigModel, RigShoe};

/// Half of the width of a sole without outline, m.
const USUAL_HALF_WIDTH_M: f64 = 0.05;

pub(super) fn shoe(rig: &RigModel, foot: Foot) -> Option<&RigShoe> {
    rig.shoes.iter().find(|shoe| shoe.foot == foot)
}

/// Front and rear edge of a sole; of a usual one where its outline is unknown.
pub(super) fn edges(rig: &RigModel, foot: Foot) -> SoleEdges {
    let x = || known_outline(rig, foot).map(|outline| outline.iter().map(|[x, _]| *x));
    let usual = FootConfig::default();
    SoleEdges {
        heel_m: x().map_or(usual.heel_m, |x| -x.fold(f64::INFINITY, f64::min)),
        toe_m: x().map_or(usual.toe_m, |x| x.fold(f64::NEG_INFINITY, f64::max)),
    }
}

/// Outline of a sole in the frame of the foot, m; that of a usual one is a rectangle.
pub(crate) fn outline(rig: &RigModel, foot: Foot) -> Vec<[f64; 2]> {
    if let Some(outline) = known_outline(rig, foot) {
        return outline.to_vec();
    }
    let FootConfig { heel_m, toe_m, .. } = FootConfig::default();
    [(-heel_m, -1.0), (toe_m, -1.0), (toe_m, 1.0), (-heel_m, 1.0)]
        .map(|(x, side)| [x, side * USUAL_HALF_WIDTH_M])
        .to_vec()
}

fn known_outline(rig: &RigModel, foot: Foot) -> Option<&[[f64; 2]]> {
    let outline = shoe(rig, foot).map(|shoe| shoe.outline_m.as_slice());
    outline.filter(|outline| !outline.is_empty())
}
