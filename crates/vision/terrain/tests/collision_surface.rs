//! What slides over the collision surface, which is the higher one of parts and layer, finds no
//! ditch and no hole.

mod ground;
mod outlines;

use ground::{Border, CELL_M, Ground, Place, Surface, resting};
use outlines::{plane, riser, tread};
use terrain::ConvexConfig;
use terrain::edges::EdgeKind;

const RISE_M: f64 = 0.17;
const GOING_M: f64 = 0.29;
const STEPS: usize = 4;
/// Half the width of stairs and kerb, m.
const HALF_M: f64 = 1.0;
const KERB_M: f64 = 0.12;
/// Rounding, and borders of planes of cells of 1 cm.
const SLACK_M: f64 = 0.001;
/// Radius of a foot, m.
const FOOT_M: f64 = 0.022;

/// Along the axes of the world and not.
const PLACES: [Place; 3] = [
    Place {
        yaw_rad: 0.0,
        offset: [0.013, 0.007],
    },
    Place {
        yaw_rad: 0.4,
        offset: [31.02, -17.3],
    },
    Place {
        yaw_rad: -2.1,
        offset: [-4.0, 8.015],
    },
];

fn all_known(_: f64, _: f64) -> bool {
    true
}

/// Places along a straight line, 5 mm apart.
fn line(from: [f64; 2], to: [f64; 2]) -> impl Iterator<Item = [f64; 2]> {
    let count = ((to[0] - from[0]).hypot(to[1] - from[1]) / 0.005) as usize;
    (0..=count).map(move |i| [0, 1].map(|k| from[k] + (to[k] - from[k]) * i as f64 / count as f64))
}

/// Errors of the surface along a line: places and heights above the true ground.
fn errors(
    surface: &Surface,
    truth: fn(f64, f64) -> f64,
    along: impl Iterator<Item = [f64; 2]>,
) -> Vec<([f64; 2], f64)> {
    let error = |at: [f64; 2]| {
        let expected = truth(at[0], at[1]);
        let found = surface.height(at, expected);
        (
            at,
            found.unwrap_or_else(|| panic!("no surface at {at:?}")) - expected,
        )
    };
    along.map(error).collect()
}

/// Asserts a bound for all errors, and gives the least one.
fn least_within(bound: f64, errors: Vec<([f64; 2], f64)>) -> f64 {
    for (at, error) in &errors {
        assert!(error.abs() <= bound, "{error} at {at:?}");
    }
    errors.iter().map(|(_, error)| *error).fold(0.0, f64::min)
}

fn stairs_height(x: f64, _: f64) -> f64 {
    (x / GOING_M).ceil().clamp(0.0, STEPS as f64) * RISE_M
}

/// Distance from the nearest riser.
fn from_riser(x: f64) -> f64 {
    let nearest = (x / GOING_M).round().clamp(0.0, (STEPS - 1) as f64);
    (x - nearest * GOING_M).abs()
}

/// Stairs along x with all treads and risers; the foot of each riser is an edge if `has_feet`.
fn stairs(place: Place, has_feet: bool) -> Ground {
    let mut planes = vec![tread(0.0, [[-1.0, -HALF_M], [0.0, HALF_M]])];
    let mut edges = Vec::new();
    for step in 0..STEPS {
        let (x, low, high) = (
            step as f64 * GOING_M,
            step as f64 * RISE_M,
            (step + 1) as f64 * RISE_M,
        );
        let end = if step + 1 == STEPS {
            x + 1.0
        } else {
            x + GOING_M
        };
        let (of_riser, of_tread) = (planes.len() as u32, planes.len() as u32 + 1);
        planes.push(riser(x, [-HALF_M, HALF_M], [low, high]));
        planes.push(tread(high, [[x, -HALF_M], [end, HALF_M]]));
        let ends = |z: f64| [[x, -HALF_M, z], [x, HALF_M, z]];
        edges.push(Border {
            kind: EdgeKind::Convex,
            ends: ends(high),
            planes: (of_tread, Some(of_riser)),
        });
        if has_feet {
            edges.push(Border {
                kind: EdgeKind::Concave,
                ends: ends(low),
                planes: (of_riser - 1, Some(of_riser)),
            });
        }
    }
    Ground {
        place,
        height: stairs_height,
        is_known: all_known,
        planes,
        edges,
        extent: [
            [-1.0, -HALF_M],
            [(STEPS - 1) as f64 * GOING_M + 1.0, HALF_M],
        ],
    }
}

