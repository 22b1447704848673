//! Two streams of one eye each into pairs: by number first, by time second.
//!
//! Contract: both streams come in their own order; pairs come out in that order. Two counters need
//! not begin at the same number, so the first pair is made by time (the two that are within half
//! a period of each other) and gives the distance between the counters. From then on numbers
//! decide, as long as times do not contradict them by more than three quarters of a period: then
//! a counter has jumped, and time decides again. A frame whose other half does not come is reported
//! alone, at the latest when [`DEPTH`] later ones of its eye have come.

use std::collections::VecDeque;

/// Frames of one eye that wait for the other.
const DEPTH: usize = 3;

/// One of the two.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Eye {
    /// The left one.
    Left,
    /// The right one.
    Right,
}

impl Eye {
    fn other(self) -> Eye {
        match self {
            Eye::Left => Eye::Right,
            Eye::Right => Eye::Left,
        }
    }
}

/// A frame of one eye.
#[derive(Debug)]
pub(super) struct Half<T> {
    pub(super) number: u64,
    pub(super) time_ns: i64,
    pub(super) frame: T,
}

/// What comes out.
#[derive(Debug)]
pub(super) enum PairingOutput<T> {
    Both(Half<T>, Half<T>),
    /// A frame without the other half.
    Alone {
        /// The eye that is missing.
        missing: Eye,
        /// Its number as the left eye counts, where that is known.
        number: Option<u64>,
    },
}

#[derive(Debug)]
pub(super) struct Pairing<T> {
    period_ns: i64,
    left: VecDeque<Half<T>>,
    right: VecDeque<Half<T>>,
    /// The right eye's number less the left's.
    ahead: Option<i64>,
}

/// Which of the two oldest frames is to go.
enum Verdict {
    Both,
    Left,
    Right,
}

impl<T> Pairing<T> {
    pub(super) fn new(rate_hz: f64) -> Pairing<T> {
        Pairing {
            period_ns: (1e9 / rate_hz).round().max(1.0) as i64,
            left: VecDeque::new(),
            right: VecDeque::new(),
            ahead: None,
        }
    }

    /// Takes a frame of one side and returns what is decided by now.
    pub(super) fn push(&mut self, eye: Eye, half: Half<T>, out: &mut impl FnMut(PairingOutput<T>)) {
        match eye {
            Eye::Left => self.left.push_back(half),
            Eye::Right => self.right.push_back(half),
        }
        while let (Some(left), Some(right)) = (self.left.front(), self.right.front()) {
            match judge(&mut self.ahead, self.period_ns, left, right) {
                Verdict::Both => {
                    if let (Some(left), Some(right)) =
                        (self.left.pop_front(), self.right.pop_front())
                    {
                        out(PairingOutput::Both(left, right));
                    }
                }
                Verdict::Left => self.alone(Eye::Left, out),
                Verdict::Right => self.alone(Eye::Right, out),
            }
        }
        for eye in [Eye::Left, Eye::Right] {
            while self.side(eye).len() > DEPTH {
                self.alone(eye, out);
            }
        }
    }

    /// Gives out what still waits.
    pub(super) fn finish(&mut self, out: &mut impl FnMut(PairingOutput<T>)) {
        for eye in [Eye::Left, Eye::Right] {
            while !self.side(eye).is_empty() {
                self.alone(eye, out);
            }
        }
    }

    fn side(&mut self, eye: Eye) -> &mut VecDeque<Half<T>> {
        match eye {
            Eye::Left => &mut self.left,
            Eye::Right => &mut self.right,
        }
    }

    /// The oldest frame of `eye` has no partner.
    fn alone(&mut self, eye: Eye, out: &mut impl FnMut(PairingOutput<T>)) {
        let ahead = self.ahead;
        let Some(half) = self.side(eye).pop_front() else {
            return;
        };
        let number = match eye {
            Eye::Left => Some(half.number),
            Eye::Right => ahead.and_then(|ahead| half.number.checked_add_signed(-ahead)),
        };
        out(PairingOutput::Alone {
            missing: eye.other(),
            number,
        });
    }
}

