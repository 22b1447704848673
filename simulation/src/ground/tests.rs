//! Heights across edges, and paths around obstacles.

use counter_random::uniform;
use scene_bundle::outputs::grid::Grid;
use scene_bundle::outputs::maps::MapLevel;

use super::*;
use crate::geodesic::DistanceField;
use crate::testing::SyntheticScene;

fn ground(scene: &SyntheticScene) -> Ground {
    let levels = scene.scene.sectors[0].levels.as_ref().expect("levels");
    Ground::new(levels.to_vec(), &AgentConfig::default()).expect("ground")
}

#[test]
fn heights_are_not_blended_over_the_edges_of_steps() {
    let scene = SyntheticScene::stairs().expect("a scene");
    let ground = ground(&scene);
    let (mut count, mut wrong) = (0, 0);
    for k in 0..20_000 {
        let at = [6.0 * uniform(1, 0, k), 3.0 * uniform(1, 1, k)];
        let Some((height_m, _)) = scene.surfaces[0].ground(at, 0.6) else {
            continue;
        };
        let Some(surface) = ground.surface(at, height_m) else {
            continue;
        };
        count += 1;
        // A cell that an edge passes belongs to one of both treads; no height is between them.
        let steps = surface.height_m / 0.15;
        assert!((steps - steps.round()).abs() < 0.02, "{at:?}: {surface:?}");
        wrong += usize::from((surface.height_m - height_m).abs() > 0.01);
    }
    assert!(count > 10_000, "{count}");
    // Half of the cells at edges, 4 cm of 30.
    assert!(wrong < count / 10, "{wrong} of {count}");
}

#[test]
fn paths_around_a_corner_are_as_long_as_taut_strings() {
    let scene = SyntheticScene::wall().expect("a scene");
    let ground = ground(&scene);
    let agent = AgentConfig::default();
    let level = &ground.levels()[0];
    // All free cells, and the taut string by a visibility graph over the corners of blocked cells.
    let free: Vec<[f64; 2]> = (0..level.grid.cells())
        .map(|cell| level.grid.center_m(cell))
        .filter(|at| ground.block(*at, 0).is_none())
        .collect();
    let goal = free[free.len() / 7];
    let field = DistanceField::new(&ground, &agent, [goal[0], goal[1], 0.0]);
    let graph = VisibilityGraph::new(&ground, goal);
    let (mut worst, mut detours) = (0.0_f64, 0);
    for k in 0..60 {
        let at = free[(uniform(9, 0, k) * free.len() as f64) as usize];
        let found = field.distance_m([at[0], at[1], 0.0]).expect("a path");
        let expected = graph.distance_m(at);
        let direct = ((at[0] - goal[0]).powi(2) + (at[1] - goal[1]).powi(2)).sqrt();
        if direct < 1.0 {
            continue;
        }
        detours += usize::from(expected > 1.02 * direct);
        worst = worst.max((found - expected) / expected);
        // The graph walks between the centers of cells, too.
        assert!(found > 0.995 * expected, "{found} {expected}");
    }
    assert!(worst <= 0.005 && detours > 5, "{worst} {detours}");
}

#[test]
fn paths_between_many_obstacles_are_as_long_as_taut_strings() {
    let scene = SyntheticScene::tilted_plane([0.0, 0.0]).expect("a scene");
    let levels = scene.scene.sectors[0].levels.as_ref().expect("levels");
    let agent = AgentConfig::default();
    let (mut worst, mut detours) = (0.0_f64, 0);
    for seed in 0..4 {
        let mut levels = levels.to_vec();
        for k in 0..7 {
            let center = [0, 1].map(|axis| 1.0 + 4.0 * uniform(seed, axis, k));
            let half = [2, 3].map(|axis| 0.05 + 0.5 * uniform(seed, axis, k));
            for cell in 0..levels[0].grid.cells() {
                let at = levels[0].grid.center_m(cell);
                if (0..2).all(|k| (at[k] - center[k]).abs() < half[k]) {
                    levels[0].occupancy[cell] = scene_bundle::outputs::maps::OCCUPIED;
                }
            }
        }
        let ground = Ground::new(levels, &agent).expect("ground");
        let grid = ground.levels()[0].grid;
        let free: Vec<[f64; 2]> = (0..grid.cells())
            .map(|cell| grid.center_m(cell))
            .filter(|at| ground.block(*at, 0).is_none())
            .collect();
        let goal = free[free.len() / 9];
        let field = DistanceField::new(&ground, &agent, [goal[0], goal[1], 0.0]);
        let graph = VisibilityGraph::new(&ground, goal);
        for k in 0..60 {
            let at = free[(uniform(seed, 9, k) * free.len() as f64) as usize];
            let expected = graph.distance_m(at);
            let found = field.distance_m([at[0], at[1], 0.0]);
            if ground.component(at, 0) != ground.component(goal, 0) {
                assert_eq!(found, None);
                continue;
            }
            let found = found.expect("a path");
            let direct = length(at, goal);
            if direct < 1.0 {
                continue;
            }
            detours += usize::from(expected > 1.02 * direct);
            worst = worst.max((found - expected) / expected);
            assert!(found > 0.995 * expected, "{found} {expected}");
        }
    }
    assert!(worst <= 0.005 && detours > 20, "{worst} {detours}");
}

