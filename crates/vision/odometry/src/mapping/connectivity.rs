//! What hangs together with the first pose.
//!
//! Where the way was lost it breaks: how far the body went and turned meanwhile is not known, and nothing that was seen afterwards
//! tells it. Keyframes on both sides are adjusted all the same, each by what it saw, and no equation there knows how
//! wrong the step between them may be. Only a place seen again ties them.

use super::Refined;

/// How a pose hangs together with the first one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Connectivity {
    /// Without a break.
    Continuous,
    /// By places seen again, if need be by way of others.
    LoopClosed,
    /// By nothing but a guess: it was lost, or it came after a loss. What the adjustment says of its covariance is too little;
    /// what was said of the causal pose holds.
    Unconstrained,
}

impl Refined {
    /// Of all poses: their times (ns, rising), and whether they were lost when they were found first. Where the adjustment did not
    /// converge no covariance of it holds.
    pub fn connectivity(&self, causal: &[(i64, bool)]) -> Vec<Connectivity> {
        if !self.is_converged {
            return vec![Connectivity::Unconstrained; causal.len()];
        }
        let time = |number: u64| {
            let at = self.poses.binary_search_by_key(&number, |p| p.number);
            Some(self.poses[at.ok()?].time_ns)
        };
        let both = self.loop_closures.iter().filter_map(|l| {
            let [earlier, later] = l.frames.map(time);
            Some([earlier?, later?])
        });
        connectivity(causal, &both.collect::<Vec<_>>())
    }
}

/// With the times of places seen again, ns.
fn connectivity(causal: &[(i64, bool)], loops: &[[i64; 2]]) -> Vec<Connectivity> {
    // Number of the unbroken span of each pose; none where it was lost.
    let mut count = 0;
    let mut was_lost = true;
    let spans: Vec<Option<usize>> = (causal.iter())
        .map(|(_, is_lost)| {
            count += usize::from(was_lost && !is_lost);
            was_lost = *is_lost;
            (!is_lost).then(|| count - 1)
        })
        .collect();
    let of = |time: i64| {
        let at = causal.binary_search_by_key(&time, |c| c.0);
        spans[at.ok()?]
    };
    let pairs: Vec<(usize, usize)> = (loops.iter())
        .filter_map(|[a, b]| Some((of(*a)?, of(*b)?)))
        .collect();
    let mut is_connected = vec![false; count];
    if let Some(first) = is_connected.first_mut() {
        *first = true;
    }
    // A tie may go by way of others: each round ties at least one more, or it is over.
    for _ in 0..count {
        for (a, b) in &pairs {
            let either = is_connected[*a] || is_connected[*b];
            is_connected[*a] = either;
            is_connected[*b] = either;
        }
    }
    let connectivity = |span: &Option<usize>| match span {
        Some(0) => Connectivity::Continuous,
        Some(span) if is_connected[*span] => Connectivity::LoopClosed,
        _ => Connectivity::Unconstrained,
    };
    spans.iter().map(connectivity).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_places_seen_again_tie_what_came_after_a_loss() {
        use Connectivity::{Continuous, LoopClosed, Unconstrained};
        let is_lost = [false, true, false, false, true, true, false, true, false];
        let causal: Vec<(i64, bool)> = (0..).zip(is_lost).collect();
        let mut expected = [Unconstrained; 9];
        expected[0] = Continuous;
        assert_eq!(connectivity(&causal, &[]), expected);
        // A tie to what is itself not tied is none.
        assert_eq!(connectivity(&causal, &[[6, 8]]), expected);
        // The last span is tied by way of the second, the third by nothing.
        for k in [2, 3, 8] {
            expected[k] = LoopClosed;
        }
        assert_eq!(connectivity(&causal, &[[3, 8], [0, 2]]), expected);
        assert_eq!(connectivity(&[], &[]), []);
    }

    #[test]
    fn what_did_not_converge_ties_nothing() {
        let causal = [(0, false), (1, false)];
        let mut adjusted = Refined {
            poses: Vec::new(),
            loop_closures: Vec::new(),
            iterations: 30,
            is_converged: true,
            landmarks: 0,
            extrinsics: Vec::new(),
        };
        assert_eq!(
            adjusted.connectivity(&causal),
            [Connectivity::Continuous; 2]
        );
        adjusted.is_converged = false;
        assert_eq!(
            adjusted.connectivity(&causal),
            [Connectivity::Unconstrained; 2]
        );
    }

    #[test]
    fn what_begins_lost_begins_when_it_is_found() {
        let causal = [(0, true), (1, false)];
        assert_eq!(
            connectivity(&causal, &[]),
            [Connectivity::Unconstrained, Connectivity::Continuous]
        );
    }
}
