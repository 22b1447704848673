//! Distance walked along the path over time.

use crate::scene::route::Leg;

/// Time between entries, s.
const STEP_S: f64 = 0.01;
/// Acceleration and deceleration, m/s².
const ACCELERATION: f64 = 0.9;
/// Standing before the first step, s.
const BEFORE_S: f64 = 0.8;
/// Standing before a jump, in which the feet come together, and after it, s.
const BEFORE_JUMP_S: f64 = 1.6;
const AFTER_JUMP_S: f64 = 0.8;

/// Distance and speed by time.
#[derive(Clone, Debug)]
pub struct Progress {
    /// Distance, m, and speed, m/s, at every [`STEP_S`].
    table: Vec<(f64, f64)>,
    stumbles: Vec<f64>,
    jumps: Vec<Jump>,
}

/// A jump on the spot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Jump {
    /// The feet leave the ground, s.
    pub(crate) at_s: f64,
    /// Height, m.
    pub(crate) height_m: f64,
}

impl Jump {
    /// Duration of the flight, s.
    pub(crate) fn flight_s(&self) -> f64 {
        (8.0 * self.height_m / 9.81).sqrt()
    }

    /// Height above the ground at a time, m.
    pub(crate) fn height_at(&self, time_s: f64) -> f64 {
        let t = (time_s - self.at_s) / self.flight_s();
        (4.0 * self.height_m * t * (1.0 - t)).max(0.0)
    }
}

impl Progress {
    /// Repeats the legs for `seconds`; from the `time, height` of each jump on, the wearer stops,
    /// jumps, and goes on.
    pub fn new(legs: &[Leg], seconds: f64, jumps: &[(f64, f64)]) -> Self {
        let steps = (seconds / STEP_S).ceil() as usize + 1;
        let mut table = Vec::with_capacity(steps + 200);
        let mut stumbles = Vec::new();
        table.resize((BEFORE_S / STEP_S) as usize, (0.0, 0.0));
        let (mut gone, mut speed) = (0.0, 0.0_f64);
        let mut legs = legs.iter().cycle().peekable();
        let mut waiting = jumps.iter().peekable();
        let mut jumps = Vec::new();
        while table.len() < steps {
            let Some(&leg) = legs.next() else { break };
            match leg {
                Leg::Walk {
                    metres,
                    speed: wish,
                } => {
                    let stops = matches!(legs.peek(), Some(Leg::Stand { .. }));
                    let end = gone + metres;
                    while gone < end && table.len() < steps {
                        let now_s = table.len() as f64 * STEP_S;
                        let jump = waiting.next_if(|(at_s, _)| *at_s <= now_s);
                        if let Some(&(_, height_m)) = jump {
                            while speed > 0.0 {
                                speed = (speed - 2.0 * ACCELERATION * STEP_S).max(0.0);
                                gone += speed * STEP_S;
                                table.push((gone, speed));
                            }
                            let at_s = table.len() as f64 * STEP_S + BEFORE_JUMP_S;
                            let jump = Jump { at_s, height_m };
                            let rest_s = BEFORE_JUMP_S + jump.flight_s() + AFTER_JUMP_S;
                            let count = (rest_s / STEP_S).ceil() as usize;
                            table.extend(std::iter::repeat_n((gone, 0.0), count));
                            jumps.push(jump);
                        }
                        let remaining: f64 = end - gone;
                        let braking = match stops {
                            true => (2.0 * ACCELERATION * remaining).sqrt().max(0.06),
                            false => wish,
                        };
                        let change = wish.min(braking) - speed;
                        speed += change.clamp(-2.0 * ACCELERATION * STEP_S, ACCELERATION * STEP_S);
                        gone += speed * STEP_S;
                        table.push((gone, speed));
                    }
                }
                Leg::Stand { seconds } => {
                    speed = 0.0;
                    let count = (seconds / STEP_S).ceil() as usize;
                    table.extend(std::iter::repeat_n((gone, 0.0), count.min(steps)));
                }
                Leg::Stumble => stumbles.push(table.len() as f64 * STEP_S),
            }
        }
        Self {
            table,
            stumbles,
            jumps,
        }
    }

    /// Length, s.
    pub fn seconds(&self) -> f64 {
        STEP_S * (self.table.len() - 1) as f64
    }

    /// Distance and speed; before and after, those at the ends.
    pub fn at(&self, time_s: f64) -> (f64, f64) {
        let u = (time_s / STEP_S).clamp(0.0, (self.table.len() - 1) as f64);
        let i = (u.floor() as usize).min(self.table.len() - 2);
        let t = u - i as f64;
        let (a, b) = (self.table[i], self.table[i + 1]);
        (a.0 + (b.0 - a.0) * t, a.1 + (b.1 - a.1) * t)
    }

    /// Jumps in the order of time.
    pub(crate) fn jumps(&self) -> &[Jump] {
        &self.jumps
    }

    /// Times of stumbles, s.
    pub(crate) fn stumbles(&self) -> &[f64] {
        &self.stumbles
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds_are_reached_and_standing_is_at_rest() {
        let legs = [
            Leg::Walk {
                metres: 5.0,
                speed: 1.2,
            },
            Leg::Stand { seconds: 2.0 },
            Leg::Stumble,
        ];
        let progress = Progress::new(&legs, 30.0, &[]);
        assert!(progress.seconds() >= 29.99);
        let mut standing = 0;
        for k in 0..3000 {
            let t = 0.01 * f64::from(k);
            let ((a, v), (b, _)) = (progress.at(t), progress.at(t + 0.005));
            assert!((0.0..0.02).contains(&(b - a)), "{t}");
            standing += i32::from(v == 0.0);
        }
        assert!(standing > 300, "{standing}");
        assert!(!progress.stumbles().is_empty());
    }
}
