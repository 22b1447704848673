//! The mesh of the ground as binary PLY 1.0 (Turk 1994).

use std::io::Write;

use crate::draft::Draft;
use crate::error::{BundleError, doing};
use crate::outputs::Fault;

/// A triangle mesh, in the world. Triangles are counterclockwise seen from outside. Properties of
/// vertices are all of the same number.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TerrainMesh {
    /// Positions of the vertices, m.
    pub positions: Vec<[f32; 3]>,
    /// Outward normals of the vertices, of length 1.
    pub normals: Vec<[f32; 3]>,
    /// Colors, sRGB; black where no view had one.
    pub colors: Vec<[u8; 3]>,
    /// One standard deviation of the position along the normal, m; NaN where it is not known.
    pub sigma_m: Vec<f32>,
    /// Views that saw the surface, at most 255.
    pub views: Vec<u8>,
    /// Plane that a vertex is on.
    pub planes: Vec<Option<u32>>,
    /// Indices of the vertices of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

const VERTEX_BYTES: usize = 36;
const FACE_BYTES: usize = 13;
const END: &[u8] = b"end_header\n";
/// Largest number of vertices and of planes: PLY has them as 32 bits with sign.
const MAX_COUNT: usize = i32::MAX as usize;

fn header(vertices: usize, faces: usize) -> String {
    format!(
        "ply\nformat binary_little_endian 1.0\ncomment metres, world with z up\n\
         element vertex {vertices}\n\
         property float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n\
         property float sigma\nproperty uchar views\nproperty int plane\n\
         element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    )
}

impl TerrainMesh {
    /// Whether it is as the format has it, with this number of planes.
    pub(super) fn check(&self, planes: usize) -> Result<(), Fault> {
        let count = self.positions.len();
        let counts = [
            ("normals", self.normals.len()),
            ("colors", self.colors.len()),
            ("sigmas", self.sigma_m.len()),
            ("views", self.views.len()),
            ("planes", self.planes.len()),
        ];
        if let Some((name, other)) = counts.into_iter().find(|(_, other)| *other != count) {
            let found = format!("{other} {name} of {count} positions");
            return Err(Fault::new("vertices", found, "one for each vertex"));
        }
        if count > MAX_COUNT || planes > MAX_COUNT {
            let found = format!("{count} vertices and {planes} planes");
            return Err(Fault::new("vertices", found, "less than 2^31 of each"));
        }
        for i in 0..count {
            let (position, normal) = (self.positions[i], self.normals[i]);
            if position.iter().chain(&normal).any(|v| !v.is_finite()) {
                let found = format!("position {position:?} and normal {normal:?}");
                return Err(Fault::new(&vertex(i), found, "finite numbers"));
            }
            let sigma = self.sigma_m[i];
            if sigma < 0.0 || sigma.is_infinite() {
                let found = format!("a sigma of {sigma} m");
                let expected = "0 or more, or not-a-number where it is not known";
                return Err(Fault::new(&vertex(i), found, expected));
            }
            if let Some(plane) = self.planes[i].filter(|plane| *plane as usize >= planes) {
                let found = format!("plane {plane} of {planes}");
                return Err(Fault::new(&vertex(i), found, "the index of a plane"));
            }
        }
        let is_outside = |triangle: &[u32; 3]| triangle.iter().any(|v| *v as usize >= count);
        if let Some(number) = self.triangles.iter().position(is_outside) {
            let found = format!("{:?} of {count} vertices", self.triangles[number]);
            let place = format!("triangle {number}");
            return Err(Fault::new(&place, found, "indices of vertices"));
        }
        Ok(())
    }
}

fn vertex(number: usize) -> String {
    format!("vertex {number}")
}

/// Writes a mesh that was checked.
pub(super) fn write(draft: &Draft, path: &str, mesh: &TerrainMesh) -> Result<(), BundleError> {
    let mut file = draft.create(path)?;
    let mut put = |bytes: &[u8]| {
        let place = draft.file_path(path);
        file.write_all(bytes)
            .map_err(doing("writing a mesh", place))
    };
    let count = mesh.positions.len();
    put(header(count, mesh.triangles.len()).as_bytes())?;
    let mut row = Vec::with_capacity(VERTEX_BYTES);
    for i in 0..count {
        row.clear();
        let numbers = mesh.positions[i].iter().chain(&mesh.normals[i]);
        row.extend(numbers.flat_map(|v| v.to_le_bytes()));
        row.extend(mesh.colors[i]);
        row.extend(mesh.sigma_m[i].to_le_bytes());
        row.push(mesh.views[i]);
        row.extend(
            mesh.planes[i]
                .map_or(-1, |plane| plane as i32)
                .to_le_bytes(),
        );
        put(&row)?;
    }
    for triangle in &mesh.triangles {
        row.clear();
        row.push(3);
        row.extend(triangle.iter().flat_map(|index| index.to_le_bytes()));
        put(&row)?;
    }
    file.finish()
}

/// A mesh of a file with exactly the layout of the writer. Indices are not checked yet, but not
/// negative.
pub(super) fn parse(bytes: &[u8]) -> Result<TerrainMesh, Fault> {
    let end = bytes.windows(END.len()).position(|w| w == END);
    let (head, data) = bytes.split_at(end.map_or(0, |at| at + END.len()));
    let head = String::from_utf8_lossy(head);
    let count = |element: &str| {
        let mut lines = head.lines();
        let count = lines.find_map(|line| line.strip_prefix(element))?;
        count.parse::<usize>().ok()
    };
    let counts = count("element vertex ").zip(count("element face "));
    let counts = counts.filter(|(vertices, faces)| head == header(*vertices, *faces));
    let Some((vertices, faces)) = counts else {
        let found = format!("{:?}", head.chars().take(1000).collect::<String>());
        return Err(Fault::new("header", found, "that of a mesh of the ground"));
    };
    let bytes_of = |count: usize, size: usize| count.checked_mul(size);
    let of_vertices = bytes_of(vertices, VERTEX_BYTES);
    let all = of_vertices
        .zip(bytes_of(faces, FACE_BYTES))
        .and_then(|(a, b)| a.checked_add(b));
    let Some(of_vertices) = of_vertices.filter(|_| all == Some(data.len())) else {
        let found = format!(
            "{} bytes for {vertices} vertices and {faces} faces",
            data.len()
        );
        return Err(Fault::new("data", found, "36 per vertex and 13 per face"));
    };
    let (of_vertices, of_faces) = data.split_at(of_vertices);
    let mut mesh = TerrainMesh::default();
    for (i, row) in of_vertices.chunks_exact(VERTEX_BYTES).enumerate() {
        mesh.positions.push([0, 4, 8].map(|at| float(row, at)));
        mesh.normals.push([12, 16, 20].map(|at| float(row, at)));
        mesh.colors.push([row[24], row[25], row[26]]);
        mesh.sigma_m.push(float(row, 27));
        mesh.views.push(row[31]);
        mesh.planes.push(match word(row, 32) as i32 {
            -1 => None,
            plane => Some(u32::try_from(plane).map_err(|_| {
                let found = format!("plane {plane}");
                Fault::new(&vertex(i), found, "an index, or -1 for none")
            })?),
        });
    }
    for (i, row) in of_faces.chunks_exact(FACE_BYTES).enumerate() {
        if row[0] != 3 {
            let found = format!("{} corners", row[0]);
            return Err(Fault::new(&format!("triangle {i}"), found, "3"));
        }
        // A negative index is larger than any number of vertices.
        mesh.triangles.push([1, 5, 9].map(|at| word(row, at)));
    }
    Ok(mesh)
}

fn word(row: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]])
}

