//! Output `collision`: convex parts for physics, and height layers for ground that is not plane.
//!
//! Contract: the collision surface at a place is the higher one of the parts and the triangles of
//! the layer of a level; the layer runs on a few millimetres below the parts, and lower beside
//! steps. Where nothing was seen there is neither. `collision.json` has the parts, the grids of the
//! layers and the report; the heights are in `layer-N.npy`. Parts refer to planes of the output
//! `terrain` by their index.

use serde::{Deserialize, Serialize};

use super::grid::Grid;
use super::{Fault, read_json, write_compact_json};
use crate::draft::Draft;
use crate::error::BundleError;
use crate::npy::array;
use crate::scene::OutputReader;

const FILE: &str = "collision.json";

/// Collision geometry of the ground and of what stands on it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Collision {
    /// Convex parts.
    pub parts: Vec<ConvexPart>,
    /// A layer per level, in the order of the output `maps`.
    pub layers: Vec<HeightLayer>,
    /// What they cost and how well they stand for the ground.
    pub report: CollisionReport,
}

/// A convex part: the hull of its vertices.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConvexPart {
    /// What it is a part of.
    pub kind: PartKind,
    /// The plane of its surface, an index in the output `terrain`.
    pub plane: Option<u32>,
    /// Corners in the world, m.
    pub vertices_m: Vec<[f64; 3]>,
    /// Triangles of its faces, counterclockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// What a part is a part of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PartKind {
    /// Ground that can carry a foot.
    Ground,
    /// A steep plane, such as a riser.
    Wall,
    /// A thing that is neither plane nor ground.
    Obstacle,
}

impl PartKind {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Ground, Self::Wall, Self::Obstacle];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ground => "ground",
            Self::Wall => "wall",
            Self::Obstacle => "obstacle",
        }
    }
}

/// Heights of ground of a level. Between four of them are two triangles; the edge between both goes
/// from the cell of least x and y to that of greatest x and y, as in MuJoCo's height fields.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightLayer {
    /// Its cells. Heights are at their centers.
    pub grid: Grid,
    /// Heights, m, row-major; NaN where unknown.
    pub heights_m: Vec<f32>,
}

/// What parts cost and how well they stand for the ground.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CollisionReport {
    /// Number of parts; each height layer is one.
    pub parts: u64,
    /// Parts per 100 m2 of ground.
    pub parts_per_100_m2: f64,
    /// Heights of the collision surface above the maps, at places of free cells and between them.
    pub height_errors: HeightErrors,
    /// Volume of the collision surface above the maps, m3.
    pub volume_added_m3: f64,
    /// Volume that the collision surface lacks, m3.
    pub volume_missing_m3: f64,
}

/// Quantiles of absolute errors of heights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeightErrors {
    /// Number of errors.
    pub count: u64,
    /// Half of the errors are at most this, m.
    pub median_m: f64,
    /// 95 % are at most this, m.
    pub p95_m: f64,
    /// The largest, m.
    pub max_m: f64,
    /// Mean with sign, m.
    pub mean_m: f64,
}

/// `collision.json`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Content {
    parts: Vec<ConvexPart>,
    layers: Vec<Grid>,
    report: CollisionReport,
}

impl ConvexPart {
    fn check(&self, place: &str) -> Result<(), Fault> {
        if self
            .vertices_m
            .as_flattened()
            .iter()
            .any(|v| !v.is_finite())
        {
            let found = "a vertex that is not finite".to_owned();
            return Err(Fault::new(place, found, "finite numbers"));
        }
        let (vertices, triangles) = (self.vertices_m.len(), self.triangles.len());
        if vertices < 4 || triangles < 4 {
            let found = format!("{vertices} vertices and {triangles} triangles");
            return Err(Fault::new(place, found, "4 or more of each"));
        }
        let mut indices = self.triangles.as_flattened().iter();
        match indices.find(|index| **index as usize >= vertices) {
            Some(index) => {
                let found = format!("vertex {index} of {vertices}");
                Err(Fault::new(place, found, "the index of a vertex"))
            }
            None => Ok(()),
        }
    }
}

