//! Scenes of several bundles and imported recordings, with edges between them: a file in JSON.

pub(super) mod format;

use std::path::Path;

use super::beogym;
use super::bundle::{self, BundleConfig};
use super::data::SceneData;
use super::graph;
use super::sector::{Area, SectorEdge};
use crate::error::SimulationError;
use format::{FORMAT, MAX_BYTES, SceneFile, VERSION};

/// Path of the scene file in the folder of a scene of several recordings.
pub(super) const IN_FOLDER: &str = "scene-graph.json";

/// Opens a scene file and everything it names.
pub(super) fn open(path: &Path, config: &BundleConfig) -> Result<SceneData, SimulationError> {
    let wrong = |found: String, expected: &str| SimulationError::Scene {
        place: format!("scene file {}", path.display()),
        found,
        expected: expected.to_owned(),
    };
    let size = std::fs::metadata(path).map(|metadata| metadata.len());
    let size = size.map_err(|error| wrong(error.to_string(), "a readable file"))?;
    if size > MAX_BYTES {
        return Err(wrong(format!("{size} bytes"), "at most 16 MiB"));
    }
    let text = std::fs::read(path).map_err(|error| wrong(error.to_string(), "a readable file"))?;
    let file: SceneFile = serde_json::from_slice(&text).map_err(|error| {
        wrong(
            error.to_string(),
            "a scene file as the reference page has it",
        )
    })?;
    if file.format != FORMAT || file.version != VERSION {
        let found = format!("format {:?} of version {}", file.format, file.version);
        return Err(wrong(found, "paws-scene-graph of version 1"));
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut hasher = blake3::Hasher::new();
    hasher.update(&text);
    let mut sectors = Vec::new();
    let mut missing = Vec::new();
    for entry in &file.recordings {
        let part = match (&entry.bundle, &entry.beogym) {
            (Some(path), None) => bundle::open(&folder.join(path), config)?,
            (None, Some(path)) => beogym::open(&folder.join(path), &Default::default())?,
            _ => {
                let found = format!("recording {}", entry.name);
                return Err(wrong(found, "either a bundle or a folder of Beogym"));
            }
        };
        hasher.update(part.hash());
        let first = sectors.len();
        let area = entry.area(part.sectors.len()).map_err(|found| {
            let expected = "both corners in order, for a recording of one sector";
            wrong(format!("recording {}: {found}", entry.name), expected)
        })?;
        for mut sector in part.sectors {
            sector.area = area.unwrap_or(sector.area);
            sector.name = renamed(&sector.name, &part.name, &entry.name);
            for edge in &mut sector.edges {
                edge.to += first;
            }
            sectors.push((first, sector));
        }
        missing.extend(part.missing);
    }
    let index = |name: &str| {
        let found = sectors.iter().position(|(_, sector)| sector.name == name);
        found.ok_or_else(|| {
            let names: Vec<&str> = sectors.iter().map(|(_, of)| of.name.as_str()).collect();
            let expected = format!("one of {}", names.join(", "));
            wrong(format!("an edge with the sector {name:?}"), &expected)
        })
    };
    let mut edges = Vec::new();
    for entry in &file.edges {
        let [from, to] = [index(&entry.from)?, index(&entry.to)?];
        let overlap = Area::new(entry.overlap_min_m, entry.overlap_max_m);
        if (0..2).any(|k| overlap.min_m[k] > overlap.max_m[k]) {
            let found = format!(
                "edge from {} to {} with an overlap from {:?} to {:?}",
                entry.from, entry.to, overlap.min_m, overlap.max_m
            );
            return Err(wrong(found, "corners in order"));
        }
        let edge = SectorEdge {
            to,
            to_from_here: entry.to_from_here,
            overlap,
            residual_m: entry.residual_m,
            is_imported: sectors[from].0 != sectors[to].0,
        };
        let is_listed = |from: &str, to: &str| {
            file.edges
                .iter()
                .any(|other| other.from == from && other.to == to)
        };
        if !is_listed(&entry.to, &entry.from) {
            edges.push((to, graph::reverse(from, &edge)));
        }
        edges.push((from, edge));
    }
    for (from, edge) in edges {
        sectors[from].1.edges.push(edge);
    }
    let sectors = sectors.into_iter().map(|(_, sector)| sector).collect();
    SceneData::with_hash(&file.name, sectors, *hasher.finalize().as_bytes(), missing)
}

/// The name of a sector in the scene: that of its recording, with its own one behind it where the
/// recording has several.
fn renamed(sector: &str, part: &str, entry: &str) -> String {
    match sector.strip_prefix(part) {
        Some("") => entry.to_owned(),
        Some(rest) if rest.starts_with('/') => format!("{entry}{rest}"),
        _ => format!("{entry}/{sector}"),
    }
}

#[cfg(test)]
mod tests;