#[test]
fn stairs_are_steep_at_their_risers_and_level_between_them() {
    let config = ConvexConfig::default();
    for (place, has_feet) in PLACES
        .into_iter()
        .flat_map(|own| [(own, true), (own, false)])
    {
        let surface = stairs(place, has_feet).collision(&config);
        let end = (STEPS - 1) as f64 * GOING_M + 0.9;
        for y in [-0.8, -0.31, 0.0, 0.02, 0.77] {
            let all = errors(&surface, stairs_height, line([-0.9, y], [end, y]));
            for (at, error) in all {
                if from_riser(at[0]) > 0.01 {
                    assert!(
                        error.abs() <= config.layer_seam_m + SLACK_M,
                        "{error} at {at:?}"
                    );
                } else {
                    assert!(
                        error.abs() <= RISE_M + config.layer_seam_m,
                        "{error} at {at:?}"
                    );
                }
            }
        }
        let report = &surface.collision.report;
        println!("{report:?}");
        assert!(report.height_errors.p95_m <= SLACK_M, "{report:?}");
        assert!(report.parts_per_100_m2 <= 500.0, "{report:?}");
    }
}

/// A plane that rises by 5 degrees with ground around it that bends away from it.
fn border_height(x: f64, y: f64) -> f64 {
    let outside = |v: f64| (v.abs() - 0.8).max(0.0);
    let away = outside(x).hypot(outside(y));
    0.0875 * x - 0.05 * away + 0.02 * away * (9.0 * x).sin() * (8.0 * y).cos()
}

#[test]
fn no_ditch_is_at_the_border_of_a_plane() {
    let config = ConvexConfig::default();
    for place in PLACES {
        let slope = f64::hypot(1.0, 0.0875);
        let axes = [[1.0 / slope, 0.0, 0.0875 / slope], [0.0, 1.0, 0.0]];
        let x = 0.8 * slope;
        let corners = [[-x, -0.8], [x, -0.8], [x, 0.8], [-x, 0.8]];
        let ground = Ground {
            place,
            height: border_height,
            is_known: all_known,
            planes: vec![plane([0.0; 3], axes, &corners)],
            edges: Vec::new(),
            extent: [[-1.5, -1.5], [1.5, 1.5]],
        };
        let surface = ground.collision(&config);
        assert_eq!(surface.collision.parts.len(), 1);
        let mut deepest = 0.0f64;
        for v in [-0.79, -0.61, 0.0, 0.4, 0.795] {
            let lines = [line([-1.4, v], [1.4, v]), line([v, -1.4], [v, 1.4])];
            for at in lines.into_iter().flatten() {
                let truth = |at: [f64; 2]| border_height(at[0], at[1]);
                let foot = surface
                    .foot_height(at, FOOT_M, truth(at))
                    .expect("a surface");
                let expected = resting(at, FOOT_M, |at| Some(truth(at))).expect("the truth");
                assert!(
                    foot - expected >= -config.layer_seam_m - SLACK_M,
                    "{foot} at {at:?}"
                );
                let error = surface.height(at, truth(at)).expect("a surface") - truth(at);
                assert!(
                    error.abs() <= config.layer_seam_m + SLACK_M,
                    "{error} at {at:?}"
                );
                deepest = deepest.max(-error);
            }
        }
        // The seam itself is there: the test sees the border.
        assert!(deepest >= 0.5 * config.layer_seam_m, "{deepest}");
        let report = &surface.collision.report;
        println!("at the border {} m, {report:?}", -deepest);
        assert!(
            report.height_errors.max_m <= config.layer_seam_m + SLACK_M,
            "{report:?}"
        );
        assert!(
            report.volume_missing_m3 <= 1e-3 && report.volume_added_m3 <= 1e-3,
            "{report:?}"
        );
    }
}

fn kerb_height(x: f64, _: f64) -> f64 {
    if x > 0.0 { KERB_M } else { 0.0 }
}

