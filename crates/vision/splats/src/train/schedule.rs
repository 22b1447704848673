//! What happens at which step.

use super::config::TrainConfig;

/// Stream of random numbers of the order of views.
const STREAM: u64 = 0x7669_6577;

/// Index of the view of a step: all views in a random order, then all in another one.
pub(super) fn view(seed: u64, step: usize, views: usize) -> usize {
    let (epoch, position) = (step / views, step % views);
    let mut order: Vec<(u64, usize)> = (0..views)
        .map(|view| {
            let index = (epoch * views + view) as u64;
            (counter_random::bits(seed, STREAM, index), view)
        })
        .collect();
    let (_, chosen, _) = order.select_nth_unstable(position);
    chosen.1
}

/// Factor by which the images of a step are reduced.
pub(super) fn reduction(config: &TrainConfig, step: usize) -> u32 {
    let share = share(config, step);
    if share < config.quarter_until {
        4
    } else if share < config.full_from {
        2
    } else {
        1
    }
}

/// Degree of the harmonics that a step trains.
pub(super) fn degree(config: &TrainConfig, step: usize) -> usize {
    let share = share(config, step);
    if share < config.degree_start || config.degree == 0 {
        return 0;
    }
    let each = (1.0 - config.degree_start) / config.degree as f32;
    let higher = match config.degree_start < 0.1 {
        // Early: one degree per length of the start.
        true => (share / config.degree_start.max(1e-6)) as usize,
        false => 1 + ((share - config.degree_start) / each) as usize,
    };
    higher.min(config.degree)
}

/// Learning rate of positions, per metre of the scene's radius.
pub(super) fn position_rate(config: &TrainConfig, step: usize) -> f32 {
    config.optimizer.position * position_decay(config, step)
}

/// Learning rate of positions as a share of the largest scale of a Gaussian.
pub(super) fn position_rate_by_size(config: &TrainConfig, step: usize) -> f32 {
    config.optimizer.position_by_size * position_decay(config, step)
}

fn position_decay(config: &TrainConfig, step: usize) -> f32 {
    libm::powf(config.optimizer.position_decay, share(config, step))
}

/// Weight of the depth's loss.
pub(super) fn depth_weight(config: &TrainConfig, step: usize) -> f32 {
    config.loss.depth_weight * libm::powf(config.loss.depth_decay, share(config, step))
}

/// Whether the number of Gaussians changes after a step.
pub(super) fn is_growth_round(config: &TrainConfig, step: usize) -> bool {
    let growth = &config.growth;
    step >= growth.start
        && share(config, step) < growth.stop
        && step.is_multiple_of(growth.interval.max(1))
}

/// Whether opacities are reset after a step.
pub(super) fn is_reset(config: &TrainConfig, step: usize) -> bool {
    let growth = &config.growth;
    growth.reset_interval > 0
        && step > 0
        && share(config, step) < growth.stop
        && step.is_multiple_of(growth.reset_interval)
}

fn share(config: &TrainConfig, step: usize) -> f32 {
    step as f32 / config.steps.max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::Preset;

    #[test]
    fn every_epoch_shows_every_view_once_in_another_order() {
        let epoch = |e: usize| (0..7).map(|k| view(3, 7 * e + k, 7)).collect::<Vec<_>>();
        for e in 0..5 {
            let mut sorted = epoch(e);
            sorted.sort_unstable();
            assert_eq!(sorted, [0, 1, 2, 3, 4, 5, 6]);
        }
        assert!((1..5).any(|e| epoch(e) != epoch(0)));
    }

    #[test]
    fn presets_follow_their_schedules() {
        let paws = TrainConfig::preset(Preset::Paws);
        let found = [0, 2999, 3000, 5999, 6000].map(|step| reduction(&paws, step));
        assert_eq!(found, [4, 4, 2, 2, 1]);
        let found = [0, 999, 1000, 2500, 3500, 20_000].map(|step| degree(&paws, step));
        assert_eq!(found, [0, 0, 1, 2, 3, 3]);
        assert!(is_growth_round(&paws, 24_900) && !is_growth_round(&paws, 25_100));
        let balanced = TrainConfig::preset(Preset::Balanced);
        assert_eq!(
            [3499, 3500, 6999].map(|step| degree(&balanced, step)),
            [0, 1, 1]
        );
        assert!(!is_growth_round(&balanced, 100) && is_growth_round(&balanced, 400));
        let first = position_rate_by_size(&balanced, 0);
        let last = position_rate_by_size(&balanced, 7000);
        assert!((last / first - 0.01).abs() < 1e-6, "{last}");
        assert_eq!(position_rate(&balanced, 0), 0.0);
        assert_eq!(position_rate(&paws, 0), 5e-5);
    }
}
