//! The parts of soles at rest that bear.
//!
//! Contract: a patch for each contact, on the ground of depth without the ramps below steps.

use cad_transforms::rig::Foot;
use scene_bundle::outputs::contacts::{ContactPatch, FootContact};
use scene_bundle::outputs::rig::RigModel;
use scene_bundle::outputs::terrain::{Terrain, TerrainMesh};
use terrain::edges::without_ramps;
use terrain::ground::Ground;
use terrain::{PatchConfig, RampConfig, contact_patch};

use crate::pipeline::stages::soles::outline;
use crate::pipeline::stages::terrain::surface::of_files;

/// Patches of contacts, in their order.
pub(super) fn patches(
    rig: &RigModel,
    contacts: &[FootContact],
    terrain: &Terrain,
    ground: TerrainMesh,
) -> Vec<ContactPatch> {
    if contacts.is_empty() {
        return Vec::new();
    }
    let (dense, planes, edges) = of_files(terrain, ground);
    let mesh = without_ramps(&dense, &planes, &edges, &RampConfig::default());
    drop((dense, planes));
    let ground = Ground::new(&mesh);
    let outlines = Foot::ALL.map(|foot| outline(rig, foot));
    let config = PatchConfig::default();
    let patch = |own: &FootContact| {
        let outline = &outlines[own.foot as usize];
        let [_, _, height_sigma_m, ..] = own.covariance.sigmas();
        let place = &own.world_from_foot;
        let patch = contact_patch(&ground, &edges, place, outline, height_sigma_m, &config);
        ContactPatch {
            outline_m: patch.outline_m,
            area_share: patch.area_share as f32,
            ground_share: patch.ground_share as f32,
            gap_m: patch.gap_m.map(|gap_m| gap_m as f32),
        }
    };
    contacts.iter().map(patch).collect()
}
