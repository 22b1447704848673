//! Key figures of the ground: mesh, maps, parts for physics.

use scene_bundle::outputs::collision::{self, PartKind};
use scene_bundle::outputs::maps;
use scene_bundle::outputs::terrain::{self, MeshDetail};
use scene_bundle::{BundleError, OutputReader};
use serde_json::{Value, json};

pub(super) fn of_terrain(reader: &OutputReader) -> Result<Value, BundleError> {
    let terrain = terrain::read(reader)?;
    let mesh = terrain::read_mesh(reader, MeshDetail::Simplified, &terrain)?;
    let area: f64 = terrain.planes.iter().map(|plane| plane.area_m2).sum();
    let steps = terrain.edges.iter().filter(|edge| edge.step.is_some());
    Ok(json!({
        "voxel_m": terrain.voxel_m,
        "simplified_vertices": mesh.positions.len(),
        "simplified_triangles": mesh.triangles.len(),
        "planes": terrain.planes.len(),
        "plane_area_m2": rounded(area),
        "edges": terrain.edges.len(),
        "steps": steps.count(),
    }))
}

pub(super) fn of_maps(reader: &OutputReader) -> Result<Value, BundleError> {
    let index = maps::read_index(reader)?;
    let (mut sizes, mut free_m2, mut occupied_m2) = (Vec::new(), 0.0, 0.0);
    for (number, grid) in index.levels.iter().enumerate() {
        sizes.push(format!("{}x{}", grid.columns, grid.rows));
        let level = maps::read_level(reader, &index, number)?;
        for (state, area_m2) in [
            (maps::FREE, &mut free_m2),
            (maps::OCCUPIED, &mut occupied_m2),
        ] {
            let count = level.occupancy.iter().filter(|value| **value == state);
            *area_m2 += count.count() as f64 * grid.cell_m * grid.cell_m;
        }
    }
    Ok(json!({
        "levels": index.levels.len(),
        "cells": sizes.join(", "),
        "free_m2": rounded(free_m2),
        "occupied_m2": rounded(occupied_m2),
    }))
}

pub(super) fn of_collision(reader: &OutputReader) -> Result<Value, BundleError> {
    let collision = collision::read(reader)?;
    let count = |kind: PartKind| {
        let parts = collision.parts.iter().filter(|part| part.kind == kind);
        format!("{} {}", parts.count(), kind.name())
    };
    let report = &collision.report;
    Ok(json!({
        "parts": PartKind::ALL.map(count).join(", "),
        "height_layers": collision.layers.len(),
        "parts_per_100_m2": rounded(report.parts_per_100_m2),
        "height_error_median_m": rounded(report.height_errors.median_m),
        "height_error_p95_m": rounded(report.height_errors.p95_m),
        "height_error_max_m": rounded(report.height_errors.max_m),
    }))
}

/// To a ten-thousandth.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
