//! Rigs in the formats of others: URDF, glTF, tables.
//!
//! Contract: what is written here is read back by this crate's readers, and
//! [`super::map::rig_of_frames`] makes the same transforms of it, within 1e-9 m and rad (a property
//! test). Tolerances, serials, loops and shoe tags have no place in these formats and are left out:
//! the rig file is the only one that holds a rig.

use std::fmt::Write as _;

use serde_json::{Value, json};

use crate::frame::Frame;
use crate::rig::Rig;
use crate::rig::write::quoted;
use crate::transform::RigidTransform;
use crate::view::FieldOfView;

/// A frame's neighbour towards `rig`, the frame itself, and `neighbour_from_frame`; neighbours come
/// first.
type Joint<'r> = (&'r Frame, &'r Frame, RigidTransform);

/// The tree from `rig` outwards.
fn joints(rig: &Rig) -> Vec<Joint<'_>> {
    let steps: Vec<Joint<'_>> = rig
        .steps()
        .map(|(frame, next, next_from_frame)| (next, frame, next_from_frame))
        .collect();
    let mut order: Vec<Joint<'_>> = Vec::new();
    let root = Frame::rig();
    // A pass per level of the tree; each takes those whose neighbour is placed.
    while order.len() < steps.len() {
        let before = order.len();
        for joint in &steps {
            let there = |frame: &Frame| *frame == root || order.iter().any(|(_, f, _)| *f == frame);
            if there(joint.0) && !there(joint.1) {
                order.push(*joint);
            }
        }
        assert!(order.len() > before, "a rig is a tree");
    }
    order
}

/// A URDF file: a link per frame, a fixed joint per neighbour.
pub fn urdf(rig: &Rig) -> String {
    let mut out = String::from("<?xml version=\"1.0\"?>\n");
    let name = xml(rig.name());
    let _ = writeln!(out, "<robot name=\"{name}\">\n  <link name=\"rig\"/>");
    for (parent, child, parent_from_child) in joints(rig) {
        let [x, y, z] = parent_from_child.translation_m().map(|v| v + 0.0);
        let [r, p, w] = rpy(&parent_from_child).map(|v| v + 0.0);
        let _ = write!(
            out,
            "  <link name=\"{child}\"/>\n  <joint name=\"{parent}-{child}\" type=\"fixed\">\n    \
             <parent link=\"{parent}\"/>\n    <child link=\"{child}\"/>\n    \
             <origin xyz=\"{x:?} {y:?} {z:?}\" rpy=\"{r:?} {p:?} {w:?}\"/>\n  </joint>\n"
        );
    }
    out + "</robot>\n"
}

/// Roll, pitch and yaw about fixed axes; exact to rounding also where the pitch is a right angle.
fn rpy(transform: &RigidTransform) -> [f64; 3] {
    let [r11, r12, r13, r21, r22, r23, r31, ..] = transform.rotation_rows();
    let yaw = r21.atan2(r11);
    let (sin, cos) = yaw.sin_cos();
    // With the yaw taken off, what is left is a pitch and a roll, each by itself.
    let pitch = (-r31).atan2(cos * r11 + sin * r21);
    let roll = (sin * r13 - cos * r23).atan2(cos * r22 - sin * r12);
    [roll, pitch, yaw]
}

/// A CSV table of neighbours, in metres, rotations as quaternions.
pub fn csv(rig: &Rig) -> String {
    let mut out = String::from("name,parent,x_m,y_m,z_m,qw,qx,qy,qz\n");
    for (parent, child, parent_from_child) in joints(rig) {
        let parent = parent_or_empty(parent);
        let [x, y, z] = parent_from_child.translation_m().map(|v| v + 0.0);
        let [w, i, j, k] = parent_from_child.rotation_wxyz().map(|v| v + 0.0);
        let _ = writeln!(
            out,
            "{child},{parent},{x:?},{y:?},{z:?},{w:?},{i:?},{j:?},{k:?}"
        );
    }
    out
}

