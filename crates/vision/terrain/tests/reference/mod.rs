//! Reference implementation of fusion: a dense grid, f64, every voxel projected on its own.

#![allow(unreachable_pub, reason = "a module of several tests")]

use terrain::{DepthView, FusionConfig, PixelClass};

#[derive(Clone, Copy, Default)]
pub struct DenseVoxel {
    pub distance_m: f64,
    pub weight: f64,
    seen: u32,
    contradictions: u8,
}

/// Voxels of a box of the world, from one voxel to another (not included).
pub struct Dense {
    config: FusionConfig,
    from: [i64; 3],
    size: [usize; 3],
    pub voxels: Vec<DenseVoxel>,
}

struct Plane {
    gradient: [f64; 2],
    at: [f64; 2],
    inverse: f64,
}

impl Dense {
    pub fn new(config: FusionConfig, from: [i64; 3], to: [i64; 3]) -> Self {
        let size = [0, 1, 2].map(|k| (to[k] - from[k]) as usize);
        Self {
            config,
            from,
            size,
            voxels: vec![DenseVoxel::default(); size[0] * size[1] * size[2]],
        }
    }

    pub fn place(&self, voxel: usize) -> [i64; 3] {
        let x = voxel % self.size[0];
        let y = voxel / self.size[0] % self.size[1];
        let z = voxel / self.size[0] / self.size[1];
        [x, y, z]
            .iter()
            .zip(self.from)
            .map(|(k, from)| *k as i64 + from)
            .collect::<Vec<_>>()
            .try_into()
            .expect("three")
    }

    pub fn add(&mut self, view: &DepthView<'_>) {
        let inverse = view.world_from_view.inverse();
        for voxel in 0..self.voxels.len() {
            let at_pose = inverse.apply(self.place(voxel).map(|k| k as f64 * self.config.voxel_m));
            if at_pose[2] < 0.1 {
                continue;
            }
            let mut x = at_pose;
            for _ in 0..6 {
                let row = view.focal_px[1] * x[1] / x[2] + view.center_px[1];
                x = view.row_motion.at_row(row, at_pose);
            }
            let pixel =
                [0, 1].map(|k| (view.focal_px[k] * x[k] / x[2] + view.center_px[k]).round());
            if (0..2).any(|k| pixel[k] < 0.0 || pixel[k] >= view.size[k] as f64) {
                continue;
            }
            let [column, row] = pixel.map(|k| k as usize);
            self.update(voxel, x, view, [column, row]);
        }
    }

    fn update(&mut self, voxel: usize, x: [f64; 3], view: &DepthView<'_>, at: [usize; 2]) {
        let config = self.config;
        let Some((depth, sigma)) = depth(view, at) else {
            return;
        };
        let surface = surface(&config, view, at, depth, sigma);
        let blunt = [0.0, 0.0, config.min_incidence_cos];
        let (away, sigma) = surface.unwrap_or((blunt, sigma * config.min_incidence_cos));
        let ray = [0, 1].map(|k| (at[k] as f64 - view.center_px[k]) / view.focal_px[k]);
        let cos = away[0] * ray[0] + away[1] * ray[1] + away[2];
        let along_ray = (depth - x[2]) * cos;
        // Distance of the voxel from the plane through the point of the pixel.
        let surface_point = [depth * ray[0], depth * ray[1], depth];
        let distance: f64 = (0..3).map(|k| away[k] * (surface_point[k] - x[k])).sum();
        let front = (3.0 * sigma)
            .min(config.max_front_m)
            .max(3.0 * config.voxel_m);
        let back = (3.0 * sigma)
            .min(config.max_back_m)
            .max(1.5 * config.voxel_m);
        let weight = (config.unit_sigma_m / sigma).powi(2);
        let voxel = &mut self.voxels[voxel];
        if along_ray > front {
            if voxel.weight > 0.0 && voxel.seen > 0 && voxel.distance_m < 1.5 * config.voxel_m {
                voxel.contradictions += 1;
                if voxel.contradictions >= config.min_contradictions {
                    voxel.weight /= 2.0;
                    if surface.is_some() {
                        fuse(voxel, 3.0 * config.voxel_m, weight);
                    }
                }
            }
        } else if surface.is_some() && along_ray > -back && distance > -back {
            let share = ((back + distance) / (back - config.voxel_m)).clamp(0.0, 1.0);
            let share = if distance >= -config.voxel_m {
                1.0
            } else {
                share
            };
            fuse(voxel, distance, weight * share);
            if distance.abs() < config.voxel_m {
                voxel.seen += 1;
                voxel.contradictions = voxel.contradictions.saturating_sub(1);
            }
        }
    }
}

