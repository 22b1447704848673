//! Pixels as voxels need them.

use simd_dispatch::Kernel;

use super::cells::Cells;
use super::fit::Planes;
use super::step::step;
use crate::config::FusionConfig;
use crate::view::DepthView;

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

/// Which pixels are surfaces, and with which weight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rules {
    step_ratio: f32,
    /// Width of the seam of foreground that is not used, px.
    margin: usize,
    inverse_focal: [f32; 2],
    center: [f32; 2],
    /// Variance that no observation is better than, m2.
    floor: f32,
    /// Variance of weight 1, m2.
    unit: f32,
    min_cos: f32,
    max_depth: f32,
    max_variance: f32,
}

impl Rules {
    pub(crate) fn new(config: &FusionConfig, view: &DepthView<'_>) -> Self {
        let unit = config.unit_sigma_m * config.unit_sigma_m;
        let floor = 0.25 * unit + view.pose_sigma_m * view.pose_sigma_m;
        Self {
            step_ratio: config.step_ratio as f32,
            margin: (config.step_margin * view.size[0] as f64 / 640.0).round() as usize,
            inverse_focal: view.focal_px.map(|f| (1.0 / f) as f32),
            center: view.center_px.map(|c| c as f32),
            floor: floor as f32,
            unit: unit as f32,
            min_cos: config.min_incidence_cos as f32,
            max_depth: config.max_depth_m as f32,
            max_variance: (config.max_sigma_m * config.max_sigma_m) as f32,
        }
    }

    /// Squared horizontal parts of the rays of columns.
    pub(crate) fn ray_squares(&self, columns: usize) -> Vec<f32> {
        let ray = |u: usize| (u as f32 - self.center[0]) * self.inverse_focal[0];
        (0..columns).map(|u| ray(u) * ray(u)).collect()
    }
}

/// Fills a row of pixels.
pub(crate) struct Row<'a> {
    pub(crate) rules: &'a Rules,
    pub(crate) view: &'a DepthView<'a>,
    pub(crate) row: usize,
    /// Edge of a cell, px.
    pub(crate) cell_px: usize,
    pub(crate) cells: &'a Cells,
    pub(crate) planes: &'a Planes,
    /// Depths of the image, m; 0 for none, negative for pixels that are not known to be static.
    pub(crate) depth: &'a [f32],
    /// Squared horizontal parts of the rays of the columns.
    pub(crate) ray_squares: &'a [f32],
    pub(crate) pixels: &'a mut [Pixel],
}

/// The planes of cells at the pixels of a row.
struct CellPlanes {
    /// Inverse depth; NaN without plane.
    inverse: Vec<f32>,
    /// See [`Pixel::cos`].
    cos: Vec<f32>,
    /// Change of the inverse depth over the width of the seam, to the right and downwards.
    right: Vec<f32>,
    down: Vec<f32>,
    /// Above 0 for pixels beside something farther.
    seam: Vec<f32>,
}

impl Kernel for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let width = self.pixels.len();
        let mut predicted = self.predicted();
        if self.rules.margin > 0 {
            self.mark_seam(&mut predicted);
        }
        let rules = *self.rules;
        let from = self.row * width;
        let depths = &self.depth[from..][..width];
        let sigmas = &self.view.sigma_m[from..][..width];
        let inverses = &predicted.inverse[..width];
        let cosines = &predicted.cos[..width];
        let seam = &predicted.seam[..width];
        let ray_y = (self.row as f32 - rules.center[1]) * rules.inverse_focal[1];
        let (along, min_square) = (1.0 + ray_y * ray_y, rules.min_cos * rules.min_cos);
        let across = &self.ray_squares[..width];
        let Outputs { cos, sigma, weight } = &mut Outputs::new(width);
        let [out_cos, out_sigma] = [&mut cos[..width], &mut sigma[..width]];
        let out_weight = &mut weight[..width];
        for u in 0..width {
            let (depth, sigma) = (depths[u].abs(), sigmas[u]);
            let is_static = depths[u] > 0.0;
            let (inverse, cos) = (inverses[u], cosines[u]);
            let max_step = step(rules.step_ratio, depth, sigma);
            let product = depth * inverse;
            // The deviation of the depth from the plane, by the product with the inverse depth.
            // False without plane, and where it is behind the camera.
            let is_on_plane = (inverse > 0.0) & ((product - 1.0).abs() <= max_step * inverse);
            let is_steep = cos * cos >= min_square * (across[u] + along);
            // The sigma at the depth of the plane: that of stereo grows with the square of the
            // depth, and depths that are too small by chance must not count more.
            let relative = 1.0 / if is_on_plane { product } else { 1.0 };
            let along_normal = sigma * relative * relative * cos;
            let variance = along_normal * along_normal + rules.floor;
            let is_surface = is_on_plane
                & is_static
                & is_steep
                & (seam[u] == 0.0)
                & (depth <= rules.max_depth)
                & (variance <= rules.max_variance);
            let blunt = sigma * rules.min_cos;
            out_weight[u] = if is_surface {
                rules.unit / variance
            } else {
                0.0
            };
            out_cos[u] = if is_surface { cos } else { rules.min_cos };
            out_sigma[u] = if is_surface { variance.sqrt() } else { blunt };
        }
        let pixels = &mut self.pixels[..width];
        for u in 0..width {
            pixels[u] = Pixel {
                depth: depths[u].abs(),
                cos: out_cos[u],
                sigma: out_sigma[u],
                weight: out_weight[u],
            };
        }
    }
}

