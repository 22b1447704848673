//! glTF 2.0, binary.

use crate::mesh::Mesh;

/// A mesh as glTF binary: position, normal, color and triangles; y up, z towards the viewer.
pub fn glb(mesh: &Mesh) -> Vec<u8> {
    let count = mesh.positions.len();
    let y_up = |v: &[f32; 3]| [v[0], v[2], 0.0 - v[1]];
    let mut binary = Vec::new();
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for position in mesh.positions.iter().map(y_up) {
        for k in 0..3 {
            low[k] = low[k].min(position[k]);
            high[k] = high[k].max(position[k]);
            binary.extend(position[k].to_le_bytes());
        }
    }
    if count == 0 {
        (low, high) = ([0.0; 3], [0.0; 3]);
    }
    for normal in mesh.normals.iter().map(y_up) {
        normal.iter().for_each(|v| binary.extend(v.to_le_bytes()));
    }
    // Colors of vertices are linear.
    let linear: Vec<u8> = (0..=255).map(linear).collect();
    for color in &mesh.colors {
        binary.extend(color.map(|c| linear[usize::from(c)]));
        binary.push(255);
    }
    for triangle in &mesh.triangles {
        triangle
            .iter()
            .for_each(|index| binary.extend(index.to_le_bytes()));
    }
    let indices = 3 * mesh.triangles.len();
    let json = match count {
        0 => r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{}]}"#.to_owned(),
        _ => format!(
            concat!(
                r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"#,
                r#""meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":1,"COLOR_0":2}},"indices":3}}]}}],"#,
                r#""accessors":[{{"bufferView":0,"componentType":5126,"count":{count},"type":"VEC3","min":{low},"max":{high}}},"#,
                r#"{{"bufferView":1,"componentType":5126,"count":{count},"type":"VEC3"}},"#,
                r#"{{"bufferView":2,"componentType":5121,"normalized":true,"count":{count},"type":"VEC4"}},"#,
                r#"{{"bufferView":3,"componentType":5125,"count":{indices},"type":"SCALAR"}}],"#,
                r#""bufferViews":[{{"buffer":0,"byteLength":{twelve},"target":34962}},"#,
                r#"{{"buffer":0,"byteOffset":{twelve},"byteLength":{twelve},"target":34962}},"#,
                r#"{{"buffer":0,"byteOffset":{twenty_four},"byteLength":{four},"target":34962}},"#,
                r#"{{"buffer":0,"byteOffset":{twenty_eight},"byteLength":{of_indices},"target":34963}}],"#,
                r#""buffers":[{{"byteLength":{all}}}]}}"#
            ),
            count = count,
            indices = indices,
            low = array(low),
            high = array(high),
            four = 4 * count,
            twelve = 12 * count,
            twenty_four = 24 * count,
            twenty_eight = 28 * count,
            of_indices = 4 * indices,
            all = binary.len(),
        ),
    };
    let mut json = json.into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF".to_vec();
    let length = 12 + 8 + json.len() + if count == 0 { 0 } else { 8 + binary.len() };
    bytes.extend(2u32.to_le_bytes());
    bytes.extend((length as u32).to_le_bytes());
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(json);
    if count > 0 {
        bytes.extend((binary.len() as u32).to_le_bytes());
        bytes.extend(b"BIN\0");
        bytes.extend(binary);
    }
    bytes
}

fn array(v: [f32; 3]) -> String {
    format!("[{},{},{}]", v[0], v[1], v[2])
}

/// Linear value of an sRGB one (IEC 61966-2-1).
fn linear(value: u8) -> u8 {
    let v = f64::from(value) / 255.0;
    let linear = match v <= 0.04045 {
        true => v / 12.92,
        false => libm::pow((v + 0.055) / 1.055, 2.4),
    };
    (255.0 * linear + 0.5) as u8
}
