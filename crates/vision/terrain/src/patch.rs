//! Contact patches: the part of a sole at rest that bears.
//!
//! On the edge of a step heel or toe hang free. A point of the sole bears unless the ground of
//! depth is lower there by more than a gap. Where depth shows no ground, nothing contradicts the
//! contact, except beyond the edge of a step: from above no view sees the foot of its riser.

use cad_transforms::RigidTransform;
use nalgebra::Vector3;

use crate::config::PatchConfig;
use crate::edges::{Edge, Strip};
use crate::ground::Ground;
use crate::hull::{area, convex_hull};
use crate::planes::Polygon;

/// The part of a sole that bears.
#[derive(Clone, Debug, PartialEq)]
pub struct ContactPatch {
    /// Corners on the plane of the sole in the world, m.
    pub outline_m: Vec<[f64; 3]>,
    /// Its area as a share of the sole's.
    pub area_share: f64,
    /// Share of it below which depth shows ground.
    pub ground_share: f64,
    /// Height of the sole above that ground, median, m; negative if it is below. None if depth
    /// shows no ground.
    pub gap_m: Option<f64>,
}

/// How a point of a sole stands to the ground.
#[derive(Clone, Copy, PartialEq)]
enum Support {
    /// On the ground that depth shows, this high above it, m.
    Ground(f64),
    /// The ground is lower.
    Free,
    /// Depth shows no ground.
    Unknown,
}

/// The patch of a sole at rest.
///
/// `edges` are those of the ground's planes, of which those with a step count. `outline_m` is that
/// of the sole in the frame of the foot (x to the toe, y to the left, z up from the sole),
/// `height_sigma_m` one standard deviation of the height of the sole.
///
/// If nothing hangs free the patch is the whole outline, otherwise the convex hull of the points
/// that bear. If all ground that depth shows is lower, it is the whole outline with a
/// `ground_share` of 0: the foot did stand there, and the ground is not where depth has it, as of
/// water and grass.
///
/// ```
/// use cad_transforms::RigidTransform;
/// use terrain::contact_patch;
/// use terrain::ground::Ground;
/// use terrain::mesh::Mesh;
///
/// // Level ground 1 cm below a foot at the origin.
/// let corners = [[-1.0, -1.0, -0.01], [1.0, -1.0, -0.01], [1.0, 1.0, -0.01], [-1.0, 1.0, -0.01]];
/// let mesh = Mesh {
///     positions: corners.to_vec(),
///     normals: vec![[0.0, 0.0, 1.0]; 4],
///     colors: vec![[0; 3]; 4],
///     sigma_m: vec![0.002; 4],
///     views: vec![5; 4],
///     triangles: vec![[0, 1, 2], [0, 2, 3]],
/// };
/// let outline = [[-0.14, -0.05], [0.14, -0.05], [0.14, 0.05], [-0.14, 0.05]];
/// let foot = RigidTransform::identity();
/// let ground = Ground::new(&mesh);
/// let patch = contact_patch(&ground, &[], &foot, &outline, 0.003, &Default::default());
/// assert_eq!((patch.outline_m.len(), patch.area_share, patch.ground_share), (4, 1.0, 1.0));
/// assert!((patch.gap_m.expect("ground") - 0.01).abs() < 1e-6);
/// ```
pub fn contact_patch(
    ground: &Ground<'_>,
    edges: &[Edge],
    world_from_foot: &RigidTransform,
    outline_m: &[[f64; 2]],
    height_sigma_m: f64,
    config: &PatchConfig,
) -> ContactPatch {
    let in_world = |[x, y]: [f64; 2]| world_from_foot.apply([x, y, 0.0]);
    let middle = world_from_foot.translation_m();
    let near = edges
        .iter()
        .filter(|edge| edge.distance_m(middle) <= config.edge_reach_m);
    let steps: Vec<Strip> = near
        .filter_map(|edge| Strip::new(edge, &edge.step?))
        .collect();
    let support = |point: [f64; 2]| {
        let at = in_world(point);
        let Some(ground) = ground.nearest(at) else {
            return match steps.iter().any(|step| is_beyond(step, at, config)) {
                true => Support::Free,
                false => Support::Unknown,
            };
        };
        let gap_m = at[2] - ground.height_m;
        let most_m = config.max_gap_m + config.sigmas * height_sigma_m.hypot(ground.sigma_m);
        match gap_m > most_m {
            true => Support::Free,
            false => Support::Ground(gap_m),
        }
    };
    let points = points(outline_m, config.spacing_m);
    let supports: Vec<Support> = points.iter().map(|point| support(*point)).collect();
    let mut gaps_m: Vec<f64> = supports
        .iter()
        .filter_map(|own| match own {
            Support::Ground(gap_m) => Some(*gap_m),
            _ => None,
        })
        .collect();
    gaps_m.sort_unstable_by(f64::total_cmp);
    let bears =
        |(point, support): (&[f64; 2], &Support)| (*support != Support::Free).then_some(*point);
    let bearing: Vec<[f64; 2]> = points.iter().zip(&supports).filter_map(bears).collect();
    let count = bearing.len();
    let hull = convex_hull(bearing);
    let is_whole = gaps_m.is_empty() || count == points.len() || hull.len() < 3;
    let corners = if is_whole { outline_m } else { &hull };
    ContactPatch {
        outline_m: corners.iter().map(|corner| in_world(*corner)).collect(),
        area_share: match is_whole {
            true => 1.0,
            false => (area(&hull) / area(outline_m).abs()).min(1.0),
        },
        ground_share: gaps_m.len() as f64 / count.max(1) as f64,
        gap_m: gaps_m.get(gaps_m.len() / 2).copied(),
    }
}

