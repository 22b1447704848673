//! How a sole is usually tilted, by the motion of its tag.

use nalgebra::Vector3;

use crate::config::FootConfig;

/// Longest time to a place where a tag rests for a slope, s, and least length of such a step, m.
const SLOPE_S: f64 = 2.5;
const MIN_STEP_M: f64 = 0.2;

/// Where the middle of a tag is in a frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct TagPlace {
    pub(super) time_ns: i64,
    /// In the world, m.
    pub(super) place: Vector3<f64>,
}

/// The tilt of a sole before images are looked at: its pitch, toe up, and the standard deviation of
/// its tilt about that, rad.
pub(super) struct TiltPrior {
    pub(super) pitch: f64,
    pub(super) sigma: f64,
}

impl TiltPrior {
    /// Of a foot whose tag moves at a speed, m/s.
    pub(super) fn of_speed(speed: f64, config: &FootConfig) -> Self {
        let sigma = config.rest_level_sigma_rad + config.level_sigma_per_speed * speed;
        Self {
            pitch: 0.0,
            sigma: sigma.min(config.level_sigma_rad),
        }
    }
}

/// Of a foot in a frame. One that comes to rest soon and did not rest before approaches its strike,
/// toe up. The ground may be as steep as the path of the foot.
pub(super) fn tilt_prior(frames: &[TagPlace], k: usize, config: &FootConfig) -> TiltPrior {
    let slope = path_slope(frames, k, config).min(config.max_slope);
    let within =
        |a: usize, b: usize, seconds: f64| seconds_between(&frames[a], &frames[b]) < seconds;
    let mut before = (0..k)
        .rev()
        .take_while(|at| within(*at, k, config.max_approach_s));
    let after = (k..frames.len() - 1).take_while(|at| within(k, *at + 1, config.landing_s));
    let was_at_rest = before.any(|at| rests(frames, at, config));
    let rests_now = k + 1 < frames.len() && rests(frames, k, config);
    let lands = after.skip(1).any(|at| rests(frames, at, config)) && !rests_now;
    if !was_at_rest && lands {
        return TiltPrior {
            pitch: config.approach_pitch[0],
            sigma: config.approach_pitch[1].hypot(slope),
        };
    }
    let next = frames.get(k + 1);
    let next = next.filter(|_| within(k, k + 1, config.max_approach_s));
    let after = next.map_or(f64::INFINITY, |next| tag_speed(&frames[k], next));
    let level = TiltPrior::of_speed(speed_before(frames, k, config).min(after), config);
    TiltPrior {
        sigma: level.sigma.hypot(slope),
        ..level
    }
}

/// Whether a tag moves little until the next frame.
fn rests(frames: &[TagPlace], k: usize, config: &FootConfig) -> bool {
    tag_speed(&frames[k], &frames[k + 1]) < config.rest_speed
}

/// Slope of the path of a foot about a frame, as a ratio: between where its tag rests before and
/// after it.
fn path_slope(frames: &[TagPlace], k: usize, config: &FootConfig) -> f64 {
    let is_soon = |at: &usize| {
        let [first, last] = [*at.min(&k), *at.max(&k)];
        seconds_between(&frames[first], &frames[last]) < SLOPE_S
    };
    let is_there = |at: &usize| {
        let is_near = |next: &TagPlace| seconds_between(&frames[*at], next) < config.max_approach_s;
        frames.get(at + 1).is_some_and(is_near) && rests(frames, *at, config)
    };
    let is_away = |at: &usize| (frames[*at].place - frames[k].place).xy().norm() > MIN_STEP_M;
    let before = (0..k).rev().take_while(is_soon).filter(is_there);
    let after = (k..frames.len()).take_while(is_soon).filter(is_there);
    let place = |at: Option<usize>| frames[at.unwrap_or(k)].place;
    let step = place({ after }.find(is_away)) - place({ before }.find(is_away));
    let length = step.xy().norm();
    match length > MIN_STEP_M {
        true => step.z.abs() / length,
        false => 0.0,
    }
}

/// Speed of a tag from a frame to the next one, m/s.
pub(super) fn tag_speed(a: &TagPlace, b: &TagPlace) -> f64 {
    (b.place - a.place).norm() / seconds_between(a, b).max(1e-3)
}

/// Speed of a tag from the frame before, m/s; infinite where none is near.
pub(super) fn speed_before(frames: &[TagPlace], k: usize, config: &FootConfig) -> f64 {
    let before = k.checked_sub(1).map(|before| &frames[before]);
    let near = before.filter(|own| seconds_between(own, &frames[k]) < config.max_approach_s);
    near.map_or(f64::INFINITY, |own| tag_speed(own, &frames[k]))
}

/// From a frame to a later one, s.
pub(super) fn seconds_between(a: &TagPlace, b: &TagPlace) -> f64 {
    1e-9 * (b.time_ns - a.time_ns) as f64
}
