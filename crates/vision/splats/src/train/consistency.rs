//! Points moved along their normals to where views agree about them.
//!
//! The baseline between views is many times that of a stereo camera: what stereo knows to some
//! percent, the images of a walk know to a fraction of that. Around a point a small square across
//! its normal is projected into the views that see it; where the surface is, they show the same
//! pattern. The measure is the normalized cross-correlation with the nearest view.

use rayon::prelude::*;

use super::fuse::Source;
use super::start::{StartConfig, StartPoint};

/// Samples along an edge of the square.
const EDGE: usize = 7;
const SAMPLES: usize = EDGE * EDGE;

/// Distance between samples, in pixels of the nearest view.
const SAMPLE_PX: f64 = 1.0;

/// Offsets along the normal, to each side.
const OFFSETS: i32 = 8;

/// Views of a point, at most, and how many times farther than the nearest one they may be.
const MAX_VIEWS: usize = 8;
const MAX_DISTANCE: f64 = 2.0;

/// Smallest cosine between the normal and the direction to a view.
const MIN_FACING: f64 = 0.2;

/// Smallest standard deviation of a pattern, gray levels.
const MIN_CONTRAST: f32 = 3.0;

type Patch = [f32; SAMPLES];

/// Moves each point that has a normal and a pattern, if views agree better elsewhere.
pub(super) fn refine(points: &mut [StartPoint], sources: &[Source<'_>], config: &StartConfig) {
    points.par_iter_mut().for_each(|point| {
        if let Some((position_m, sigma_m)) = refined(point, sources, config) {
            point.position_m = position_m;
            point.sigma_m = sigma_m;
        }
    });
}

/// Position and standard deviation along the normal.
fn refined(
    point: &StartPoint,
    sources: &[Source<'_>],
    config: &StartConfig,
) -> Option<([f32; 3], f32)> {
    let normal = point.normal?.map(f64::from);
    let center = point.position_m.map(f64::from);
    let views = views(center, normal, sources);
    let (nearest, others) = views.split_first()?;
    if others.len() < config.min_agreeing_views {
        return None;
    }
    let [u, v] = across(normal);
    let (_, depth) = nearest.project(center)?;
    let spacing = SAMPLE_PX * depth / nearest.view.camera.model().fx;
    let reach = config.search_sigmas * f64::from(point.sigma_m);
    let step = reach / f64::from(OFFSETS);
    let score = |offset: i32| -> Option<f64> {
        let at = along(center, normal, f64::from(offset) * step);
        let pattern = normalized(&patch(nearest, at, [u, v], spacing)?)?;
        let (mut sum, mut count) = (0.0, 0);
        for view in others {
            if let Some(other) = patch(view, at, [u, v], spacing).and_then(|p| normalized(&p)) {
                sum += f64::from(pattern.iter().zip(other).map(|(a, b)| a * b).sum::<f32>());
                count += 1;
            }
        }
        (count >= config.min_agreeing_views).then(|| sum / f64::from(count as u32))
    };
    let scores: Vec<Option<f64>> = (-OFFSETS..=OFFSETS).map(score).collect();
    let best = (0..scores.len())
        .filter(|k| scores[*k].is_some())
        .max_by(|a, b| {
            scores[*a]
                .partial_cmp(&scores[*b])
                .unwrap_or(std::cmp::Ordering::Equal)
        })?;
    let (before, peak, after) = (
        scores.get(best.checked_sub(1)?).copied()??,
        scores[best]?,
        scores.get(best + 1).copied()??,
    );
    if peak < config.min_agreement {
        return None;
    }
    // The maximum of the parabola through three scores.
    let bend = before + after - 2.0 * peak;
    let shift = if bend < -1e-9 {
        0.5 * (before - after) / bend
    } else {
        0.0
    };
    let offset = (best as f64 - f64::from(OFFSETS) + shift.clamp(-0.5, 0.5)) * step;
    let position = along(center, normal, offset);
    Some((position.map(|v| v as f32), (0.5 * step) as f32))
}

/// Views that see a point, nearest first.
fn views<'a>(center: [f64; 3], normal: [f64; 3], sources: &'a [Source<'a>]) -> Vec<&'a Source<'a>> {
    let mut found: Vec<(f64, usize)> = Vec::new();
    for (index, source) in sources.iter().enumerate() {
        let to = [0, 1, 2].map(|k| source.center[k] - center[k]);
        let distance = to.iter().map(|v| v * v).sum::<f64>().sqrt();
        let facing = to.iter().zip(normal).map(|(a, b)| a * b).sum::<f64>();
        let ahead = -to.iter().zip(source.axis).map(|(a, b)| a * b).sum::<f64>();
        if ahead > 0.0 && facing > MIN_FACING * distance && source.shows(center) {
            found.push((distance, index));
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let Some(nearest) = found.first().map(|(distance, _)| *distance) else {
        return Vec::new();
    };
    found.retain(|(distance, _)| *distance <= MAX_DISTANCE * nearest);
    // From near to far, for the longest baselines.
    let count = found.len().min(MAX_VIEWS);
    let each = |k: usize| found[k * (found.len() - 1) / (count - 1).max(1)].1;
    (0..count).map(|k| &sources[each(k)]).collect()
}

/// Two directions across a normal.
fn across(n: [f64; 3]) -> [[f64; 3]; 2] {
    let least = (0..3).fold(0, |k, other| {
        if n[other].abs() < n[k].abs() {
            other
        } else {
            k
        }
    });
    let mut axis = [0.0; 3];
    axis[least] = 1.0;
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    };
    let u = cross(n, axis);
    let length = u.iter().map(|v| v * v).sum::<f64>().sqrt();
    let u = u.map(|v| v / length);
    [u, cross(n, u)]
}

fn along(center: [f64; 3], direction: [f64; 3], by: f64) -> [f64; 3] {
    [0, 1, 2].map(|k| center[k] + by * direction[k])
}

/// Gray levels of a square around a point. Within some pixels a projection is affine: three points
/// are projected, and not each sample.
fn patch(
    source: &Source<'_>,
    center: [f64; 3],
    [u, v]: [[f64; 3]; 2],
    spacing: f64,
) -> Option<Patch> {
    let middle = (EDGE / 2) as f64;
    let (at, _) = source.image_point(center)?;
    let step = |direction: [f64; 3]| {
        let (end, _) = source.image_point(along(center, direction, middle * spacing))?;
        Some([0, 1].map(|k| (end[k] - at[k]) / middle))
    };
    let (by_u, by_v) = (step(u)?, step(v)?);
    let pixel = |a: f64, b: f64| [0, 1].map(|k| at[k] + a * by_u[k] + b * by_v[k]);
    let ends = [-middle, middle];
    let mut corners = ends.iter().flat_map(|a| ends.map(|b| pixel(*a, b)));
    if !corners.all(|corner| source.has_gray(corner)) {
        return None;
    }
    let mut out = [0.0; SAMPLES];
    for (k, value) in out.iter_mut().enumerate() {
        let [a, b] = [k % EDGE, k / EDGE].map(|i| i as f64 - middle);
        *value = source.gray(pixel(a, b));
    }
    Some(out)
}

/// Without mean and of length 1; `None` without pattern.
fn normalized(patch: &Patch) -> Option<Patch> {
    let count = SAMPLES as f32;
    let mean = patch.iter().sum::<f32>() / count;
    let square: f32 = patch.iter().map(|v| (v - mean) * (v - mean)).sum();
    let length = square.sqrt();
    (length >= MIN_CONTRAST * count.sqrt()).then(|| patch.map(|v| (v - mean) / length))
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;
    use camera_models::{CameraModel, Distortion};

    use super::*;
    use crate::camera::Camera;
    use crate::train::TrainingView;

    /// A wall at z = 4 with a pattern, or without, from a position along it.
    fn view(number: u32, x_m: f64, has_pattern: bool) -> TrainingView {
        let model = CameraModel::new((96, 64), [80.0, 80.0, 47.5, 31.5], Distortion::None);
        let pose = RigidTransform::from_translation_m([-x_m, 0.0, 0.0]).unwrap();
        let camera = Camera::new(model, pose).unwrap();
        let gray = |pixel: u32| {
            let at = |of: u32, center: f64| (f64::from(of) - center) / 80.0 * 4.0;
            let (x, y) = (at(pixel % 96, 47.5) + x_m, at(pixel / 96, 31.5));
            let pattern = (7.0 * x + 2.0 * y).sin() + (3.0 * x - 9.0 * y).sin();
            if has_pattern {
                (128.0 + 50.0 * pattern) as u8
            } else {
                128
            }
        };
        let rgb = (0..96 * 64).flat_map(|pixel| [gray(pixel); 3]).collect();
        TrainingView::new(camera, rgb, number)
    }

    fn distance_after(has_pattern: bool, displaced_m: f32) -> f32 {
        let of = |k: u32| view(k, 0.25 * f64::from(k), has_pattern);
        let views: Vec<TrainingView> = (0..6).map(of).collect();
        let sources: Vec<Source<'_>> = views.iter().map(Source::new).collect();
        let mut points = [StartPoint {
            position_m: [0.6, 0.1, 4.0 + displaced_m],
            normal: Some([0.0, 0.0, -1.0]),
            spacing_m: 0.1,
            sigma_m: 0.1,
            color: [0.5; 3],
        }];
        refine(&mut points, &sources, &StartConfig::default());
        points[0].position_m[2] - 4.0
    }

    #[test]
    fn points_move_to_the_surface_that_the_views_show() {
        for displaced_m in [-0.2, -0.07, 0.0, 0.15] {
            let after = distance_after(true, displaced_m);
            assert!(after.abs() < 0.02, "{after} m after {displaced_m} m");
        }
    }

    #[test]
    fn points_stay_without_pattern_or_beyond_the_search() {
        assert_eq!(distance_after(false, 0.1), 0.1_f32.mul_add(1.0, 4.0) - 4.0);
        let far = distance_after(true, 0.8);
        assert!(far > 0.4, "{far}");
    }
}
