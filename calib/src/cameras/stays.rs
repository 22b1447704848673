//! One instant of each stay.
//!
//! Contract: while the rig rests, every picture repeats the last one, and with it where print, pixels and compression put its corners
//! wrongly. Taken as independent views they would make results look surer than they are. Of instants that follow each other
//! with corners less than [`STAY_PX`] from where they were at the first of them, only the stillest is used. Recordings of views that
//! are all different lose nothing.

use std::collections::{BTreeMap, BTreeSet};

use super::gather::{Picture, moved_px};

/// Corners that are no farther from where they were show the same view, px.
const STAY_PX: f64 = 3.0;

/// The instants that are used.
pub(super) fn one_of_each(pictures: &[Picture]) -> BTreeSet<usize> {
    let mut instants: BTreeMap<usize, Vec<&Picture>> = BTreeMap::new();
    for picture in pictures {
        let of = instants.entry(picture.posed.instant).or_default();
        of.push(picture);
    }
    let movement = |of: &[&Picture]| of.iter().map(|p| p.movement()).fold(0.0, f64::max);
    let mut kept = BTreeSet::new();
    // The first instant of the stay, and the stillest so far with its movement.
    let mut stay: Option<(&[&Picture], usize, f64)> = None;
    for (instant, of) in &instants {
        let moving = movement(of);
        stay = match stay {
            Some((first, stillest, least)) if is_same_view(first, of) => match moving < least {
                true => Some((first, *instant, moving)),
                false => Some((first, stillest, least)),
            },
            other => {
                kept.extend(other.map(|(_, stillest, _)| stillest));
                Some((of, *instant, moving))
            }
        };
    }
    kept.extend(stay.map(|(_, stillest, _)| stillest));
    kept
}

/// Whether no eye sees anything elsewhere than before.
fn is_same_view(first: &[&Picture], now: &[&Picture]) -> bool {
    let moved = now.iter().filter_map(|b| {
        let key = |p: &Picture| (p.posed.eye, p.posed.target);
        let a = first.iter().find(|a| key(a) == key(b))?;
        moved_px(a, b)
    });
    // Without anything in common nothing says that it is the same.
    let farthest = moved.fold(None, |far: Option<f64>, px| {
        Some(far.map_or(px, |far| far.max(px)))
    });
    farthest.is_some_and(|px| px < STAY_PX)
}
