//! Removal of triangles that feet do not need.
//!
//! Contract: edges collapse in the order of their quadric error (Garland and Heckbert 1997), borders
//! stay where they are, and triangles never turn over. [`simplify`] doubles the tolerance as long as
//! the heights at the vertices of the dense mesh, measured on the simplified one, keep within the
//! limits: the quadric error alone is no bound. The image may get coarser than the feet notice.

use crate::config::SimplifyConfig;
use crate::evaluate::ErrorQuantiles;
use crate::mesh::Mesh;

mod collapse;
mod heights;
mod quadric;

pub use collapse::collapse;

use heights::HeightIndex;

/// What a simplified mesh keeps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SimplifyReport {
    /// Tolerance of the quadric error, m; 0 if even the first one was too large.
    pub tolerance_m: f64,
    /// Triangles of the dense mesh.
    pub triangles_before: usize,
    /// Triangles of the simplified one.
    pub triangles_after: usize,
    /// Heights of the simplified mesh above vertices of the dense one.
    pub height_errors: ErrorQuantiles,
}

/// The mesh with as few triangles as the limits of the configuration allow.
pub fn simplify(mesh: &Mesh, config: &SimplifyConfig) -> (Mesh, SimplifyReport) {
    let report = |tolerance_m: f64, simplified: &Mesh| SimplifyReport {
        tolerance_m,
        triangles_before: mesh.triangles.len(),
        triangles_after: simplified.triangles.len(),
        height_errors: height_errors(mesh, simplified, config.min_ground_cos),
    };
    let mut best = (mesh.clone(), report(0.0, mesh));
    let mut tolerance_m = config.first_tolerance_m;
    while tolerance_m <= config.last_tolerance_m * (1.0 + 1e-9) {
        let simplified = collapse(mesh, tolerance_m);
        let of = report(tolerance_m, &simplified);
        let errors = &of.height_errors;
        if errors.p95_m > config.max_height_p95_m || errors.max_m > config.max_height_m {
            break;
        }
        best = (simplified, of);
        tolerance_m *= 2.0;
    }
    best
}

/// Heights of a mesh above the upward vertices of another one. A vertex without surface nearby
/// counts with half a metre.
pub fn height_errors(dense: &Mesh, simplified: &Mesh, min_ground_cos: f64) -> ErrorQuantiles {
    let index = HeightIndex::new(simplified, 0.1);
    let vertices = dense.positions.iter().zip(&dense.normals);
    let ground = vertices.filter(|(_, n)| f64::from(n[2]) >= min_ground_cos);
    ErrorQuantiles::of(ground.map(|(p, _)| {
        let p = p.map(f64::from);
        // Vertices on borders may be just outside by rounding.
        index.nearest_height(p).map_or(0.5, |height| height - p[2])
    }))
}
