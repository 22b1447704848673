//! Planes of cells, by a fit of the inverse depths of the cells around each.

use rayon::prelude::*;
use simd_dispatch::Kernel;

use super::cells::{CellRow, Cells};
use super::step::step;
use crate::config::FusionConfig;
use crate::instructions::larger;
use crate::view::DepthView;

/// Planes of a row of cells.
#[derive(Clone, Debug, Default)]
pub(crate) struct PlaneRow {
    /// Gradient of the inverse depth, 1/(m px); NaN where a cell and those around it are on none.
    pub(crate) gradient: [Vec<f32>; 2],
    /// Inverse depth at the mean pixel of the cell, 1/m.
    pub(crate) inverse: Vec<f32>,
    /// Outward normal in the view.
    pub(crate) normal: [Vec<f32>; 3],
}

/// Planes of all cells.
#[derive(Clone, Debug, Default)]
pub(crate) struct Planes {
    pub(crate) rows: Vec<PlaneRow>,
}

impl Planes {
    pub(crate) fn new(
        config: &FusionConfig,
        view: &DepthView<'_>,
        cell_px: usize,
        cells: &Cells,
    ) -> Self {
        let mut rows = vec![PlaneRow::default(); cells.rows.len()];
        let each = rows.par_iter_mut().enumerate().with_min_len(4);
        each.for_each(|(row, planes)| {
            let zeros = || vec![0.0f32; cells.size[0]];
            *planes = PlaneRow {
                gradient: [zeros(), zeros()],
                inverse: zeros(),
                normal: [zeros(), zeros(), zeros()],
            };
            simd_dispatch::run(Fit {
                step_ratio: config.step_ratio as f32,
                focal_px: view.focal_px.map(|f| f as f32),
                center_px: view.center_px.map(|c| c as f32),
                cell_px: cell_px as f32,
                rows: &cells.rows[row.saturating_sub(1)..(row + 2).min(cells.rows.len())],
                row: &cells.rows[row],
                planes,
            });
        });
        Self { rows }
    }
}

/// Fits the planes of a row of cells.
struct Fit<'a> {
    step_ratio: f32,
    focal_px: [f32; 2],
    center_px: [f32; 2],
    cell_px: f32,
    /// The row and those beside it.
    rows: &'a [CellRow],
    row: &'a CellRow,
    planes: &'a mut PlaneRow,
}

/// Weighted sums over neighbors of 1, u, v, q, uu, uv, vv, uq, vq.
const SUMS: usize = 9;

impl Kernel for Fit<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let columns = self.planes.inverse.len();
        let mut sums = vec![0.0f32; SUMS * columns];
        for row in self.rows {
            for shift in 0..3 {
                add_neighbors(self.step_ratio, self.row, row, shift, &mut sums);
            }
        }
        self.solve(&sums);
    }
}

