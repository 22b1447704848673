//! Meshes as the bytes of files: PLY, OBJ and glTF binary.
//!
//! Coordinates are those of the world, z up, in metres; only glTF has y up, as its standard
//! demands.

use crate::mesh::Mesh;

mod glb;

pub use glb::glb;

/// A mesh as binary little-endian PLY: position, normal, color, `sigma` in m and `views`.
pub fn ply(mesh: &Mesh) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\ncomment metres, z up\nelement vertex {}\n\
         property float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n\
         property float sigma\nproperty ushort views\nelement face {}\n\
         property list uchar uint vertex_indices\nend_header\n",
        mesh.positions.len(),
        mesh.triangles.len()
    )
    .into_bytes();
    for i in 0..mesh.positions.len() {
        for value in mesh.positions[i].iter().chain(&mesh.normals[i]) {
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend(mesh.colors[i]);
        bytes.extend(mesh.sigma_m[i].to_le_bytes());
        bytes.extend(u16::from(mesh.views[i]).to_le_bytes());
    }
    for triangle in &mesh.triangles {
        bytes.push(3);
        triangle
            .iter()
            .for_each(|index| bytes.extend(index.to_le_bytes()));
    }
    bytes
}

/// A mesh as OBJ text, with normals, and with colors from 0 to 1 after the positions.
pub fn obj(mesh: &Mesh) -> Vec<u8> {
    let mut text = String::from("# metres, z up\n");
    for (position, color) in mesh.positions.iter().zip(&mesh.colors) {
        let [x, y, z] = position;
        let [r, g, b] = color.map(|c| f32::from(c) / 255.0);
        text += &format!("v {x} {y} {z} {r:.4} {g:.4} {b:.4}\n");
    }
    for [x, y, z] in &mesh.normals {
        text += &format!("vn {x:.4} {y:.4} {z:.4}\n");
    }
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|index| index + 1);
        text += &format!("f {a}//{a} {b}//{b} {c}//{c}\n");
    }
    text.into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Mesh {
        Mesh {
            positions: vec![
                [0.0, 0.0, 1.5],
                [2.0, 0.0, 1.5],
                [2.0, 1.0, 1.5],
                [0.0, 1.0, 1.5],
            ],
            normals: vec![[0.0, 0.0, 1.0]; 4],
            colors: vec![[255, 0, 51]; 4],
            sigma_m: vec![0.004; 4],
            views: vec![9; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        }
    }

    #[test]
    fn ply_has_all_properties() {
        let bytes = ply(&square());
        let end = b"end_header\n";
        let start = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
        let header = std::str::from_utf8(&bytes[..start]).unwrap();
        assert!(header.contains("element vertex 4\n") && header.contains("element face 2\n"));
        let vertex = 6 * 4 + 3 + 4 + 2;
        assert_eq!(bytes.len(), start + 4 * vertex + 2 * 13);
        let second = &bytes[start + vertex..start + 2 * vertex];
        assert_eq!(second[..4], 2.0f32.to_le_bytes());
        assert_eq!(second[24..27], [255, 0, 51]);
        assert_eq!(second[27..31], 0.004f32.to_le_bytes());
        assert_eq!(second[31..], 9u16.to_le_bytes());
    }

    #[test]
    fn obj_counts_from_one() {
        let text = String::from_utf8(obj(&square())).unwrap();
        assert!(text.contains("v 2 1 1.5 1.0000 0.0000 0.2000\n"), "{text}");
        assert!(
            text.ends_with("f 1//1 2//2 3//3\nf 1//1 3//3 4//4\n"),
            "{text}"
        );
    }

    #[test]
    fn glb_has_y_up_and_aligned_chunks() {
        let bytes = glb(&square());
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(bytes[..4], *b"glTF");
        assert_eq!((word(4), word(8)), (2, bytes.len()));
        let json_length = word(12);
        assert_eq!((json_length % 4, &bytes[16..20]), (0, &b"JSON"[..]));
        let json = std::str::from_utf8(&bytes[20..20 + json_length]).unwrap();
        assert!(
            json.contains(r#""min":[0,1.5,-1],"max":[2,1.5,0]"#),
            "{json}"
        );
        let binary = 20 + json_length;
        assert_eq!(&bytes[binary + 4..binary + 8], b"BIN\0");
        assert_eq!(binary + 8 + word(binary), bytes.len());
        // The third vertex: x, z, -y.
        let third = binary + 8 + 24;
        let value = |k: usize| f32::from_bits(word(third + 4 * k) as u32);
        assert_eq!([0, 1, 2].map(value), [2.0, 1.5, -1.0]);
    }
}
