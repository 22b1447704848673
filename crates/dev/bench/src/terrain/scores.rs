//! Errors of a surface against the truth of its walk.

use anyhow::Result;
use nalgebra::Vector3;
use rig_sim::scene::terrain::StepEdge;
use serde::{Deserialize, Serialize};
use terrain::edges::Edge;
use terrain::evaluate::ErrorQuantiles;
use terrain::ground::Ground;
use terrain::maps::{CONTRADICTED, EDGE, FILLED, GroundSample, KNOWN, Level, SAMPLED, UNCERTAIN};

use super::patches::{PatchScores, patch_scores};
use super::surface::{Surface, maps};
use super::truth::{CONTACT_SIGMA_M, Crossing, Truth, horizontal_distance};

/// Radius around footprints within which holes and invented cells count, m.
const RADIUS_M: f64 = 0.6;
/// Ground nearer than this to no true surface is invented, m.
const INVENTED_M: f64 = 0.03;
/// Ground of a map at another level than a footprint, m.
const LEVEL_M: f64 = 0.3;
/// Found edges belong to a true one within this distance, m, and cosine of the angle.
const EDGE_M: f64 = 0.08;
const EDGE_COS: f64 = 0.966;

/// Quantiles, mm.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Quantiles {
    pub(crate) count: usize,
    pub(crate) median_mm: f64,
    pub(crate) p95_mm: f64,
    pub(crate) max_mm: f64,
    /// Mean with sign.
    pub(crate) mean_mm: f64,
}

impl Quantiles {
    pub(crate) fn of(errors: impl IntoIterator<Item = f64>) -> Self {
        let own = ErrorQuantiles::of(errors);
        Self {
            count: own.count,
            median_mm: 1e3 * own.median_m,
            p95_mm: 1e3 * own.p95_m,
            max_mm: 1e3 * own.max_m,
            mean_mm: 1e3 * own.mean_m,
        }
    }
}

/// Errors of a walk.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Scores {
    pub(super) footprints: usize,
    /// Heights under soles: of the mesh before and after vertices are moved to planes and edges,
    /// and of the cells of the maps that are not flagged as edges.
    pub(super) field_height: Quantiles,
    pub(super) mesh_height: Quantiles,
    pub(super) map_height: Quantiles,
    /// Cells under soles that are flagged as edges, and as uncertain.
    pub(super) sole_edge_cells: usize,
    pub(super) sole_uncertain_cells: usize,
    /// Share of heights of the mesh under soles within two of their sigmas.
    pub(super) within_two_sigmas: f64,
    /// Heights of the mesh within 0.6 m of footprints.
    pub(super) near_height: Quantiles,
    pub(super) edges: EdgeScores,
    pub(super) patches: PatchScores,
    /// True planes of at least 0.25 m2 within 0.6 m of footprints, and those found.
    pub(super) planes: usize,
    pub(super) planes_found: usize,
    /// Cells of open ground within 0.6 m of footprints, those without height from depth alone, and
    /// those of them that are filled.
    pub(super) cells: usize,
    pub(super) holes: usize,
    pub(super) filled: usize,
    /// The same under soles, and without height although contacts are known.
    pub(super) sole_cells: usize,
    pub(super) sole_holes: usize,
    pub(super) sole_holes_with_contacts: usize,
    /// Cells of ground of any level within 3.5 m of footprints, and those with a flag of any kind;
    /// cells whose nearest true surface is farther than 3 cm, and those of them without a flag.
    pub(super) ground_cells: usize,
    pub(super) flagged_cells: usize,
    pub(super) invented: usize,
    pub(super) invented_unflagged: usize,
    /// The same within 0.6 m of footprints.
    pub(super) near_cells: usize,
    pub(super) near_flagged: usize,
    pub(super) invented_near: usize,
}

/// Errors of step edges.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct EdgeScores {
    /// Edges that the walker crossed, and those found.
    pub(super) crossed: usize,
    pub(super) crossed_found: usize,
    /// Edges within a metre that he did not cross.
    pub(super) beside: usize,
    pub(super) beside_found: usize,
    /// Heights of found steps.
    pub(super) riser: Quantiles,
    /// Distances across the edge, positive towards the lower side.
    pub(super) up: Quantiles,
    pub(super) down: Quantiles,
    pub(super) other: Quantiles,
    /// Steps found near footprints where no true surface has one.
    pub(super) invented: usize,
    /// Errors of heights that are within two of their sigmas.
    pub(super) within_two_sigmas: f64,
    #[serde(skip)]
    pub(super) heights_m: Vec<f64>,
    #[serde(skip)]
    pub(super) places_m: [Vec<f64>; 3],
    /// Each edge in words.
    pub(super) list: Vec<String>,
}