/// Adds the neighbors in a row of cells, from the left ones to the right ones, that are on the same
/// surface.
#[inline(always)]
fn add_neighbors(step_ratio: f32, own: &CellRow, other: &CellRow, shift: usize, sums: &mut [f32]) {
    let columns = sums.len() / SUMS;
    let [own_u, own_v] = [&own.at[0][1..][..columns], &own.at[1][1..][..columns]];
    let own_inverse = &own.inverse[1..][..columns];
    let own_sigma = &own.sigma[1..][..columns];
    let [other_u, other_v] = [
        &other.at[0][shift..][..columns],
        &other.at[1][shift..][..columns],
    ];
    let other_inverse = &other.inverse[shift..][..columns];
    let count = &other.count[shift..][..columns];
    let (s0, rest) = sums.split_at_mut(columns);
    let (s1, rest) = rest.split_at_mut(columns);
    let (s2, rest) = rest.split_at_mut(columns);
    let (s3, rest) = rest.split_at_mut(columns);
    let (s4, rest) = rest.split_at_mut(columns);
    let (s5, rest) = rest.split_at_mut(columns);
    let (s6, rest) = rest.split_at_mut(columns);
    let (s7, s8) = rest.split_at_mut(columns);
    let s8 = &mut s8[..columns];
    for i in 0..columns {
        let inverse = if own_inverse[i] > 0.0 {
            own_inverse[i]
        } else {
            1.0
        };
        let depth = 1.0 / inverse;
        let max_step = 2.0 * step(step_ratio, depth, own_sigma[i]);
        // The difference of depths, by the product with the other's inverse.
        let differs = (1.0 - depth * other_inverse[i]).abs() > max_step * other_inverse[i];
        let n = if differs { 0.0 } else { count[i] };
        let u = other_u[i] - own_u[i];
        let v = other_v[i] - own_v[i];
        let q = other_inverse[i] - own_inverse[i];
        let [nu, nv] = [n * u, n * v];
        s0[i] += n;
        s1[i] += nu;
        s2[i] += nv;
        s3[i] += n * q;
        s4[i] += nu * u;
        s5[i] += nu * v;
        s6[i] += nv * v;
        s7[i] += nu * q;
        s8[i] += nv * q;
    }
}

impl Fit<'_> {
    #[inline(always)]
    fn solve(self, sums: &[f32]) {
        let columns = sums.len() / SUMS;
        let of = |k: usize| &sums[k * columns..][..columns];
        let [s0, s1, s2, s3] = [of(0), of(1), of(2), of(3)];
        let [s4, s5, s6, s7, s8] = [of(4), of(5), of(6), of(7), of(8)];
        let [at_u, at_v] = [
            &self.row.at[0][1..][..columns],
            &self.row.at[1][1..][..columns],
        ];
        let own_inverse = &self.row.inverse[1..][..columns];
        let own_count = &self.row.count[1..][..columns];
        let PlaneRow {
            gradient: [out_a, out_b],
            inverse: out_inverse,
            normal: [out_x, out_y, out_z],
        } = self.planes;
        let [out_a, out_b] = [&mut out_a[..columns], &mut out_b[..columns]];
        let [out_x, out_y] = [&mut out_x[..columns], &mut out_y[..columns]];
        let [out_z, out_inverse] = [&mut out_z[..columns], &mut out_inverse[..columns]];
        let square = self.cell_px * self.cell_px;
        // Cells on a line, or a single one: a square of two by two has a quarter for both
        // variances.
        let min_determinant = 0.01 * square * square;
        for i in 0..columns {
            let share = 1.0 / larger(s0[i], 1.0);
            let [u, v, q] = [share * s1[i], share * s2[i], share * s3[i]];
            let uu = share * s4[i] - u * u;
            let uv = share * s5[i] - u * v;
            let vv = share * s6[i] - v * v;
            let uq = share * s7[i] - u * q;
            let vq = share * s8[i] - v * q;
            let determinant = uu * vv - uv * uv;
            let is_plane = (own_count[i] > 0.0) & (determinant >= min_determinant);
            let inverse_determinant = 1.0 / if is_plane { determinant } else { 1.0 };
            let a = (uq * vv - vq * uv) * inverse_determinant;
            let b = (vq * uu - uq * uv) * inverse_determinant;
            let inverse = own_inverse[i] + (q - a * u - b * v);
            let center_u = at_u[i] - self.center_px[0];
            let center_v = at_v[i] - self.center_px[1];
            let at_center = inverse - a * center_u - b * center_v;
            let [x, y] = [a * self.focal_px[0], b * self.focal_px[1]];
            let norm = larger((x * x + y * y + at_center * at_center).sqrt(), 1e-20);
            let scale = -1.0 / norm;
            out_a[i] = if is_plane { a } else { f32::NAN };
            out_b[i] = if is_plane { b } else { f32::NAN };
            out_inverse[i] = inverse;
            out_x[i] = scale * x;
            out_y[i] = scale * y;
            out_z[i] = scale * at_center;
        }
    }
}
