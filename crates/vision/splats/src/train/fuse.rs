//! Stereo depth of several views combined.
//!
//! The error of a single depth is far larger than a Gaussian: a scene that starts at such points
//! is a cloud around its surfaces, and a training does not thin it in any number of steps that
//! anyone would wait for. Errors of different views are nearly independent. The depth of a pixel
//! is therefore the mean of what its view and the nearest views with similar directions measured
//! there, weighted by their information. A view that sees through the point contradicts it.

use camera_models::Lens;
use rayon::prelude::*;

use super::start::StartConfig;
use super::view::TrainingView;
use crate::camera::Shutter;

/// Largest angle between the optical axes of views that are combined, as a cosine: what both
/// measure along their axes is taken as the same.
const MIN_AXIS_COSINE: f64 = 0.7;

/// Pixels that decide whether a view shares something with another one, across and down.
const PROBES: usize = 3;

/// Depth of every which pixel of a view; NaN where there is none.
pub(super) struct FusedDepth {
    /// Pixels between the samples.
    pub(super) step: usize,
    /// Samples across and down.
    pub(super) size: [usize; 2],
    pub(super) depth_m: Vec<f32>,
    pub(super) sigma_m: Vec<f32>,
}

/// Directions of all pixels of a lens, with a length of 1 along the optical axis.
pub(super) type Rays = Vec<[f32; 3]>;

/// Directions of all pixels, with a length of 1 along the optical axis; NaN where there is none.
pub(super) fn rays_of(lens: &Lens) -> Rays {
    let (width, height) = (lens.model().width, lens.model().height);
    let ray = |pixel: u32| {
        let at = [pixel % width, pixel / width].map(f64::from);
        let ray = lens.unproject(at).filter(|ray| ray[2] > 1e-3);
        ray.map_or([f32::NAN; 3], |ray| ray.map(|v| (v / ray[2]) as f32))
    };
    (0..width * height).into_par_iter().map(ray).collect()
}

/// Combined depth of views, one for each; `None` for those without depth. `rays` are those of
/// each view.
pub(super) fn fuse(
    views: &[TrainingView],
    rays: &[&Rays],
    config: &StartConfig,
) -> Vec<Option<FusedDepth>> {
    let sources: Vec<Source<'_>> = views.iter().map(Source::new).collect();
    (0..views.len())
        .into_par_iter()
        .map(|index| {
            let source = &sources[index];
            if source.view.depth_m.is_empty() {
                return None;
            }
            let step = config.step_px.max(1);
            let size = source.size.map(|edge| edge.div_ceil(step));
            let neighbors = neighbors(&sources, index, rays[index], config);
            let samples = (0..size[0] * size[1]).map(|sample| {
                let pixel = [sample % size[0] * step, sample / size[0] * step];
                let found = source.fused(pixel, rays[index], &neighbors, config);
                found.unwrap_or([f32::NAN; 2])
            });
            let (depth_m, sigma_m) = samples.map(|[depth, sigma]| (depth, sigma)).unzip();
            Some(FusedDepth {
                step,
                size,
                depth_m,
                sigma_m,
            })
        })
        .collect()
}

/// Views with depth that share something with a view, nearest first.
fn neighbors<'a>(
    sources: &'a [Source<'a>],
    index: usize,
    rays: &Rays,
    config: &StartConfig,
) -> Vec<&'a Source<'a>> {
    let own = &sources[index];
    let probes: Vec<[f64; 3]> = (0..PROBES * PROBES)
        .filter_map(|k| {
            let at = |k: usize, edge: usize| (2 * k + 1) * edge / (2 * PROBES);
            let pixel = [at(k % PROBES, own.size[0]), at(k / PROBES, own.size[1])];
            Some(own.world(pixel, rays, own.depth(pixel)?[0]))
        })
        .collect();
    let others = sources.iter().enumerate().filter(|(other, source)| {
        *other != index
            && !source.view.depth_m.is_empty()
            && cosine(own.axis, source.axis) >= MIN_AXIS_COSINE
            && probes.iter().any(|probe| source.project(*probe).is_some())
    });
    let distance = |source: &Source<'_>| {
        let square = |k: usize| (source.center[k] - own.center[k]).powi(2);
        square(0) + square(1) + square(2)
    };
    let mut others: Vec<(usize, &Source<'_>)> = others.collect();
    others.sort_by(|(i, a), (j, b)| distance(a).total_cmp(&distance(b)).then(i.cmp(j)));
    others.truncate(config.fused_views);
    others.into_iter().map(|(_, source)| source).collect()
}

