//! A step whose riser no view saw: the matcher's ramp below it is neither in maps nor in parts.

mod outlines;

use outlines::{plane, riser, tread};
use terrain::convex::{Collision, collision_parts};
use terrain::edges::{Edge, EdgeKind, Step, without_ramps};
use terrain::mesh::Mesh;
use terrain::planes::{Plane, PlaneOutline, Planes};
use terrain::{ConvexConfig, PlaneConfig, RampConfig};

const RISE_M: f64 = 0.17;
const RUN_M: f64 = 0.12;
const HALF_M: f64 = 0.5;
const UPPER: u32 = 0;
const LOWER: u32 = 1;
const RAMP: u32 = 2;

/// Ground above and, from where views see it, below a step down along x, and the ramp between.
fn outlines() -> Vec<PlaneOutline> {
    let length = RUN_M.hypot(RISE_M);
    let down = [RUN_M / length, 0.0, -RISE_M / length];
    let corners = [
        [0.0, -HALF_M],
        [length, -HALF_M],
        [length, HALF_M],
        [0.0, HALF_M],
    ];
    vec![
        tread(RISE_M, [[-0.4, -HALF_M], [0.0, HALF_M]]),
        tread(0.0, [[RUN_M, -HALF_M], [0.6, HALF_M]]),
        plane([0.0, 0.0, RISE_M], [down, [0.0, 1.0, 0.0]], &corners),
    ]
}

fn planes(outlines: &[PlaneOutline]) -> Planes {
    let config = PlaneConfig::default();
    let planes = outlines.iter().map(|own| Plane::of_outline(own, &config));
    Planes {
        planes: planes.collect(),
        ..Planes::default()
    }
}

fn edge(kind: EdgeKind, other: Option<u32>, y: [f64; 2]) -> Edge {
    Edge {
        kind,
        from: [0.0, y[0], RISE_M],
        to: [0.0, y[1], RISE_M],
        sigma_m: 0.005,
        planes: (UPPER, other),
        step: Some(Step {
            below: LOWER,
            height_m: RISE_M,
            sigma_m: 0.002,
            views: 3,
            direction: [1.0, 0.0],
        }),
    }
}

fn end() -> Edge {
    edge(EdgeKind::End, None, [-0.4, 0.4])
}

fn leaning() -> Edge {
    edge(EdgeKind::Convex, Some(RAMP), [-0.4, 0.4])
}

/// The far end of the ground below: planes without edges have no parts.
fn far_end() -> Edge {
    Edge {
        from: [0.6, -0.4, 0.0],
        to: [0.6, 0.4, 0.0],
        planes: (LOWER, None),
        step: None,
        ..end()
    }
}

/// A mesh of points alone.
fn mesh(positions: &[[f64; 3]]) -> Mesh {
    let count = positions.len();
    Mesh {
        positions: positions.iter().map(|x| x.map(|v| v as f32)).collect(),
        normals: vec![[0.6, 0.0, 0.8]; count],
        colors: vec![[0; 3]; count],
        sigma_m: vec![0.02; count],
        views: vec![3; count],
        triangles: Vec::new(),
    }
}

#[test]
fn a_plane_below_a_step_where_depths_end_is_a_ramp() {
    let mut planes = planes(&outlines());
    planes.of_vertex = vec![Some(RAMP)];
    // Vertices of planes that are no ramps remain.
    let is_ramp = |edges: &[Edge]| {
        let mesh = mesh(&[[0.06, 0.1, 0.085]]);
        let found = without_ramps(&mesh, &planes, edges, &RampConfig::default());
        found.positions != mesh.positions
    };
    assert!(is_ramp(&[end()]));
    assert!(!is_ramp(&[]));
    // A leaning riser is one, unless depths end at another step of its flight.
    assert!(!is_ramp(&[leaning()]));
    let mut other = end();
    other.from[0] -= 0.29;
    other.to[0] -= 0.29;
    assert!(is_ramp(&[leaning(), other]));
    other.step = other.step.map(|step| Step {
        direction: [0.0, 1.0],
        ..step
    });
    assert!(!is_ramp(&[leaning(), other]), "of another flight");
}

