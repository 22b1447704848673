//! Figures of the ground of a scene: how much of it can be walked on, where the recorded path
//! crosses what is not known, and what look-ups, motion and distances cost.
//!
//! `cargo run -p simulation --example ground_figures -- walk.scene`

use std::sync::Arc;
use std::time::Instant;

use counter_random::uniform;
use simulation::testing::SyntheticScene;
use simulation::{
    AgentConfig, AgentState, Cover, DistanceField, Drive, Ground, SceneData, Sector, advance,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let agent = AgentConfig::default();
    let scene = match std::env::args().nth(1) {
        Some(path) => Arc::new(SceneData::open(path.as_ref())?),
        None => SyntheticScene::bridge()?.scene,
    };
    let sector = &scene.sectors[0];
    let levels = sector.levels.as_ref().ok_or("no maps")?;
    let begin = Instant::now();
    let ground = Ground::new(levels.to_vec(), &agent)?;
    println!("ground: {:.1} ms", 1e3 * begin.elapsed().as_secs_f64());
    let free = report_cells(&ground);
    report_path(&ground, sector);
    report_costs(&ground, &agent, &free);
    Ok(())
}

/// Cells by what they are; returns the centers of those where the agent can be.
fn report_cells(ground: &Ground) -> Vec<[f64; 3]> {
    let mut free = Vec::new();
    for (number, level) in ground.levels().iter().enumerate() {
        let cells = level.grid.cells();
        let (mut known, mut occupied, mut walkable) = (0, 0, 0);
        let mut components = std::collections::BTreeMap::<u32, usize>::new();
        for cell in 0..cells {
            let at = level.grid.center_m(cell);
            match ground.cover(at, number) {
                Cover::Free => known += 1,
                Cover::Occupied => occupied += 1,
                Cover::Unknown => {}
            }
            if let Some(component) = ground.component(at, number) {
                walkable += 1;
                *components.entry(component).or_default() += 1;
                free.push([at[0], at[1], f64::from(level.elevation[cell])]);
            }
        }
        let largest = components.values().max().copied().unwrap_or(0);
        println!(
            "level {number}: {}x{} cells of {} m, free {known}, occupied {occupied}, unknown {}, \
             holes {:?}, \
             walkable for the center {walkable} in {} components, largest {largest}",
            level.grid.columns,
            level.grid.rows,
            level.grid.cell_m,
            cells - known - occupied,
            ground.bridges(number),
            components.len()
        );
    }
    free
}

/// Ground below the recorded path, by the height of the rig above it.
fn report_path(ground: &Ground, sector: &Sector) {
    let Some(trajectory) = &sector.recording.trajectory else {
        return;
    };
    let mut runs: Vec<(String, usize, [f64; 3])> = Vec::new();
    for pose in trajectory.poses() {
        let at = pose.world_from_rig.translation_m();
        let below = ground.surface([at[0], at[1]], at[2] - 1.4);
        let what = match below {
            None => "no ground".to_owned(),
            Some(surface) => match ground.block([at[0], at[1]], surface.level) {
                Some(reason) => format!("{reason:?}"),
                None => format!(
                    "free, component {:?}",
                    ground.component([at[0], at[1]], surface.level)
                ),
            },
        };
        match runs.last_mut() {
            Some((last, count, _)) if *last == what => *count += 1,
            _ => runs.push((what, 1, at)),
        }
    }
    for (what, count, at) in runs {
        println!("path: {count} poses from {at:.2?}: {what}");
    }
    for contact in &sector.recording.contacts {
        let at = contact.world_from_foot.translation_m();
        let surface = ground.surface([at[0], at[1]], at[2]);
        println!(
            "contact {:?} at {at:.2?}, {} ns: ground {:?}",
            contact.foot,
            contact.events[0].time_ns,
            surface.map(|s| s.height_m - at[2])
        );
    }
}

fn report_costs(ground: &Ground, agent: &AgentConfig, free: &[[f64; 3]]) {
    const COUNT: u64 = 200_000;
    let places: Vec<[f64; 3]> = (0..COUNT)
        .map(|k| {
            let [x, y, z] = free[(uniform(1, 0, k) * free.len() as f64) as usize];
            [
                x + 0.03 * uniform(1, 1, k) - 0.015,
                y + 0.03 * uniform(1, 2, k) - 0.015,
                z,
            ]
        })
        .collect();
    let per = |name: &str, work: &mut dyn FnMut(usize) -> f64| {
        let mut sum = 0.0;
        let mut best = f64::INFINITY;
        for _ in 0..5 {
            let begin = Instant::now();
            for k in 0..places.len() {
                sum += work(k);
            }
            best = best.min(begin.elapsed().as_secs_f64() / places.len() as f64);
        }
        println!("{name}: {:.0} ns (sum {sum:.3})", 1e9 * best);
    };
    per("surface", &mut |k| {
        let [x, y, z] = places[k];
        ground.surface([x, y], z).map_or(0.0, |s| s.height_m)
    });
    let states: Vec<AgentState> = places
        .iter()
        .enumerate()
        .filter_map(|(k, at)| {
            AgentState::on_ground(ground, agent, *at, 6.0 * uniform(1, 3, k as u64))
        })
        .collect();
    per("advance, 0.1 s at 1.5 m/s", &mut |k| {
        let mut state = states[k % states.len()];
        state.velocity = [1.5, 0.0, 0.5];
        advance(
            ground,
            agent,
            Drive::Differential,
            &state,
            &[1.0, 0.25],
            0.1,
        )
        .distance_m
    });
    let begin = Instant::now();
    let field = DistanceField::new(ground, agent, free[free.len() / 3]);
    println!(
        "distance field: {:.1} ms",
        1e3 * begin.elapsed().as_secs_f64()
    );
    per("distance", &mut |k| {
        field.distance_m(places[k]).unwrap_or(0.0)
    });
}