/// All errors.
///
/// # Errors
/// A pose of a footprint that is not finite.
pub(super) fn scores(surface: &Surface, truth: &Truth<'_>) -> Result<Scores> {
    let mut scores = Scores {
        footprints: truth.footprints.len(),
        edges: edge_scores(surface, truth),
        patches: patch_scores(surface, truth)?,
        ..Scores::default()
    };
    heights(surface, truth, &mut scores);
    planes(surface, truth, &mut scores);
    holes(surface, truth, &mut scores);
    invented(surface, truth, &mut scores);
    Ok(scores)
}

fn heights(surface: &Surface, truth: &Truth<'_>, scores: &mut Scores) {
    let field = Ground::new(&surface.field);
    let soles = truth.footprints.iter().flat_map(|print| &print.ground);
    scores.field_height = Quantiles::of(soles.filter_map(|x| {
        let error = field.nearest(*x)?.height_m - x[2];
        (error.abs() < LEVEL_M).then_some(error)
    }));
    let ground = Ground::new(&surface.mesh);
    let error = |x: &[f64; 3]| {
        let point = ground.nearest(*x)?;
        let error = point.height_m - x[2];
        (error.abs() < LEVEL_M).then_some((error, point.sigma_m))
    };
    let under: Vec<(f64, f64)> = truth
        .footprints
        .iter()
        .flat_map(|print| print.ground.iter().filter_map(error))
        .collect();
    let within = under.iter().filter(|(e, sigma)| e.abs() <= 2.0 * sigma);
    scores.within_two_sigmas = within.count() as f64 / under.len().max(1) as f64;
    scores.mesh_height = Quantiles::of(under.iter().map(|(e, _)| *e));
    let of_maps: Vec<(f64, u8)> = sole_cells(truth)
        .into_iter()
        .filter_map(|x| {
            let (level, index) = cell(&surface.levels, x)?;
            let error = f64::from(level.elevation[index]) - x[2];
            Some((error, level.flags[index]))
        })
        .collect();
    let is_edge = |flags: u8| flags & EDGE != 0;
    let plain = of_maps.iter().filter(|(_, flags)| !is_edge(*flags));
    scores.map_height = Quantiles::of(plain.map(|(error, _)| *error));
    scores.sole_edge_cells = of_maps.iter().filter(|(_, flags)| is_edge(*flags)).count();
    scores.sole_uncertain_cells = of_maps
        .iter()
        .filter(|(_, flags)| flags & UNCERTAIN != 0)
        .count();
    let near = open_ground(truth);
    scores.near_height = Quantiles::of(near.iter().filter_map(error).map(|(e, _)| e));
}

/// Centers of map cells under soles, with the true height there.
fn sole_cells(truth: &Truth<'_>) -> Vec<[f64; 3]> {
    let mut cells: Vec<([i64; 2], [f64; 3])> = Vec::new();
    for [x, y, z] in truth.footprints.iter().flat_map(|print| &print.ground) {
        let at = [x, y].map(|v| (v / CELL_M).floor() as i64);
        let center = at.map(|k| (k as f64 + 0.5) * CELL_M);
        let height = truth.ground([center[0], center[1], *z], 0.03);
        if let Some(height) = height.filter(|height| (height - z).abs() < 0.03) {
            cells.push((at, [center[0], center[1], height]));
        }
    }
    cells.sort_by(|a, b| a.0.cmp(&b.0).then(a.1[2].total_cmp(&b.1[2])));
    cells.dedup_by(|a, b| a.0 == b.0 && (a.1[2] - b.1[2]).abs() < 0.03);
    cells.into_iter().map(|(_, center)| center).collect()
}

const CELL_M: f64 = 0.04;

/// Centers of map cells near footprints where nothing stands on the ground.
pub(super) fn open_ground(truth: &Truth<'_>) -> Vec<[f64; 3]> {
    let cells = truth.cells(CELL_M, RADIUS_M).into_iter();
    cells
        .filter_map(|[x, y, z]| {
            let height = truth.ground([x, y, z], 0.4)?;
            let is_open = truth
                .surfaces([x, y])
                .all(|other| !(height + 0.01..height + 1.5).contains(&other));
            ((height - z).abs() < 0.5 && is_open).then_some([x, y, height])
        })
        .collect()
}

/// The cell with a height near a point.
fn cell(levels: &[Level], [x, y, z]: [f64; 3]) -> Option<(&Level, usize)> {
    levels.iter().find_map(|level| {
        let index = level.index(x, y)?;
        let near = f64::from(level.elevation[index]) - z;
        (level.has_height(index) && near.abs() < LEVEL_M).then_some((level, index))
    })
}

