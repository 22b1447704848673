//! Generation 2: `sequence.json` with the arrays of each sector.
//!
//! Beogym's arrays have neither origin nor cell size, their rows are along x, and holes were filled
//! without a mark. So the file has to state origin and cell size, and every height is flagged as
//! uncertain.

use std::path::Path;
use std::sync::Arc;

use scene_bundle::outputs::grid::Grid;
use scene_bundle::outputs::maps::{FREE, KNOWN, MapLevel, OCCUPIED, UNCERTAIN};
use serde::Deserialize;

use super::maps::normals;
use super::numbers::array;
use super::{BeogymConfig, Sector, Similarity, read, splats, text, wrong};
use crate::error::SimulationError;
use crate::scene::data::{Missing, SceneData};
use crate::scene::gaussians::GaussianSource;
use crate::scene::measures::complete;
use crate::scene::sector::{Area, Recording, SectorEdge};
use crate::scene::{graph, hash};

pub(super) const FILE: &str = "sequence.json";
const FORMAT: &str = "beogym-sequence";

/// Sigma of heights whose origin is not known, m.
const SIGMA_M: f32 = 0.1;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Sequence {
    format: String,
    name: String,
    sectors: Vec<SectorEntry>,
    #[serde(default)]
    edges: Vec<EdgeEntry>,
}

/// A sector. Paths are relative to the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SectorEntry {
    name: Name,
    gaussians: Option<String>,
    elevation: Option<String>,
    occupancy: Option<String>,
    /// Center of the first cell, x and y of the sector, m.
    origin_m: Option<[f64; 2]>,
    cell_m: Option<f64>,
}

/// Beogym names sectors by numbers here and texts there.
#[derive(Deserialize)]
#[serde(untagged)]
enum Name {
    Number(u64),
    Text(String),
}

/// An edge, directed; its reverse follows from it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EdgeEntry {
    from: Name,
    to: Name,
    to_from_here: Similarity,
}

impl Name {
    fn text(&self) -> String {
        match self {
            Self::Number(number) => number.to_string(),
            Self::Text(text) => text.clone(),
        }
    }
}

pub(super) fn open(folder: &Path, config: &BeogymConfig) -> Result<SceneData, SimulationError> {
    let path = folder.join(FILE);
    let sequence: Sequence = serde_json::from_str(&text(&path)?).map_err(|e| {
        wrong(
            &path,
            e.to_string(),
            "a sequence as the reference page has it",
        )
    })?;
    if sequence.format != FORMAT {
        return Err(wrong(
            &path,
            format!("format {:?}", sequence.format),
            FORMAT,
        ));
    }
    let mut missing = Vec::new();
    let mut sectors = Vec::new();
    for entry in &sequence.sectors {
        let name = entry.name.text();
        let level = level(folder, &path, entry)?;
        let gaussians = entry.gaussians.as_ref().map(|file| {
            let file = folder.join(file);
            let scene = splats::read(&read(&file)?, &file, &Similarity::identity(), config)?;
            GaussianSource::new(scene, false)
        });
        for (is_missing, output, features) in [
            (
                level.is_none(),
                "elevation",
                "agents on the ground, starts in free space",
            ),
            (
                gaussians.is_none(),
                "gaussians",
                "images and depth of cameras",
            ),
        ] {
            if is_missing {
                missing.push(Missing {
                    place: name.clone(),
                    output: output.to_owned(),
                    features: features.to_owned(),
                });
            }
        }
        let area = level
            .as_ref()
            .map_or(Area::new([0.0; 2], [0.0; 2]), |level| {
                let (corner, size) = (level.grid.corner_m(), level.grid.size_m());
                Area::new(corner, [0, 1].map(|k| corner[k] + size[k]))
            });
        sectors.push(Sector {
            name,
            levels: level.map(|level| Arc::new(vec![level])),
            area,
            references: Arc::default(),
            gaussians: gaussians.transpose()?,
            recording: Arc::new(Recording::default()),
            edges: Vec::new(),
        });
    }
    for entry in &sequence.edges {
        let index = |name: &Name| {
            let found = sectors.iter().position(|sector| sector.name == name.text());
            let error = || {
                wrong(
                    &path,
                    format!("an edge with the sector {:?}", name.text()),
                    "one of its sectors",
                )
            };
            found.ok_or_else(error)
        };
        let [from, to] = [index(&entry.from)?, index(&entry.to)?];
        let edge = SectorEdge {
            to,
            to_from_here: entry.to_from_here,
            overlap: sectors[from].area,
            residual_m: None,
            is_imported: true,
        };
        let back = graph::reverse(from, &edge);
        sectors[from].edges.push(edge);
        sectors[to].edges.push(back);
    }
    let hash = hash::of_sectors(&sectors);
    SceneData::with_hash(&sequence.name, sectors, hash, missing)
}

