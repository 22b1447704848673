//! Collision geometry as a model of MuJoCo (MJCF).
//!
//! Contract: a folder with `model.xml` and a file of heights for each layer. Each convex part is a
//! mesh geom of its vertices alone, whose hull MuJoCo collides; each height layer is a height field
//! with its vertices at the centers of the cells. Coordinates are those of the world of the bundle,
//! z up, in metres. All geoms are of the world body: add bodies to the model, or include it.
//!
//! A height field cannot have holes. Unknown cells are [`UNKNOWN_BELOW_M`] below the lowest known
//! height of their layer: what leaves the known ground falls visibly, rather than walking on ground
//! that nobody saw. Between a known and an unknown cell there is a steep slope of one cell.

use std::fmt::Write;
use std::path::Path;

use super::error::ExportError;
use super::folder::NewFolder;
use super::summary::Summary;
use crate::outputs::COLLISION;
use crate::outputs::collision::{self, Collision, ConvexPart, HeightLayer, PartKind};
use crate::scene::Scene;

/// Depth of unknown cells below the lowest known one, m.
const UNKNOWN_BELOW_M: f64 = 1.0;
/// Thickness of a height field below its lowest height, m. It must be positive.
const BASE_M: f64 = 0.1;
/// Height range of a height field that is level, m. It must be positive.
const MIN_RANGE_M: f64 = 1e-3;
/// Volume below which a part is flat, m3: MuJoCo refuses to compile flat meshes.
pub(super) const MIN_VOLUME_M3: f64 = 1e-9;

pub(super) fn export(scene: &Scene, out: &Path) -> Result<Summary, ExportError> {
    let collision = collision::read(&scene.output(COLLISION)?)?;
    let mut model = Model::default();
    let folder = NewFolder::begin(out)?;
    for (number, layer) in collision.layers.iter().enumerate() {
        if let Some(bytes) = model.add_layer(number, layer) {
            folder.write(&layer_path(number), &bytes)?;
        }
    }
    for (number, part) in collision.parts.iter().enumerate() {
        model.add_part(number, part);
    }
    folder.write("model.xml", model.to_text().as_bytes())?;
    folder.finish()?;
    Ok(Summary {
        description: format!(
            "{} convex parts and {} height fields",
            model.parts, model.layers
        ),
        notes: notes(&collision),
        lost: model.lost,
    })
}

fn layer_path(number: usize) -> String {
    format!("layer-{number}.bin")
}

fn notes(collision: &Collision) -> Vec<String> {
    let mut notes =
        vec!["planes and triangles of parts are left out: MuJoCo collides hulls".to_owned()];
    if !collision.layers.is_empty() {
        notes.push(format!(
            "a height field has no holes: unknown cells are {UNKNOWN_BELOW_M} m below the lowest known one"
        ));
    }
    notes
}

/// The model as it grows.
#[derive(Default)]
struct Model {
    assets: String,
    geoms: String,
    parts: usize,
    layers: usize,
    lost: Vec<String>,
}