fn judge<T>(ahead: &mut Option<i64>, period_ns: i64, left: &Half<T>, right: &Half<T>) -> Verdict {
    let later_ns = right.time_ns.saturating_sub(left.time_ns);
    let counted = right.number.wrapping_sub(left.number) as i64;
    if let Some(ahead) = *ahead {
        let later = counted.saturating_sub(ahead);
        let contradiction = later_ns.saturating_sub(later.saturating_mul(period_ns));
        if contradiction.saturating_abs() <= period_ns / 4 * 3 {
            return match later {
                0 => Verdict::Both,
                1.. => Verdict::Left,
                _ => Verdict::Right,
            };
        }
    }
    *ahead = None;
    if later_ns.saturating_abs() <= period_ns / 2 {
        *ahead = Some(counted);
        Verdict::Both
    } else if later_ns > 0 {
        Verdict::Left
    } else {
        Verdict::Right
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: i64 = 10_000_000;

    /// Pairs as (left number, right number); a frame alone as (number or MAX, MAX).
    fn pair(frames: &[(Eye, u64, i64)]) -> Vec<(u64, u64)> {
        let mut pairing = Pairing::new(100.0);
        let mut found = Vec::new();
        let mut out = |paired: PairingOutput<()>| {
            found.push(match paired {
                PairingOutput::Both(left, right) => (left.number, right.number),
                PairingOutput::Alone { number, .. } => (number.unwrap_or(u64::MAX), u64::MAX),
            });
        };
        for &(eye, number, time_ns) in frames {
            let half = Half {
                number,
                time_ns,
                frame: (),
            };
            pairing.push(eye, half, &mut out);
        }
        pairing.finish(&mut out);
        found
    }

    /// Left and right in turn, the right counter 5 ahead and its times 1 ms later.
    fn stream(count: i64, keep: impl Fn(Eye, i64) -> bool) -> Vec<(Eye, u64, i64)> {
        (0..count)
            .flat_map(|n| {
                [
                    (Eye::Left, n, n as u64, n * PERIOD),
                    (Eye::Right, n, n as u64 + 5, n * PERIOD + 1_000_000),
                ]
            })
            .filter(|&(eye, n, ..)| keep(eye, n))
            .map(|(eye, _, number, time)| (eye, number, time))
            .collect()
    }

    #[test]
    fn counters_need_not_agree() {
        let expected: Vec<(u64, u64)> = (0..20).map(|n| (n, n + 5)).collect();
        assert_eq!(pair(&stream(20, |_, _| true)), expected);
    }

    #[test]
    fn a_loss_of_one_eye_is_reported_for_the_other() {
        let lost = |eye, n| match eye {
            Eye::Left => n % 7 == 3,
            Eye::Right => n % 5 == 4,
        };
        let found = pair(&stream(100, |eye, n| !lost(eye, n)));
        let expected: Vec<(u64, u64)> = (0..100)
            .filter_map(|n| match (lost(Eye::Left, n), lost(Eye::Right, n)) {
                (false, false) => Some((n as u64, n as u64 + 5)),
                (true, true) => None,
                _ => Some((n as u64, u64::MAX)),
            })
            .collect();
        assert_eq!(found, expected);
    }

    #[test]
    fn numbers_decide_where_times_are_poor() {
        // 60 % of a period late: by time, they would belong to the next.
        let mut frames = stream(20, |_, _| true);
        for frame in &mut frames[10..] {
            if frame.0 == Eye::Right {
                frame.2 += 5_000_000;
            }
        }
        let expected: Vec<(u64, u64)> = (0..20).map(|n| (n, n + 5)).collect();
        assert_eq!(pair(&frames), expected);
    }

    #[test]
    fn a_counter_that_begins_anew_is_followed_by_time() {
        let mut frames = stream(20, |_, _| true);
        for frame in &mut frames[20..] {
            if frame.0 == Eye::Right {
                frame.1 -= 15;
            }
        }
        let expected: Vec<(u64, u64)> = (0..20)
            .map(|n| (n, if n < 10 { n + 5 } else { n - 10 }))
            .collect();
        assert_eq!(pair(&frames), expected);
    }

    #[test]
    fn an_eye_that_starts_late_or_stops_leaves_the_other_alone() {
        let found = pair(&stream(30, |eye, n| {
            eye == Eye::Left || (10..20).contains(&n)
        }));
        assert_eq!(found.len(), 30);
        let paired: Vec<u64> = found
            .iter()
            .filter(|f| f.1 != u64::MAX)
            .map(|f| f.0)
            .collect();
        assert_eq!(paired, (10..20).collect::<Vec<u64>>());
        // Never more than a few wait: the first one is reported as soon as the fourth has come.
        let mut pairing = Pairing::new(100.0);
        let mut count = 0;
        for n in 0..10 {
            let half = Half {
                number: n,
                time_ns: n as i64 * PERIOD,
                frame: (),
            };
            pairing.push(Eye::Left, half, &mut |_| count += 1);
            assert_eq!(count, (n as usize + 1).saturating_sub(DEPTH));
        }
    }
}