/// The columns of a level from one to another.
fn part(level: &MapLevel, columns: std::ops::Range<usize>) -> MapLevel {
    let grid = level.grid;
    let cells: Vec<usize> = (0..grid.cells())
        .filter(|cell| columns.contains(&(cell % grid.columns)))
        .collect();
    let mut part = MapLevel::unknown(Grid {
        origin_m: grid.center_m(columns.start),
        columns: columns.len(),
        ..grid
    });
    let of = |values: &[f32]| cells.iter().map(|cell| values[*cell]).collect();
    part.elevation = of(&level.elevation);
    part.clearance = of(&level.clearance);
    part.distance = of(&level.distance);
    part.sigma = of(&level.sigma);
    part.normal = cells.iter().map(|cell| level.normal[*cell]).collect();
    part.occupancy = cells.iter().map(|cell| level.occupancy[*cell]).collect();
    part.flags = cells.iter().map(|cell| level.flags[*cell]).collect();
    part
}

/// As output `maps` divides levels that are mostly empty.
#[test]
fn levels_that_overlap_are_one_ground() {
    for scene in [
        SyntheticScene::wall(),
        SyntheticScene::stairs(),
        SyntheticScene::room(),
    ] {
        let scene = scene.expect("a scene");
        let whole = ground(&scene);
        let level = &whole.levels()[0];
        let columns = level.grid.columns;
        let middle = columns / 2;
        // In both orders, with 1 m in common.
        let left = part(level, 0..middle + 13);
        let right = part(level, middle - 12..columns);
        for parts in [vec![left.clone(), right.clone()], vec![right, left]] {
            let divided = Ground::new(parts, &AgentConfig::default()).expect("ground");
            let mut components = std::collections::BTreeMap::new();
            for cell in 0..level.grid.cells() {
                let at = level.grid.center_m(cell);
                let height_m = f64::from(level.elevation[cell]);
                let expected = whole.surface(at, height_m);
                let found = divided.surface(at, height_m);
                assert_eq!(expected.is_some(), found.is_some(), "{at:?}");
                let Some((expected, found)) = expected.zip(found) else {
                    continue;
                };
                let difference_m = found.height_m - expected.height_m;
                assert!(difference_m.abs() < 1e-6, "{at:?}: {difference_m}");
                let block = whole.block(at, expected.level);
                assert_eq!(block, divided.block(at, found.level), "{at:?}");
                let own = whole.component(at, expected.level);
                let other = divided.component(at, found.level);
                assert_eq!(*components.entry(own).or_insert(other), other, "{at:?}");
            }
        }
    }
}

/// Level ground of 6 m with a hole of some cells from 2 m, 2 m on.
fn with_hole(size: [usize; 2], change: impl Fn(&mut MapLevel, usize)) -> Ground {
    let scene = SyntheticScene::tilted_plane([0.1, 0.0]).expect("a scene");
    let mut levels = scene.scene.sectors[0]
        .levels
        .as_ref()
        .expect("levels")
        .to_vec();
    let grid = levels[0].grid;
    let first = grid.cell([2.0, 2.0]).expect("a cell");
    for row in 0..size[1] {
        for column in 0..size[0] {
            change(&mut levels[0], first + row * grid.columns + column);
        }
    }
    Ground::new(levels, &AgentConfig::default()).expect("ground")
}

fn forget(level: &mut MapLevel, cell: usize) {
    level.occupancy[cell] = scene_bundle::outputs::maps::UNKNOWN;
    level.flags[cell] = 0;
    level.elevation[cell] = f32::NAN;
}

