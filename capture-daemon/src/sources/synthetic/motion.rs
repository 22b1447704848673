//! Motion of the synthetic camera, and the IMU's measurements of it.
//!
//! Contract: smooth and periodic for ever, without loss of precision at any time: phases are
//! computed from integer times. Angles are small; image and gyro agree to first order.

use std::f64::consts::TAU;

use counter_random as random;

use super::streams;

/// Standard gravity, m/s².
const GRAVITY_M_S2: f64 = 9.806_65;

/// Rotation right and left (yaw), up and down (pitch), and bobbing.
pub(super) struct Motion {
    yaw: Wave,
    pitch: Wave,
    bob: Wave,
    focal_px: f64,
}

impl Motion {
    /// For images `eye_width` wide; the focal length is the same number of pixels, a field of view
    /// of 53°.
    pub(super) fn new(seed: u64, eye_width: u32) -> Self {
        let wave = |amplitude, period_ms: i64, index| Wave {
            amplitude,
            period_ns: period_ms * 1_000_000,
            phase: random::uniform(seed, streams::PHASES, index),
        };
        Self {
            yaw: wave(0.35, 8_000, 0),
            pitch: wave(0.08, 5_000, 1),
            // A walk: 2 cm at two steps a second.
            bob: wave(0.02, 500, 2),
            focal_px: f64::from(eye_width),
        }
    }

    /// Position of pixel (0, 0) on the wall, in pixels right of and below its position at rest.
    pub(super) fn shift_px(&self, t_ns: i64) -> (i64, i64) {
        // A rotation to the right shows the wall further right; a rotation upwards, further up.
        let right = self.focal_px * self.yaw.value(t_ns);
        let down = -self.focal_px * self.pitch.value(t_ns);
        (right.round() as i64, down.round() as i64)
    }

    /// Angular rate in rad/s and specific force in m/s², in the optical frame (x right, y down, z
    /// forward).
    pub(super) fn measured(&self, t_ns: i64) -> ([f64; 3], [f64; 3]) {
        // A positive rate about x (right) rotates the view up, about y (down) to the right.
        let gyro = [self.pitch.rate(t_ns), self.yaw.rate(t_ns), 0.0];
        let pitch = self.pitch.value(t_ns) / TAU;
        let up = [0.0, -sin_cycles(pitch + 0.25), sin_cycles(pitch)];
        let force = GRAVITY_M_S2 + self.bob.acceleration(t_ns);
        (gyro, up.map(|x| x * force))
    }
}

struct Wave {
    amplitude: f64,
    period_ns: i64,
    /// In cycles.
    phase: f64,
}

impl Wave {
    fn cycles(&self, t_ns: i64) -> f64 {
        t_ns.rem_euclid(self.period_ns) as f64 / self.period_ns as f64 + self.phase
    }

    /// rad/s.
    fn omega(&self) -> f64 {
        TAU / (self.period_ns as f64 / 1e9)
    }

    fn value(&self, t_ns: i64) -> f64 {
        self.amplitude * sin_cycles(self.cycles(t_ns))
    }

    fn rate(&self, t_ns: i64) -> f64 {
        self.amplitude * self.omega() * sin_cycles(self.cycles(t_ns) + 0.25)
    }

    fn acceleration(&self, t_ns: i64) -> f64 {
        -self.omega() * self.omega() * self.value(t_ns)
    }
}

/// Sine of an angle in cycles, to 1e-9, the same on every machine (the library's is not): Taylor's
/// series after folding into a quarter cycle.
fn sin_cycles(cycles: f64) -> f64 {
    let cycles = cycles - cycles.round();
    let quarter = if cycles.abs() > 0.25 {
        0.5_f64.copysign(cycles) - cycles
    } else {
        cycles
    };
    let x = TAU * quarter;
    let square = x * x;
    let series = [12.0, 10.0, 8.0, 6.0, 4.0, 2.0];
    x * series
        .into_iter()
        .fold(1.0, |sum, n: f64| 1.0 - sum * square / (n * (n + 1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_agrees_with_the_library() {
        for i in -3000..3000 {
            let cycles = f64::from(i) / 1000.0;
            let (found, expected) = (sin_cycles(cycles), (TAU * cycles).sin());
            assert!(
                (found - expected).abs() < 1e-8,
                "{cycles}: {found} {expected}"
            );
        }
    }

    #[test]
    fn gyro_is_the_rate_of_the_image_motion() {
        let motion = Motion::new(5, 100_000);
        let (t, dt) = (3_600_000_000_000 + 1_234_567_890, 1_000_000);
        let (before, after) = (motion.shift_px(t - dt), motion.shift_px(t + dt));
        let ([pitch, yaw, roll], force) = motion.measured(t);
        let per_s = |a: i64, b: i64| (b - a) as f64 / 1e5 / 2e-3;
        assert!((per_s(before.0, after.0) - yaw).abs() < 0.01, "{yaw}");
        assert!((per_s(before.1, after.1) + pitch).abs() < 0.01, "{pitch}");
        assert_eq!((roll, force[0]), (0.0, 0.0));
        assert!(force[1] < -6.0, "level, the sensor is pushed up: {force:?}");
    }
}
