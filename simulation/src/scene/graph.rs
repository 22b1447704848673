//! Checks of the edges between sectors.
//!
//! Edges form cycles, two sectors with an edge in each direction the shortest. Along a spanning
//! tree every sector has a pose; each other edge closes one cycle, whose error is measured where
//! an agent crosses it, in the middle of the overlap.

use std::collections::{BTreeMap, VecDeque};

use estimator_config::config;
use nalgebra::Vector3;

use super::sector::{Area, Sector, SectorEdge};
use super::similarity::Similarity;
use crate::error::SimulationError;

config! {
    /// How well edges have to agree.
    pub struct GraphConfig {
        /// Largest distance by which a cycle of edges misses where it began, m. Source: exam 6.6 of
        /// the simulators. More is a jump of the agent that a step limit of 20 cm does not hide.
        pub max_gap_m: f64 = 0.01,
        /// Largest rotation by which a cycle misses, degrees. Source: as above.
        pub max_gap_deg: f64 = 0.2,
        /// Largest relative error of the scale of a cycle: a centimetre over 10 m.
        pub max_scale_gap: f64 = 1e-3,
        /// Largest root mean square residual of the alignment of an edge, m. Walks align to a few
        /// centimetres; 10 cm is half of the step that an agent can take.
        pub max_residual_m: f64 = 0.1,
        /// Largest difference from 1 of the scale between two metric recordings, which bundles are.
        /// Stereo depth of a calibrated rig is within 1 % of the truth, on both sides.
        pub max_metric_scale_error: f64 = 0.02,
    }
}

/// Checks sectors and edges.
pub(super) fn check(sectors: &[Sector], config: &GraphConfig) -> Result<(), SimulationError> {
    let wrong = |place: String, found: String, expected: String| SimulationError::Scene {
        place,
        found,
        expected,
    };
    if sectors.is_empty() {
        let expected = "at least one".to_owned();
        return Err(wrong("sectors".to_owned(), "none".to_owned(), expected));
    }
    let mut names = BTreeMap::new();
    for (number, sector) in sectors.iter().enumerate() {
        if let Some(other) = names.insert(&sector.name, number) {
            let place = format!("sector {number}");
            let found = format!("the name {:?} of sector {other}", sector.name);
            return Err(wrong(place, found, "a name of its own".to_owned()));
        }
        for edge in &sector.edges {
            check_edge(sectors, number, edge, config)?;
        }
    }
    for (number, edge, gap) in cycles(sectors) {
        let place = edge_name(sectors, number, edge);
        if !gap.is_within(config) {
            let found = format!(
                "a cycle that does not close by {:.4} m, {:.3} degrees and a scale of {:.6}",
                gap.distance_m, gap.angle_deg, gap.scale
            );
            let expected = format!(
                "at most {} m, {} degrees and a scale of 1 within {}",
                config.max_gap_m, config.max_gap_deg, config.max_scale_gap
            );
            return Err(wrong(place, found, expected));
        }
    }
    Ok(())
}

fn edge_name(sectors: &[Sector], from: usize, edge: &SectorEdge) -> String {
    let name = |index: usize| match sectors.get(index) {
        Some(sector) => sector.name.clone(),
        None => format!("number {index}"),
    };
    format!("edge from {} to {}", name(from), name(edge.to))
}

fn check_edge(
    sectors: &[Sector],
    from: usize,
    edge: &SectorEdge,
    config: &GraphConfig,
) -> Result<(), SimulationError> {
    let is_metric = |sector: &Sector| sector.recording.bundle.is_some();
    let scale = edge.to_from_here.scale();
    let max_scale_error = config.max_metric_scale_error;
    let residual_m = edge.residual_m.unwrap_or(0.0);
    let (found, expected) = if edge.to >= sectors.len() {
        let found = format!("sector {} of {}", edge.to, sectors.len());
        (found, "a sector of the scene".to_owned())
    } else if edge.to == from {
        ("an edge to itself".to_owned(), "another sector".to_owned())
    } else if !edge.is_imported && !edge.to_from_here.is_rigid() {
        (
            format!("a scale of {scale}"),
            "1, inside of a recording".to_owned(),
        )
    } else if is_metric(&sectors[from])
        && is_metric(&sectors[edge.to])
        && (scale - 1.0).abs() > max_scale_error + ROUNDING
    {
        let expected = format!("1 within {max_scale_error}, between two metric recordings");
        (format!("a scale of {scale}"), expected)
    } else if !(0.0..=config.max_residual_m).contains(&residual_m) {
        let expected = format!("0 to {} m", config.max_residual_m);
        (format!("a residual of {residual_m} m"), expected)
    } else {
        return Ok(());
    };
    Err(SimulationError::Scene {
        place: edge_name(sectors, from, edge),
        found,
        expected,
    })
}

