//! Position of a vertex from the points and normals where a surface crosses the edges of its cell.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

/// A vertex of a mesh.
#[derive(Clone, Copy, Debug)]
pub(super) struct Vertex {
    pub(super) position: [f32; 3],
    pub(super) normal: [f32; 3],
    pub(super) color: [u8; 3],
    pub(super) sigma_m: f32,
    pub(super) views: u8,
}

/// A point of the surface on an edge of a cell, in voxels from its first corner.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Crossing {
    pub(super) position: [f64; 3],
    pub(super) normal: [f64; 3],
}

impl Crossing {
    /// The point of least squared distance from the planes of the crossings, inside the cell, and
    /// their mean normal. Directions whose eigenvalue is below a share of the largest one are left
    /// at the mean of the crossings (Ju et al. 2002, Lindstrom 2000).
    pub(super) fn meeting(crossings: &[Self], min_ratio: f64) -> ([f64; 3], [f64; 3]) {
        let mean = crossings
            .iter()
            .map(|c| Vector3::from(c.position))
            .sum::<Vector3<f64>>()
            / crossings.len() as f64;
        let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
        let mut normals = Vector3::zeros();
        for crossing in crossings {
            let n = Vector3::from(crossing.normal);
            let n = n / n.norm().max(1e-12);
            matrix += n * n.transpose();
            right += n * n.dot(&(Vector3::from(crossing.position) - mean));
            normals += n;
        }
        let eigen = SymmetricEigen::new(matrix);
        let largest = eigen.eigenvalues.max();
        let mut shift = Vector3::zeros();
        for (value, vector) in eigen
            .eigenvalues
            .iter()
            .zip(eigen.eigenvectors.column_iter())
        {
            if *value > min_ratio * largest {
                shift += vector * (vector.dot(&right) / value);
            }
        }
        let position = (mean + shift).map(|v| v.clamp(0.0, 1.0));
        let normal = match normals.norm() {
            // Opposite normals: those of the first.
            norm if norm < 1e-6 => crossings.first().map_or([0.0, 0.0, 1.0], |c| c.normal),
            norm => (normals / norm).into(),
        };
        (position.into(), normal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_keep_their_mean_and_edges_meet() {
        let crossing = |position, normal| Crossing { position, normal };
        let flat = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
            .map(|[x, y]| crossing([x, y, 0.3], [0.0, 0.0, 1.0]));
        let (position, normal) = Crossing::meeting(&flat, 0.1);
        assert!((Vector3::from(position) - Vector3::new(0.5, 0.5, 0.3)).norm() < 1e-12);
        assert_eq!(normal, [0.0, 0.0, 1.0]);
        // A tread at 0.8 that ends at x = 0.6.
        let edge = [
            crossing([0.0, 0.0, 0.8], [0.0, 0.0, 1.0]),
            crossing([0.0, 1.0, 0.8], [0.0, 0.0, 1.0]),
            crossing([0.6, 0.0, 0.0], [1.0, 0.0, 0.0]),
            crossing([0.6, 1.0, 0.0], [1.0, 0.0, 0.0]),
        ];
        let (position, _) = Crossing::meeting(&edge, 0.1);
        assert!((Vector3::from(position) - Vector3::new(0.6, 0.5, 0.8)).norm() < 1e-9);
    }
}
