//! Lines through events that come in equal steps. Plain functions.
//!
//! The thinnest band is looked for by golden section, for its width is convex in the slope; the
//! lower edge goes through the lowest points of a few parts of the window. A thousand points are
//! few: all is done again each time. Points are taken relative to the first, so that nanoseconds of
//! years of uptime stay exact.

use std::collections::VecDeque;

use super::config::FrameSyncConfig;

/// Steps of a search: the slope is then known to 1e-10 of the range.
const STEPS: usize = 48;

/// An event: its number and its time, ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Point {
    pub(super) n: i64,
    pub(super) y: i64,
}

/// Time over number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    /// Where it is anchored.
    origin: Point,
    /// Its height above the origin there, ns.
    pub(super) value: f64,
    /// ns per event.
    pub(super) slope: f64,
}

impl Line {
    fn offset(&self, n: f64) -> f64 {
        self.value + self.slope * (n - self.origin.n as f64)
    }

    /// Time of event `n`, ns, as far as an `f64` goes.
    pub(super) fn at(&self, n: f64) -> f64 {
        self.origin.y as f64 + self.offset(n)
    }

    /// Time of event `n`, ns.
    pub(super) fn y(&self, n: f64) -> i64 {
        self.origin.y + self.offset(n).round() as i64
    }

    /// How much later than event `n` the time is, ns.
    pub(super) fn above(&self, y: i64, n: f64) -> f64 {
        (y - self.origin.y) as f64 - self.offset(n)
    }

    /// The event, with fractions, at a time.
    pub(super) fn inverse(&self, y: i64) -> f64 {
        self.origin.n as f64 + ((y - self.origin.y) as f64 - self.value) / self.slope
    }
}

/// The middle of the bands around the points that are no wider than they may be.
#[derive(Clone, Copy, Debug)]
pub(super) struct SlopeBand {
    pub(super) line: Line,
    /// Of the thinnest one from edge to edge, ns.
    pub(super) width: f64,
    /// Span at the newest point in which the middle of such a band may lie, ns.
    pub(super) unresolved: f64,
}

/// The lower edge of the points.
#[derive(Clone, Copy, Debug)]
pub(super) struct LowerEnvelope {
    pub(super) line: Line,
    /// How well it is known, ns.
    pub(super) sigma: f64,
}

