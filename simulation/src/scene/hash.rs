//! Hash of a scene in memory.

use super::sector::Sector;

/// Hash of what agents and images depend on: levels, Gaussians, reference poses, areas and edges.
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

fn text(hasher: &mut blake3::Hasher, text: &str) {
    hasher.update(&(text.len() as u64).to_le_bytes());
    hasher.update(text.as_bytes());
}

fn numbers(hasher: &mut blake3::Hasher, values: &[f64]) {
    for value in values {
        hasher.update(&value.to_le_bytes());
    }
}

/// Hashes f32 numbers, in blocks rather than one by one.
pub(super) fn floats(hasher: &mut blake3::Hasher, values: &[f32]) {
    for block in values.chunks(4096) {
        let bytes: Vec<u8> = block.iter().flat_map(|value| value.to_le_bytes()).collect();
        hasher.update(&bytes);
    }
}
