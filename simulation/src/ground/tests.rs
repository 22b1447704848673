//! Heights across edges, and paths around obstacles.

use counter_random::uniform;

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
