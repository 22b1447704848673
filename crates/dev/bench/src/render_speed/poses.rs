//! Reference poses: near the path of a walk, where a simulator starts and ends episodes.

use std::f64::consts::TAU;

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};
use rayon::prelude::*;
use splats::{Camera, Exposure, Renderer, Scene, SplatError};

/// Largest offsets from the path.
const MAX_OFFSET_M: f64 = 3.0;
const MAX_RISE_M: f64 = 0.3;
const MAX_YAW_DEG: f64 = 28.0;
const MAX_PITCH_DEG: f64 = 10.0;
/// Views are refused that show more sky, or more that is nearer than this.
const MAX_SKY: f64 = 0.5;
const MIN_DEPTH_M: f32 = 0.5;
const MAX_NEAR: f64 = 0.01;
/// Most draws for each view.
const MAX_DRAWS: u64 = 50;
/// Edge of the images by which views are judged, px.
const EDGE: u32 = 64;

/// A pinhole camera with 90 degrees from left to right.
pub(crate) fn camera(
    size: [u32; 2],
    world_from_camera: &RigidTransform,
) -> Result<Camera, SplatError> {
    let [width, height] = size.map(f64::from);
    let lens = [
        width / 2.0,
        width / 2.0,
        (width - 1.0) / 2.0,
        (height - 1.0) / 2.0,
    ];
    let model = CameraModel::new((size[0], size[1]), lens, Distortion::None);
    Camera::new(model, world_from_camera.inverse())
}

/// `world_from_camera` of reference views: random offsets from random poses of the path. Views
/// that show more than half sky or a surface nearer than half a metre are drawn again; fewer than
/// `count` if hardly any is left.
///
/// # Errors
/// A pose is invalid.
pub(crate) fn reference_poses(
    renderer: &Renderer,
    scene: &Scene,
    path: &[RigidTransform],
    count: usize,
) -> Result<Vec<RigidTransform>, SplatError> {
    let mut found = Vec::with_capacity(count);
    let mut next = 0;
    while found.len() < count && next < MAX_DRAWS * count as u64 {
        let numbers: Vec<u64> = (next..next + count as u64).collect();
        next += count as u64;
        let kept: Vec<Option<RigidTransform>> = numbers
            .par_iter()
            .map(|number| {
                let pose = pose(path, *number);
                let image = renderer.render(scene, &camera([EDGE; 2], &pose)?, &Exposure::NONE);
                let share = |hits: usize| hits as f64 / image.alpha.len() as f64;
                let sky = image.alpha.iter().filter(|alpha| **alpha < 0.5).count();
                let depths = image.median_depth_m.iter();
                let near = depths.filter(|depth| **depth < MIN_DEPTH_M).count();
                let is_valid = share(sky) <= MAX_SKY && share(near) <= MAX_NEAR;
                Ok(is_valid.then_some(pose))
            })
            .collect::<Result<_, SplatError>>()?;
        found.extend(kept.into_iter().flatten());
    }
    found.truncate(count);
    Ok(found)
}

fn pose(path: &[RigidTransform], number: u64) -> RigidTransform {
    let uniform = |stream: u64| counter_random::uniform(26, stream, number);
    let around = |stream: u64, most: f64| most * (2.0 * uniform(stream) - 1.0);
    let from = path[((uniform(0) * path.len() as f64) as usize).min(path.len() - 1)];
    let (angle, radius) = (TAU * uniform(1), MAX_OFFSET_M * uniform(2).sqrt());
    let [x, y, z] = from.translation_m();
    let position = [
        x + radius * libm::cos(angle),
        y + radius * libm::sin(angle),
        z + around(3, MAX_RISE_M),
    ];
    let turn = [
        around(4, MAX_PITCH_DEG).to_radians(),
        around(5, MAX_YAW_DEG).to_radians(),
        0.0,
    ];
    let turn = RigidTransform::from_rotation_vector(turn, [0.0; 3]);
    let turned = from * turn.unwrap_or_else(|_| RigidTransform::identity());
    let moved = RigidTransform::from_wxyz(turned.rotation_wxyz(), position);
    moved.unwrap_or(turned)
}
