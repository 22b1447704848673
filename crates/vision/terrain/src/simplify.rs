//! Removal of triangles that feet do not need.
//!
//! Contract: edges collapse in the order of their quadric error (Garland and Heckbert 1997),
//! borders keep their place within the tolerance, holes stay holes, and triangles never turn over.
//! [`simplify`] doubles the tolerance as long as the heights at the vertices of the dense mesh,
//! measured on the simplified one, keep within the limits: the quadric error alone is no bound. The
//! image may get coarser than the feet notice.

use crate::config::SimplifyConfig;
use crate::evaluate::ErrorQuantiles;
use crate::ground::Ground;
use crate::mesh::Mesh;

mod collapse;
mod quadric;

pub use collapse::collapse;

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
    /// Share of these vertices with an error above the limit.
    pub beyond_share: f64,
}

/// The mesh with as few triangles as the limits of the configuration allow.
pub fn simplify(mesh: &Mesh, config: &SimplifyConfig) -> (Mesh, SimplifyReport) {
    let report = |tolerance_m: f64, simplified: &Mesh| {
        let errors = errors(mesh, simplified, config.min_ground_cos);
        let beyond = errors
            .iter()
            .filter(|error| error.abs() > config.max_height_m)
            .count();
        SimplifyReport {
            tolerance_m,
            triangles_before: mesh.triangles.len(),
            triangles_after: simplified.triangles.len(),
            beyond_share: beyond as f64 / errors.len().max(1) as f64,
            height_errors: ErrorQuantiles::of(errors),
        }
    };
    let mut best = (mesh.clone(), report(0.0, mesh));
    let mut tolerance_m = config.first_tolerance_m;
    while tolerance_m <= config.last_tolerance_m * (1.0 + 1e-9) {
        // From the last result: each round has fewer triangles, and errors are against the dense
        // mesh.
        let simplified = collapse(&best.0, tolerance_m);
        let of = report(tolerance_m, &simplified);
        let is_beyond = of.beyond_share > config.max_beyond_share;
        if is_beyond || of.height_errors.p95_m > config.max_height_p95_m {
            break;
        }
        best = (simplified, of);
        tolerance_m *= 2.0;
    }
    best
}

/// Sideways displacement of an edge that a foot does not notice, m.
const SIDEWAYS_M: f64 = 0.004;
/// Error that is small enough not to look sideways, m.
const SURE_M: f64 = 0.001;

/// Heights of a mesh above the upward vertices of another one, the least one within 4 mm. A vertex
/// without surface there counts with half a metre.
pub fn height_errors(dense: &Mesh, simplified: &Mesh, min_ground_cos: f64) -> ErrorQuantiles {
    ErrorQuantiles::of(errors(dense, simplified, min_ground_cos))
}

fn errors(dense: &Mesh, simplified: &Mesh, min_ground_cos: f64) -> Vec<f64> {
    let ground = Ground::new(simplified);
    let vertices = dense.positions.iter().zip(&dense.normals);
    let upward = vertices.filter(|(_, n)| f64::from(n[2]) >= min_ground_cos);
    let steps = [[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
    let error = |(p, _): (&[f32; 3], &[f32; 3])| {
        let [x, y, z] = p.map(f64::from);
        let at = |[dx, dy]: [f64; 2]| {
            let point = ground.nearest([x + SIDEWAYS_M * dx, y + SIDEWAYS_M * dy, z])?;
            Some(point.height_m - z)
        };
        if let Some(error) = at(steps[0]).filter(|error| error.abs() < SURE_M) {
            return error;
        }
        let errors = steps.into_iter().filter_map(at);
        errors
            .min_by(|a, b| a.abs().total_cmp(&b.abs()))
            .unwrap_or(0.5)
    };
    upward.map(error).collect()
}
