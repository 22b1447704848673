//! Numbers of frames: the device's own, or inferred from times.
//!
//! Contract: numbers rise, and a hole in them is a frame that was lost before it reached us. *By
//! offset*, the number is the buffer's offset, holes and all, but for one between the first two
//! frames for which there was no time: v4l2src (seen with GStreamer 1.22) gives its first frame
//! offset 0 and the second one 2, and counts on from there. *By time*, the number rises by the
//! periods that have passed since the frame before was due. The phase is tracked, so that neither
//! one late frame nor a rate that deviates slightly from the nominal one makes a hole. A frame that
//! is more than half a period later than due has a hole in front. *A time that does not rise* marks
//! a frame as repeated; by time, it keeps the number of the one before.

use super::policy::Numbers;

/// The phase follows by one part in this number of a frame's deviation. A rate with an error of 1 %
/// is then tracked with a lag of 8 % of a period.
const FOLLOW: i64 = 8;

/// One stream's numbering.
#[derive(Debug)]
pub(super) struct Numbering {
    by: Numbers,
    period_ns: i64,
    last: Option<Last>,
    /// By how much offsets are ahead of the numbers, known from the second frame on.
    ahead: Option<u64>,
}

#[derive(Debug, Clone, Copy)]
struct Last {
    number: u64,
    time_ns: i64,
    /// When it was due.
    due_ns: i64,
}

/// What is known of a frame from its time and offset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FrameNumber {
    pub(super) number: u64,
    /// Frames that are missing in front of it.
    pub(super) missing: u64,
    /// Its time is not after the one before.
    pub(super) repeated: bool,
}

impl Numbering {
    pub(super) fn new(by: Numbers, rate_hz: f64) -> Numbering {
        Numbering {
            by,
            period_ns: (1e9 / rate_hz).round().max(1.0) as i64,
            last: None,
            ahead: None,
        }
    }

    /// How many periods lie between two times, rounded.
    fn periods(&self, from_ns: i64, to_ns: i64) -> i64 {
        let since = to_ns.saturating_sub(from_ns);
        since.saturating_add(self.period_ns / 2) / self.period_ns
    }

