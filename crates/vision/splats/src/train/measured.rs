//! Points at the depths of views: one per voxel of an octree.
//!
//! Depths of views are [combined](super::fuse) first. A depth belongs to the voxels of the size of
//! some pixels at its distance. Of voxels that contain each other the smallest one is kept: the
//! nearest view knows best. A point is the mean of the depths in its voxel, with the mean of their
//! normals and colors, [moved](super::consistency) to where the images of several views agree.

use std::collections::{HashMap, HashSet};

use camera_models::CameraModel;
use rayon::prelude::*;

use super::consistency::refine;
use super::fuse::{FusedDepth, Rays, Source, at_pose, fuse, rays_of};
use super::start::{StartConfig, StartPoint};
use super::view::TrainingView;

/// Most levels of the octree: the largest voxels are this power of two of the smallest.
const MAX_LEVEL: u8 = 20;

/// Most voxels in memory for each point of the result: they double above that.
pub const MAX_VOXELS_PER_POINT: usize = 8;

/// Neighbors of a pixel for its normal, steps away: errors of depth tilt nearer ones too much.
const NEIGHBOR_STEPS: usize = 2;

/// Along a plane the inverse depth is linear in the pixel. A share of it by which the depth of a
/// pixel may differ from the mean of its neighbors on both sides; beyond it there is an edge.
const MAX_BEND: f64 = 0.05;

/// Level of the octree and cell in it.
type Voxel = (u8, [i32; 3]);

/// Sums over the depths of a voxel.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    count: f64,
    position_m: [f64; 3],
    normals: f64,
    normal: [f64; 3],
    color: [f64; 3],
    /// Sum of `1 / sigma²`.
    information: f64,
}

impl Sums {
    fn add(&mut self, other: &Self) {
        let add = |a: &mut [f64; 3], b: &[f64; 3]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        self.count += other.count;
        add(&mut self.position_m, &other.position_m);
        self.normals += other.normals;
        add(&mut self.normal, &other.normal);
        add(&mut self.color, &other.color);
        self.information += other.information;
    }

    fn point(&self, spacing_m: f64) -> StartPoint {
        let mean = |sum: [f64; 3]| sum.map(|v| (v / self.count) as f32);
        let length = self.normal.iter().map(|v| v * v).sum::<f64>().sqrt();
        StartPoint {
            position_m: mean(self.position_m),
            // Depths of several surfaces have no common normal.
            normal: (length > 0.5 * self.normals).then(|| self.normal.map(|v| (v / length) as f32)),
            spacing_m: spacing_m as f32,
            // That of a single depth: errors of neighbors are not independent.
            sigma_m: (self.count / self.information).sqrt() as f32,
            color: mean(self.color),
        }
    }
}

/// Points at the usable depths of views, at most [`StartConfig::max_points`] of them, in an order
/// that depends on their positions only.
///
/// # Panics
/// If a buffer of a view does not fit its image.
///
/// ```
/// use cad_transforms::RigidTransform;
/// use camera_models::{CameraModel, Distortion};
/// use splats::{Camera, StartConfig, TrainingView, points_from_views};
///
/// // A wall at 2 m.
/// let model = CameraModel::new((64, 48), [60.0, 60.0, 31.5, 23.5], Distortion::None);
/// let camera = Camera::new(model, RigidTransform::identity())?;
/// let mut view = TrainingView::new(camera, vec![200; 3 * 64 * 48], 0);
/// view.depth_m = vec![2.0; 64 * 48];
/// view.depth_sigma_m = vec![0.01; 64 * 48];
/// let points = points_from_views(&[view], &StartConfig::default());
/// assert!(points.len() > 100);
/// assert!(points.iter().all(|point| (point.position_m[2] - 2.0).abs() < 1e-6));
/// assert!(points.iter().all(|point| point.normal.is_none_or(|n| n[2] < -0.99)));
/// # Ok::<(), splats::SplatError>(())
/// ```
pub fn points_from_views(views: &[TrainingView], config: &StartConfig) -> Vec<StartPoint> {
    let mut lenses: Vec<(CameraModel, Rays)> = Vec::new();
    let mut lens_of_view = Vec::with_capacity(views.len());
    for view in views {
        let model = *view.camera.model();
        let known = lenses.iter().position(|(of, _)| *of == model);
        lens_of_view.push(known.unwrap_or_else(|| {
            lenses.push((model, rays_of(view.camera.lens())));
            lenses.len() - 1
        }));
    }
    let rays: Vec<&Rays> = lens_of_view.iter().map(|lens| &lenses[*lens].1).collect();
    let depths = fuse(views, &rays, config);
    let inputs: Vec<Input<'_>> = (views.iter().zip(rays).zip(&depths))
        .filter_map(|((view, rays), depth)| {
            let depth = depth.as_ref()?;
            Some(Input { view, rays, depth })
        })
        .collect();
    let mut larger = *config;
    larger.spacing_px *= std::f64::consts::SQRT_2;
    larger.min_spacing_m *= std::f64::consts::SQRT_2;
    let [points, fewer] = [config, &larger].map(|config| in_octaves(&inputs, config));
    let mut points = match fewer.len() > points.len() {
        true => fewer,
        false => points,
    };
    let sources: Vec<Source<'_>> = views.iter().map(Source::new).collect();
    refine(&mut points, &sources, config);
    points
}