impl CollisionReport {
    fn check(&self) -> Result<(), Fault> {
        let errors = &self.height_errors;
        let numbers = [
            self.parts_per_100_m2,
            errors.median_m,
            errors.p95_m,
            errors.max_m,
            errors.mean_m,
            self.volume_added_m3,
            self.volume_missing_m3,
        ];
        match numbers.iter().find(|v| !v.is_finite()) {
            Some(number) => {
                let found = format!("a number that is {number}");
                Err(Fault::new("report", found, "finite numbers"))
            }
            None => Ok(()),
        }
    }
}

impl Content {
    fn check(&self) -> Result<(), Fault> {
        for (number, part) in self.parts.iter().enumerate() {
            part.check(&format!("part {number}"))?;
        }
        for (number, grid) in self.layers.iter().enumerate() {
            grid.check(&format!("layer {number}"))?;
        }
        self.report.check()
    }
}

fn check_heights(heights: &[f32], cells: usize) -> Result<(), Fault> {
    if heights.len() != cells {
        let found = format!("{} of {cells} cells", heights.len());
        return Err(Fault::new("heights", found, "one for each cell"));
    }
    match heights.iter().position(|v| v.is_infinite()) {
        Some(cell) => {
            let found = format!("{} m", heights[cell]);
            let expected = "a finite number, or not-a-number where it is not known";
            Err(Fault::new(&format!("cell {cell}"), found, expected))
        }
        None => Ok(()),
    }
}

fn layer_path(number: usize) -> String {
    format!("layer-{number}.npy")
}

/// Writes collision geometry.
///
/// # Errors
/// [`BundleError::Refused`] for numbers that are not finite, indices out of range, and layers with
/// another number of heights than cells; [`BundleError::Io`].
///
/// ```
/// use scene_bundle::outputs::collision::{self, Collision, ConvexPart, PartKind};
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
/// let stone = ConvexPart {
///     kind: PartKind::Obstacle,
///     plane: None,
///     vertices_m: vec![[0.0; 3], [0.2, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.2]],
///     triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
/// };
/// let geometry = Collision { parts: vec![stone], ..Collision::default() };
/// let draft = bundle.begin(outputs::COLLISION)?;
/// collision::write(&draft, &geometry)?;
/// draft.commit(record)?;
///
/// let reader = bundle.scene().output(outputs::COLLISION)?;
/// assert_eq!(collision::read(&reader)?, geometry);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write(draft: &Draft, collision: &Collision) -> Result<(), BundleError> {
    let content = Content {
        parts: collision.parts.clone(),
        layers: collision.layers.iter().map(|layer| layer.grid).collect(),
        report: collision.report,
    };
    content
        .check()
        .map_err(|fault| fault.refused(draft, FILE))?;
    for (number, layer) in collision.layers.iter().enumerate() {
        let path = layer_path(number);
        let checked = check_heights(&layer.heights_m, layer.grid.cells());
        checked.map_err(|fault| fault.refused(draft, &path))?;
        let shape = [layer.grid.rows, layer.grid.columns];
        draft.write(&path, &array::encode(&shape, &layer.heights_m))?;
    }
    write_compact_json(draft, FILE, &content)
}

/// Reads collision geometry.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read(reader: &OutputReader) -> Result<Collision, BundleError> {
    let content: Content = read_json(reader, FILE)?;
    let checked = content.check();
    checked.map_err(|fault| fault.malformed(reader, FILE))?;
    let mut layers = Vec::new();
    for (number, grid) in content.layers.into_iter().enumerate() {
        let path = layer_path(number);
        let shape = [grid.rows, grid.columns];
        let heights_m = array::decode(&reader.read(&path)?, &shape, &reader.file_path(&path))?;
        let checked = check_heights(&heights_m, grid.cells());
        checked.map_err(|fault| fault.malformed(reader, &path))?;
        layers.push(HeightLayer { grid, heights_m });
    }
    Ok(Collision {
        parts: content.parts,
        layers,
        report: content.report,
    })
}