/// A TOML table of neighbours.
pub fn toml(rig: &Rig) -> String {
    let mut out = format!(
        "# Frames of {}, revision {}.\n",
        one_line(rig.name()),
        one_line(rig.revision())
    );
    for (parent, child, parent_from_child) in joints(rig) {
        let _ = write!(out, "\n[[part]]\nname = {}\n", quoted(child.as_str()));
        if *parent != Frame::rig() {
            let _ = writeln!(out, "parent = {}", quoted(parent.as_str()));
        }
        let t = parent_from_child.translation_m().map(|v| v + 0.0);
        let q = parent_from_child.rotation_wxyz().map(|v| v + 0.0);
        let _ = write!(out, "translation_m = {t:?}\nrotation_wxyz = {q:?}\n");
    }
    out
}

fn one_line(text: &str) -> String {
    text.replace(|c: char| c.is_control(), " ")
}

fn parent_or_empty(parent: &Frame) -> &str {
    if *parent == Frame::rig() {
        ""
    } else {
        parent.as_str()
    }
}

fn xml(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
        .replace(|c: char| c.is_control(), " ")
}

/// What glTF shows beside the frames.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Field of view of each left or right lens, by frame.
    pub views: Vec<(Frame, FieldOfView)>,
    /// Depth of the drawn frusta, m.
    pub depth_m: f64,
    /// Height of the ground in `rig`, m, where it is to be drawn.
    pub ground_z_m: Option<f64>,
    /// Outlines on the ground in `rig`, m, each a name and a closed line.
    pub outlines: Vec<(String, Vec<[f64; 3]>)>,
}

/// A glTF file with all in one: a node per frame with its axes (x red, y green, z blue), frusta,
/// ground, outlines.
///
/// The node `rig` rotates z up to glTF's y up, so that a viewer shows the rig upright.
pub fn gltf(rig: &Rig, scene: &Scene) -> String {
    let mut file = Buffers::default();
    let axes = file.axes(0.05);
    let mut nodes: Vec<Value> = vec![json!({
        "name": "rig",
        "rotation": [-(0.5_f64.sqrt()), 0.0, 0.0, 0.5_f64.sqrt()],
        "mesh": axes,
    })];
    let mut index = vec![Frame::rig()];
    let mut children: Vec<Vec<usize>> = vec![Vec::new()];
    for (parent, child, parent_from_child) in joints(rig) {
        let at = index.iter().position(|frame| frame == parent);
        children[at.expect("neighbours come first")].push(nodes.len());
        let [w, x, y, z] = parent_from_child.rotation_wxyz();
        nodes.push(json!({
            "name": child.as_str(),
            "translation": parent_from_child.translation_m(),
            "rotation": [x, y, z, w],
            "mesh": axes,
        }));
        index.push(child.clone());
        children.push(Vec::new());
    }
    let mut add = |to: usize, name: String, mesh: usize, nodes: &mut Vec<Value>| {
        children[to].push(nodes.len());
        children.push(Vec::new());
        nodes.push(json!({ "name": name, "mesh": mesh }));
    };
    for (i, (frame, view)) in scene.views.iter().enumerate() {
        let Some(at) = index.iter().position(|known| known == frame) else {
            continue;
        };
        let far = view.corners().map(|c| c.map(|v| v * scene.depth_m));
        let mut lines = Vec::new();
        for k in 0..4 {
            lines.extend([[0.0; 3], far[k], far[k], far[(k + 1) % 4]]);
        }
        let mesh = file.lines(&lines, COLOURS[i % COLOURS.len()], "frustum");
        add(at, format!("view of {frame}"), mesh, &mut nodes);
    }
    if let Some(z) = scene.ground_z_m {
        let mut lines = Vec::new();
        for i in -4..=4 {
            let v = 0.25 * f64::from(i);
            lines.extend([[v, -1.0, z], [v, 1.0, z], [-1.0, v, z], [1.0, v, z]]);
        }
        let mesh = file.lines(&lines, [0.6, 0.6, 0.6], "ground");
        add(0, "ground".to_owned(), mesh, &mut nodes);
    }
    for (name, outline) in &scene.outlines {
        let mut lines = Vec::new();
        for k in 0..outline.len() {
            lines.extend([outline[k], outline[(k + 1) % outline.len()]]);
        }
        let mesh = file.lines(&lines, [0.1, 0.1, 0.1], name);
        add(0, name.clone(), mesh, &mut nodes);
    }
    for (node, children) in nodes.iter_mut().zip(children) {
        if !children.is_empty() {
            node["children"] = json!(children);
        }
    }
    let document = json!({
        "asset": { "version": "2.0", "generator": concat!("cad-transforms ", env!("CARGO_PKG_VERSION")) },
        "scene": 0,
        "scenes": [{ "name": one_line(rig.name()), "nodes": [0] }],
        "nodes": nodes,
        "meshes": file.meshes,
        "materials": file.materials,
        "accessors": file.accessors,
        "bufferViews": file.views,
        "buffers": [{
            "byteLength": file.bytes.len(),
            "uri": format!("data:application/octet-stream;base64,{}", base64(&file.bytes)),
        }],
    });
    let text = serde_json::to_string_pretty(&document).expect("finite numbers and texts");
    text + "\n"
}