/// A road, and a pavement of which only the middle is on a plane.
fn kerb(place: Place) -> Ground {
    Ground {
        place,
        height: kerb_height,
        is_known: all_known,
        planes: vec![
            tread(0.0, [[-1.0, -HALF_M], [0.0, HALF_M]]),
            tread(KERB_M, [[0.0, -0.5], [1.0, 0.5]]),
        ],
        edges: vec![Border {
            kind: EdgeKind::End,
            ends: [[0.0, -HALF_M, KERB_M], [0.0, HALF_M, KERB_M]],
            planes: (1, None),
        }],
        extent: [[-1.0, -HALF_M], [1.0, HALF_M]],
    }
}

#[test]
fn a_kerb_is_as_steep_as_its_part_and_else_a_slope_of_a_cell() {
    let config = ConvexConfig::default();
    let seam = config.layer_seam_m + SLACK_M;
    let diagonal = CELL_M * f64::sqrt(2.0);
    for place in PLACES {
        let surface = kerb(place).collision(&config);
        for y in [-0.9, -0.7, -0.42, 0.0, 0.33, 0.8] {
            let is_part = f64::abs(y) < 0.5;
            // Off the part the step is a slope, hardly on the road and a cell wide on the pavement.
            let reach = match is_part {
                true => [0.01; 2],
                false => [config.max_smear_m, diagonal],
            };
            for (at, error) in errors(&surface, kerb_height, line([-0.9, y], [0.9, y])) {
                let bound = if at[0] < -reach[0] || at[0] > reach[1] {
                    seam
                } else {
                    KERB_M + seam
                };
                assert!(error.abs() <= bound, "{error} at {at:?}");
            }
        }
        // Along the kerb, across both ends of the part, and below it.
        let mut least = 0.0f64;
        for x in [0.06, 0.1, 0.5, 0.93, -0.93, -0.3, -0.06] {
            let along = line([x, -0.9], [x, 0.9]);
            least = least.min(least_within(seam, errors(&surface, kerb_height, along)));
        }
        println!("beside the kerb {least} m");
    }
}

fn flat(_: f64, _: f64) -> f64 {
    0.0
}

/// The deepest place below flat ground along lines across its parts, m; more than the seam fails.
fn least_across(surface: &Surface, config: &ConvexConfig) -> f64 {
    let across = |y: f64| errors(surface, flat, line([-0.9, y], [0.9, y]));
    [-0.8, -0.01, 0.5]
        .map(|y| least_within(config.layer_seam_m + SLACK_M, across(y)))
        .into_iter()
        .fold(0.0, f64::min)
}

/// Two parts of a plane with ground between them that is on none.
#[test]
fn a_gap_between_parts_is_filled_by_the_layer() {
    let config = ConvexConfig::default();
    for place in PLACES {
        let ground = Ground {
            place,
            height: flat,
            is_known: all_known,
            planes: vec![
                tread(0.0, [[-1.0, -HALF_M], [-0.015, HALF_M]]),
                tread(0.0, [[0.015, -HALF_M], [1.0, HALF_M]]),
            ],
            edges: Vec::new(),
            extent: [[-1.0, -HALF_M], [1.0, HALF_M]],
        };
        let surface = ground.collision(&config);
        let least = least_across(&surface, &config);
        println!("in the gap {least} m");
    }
}

/// Depth shows the ground up to the border of a part, which is of a plane that was seen beyond it.
#[test]
fn no_hole_is_between_a_part_and_the_known_ground_beside_it() {
    let config = ConvexConfig::default();
    for place in PLACES {
        let ground = Ground {
            place,
            height: flat,
            is_known: |x, _| x > -0.05,
            planes: vec![tread(0.0, [[-1.0, -HALF_M], [0.0, HALF_M]])],
            edges: Vec::new(),
            extent: [[-1.0, -HALF_M], [1.0, HALF_M]],
        };
        let surface = ground.collision(&config);
        let least = least_across(&surface, &config);
        println!("beside the part {least} m");
        // Away from known ground it is the part alone that stands for it.
        let layer = &surface.collision.layers[0];
        let [x, y] = place.world([-0.5, 0.0]);
        assert_eq!(layer.height_at(x, y), None);
    }
}