    /// The next frame. An element that should count but does not is followed by time from its
    /// first frame on.
    pub(super) fn next(&mut self, time_ns: i64, offset: Option<u64>) -> FrameNumber {
        if offset.is_none() {
            self.by = Numbers::Times;
        }
        let first = self.last.is_none();
        let last = self.last.unwrap_or(Last {
            number: 0,
            time_ns: i64::MIN,
            due_ns: time_ns,
        });
        let repeated = time_ns <= last.time_ns;
        let mut due_ns = time_ns;
        let (number, missing) = match (self.by, offset) {
            (Numbers::Offset, Some(offset)) if first => (offset, 0),
            (Numbers::Offset, Some(offset)) => {
                let ahead = self.ahead.unwrap_or_else(|| {
                    let counted = offset.saturating_sub(last.number);
                    let there_was_time = self.periods(last.time_ns, time_ns).max(1) as u64;
                    counted.saturating_sub(there_was_time)
                });
                self.ahead = Some(ahead);
                let number = offset.saturating_sub(ahead);
                // One that does not rise: the device restarts its count, which is for the caller to
                // see.
                (number, number.saturating_sub(last.number.saturating_add(1)))
            }
            _ if first => (0, 0),
            _ if repeated => {
                due_ns = last.due_ns;
                (last.number, 0)
            }
            _ => {
                let steps = self.periods(last.due_ns, time_ns);
                if steps > 0 {
                    let due = last.due_ns.saturating_add(steps * self.period_ns);
                    due_ns = due + (time_ns - due) / FOLLOW;
                }
                let steps = steps.max(1) as u64;
                (last.number + steps, steps - 1)
            }
        };
        self.last = Some(Last {
            number,
            time_ns: time_ns.max(last.time_ns),
            due_ns,
        });
        FrameNumber {
            number,
            missing,
            repeated,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    fn numbers(by: Numbers, frames: &[(i64, Option<u64>)]) -> Vec<(u64, u64, bool)> {
        let mut numbering = Numbering::new(by, 100.0);
        let frames = frames.iter().map(|&(ms, offset)| {
            let FrameNumber {
                number,
                missing,
                repeated,
            } = numbering.next(5_000_000_000 + ms * MS, offset);
            (number, missing, repeated)
        });
        frames.collect()
    }

    #[test]
    fn the_device_s_own_numbers_are_kept() {
        let frames = [(0, 7), (10, 8), (40, 11), (50, 12), (60, 3), (70, 4)];
        let frames = frames.map(|(ms, offset)| (ms, Some(offset)));
        let found = numbers(Numbers::Offset, &frames);
        let expected = [7, 8, 11, 12, 3, 4].map(|number| (number, 0, false));
        let mut expected = expected.to_vec();
        expected[2].1 = 2;
        assert_eq!(found, expected);
    }

    /// As v4l2src of GStreamer 1.22 counts.
    #[test]
    fn a_hole_behind_the_first_frame_needs_time() {
        let count = |second_ms: i64, offsets: [u64; 4]| {
            let times = [0, second_ms, second_ms + 10, second_ms + 40];
            let frames: Vec<_> = times.into_iter().zip(offsets.map(Some)).collect();
            let found = numbers(Numbers::Offset, &frames);
            found
                .into_iter()
                .map(|(n, missing, _)| (n, missing))
                .collect::<Vec<_>>()
        };
        let expected = [(0, 0), (1, 0), (2, 0), (5, 2)];
        assert_eq!(count(10, [0, 2, 3, 6]), expected);
        assert_eq!(count(10, [0, 1, 2, 5]), expected);
        // One was really lost there.
        let expected = [(0, 0), (2, 1), (3, 0), (6, 2)];
        assert_eq!(count(20, [0, 3, 4, 7]), expected);
        assert_eq!(count(20, [0, 2, 3, 6]), expected);
    }

    #[test]
    fn holes_and_repeats_are_seen_in_times() {
        let frames = [0, 10, 21, 51, 59, 59, 70, 95].map(|ms| (ms, None));
        let expected = [
            (0, 0, false),
            (1, 0, false),
            (2, 0, false),
            (5, 2, false),
            (6, 0, false),
            (6, 0, true),
            (7, 0, false),
            // 2.5 periods after the one before, 2.4 after it was due.
            (9, 1, false),
        ];
        assert_eq!(numbers(Numbers::Times, &frames), expected);
        // An element without offsets is numbered by its times whatever the table says.
        assert_eq!(numbers(Numbers::Offset, &frames), expected);
    }

    #[test]
    fn one_late_frame_makes_no_hole() {
        // 4 ms late, then on time: 14 and 6 ms apart.
        let frames = [0, 10, 20, 34, 40, 50].map(|ms| (ms, None));
        let found = numbers(Numbers::Times, &frames);
        assert!(found.iter().all(|frame| frame.1 == 0), "{found:?}");
        assert_eq!(found.last().unwrap().0, 5);
    }

    #[test]
    fn a_rate_that_is_off_is_followed() {
        for period_us in [9_900, 9_990, 10_010, 10_100] {
            let mut numbering = Numbering::new(Numbers::Times, 100.0);
            for number in 0..100_000 {
                let found = numbering.next(number * period_us * 1_000, None);
                assert_eq!(found.number, number as u64, "period {period_us} us");
            }
        }
    }

    #[test]
    fn a_rate_that_is_twice_the_nominal_one_still_rises() {
        let mut numbering = Numbering::new(Numbers::Times, 100.0);
        for number in 0..1_000 {
            let found = numbering.next(number * 5 * MS, None);
            assert_eq!((found.number, found.missing), (number as u64, 0));
        }
    }
}