/// Colours of frusta, linear.
const COLOURS: [[f64; 3]; 4] = [
    [0.0, 0.18, 0.45],
    [0.65, 0.13, 0.0],
    [0.0, 0.32, 0.12],
    [0.4, 0.1, 0.4],
];

/// Meshes of lines and what they are stored in.
#[derive(Default)]
struct Buffers {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    materials: Vec<Value>,
    meshes: Vec<Value>,
}

impl Buffers {
    /// Three lines along the axes.
    fn axes(&mut self, length: f64) -> usize {
        let mut primitives = Vec::new();
        for axis in 0..3 {
            let (mut tip, mut colour) = ([0.0; 3], [0.0; 3]);
            (tip[axis], colour[axis]) = (length, 0.8);
            primitives.push(self.primitive(&[[0.0; 3], tip], colour));
        }
        self.meshes
            .push(json!({ "name": "axes", "primitives": primitives }));
        self.meshes.len() - 1
    }

    /// Pairs of points, each a line.
    fn lines(&mut self, points: &[[f64; 3]], colour: [f64; 3], name: &str) -> usize {
        let primitive = self.primitive(points, colour);
        self.meshes
            .push(json!({ "name": name, "primitives": [primitive] }));
        self.meshes.len() - 1
    }

    fn primitive(&mut self, points: &[[f64; 3]], [r, g, b]: [f64; 3]) -> Value {
        let floats: Vec<[f32; 3]> = points.iter().map(|p| p.map(|v| v as f32)).collect();
        let bound = |pick: fn(f32, f32) -> f32, start: f32| -> [f32; 3] {
            std::array::from_fn(|i| floats.iter().map(|p| p[i]).fold(start, pick))
        };
        let offset = self.bytes.len();
        for value in floats.iter().flatten() {
            self.bytes.extend(value.to_le_bytes());
        }
        let length = self.bytes.len() - offset;
        self.views.push(
            json!({ "buffer": 0, "byteOffset": offset, "byteLength": length, "target": 34962 }),
        );
        self.accessors.push(json!({
            "bufferView": self.views.len() - 1,
            "componentType": 5126,
            "count": floats.len(),
            "type": "VEC3",
            "min": bound(f32::min, f32::INFINITY),
            "max": bound(f32::max, f32::NEG_INFINITY),
        }));
        self.materials.push(json!({
            "pbrMetallicRoughness": { "baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0 },
            "emissiveFactor": [r, g, b],
        }));
        // Mode 1 is separate lines (glTF 2.0, section 3.7.2.1).
        json!({
            "attributes": { "POSITION": self.accessors.len() - 1 },
            "material": self.materials.len() - 1,
            "mode": 1,
        })
    }
}

/// RFC 4648, section 4.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::new();
    for three in bytes.chunks(3) {
        let word = three
            .iter()
            .fold(0_u32, |word, b| word << 8 | u32::from(*b))
            << (8 * (3 - three.len()));
        for i in 0..4 {
            let digit = DIGITS[(word >> (18 - 6 * i) & 63) as usize];
            out.push(if i <= three.len() {
                char::from(digit)
            } else {
                '='
            });
        }
    }
    out
}

#[cfg(test)]
mod tests;
