//! Clusters of near-identical views.
//!
//! Contract: while the rig is at rest, every image repeats the last one, with the same corner
//! errors from print, pixels and compression. Taken as independent, they would make the stated
//! sigmas too small; the cluster numbers group them for the jackknife. Consecutive instants whose
//! corners are less than a few pixels from those of the first of them form one cluster.

use std::collections::BTreeMap;

use super::target_view::{TargetView, median_displacement_px};

/// The cluster of each instant with views; `max_px` is the maximum corner displacement within one.
pub(super) fn assign_clusters(views: &[TargetView], max_px: f64) -> BTreeMap<usize, usize> {
    let mut instants: BTreeMap<usize, Vec<&TargetView>> = BTreeMap::new();
    for view in views {
        let of = instants.entry(view.posed.instant).or_default();
        of.push(view);
    }
    let mut clusters = BTreeMap::new();
    let mut first: Option<&Vec<&TargetView>> = None;
    let mut cluster = 0;
    for (instant, of) in &instants {
        if !first.is_some_and(|first| is_same_view(first, of, max_px)) {
            first = Some(of);
            cluster += 1;
        }
        clusters.insert(*instant, cluster);
    }
    clusters
}

/// Whether no corner moved beyond `max_px` in any eye.
fn is_same_view(first: &[&TargetView], now: &[&TargetView], max_px: f64) -> bool {
    let moved = now.iter().filter_map(|b| {
        let key = |p: &TargetView| (p.posed.eye, p.posed.target);
        let a = first.iter().find(|a| key(a) == key(b))?;
        median_displacement_px(a, b)
    });
    // Without common corners the views count as different.
    let farthest = moved.fold(None, |far: Option<f64>, px| {
        Some(far.map_or(px, |far| far.max(px)))
    });
    farthest.is_some_and(|px| px < max_px)
}