/// Whether an array has the values of an occupancy map, some of each.
fn is_occupancy(values: &[f64]) -> bool {
    let known = || values.iter().filter(|value| value.is_finite());
    let is_binary = known().all(|value| *value == 0.0 || *value == 1.0);
    is_binary
        && [0.0, 1.0]
            .iter()
            .all(|value| known().any(|known| known == value))
}

/// The map of a sector.
fn level(
    folder: &Path,
    path: &Path,
    entry: &SectorEntry,
) -> Result<Option<MapLevel>, SimulationError> {
    let Some(elevation) = &entry.elevation else {
        return Ok(None);
    };
    let (Some(origin_m), Some(cell_m)) = (entry.origin_m, entry.cell_m) else {
        let found = format!("no origin_m or cell_m of sector {}", entry.name.text());
        let expected = "both: arrays of Beogym do not say where they are";
        return Err(wrong(path, found, expected));
    };
    let elevation = folder.join(elevation);
    let heights = array(&read(&elevation)?, &elevation)?;
    if is_occupancy(&heights.values) {
        let found = "heights of 0 and 1 only".to_owned();
        return Err(wrong(
            &elevation,
            found,
            "heights in m, not an occupancy map",
        ));
    }
    // Rows of the array are along x.
    let grid = Grid {
        cell_m,
        origin_m,
        columns: heights.rows,
        rows: heights.columns,
    };
    if !(cell_m > 0.0 && cell_m.is_finite() && origin_m.iter().all(|v| v.is_finite())) {
        let found = format!("cells of {cell_m} m from {origin_m:?}");
        return Err(wrong(path, found, "finite numbers, a size above 0"));
    }
    let occupancy = match &entry.occupancy {
        Some(file) => {
            let file = folder.join(file);
            let occupancy = array(&read(&file)?, &file)?;
            if [occupancy.rows, occupancy.columns] != [heights.rows, heights.columns] {
                let found = format!("{} x {} cells", occupancy.rows, occupancy.columns);
                let expected =
                    format!("{} x {} as of the elevation", heights.rows, heights.columns);
                return Err(wrong(&file, found, &expected));
            }
            Some(occupancy)
        }
        None => None,
    };
    let mut level = MapLevel::unknown(grid);
    for cell in 0..grid.cells() {
        let (x, y) = (cell % grid.columns, cell / grid.columns);
        let index = x * heights.columns + y;
        let height = heights.values[index] as f32;
        if !height.is_finite() {
            continue;
        }
        level.elevation[cell] = height;
        (level.lower[cell], level.upper[cell]) = (height, height);
        level.sigma[cell] = SIGMA_M;
        level.clearance[cell] = f32::INFINITY;
        level.views[cell] = 1;
        level.flags[cell] = KNOWN | UNCERTAIN;
        let is_occupied = occupancy.as_ref().is_some_and(|of| of.values[index] != 0.0);
        level.occupancy[cell] = if is_occupied { OCCUPIED } else { FREE };
    }
    normals(&mut level);
    complete(&mut level);
    Ok(Some(level))
}
