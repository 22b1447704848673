//! Output `maps`: grids of every walkable level, for foothold planning.
//!
//! Contract: `maps.json` has the grid of each level, and the folder `level-N` of a level one file
//! for each layer. What no view saw is unknown, not free: numbers are NaN there, the occupancy is
//! [`UNKNOWN`] and the flags are 0. A cell has an elevation where one of [`KNOWN`], [`FILLED`] and
//! [`SAMPLED`] is set, and nowhere else.

mod level;

pub use level::{
    CONTRADICTED, EDGE, FILLED, FREE, KNOWN, MapLevel, OCCUPIED, SAMPLED, UNCERTAIN, UNKNOWN,
};

use serde::{Deserialize, Serialize};

use super::grid::Grid;
use super::{Fault, read_json, write_json};
use crate::draft::Draft;
use crate::error::BundleError;
use crate::npy::array::{self, Element};
use crate::scene::OutputReader;

const FILE: &str = "maps.json";

/// The grids of the levels, in order.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapIndex {
    /// A grid per level.
    pub levels: Vec<Grid>,
}

impl MapIndex {
    fn check(&self) -> Result<(), Fault> {
        let mut levels = self.levels.iter().enumerate();
        levels.try_for_each(|(number, grid)| grid.check(&format!("level {number}")))
    }
}

fn path(level: usize, layer: &str) -> String {
    format!("level-{level}/{layer}.npy")
}

/// Writes maps.
///
/// # Errors
/// [`BundleError::Refused`] for layers with another number of values than cells, and for values
/// that a layer does not allow; [`BundleError::Io`].
///
/// ```
/// use scene_bundle::outputs::grid::Grid;
/// use scene_bundle::outputs::maps::{self, MapLevel};
/// use scene_bundle::outputs;
/// # use scene_bundle::Bundle;
/// # let folder = tempfile::tempdir()?;
/// # let provenance = scene_bundle::Provenance {
/// #     session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
/// #     handoff_blake3: "ab".repeat(32),
/// #     judgement: None,
/// #     rig: scene_bundle::RigRevision { name: "chest".to_owned(), revision: "B".to_owned() },
/// #     program: "example".to_owned(),
/// #     program_version: "1.0".to_owned(),
/// #     started_civil_ns: 1_790_000_000_000_000_000,
/// #     ended_civil_ns: None,
/// # };
/// # let record = scene_bundle::Record {
/// #     stage: "example".to_owned(),
/// #     stage_version: 1,
/// #     settings: serde_json::json!({ "step": 2 }),
/// #     inputs: std::collections::BTreeMap::new(),
/// # };
/// # let bundle = Bundle::create_or_open(&folder.path().join("walk.scene"), provenance)?;
///
/// let grid = Grid { cell_m: 0.04, origin_m: [1.0, 2.0], columns: 3, rows: 2 };
/// let mut level = MapLevel::unknown(grid);
/// // One cell was seen: row 1, column 2.
/// let cell = 5;
/// level.elevation[cell] = 0.25;
/// level.occupancy[cell] = maps::FREE;
/// level.flags[cell] = maps::KNOWN;
/// let draft = bundle.begin(outputs::MAPS)?;
/// maps::write(&draft, &[level])?;
/// draft.commit(record)?;
///
/// let reader = bundle.scene().output(outputs::MAPS)?;
/// let index = maps::read_index(&reader)?;
/// let level = maps::read_level(&reader, &index, 0)?;
/// assert_eq!((level.elevation[cell], level.occupancy[0]), (0.25, maps::UNKNOWN));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write(draft: &Draft, levels: &[MapLevel]) -> Result<(), BundleError> {
    let index = MapIndex {
        levels: levels.iter().map(|level| level.grid).collect(),
    };
    index.check().map_err(|fault| fault.refused(draft, FILE))?;
    for (number, level) in levels.iter().enumerate() {
        let checked = level.check();
        checked.map_err(|(layer, fault)| fault.refused(draft, &path(number, layer)))?;
        let shape = [level.grid.rows, level.grid.columns];
        for (layer, values) in level.numbers() {
            draft.write(&path(number, layer), &array::encode(&shape, values))?;
        }
        let normals = array::encode(&[shape[0], shape[1], 3], level.normal.as_flattened());
        draft.write(&path(number, level::NORMAL), &normals)?;
        let occupancy = array::encode(&shape, &level.occupancy);
        draft.write(&path(number, level::OCCUPANCY), &occupancy)?;
        for (layer, values) in [(level::VIEWS, &level.views), (level::FLAGS, &level.flags)] {
            draft.write(&path(number, layer), &array::encode(&shape, values))?;
        }
    }
    write_json(draft, FILE, &index)
}

/// Reads the grids of the levels.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read_index(reader: &OutputReader) -> Result<MapIndex, BundleError> {
    let index: MapIndex = read_json(reader, FILE)?;
    let checked = index.check();
    checked.map_err(|fault| fault.malformed(reader, FILE))?;
    Ok(index)
}

/// Reads all layers of a level.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`], also for a level that the index does not
/// have.
pub fn read_level(
    reader: &OutputReader,
    index: &MapIndex,
    number: usize,
) -> Result<MapLevel, BundleError> {
    let Some(grid) = index.levels.get(number) else {
        let found = format!("level {number} of {}", index.levels.len());
        return Err(Fault::new("levels", found, "a level of the index").malformed(reader, FILE));
    };
    let shape = [grid.rows, grid.columns];
    let mut level = MapLevel::empty(*grid);
    for (layer, values) in level.numbers_mut() {
        *values = values_of(reader, number, layer, &shape)?;
    }
    let normals = values_of::<f32>(reader, number, level::NORMAL, &[shape[0], shape[1], 3])?;
    level.normal = normals
        .chunks_exact(3)
        .map(|n| [n[0], n[1], n[2]])
        .collect();
    level.occupancy = values_of(reader, number, level::OCCUPANCY, &shape)?;
    level.views = values_of(reader, number, level::VIEWS, &shape)?;
    level.flags = values_of(reader, number, level::FLAGS, &shape)?;
    let checked = level.check();
    checked.map_err(|(layer, fault)| fault.malformed(reader, &path(number, layer)))?;
    Ok(level)
}

fn values_of<T: Element>(
    reader: &OutputReader,
    level: usize,
    layer: &str,
    shape: &[usize],
) -> Result<Vec<T>, BundleError> {
    let path = path(level, layer);
    array::decode(&reader.read(&path)?, shape, &reader.file_path(&path))
}
