//! glTF: nodes of a scene.
//!
//! Contract: every node of the default scene becomes a part; meshes, cameras and buffers are not
//! looked at, so a `.gltf` can be read without its `.bin`. glTF is in metres with y up and
//! right-handed (glTF 2.0, section 3.4); the root given here has z up instead: its x is glTF's x,
//! its y is glTF's -z, its z is glTF's y. Programs that draw with z up put a node with that
//! rotation at the top, and below it everything is as drawn. A node's own axes are its own.
//!
//! Even scaling of a node (0.001 above a drawing in millimetres) is carried through; uneven
//! scaling, shear and mirroring are errors.

use serde_json::Value;

use super::{Cad, Fault, MOST_PARTS, Part, numbered, step_of_path};
use crate::transform::RigidTransform;

/// Maximum difference of scale factors that count as equal.
const SCALE_TOLERANCE: f64 = 1e-6;

/// Deepest tree of nodes.
const DEEPEST: usize = 256;

/// A node's transform: rotation and translation after an even scaling.
#[derive(Clone, Copy)]
struct NodeTransform {
    transform: RigidTransform,
    scale: f64,
}

/// Parts of a `.gltf` or `.glb` file.
///
/// # Errors
/// What is wrong, with the node.
pub fn parts(bytes: &[u8]) -> Result<Cad, Vec<Fault>> {
    let json = if bytes.starts_with(b"glTF") {
        json_of_glb(bytes).map_err(|fault| vec![fault])?
    } else {
        bytes
    };
    let document: Value = serde_json::from_slice(json)
        .map_err(|error| vec![Fault::at_line(error.line(), format!("not JSON: {error}"))])?;
    Scene::of(&document)
        .and_then(|scene| scene.parts())
        .map_err(|fault| vec![fault])
}

/// The first chunk of the binary container (glTF 2.0, section 4.4).
fn json_of_glb(bytes: &[u8]) -> Result<&[u8], Fault> {
    let word = |at: usize| {
        let bytes: Option<[u8; 4]> = bytes.get(at..at + 4).and_then(|b| b.try_into().ok());
        bytes.map(u32::from_le_bytes)
    };
    let cut_off = || Fault::new("header", "the container is cut off");
    let (version, length) = (word(4).ok_or_else(cut_off)?, word(8).ok_or_else(cut_off)?);
    let (size, kind) = (word(12).ok_or_else(cut_off)?, word(16).ok_or_else(cut_off)?);
    if version != 2 {
        return Err(Fault::new(
            "header",
            format!("version is {version}, expected 2"),
        ));
    }
    if length as usize > bytes.len() {
        let message = format!(
            "states {length} bytes and has {}: it is cut off",
            bytes.len()
        );
        return Err(Fault::new("header", message));
    }
    if kind != u32::from_le_bytes(*b"JSON") {
        return Err(Fault::new("first chunk", "is not the JSON chunk"));
    }
    bytes.get(20..20 + size as usize).ok_or_else(cut_off)
}

struct Scene<'d> {
    nodes: &'d [Value],
    roots: Vec<usize>,
}

impl<'d> Scene<'d> {
    fn of(document: &'d Value) -> Result<Self, Fault> {
        let version = document.pointer("/asset/version").and_then(Value::as_str);
        if !version.is_some_and(|v| v.starts_with("2.")) {
            let message = format!("is {version:?}, expected 2.x");
            return Err(Fault::new("asset.version", message));
        }
        let nodes = document.get("nodes").and_then(Value::as_array);
        let nodes = nodes.map(Vec::as_slice).unwrap_or_default();
        if nodes.is_empty() {
            return Err(Fault::new("nodes", "there are none"));
        }
        let scenes = document.get("scenes").and_then(Value::as_array);
        let roots = match scenes {
            Some(scenes) => {
                let which = document.get("scene").and_then(Value::as_u64).unwrap_or(0);
                let scene = scenes.get(which as usize);
                let scene = scene.ok_or_else(|| {
                    Fault::new("scene", format!("is {which}, which is not there"))
                })?;
                indices(
                    scene,
                    "nodes",
                    &format!("scenes[{which}].nodes"),
                    nodes.len(),
                )?
            }
            None => {
                let mut children = std::collections::BTreeSet::new();
                for (i, node) in nodes.iter().enumerate() {
                    children.extend(indices(node, "children", &place(nodes, i), nodes.len())?);
                }
                (0..nodes.len()).filter(|i| !children.contains(i)).collect()
            }
        };
        Ok(Self { nodes, roots })
    }

    fn parts(&self) -> Result<Cad, Fault> {
        let z_up_from_y_up = RigidTransform::from_rotation_rows(
            [1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0],
            [0.0; 3],
        )
        .expect("a quarter turn");
        let top = NodeTransform {
            transform: z_up_from_y_up,
            scale: 1.0,
        };
        let mut cad = Cad {
            parts: Vec::new(),
            notes: Vec::new(),
        };
        self.walk(&self.roots, "", &top, 0, &mut cad)?;
        Ok(cad)
    }

