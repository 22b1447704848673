//! The ground below an edge, and the height of the step down to it.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::edge::{Edge, EdgeKind, Step};
use crate::config::EdgeConfig;
use crate::planes::{Plane, Planes};

/// Spacing of the samples along an edge and away from it, m.
const SAMPLE_M: f64 = 0.02;

/// The step down at an edge, if its first plane is ground and there is ground below.
pub(super) fn step(
    planes: &Planes,
    ground: &[(usize, [Vector3<f64>; 2])],
    edge: &Edge,
    config: &EdgeConfig,
) -> Option<Step> {
    let number = edge.planes.0 as usize;
    let upper = &planes.planes[number];
    if edge.kind == EdgeKind::Concave || upper.frame.normal.z < config.min_ground_cos {
        return None;
    }
    let [from, to] = [edge.from, edge.to].map(Vector3::from);
    let along = (to - from).normalize();
    let mut out = along.cross(&upper.frame.normal);
    // Away from the support of the plane.
    let probe = |side: f64| {
        let at = |share: f64| from + (to - from) * share + out * (side * 0.03);
        [0.25, 0.5, 0.75]
            .into_iter()
            .filter(|share| upper.is_observed(at(*share).into()))
            .count()
    };
    match (probe(1.0), probe(-1.0)) {
        (ahead, behind) if ahead < behind => {}
        (ahead, behind) if ahead > behind => out = -out,
        _ => return None,
    }
    out.z = 0.0;
    let out = out.try_normalize(1e-6)?;
    let near: Vec<&(usize, [Vector3<f64>; 2])> = ground
        .iter()
        .filter(|(other, [low, high])| {
            let reach = config.max_run_m;
            let (least, most) = (from.inf(&to), from.sup(&to));
            *other != number
                && (0..2).all(|k| low[k] <= most[k] + reach && high[k] >= least[k] - reach)
                && low.z <= most.z
                && high.z >= least.z - config.max_step_m - reach
        })
        .collect();
    let samples = ((to - from).norm() / SAMPLE_M / 2.0).ceil().max(1.0) as usize;
    let mut votes: BTreeMap<usize, usize> = BTreeMap::new();
    for sample in 0..samples {
        let x = from + (to - from) * ((sample as f64 + 0.5) / samples as f64);
        if let Some(below) = first_below(planes, &near, &x, &out, config) {
            *votes.entry(below).or_default() += 1;
        }
    }
    let (below, count) = votes
        .into_iter()
        .max_by_key(|(plane, count)| (*count, usize::MAX - plane))?;
    if 3 * count < samples {
        return None;
    }
    height(planes, [number, below], edge, out, config)
}

/// The first ground that is met away from a point of an edge.
fn first_below(
    planes: &Planes,
    ground: &[&(usize, [Vector3<f64>; 2])],
    x: &Vector3<f64>,
    out: &Vector3<f64>,
    config: &EdgeConfig,
) -> Option<usize> {
    for step in 1..=(config.max_run_m / SAMPLE_M) as usize {
        let at = x + out * (SAMPLE_M * step as f64);
        let mut found: Option<(usize, f64)> = None;
        for (other, _) in ground {
            let plane = &planes.planes[*other];
            let Some(height) = plane.height_at(at.x, at.y) else {
                continue;
            };
            let drop = x.z - height;
            let is_higher = found.is_none_or(|(_, highest)| height > highest);
            if (config.min_step_m..=config.max_step_m).contains(&drop)
                && is_higher
                && plane.is_observed([at.x, at.y, height])
            {
                found = Some((*other, height));
            }
        }
        if let Some((other, _)) = found {
            return Some(other);
        }
    }
    None
}

fn height(
    planes: &Planes,
    [upper, below]: [usize; 2],
    edge: &Edge,
    out: Vector3<f64>,
    config: &EdgeConfig,
) -> Option<Step> {
    let middle = edge.middle();
    let [a, b] = [upper, below].map(|i| &planes.planes[i]);
    let foot = b.height_at(middle[0], middle[1])?;
    let at_foot = [middle[0], middle[1], foot];
    let drop = middle[2] - foot;
    if !(config.min_step_m..=config.max_step_m).contains(&drop) {
        return None;
    }
    let apart = a.sigma_at(middle).hypot(b.sigma_at(at_foot));
    let together = height_in_views(planes, [a, b], [middle, at_foot]);
    let (height_m, sigma_m, views) = match together {
        Some((correction, sigma, views)) if sigma < apart => (drop + correction, sigma, views),
        Some((_, _, views)) => (drop, apart, views),
        None => (drop, apart, 0),
    };
    Some(Step {
        below: below as u32,
        height_m,
        sigma_m,
        views,
        direction: [out.x, out.y],
    })
}

/// What views that saw both planes add to the vertical distance of two points of theirs. In such a
/// view, errors of its pose are common to both.
fn height_in_views(
    planes: &Planes,
    of: [&Plane; 2],
    at: [[f64; 3]; 2],
) -> Option<(f64, f64, usize)> {
    let config = &planes.config;
    // The tilt of a plane against its mean of all views: of the view's pose.
    let tilt = config.view_tilt_sigma_rad;
    let coordinates = [0, 1].map(|k| of[k].sums_frame.coordinates(&Vector3::from(at[k])));
    let (mut weight, mut sum, mut views) = (0.0, 0.0, 0);
    for upper in &of[0].sums {
        let position = of[1]
            .sums
            .binary_search_by_key(&upper.view, |sums| sums.view);
        let Ok(position) = position else {
            continue;
        };
        let pair = [upper, &of[1].sums[position]];
        let heights = [0, 1].map(|k| {
            let [s, t, _] = coordinates[k];
            let [samples, common] = [config.correlated_samples, config.common_ratio];
            pair[k].height_at(samples, common, tilt, &of[k].height, [s, t])
        });
        let [Some((h0, v0)), Some((h1, v1))] = heights else {
            continue;
        };
        // Heights along the normals, against the mean of all views, as vertical ones.
        let [c0, c1] = [0, 1].map(|k| {
            let [s, t, _] = coordinates[k];
            let mean = of[k].height[0] + of[k].height[1] * s + of[k].height[2] * t;
            ([h0, h1][k] - mean) / of[k].sums_frame.normal.z
        });
        let variance = v0 + v1;
        weight += 1.0 / variance;
        sum += (c0 - c1) / variance;
        views += 1;
    }
    // The slopes of the planes are common to all views.
    let slopes = [0, 1].map(|k| {
        let [s, t, _] = coordinates[k];
        let away = Vector3::new(0.0, s, t);
        away.dot(&(of[k].covariance * away))
    });
    let variance = 1.0 / weight + slopes[0] + slopes[1] + 5e-4 * 5e-4;
    (views > 0).then(|| (sum / weight, variance.sqrt(), views))
}