/// Whether a point at about the height of the edge of a step is on the lower side of it.
fn is_beyond(step: &Strip, at: [f64; 3], config: &PatchConfig) -> bool {
    let [along, away] = step.coordinates(&Vector3::from(at).xy());
    let ends = -config.edge_margin_m..=step.length_m + config.edge_margin_m;
    let above_m = at[2] - step.height_m(along);
    away > 0.0 && ends.contains(&along) && above_m.abs() <= config.max_edge_height_m
}

/// Points of a polygon on a grid, and on its border.
fn points(outline_m: &[[f64; 2]], spacing_m: f64) -> Vec<[f64; 2]> {
    if outline_m.len() < 3 {
        return Vec::new();
    }
    let range = |k: usize| {
        let values = outline_m.iter().map(|corner| corner[k] / spacing_m);
        let low = values.clone().fold(f64::INFINITY, f64::min).ceil() as i64;
        let high = values.fold(f64::NEG_INFINITY, f64::max).floor() as i64;
        low..=high
    };
    let polygon = Polygon {
        outline: outline_m.to_vec(),
        holes: Vec::new(),
    };
    let grid = range(1).flat_map(|row| range(0).map(move |column| [column, row]));
    let grid = grid.map(|cell| cell.map(|k| k as f64 * spacing_m));
    let inside = grid.filter(|point| polygon.contains(*point));
    let next = outline_m.iter().cycle().skip(1);
    let border = outline_m.iter().zip(next).flat_map(|(a, b)| {
        let length_m = (b[0] - a[0]).hypot(b[1] - a[1]);
        let parts = (length_m / spacing_m).ceil().max(1.0) as usize;
        (0..parts).map(move |part| {
            let share = part as f64 / parts as f64;
            [0, 1].map(|k| a[k] + share * (b[k] - a[k]))
        })
    });
    inside.chain(border).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edges::{EdgeKind, Step};
    use crate::mesh::Mesh;

    const OUTLINE: [[f64; 2]; 4] = [[-0.14, -0.05], [0.14, -0.05], [0.14, 0.05], [-0.14, 0.05]];
    const SIGMA_M: f64 = 0.003;

    /// Squares of 2 cm over 2 m, each level at a height, or a hole.
    fn ground(height: impl Fn(f64, f64) -> Option<f64>) -> Mesh {
        let mut mesh = Mesh::default();
        for cell in 0..100 * 100 {
            let low = [cell % 100, cell / 100].map(|k| -1.0 + 0.02 * f64::from(k));
            let Some(z) = height(low[0] + 0.01, low[1] + 0.01) else {
                continue;
            };
            let first = mesh.positions.len() as u32;
            for [x, y] in [[0.0, 0.0], [0.02, 0.0], [0.02, 0.02], [0.0, 0.02]] {
                let position = [low[0] + x, low[1] + y, z];
                mesh.positions.push(position.map(|v| v as f32));
                mesh.normals.push([0.0, 0.0, 1.0]);
                mesh.colors.push([0; 3]);
                mesh.sigma_m.push(0.003);
                mesh.views.push(3);
            }
            mesh.triangles.push([first, first + 1, first + 2]);
            mesh.triangles.push([first, first + 2, first + 3]);
        }
        mesh
    }

    /// A foot with a heading of 0.6 rad.
    fn foot(x: f64, y: f64, z: f64) -> RigidTransform {
        RigidTransform::from_rotation_vector([0.0, 0.0, 0.6], [x, y, z]).expect("finite")
    }

    fn patch(mesh: &Mesh, place: &RigidTransform) -> ContactPatch {
        let ground = Ground::new(mesh);
        let config = PatchConfig::default();
        contact_patch(&ground, &[], place, &OUTLINE, SIGMA_M, &config)
    }

    fn area_m2(patch: &ContactPatch, place: &RigidTransform) -> f64 {
        let foot_from_world = place.inverse();
        let corners = patch.outline_m.iter().map(|corner| {
            let [x, y, z] = foot_from_world.apply(*corner);
            assert!(z.abs() < 1e-9, "on the sole: {corner:?}");
            [x, y]
        });
        area(&corners.collect::<Vec<_>>())
    }

    #[test]
    fn the_part_beyond_the_edge_of_a_step_hangs_free() {
        // The ground is 17 cm lower from x = 0.1 on.
        let mesh = ground(|x, _| Some(if x < 0.1 { 0.0 } else { -0.17 }));
        // The edge crosses the middle of the sole.
        let place = foot(0.1, 0.2, 0.004);
        let patch = patch(&mesh, &place);
        assert!((patch.area_share - 0.5).abs() < 0.03, "{patch:?}");
        assert!((area_m2(&patch, &place) / 0.028 - patch.area_share).abs() < 1e-6);
        let beyond = patch.outline_m.iter().map(|corner| corner[0] - 0.1);
        let farthest = beyond.fold(f64::NEG_INFINITY, f64::max);
        assert!((-0.005..=0.001).contains(&farthest), "{patch:?}");
        assert_eq!(patch.ground_share, 1.0);
        assert!((patch.gap_m.expect("ground") - 0.004).abs() < 1e-6);
        // Going up the riser is ahead of the toe, and the whole sole bears.
        let above = ground(|x, _| Some(if x < 0.3 { 0.0 } else { 0.17 }));
        let whole = super::tests::patch(&above, &foot(0.1, 0.2, 0.004));
        assert_eq!((whole.outline_m.len(), whole.area_share), (4, 1.0));
    }

    #[test]
    fn ground_that_depth_does_not_show_contradicts_nothing() {
        // A hole below the half with y < 0.2.
        let mesh = ground(|_, y| (y > 0.2).then_some(0.0));
        let place = foot(0.1, 0.2, 0.004);
        let patch = patch(&mesh, &place);
        assert_eq!((patch.outline_m.len(), patch.area_share), (4, 1.0));
        assert!((patch.ground_share - 0.5).abs() < 0.06, "{patch:?}");
        let nothing = super::tests::patch(&ground(|_, _| None), &place);
        assert_eq!((nothing.area_share, nothing.ground_share), (1.0, 0.0));
        assert_eq!(nothing.gap_m, None);
    }

    /// From above no view sees the foot of the riser.
    #[test]
    fn unknown_ground_beyond_the_edge_of_a_step_does_not_bear() {
        let mesh = ground(|x, _| (x < 0.1).then_some(0.0));
        let edge = Edge {
            kind: EdgeKind::End,
            from: [0.1, 1.0, 0.001],
            to: [0.1, -1.0, 0.001],
            sigma_m: 0.005,
            planes: (0, None),
            step: Some(Step {
                below: 1,
                height_m: 0.17,
                sigma_m: 0.002,
                views: 3,
                direction: [1.0, 0.0],
            }),
        };
        let place = foot(0.1, 0.2, 0.004);
        let config = PatchConfig::default();
        let on = Ground::new(&mesh);
        let share =
            |edge: Edge| contact_patch(&on, &[edge], &place, &OUTLINE, SIGMA_M, &config).area_share;
        assert!((share(edge) - 0.5).abs() < 0.03, "{}", share(edge));
        // No step, one of another tread, and one that ends beside the foot.
        assert_eq!(share(Edge { step: None, ..edge }), 1.0);
        let other = [edge.from, edge.to].map(|[x, y, z]| [x, y, z - 0.17]);
        assert_eq!(
            share(Edge {
                from: other[0],
                to: other[1],
                ..edge
            }),
            1.0
        );
        assert_eq!(
            share(Edge {
                to: [0.1, 0.6, 0.0],
                ..edge
            }),
            1.0
        );
    }

    #[test]
    fn a_sole_above_all_ground_that_depth_shows_is_whole() {
        // Grass: depth shows the soil.
        let patch = patch(&ground(|_, _| Some(-0.1)), &foot(0.0, 0.0, 0.0));
        assert_eq!((patch.outline_m.len(), patch.area_share), (4, 1.0));
        assert_eq!((patch.ground_share, patch.gap_m), (0.0, None));
        // The same where it shows half of it.
        let half = ground(|_, y| (y > 0.0).then_some(-0.1));
        let half = super::tests::patch(&half, &foot(0.0, 0.0, 0.0));
        assert_eq!((half.area_share, half.ground_share), (1.0, 0.0));
    }

    #[test]
    fn a_height_within_its_sigmas_is_no_gap() {
        let place = foot(0.0, 0.0, 0.0);
        // 15 mm, and two sigmas of 3 and 3 mm.
        let share = |gap_m: f64| patch(&ground(|_, _| Some(-gap_m)), &place).ground_share;
        assert_eq!((share(0.0234), share(0.0236)), (1.0, 0.0));
        // The sole is below the ground: soft ground.
        assert_eq!(share(-0.03), 1.0);
    }

    #[test]
    fn a_polygon_without_area_has_no_patch() {
        let mesh = ground(|_, _| Some(0.0));
        let ground = Ground::new(&mesh);
        let place = foot(0.0, 0.0, 0.0);
        let config = PatchConfig::default();
        let patch = contact_patch(&ground, &[], &place, &[], SIGMA_M, &config);
        assert!(patch.outline_m.is_empty() && patch.gap_m.is_none());
    }
}