    fn walk(
        &self,
        nodes: &[usize],
        above: &str,
        root_from_parent: &NodeTransform,
        depth: usize,
        cad: &mut Cad,
    ) -> Result<(), Fault> {
        let names = nodes.iter().map(|&i| {
            let name = self.nodes[i].get("name").and_then(Value::as_str);
            let name = name.map(str::trim).filter(|name| !name.is_empty());
            name.map_or_else(|| format!("node_{i}"), str::to_owned)
        });
        for (&i, name) in nodes.iter().zip(numbered(names.collect())) {
            let place = place(self.nodes, i);
            if depth > DEEPEST || cad.parts.len() >= MOST_PARTS {
                return Err(Fault::new(
                    place,
                    "the tree of nodes is a circle or too large",
                ));
            }
            let own = local(&self.nodes[i], &place)?;
            let [x, y, z] = own
                .transform
                .translation_m()
                .map(|v| v * root_from_parent.scale);
            let turn = own.transform.rotation_wxyz();
            let scaled = RigidTransform::from_wxyz(turn, [x, y, z])
                .map_err(|error| Fault::new(place.clone(), error.to_string()))?;
            let root_from_node = NodeTransform {
                transform: root_from_parent.transform * scaled,
                scale: root_from_parent.scale * own.scale,
            };
            let step = step_of_path(&name);
            let path = match above {
                "" => step,
                above => format!("{above}/{step}"),
            };
            cad.parts.push(Part {
                name,
                path: path.clone(),
                root_from_part: root_from_node.transform,
                place: place.clone(),
            });
            let children = indices(&self.nodes[i], "children", &place, self.nodes.len())?;
            self.walk(&children, &path, &root_from_node, depth + 1, cad)?;
        }
        Ok(())
    }
}

fn place(nodes: &[Value], i: usize) -> String {
    match nodes[i].get("name").and_then(Value::as_str) {
        Some(name) => format!("nodes[{i}] {name:?}"),
        None => format!("nodes[{i}]"),
    }
}

fn indices(of: &Value, key: &str, place: &str, count: usize) -> Result<Vec<usize>, Fault> {
    let Some(list) = of.get(key) else {
        return Ok(Vec::new());
    };
    let wrong = || Fault::new(place, format!("{key} is not a list of nodes below {count}"));
    let index = |v: &Value| v.as_u64().filter(|i| *i < count as u64).map(|i| i as usize);
    let list: Option<Vec<usize>> = list
        .as_array()
        .ok_or_else(wrong)?
        .iter()
        .map(index)
        .collect();
    list.ok_or_else(wrong)
}

fn numbers<const N: usize>(
    node: &Value,
    key: &str,
    place: &str,
) -> Result<Option<[f64; N]>, Fault> {
    let Some(list) = node.get(key) else {
        return Ok(None);
    };
    let wrong = || Fault::new(place, format!("{key} is not {N} finite numbers"));
    let list: Option<Vec<f64>> = list
        .as_array()
        .ok_or_else(wrong)?
        .iter()
        .map(Value::as_f64)
        .collect();
    let list: [f64; N] = list
        .and_then(|list| list.try_into().ok())
        .ok_or_else(wrong)?;
    if list.iter().any(|v| !v.is_finite()) {
        return Err(wrong());
    }
    Ok(Some(list))
}

fn local(node: &Value, place: &str) -> Result<NodeTransform, Fault> {
    let fault = |message: String| Fault::new(place, message);
    if let Some(matrix) = numbers::<16>(node, "matrix", place)? {
        // Columns first.
        let column = |i: usize| [matrix[4 * i], matrix[4 * i + 1], matrix[4 * i + 2]];
        if [matrix[3], matrix[7], matrix[11], matrix[15]] != [0.0, 0.0, 0.0, 1.0] {
            return Err(fault(
                "matrix has a last row that is not 0 0 0 1".to_owned(),
            ));
        }
        let lengths = [0, 1, 2].map(|i| column(i).iter().map(|v| v * v).sum::<f64>().sqrt());
        let scale = even(lengths).map_err(|m| fault(format!("matrix {m}")))?;
        let [x, y, z] = [0, 1, 2].map(|i| column(i).map(|v| v / scale));
        let rows = [x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]];
        let transform = RigidTransform::from_rotation_rows(rows, column(3));
        let transform = transform.map_err(|error| fault(format!("matrix: {error}")))?;
        return Ok(NodeTransform { transform, scale });
    }
    let translation = numbers::<3>(node, "translation", place)?.unwrap_or([0.0; 3]);
    let [x, y, z, w] = numbers::<4>(node, "rotation", place)?.unwrap_or([0.0, 0.0, 0.0, 1.0]);
    let scale = numbers::<3>(node, "scale", place)?.unwrap_or([1.0; 3]);
    let scale = even(scale).map_err(|m| fault(format!("scale {m}")))?;
    let transform = RigidTransform::from_wxyz([w, x, y, z], translation)
        .map_err(|error| fault(format!("rotation: {error}")))?;
    Ok(NodeTransform { transform, scale })
}