fn planes(surface: &Surface, truth: &Truth<'_>, scores: &mut Scores) {
    for own in &truth.planes {
        let is_covered = |x: &&[f64; 3]| {
            surface.planes.planes.iter().any(|plane| {
                let normal = Vector3::from(plane.normal);
                let away = normal.dot(&(Vector3::from(**x) - Vector3::from(plane.center)));
                away.abs() < 0.015
                    && normal.dot(&own.plane.normal) > 0.9986
                    && plane.is_observed(**x)
            })
        };
        let covered = own.points.iter().filter(is_covered).count();
        scores.planes += 1;
        scores.planes_found += usize::from(2 * covered >= own.points.len());
    }
}

fn holes(surface: &Surface, truth: &Truth<'_>, scores: &mut Scores) {
    let samples: Vec<GroundSample> = truth
        .footprints
        .iter()
        .enumerate()
        .map(|(number, print)| {
            let noise = CONTACT_SIGMA_M * counter_random::bell(41, 0, number as u64);
            let [x, y, z] = print.middle;
            GroundSample {
                position: [x, y, z + noise],
                sigma_m: CONTACT_SIGMA_M,
                contact: number,
            }
        })
        .collect();
    let flags = |levels: &[Level], x: [f64; 3]| {
        cell(levels, x).map_or(0, |(level, index)| level.flags[index])
    };
    for x in open_ground(truth) {
        let flags = flags(&surface.levels, x);
        scores.cells += 1;
        scores.holes += usize::from(flags & KNOWN == 0);
        scores.filled += usize::from(flags & KNOWN == 0 && flags & FILLED != 0);
    }
    let with_contacts = maps(&surface.ground, &surface.edges, &samples);
    for x in sole_cells(truth) {
        scores.sole_cells += 1;
        scores.sole_holes += usize::from(flags(&surface.levels, x) & KNOWN == 0);
        scores.sole_holes_with_contacts += usize::from(flags(&with_contacts, x) == 0);
    }
}

fn invented(surface: &Surface, truth: &Truth<'_>, scores: &mut Scores) {
    for level in &surface.levels {
        for index in 0..level.flags.len() {
            if level.flags[index] & KNOWN == 0 {
                continue;
            }
            let [x, y] = level.center(index);
            let at = [x, y, f64::from(level.elevation[index])];
            let away =
                |print: &super::truth::Footprint| (print.middle[0] - x).hypot(print.middle[1] - y);
            let nearest = truth
                .footprints
                .iter()
                .map(away)
                .fold(f64::INFINITY, f64::min);
            // Triangles are known near the footsteps.
            if nearest > 3.5 {
                continue;
            }
            let is_flagged =
                level.flags[index] & (FILLED | SAMPLED | CONTRADICTED | EDGE | UNCERTAIN) != 0;
            let is_near = nearest < RADIUS_M;
            scores.ground_cells += 1;
            scores.flagged_cells += usize::from(is_flagged);
            scores.near_cells += usize::from(is_near);
            scores.near_flagged += usize::from(is_near && is_flagged);
            if truth.distance(at) <= INVENTED_M {
                continue;
            }
            scores.invented += 1;
            scores.invented_unflagged += usize::from(!is_flagged);
            scores.invented_near += usize::from(!is_flagged && is_near);
        }
    }
}

/// Points of a found edge with the place of each along a true one, and its distance across.
fn places(found: &Edge, edge: &StepEdge) -> Vec<f64> {
    let [from, to] = edge.ends;
    let along = (to - from).xy();
    let length = along.norm();
    let along = along / length;
    let [own_from, own_to] = [found.from, found.to].map(Vector3::from);
    let own = (own_to - own_from).xy();
    let has_direction = own.norm() > 1e-6 && along.dot(&own.normalize()).abs() > EDGE_COS;
    if !has_direction {
        return Vec::new();
    }
    let count = (own.norm() / 0.05).ceil() as usize;
    (0..count)
        .filter_map(|k| {
            let x = own_from + (own_to - own_from) * ((k as f64 + 0.5) / count as f64);
            let d = x.xy() - from.xy();
            let (at, across) = (along.dot(&d), along.y * d.x - along.x * d.y);
            let height = from.z + (to.z - from.z) * at / length;
            let is_near = across.abs() < EDGE_M && (x.z - height).abs() < EDGE_M;
            (is_near && (0.0..length).contains(&at)).then_some(across)
        })
        .collect()
}

