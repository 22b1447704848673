//! A depth image prepared for fusion: normals, sigmas along them, usable pixels.
//!
//! Inverse depth is affine in pixel coordinates on a plane, so the normal of a cell of pixels
//! follows from a fit of inverse depths of the cells around it. The distance of a voxel from the
//! surface of a pixel is measured along that normal: along the ray it would be too long on ground
//! seen at a shallow angle.

use rayon::prelude::*;

use crate::config::FusionConfig;
use crate::view::{DepthView, PixelClass, Pose};

/// Cells across the width of an image, at least. Their edge is a power of 2.
const CELLS_ACROSS: usize = 160;
/// A depth deviates from a surface by this many sigmas, or by a step.
const STEP_SIGMAS: f32 = 5.0;

/// A pixel as voxels need it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Pixel {
    /// Depth, m; 0 where absent.
    pub(crate) depth: f32,
    /// Distance along the normal of a difference of depths of 1.
    pub(crate) cos: f32,
    /// One standard deviation along the normal, m.
    pub(crate) sigma: f32,
    /// Weight as a surface; 0 where the pixel only shows that the space before it is free.
    pub(crate) weight: f32,
}

/// Plane of a cell of pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Cell {
    /// Depths of its pixels, m; the minimum is infinite without depth.
    pub(crate) min_depth: f32,
    pub(crate) max_depth: f32,
    /// Mean pixel, inverse depth and sigma of depth of its pixels on one surface, and their number.
    pub(crate) at: [f32; 2],
    pub(crate) inverse: f32,
    pub(crate) sigma: f32,
    pub(crate) count: u32,
    /// Gradient of the inverse depth, 1/(m px), if there is a plane.
    pub(crate) gradient: Option<[f32; 2]>,
    /// Outward normal in the view.
    pub(crate) normal: [f32; 3],
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Frame<'a> {
    pub(crate) view: &'a DepthView<'a>,
    pub(crate) pose: Pose,
    pub(crate) pixels: Vec<Pixel>,
    /// Edge of a cell, px.
    pub(crate) cell_px: usize,
    /// Columns and rows of cells.
    pub(crate) cells_size: [usize; 2],
    pub(crate) cells: Vec<Cell>,
}

impl<'a> Frame<'a> {
    pub(crate) fn new(config: &FusionConfig, view: &'a DepthView<'a>) -> Self {
        let cell_px = 1 << (view.size[0] / CELLS_ACROSS).max(2).ilog2();
        let cells_size = view.size.map(|size| size.div_ceil(cell_px));
        let mut frame = Self {
            view,
            pose: Pose::new(&view.world_from_view),
            pixels: Vec::new(),
            cell_px,
            cells_size,
            cells: Vec::new(),
        };
        let count = cells_size[0] * cells_size[1];
        frame.cells = (0..count)
            .into_par_iter()
            .with_min_len(cells_size[0])
            .map(|i| frame.mean(config, [i % cells_size[0], i / cells_size[0]]))
            .collect();
        frame.cells = (0..count)
            .into_par_iter()
            .with_min_len(cells_size[0])
            .map(|i| frame.fitted(config, [i % cells_size[0], i / cells_size[0]]))
            .collect();
        let width = view.size[0];
        let mut pixels = vec![Pixel::default(); width * view.size[1]];
        pixels
            .par_chunks_mut(width)
            .enumerate()
            .with_min_len(8)
            .for_each(|(row, pixels)| frame.prepare_row(config, row, pixels));
        frame.pixels = pixels;
        frame
    }