/// Points relative to the first, and less a slope: (number, what is left).
fn residuals(points: &VecDeque<Point>, slope: f64) -> Option<(Point, Vec<(f64, f64)>)> {
    let origin = *points.front()?;
    let relative = |p: &Point| {
        let x = (p.n - origin.n) as f64;
        (x, (p.y - origin.y) as f64 - slope * x)
    };
    Some((origin, points.iter().map(relative).collect()))
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// ns per event: the median of slopes between points half the window apart.
pub(super) fn slope_of(points: &VecDeque<Point>) -> Option<f64> {
    let half = points.len() / 2;
    let pairs = points.iter().zip(points.iter().skip(half));
    let slope = |(a, b): (&Point, &Point)| (b.y - a.y) as f64 / (b.n - a.n) as f64;
    let slopes: Vec<f64> = pairs.filter(|(a, b)| b.n > a.n).map(slope).collect();
    median(slopes).filter(|s| s.is_finite() && *s > 0.0)
}

/// Points that are late by anything between 0 and `limit` lie in a band of that width, but not in
/// one band only: a range of slopes may do. The middle of that range is taken, and how much it
/// leaves open is reported. A few points that lie far from the rest are left out; if there are
/// many, none is.
pub(super) fn slope_band(
    points: &VecDeque<Point>,
    slope: f64,
    limit: f64,
    config: &FrameSyncConfig,
) -> Option<SlopeBand> {
    let (origin, mut rest) = residuals(points, slope)?;
    let middle = median(rest.iter().map(|p| p.1).collect())?;
    let all = rest.clone();
    rest.retain(|p| (p.1 - middle).abs() <= limit);
    if rest.len() < all.len() - all.len() / config.max_left_out_divisor {
        rest = all;
    }
    let last = rest.last().map(|p| p.0).filter(|&x| x > 0.0)?;
    let edges = |turn: f64| {
        let ends = (f64::INFINITY, f64::NEG_INFINITY);
        let height = rest.iter().map(|(x, y)| y - turn * x);
        height.fold(ends, |(lo, hi), y| (lo.min(y), hi.max(y)))
    };
    let width = |turn: f64| {
        let (low, high) = edges(turn);
        high - low
    };
    let range = 4.0 * limit / last;
    let thinnest = minimise(range, width);
    // Times are rounded, so that even the thinnest may be a little too wide; then there is no
    // choice.
    let limit = limit.max(width(thinnest));
    let ends = [-range, range].map(|end| last_where(thinnest, end, |turn| width(turn) <= limit));
    let turn = (ends[0] + ends[1]) / 2.0;
    let (low, high) = edges(turn);
    let value = (low + high) / 2.0;

    // Where the middle may be at the newest point, by the outermost slopes and this one.
    let half_slack = |turn: f64| (limit - width(turn)).max(0.0) / 2.0;
    let (mut least, mut most) = (0.0_f64, 0.0_f64);
    for end in [ends[0], thinnest, turn, ends[1]] {
        let (low, high) = edges(end);
        let off = (low + high) / 2.0 - value + (end - turn) * last;
        least = least.min(off - half_slack(end));
        most = most.max(off + half_slack(end));
    }
    Some(SlopeBand {
        line: Line {
            origin,
            value,
            slope: slope + turn,
        },
        width: width(thinnest),
        unresolved: most - least,
    })
}

/// The lower edge of points, with a slope within `within` of the given one. Points far below the
/// others are left out: nothing is early, so they are wrong.
pub(super) fn lower_envelope(
    points: &VecDeque<Point>,
    slope: f64,
    within: f64,
    config: &FrameSyncConfig,
) -> Option<LowerEnvelope> {
    let (origin, mut rest) = residuals(points, slope)?;
    let drift = slope_of(points)?.clamp(slope - within, slope + within) - slope;
    let mut heights: Vec<f64> = rest.iter().map(|(x, y)| y - drift * x).collect();
    heights.sort_by(f64::total_cmp);
    let quantile = |share: usize| heights[heights.len() * share / 10];
    // Of a one-sided spread nothing is farther below the median than the lowest tenth, a few times
    // over.
    let least =
        quantile(5) - config.max_early_ratio * (quantile(5) - quantile(1)) - config.max_early_ns;
    rest.retain(|(x, y)| y - drift * x >= least);

    // The lowest point of each part of the window; a line through those is one through the edge.
    let lowest = |part: &[(f64, f64)]| {
        let height = |p: &(f64, f64)| p.1 - drift * p.0;
        part.iter()
            .copied()
            .min_by(|a, b| height(a).total_cmp(&height(b)))
    };
    let part = rest.len().div_ceil(config.parts).max(1);
    let lows: Vec<(f64, f64)> = rest.chunks(part).filter_map(lowest).collect();
    let pairs = lows
        .iter()
        .enumerate()
        .flat_map(|(k, a)| lows[k + 1..].iter().map(move |b| (a, b)));
    let turns = pairs.map(|(a, b)| (b.1 - a.1) / (b.0 - a.0)).collect();
    let turn = median(turns)?.clamp(-within, within);
    let value = rest
        .iter()
        .map(|(x, y)| y - turn * x)
        .fold(f64::INFINITY, f64::min);

    // The distance of each part from the line. Most parts count, not all: all points of one may
    // have been late.
    let mut heights: Vec<f64> = lows.iter().map(|(x, y)| y - turn * x - value).collect();
    heights.sort_by(f64::total_cmp);
    Some(LowerEnvelope {
        line: Line {
            origin,
            value,
            slope: slope + turn,
        },
        sigma: heights[heights.len() * 3 / 4],
    })
}

/// The farthest place from `from` towards `to` where something holds that holds at `from`, and from
/// some place on no more.
fn last_where(from: f64, to: f64, holds: impl Fn(f64) -> bool) -> f64 {
    let (mut good, mut bad) = (from, to);
    for _ in 0..STEPS {
        let middle = (good + bad) / 2.0;
        if holds(middle) {
            good = middle;
        } else {
            bad = middle;
        }
    }
    good
}

/// Where in `-range..range` a convex function is least.
fn minimise(range: f64, of: impl Fn(f64) -> f64) -> f64 {
    let golden = (5_f64.sqrt() - 1.0) / 2.0;
    let (mut a, mut b) = (-range, range);
    let (mut x, mut y) = (b - golden * (b - a), a + golden * (b - a));
    let (mut at_x, mut at_y) = (of(x), of(y));
    for _ in 0..STEPS {
        if at_x < at_y {
            (b, y, at_y) = (y, x, at_x);
            x = b - golden * (b - a);
            at_x = of(x);
        } else {
            (a, x, at_x) = (x, y, at_y);
            y = a + golden * (b - a);
            at_y = of(y);
        }
    }
    (a + b) / 2.0
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;

    use super::*;

    const PERIOD: f64 = 33_333_400.0;

    fn points(late: impl Fn(i64) -> f64) -> VecDeque<Point> {
        let y = |n: i64| 1_000_000_000_000_000 + (n as f64 * PERIOD + late(n)).round() as i64;
        (0..512).map(|n| Point { n: 7 + n, y: y(n) }).collect()
    }

    /// Error of the line at both ends, ns.
    fn errors(line: &Line) -> [f64; 2] {
        [0, 511].map(|n| line.at(7.0 + n as f64) - 1e15 - n as f64 * PERIOD)
    }

    proptest! {
        /// Flags that are late by anything up to a sample period: the middle is half a period late,
        /// at both ends.
        #[test]
        fn the_strip_finds_the_middle(late in prop::collection::vec(0.0..1_250_000.0_f64, 512)) {
            let points = points(|n| late[n as usize]);
            let slope_band = slope_band(&points, slope_of(&points).expect("some"), 1_250_000.0, &FrameSyncConfig::default()).expect("some");
            prop_assert!(slope_band.width <= 1_250_001.0 && slope_band.width > 1_150_000.0, "{}", slope_band.width);
            for error in errors(&slope_band.line) {
                prop_assert!((error - 625_000.0).abs() < 75_000.0, "{}", error);
            }
        }
    }

    /// Stamps that are late, a third of them very: the line is that of those that are not. Beyond
    /// five sigmas were 2 of 40 000 ends of other draws, so that draws of a random seed would fail
    /// now and then.
    #[test]
    fn the_floor_is_below_what_is_late() {
        let mut runner = TestRunner::deterministic();
        let draw = prop::collection::vec((0.0..300_000.0_f64, prop::bool::weighted(0.3)), 512);
        for _ in 0..256 {
            let late = draw.new_tree(&mut runner).expect("a draw").current();
            let points = points(|n| {
                let (late, very) = late[n as usize];
                if very { 50.0 * late } else { late }
            });
            let lower_envelope = lower_envelope(
                &points,
                PERIOD + 2000.0,
                PERIOD * 500e-6,
                &FrameSyncConfig::default(),
            )
            .expect("some");
            for error in errors(&lower_envelope.line) {
                assert!(error.abs() < 100_000.0, "{error}");
                let sigma = lower_envelope.sigma;
                assert!(error.abs() < 5.0 * sigma + 2000.0, "{error} {sigma}");
            }
        }
    }

    #[test]
    fn a_wrong_event_does_no_harm() {
        let wild = points(|n| match n {
            100 => 20e6,
            300 => -20e6,
            n => ((n * 37) % 100) as f64 * 10_000.0,
        });
        let slope_band = slope_band(
            &wild,
            slope_of(&wild).expect("some"),
            1_000_000.0,
            &FrameSyncConfig::default(),
        )
        .expect("some");
        assert!(slope_band.width < 1_000_000.0);
        let lower_envelope =
            lower_envelope(&wild, PERIOD, PERIOD * 500e-6, &FrameSyncConfig::default())
                .expect("some");
        for error in errors(&lower_envelope.line) {
            assert!((-30_000.0..30_000.0).contains(&error), "{error}");
        }
    }

    #[test]
    fn a_line_is_read_both_ways() {
        let exact = points(|_| 0.0);
        let line = slope_band(
            &exact,
            slope_of(&exact).expect("some"),
            1000.0,
            &FrameSyncConfig::default(),
        )
        .expect("some")
        .line;
        assert!((line.inverse(line.y(100.0)) - 100.0).abs() < 1e-6);
        assert!(line.above(line.y(100.0), 100.0).abs() <= 1.0);
    }
}