/// Values of the pixels of a row.
struct Outputs {
    cos: Vec<f32>,
    sigma: Vec<f32>,
    weight: Vec<f32>,
}

impl Outputs {
    fn new(width: usize) -> Self {
        let zeros = || vec![0.0; width];
        Self {
            cos: zeros(),
            sigma: zeros(),
            weight: zeros(),
        }
    }
}

impl Row<'_> {
    #[inline(always)]
    fn predicted(&self) -> CellPlanes {
        let width = self.pixels.len();
        let zeros = || vec![0.0f32; width];
        let mut predicted = CellPlanes {
            inverse: zeros(),
            cos: zeros(),
            right: zeros(),
            down: zeros(),
            seam: zeros(),
        };
        let rules = self.rules;
        let cells = &self.cells.rows[self.row / self.cell_px];
        let planes = &self.planes.rows[self.row / self.cell_px];
        let row = self.row as f32;
        let ray_y = (row - rules.center[1]) * rules.inverse_focal[1];
        let margin = rules.margin as f32;
        for column in 0..self.cells.size[0] {
            let first = column * self.cell_px;
            let end = (first + self.cell_px).min(width);
            let [a, b] = [planes.gradient[0][column], planes.gradient[1][column]];
            let [x, y, z] = [0, 1, 2].map(|k| planes.normal[k][column]);
            let [at_u, at_v] = [cells.at[0][column + 1], cells.at[1][column + 1]];
            let inverse = planes.inverse[column] + a * (first as f32 - at_u) + b * (row - at_v);
            let ray_x = (first as f32 - rules.center[0]) * rules.inverse_focal[0];
            let cos = -(x * ray_x + y * ray_y + z);
            let turn = -x * rules.inverse_focal[0];
            for u in first..end {
                let k = (u - first) as f32;
                predicted.inverse[u] = inverse + k * a;
                predicted.cos[u] = cos + k * turn;
            }
            predicted.right[first..end].fill(margin * a);
            predicted.down[first..end].fill(margin * b);
        }
        predicted
    }

    /// Marks pixels beside which something is farther than their plane by more than a step.
    #[inline(always)]
    fn mark_seam(&self, predicted: &mut CellPlanes) {
        let width = self.pixels.len();
        let (margin, height) = (self.rules.margin, self.view.size[1]);
        let line = |row: usize| &self.view.depth_m[row * width..][..width];
        let own = self.row * width;
        let (depth, sigma) = (
            &self.depth[own..][..width],
            &self.view.sigma_m[own..][..width],
        );
        let CellPlanes {
            inverse,
            right,
            down,
            seam,
            ..
        } = predicted;
        let ratio = self.rules.step_ratio;
        let all = [&inverse[..], &right[..], depth, sigma];
        if margin < width {
            let kept = all.map(|of| &of[margin..]);
            mark(ratio, -1.0, kept, line(self.row), &mut seam[margin..]);
            let kept = all.map(|of| &of[..width - margin]);
            mark(
                ratio,
                1.0,
                kept,
                &line(self.row)[margin..],
                &mut seam[..width - margin],
            );
        }
        let all = [&inverse[..], &down[..], depth, sigma];
        if self.row >= margin {
            mark(ratio, -1.0, all, line(self.row - margin), seam);
        }
        if self.row + margin < height {
            mark(ratio, 1.0, all, line(self.row + margin), seam);
        }
    }
}

/// Marks pixels where another depth is behind their plane; of the pixels: inverse depth of the
/// plane, its change to the other pixel but for the sign, depth and sigma.
#[inline(always)]
fn mark(
    step_ratio: f32,
    sign: f32,
    [inverse, change, depth, sigma]: [&[f32]; 4],
    other: &[f32],
    seam: &mut [f32],
) {
    let count = seam.len();
    let [inverse, change, other] = [&inverse[..count], &change[..count], &other[..count]];
    let [depth, sigma] = [&depth[..count], &sigma[..count]];
    for i in 0..count {
        let at_plane = inverse[i] + sign * change[i];
        let max_step = step(step_ratio, depth[i], sigma[i]);
        // False for NaN. A plane that reaches the horizon has no farther side.
        let is_farther = (at_plane > 0.0) & (other[i] * at_plane - 1.0 > max_step * at_plane);
        seam[i] = if is_farther { 1.0 } else { seam[i] };
    }
}
