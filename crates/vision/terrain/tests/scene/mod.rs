//! Analytic scenes and cameras with known noise. Nothing here is shared with the crate.

#![allow(dead_code, unreachable_pub, reason = "each test uses a part")]

pub mod score;
pub mod surface;

use cad_transforms::RigidTransform;
use counter_random::bell;
use terrain::{DepthView, PixelClass, RowMotion};

/// A solid that rays end at.
#[derive(Clone, Copy)]
pub enum Solid {
    /// An axis-aligned box.
    Box {
        min: [f64; 3],
        max: [f64; 3],
        color: [u8; 3],
    },
    /// Everything below a height.
    Ground(fn(f64, f64) -> f64),
}

#[derive(Clone)]
pub struct Scene {
    pub solids: Vec<Solid>,
}

pub const RISE_M: f64 = 0.17;
pub const GOING_M: f64 = 0.29;

/// Stairs along x that begin at x = 0 with the floor at z = 0: `steps` risers, the last tread a
/// landing of 2 m. Width 2 m around y = 0.
pub fn stairs(steps: usize) -> Scene {
    let mut solids = vec![Solid::Box {
        min: [-3.0, -1.0, -0.5],
        max: [0.0, 1.0, 0.0],
        color: [90, 90, 90],
    }];
    for step in 0..steps {
        let from = step as f64 * GOING_M;
        let to = if step + 1 == steps {
            from + 2.0
        } else {
            from + GOING_M
        };
        solids.push(Solid::Box {
            min: [from, -1.0, -0.5],
            max: [to, 1.0, (step + 1) as f64 * RISE_M],
            color: [120, 100 + 10 * (step % 2) as u8, 80],
        });
    }
    Scene { solids }
}

impl Scene {
    /// Distance along a ray with direction of any length, and color.
    pub fn cast(&self, origin: [f64; 3], direction: [f64; 3]) -> Option<(f64, [u8; 3])> {
        let mut nearest: Option<(f64, [u8; 3])> = None;
        for solid in &self.solids {
            let hit = match solid {
                Solid::Box { min, max, color } => {
                    cast_box(min, max, origin, direction).map(|t| (t, *color))
                }
                Solid::Ground(height) => {
                    cast_ground(*height, origin, direction).map(|t| (t, [100, 120, 60]))
                }
            };
            if let Some(hit) = hit.filter(|hit| nearest.is_none_or(|n| hit.0 < n.0)) {
                nearest = Some(hit);
            }
        }
        nearest
    }

    /// Height of the highest surface at a place.
    pub fn height(&self, x: f64, y: f64) -> Option<f64> {
        let heights = self.solids.iter().filter_map(|solid| match solid {
            Solid::Box { min, max, .. } => {
                let inside = (0..2).all(|k| ([x, y][k] - min[k]) * ([x, y][k] - max[k]) <= 0.0);
                inside.then_some(max[2])
            }
            Solid::Ground(height) => Some(height(x, y)),
        });
        heights.reduce(f64::max)
    }

    /// Distance of a point from the nearest surface.
    pub fn distance(&self, p: [f64; 3]) -> f64 {
        let of = |solid: &Solid| match solid {
            Solid::Box { min, max, .. } => box_distance(min, max, p).abs(),
            // Good for shallow slopes.
            Solid::Ground(height) => (p[2] - height(p[0], p[1])).abs(),
        };
        self.solids.iter().map(of).fold(f64::INFINITY, f64::min)
    }
}

fn box_distance(min: &[f64; 3], max: &[f64; 3], p: [f64; 3]) -> f64 {
    let outside = [0, 1, 2].map(|k| (min[k] - p[k]).max(p[k] - max[k]));
    let out = outside.map(|d| d.max(0.0));
    let out = (out[0] * out[0] + out[1] * out[1] + out[2] * out[2]).sqrt();
    out + outside
        .into_iter()
        .fold(f64::NEG_INFINITY, f64::max)
        .min(0.0)
}

