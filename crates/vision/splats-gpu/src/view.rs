//! A camera with an exposure as the kernels see it. In memory as `View` in `common.wgsl`.

use bytemuck::{Pod, Zeroable};
use camera_models::{Distortion, Lens};
use splats::{Camera, Exposure, RenderConfig};

/// Edge of a tile, px.
pub(crate) const TILE: u32 = 16;

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(crate) struct View {
    /// Columns, rows, columns of tiles, rows of tiles.
    pub(crate) size: [u32; 4],
    /// Gaussians, degree of the harmonics, pairs that fit, edge of the sky in texels.
    pub(crate) counts: [u32; 4],
    kinds: [u32; 4],
    rotation: [[f32; 4]; 3],
    center: [f32; 4],
    focal: [f32; 4],
    slopes: [f32; 4],
    bounds: [f32; 4],
    lens: [[f32; 4]; 3],
    time: [f32; 4],
    velocity: [f32; 4],
    rate: [f32; 4],
    shape: [f32; 4],
    limits: [f32; 4],
    bound: [f32; 4],
    exposure: [[f32; 4]; 3],
}

impl View {
    /// `counts` are zeros.
    pub(crate) fn new(camera: &Camera, exposure: &Exposure, config: &RenderConfig) -> Self {
        let model = camera.model();
        let rows = camera.camera_from_world().rotation_rows().map(|v| v as f32);
        let center = camera.camera_from_world().inverse().translation_m();
        let sizes = [model.width, model.height].map(f64::from);
        let (focal, principal) = ([model.fx, model.fy], [model.cx, model.cy]);
        let margin = f64::from(config.margin);
        let mut view = Self {
            size: [
                model.width,
                model.height,
                model.width.div_ceil(TILE),
                model.height.div_ceil(TILE),
            ],
            center: wide(center.map(|v| v as f32)),
            focal: [focal[0], focal[1], principal[0], principal[1]].map(|v| v as f32),
            shape: [
                config.dilation_px2,
                config.min_compensation,
                config.max_alpha,
                config.min_alpha,
            ],
            limits: [
                config.min_transmittance,
                config.min_depth_alpha,
                config.near_m,
                config.far_m,
            ],
            // The reach of an opaque Gaussian has a margin for rounding.
            bound: [
                config.min_shear,
                -2.0 * config.min_alpha.ln() * 1.001,
                config.slope_dilation_px2,
                config.max_slope_share / (-2.0 * config.min_alpha.ln()).sqrt(),
            ],
            exposure: exposure.matrix,
            ..Self::zeroed()
        };
        for (i, row) in view.rotation.iter_mut().enumerate() {
            *row = [rows[3 * i], rows[3 * i + 1], rows[3 * i + 2], 0.0];
        }
        for k in 0..2 {
            let beyond = margin * sizes[k] + 0.5;
            let (low, high) = (-beyond, sizes[k] - 1.0 + beyond);
            view.slopes[k] = ((low - principal[k]) / focal[k]) as f32;
            view.slopes[k + 2] = ((high - principal[k]) / focal[k]) as f32;
            (view.bounds[k], view.bounds[k + 2]) = (low as f32, high as f32);
        }
        (view.kinds[0], view.lens) = lens(camera.lens());
        view.kinds[2] = u32::from(config.compensate);
        if let Some(shutter) = camera.shutter() {
            let [gx, gy] = shutter.time_gradient_s_per_px;
            let [rx, ry] = shutter.reference_px;
            view.kinds[1] = 1;
            view.time = [gx, gy, rx, ry].map(|v| v as f32);
            view.velocity = wide(shutter.velocity_m_s.map(|v| v as f32));
            view.rate = wide(shutter.rate_rad_s.map(|v| v as f32));
        }
        view
    }

    /// Number of tiles.
    pub(crate) fn tiles(&self) -> usize {
        self.size[2] as usize * self.size[3] as usize
    }

    /// Number of pixels.
    pub(crate) fn pixels(&self) -> usize {
        self.size[0] as usize * self.size[1] as usize
    }
}

fn wide([x, y, z]: [f32; 3]) -> [f32; 4] {
    [x, y, z, 0.0]
}

/// Number of a lens and its parameters in f32, as `lens.wgsl` has them: coefficients, and in the
/// third row the end of its domain.
fn lens(lens: &Lens) -> (u32, [[f32; 4]; 3]) {
    let distortion = lens.model().distortion;
    let mut out = [[0.0; 4]; 3];
    let kind = match distortion {
        Distortion::None => 0,
        Distortion::KannalaBrandt4 { k1, k2, k3, k4 } => {
            out[0] = [k1, k2, k3, k4];
            out[2][2] = lens.widest_rad();
            2
        }
        Distortion::DoubleSphere { xi, alpha } => {
            out[0] = [xi, alpha, 0.0, 0.0];
            let w = weight(alpha);
            out[2][2] = (w + xi) / (2.0 * w * xi + xi * xi + 1.0).sqrt();
            3
        }
        Distortion::Eucm { alpha, beta } => {
            out[0] = [alpha, beta, 0.0, 0.0];
            out[2][2] = weight(alpha);
            4
        }
        ref other => {
            if let Some(of) = other.rational() {
                out[0][..3].copy_from_slice(&of.over);
                out[1][..3].copy_from_slice(&of.under);
                out[2][..2].copy_from_slice(&of.tangential);
            }
            out[2][2] = lens.widest_rad().tan().powi(2);
            1
        }
    };
    (kind, out.map(|row| row.map(|v| v as f32)))
}

/// `w` of the domains of the spherical models (Usenko et al. 2018).
fn weight(alpha: f64) -> f64 {
    match alpha <= 0.5 {
        true => alpha / (1.0 - alpha),
        false => (1.0 - alpha) / alpha,
    }
}
