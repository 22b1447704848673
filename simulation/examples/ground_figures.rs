//! Figures of the ground of a scene: how much of it can be walked on, where the recorded path
//! crosses what is not known, and what look-ups, motion and distances cost
//! (processor time, the least of five runs).
//!
//! `cargo run -p simulation --example ground_figures -- walk.scene`

use std::sync::Arc;

use counter_random::uniform;
use simulation::testing::SyntheticScene;
use simulation::{
    AgentConfig, AgentState, Cover, DistanceField, Drive, Ground, Playback, SceneData, Sector,
    advance,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let agent = AgentConfig::default();
    let scene = match std::env::args().nth(1) {
        Some(path) => Arc::new(SceneData::open(path.as_ref())?),
        None => SyntheticScene::bridge()?.scene,
    };
    let sector = &scene.sectors[0];
    let levels = sector.levels.as_ref().ok_or("no maps")?;
    let begin_s = processor_s();
    let ground = Ground::new(levels.to_vec(), &agent)?;
    println!("ground: {:.1} ms", 1e3 * (processor_s() - begin_s));
    let free = report_cells(&ground);
    report_path(&ground, sector);
    report_follower(&ground, &agent, sector);
    report_costs(&ground, &agent, &free);
    Ok(())
}

/// Processor time of this thread, s: the first number of its schedstat, ns. 0 where there is none.
fn processor_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let first = text.split_whitespace().next();
    1e-9 * first.and_then(|ns| ns.parse().ok()).unwrap_or(0.0)
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
    let contacts = &sector.recording.contacts;
    let off_m: Vec<f64> = contacts
        .iter()
        .filter_map(|contact| {
            let [x, y, z] = contact.world_from_foot.translation_m();
            Some((ground.surface([x, y], z)?.height_m - z).abs())
        })
        .collect();
    println!(
        "contacts: {} of {} have ground below, at most {:.4} m from it",
        off_m.len(),
        contacts.len(),
        off_m.iter().copied().fold(0.0, f64::max)
    );
}

/// An agent that goes after the wearer from the first place with ground: how far it comes.
fn report_follower(ground: &Ground, agent: &AgentConfig, sector: &Sector) {
    let Some(trajectory) = &sector.recording.trajectory else {
        return;
    };
    let playback = Playback::new(trajectory.clone(), sector.recording.contacts.clone());
    let Some([first_ns, last_ns]) = playback.range_ns() else {
        return;
    };
    const STEP_NS: i64 = 50_000_000;
    let mut state: Option<AgentState> = None;
    let (mut length_m, mut filled, mut steps, mut stops) = (0.0, 0, 0, 0);
    let (mut pitch_rad, mut off_ground) = (0.0_f64, 0);
    for time_ns in (first_ns..last_ns).step_by(STEP_NS as usize) {
        let Some(now) = state else {
            state = playback.state(ground, agent, time_ns);
            if let Some(state) = state {
                let late_s = 1e-9 * (time_ns - first_ns) as f64;
                println!(
                    "follower: begins at {:.2?}, {late_s:.2} s",
                    state.position_m
                );
            }
            continue;
        };
        let Some(target) = playback.at(time_ns + STEP_NS) else {
            continue;
        };
        let to = target.world_from_rig.translation_m();
        let off = [to[0] - now.position_m[0], to[1] - now.position_m[1]];
        let (sine, cosine) = now.yaw_rad.sin_cos();
        let scale = 1.0 / (1e-9 * STEP_NS as f64) / agent.max_speed_m_s;
        let action = [
            (off[0] * cosine + off[1] * sine) * scale,
            (off[1] * cosine - off[0] * sine) * scale,
            0.0,
        ];
        let motion = advance(ground, agent, Drive::Holonomic, &now, &action, 0.05);
        steps += 1;
        stops += usize::from(motion.blocked.is_some());
        length_m += motion.distance_m;
        let [x, y, z] = motion.state.position_m;
        filled += usize::from(ground.surface([x, y], z).is_some_and(|s| s.is_filled));
        pitch_rad = pitch_rad.max(motion.state.pitch_rad.abs());
        off_ground += usize::from(!motion.state.is_on_ground);
        state = Some(motion.state);
    }
    let end = state.map(|state| state.position_m);
    println!(
        "follower: {steps} steps, {length_m:.2} m of {:.2} m, stopped in {stops}, on filled ground \
         in {filled}, not on the ground in {off_ground}, pitch at most {pitch_rad:.3} rad, \
         ends at {end:.2?}",
        trajectory.path_length_m()
    );
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
            let begin_s = processor_s();
            for k in 0..places.len() {
                sum += work(k);
            }
            best = best.min((processor_s() - begin_s) / places.len() as f64);
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
    let begin_s = processor_s();
    let field = DistanceField::new(ground, agent, free[free.len() / 3]);
    println!("distance field: {:.1} ms", 1e3 * (processor_s() - begin_s));
    per("distance", &mut |k| {
        field.distance_m(places[k]).unwrap_or(0.0)
    });
}