#[test]
fn vertices_of_ramps_are_on_the_ground_below() {
    let mut planes = planes(&outlines());
    let points = [
        ([0.06, 0.1, 0.085], Some(RAMP)),
        ([0.10, 0.0, 0.02], None),
        // Beside the ends of the edge, where both planes go on.
        ([0.06, 0.45, 0.085], None),
        // At the foot of the step.
        ([0.02, 0.0, 0.12], None),
        // The border of the ground above is too wide.
        ([0.03, 0.0, 0.17], Some(UPPER)),
        // No ramps: a thing on the ground below, ground above and below, and beyond both planes.
        ([0.12, 0.0, 0.16], None),
        ([-0.03, 0.0, 0.17], Some(UPPER)),
        ([0.15, 0.0, 0.0], Some(LOWER)),
        ([0.06, 0.6, 0.085], None),
    ];
    planes.of_vertex = points.iter().map(|(_, plane)| *plane).collect();
    let config = RampConfig::default();
    let positions = points.map(|(x, _)| x);
    let mesh = mesh(&positions);
    let lowered = without_ramps(&mesh, &planes, &[end()], &config);
    let expected = [
        [0.06, 0.1, 0.0],
        [0.10, 0.0, 0.0],
        [0.06, 0.45, 0.0],
        [config.min_run_m, 0.0, 0.0],
        [0.0, 0.0, 0.17],
    ];
    let expected = expected.iter().chain(&positions[5..]);
    for (found, expected) in lowered.positions.iter().zip(expected) {
        for k in 0..3 {
            let away = f64::from(found[k]) - expected[k];
            assert!(away.abs() < 1e-6, "{found:?}, expected {expected:?}");
        }
    }
    assert_eq!(lowered.normals[0], [0.0, 0.0, 1.0]);
    assert!(lowered.sigma_m[0] < 0.01 && lowered.sigma_m[5] == mesh.sigma_m[5]);
    let still = without_ramps(&mesh, &planes, &[], &config);
    assert_eq!(still.positions, mesh.positions);
}

fn parts(outlines: &[PlaneOutline], edges: &[Edge]) -> Collision {
    collision_parts(&planes(outlines), edges, &[], &ConvexConfig::default())
}

/// Least and greatest coordinates of the surfaces of the parts of a plane.
fn range(collision: &Collision, plane: u32, k: usize) -> [f64; 2] {
    let own = collision.parts.iter().filter(|part| part.plane == plane);
    let values = own.flat_map(|part| &part.vertices[..part.vertices.len() / 2]);
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| {
        [low.min(x[k]), high.max(x[k])]
    })
}

#[test]
fn ground_below_reaches_to_the_foot_of_the_step() {
    let outlines = outlines();
    let without = parts(&outlines, &[]);
    assert!(
        without.parts.iter().all(|part| part.plane != RAMP),
        "it is small"
    );
    let as_riser = parts(&outlines, &[leaning(), far_end()]);
    assert!(as_riser.parts.iter().any(|part| part.plane == RAMP));
    let found = parts(&outlines, &[end(), leaning(), far_end()]);
    assert!(found.parts.iter().all(|part| part.plane != RAMP));
    let [low, high] = range(&found, LOWER, 0);
    assert!(
        low.abs() < 0.011 && (high - 0.6).abs() < 0.011,
        "{low} to {high}"
    );
    let [low, _] = range(&as_riser, LOWER, 0);
    assert!((low - RUN_M).abs() < 0.011, "{low}");
    let [_, high] = range(&found, UPPER, 0);
    assert!(high.abs() < 1e-6, "{high}");
}

#[test]
fn risers_end_at_the_ground_above_them() {
    let config = ConvexConfig::default();
    let mut outlines = outlines();
    let top = |above: f64, outlines: &mut Vec<PlaneOutline>| {
        // A riser that faces down the step, observed from its foot to above the tread.
        let mut own = riser(0.02, [-HALF_M, HALF_M], [0.0, RISE_M + above]);
        own.axes = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        own.normal = [1.0, 0.0, 0.0];
        outlines.truncate(2);
        outlines.push(own);
        let foot = Edge {
            kind: EdgeKind::Concave,
            from: [0.02, -0.4, 0.0],
            to: [0.02, 0.4, 0.0],
            planes: (LOWER, Some(RAMP)),
            step: None,
            ..end()
        };
        let found = parts(outlines, &[end(), foot]);
        range(&found, RAMP, 2)[1]
    };
    let cut = top(0.04, &mut outlines);
    assert!((cut - RISE_M + config.layer_seam_m).abs() < 1e-6, "{cut}");
    // A wall that goes on is no riser.
    let whole = top(0.3, &mut outlines);
    assert!(whole > RISE_M + 0.28, "{whole}");
}