    /// Depths of a cell, and the mean of those on the surface at its center.
    fn mean(&self, config: &FusionConfig, [column, row]: [usize; 2]) -> Cell {
        let [width, height] = self.view.size;
        let (first, end) = (
            [column, row].map(|k| k * self.cell_px),
            [(column + 1) * self.cell_px, (row + 1) * self.cell_px],
        );
        let end = [end[0].min(width), end[1].min(height)];
        let center = first.map(|k| k + self.cell_px / 2);
        let mut cell = Cell {
            min_depth: f32::INFINITY,
            ..Cell::default()
        };
        let (mut reference, mut nearest) = ((0.0, 0.0), usize::MAX);
        for v in first[1]..end[1] {
            for u in first[0]..end[0] {
                let pixel = v * width + u;
                let Some((depth, sigma)) = self.view.depth(pixel) else {
                    continue;
                };
                if self.view.class(pixel) == PixelClass::Excluded {
                    continue;
                }
                cell.min_depth = cell.min_depth.min(depth);
                cell.max_depth = cell.max_depth.max(depth);
                let distance = u.abs_diff(center[0]) + v.abs_diff(center[1]);
                if distance < nearest {
                    (reference, nearest) = ((depth, sigma), distance);
                }
            }
        }
        let max_step = step(config, reference.0, reference.1);
        let mut sums = [0.0f32; 4];
        for v in first[1]..end[1] {
            for u in first[0]..end[0] {
                let pixel = v * width + u;
                let Some((depth, sigma)) = self.view.depth(pixel) else {
                    continue;
                };
                if self.view.class(pixel) == PixelClass::Static
                    && (depth - reference.0).abs() <= max_step
                {
                    let of = [
                        (u - first[0]) as f32,
                        (v - first[1]) as f32,
                        1.0 / depth,
                        sigma,
                    ];
                    for (sum, of) in sums.iter_mut().zip(of) {
                        *sum += of;
                    }
                    cell.count += 1;
                }
            }
        }
        if cell.count > 0 {
            let [u, v, inverse, sigma] = sums.map(|sum| sum / cell.count as f32);
            cell.at = [first[0] as f32 + u, first[1] as f32 + v];
            (cell.inverse, cell.sigma) = (inverse, sigma);
        }
        cell
    }

    /// The cell with its plane, if it and the cells around it are on one.
    fn fitted(&self, config: &FusionConfig, [column, row]: [usize; 2]) -> Cell {
        let [columns, rows] = self.cells_size;
        let mut cell = self.cells[row * columns + column];
        if cell.count == 0 {
            return cell;
        }
        let depth = 1.0 / cell.inverse;
        let max_step = 2.0 * step(config, depth, cell.sigma);
        let (mut count, mut mean) = (0.0f64, [0.0f64; 3]);
        let mut second = [0.0f64; 5];
        for j in row.saturating_sub(1)..(row + 2).min(rows) {
            for i in column.saturating_sub(1)..(column + 2).min(columns) {
                let other = &self.cells[j * columns + i];
                // The difference of depths, by the product with the other's inverse.
                let differs = (1.0 - depth * other.inverse).abs() > max_step * other.inverse;
                if other.count == 0 || differs {
                    continue;
                }
                let n = f64::from(other.count);
                let u = f64::from(other.at[0] - cell.at[0]);
                let v = f64::from(other.at[1] - cell.at[1]);
                let q = f64::from(other.inverse - cell.inverse);
                count += n;
                for (sum, of) in mean.iter_mut().zip([u, v, q]) {
                    *sum += n * of;
                }
                for (sum, of) in second.iter_mut().zip([u * u, u * v, v * v, u * q, v * q]) {
                    *sum += n * of;
                }
            }
        }
        let share = 1.0 / count;
        let [u, v, q] = mean.map(|sum| sum * share);
        let [uu, uv, vv, uq, vq] = second.map(|sum| sum * share);
        let (uu, uv, vv) = (uu - u * u, uv - u * v, vv - v * v);
        let (uq, vq) = (uq - u * q, vq - v * q);
        let determinant = uu * vv - uv * uv;
        let side = self.cell_px as f64;
        // Cells on a line, or a single one: a square of two by two has a quarter for both
        // variances.
        if determinant < 0.01 * side.powi(4) {
            return cell;
        }
        let inverse_determinant = 1.0 / determinant;
        let a = (uq * vv - vq * uv) * inverse_determinant;
        let b = (vq * uu - uq * uv) * inverse_determinant;
        cell.gradient = Some([a as f32, b as f32]);
        cell.inverse += (q - a * u - b * v) as f32;
        let view = self.view;
        let at_center = f64::from(cell.inverse)
            - a * (f64::from(cell.at[0]) - view.center_px[0])
            - b * (f64::from(cell.at[1]) - view.center_px[1]);
        let away = [a * view.focal_px[0], b * view.focal_px[1], at_center];
        let norm = (away[0] * away[0] + away[1] * away[1] + away[2] * away[2]).sqrt();
        cell.normal = away.map(|v| (-v / norm) as f32);
        cell
    }