/// A view with its depth.
struct Input<'a> {
    view: &'a TrainingView,
    rays: &'a Rays,
    depth: &'a FusedDepth,
}

/// The same with voxels that double until there are no more points than allowed.
fn in_octaves(inputs: &[Input<'_>], config: &StartConfig) -> Vec<StartPoint> {
    let mut voxels: HashMap<Voxel, Sums> = HashMap::new();
    // Of all voxels.
    let mut doublings = 0;
    for input in inputs {
        let [columns, rows] = input.depth.size;
        let found: Vec<(Voxel, Sums)> = (0..rows)
            .into_par_iter()
            .flat_map_iter(|row| {
                (0..columns).filter_map(move |column| input.measured([column, row], config))
            })
            .collect();
        // In order, so that sums do not depend on the number of threads.
        for ((level, cell), sums) in found {
            let cell = (0..doublings).fold(cell, |cell, _| parent(cell));
            let voxel = ((level + doublings).min(MAX_LEVEL), cell);
            voxels.entry(voxel).or_default().add(&sums);
        }
        let most = config.max_points.saturating_mul(MAX_VOXELS_PER_POINT);
        while voxels.len() > most && doublings < MAX_LEVEL {
            voxels = doubled(&sorted(voxels)).into_iter().collect();
            doublings += 1;
        }
    }
    let mut voxels = sorted(voxels);
    loop {
        let kept = smallest(&voxels);
        if kept.len() <= config.max_points || doublings == MAX_LEVEL {
            let size = |level: u8| config.min_spacing_m * f64::from(1_u32 << level);
            let points = kept.into_iter().take(config.max_points);
            return points
                .map(|((level, _), sums)| sums.point(size(level)))
                .collect();
        }
        voxels = doubled(&voxels);
        doublings += 1;
    }
}

fn sorted(voxels: HashMap<Voxel, Sums>) -> Vec<(Voxel, Sums)> {
    let mut voxels: Vec<(Voxel, Sums)> = voxels.into_iter().collect();
    voxels.sort_unstable_by_key(|(voxel, _)| *voxel);
    voxels
}

impl Input<'_> {
    /// A sample of the depth with its voxel.
    fn measured(&self, sample: [usize; 2], config: &StartConfig) -> Option<(Voxel, Sums)> {
        let [columns, rows] = self.depth.size;
        let width = self.view.camera.model().width as usize;
        let pixel = |[column, row]: [usize; 2]| {
            let step = self.depth.step;
            row * step * width + column * step
        };
        let at = |column: Option<usize>, row: Option<usize>| {
            let (column, row) = (column?, row?);
            if column >= columns || row >= rows {
                return None;
            }
            let z = self.depth.depth_m[row * columns + column];
            let point = self.rays[pixel([column, row])].map(|v| f64::from(v * z));
            point[0].is_finite().then_some(point)
        };
        let [column, row] = sample;
        let point = at(Some(column), Some(row))?;
        let z = point[2];
        let sigma = f64::from(self.depth.sigma_m[row * columns + column]);
        // Difference of the neighbors on both sides along one axis, where they are on one surface.
        let along = |before: Option<[f64; 3]>, after: Option<[f64; 3]>| {
            let (a, b) = (before?, after?);
            let bend = 0.5 * z * (1.0 / a[2] + 1.0 / b[2]) - 1.0;
            (bend.abs() < MAX_BEND).then(|| [b[0] - a[0], b[1] - a[1], b[2] - a[2]])
        };
        let x = along(
            at(column.checked_sub(NEIGHBOR_STEPS), Some(row)),
            at(Some(column + NEIGHBOR_STEPS), Some(row)),
        );
        let y = along(
            at(Some(column), row.checked_sub(NEIGHBOR_STEPS)),
            at(Some(column), Some(row + NEIGHBOR_STEPS)),
        );
        let normal = x.zip(y).and_then(|(x, y)| {
            let n = [
                y[1] * x[2] - y[2] * x[1],
                y[2] * x[0] - y[0] * x[2],
                y[0] * x[1] - y[1] * x[0],
            ];
            let length = n.iter().map(|v| v * v).sum::<f64>().sqrt();
            (length > 0.0).then(|| n.map(|v| v / length))
        });
        let world_from_camera = self.view.camera.camera_from_world().inverse();
        let recorded = sample.map(|v| v * self.depth.step);
        let position_m = world_from_camera.apply(at_pose(self.view, recorded, point));
        let spacing = config.spacing_px * z / self.view.camera.model().fx;
        let spacing = spacing.max(config.spacing_sigmas * sigma);
        let doublings = libm::log2((spacing / config.min_spacing_m).max(1.0));
        let level = (doublings.round() as u8).min(MAX_LEVEL);
        let size = config.min_spacing_m * f64::from(1_u32 << level);
        let voxel = (level, position_m.map(|v| (v / size).floor() as i32));
        let first = 3 * pixel(sample);
        let color = [0, 1, 2].map(|c| f64::from(self.view.rgb[first + c]) / 255.0);
        let sums = Sums {
            count: 1.0,
            position_m,
            normals: normal.map_or(0.0, |_| 1.0),
            normal: normal.map_or([0.0; 3], |normal| world_from_camera.rotate(normal)),
            color,
            information: 1.0 / (sigma * sigma),
        };
        Some((voxel, sums))
    }
}

