//! Drift: relative pose error (RPE) over a distance or a time.
//!
//! Contract: a segment goes from one pair to the first one that is at least the delta further, by
//! true path length, by time or by compared poses; its error takes the true motion to the estimated
//! one (RPE; Sturm et al. 2012, Geiger et al. 2012). The next segment begins where the last one
//! ended, as `evo_rpe` pairs poses by default and over metres with `--pairs_from_reference`, or,
//! overlapping, at every pose. Overlapping segments in metres are not those of `evo_rpe
//! --all_pairs`, whose end is the pose nearest to the delta, if within 10 % of it; in poses they
//! are the same. `evo_rpe` has no segments in seconds, and its default is one pose. A segment may
//! contain lost poses; their path length counts as well.

use serde::Serialize;

use super::associate::Pair;
use super::statistics::Statistics;

/// Length of a segment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Delta {
    /// True path length, m.
    #[serde(rename = "metres")]
    Meters(f64),
    /// Of time, s.
    Seconds(f64),
    /// Matched poses.
    Poses(usize),
}

impl std::fmt::Display for Delta {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Meters(metres) => write!(f, "{metres} m"),
            Self::Seconds(seconds) => write!(f, "{seconds} s"),
            Self::Poses(poses) => write!(f, "{poses} poses"),
        }
    }
}

/// Drift over segments of one length. All statistics are `None` if no segment is that long.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Relative {
    /// Length of the segments.
    pub delta: Delta,
    /// Whether segments start at every pose, not only at the end of the previous one.
    pub overlapping: bool,
    /// m.
    pub translation_m: Option<Statistics>,
    /// rad.
    pub rotation_rad: Option<Statistics>,
    /// Translation error as a ratio of the true path length; segments without motion are left out.
    pub share: Option<Statistics>,
}

/// True path length up to each pair, m.
pub(crate) fn path_m(pairs: &[Pair]) -> Vec<f64> {
    let steps = pairs.windows(2).map(|pair| {
        let [from, to] = [&pair[0], &pair[1]].map(|p| p.truth.translation());
        (to - from).norm()
    });
    let mut path = vec![0.0; pairs.len().min(1)];
    for step in steps {
        path.push(path[path.len() - 1] + step);
    }
    path
}

/// Drift of aligned pairs.
pub(crate) fn relative(pairs: &[Pair], delta: Delta, overlapping: bool) -> Relative {
    let path = path_m(pairs);
    let stretches = stretches(pairs, &path, delta, overlapping);
    let error = |&(from, to): &(usize, usize)| {
        let (from, to) = (&pairs[from], &pairs[to]);
        let truth = from.truth.inverse() * to.truth;
        truth.inverse() * (from.estimated.inverse() * to.estimated)
    };
    let shares = stretches.iter().filter_map(|&(from, to)| {
        let length = path[to] - path[from];
        (length > 0.0).then(|| error(&(from, to)).distance_m() / length)
    });
    let of = |measure: &dyn Fn(&(usize, usize)) -> f64| {
        Statistics::of(stretches.iter().map(measure).collect())
    };
    Relative {
        delta,
        overlapping,
        translation_m: of(&|stretch| error(stretch).distance_m()),
        rotation_rad: of(&|stretch| error(stretch).angle_rad()),
        share: Statistics::of(shares.collect()),
    }
}

fn stretches(pairs: &[Pair], path: &[f64], delta: Delta, overlapping: bool) -> Vec<(usize, usize)> {
    let reached = |from: usize, to: usize| match delta {
        Delta::Meters(metres) => path[to] - path[from] >= metres,
        Delta::Seconds(seconds) => {
            // Half a microsecond of rounding in the recording's times must not extend the segment
            // by a pose.
            (pairs[to].time_ns - pairs[from].time_ns) as f64 * 1e-9 >= seconds - 5e-7
        }
        Delta::Poses(poses) => to - from >= poses,
    };
    let mut stretches = Vec::new();
    let (mut from, mut to) = (0, 0);
    while from < pairs.len() {
        // A later start reaches the delta later, so the end only moves forward.
        to = to.max(from + 1);
        while to < pairs.len() && !reached(from, to) {
            to += 1;
        }
        if to >= pairs.len() {
            break;
        }
        stretches.push((from, to));
        from = if overlapping { from + 1 } else { to };
    }
    stretches
}