fn cosine(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A view with what projections into it need.
pub(super) struct Source<'a> {
    pub(super) view: &'a TrainingView,
    lens: &'a Lens,
    size: [usize; 2],
    /// In the world: of the camera, and its optical axis.
    pub(super) center: [f64; 3],
    pub(super) axis: [f64; 3],
}

impl<'a> Source<'a> {
    pub(super) fn new(view: &'a TrainingView) -> Self {
        let world_from_camera = view.camera.camera_from_world().inverse();
        let model = view.camera.model();
        Self {
            view,
            lens: view.camera.lens(),
            size: [model.width as usize, model.height as usize],
            center: world_from_camera.translation_m(),
            axis: world_from_camera.rotate([0.0, 0.0, 1.0]),
        }
    }

    /// Depth of a pixel and its standard deviation, if it may be used.
    fn depth(&self, [column, row]: [usize; 2]) -> Option<[f64; 2]> {
        let pixel = row * self.size[0] + column;
        let (depth, sigma) = (self.view.depth_m[pixel], self.view.depth_sigma_m[pixel]);
        let is_usable = self.view.mask.get(pixel).copied().unwrap_or(true)
            && depth > 0.0
            && depth.is_finite()
            && sigma > 0.0
            && sigma.is_finite();
        is_usable.then_some([f64::from(depth), f64::from(sigma)])
    }

    /// The point of a pixel at a depth.
    fn world(&self, pixel: [usize; 2], rays: &Rays, depth_m: f64) -> [f64; 3] {
        let ray = rays[pixel[1] * self.size[0] + pixel[0]];
        let point = at_pose(self.view, pixel, ray.map(|v| f64::from(v) * depth_m));
        let camera_from_world = self.view.camera.camera_from_world();
        camera_from_world.inverse().apply(point)
    }

    /// Nearest pixel and depth of a point; `None` beyond the image.
    pub(super) fn project(&self, world: [f64; 3]) -> Option<([usize; 2], f64)> {
        let (at, depth) = self.image_point(world)?;
        let [x, y] = at.map(f64::round);
        let inside = |v: f64, edge: usize| (0.0..edge as f64).contains(&v);
        let is_seen = inside(x, self.size[0]) && inside(y, self.size[1]);
        is_seen.then_some(([x as usize, y as usize], depth))
    }

    /// Place in the image, px, and depth of a point; also beyond the image.
    pub(super) fn image_point(&self, world: [f64; 3]) -> Option<([f64; 2], f64)> {
        let mut point = self.view.camera.camera_from_world().apply(world);
        let mut at = self.lens.project(point)?;
        if let Some(shutter) = self.view.camera.shutter() {
            point = at_row(shutter, at, point);
            at = self.lens.project(point)?;
        }
        (point[2] > 0.0).then_some((at, point[2]))
    }

    /// Whether a point is in the image, usable, and not behind the depth that is known there.
    pub(super) fn shows(&self, world: [f64; 3]) -> bool {
        let Some(([column, row], z)) = self.project(world) else {
            return false;
        };
        let pixel = row * self.size[0] + column;
        let is_usable = self.view.mask.get(pixel).copied().unwrap_or(true);
        let is_hidden = !self.view.depth_m.is_empty()
            && self
                .depth([column, row])
                .is_some_and(|[depth, sigma]| z > depth + 3.0 * sigma);
        is_usable && !is_hidden
    }

