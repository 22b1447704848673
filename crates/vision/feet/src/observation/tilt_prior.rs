//! How a sole is usually tilted, by the motion of its tag.

use nalgebra::Vector3;

use crate::config::FootConfig;

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
/// toe up.
pub(super) fn tilt_prior(frames: &[TagPlace], k: usize, config: &FootConfig) -> TiltPrior {
    let is_near =
        |a: usize, b: usize| seconds_between(&frames[a], &frames[b]) < config.max_approach_s;
    let rests = |k: usize| tag_speed(&frames[k], &frames[k + 1]) < config.rest_speed;
    let mut before = (0..k).rev().take_while(|at| is_near(*at, k));
    let after = (k..frames.len() - 1).take_while(|at| is_near(k, *at + 1));
    let was_at_rest = before.any(rests);
    let lands = after.skip(1).any(rests) && !(k + 1 < frames.len() && rests(k));
    if !was_at_rest && lands {
        return TiltPrior {
            pitch: config.approach_pitch[0],
            sigma: config.approach_pitch[1],
        };
    }
    let next = frames.get(k + 1).filter(|_| is_near(k, k + 1));
    let after = next.map_or(f64::INFINITY, |next| tag_speed(&frames[k], next));
    TiltPrior::of_speed(speed_before(frames, k, config).min(after), config)
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