fn fuse(voxel: &mut DenseVoxel, distance: f64, weight: f64) {
    let sum = voxel.weight + weight;
    voxel.distance_m = (voxel.weight * voxel.distance_m + weight * distance) / sum;
    voxel.weight = sum.min(65535.0 / 4096.0);
}

fn depth(view: &DepthView<'_>, [column, row]: [usize; 2]) -> Option<(f64, f64)> {
    let pixel = row * view.size[0] + column;
    let (depth, sigma) = (
        f64::from(view.depth_m[pixel]),
        f64::from(view.sigma_m[pixel]),
    );
    let excluded = view
        .classes
        .is_some_and(|classes| classes[pixel] == PixelClass::Excluded);
    (depth > 0.0 && sigma > 0.0 && !excluded).then_some((depth, sigma))
}

/// Inward normal, and sigma along it, of a pixel that is a surface.
fn surface(
    config: &FusionConfig,
    view: &DepthView<'_>,
    at: [usize; 2],
    depth_m: f64,
    sigma_m: f64,
) -> Option<([f64; 3], f64)> {
    let is_static = |[u, v]: [usize; 2]| {
        let class = view.classes.map(|classes| classes[v * view.size[0] + u]);
        class.is_none_or(|class| class == PixelClass::Static)
    };
    if !is_static(at) {
        return None;
    }
    let side = [8, 4, 2]
        .into_iter()
        .find(|side| side * 160 <= view.size[0])
        .unwrap_or(2);
    let plane = plane(config, view, at.map(|k| k / side), side, &is_static)?;
    let predict = |du: f64, dv: f64| {
        plane.inverse
            + plane.gradient[0] * (at[0] as f64 + du - plane.at[0])
            + plane.gradient[1] * (at[1] as f64 + dv - plane.at[1])
    };
    let step = (5.0 * sigma_m).max(config.step_ratio * depth_m);
    let inverse = predict(0.0, 0.0);
    if !(inverse > 0.0 && (depth_m - 1.0 / inverse).abs() <= step) {
        return None;
    }
    let margin = (config.step_margin * view.size[0] as f64 / 640.0).round();
    for (du, dv) in [(-margin, 0.0), (margin, 0.0), (0.0, -margin), (0.0, margin)] {
        let other = [at[0] as f64 + du, at[1] as f64 + dv];
        if (0..2).any(|k| other[k] < 0.0 || other[k] >= view.size[k] as f64) {
            continue;
        }
        let pixel = other[1] as usize * view.size[0] + other[0] as usize;
        let inverse = predict(du, dv);
        if inverse > 0.0 && f64::from(view.depth_m[pixel]) - 1.0 / inverse > step {
            return None;
        }
    }
    // Normal of the plane n . x = 1 through the view: its inverse depth is n . ray.
    let ray = [0, 1].map(|k| (at[k] as f64 - view.center_px[k]) / view.focal_px[k]);
    let n = [
        plane.gradient[0] * view.focal_px[0],
        plane.gradient[1] * view.focal_px[1],
        predict(
            view.center_px[0] - at[0] as f64,
            view.center_px[1] - at[1] as f64,
        ),
    ];
    let norm = n.iter().map(|k| k * k).sum::<f64>().sqrt();
    let cos = (n[0] * ray[0] + n[1] * ray[1] + n[2]) / norm;
    let incidence = cos / (1.0 + ray[0] * ray[0] + ray[1] * ray[1]).sqrt();
    let variance = (sigma_m / (inverse * depth_m).powi(2) * cos).powi(2)
        + view.pose_sigma_m.powi(2)
        + 0.25 * config.unit_sigma_m.powi(2);
    let usable = incidence >= config.min_incidence_cos
        && depth_m <= config.max_depth_m
        && variance.sqrt() <= config.max_sigma_m;
    usable.then(|| (n.map(|k| k / norm), variance.sqrt()))
}