impl Model {
    /// Adds a height field and gives its file; none for a layer of which nothing is known.
    fn add_layer(&mut self, number: usize, layer: &HeightLayer) -> Option<Vec<u8>> {
        let heights = layer.heights_m.iter().copied().filter(|v| !v.is_nan());
        let lowest = f64::from(heights.clone().reduce(f32::min)?);
        let highest = f64::from(heights.reduce(f32::max)?);
        let grid = &layer.grid;
        if grid.columns < 2 || grid.rows < 2 {
            self.lost.push(format!(
                "layer {number} of {} by {} cells: a height field has two or more each way",
                grid.columns, grid.rows
            ));
            return None;
        }
        let has_unknown = layer.heights_m.iter().any(|v| v.is_nan());
        let floor = lowest - if has_unknown { UNKNOWN_BELOW_M } else { 0.0 };
        let range = (highest - floor).max(MIN_RANGE_M);
        // Vertices are at the centers of cells.
        let [radius_x, radius_y] =
            [grid.columns, grid.rows].map(|count| 0.5 * (count - 1) as f64 * grid.cell_m);
        let [x, y] = [grid.origin_m[0] + radius_x, grid.origin_m[1] + radius_y];
        // Writing to a string does not fail.
        let _ = writeln!(
            self.assets,
            "    <hfield name=\"layer_{number}\" file=\"{}\" size=\"{radius_x} {radius_y} {range} {BASE_M}\"/>",
            layer_path(number)
        );
        let _ = writeln!(
            self.geoms,
            "    <geom name=\"layer_{number}\" class=\"layer\" hfield=\"layer_{number}\" pos=\"{x} {y} {floor}\"/>"
        );
        self.layers += 1;
        // Numbers of rows and columns, then shares of the range, the row of least y first.
        let mut bytes = Vec::with_capacity(8 + 4 * grid.cells());
        bytes.extend((grid.rows as i32).to_le_bytes());
        bytes.extend((grid.columns as i32).to_le_bytes());
        for height in &layer.heights_m {
            let share = match height.is_nan() {
                true => 0.0,
                false => (f64::from(*height) - floor) / range,
            };
            bytes.extend((share as f32).to_le_bytes());
        }
        Some(bytes)
    }

    fn add_part(&mut self, number: usize, part: &ConvexPart) {
        let volume = volume_m3(part);
        if volume < MIN_VOLUME_M3 {
            self.lost.push(format!(
                "part {number} of {volume:e} m3: a mesh that is flat cannot be compiled"
            ));
            return;
        }
        let _ = write!(self.assets, "    <mesh name=\"part_{number}\" vertex=\"");
        for (i, [x, y, z]) in part.vertices_m.iter().enumerate() {
            let blank = if i == 0 { "" } else { "  " };
            let _ = write!(self.assets, "{blank}{x} {y} {z}");
        }
        let _ = writeln!(self.assets, "\"/>");
        let kind = part.kind.name();
        let _ = writeln!(
            self.geoms,
            "    <geom name=\"{kind}_{number}\" class=\"{kind}\" mesh=\"part_{number}\"/>"
        );
        self.parts += 1;
    }

    fn to_text(&self) -> String {
        let mut classes = String::new();
        for kind in PartKind::ALL {
            let color = match kind {
                PartKind::Ground => "0.55 0.6 0.5 1",
                PartKind::Wall => "0.6 0.55 0.5 1",
                PartKind::Obstacle => "0.65 0.45 0.4 1",
            };
            let name = kind.name();
            let _ = writeln!(
                classes,
                "    <default class=\"{name}\">\n      <geom type=\"mesh\" rgba=\"{color}\"/>\n    </default>"
            );
        }
        format!(
            "<mujoco model=\"terrain\">\n  <default>\n{classes}    <default class=\"layer\">\n      \
             <geom type=\"hfield\" rgba=\"0.5 0.5 0.5 1\"/>\n    </default>\n  </default>\n  \
             <asset>\n{}  </asset>\n  <worldbody>\n{}  </worldbody>\n</mujoco>\n",
            self.assets, self.geoms
        )
    }
}

/// Volume inside of the triangles, m3.
pub(super) fn volume_m3(part: &ConvexPart) -> f64 {
    let origin = part.vertices_m[0];
    let of = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|i| {
            let x = part.vertices_m[i as usize];
            [0, 1, 2].map(|k| x[k] - origin[k])
        });
        let cross = [
            b[1] * c[2] - b[2] * c[1],
            b[2] * c[0] - b[0] * c[2],
            b[0] * c[1] - b[1] * c[0],
        ];
        (a[0] * cross[0] + a[1] * cross[1] + a[2] * cross[2]) / 6.0
    };
    part.triangles.iter().map(of).sum::<f64>().abs()
}
