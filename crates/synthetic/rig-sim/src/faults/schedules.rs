//! Random fault schedules for tests.

use super::{Fault, FaultDuration, Faults, Kind, Subject};
use crate::random;
use crate::walker::Side;

/// Maximum number of faults in a schedule.
const MAX_FAULTS: usize = 8;

impl Faults {
    /// A schedule that follows from the seed: up to eight faults of these kinds at random times of
    /// a walk of `seconds`, on random cameras or all. Faults whose strength is their duration last
    /// up to half a minute; delays are up to some 2 s, and bursts of latency end within 3 s; other
    /// strengths reach the maximum of their kind. Strengths are log-uniform over three decades.
    pub fn random(seed: u64, kinds: &[Kind], cameras: &[&str], seconds: f64) -> Self {
        let draw = |i: u64, k: u64| random::uniform(seed, random::FAULT + 0x40 + k, i);
        let pick = |i: u64, k: u64, count: usize| (draw(i, k) * count as f64) as usize;
        let fault = |i: u64| {
            let kind = kinds[pick(i, 1, kinds.len())];
            let (least, most) = (*kind.range().start(), *kind.range().end());
            let size = libm::pow(10.0, -3.0 * draw(i, 2));
            let strength = match kind {
                Kind::TickWrap => 1.0,
                Kind::Late => 2.0 * size,
                // Later deliveries wait, so consecutive delays add up to eight times the mean.
                Kind::LatencyBurst => 0.3 * size,
                _ if kind.duration() == FaultDuration::ByStrength => 30.0 * size,
                _ if least < 0.0 && draw(i, 3) < 0.5 => least * size,
                _ => most * size,
            };
            let from_s = seconds * draw(i, 4);
            let to_s = match kind.duration() {
                // A permanent latency increase cannot be distinguished from a clock step.
                _ if kind == Kind::LatencyBurst => from_s + 0.05 + 3.0 * draw(i, 6),
                FaultDuration::UntilEnd if draw(i, 5) < 0.8 => from_s + 0.05 + 10.0 * draw(i, 6),
                _ => f64::INFINITY,
            };
            let camera = match pick(i, 7, cameras.len() + 1) {
                n if n > 0 && kind.subject() == Subject::Camera => Some(cameras[n - 1].to_owned()),
                _ => None,
            };
            let foot = match kind.subject() {
                Subject::Foot => [None, Some(Side::Left), Some(Side::Right)][pick(i, 8, 3)],
                _ => None,
            };
            Fault {
                kind,
                strength,
                from_s,
                to_s,
                camera,
                foot,
            }
        };
        let count = 1 + pick(0, 0, MAX_FAULTS) as u64;
        Self {
            list: (0..count).map(fault).collect(),
            seed,
        }
    }
}