fn plane(
    config: &FusionConfig,
    view: &DepthView<'_>,
    cell: [usize; 2],
    side: usize,
    is_static: &dyn Fn([usize; 2]) -> bool,
) -> Option<Plane> {
    let (_, depth, sigma) = cell_mean(config, view, cell, side, is_static)?;
    let max_step = 2.0 * (5.0 * sigma).max(config.step_ratio * depth);
    let mut points = Vec::new();
    for row in cell[1].saturating_sub(1)..=cell[1] + 1 {
        for column in cell[0].saturating_sub(1)..=cell[0] + 1 {
            let Some((pixels, other, _)) = cell_mean(config, view, [column, row], side, is_static)
            else {
                continue;
            };
            if (other - depth).abs() <= max_step {
                let n = pixels.len() as f64;
                let mean = |k: usize| pixels.iter().map(|p| p[k]).sum::<f64>() / n;
                points.push([n, mean(0), mean(1), mean(2)]);
            }
        }
    }
    let count: f64 = points.iter().map(|p| p[0]).sum();
    let mean = |k: usize| points.iter().map(|p| p[0] * p[k]).sum::<f64>() / count;
    let [u, v, q] = [1, 2, 3].map(mean);
    let product = |a: usize, b: usize| {
        let center = [0.0, u, v, q];
        let of = |p: &[f64; 4]| p[0] * (p[a] - center[a]) * (p[b] - center[b]);
        points.iter().map(of).sum::<f64>() / count
    };
    let determinant = product(1, 1) * product(2, 2) - product(1, 2).powi(2);
    if determinant < 0.01 * (side as f64).powi(4) {
        return None;
    }
    let a = (product(1, 3) * product(2, 2) - product(2, 3) * product(1, 2)) / determinant;
    let b = (product(2, 3) * product(1, 1) - product(1, 3) * product(1, 2)) / determinant;
    Some(Plane {
        gradient: [a, b],
        at: [u, v],
        inverse: q,
    })
}

type CellMean = (Vec<[f64; 3]>, f64, f64);

/// Column, row, inverse depth of the pixels of a cell on the surface at its center; depth and
/// sigma.
fn cell_mean(
    config: &FusionConfig,
    view: &DepthView<'_>,
    cell: [usize; 2],
    side: usize,
    is_static: &dyn Fn([usize; 2]) -> bool,
) -> Option<CellMean> {
    let center = cell.map(|k| k * side + side / 2);
    let mut pixels = Vec::new();
    for v in cell[1] * side..((cell[1] + 1) * side).min(view.size[1]) {
        for u in cell[0] * side..((cell[0] + 1) * side).min(view.size[0]) {
            if let Some((depth, sigma)) = depth(view, [u, v]) {
                let away = u.abs_diff(center[0]) + v.abs_diff(center[1]);
                pixels.push((away, [u, v], depth, sigma));
            }
        }
    }
    let (_, _, depth, sigma) = *pixels.iter().min_by_key(|pixel| pixel.0)?;
    let step = (5.0 * sigma).max(config.step_ratio * depth);
    pixels.retain(|pixel| is_static(pixel.1) && (pixel.2 - depth).abs() <= step);
    let n = pixels.len() as f64;
    if pixels.is_empty() {
        return None;
    }
    let inverse = pixels.iter().map(|pixel| 1.0 / pixel.2).sum::<f64>() / n;
    let sigma = pixels.iter().map(|pixel| pixel.3).sum::<f64>() / n;
    let points = pixels
        .iter()
        .map(|(_, [u, v], depth, _)| [*u as f64, *v as f64, 1.0 / depth]);
    Some((points.collect(), 1.0 / inverse, sigma))
}