fn parent([x, y, z]: [i32; 3]) -> [i32; 3] {
    [x, y, z].map(|v| v.div_euclid(2))
}

/// Voxels that contain no smaller one. The list is sorted.
fn smallest(voxels: &[(Voxel, Sums)]) -> Vec<(Voxel, Sums)> {
    let mut kept = Vec::new();
    // Cells of the present level with smaller voxels in them.
    let mut taken: HashSet<[i32; 3]> = HashSet::new();
    for level in 0..=MAX_LEVEL {
        let first = voxels.partition_point(|((of, _), _)| *of < level);
        let end = voxels.partition_point(|((of, _), _)| *of <= level);
        let of_level = &voxels[first..end];
        kept.extend(
            of_level
                .iter()
                .filter(|((_, cell), _)| !taken.contains(cell)),
        );
        taken.extend(of_level.iter().map(|((_, cell), _)| *cell));
        taken = taken.into_iter().map(parent).collect();
    }
    kept
}

/// The same with voxels of twice the size.
fn doubled(voxels: &[(Voxel, Sums)]) -> Vec<(Voxel, Sums)> {
    let mut out: HashMap<Voxel, Sums> = HashMap::with_capacity(voxels.len());
    for ((level, cell), sums) in voxels {
        let voxel = ((level + 1).min(MAX_LEVEL), parent(*cell));
        out.entry(voxel).or_default().add(sums);
    }
    sorted(out)
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;
    use camera_models::Distortion;

    use super::*;
    use crate::camera::{Camera, Shutter};

    const SIZE: (u32, u32) = (64, 48);

    /// A wall at a distance, seen from a position along its normal.
    fn view(distance_m: f64) -> TrainingView {
        let model = CameraModel::new(SIZE, [60.0, 60.0, 31.5, 23.5], Distortion::None);
        // The wall is at z = 4.
        let pose = RigidTransform::from_translation_m([0.0, 0.0, distance_m - 4.0]);
        let camera = Camera::new(model, pose.unwrap()).unwrap();
        let mut view = TrainingView::new(camera, vec![200; 3 * 64 * 48], 0);
        view.depth_m = vec![distance_m as f32; 64 * 48];
        view.depth_sigma_m = vec![0.02; 64 * 48];
        view
    }

    #[test]
    fn each_place_has_the_points_of_its_nearest_view() {
        let config = StartConfig::default();
        let far = points_from_views(&[view(4.0)], &config);
        let both = points_from_views(&[view(4.0), view(1.0)], &config);
        let smallest =
            |points: &[StartPoint]| points.iter().fold(f32::INFINITY, |s, p| s.min(p.spacing_m));
        assert!(smallest(&both) < 0.5 * smallest(&far));
        // The near view shows a sixteenth of the wall. No point of the far one remains there.
        for point in &both {
            let [x, y, z] = point.position_m;
            assert!((z - 4.0).abs() < 1e-5);
            let in_near = x.abs() < 0.4 && y.abs() < 0.3;
            assert!(!in_near || point.spacing_m == smallest(&both), "{point:?}");
        }
        // Of one view, or of both.
        let sigmas = 0.02 / std::f32::consts::SQRT_2 - 1e-6..0.02 + 1e-6;
        assert!(both.iter().all(|p| sigmas.contains(&p.sigma_m)));
    }

    #[test]
    fn masked_and_uncertain_depths_give_no_points() {
        let mut masked = view(2.0);
        masked.mask = vec![false; 64 * 48];
        let mut uncertain = view(2.0);
        uncertain.depth_sigma_m.fill(0.5);
        let mut unknown = view(2.0);
        unknown.depth_m.fill(f32::NAN);
        let mut without_sigma = view(2.0);
        without_sigma.depth_sigma_m.fill(f32::NAN);
        let views = [masked, uncertain, unknown, without_sigma];
        assert_eq!(points_from_views(&views, &StartConfig::default()), []);
    }

    #[test]
    fn voxels_double_until_few_enough_points_remain() {
        let mut config = StartConfig::default();
        let all = points_from_views(&[view(4.0), view(1.0)], &config);
        config.max_points = all.len() / 3;
        let fewer = points_from_views(&[view(4.0), view(1.0)], &config);
        assert!(!fewer.is_empty() && fewer.len() <= config.max_points);
        assert!(fewer.len() > config.max_points / 8, "{}", fewer.len());
        // Near and far ones alike.
        let sizes = |points: &[StartPoint]| {
            let size = |p: &StartPoint| (p.spacing_m * 1e4) as u32;
            let (least, most) = (points.iter().map(size).min(), points.iter().map(size).max());
            f64::from(most.unwrap()) / f64::from(least.unwrap())
        };
        assert!((sizes(&fewer) / sizes(&all) - 1.0).abs() < 0.01);
        assert!(sizes(&all) > 2.0);
        // So few that they already double from view to view.
        config.max_points = 10;
        let few = points_from_views(&[view(4.0), view(1.0)], &config);
        assert!((2..=10).contains(&few.len()), "{}", few.len());
    }

    #[test]
    fn rows_of_a_rolling_shutter_are_at_their_own_times() {
        let mut moving = view(2.0);
        // 1 m/s to the right, 10 ms a row.
        let shutter = Shutter::rows(0.01, SIZE.1, [1.0, 0.0, 0.0], [0.0; 3]);
        moving.camera = moving.camera.with_shutter(shutter).unwrap();
        let config = StartConfig {
            step_px: 2,
            ..StartConfig::default()
        };
        let still = points_from_views(&[view(2.0)], &config);
        let points = points_from_views(&[moving], &config);
        let edge = |points: &[StartPoint], is_low: bool| {
            let of_rows = points.iter().filter(|p| (p.position_m[1] > 0.7) == is_low);
            of_rows.fold(f32::NEG_INFINITY, |m, p| m.max(p.position_m[0]))
        };
        // The lowest row is 0.235 s after the middle one.
        let shift = edge(&points, true) - edge(&still, true);
        assert!((shift - 0.23).abs() < 0.06, "{shift}");
    }
}
