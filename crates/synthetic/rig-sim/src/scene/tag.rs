//! AprilTags as geometry: every cell is a square of its own, so that edges are exact at any
//! distance.
//!
//! Family 36h11 (Olson 2011; Wang and Olson 2016): 6 x 6 bits inside a black border one cell wide,
//! on white. The codes are the family's first ones, most significant bit first, row by row from the
//! top left. A tag's frame: x to the right, y down, z into the tag, origin in its middle, as
//! AprilTag's own pose estimation has it; its size is the length of the black square's side.

use nalgebra::Vector3;

use super::mesh::{Mesh, Stuff};

/// The first codes of the family.
const CODES: [u64; 8] = [
    0xd_5d62_8584,
    0xd_97f1_8b49,
    0xd_d280_910e,
    0xe_479e_9c98,
    0xe_bcbc_a822,
    0xf_31da_b3ac,
    0x0_56a5_d085,
    0x1_0652_e1d4,
];
/// Bits along a side.
const BITS: usize = 6;
/// Cells along a side with the black border.
pub(crate) const CELLS: usize = BITS + 2;

/// Number of available tags.
pub const COUNT: usize = CODES.len();

/// Whether the cell in this row and column is black; the border is, all around it is not.
fn is_black(id: usize, row: i32, column: i32) -> bool {
    let inside = |i: i32| (0..CELLS as i32).contains(&i);
    if !inside(row) || !inside(column) {
        return false;
    }
    let bit = |i: i32| usize::try_from(i - 1).ok().filter(|&i| i < BITS);
    match (bit(row), bit(column)) {
        (Some(r), Some(c)) => CODES[id] >> (BITS * BITS - 1 - (r * BITS + c)) & 1 == 0,
        _ => true,
    }
}

/// Adds tag `id` of side `size_m` to a mesh, with a white margin one cell wide. `place` maps points
/// of the tag frame to the mesh frame.
///
/// # Panics
/// If `id` is not below [`COUNT`].
pub fn draw(
    mesh: &mut Mesh,
    id: usize,
    size_m: f64,
    place: impl Fn(Vector3<f64>) -> Vector3<f64>,
    [black, white]: [Stuff; 2],
) {
    assert!(id < COUNT, "tag {id} of {COUNT}");
    let cell = size_m / CELLS as f64;
    let at = |row: i32, column: i32| {
        let half = 0.5 * size_m;
        place(Vector3::new(
            f64::from(column) * cell - half,
            f64::from(row) * cell - half,
            0.0,
        ))
    };
    for row in -1..=CELLS as i32 {
        for column in -1..=CELLS as i32 {
            let stuff = if is_black(id, row, column) {
                black
            } else {
                white
            };
            // Seen from outside, against z: x to the right, y down.
            let corners = [
                at(row + 1, column),
                at(row + 1, column + 1),
                at(row, column + 1),
                at(row, column),
            ];
            mesh.quad(
                corners,
                [f64::from(column) * cell, f64::from(row) * cell],
                stuff,
            );
        }
    }
}

/// The corners of the black square in the tag's frame, m, in the order of AprilTag's detections:
/// bottom left, bottom right, top right, top left.
pub fn corners(size_m: f64) -> [Vector3<f64>; 4] {
    let h = 0.5 * size_m;
    [(-h, h), (h, h), (h, -h), (-h, -h)].map(|(x, y)| Vector3::new(x, y, 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tag_codes_have_the_minimum_distance_of_the_family() {
        let turned = |code: u64| {
            let bit = |r: usize, c: usize| code >> (35 - (r * 6 + c)) & 1;
            (0..36).fold(0, |sum, i| sum << 1 | bit(5 - i % 6, i / 6))
        };
        for (i, &a) in CODES.iter().enumerate() {
            for &b in &CODES[i + 1..] {
                let mut b = b;
                for _ in 0..4 {
                    b = turned(b);
                    assert!((a ^ b).count_ones() >= 11, "{a:x} {b:x}");
                }
            }
        }
    }
}