    /// Whether there is a gray level at a place in the image, px.
    pub(super) fn has_gray(&self, at: [f64; 2]) -> bool {
        // Rounding must not take a place between two others that have one beyond the edge.
        let inside = |k: usize| at[k] >= 0.0 && at[k] < (self.size[k] - 1) as f64 - 1e-6;
        inside(0) && inside(1)
    }

    /// Gray level at a place in the image that [has one](Self::has_gray), interpolated.
    pub(super) fn gray(&self, [x, y]: [f64; 2]) -> f32 {
        let (column, row) = (x as usize, y as usize);
        let [a, b] = [x - column as f64, y - row as f64].map(|v| v as f32);
        let first = row * self.size[0] + column;
        let pair = |first: usize| {
            let rgb = &self.view.rgb[3 * first..3 * first + 6];
            let gray = |k: usize| {
                f32::from(u16::from(rgb[k]) + 2 * u16::from(rgb[k + 1]) + u16::from(rgb[k + 2]))
            };
            gray(0) * (1.0 - a) + gray(3) * a
        };
        0.25 * (pair(first) * (1.0 - b) + pair(first + self.size[0]) * b)
    }

    /// Combined depth of a pixel and its standard deviation.
    fn fused(
        &self,
        pixel: [usize; 2],
        rays: &Rays,
        neighbors: &[&Source<'_>],
        config: &StartConfig,
    ) -> Option<[f32; 2]> {
        let [depth, sigma] = self.depth(pixel)?;
        let world = self.world(pixel, rays, depth);
        if !world[0].is_finite() {
            return None;
        }
        let mut information = 1.0 / (sigma * sigma);
        let (mut sum, mut agreeing, mut contradicting) = (0.0, 1, 0);
        for other in neighbors {
            let Some((at, z)) = other.project(world) else {
                continue;
            };
            let Some([other_depth, other_sigma]) = other.depth(at) else {
                continue;
            };
            let difference = other_depth - z;
            let gate = config.fused_sigmas * sigma.hypot(other_sigma);
            if difference.abs() <= gate {
                let weight = 1.0 / (other_sigma * other_sigma);
                information += weight;
                sum += weight * difference;
                agreeing += 1;
            } else if difference > 0.0 {
                contradicting += 1;
            }
        }
        let fused = depth + sum / information;
        let least = sigma * config.min_fused_sigma;
        let fused_sigma = (1.0 / information).sqrt().max(least);
        let is_valid = agreeing > contradicting
            && fused > 0.0
            && fused_sigma <= config.max_relative_sigma * fused;
        is_valid.then_some([fused as f32, fused_sigma as f32])
    }
}

/// A point of a pixel at the pose of the camera, which a rolling shutter has at another time.
pub(super) fn at_pose(view: &TrainingView, pixel: [usize; 2], x: [f64; 3]) -> [f64; 3] {
    let Some(shutter) = view.camera.shutter() else {
        return x;
    };
    let motion = motion(shutter, pixel.map(|v| v as f64), x);
    [0, 1, 2].map(|k| x[k] + motion[k])
}

/// The reverse: a point, given at the pose of the camera, at the time of a pixel.
fn at_row(shutter: &Shutter, pixel: [f64; 2], x: [f64; 3]) -> [f64; 3] {
    let motion = motion(shutter, pixel, x);
    [0, 1, 2].map(|k| x[k] - motion[k])
}

/// Motion of a point between the reference time and that of a pixel, m.
fn motion(shutter: &Shutter, pixel: [f64; 2], x: [f64; 3]) -> [f64; 3] {
    let time = |k: usize| shutter.time_gradient_s_per_px[k] * (pixel[k] - shutter.reference_px[k]);
    let time_s = time(0) + time(1);
    let (v, w) = (shutter.velocity_m_s, shutter.rate_rad_s);
    let turn = [
        w[1] * x[2] - w[2] * x[1],
        w[2] * x[0] - w[0] * x[2],
        w[0] * x[1] - w[1] * x[0],
    ];
    [0, 1, 2].map(|k| time_s * (v[k] + turn[k]))
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;
    use camera_models::{CameraModel, Distortion};

    use super::*;
    use crate::camera::Camera;

    /// A wall at 4 m with depths that scatter by 8 cm, from a position along it.
    fn view(number: u32, x_m: f64) -> TrainingView {
        let model = CameraModel::new((48, 32), [40.0, 40.0, 23.5, 15.5], Distortion::None);
        let pose = RigidTransform::from_translation_m([-x_m, 0.0, 0.0]).unwrap();
        let camera = Camera::new(model, pose).unwrap();
        let mut view = TrainingView::new(camera, vec![100; 3 * 48 * 32], number);
        let noise = |k: u64| counter_random::bell(5, u64::from(number), k) as f32;
        view.depth_m = (0..48 * 32).map(|k| 4.0 + 0.08 * noise(k)).collect();
        view.depth_sigma_m = vec![0.08; 48 * 32];
        view
    }

    fn fused(views: &[TrainingView]) -> Vec<FusedDepth> {
        let config = StartConfig {
            step_px: 1,
            ..StartConfig::default()
        };
        let rays: Vec<Rays> = views.iter().map(|v| rays_of(v.camera.lens())).collect();
        let rays: Vec<&Rays> = rays.iter().collect();
        fuse(views, &rays, &config).into_iter().flatten().collect()
    }

    #[test]
    fn errors_fall_with_the_number_of_views() {
        let views: Vec<TrainingView> = (0..9).map(|k| view(k, 0.1 * f64::from(k))).collect();
        let error = |depth: &FusedDepth| {
            let known = depth.depth_m.iter().filter(|d| d.is_finite());
            let squares: Vec<f32> = known.map(|d| (d - 4.0).powi(2)).collect();
            assert!(squares.len() > 1400, "{}", squares.len());
            (squares.iter().sum::<f32>() / squares.len() as f32).sqrt()
        };
        let single = error(&fused(&views[..1])[0]);
        let combined = error(&fused(&views)[4]);
        assert!((single - 0.08).abs() < 0.01, "{single}");
        assert!(combined < 0.45 * single, "{combined} of {single}");
        let sigma = fused(&views)[4].sigma_m[16 * 48 + 24];
        assert!((0.02..0.04).contains(&sigma), "{sigma}");
    }

    #[test]
    fn depths_that_other_views_see_through_are_dropped() {
        let mut views: Vec<TrainingView> = (0..5).map(|k| view(k, 0.1 * f64::from(k))).collect();
        let pixel = 16 * 48 + 24;
        views[2].depth_m[pixel] = 2.0;
        assert!(fused(&views)[2].depth_m[pixel].is_nan());
        assert_eq!(fused(&views[2..3])[0].depth_m[pixel], 2.0);
        // What is hidden behind the wall contradicts nothing that others see.
        views[2].depth_m[pixel] = 6.0;
        assert_eq!(fused(&views)[2].depth_m[pixel], 6.0);
    }

    #[test]
    fn rows_of_a_rolling_shutter_project_to_where_they_were_seen() {
        let mut moving = view(0, 0.0);
        let shutter = Shutter::rows(0.001, 32, [1.3, 0.2, 0.5], [0.1, 1.0, 0.3]);
        moving.camera = moving.camera.with_shutter(shutter).unwrap();
        let rays = rays_of(moving.camera.lens());
        let source = Source::new(&moving);
        for pixel in [[3, 2], [40, 30], [24, 16]] {
            let (found, depth) = source.project(source.world(pixel, &rays, 4.0)).unwrap();
            assert_eq!(found, pixel);
            // The row is that of the nearest pixel.
            assert!((depth - 4.0).abs() < 3e-3, "{depth}");
        }
    }
}
