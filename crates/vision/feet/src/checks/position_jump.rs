//! Jumps in positions of the rig themselves, where no foot at rest shows them.
//!
//! Contract: a person accelerates smoothly; a jump between two positions is two opposite
//! accelerations one after the other. What recurs with the steps of a person who runs is none.
//! Positions at regular times only say something.

use nalgebra::Vector3;

use crate::config::JumpConfig;

/// A position of the rig at a time: s and m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigPosition {
    /// The time, s.
    pub time_s: f64,
    /// The position in the world, m.
    pub position: [f64; 3],
}

/// Times of the positions after jumps, s, and sizes of these, m.
pub fn position_jumps(positions: &[RigPosition], config: &JumpConfig) -> Vec<[f64; 2]> {
    let sizes: Vec<Option<f64>> = positions.windows(4).map(size).collect();
    let mut usual: Vec<f64> = sizes.iter().flatten().copied().collect();
    usual.sort_by(f64::total_cmp);
    let Some(median) = usual.get(usual.len() / 2) else {
        return Vec::new();
    };
    let least = (config.usual_factor * median).max(config.min_position_m);
    let mut found: Vec<[f64; 2]> = Vec::new();
    for (k, (own, size)) in positions.windows(4).zip(&sizes).enumerate() {
        let Some(size) = size.filter(|size| *size > least) else {
            continue;
        };
        let largest = others(positions, &sizes, k, config).fold(0.0, f64::max);
        if size < config.alone_factor * largest {
            continue;
        }
        // The middle interval of the four; those beside it show the same jump.
        let [time_s, last_s] = [own[2].time_s, own[0].time_s];
        match found.last_mut() {
            Some(last) if last[0] >= last_s => {
                if size > last[1] {
                    *last = [time_s, size];
                }
            }
            _ => found.push([time_s, size]),
        }
    }
    found
}

/// Sizes within a time before and after those of four positions, of positions that have none of
/// these.
fn others<'a>(
    positions: &'a [RigPosition],
    sizes: &'a [Option<f64>],
    k: usize,
    config: &'a JumpConfig,
) -> impl Iterator<Item = f64> + 'a {
    let is_near = move |other: &usize| {
        (positions[*other].time_s - positions[k].time_s).abs() < config.alone_s
    };
    let before = (0..(k + 1).saturating_sub(4)).rev().take_while(is_near);
    let after = (k + 4..sizes.len()).take_while(is_near);
    before.chain(after).filter_map(|other| sizes[other])
}

/// Size of a jump in the middle of four positions.
fn size(positions: &[RigPosition]) -> Option<f64> {
    let of = |k: usize| Vector3::from(positions[k].position);
    let intervals = [0, 1, 2].map(|k: usize| positions[k + 1].time_s - positions[k].time_s);
    let is_regular = |interval: &f64| (interval / intervals[1] - 1.0).abs() < 0.1;
    let change = of(3) - of(2) * 3.0 + of(1) * 3.0 - of(0);
    intervals
        .iter()
        .all(is_regular)
        .then_some(0.5 * change.norm())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A walk of 20 s, 15 Hz, that sways and bobs, with a jump to the side at 10 s.
    fn walk(jump_m: f64) -> Vec<RigPosition> {
        let place = |n: i32| {
            let t = f64::from(n) / 15.0;
            let turn = std::f64::consts::TAU * t;
            let jumped = if n >= 150 { jump_m } else { 0.0 };
            RigPosition {
                time_s: t,
                position: [
                    1.3 * t + 0.02 * libm::sin(2.0 * turn),
                    0.03 * libm::sin(turn) + jumped,
                    1.3 + 0.025 * libm::cos(2.0 * turn),
                ],
            }
        };
        (0..300).map(place).collect()
    }

    #[test]
    fn jumps_are_found_and_steps_of_a_walk_are_none() {
        let config = JumpConfig::default();
        assert_eq!(position_jumps(&walk(0.0), &config), Vec::<[f64; 2]>::new());
        for jump_m in [0.06, 0.2, 0.5] {
            let found = position_jumps(&walk(jump_m), &config);
            assert_eq!(found.len(), 1, "{found:?}");
            assert!((found[0][0] - 10.0).abs() < 1e-6, "{found:?}");
            assert!((found[0][1] - jump_m).abs() < 0.02, "{found:?}");
        }
        assert!(position_jumps(&walk(0.2)[..3], &config).is_empty());
    }

    #[test]
    fn jolts_of_a_run_after_a_walk_are_no_jumps() {
        let mut positions = walk(0.0);
        for own in &mut positions[160..] {
            // Three strikes a second.
            own.position[2] += 0.08 * libm::sin(std::f64::consts::TAU * 3.0 * own.time_s).abs();
        }
        let config = JumpConfig::default();
        assert_eq!(position_jumps(&positions, &config), Vec::<[f64; 2]>::new());
        for own in &mut positions[200..] {
            own.position[1] += 0.5;
        }
        let found = position_jumps(&positions, &config);
        assert_eq!(found.len(), 1, "{found:?}");
    }
}
