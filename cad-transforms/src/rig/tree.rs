//! Checks of the entries together: they are a tree that connects every frame to `rig`.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::ops::Range;

use super::table::Log;
use super::{Edge, Step};
use crate::frame::{Frame, FramePart};

/// Reports frames of cameras that have no left frame.
pub(super) fn check_cameras(edges: &[(Range<usize>, Edge)], log: &mut Log<'_>) {
    let frames: BTreeSet<&Frame> = edges
        .iter()
        .flat_map(|(_, e)| [&e.parent, &e.child])
        .collect();
    let mut reported = BTreeSet::new();
    for (at, edge) in edges {
        for frame in [&edge.parent, &edge.child] {
            let Some((camera, _)) = frame.camera() else {
                continue;
            };
            let left =
                Frame::of_camera(camera, FramePart::Left).expect("the camera's name is valid");
            if !frames.contains(&left) && reported.insert(camera) {
                log.add(
                    at.clone(),
                    format!(
                        "{frame} is there but {left} is not: the left frame is a camera's reference"
                    ),
                );
            }
        }
    }
}

/// Reports duplicated edges, loops and frames without a connection to `rig`; returns each frame's
/// step towards `rig`.
pub(super) fn check(edges: &[(Range<usize>, Edge)], log: &mut Log<'_>) -> BTreeMap<Frame, Step> {
    // `group` merges as edges come in; an edge inside one group closes a loop.
    let mut group: BTreeMap<&Frame, usize> = BTreeMap::new();
    let mut tree: Vec<&Edge> = Vec::new();
    for (i, (at, edge)) in edges.iter().enumerate() {
        let same = |(_, other): &&(Range<usize>, Edge)| {
            (&other.parent, &other.child) == (&edge.parent, &edge.child)
                || (&other.child, &other.parent) == (&edge.parent, &edge.child)
        };
        if let Some((first_at, _)) = edges[..i].iter().find(same) {
            let line = log.line(first_at);
            log.add(
                at.clone(),
                format!(
                    "{} and {} are already connected on line {line}",
                    edge.parent, edge.child
                ),
            );
            continue;
        }
        let next = group.len();
        let parent = *group.entry(&edge.parent).or_insert(next);
        let next = group.len();
        let child = *group.entry(&edge.child).or_insert(next);
        if parent == child {
            log.add(
                at.clone(),
                format!("connecting {} and {} closes a loop: they are connected already through other frames; a check belongs into [[closes_loop]]", edge.parent, edge.child),
            );
            continue;
        }
        group
            .values_mut()
            .filter(|g| **g == child)
            .for_each(|g| *g = parent);
        tree.push(edge);
    }

    let towards_rig = towards_rig(tree);

    for (at, edge) in edges {
        let lost: Vec<&Frame> = [&edge.parent, &edge.child]
            .into_iter()
            .filter(|frame| **frame != Frame::rig() && !towards_rig.contains_key(*frame))
            .collect();
        if let [first, ..] = lost.as_slice() {
            log.add(at.clone(), format!("{first} has no connection to rig"));
        }
    }
    towards_rig
}

/// Each frame's step towards `rig`, over edges without a loop.
pub(super) fn towards_rig<'e>(edges: impl IntoIterator<Item = &'e Edge>) -> BTreeMap<Frame, Step> {
    let edges: Vec<&Edge> = edges.into_iter().collect();
    let mut towards_rig = BTreeMap::new();
    let mut front = VecDeque::from([Frame::rig()]);
    while let Some(here) = front.pop_front() {
        for edge in &edges {
            let parent_from_child = edge.parent_from_child;
            let (far, here_from_far, covariance) = if edge.parent == here {
                (&edge.child, parent_from_child, edge.covariance)
            } else if edge.child == here {
                // The tolerance is the child's; seen from the other end it moves the parent.
                let covariance = edge.covariance.map(|c| c.moved(&parent_from_child));
                (&edge.parent, parent_from_child.inverse(), covariance)
            } else {
                continue;
            };
            if *far != Frame::rig() && !towards_rig.contains_key(far) {
                towards_rig.insert(
                    far.clone(),
                    Step {
                        this: far.clone(),
                        next: here.clone(),
                        next_from_this: here_from_far,
                        covariance,
                    },
                );
                front.push_back(far.clone());
            }
        }
    }
    towards_rig
}