fn edge_scores(surface: &Surface, truth: &Truth<'_>) -> EdgeScores {
    let mut scores = EdgeScores::default();
    let mut is_known = vec![false; surface.edges.len()];
    let mut within = 0;
    for step in &truth.edges {
        let lengths = (step.edge.ends[1] - step.edge.ends[0]).norm();
        let mut found = (0.0, None);
        for (number, edge) in surface.edges.iter().enumerate() {
            let places = places(edge, &step.edge);
            if places.len() < 2 {
                continue;
            }
            is_known[number] = true;
            let length = 0.05 * places.len() as f64;
            if edge.step.is_some() && length > found.0 {
                found = (length, Some((edge, places)));
            }
        }
        let (crossed, crossed_found) = match step.crossing {
            Crossing::Beside => (&mut scores.beside, &mut scores.beside_found),
            _ => (&mut scores.crossed, &mut scores.crossed_found),
        };
        *crossed += 1;
        let middle = step.edge.heights_m();
        let truth_m = 0.5 * (middle[0] + middle[1]);
        let mut text = format!(
            "{:?} {lengths:.2} m long, {:.0} mm high",
            step.crossing,
            1e3 * truth_m
        );
        if let Some((edge, places)) = found.1 {
            *crossed_found += 1;
            let own = edge.step.expect("edges without steps are left out");
            let at = edge.middle();
            let [from, to] = step.edge.ends;
            let along = (to - from).xy();
            let share = along.dot(&(Vector3::from(at).xy() - from.xy())) / along.norm_squared();
            let true_height = middle[0] + (middle[1] - middle[0]) * share.clamp(0.0, 1.0);
            let error = own.height_m - true_height;
            within += usize::from(error.abs() <= 2.0 * own.sigma_m);
            scores.heights_m.push(error);
            let mean = places.iter().sum::<f64>() / places.len() as f64;
            text += &format!(
                ": {:?}, {:.2} m, height {:+.1} mm (sigma {:.1}), place {:+.1} mm (sigma {:.1})",
                edge.kind,
                edge.length_m(),
                1e3 * error,
                1e3 * own.sigma_m,
                1e3 * mean,
                1e3 * edge.sigma_m
            );
            let of = match step.crossing {
                Crossing::Up => 0,
                Crossing::Down => 1,
                Crossing::Beside => 2,
            };
            scores.places_m[of].extend(places);
        } else {
            text += ": not found";
        }
        scores.list.push(text);
    }
    for (number, edge) in surface.edges.iter().enumerate() {
        let Some(step) = edge.step.filter(|_| !is_known[number]) else {
            continue;
        };
        let at = edge.middle();
        let is_near = truth
            .footprints
            .iter()
            .any(|print| (print.middle[0] - at[0]).hypot(print.middle[1] - at[1]) < 1.0);
        if is_near && !is_real(truth, at, &step) {
            scores.invented += 1;
            scores.list.push(format!(
                "invented: {:?} at {:.2} {:.2} {:.2}, {:.2} m long, {:.0} mm high",
                edge.kind,
                at[0],
                at[1],
                at[2],
                edge.length_m(),
                1e3 * step.height_m
            ));
        }
    }
    scores.within_two_sigmas = within as f64 / scores.heights_m.len().max(1) as f64;
    scores.riser = Quantiles::of(scores.heights_m.iter().copied());
    scores.up = Quantiles::of(scores.places_m[0].iter().copied());
    scores.down = Quantiles::of(scores.places_m[1].iter().copied());
    scores.other = Quantiles::of(scores.places_m[2].iter().copied());
    scores
}

/// Whether true surfaces have this step within 8 cm: what people do not walk on has edges too.
fn is_real(truth: &Truth<'_>, [x, y, z]: [f64; 3], step: &terrain::edges::Step) -> bool {
    let has = |side: f64, height: f64| {
        (1..=8).any(|k| {
            let at = 0.01 * side * f64::from(k);
            let place = [x + at * step.direction[0], y + at * step.direction[1]];
            truth
                .surfaces(place)
                .any(|other| (other - height).abs() < 0.03)
        })
    };
    let lower = z - step.height_m;
    let far = 0.3;
    let below = [x + far * step.direction[0], y + far * step.direction[1]];
    let is_below = truth
        .surfaces(below)
        .any(|other| (other - lower).abs() < 0.03);
    let is_known = truth.edges.iter().any(|own| {
        horizontal_distance(&own.edge, [x, y, z]) < EDGE_M
            && (own.edge.ends[0].z - z).abs() < EDGE_M
    });
    is_known || has(-1.0, z) && (has(1.0, lower) || is_below)
}
