//! The simplified mesh of the ground as binary glTF 2.0 (Khronos Group 2017, ISO/IEC 12113).
//!
//! Contract: glTF has y up. Positions and normals are converted, x, y, z of the world being x, z,
//! -y of glTF, rather than rotated by a node: programs that take vertices without their node are
//! right too. Colors of vertices are linear, as the standard demands, in 32-bit floating point: 8
//! bits of a linear value are too few where it is dark, and some readers take 16 for 8.

use std::path::Path;

use cad_transforms::output::{Existing, write};
use serde_json::{Value, json};

use super::error::ExportError;
use super::summary::Summary;
use super::terrain_mesh::{description, linear_colors, note, simplified};
use crate::outputs::terrain::TerrainMesh;
use crate::scene::Scene;

/// Types of numbers (glTF 2.0, 5.1.3).
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;
/// Uses of a view of the buffer (5.11.5).
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

pub(super) fn export(scene: &Scene, out: &Path) -> Result<Summary, ExportError> {
    let mesh = simplified(scene)?;
    // 36 bytes of a vertex and 12 of a triangle; lengths are words of 32 bits.
    let bytes = 36 * mesh.positions.len() as u64 + 12 * mesh.triangles.len() as u64;
    if bytes > u64::from(u32::MAX / 2) {
        return Err(ExportError::Refused {
            format: "terrain-glb",
            found: format!("a mesh of {bytes} bytes"),
            expected: "at most 2 GiB".to_owned(),
        });
    }
    write(out, &to_bytes(&mesh), Existing::Refuse)?;
    Ok(Summary {
        description: description(&mesh),
        notes: vec![
            "y is up in glTF: x, y, z of the world are written as x, z, -y".to_owned(),
            note("glTF"),
        ],
        lost: Vec::new(),
    })
}

fn y_up([x, y, z]: [f32; 3]) -> [f32; 3] {
    // Not -y: that would make -0 of 0.
    [x, z, 0.0 - y]
}

fn to_bytes(mesh: &TerrainMesh) -> Vec<u8> {
    let mut binary = Vec::new();
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for position in mesh.positions.iter().copied().map(y_up) {
        for k in 0..3 {
            low[k] = low[k].min(position[k]);
            high[k] = high[k].max(position[k]);
        }
        binary.extend(position.iter().flat_map(|v| v.to_le_bytes()));
    }
    for normal in mesh.normals.iter().copied().map(y_up) {
        binary.extend(normal.iter().flat_map(|v| v.to_le_bytes()));
    }
    let linear = linear_colors().map(|v| v as f32);
    for color in &mesh.colors {
        let color = color.map(|c| linear[usize::from(c)]);
        binary.extend(color.iter().flat_map(|v| v.to_le_bytes()));
    }
    let indices = mesh.triangles.as_flattened();
    binary.extend(indices.iter().flat_map(|index| index.to_le_bytes()));
    if mesh.positions.is_empty() || indices.is_empty() {
        // Views and accessors of nothing are not allowed.
        let empty = json!({ "asset": asset(), "scene": 0, "scenes": [{}] });
        return container(&empty, &[]);
    }
    let content = content(mesh.positions.len(), indices.len(), low, high);
    container(&content, &binary)
}

fn asset() -> Value {
    json!({ "version": "2.0", "generator": concat!("paws-scene ", env!("CARGO_PKG_VERSION")) })
}

fn content(vertices: usize, indices: usize, low: [f32; 3], high: [f32; 3]) -> Value {
    let (of_vertices, of_indices) = (12 * vertices, 4 * indices);
    let view = |offset: usize, length: usize, target: u32| json!({ "buffer": 0, "byteOffset": offset, "byteLength": length, "target": target });
    let accessor = |view: usize, kind: u32, count: usize, shape: &str| json!({ "bufferView": view, "componentType": kind, "count": count, "type": shape });
    let mut positions = accessor(0, FLOAT, vertices, "VEC3");
    positions["min"] = json!(low);
    positions["max"] = json!(high);
    let attributes = json!({ "POSITION": 0, "NORMAL": 1, "COLOR_0": 2 });
    // Rough and no metal: color as it is.
    let material = json!({ "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 1 } });
    json!({
        "asset": asset(),
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "name": "terrain" }],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": 3, "material": 0 }] }],
        "materials": [material],
        "accessors": [
            positions,
            accessor(1, FLOAT, vertices, "VEC3"),
            accessor(2, FLOAT, vertices, "VEC3"),
            accessor(3, UNSIGNED_INT, indices, "SCALAR"),
        ],
        "bufferViews": [
            view(0, of_vertices, ARRAY_BUFFER),
            view(of_vertices, of_vertices, ARRAY_BUFFER),
            view(2 * of_vertices, of_vertices, ARRAY_BUFFER),
            view(3 * of_vertices, of_indices, ELEMENT_ARRAY_BUFFER),
        ],
        "buffers": [{ "byteLength": 3 * of_vertices + of_indices }],
    })
}

/// The file of a JSON and, if there is one, a binary chunk.
fn container(content: &Value, binary: &[u8]) -> Vec<u8> {
    let mut json = content.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    // The binary chunk consists of words of four bytes already.
    let chunks = [(b"JSON", json.as_slice()), (b"BIN\0", binary)];
    let chunks = chunks.into_iter().filter(|(_, chunk)| !chunk.is_empty());
    let mut bytes = b"glTF".to_vec();
    bytes.extend(2_u32.to_le_bytes());
    bytes.extend([0; 4]);
    for (kind, chunk) in chunks {
        bytes.extend((chunk.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(chunk);
    }
    let length = bytes.len() as u32;
    bytes[8..12].copy_from_slice(&length.to_le_bytes());
    bytes
}