/// Of limits that are written with two digits.
const ROUNDING: f64 = 1e-9;

/// By how much a cycle misses its begin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gap {
    pub(super) distance_m: f64,
    pub(super) angle_deg: f64,
    pub(super) scale: f64,
}

impl Gap {
    fn is_within(&self, config: &GraphConfig) -> bool {
        self.distance_m <= config.max_gap_m
            && self.angle_deg <= config.max_gap_deg
            && (self.scale - 1.0).abs() <= config.max_scale_gap
    }
}

/// Poses of sectors along a spanning tree, each in the frame of the first sector that edges connect
/// it with: the index of that sector, and the transform.
pub(super) fn spanning_tree(sectors: &[Sector]) -> Vec<(usize, Similarity)> {
    let mut roots_from: Vec<Option<(usize, Similarity)>> = vec![None; sectors.len()];
    // Edges of both directions, each from its sector.
    let mut outgoing: Vec<Vec<(usize, Similarity)>> = vec![Vec::new(); sectors.len()];
    for (from, sector) in sectors.iter().enumerate() {
        for edge in &sector.edges {
            outgoing[from].push((edge.to, edge.to_from_here));
            outgoing[edge.to].push((from, edge.to_from_here.inverse()));
        }
    }
    for root in 0..sectors.len() {
        if roots_from[root].is_some() {
            continue;
        }
        roots_from[root] = Some((root, Similarity::identity()));
        let mut open = VecDeque::from([(root, Similarity::identity())]);
        while let Some((here, root_from_here)) = open.pop_front() {
            for (to, to_from_here) in &outgoing[here] {
                if roots_from[*to].is_none() {
                    let root_from_to = root_from_here.compose(&to_from_here.inverse());
                    roots_from[*to] = Some((root, root_from_to));
                    open.push_back((*to, root_from_to));
                }
            }
        }
    }
    roots_from.into_iter().flatten().collect()
}

/// The gap between each edge and the path along a spanning tree; none for edges of the tree.
pub(super) fn cycles(sectors: &[Sector]) -> Vec<(usize, &SectorEdge, Gap)> {
    let tree = spanning_tree(sectors);
    let edges = sectors.iter().enumerate();
    let edges = edges.flat_map(|(from, sector)| sector.edges.iter().map(move |edge| (from, edge)));
    edges
        .map(|(from, edge)| {
            let [(_, root_from_here), (_, root_from_to)] = [tree[from], tree[edge.to]];
            let by_tree = root_from_to.inverse().compose(&root_from_here);
            (from, edge, gap(edge, &by_tree))
        })
        .collect()
}

/// The difference between an edge and another path to its sector, at the overlap.
fn gap(edge: &SectorEdge, other: &Similarity) -> Gap {
    let [x, y] = edge.overlap.center_m();
    let heights = edge.overlap.height_m;
    let z = match heights.iter().all(|v| v.is_finite()) {
        true => 0.5 * (heights[0] + heights[1]),
        false => 0.0,
    };
    let [by_edge, by_other] =
        [&edge.to_from_here, other].map(|to| Vector3::from(to.apply([x, y, z])));
    let rotation = edge.to_from_here.rotation().inverse() * other.rotation();
    Gap {
        distance_m: (by_edge - by_other).norm(),
        angle_deg: rotation.angle().to_degrees(),
        scale: edge.to_from_here.scale() / other.scale(),
    }
}

/// The smallest area around another one in another frame.
pub(super) fn carried_area(area: &Area, to_from_here: &Similarity) -> Area {
    let [z0, z1] = area.height_m;
    let is_bounded = z0.is_finite() && z1.is_finite();
    let heights = if is_bounded { [z0, z1] } else { [0.0; 2] };
    let mut carried = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    for x in [area.min_m[0], area.max_m[0]] {
        for y in [area.min_m[1], area.max_m[1]] {
            for z in heights {
                let corner = to_from_here.apply([x, y, z]);
                for k in 0..3 {
                    carried[0][k] = carried[0][k].min(corner[k]);
                    carried[1][k] = carried[1][k].max(corner[k]);
                }
            }
        }
    }
    let [[x0, y0, z0], [x1, y1, z1]] = carried;
    let unbounded = Area::new([x0, y0], [x1, y1]);
    match is_bounded {
        true => Area {
            height_m: [z0, z1],
            ..unbounded
        },
        false => unbounded,
    }
}

/// The edge back to a sector.
pub(super) fn reverse(from: usize, edge: &SectorEdge) -> SectorEdge {
    SectorEdge {
        to: from,
        to_from_here: edge.to_from_here.inverse(),
        overlap: carried_area(&edge.overlap, &edge.to_from_here),
        ..edge.clone()
    }
}

#[cfg(test)]
mod tests;