fn float(row: &[u8], at: usize) -> f32 {
    f32::from_bits(word(row, at))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_of_records_are_those_of_the_header() {
        let mut bytes = header(1, 1).into_bytes();
        let whole = bytes.len() + VERTEX_BYTES + FACE_BYTES;
        bytes.resize(whole, 0);
        bytes[whole - FACE_BYTES] = 3;
        let mesh = parse(&bytes).unwrap();
        assert_eq!((mesh.positions.len(), mesh.triangles.len()), (1, 1));
        assert_eq!(mesh.planes, [Some(0)]);
        assert!(mesh.check(1).is_ok());
        let message = |result: Result<(), Fault>| format!("{:?}", result.unwrap_err());
        assert!(message(mesh.check(0)).contains("plane 0 of 0"));
        bytes[whole - 1] = 0xff;
        let outside = parse(&bytes).unwrap();
        assert!(message(outside.check(1)).contains("triangle 0"));
        bytes[whole - FACE_BYTES] = 4;
        assert!(message(parse(&bytes).map(drop)).contains("4 corners"));
        bytes.pop();
        assert!(message(parse(&bytes).map(drop)).contains("48 bytes for 1 vertices"));
        // Counts whose bytes do not fit into a word.
        let huge = header(usize::MAX, 2).into_bytes();
        assert!(message(parse(&huge).map(drop)).contains("0 bytes for"));
        assert!(message(parse(b"ply\n").map(drop)).contains("header"));
    }
}
