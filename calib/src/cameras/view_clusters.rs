//! Which instants show the same view.
//!
//! Contract: while the rig rests, every picture repeats the last one, and with it where print, pixels and compression put its corners
//! wrongly. Taken as independent they would make results look surer than they are; numbers of stays tell which are not. Instants
//! that follow each other with corners less than [`CLUSTER_PX`] from where they were at the first of them are one stay.

use std::collections::BTreeMap;

use super::pipeline::{TargetView, median_displacement_px};

/// Corners that are no farther from where they were show the same view, px.
const CLUSTER_PX: f64 = 3.0;

/// The number of the stay of each instant of which there are pictures.
pub(super) fn assign_clusters(views: &[TargetView]) -> BTreeMap<usize, usize> {
    let mut instants: BTreeMap<usize, Vec<&TargetView>> = BTreeMap::new();
    for view in views {
        let of = instants.entry(view.posed.instant).or_default();
        of.push(view);
    }
    let mut clusters = BTreeMap::new();
    let mut first: Option<&Vec<&TargetView>> = None;
    let mut cluster = 0;
    for (instant, of) in &instants {
        if !first.is_some_and(|first| is_same_view(first, of)) {
            first = Some(of);
            cluster += 1;
        }
        clusters.insert(*instant, cluster);
    }
    clusters
}

/// Whether no eye sees anything elsewhere than before.
fn is_same_view(first: &[&TargetView], now: &[&TargetView]) -> bool {
    let moved = now.iter().filter_map(|b| {
        let key = |p: &TargetView| (p.posed.eye, p.posed.target);
        let a = first.iter().find(|a| key(a) == key(b))?;
        median_displacement_px(a, b)
    });
    // Without anything in common nothing says that it is the same.
    let farthest = moved.fold(None, |far: Option<f64>, px| {
        Some(far.map_or(px, |far| far.max(px)))
    });
    farthest.is_some_and(|px| px < CLUSTER_PX)
}