fn cast_box(min: &[f64; 3], max: &[f64; 3], origin: [f64; 3], direction: [f64; 3]) -> Option<f64> {
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    for k in 0..3 {
        let [a, b] = [min[k], max[k]].map(|side| (side - origin[k]) / direction[k]);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    (enter > 1e-6 && enter < leave).then_some(enter)
}

fn cast_ground(height: fn(f64, f64) -> f64, origin: [f64; 3], d: [f64; 3]) -> Option<f64> {
    let above = |t: f64| {
        let p = [0, 1, 2].map(|k| origin[k] + t * d[k]);
        p[2] - height(p[0], p[1])
    };
    let (mut t, step) = (0.3, 0.03);
    while t < 12.0 {
        if above(t + step) <= 0.0 {
            let (mut low, mut high) = (t, t + step);
            for _ in 0..40 {
                let middle = 0.5 * (low + high);
                if above(middle) > 0.0 {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            return Some(low);
        }
        t += step;
    }
    None
}

/// A rectified stereo camera.
#[derive(Clone, Copy)]
pub struct Camera {
    pub size: [usize; 2],
    pub focal_px: f64,
    pub baseline_m: f64,
    /// Time from row to row, s.
    pub line_s: f64,
    /// Width by which foreground is too wide, px.
    pub wide_px: usize,
}

/// HD720 and VGA modes of a camera with a baseline of 63 mm.
pub const HD720: Camera = Camera {
    size: [1280, 720],
    focal_px: 700.0,
    baseline_m: 0.063,
    line_s: 0.0,
    wide_px: 0,
};
pub const VGA: Camera = Camera {
    size: [672, 376],
    focal_px: 367.0,
    baseline_m: 0.063,
    line_s: 0.0,
    wide_px: 0,
};

/// Errors of a depth image.
#[derive(Clone, Copy, Default)]
pub struct Noise {
    /// Standard deviation of the disparity, px: independent for patches of 3 x 3 px.
    pub disparity_px: f64,
    /// Standard deviation of the position and of the rotation of the stated pose, m and rad.
    pub pose_m: f64,
    pub pose_rad: f64,
    /// Standard deviation of a disparity error that all pixels of a view share, px.
    pub common_px: f64,
    /// Standard deviation of a disparity error that all pixels of a view between two heights of
    /// treads share, px.
    pub tread_px: f64,
    /// Side of the patches with one error, px; 3 if it is 0.
    pub patch_px: usize,
    pub seed: u64,
}

/// No errors.
pub const CLEAN: Noise = Noise {
    disparity_px: 0.0,
    pose_m: 0.0,
    pose_rad: 0.0,
    common_px: 0.0,
    tread_px: 0.0,
    patch_px: 3,
    seed: 0,
};

/// A depth image with its stated pose.
pub struct Shot {
    camera: Camera,
    world_from_view: RigidTransform,
    row_motion: RowMotion,
    pose_sigma_m: f64,
    pub depth_m: Vec<f32>,
    pub sigma_m: Vec<f32>,
    pub color: Vec<[u8; 3]>,
    pub classes: Option<Vec<PixelClass>>,
}

impl Shot {
    pub fn view(&self) -> DepthView<'_> {
        DepthView {
            size: self.camera.size,
            focal_px: [self.camera.focal_px; 2],
            center_px: self.camera.size.map(|s| 0.5 * (s as f64 - 1.0)),
            world_from_view: self.world_from_view,
            row_motion: self.row_motion,
            pose_sigma_m: self.pose_sigma_m,
            depth_m: &self.depth_m,
            sigma_m: &self.sigma_m,
            color: Some(&self.color),
            classes: self.classes.as_deref(),
        }
    }
}

/// Pose of a view that looks along a heading, pitched down.
pub fn pose(position: [f64; 3], heading: f64, pitch: f64) -> RigidTransform {
    let (sin, cos) = heading.sin_cos();
    let (down, ahead) = pitch.sin_cos();
    let z = [ahead * cos, ahead * sin, -down];
    let x = [sin, -cos, 0.0];
    let y = [
        z[1] * x[2] - z[2] * x[1],
        z[2] * x[0] - z[0] * x[2],
        z[0] * x[1] - z[1] * x[0],
    ];
    let rows = [x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]];
    RigidTransform::from_rotation_rows(rows, position).expect("a rotation")
}

/// Depth image of a scene from a view that moves with the velocity and angular rate of the motion.
pub fn shoot(
    scene: &Scene,
    camera: Camera,
    world_from_view: RigidTransform,
    motion: ([f64; 3], [f64; 3]),
    noise: Noise,
) -> Shot {
    let [width, height] = camera.size;
    let center = camera.size.map(|s| 0.5 * (s as f64 - 1.0));
    let row_motion = RowMotion {
        first_s: -camera.line_s * center[1],
        row_s: camera.line_s,
        velocity: motion.0,
        angular_rate: motion.1,
    };
    let focal_baseline = camera.focal_px * camera.baseline_m;
    let count = width * height;
    let patch_px = if noise.patch_px == 0 {
        3
    } else {
        noise.patch_px
    };
    let common = noise.common_px * bell(noise.seed, 4, 0);
    let mut shot = Shot {
        camera,
        world_from_view,
        row_motion,
        pose_sigma_m: noise.pose_m,
        depth_m: vec![f32::NAN; count],
        sigma_m: vec![f32::NAN; count],
        color: vec![[0; 3]; count],
        classes: None,
    };
    for row in 0..height {
        // The exact pose at the exposure of the row.
        let time = camera.line_s * (row as f64 - center[1]);
        let moved = RigidTransform::from_rotation_vector(
            motion.1.map(|w| w * time),
            motion.0.map(|v| v * time),
        );
        let at_row = world_from_view * moved.expect("finite");
        let origin = at_row.translation_m();
        for column in 0..width {
            let ray = [column as f64, row as f64];
            let ray = [0, 1].map(|k| (ray[k] - center[k]) / camera.focal_px);
            let hit = scene.cast(origin, at_row.rotate([ray[0], ray[1], 1.0]));
            let Some((depth, color)) = hit else {
                continue;
            };
            let pixel = row * width + column;
            let patch = (row / patch_px * width + column / patch_px) as u64;
            let height = origin[2] + depth * at_row.rotate([ray[0], ray[1], 1.0])[2];
            let tread = (height / RISE_M).round() + 100.0;
            let common = common + noise.tread_px * bell(noise.seed, 5, tread as u64);
            let disparity = focal_baseline / depth + common;
            let disparity = disparity + noise.disparity_px * bell(noise.seed, 1, patch);
            let noisy = focal_baseline / disparity;
            let sigma = noisy * noisy * noise.disparity_px.hypot(noise.common_px) / focal_baseline;
            shot.depth_m[pixel] = noisy as f32;
            shot.sigma_m[pixel] = (sigma as f32).max(1e-4);
            shot.color[pixel] = color;
        }
    }
    for _ in 0..camera.wide_px {
        widen(&mut shot);
    }
    let error = |stream: u64, sigma: f64| [0, 1, 2].map(|k| sigma * bell(noise.seed, stream, k));
    let error =
        RigidTransform::from_rotation_vector(error(2, noise.pose_rad), error(3, noise.pose_m));
    let rotated = world_from_view * error.expect("finite");
    shot.world_from_view = rotated;
    shot
}

/// Views of a person who climbs stairs: a camera 1.2 m above the feet, pitched down, every 0.2 m of
/// the path from `from` to `to` (in x), heading along x if `to` is larger, else against it.
pub fn climb(
    scene: &Scene,
    camera: Camera,
    [from, to]: [f64; 2],
    pitch: f64,
    noise: Noise,
) -> Vec<Shot> {
    let count = ((to - from).abs() / 0.2).round() as usize;
    let heading = if to > from { 0.0 } else { std::f64::consts::PI };
    (0..=count)
        .map(|i| {
            let x = from + (to - from) * i as f64 / count as f64;
            let feet = scene.height(x, 0.0).unwrap_or(0.0);
            let at = pose([x, 0.02 * (i % 3) as f64, feet + 1.3], heading, pitch);
            let noise = Noise {
                seed: noise.seed * 1000 + i as u64,
                ..noise
            };
            // A walker's velocity and sway, in the axes of the view.
            let motion = match camera.line_s > 0.0 {
                true => ([0.1, -0.9, 0.4], [0.3, -0.2, 0.1]),
                false => ([0.0; 3], [0.0; 3]),
            };
            shoot(scene, camera, at, motion, noise)
        })
        .collect()
}

/// Disparities beside steps become means of a square of `2 * reach + 1` pixels, with sigmas four
/// times as large: matchers join both sides of a depth step by a ramp.
pub fn join_steps(shot: &mut Shot, reach: usize) {
    let [width, height] = shot.camera.size;
    let focal_baseline = (shot.camera.focal_px * shot.camera.baseline_m) as f32;
    let disparity: Vec<f32> = shot.depth_m.iter().map(|z| focal_baseline / z).collect();
    let before = shot.sigma_m.clone();
    for row in reach..height - reach {
        for column in reach..width - reach {
            let rows = (row - reach..=row + reach).step_by(2);
            let square = rows.flat_map(|v| {
                let from = v * width + column;
                disparity[from - reach..=from + reach].iter().step_by(2)
            });
            let (mut low, mut high, mut sum, mut count) = (f32::INFINITY, 0.0f32, 0.0, 0.0);
            for d in square.filter(|d| d.is_finite()) {
                (low, high) = (low.min(*d), high.max(*d));
                (sum, count) = (sum + d, count + 1.0);
            }
            // A surface at a shallow angle has no step.
            if high - low > 1.5 && count > 0.0 {
                let pixel = row * width + column;
                shot.depth_m[pixel] = focal_baseline * count / sum;
                shot.sigma_m[pixel] = 4.0 * before[pixel];
            }
        }
    }
}

/// Pixels beside much nearer ones become as near: matchers see edges too wide.
fn widen(shot: &mut Shot) {
    let [width, height] = shot.camera.size;
    let before = (shot.depth_m.clone(), shot.sigma_m.clone());
    for pixel in 0..width * height {
        let (u, v) = (pixel % width, pixel / width);
        let mut others = Vec::new();
        others.extend((u > 0).then(|| pixel - 1));
        others.extend((u + 1 < width).then(|| pixel + 1));
        others.extend((v > 0).then(|| pixel - width));
        others.extend((v + 1 < height).then(|| pixel + width));
        for other in others {
            if before.0[other] < shot.depth_m[pixel] - 0.1 {
                shot.depth_m[pixel] = before.0[other];
                shot.sigma_m[pixel] = before.1[other];
            }
        }
    }
}
