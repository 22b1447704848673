//! Selection of the bursts of a session that are decoded.
//!
//! Contract: the session is divided into equal parts with one burst each. Within its part, a burst
//! is placed where the rotation rate changes most, but not so fast that images blur. The selection
//! depends on the gyroscopes alone; without them, each burst is in the middle of its part. A
//! session shorter than a burst is one burst.

use super::config::BurstConfig;
use super::gyro::Gyro;

/// First and last time of `count` bursts of a given length in a session, ns; fewer in a short
/// session.
pub fn choose_bursts(
    gyros: &[&Gyro],
    span_ns: [i64; 2],
    count: usize,
    length_ns: i64,
    config: &BurstConfig,
) -> Vec<[i64; 2]> {
    let [start, end] = span_ns;
    if end > start && end - start < length_ns && count > 0 {
        return vec![span_ns];
    }
    let fit = ((end - start) / length_ns.max(1)).max(0);
    let count = (count as i64).min(fit);
    let part = (end - start) / count.max(1);
    let burst = |k: i64| {
        let (first, last) = (start + k * part, start + (k + 1) * part - length_ns);
        let middle = first + (last - first) / 2;
        let places = (0..=(last - first) / config.step_ns).map(|i| first + i * config.step_ns);
        let best = places
            .map(|at| (rate_variance(gyros, at, at + length_ns, config), at))
            .filter(|(variance, _)| *variance > 0.0)
            .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        let from = best.map_or(middle, |(_, at)| at);
        [from, from + length_ns]
    };
    (0..count).map(burst).collect()
}

/// Variance of the rate, (rad/s)².
fn rate_variance(gyros: &[&Gyro], from: i64, to: i64, config: &BurstConfig) -> f64 {
    let Some(gyro) = gyros.first() else {
        return 0.0;
    };
    let (mut count, mut sum, mut square, mut next) = (0.0, nalgebra::Vector3::zeros(), 0.0, from);
    for (time, rate) in gyro.between_ns(from, to) {
        if time >= next {
            let rate =
                rate * (config.max_rate_rad_s / rate.norm().max(config.max_rate_rad_s)).powi(3);
            count += 1.0;
            sum += rate;
            square += rate.norm_squared();
            next = time + config.rate_step_ns;
        }
    }
    if count < 2.0 {
        return 0.0;
    }
    square / count - (sum / count).norm_squared()
}