#[test]
fn small_holes_are_bridged_by_the_plane_of_their_rim_and_marked() {
    let whole = with_hole([0, 0], forget);
    assert_eq!(whole.bridges(0), (0, 0));
    let cell_m = whole.levels()[0].grid.cell_m;
    let most = (AgentConfig::default().max_hole_m2 / (cell_m * cell_m)) as usize;
    let bridged = with_hole([5, most / 5], forget);
    assert_eq!(bridged.bridges(0), (1, most / 5 * 5));
    let at = [2.0 + 1.5 * cell_m, 2.0 + 2.5 * cell_m];
    let surface = bridged.surface(at, 0.2).expect("a bridge");
    let before = whole.surface(at, 0.2).expect("ground");
    assert!(surface.is_filled && !before.is_filled);
    assert!(
        (surface.height_m - before.height_m).abs() < 0.002,
        "{surface:?} {before:?}"
    );
    assert_eq!(
        (bridged.block(at, 0), bridged.cover(at, 0)),
        (None, Cover::Unknown)
    );
    // Larger, at an obstacle, over a step: not.
    let large = with_hole([5, most / 5 + 1], forget);
    let beside_obstacle = with_hole([3, 3], |level, cell| {
        forget(level, cell);
        level.occupancy[cell + 3] = scene_bundle::outputs::maps::OCCUPIED;
    });
    let over_step = with_hole([3, 3], |level, cell| {
        forget(level, cell);
        for beyond in cell + 3..cell + 6 {
            level.elevation[beyond] += 0.4;
        }
    });
    for ground in [large, beside_obstacle, over_step] {
        assert_eq!(ground.bridges(0), (0, 0));
        assert_eq!(ground.surface(at, 0.2), None);
        assert!(ground.block(at, 0).is_some());
    }
}

/// Shortest paths over the free cells at convex corners of what blocks the agent.
struct VisibilityGraph<'a> {
    ground: &'a Ground,
    nodes: Vec<[f64; 2]>,
    left_m: Vec<f64>,
}

impl<'a> VisibilityGraph<'a> {
    fn new(ground: &'a Ground, goal: [f64; 2]) -> Self {
        let grid = ground.levels()[0].grid;
        let is_free = |at: [f64; 2]| ground.block(at, 0).is_none();
        let mut nodes = vec![goal];
        for cell in 0..grid.cells() {
            let at = grid.center_m(cell);
            let step = |x: f64, y: f64| [at[0] + x * grid.cell_m, at[1] + y * grid.cell_m];
            let corner = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)]
                .iter()
                .any(|(x, y)| {
                    !is_free(step(*x, *y)) && is_free(step(*x, 0.0)) && is_free(step(0.0, *y))
                });
            if is_free(at) && corner {
                nodes.push(at);
            }
        }
        let mut graph = Self {
            ground,
            left_m: vec![f64::INFINITY; nodes.len()],
            nodes,
        };
        graph.left_m[0] = 0.0;
        let mut is_closed = vec![false; graph.nodes.len()];
        while let Some(best) = (0..graph.nodes.len())
            .filter(|node| !is_closed[*node] && graph.left_m[*node].is_finite())
            .min_by(|a, b| graph.left_m[*a].total_cmp(&graph.left_m[*b]))
        {
            is_closed[best] = true;
            for (to, is_closed) in is_closed.iter().enumerate() {
                let (a, b) = (graph.nodes[best], graph.nodes[to]);
                if !is_closed && graph.sees(a, b) {
                    let along = graph.left_m[best] + length(a, b);
                    graph.left_m[to] = graph.left_m[to].min(along);
                }
            }
        }
        graph
    }

    fn distance_m(&self, from: [f64; 2]) -> f64 {
        let nodes = self.nodes.iter().zip(&self.left_m);
        let seen = nodes.filter(|(node, _)| self.sees(from, **node));
        seen.map(|(node, left)| left + length(from, *node))
            .fold(f64::INFINITY, f64::min)
    }

    fn sees(&self, a: [f64; 2], b: [f64; 2]) -> bool {
        let steps = (length(a, b) / 0.002).ceil() as usize;
        (0..=steps).all(|k| {
            let share = k as f64 / steps.max(1) as f64;
            let at = [0, 1].map(|i| a[i] + share * (b[i] - a[i]));
            self.ground.block(at, 0).is_none()
        })
    }
}

fn length(a: [f64; 2], b: [f64; 2]) -> f64 {
    ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt()
}

#[test]
fn what_is_no_ground_is_refused() {
    let agent = AgentConfig::default();
    let error = Ground::new(Vec::new(), &agent).expect_err("no level");
    assert!(error.to_string().contains("found no level"), "{error}");
    let scene = SyntheticScene::wall().expect("a scene");
    let mut levels = scene.scene.sectors[0]
        .levels
        .as_ref()
        .expect("levels")
        .to_vec();
    levels[0].normal.pop();
    let error = Ground::new(levels.clone(), &agent).expect_err("a short layer");
    assert!(
        error.to_string().contains("another number of cells"),
        "{error}"
    );
    let agent = AgentConfig {
        radius_m: f64::NAN,
        ..agent
    };
    let error = Ground::new(levels, &agent).expect_err("no size");
    assert!(
        error.to_string().starts_with("agent.radius_m: found NaN"),
        "{error}"
    );
}
