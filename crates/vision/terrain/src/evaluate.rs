//! Errors of results against ground truth, which comes as functions.

use crate::mesh::Mesh;

/// Quantiles of absolute errors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorQuantiles {
    /// Number of errors.
    pub count: usize,
    /// Half of the errors are at most this, m.
    pub median_m: f64,
    /// 95 % are at most this, m.
    pub p95_m: f64,
    /// The largest, m.
    pub max_m: f64,
    /// Mean with sign: positive above or outside of the truth, m.
    pub mean_m: f64,
}

impl ErrorQuantiles {
    /// Of errors with sign. Errors that are not finite are left out.
    ///
    /// ```
    /// use terrain::evaluate::ErrorQuantiles;
    ///
    /// let errors = ErrorQuantiles::of([0.01, -0.03, 0.02]);
    /// assert_eq!((errors.median_m, errors.max_m), (0.02, 0.03));
    /// ```
    pub fn of(errors: impl IntoIterator<Item = f64>) -> Self {
        let errors: Vec<f64> = errors.into_iter().filter(|e| e.is_finite()).collect();
        let mut sizes: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
        sizes.sort_unstable_by(f64::total_cmp);
        let Some(max_m) = sizes.last() else {
            return Self::default();
        };
        let at = |share: f64| sizes[((share * sizes.len() as f64) as usize).min(sizes.len() - 1)];
        Self {
            count: sizes.len(),
            median_m: at(0.5),
            p95_m: at(0.95),
            max_m: *max_m,
            mean_m: errors.iter().sum::<f64>() / errors.len() as f64,
        }
    }
}

/// Heights of upward vertices above the true height at their place. Places for which the truth has
/// none are left out.
pub fn height_errors(mesh: &Mesh, truth: impl Fn(f64, f64) -> Option<f64>) -> ErrorQuantiles {
    let vertices = mesh.positions.iter().zip(&mesh.normals);
    let errors = vertices.filter(|(_, n)| n[2] > 0.8).filter_map(|(p, _)| {
        let [x, y, z] = p.map(f64::from);
        Some(z - truth(x, y)?)
    });
    ErrorQuantiles::of(errors)
}

/// Distances of vertices from the true surface.
pub fn surface_errors(mesh: &Mesh, distance: impl Fn([f64; 3]) -> f64) -> ErrorQuantiles {
    ErrorQuantiles::of(mesh.positions.iter().map(|p| distance(p.map(f64::from))))
}

/// Share of vertices whose distance from the true surface is at most two of their sigmas.
pub fn two_sigma_share(mesh: &Mesh, distance: impl Fn([f64; 3]) -> f64) -> f64 {
    let vertices = mesh.positions.iter().zip(&mesh.sigma_m);
    let within =
        vertices.filter(|(p, sigma)| distance(p.map(f64::from)).abs() <= 2.0 * f64::from(**sigma));
    within.count() as f64 / mesh.positions.len().max(1) as f64
}
