//! Outlines of planes.

use terrain::planes::{PlaneOutline, Polygon};

/// A plane of a scene: its corners along two axes of length 1 from a point.
pub(crate) fn plane(origin: [f64; 3], axes: [[f64; 3]; 2], corners: &[[f64; 2]]) -> PlaneOutline {
    let [u, v] = axes;
    PlaneOutline {
        center: origin,
        normal: [
            u[1] * v[2] - u[2] * v[1],
            u[2] * v[0] - u[0] * v[2],
            u[0] * v[1] - u[1] * v[0],
        ],
        axes,
        sigma_m: 0.001,
        tilt_sigma_rad: [0.001; 2],
        depths: 1000,
        views: 5,
        chi_square: 1.0,
        polygons: vec![Polygon {
            outline: corners.to_vec(),
            holes: Vec::new(),
        }],
    }
}

/// A level rectangle.
pub(crate) fn tread(z: f64, [from, to]: [[f64; 2]; 2]) -> PlaneOutline {
    let corners = [from, [to[0], from[1]], to, [from[0], to[1]]];
    plane([0.0, 0.0, z], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], &corners)
}

/// An upright rectangle across x that faces backwards.
pub(crate) fn riser(x: f64, y: [f64; 2], z: [f64; 2]) -> PlaneOutline {
    let corners = [[-y[1], z[0]], [-y[0], z[0]], [-y[0], z[1]], [-y[1], z[1]]];
    plane([x, 0.0, 0.0], [[0.0, -1.0, 0.0], [0.0, 0.0, 1.0]], &corners)
}