    fn prepare_row(&self, config: &FusionConfig, row: usize, pixels: &mut [Pixel]) {
        let view = self.view;
        let width = view.size[0];
        let margin = (config.step_margin * width as f64 / 640.0).round() as usize;
        let inverse_focal = view.focal_px.map(|f| (1.0 / f) as f32);
        let center = view.center_px.map(|c| c as f32);
        let ray_y = (row as f32 - center[1]) * inverse_focal[1];
        let cells = &self.cells[row / self.cell_px * self.cells_size[0]..][..self.cells_size[0]];
        let floor = 0.25 * config.unit_sigma_m * config.unit_sigma_m
            + view.pose_sigma_m * view.pose_sigma_m;
        let (floor, unit) = (
            floor as f32,
            (config.unit_sigma_m * config.unit_sigma_m) as f32,
        );
        let [min_cos, max_depth, max_sigma] = [
            config.min_incidence_cos,
            config.max_depth_m,
            config.max_sigma_m,
        ]
        .map(|v| v as f32);
        for (column, out) in pixels.iter_mut().enumerate() {
            let pixel = row * width + column;
            let Some((depth, sigma)) = view.depth(pixel) else {
                continue;
            };
            let class = view.class(pixel);
            if class == PixelClass::Excluded {
                continue;
            }
            *out = Pixel {
                depth,
                cos: min_cos,
                sigma: sigma * min_cos,
                weight: 0.0,
            };
            let cell = &cells[column / self.cell_px];
            let Some([a, b]) = cell.gradient.filter(|_| class == PixelClass::Static) else {
                continue;
            };
            let inverse =
                cell.inverse + a * (column as f32 - cell.at[0]) + b * (row as f32 - cell.at[1]);
            let max_step = step(config, depth, sigma);
            // The deviation of the depth from the plane, by the product with the inverse depth.
            // False where the plane is behind the camera.
            if !(inverse > 0.0 && (depth * inverse - 1.0).abs() <= max_step * inverse) {
                continue;
            }
            let ray_x = (column as f32 - center[0]) * inverse_focal[0];
            let n = cell.normal;
            let cos = -(n[0] * ray_x + n[1] * ray_y + n[2]);
            let is_shallow = cos * cos < min_cos * min_cos * (1.0 + ray_x * ray_x + ray_y * ray_y);
            // The sigma at the depth of the plane: that of stereo grows with the square of the
            // depth, and depths that are too small by chance must not count more.
            let relative = 1.0 / (depth * inverse);
            let along = sigma * relative * relative * cos;
            let variance = along * along + floor;
            if is_shallow || depth > max_depth || variance > max_sigma * max_sigma {
                continue;
            }
            let is_seam =
                margin > 0 && self.is_foreground(column, row, margin, [inverse, a, b], max_step);
            if is_seam {
                continue;
            }
            *out = Pixel {
                depth,
                cos,
                sigma: variance.sqrt(),
                weight: unit / variance,
            };
        }
    }

    /// Whether a pixel at this distance is farther than the plane by more than a step.
    fn is_foreground(
        &self,
        column: usize,
        row: usize,
        margin: usize,
        [inverse, a, b]: [f32; 3],
        max_step: f32,
    ) -> bool {
        let [width, height] = self.view.size;
        let m = margin as f32;
        let farther = |column: usize, row: usize, inverse: f32| {
            let depth = self.view.depth_m[row * width + column];
            // False for NaN. A plane that reaches the horizon has no farther side.
            inverse > 0.0 && depth * inverse - 1.0 > max_step * inverse
        };
        column >= margin && farther(column - margin, row, inverse - m * a)
            || column + margin < width && farther(column + margin, row, inverse + m * a)
            || row >= margin && farther(column, row - margin, inverse - m * b)
            || row + margin < height && farther(column, row + margin, inverse + m * b)
    }
}

/// Difference of depths that is a step.
pub(crate) fn step(config: &FusionConfig, depth: f32, sigma: f32) -> f32 {
    (STEP_SIGMAS * sigma).max(config.step_ratio as f32 * depth)
}
