//! Hash of a scene in memory.

pub(super) mod bytes;

use bytes::{floats, numbers, text};

use super::sector::Sector;

/// Hash of what agents and images depend on: levels, Gaussians, reference poses, the recorded walk,
/// areas and edges.
pub(super) fn of_sectors(sectors: &[Sector]) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    for sector in sectors {
        text(&mut hasher, &sector.name);
        for level in sector.levels.iter().flat_map(|levels| levels.iter()) {
            let grid = level.grid;
            numbers(
                &mut hasher,
                &[grid.cell_m, grid.origin_m[0], grid.origin_m[1]],
            );
            numbers(&mut hasher, &[grid.columns as f64, grid.rows as f64]);
            for (_, values) in level.numbers() {
                floats(&mut hasher, values);
            }
            floats(&mut hasher, level.normal.as_flattened());
            let occupancy: Vec<u8> = level.occupancy.iter().map(|v| v.cast_unsigned()).collect();
            hasher.update(&occupancy);
            hasher.update(&level.flags);
        }
        for pose in sector.references.iter() {
            numbers(&mut hasher, &pose.rotation_wxyz());
            numbers(&mut hasher, &pose.translation_m());
        }
        let trajectory = sector.recording.trajectory.iter();
        for pose in trajectory.flat_map(|trajectory| trajectory.poses()) {
            hasher.update(&pose.time_ns.to_le_bytes());
            hasher.update(&[pose.status.code()]);
            numbers(&mut hasher, &pose.world_from_rig.rotation_wxyz());
            numbers(&mut hasher, &pose.world_from_rig.translation_m());
        }
        if let Some(gaussians) = &sector.gaussians {
            gaussians.hash(&mut hasher);
        }
        let area = sector.area;
        numbers(
            &mut hasher,
            [area.min_m, area.max_m, area.height_m].as_flattened(),
        );
        for edge in &sector.edges {
            let transform = edge.to_from_here;
            let q = transform.rotation().quaternion();
            numbers(
                &mut hasher,
                &[edge.to as f64, transform.scale(), q.w, q.i, q.j, q.k],
            );
            numbers(&mut hasher, &transform.translation_m());
            hasher.update(&[u8::from(edge.is_imported)]);
        }
    }
    *hasher.finalize().as_bytes()
}