/// The common factor, if the three are equal and do not mirror.
fn even(scale: [f64; 3]) -> Result<f64, String> {
    let [x, y, z] = scale;
    if !(x > 0.0 && y > 0.0 && z > 0.0) {
        return Err(format!(
            "is {scale:?}, expected above 0: the node is mirrored or flat"
        ));
    }
    if (x - y).abs().max((x - z).abs()) > SCALE_TOLERANCE * x {
        return Err(format!("is {scale:?}, expected the same along all axes"));
    }
    Ok(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(nodes: &str) -> String {
        format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{nodes}]}}"#
        )
    }

    /// A drawing in millimetres with z up, as CAD programs export it.
    const DRAWING: &str = r#"
        {"name":"top","rotation":[-0.7071067811865476,0,0,0.7071067811865476],"scale":[0.001,0.001,0.001],"children":[1]},
        {"name":"mount","translation":[20,140,100],"children":[2]},
        {"name":"lens","matrix":[0,0,-1,0, -1,0,0,0, 0,1,0,0, 1,2,3,1]}"#;

    #[test]
    fn nodes_are_placed_with_z_up() {
        let cad = parts(file(DRAWING).as_bytes()).unwrap();
        let [top, mount, lens] = cad.parts.as_slice() else {
            panic!("{cad:?}")
        };
        assert!(top.root_from_part.angle_rad() < 1e-15);
        assert_eq!(lens.path, "top/mount/lens");
        let close = |found: [f64; 3], expected: [f64; 3]| {
            assert!(
                (0..3).all(|i| (found[i] - expected[i]).abs() < 1e-12),
                "{found:?}"
            );
        };
        close(mount.root_from_part.translation_m(), [0.02, 0.14, 0.1]);
        close(lens.root_from_part.translation_m(), [0.021, 0.142, 0.103]);
        // Columns first: the lens's x is the mount's -z.
        close(
            lens.root_from_part.rotate([1.0, 0.0, 0.0]),
            [0.0, 0.0, -1.0],
        );
        // Without a rotation at the top, y is up.
        let cad = parts(file(r#"{"translation":[1,2,3]}"#).as_bytes()).unwrap();
        close(
            cad.parts[0].root_from_part.translation_m(),
            [1.0, -3.0, 2.0],
        );
        assert_eq!(cad.parts[0].path, "node_0");
    }

    #[test]
    fn the_binary_container_is_read() {
        let json = file(DRAWING);
        let mut glb = b"glTF".to_vec();
        glb.extend(2_u32.to_le_bytes());
        glb.extend((20 + json.len() as u32).to_le_bytes());
        glb.extend((json.len() as u32).to_le_bytes());
        glb.extend(b"JSON");
        glb.extend(json.as_bytes());
        assert_eq!(parts(&glb).unwrap(), parts(json.as_bytes()).unwrap());
        for cut in 0..glb.len() {
            assert!(parts(&glb[..cut]).is_err(), "cut at {cut}");
        }
    }

    #[test]
    fn faults_name_the_node() {
        let check = |nodes: &str, expected: &str| {
            let fault = parts(file(nodes).as_bytes()).unwrap_err()[0].to_string();
            assert!(fault.starts_with(expected), "{nodes}: {fault}");
        };
        check(
            r#"{"name":"a","scale":[1,1,-1]}"#,
            "nodes[0] \"a\": scale is [1.0, 1.0, -1.0], expected above 0",
        );
        check(
            r#"{"scale":[1,2,1]}"#,
            "nodes[0]: scale is [1.0, 2.0, 1.0], expected the same",
        );
        check(
            r#"{"rotation":[0,0,0,2]}"#,
            "nodes[0]: rotation: the quaternion's norm is 2",
        );
        check(
            r#"{"translation":[0,1]}"#,
            "nodes[0]: translation is not 3 finite numbers",
        );
        check(r#"{"translation":[0,1,NaN]}"#, "line 1: not JSON");
        check(
            r#"{"translation":[0,1,"2,5"]}"#,
            "nodes[0]: translation is not 3 finite numbers",
        );
        check(
            r#"{"children":[0]}"#,
            "nodes[0]: the tree of nodes is a circle",
        );
        check(
            r#"{"children":[7]}"#,
            "nodes[0]: children is not a list of nodes below 1",
        );
        let mirrored = DRAWING.replace("[0,0,-1,0, -1,0,0,0", "[0,0,1,0, -1,0,0,0");
        check(
            &mirrored,
            "nodes[2] \"lens\": matrix: the rotation matrix is left-handed",
        );
    }
}
