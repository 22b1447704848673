//! What hangs together with the first pose.
//!
//! Where the way was lost it breaks: how far the body went and turned meanwhile is not known, and nothing that was seen afterwards
//! tells it. Keyframes on both sides are adjusted all the same, each by what it saw, and no equation there knows how
//! wrong the step between them may be. Only a place seen again ties them.

use super::Adjusted;

/// How a pose hangs together with the first one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tie {
    /// Without a break.
    Unbroken,
    /// By places seen again, if need be by way of others.
    SeenAgain,
    /// By nothing but a guess: it was lost, or it came after a loss. What the adjustment says of its covariance is too little;
    /// what was said of the causal pose holds.
    Guessed,
}

impl Adjusted {
    /// Of all poses: their times (ns, rising), and whether they were lost when they were found first. Where the adjustment did not
    /// converge no covariance of it holds.
    pub fn ties(&self, causal: &[(i64, bool)]) -> Vec<Tie> {
        if !self.is_converged {
            return vec![Tie::Guessed; causal.len()];
        }
        let time = |number: u64| {
            let at = self.poses.binary_search_by_key(&number, |p| p.number);
            Some(self.poses[at.ok()?].time_ns)
        };
        let both = self.loops.iter().filter_map(|l| {
            let [earlier, later] = l.frames.map(time);
            Some([earlier?, later?])
        });
        ties(causal, &both.collect::<Vec<_>>())
    }
}

/// With the times of places seen again, ns.
fn ties(causal: &[(i64, bool)], loops: &[[i64; 2]]) -> Vec<Tie> {
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
    let mut is_tied = vec![false; count];
    if let Some(first) = is_tied.first_mut() {
        *first = true;
    }
    // A tie may go by way of others: each round ties at least one more, or it is over.
    for _ in 0..count {
        for (a, b) in &pairs {
            let either = is_tied[*a] || is_tied[*b];
            is_tied[*a] = either;
            is_tied[*b] = either;
        }
    }
    let tie = |span: &Option<usize>| match span {
        Some(0) => Tie::Unbroken,
        Some(span) if is_tied[*span] => Tie::SeenAgain,
        _ => Tie::Guessed,
    };
    spans.iter().map(tie).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_places_seen_again_tie_what_came_after_a_loss() {
        use Tie::{Guessed, SeenAgain, Unbroken};
        let is_lost = [false, true, false, false, true, true, false, true, false];
        let causal: Vec<(i64, bool)> = (0..).zip(is_lost).collect();
        let mut expected = [Guessed; 9];
        expected[0] = Unbroken;
        assert_eq!(ties(&causal, &[]), expected);
        // A tie to what is itself not tied is none.
        assert_eq!(ties(&causal, &[[6, 8]]), expected);
        // The last span is tied by way of the second, the third by nothing.
        for k in [2, 3, 8] {
            expected[k] = SeenAgain;
        }
        assert_eq!(ties(&causal, &[[3, 8], [0, 2]]), expected);
        assert_eq!(ties(&[], &[]), []);
    }

    #[test]
    fn what_did_not_converge_ties_nothing() {
        let causal = [(0, false), (1, false)];
        let mut adjusted = Adjusted {
            poses: Vec::new(),
            loops: Vec::new(),
            rounds: 30,
            is_converged: true,
            landmarks: 0,
            mounts: Vec::new(),
        };
        assert_eq!(adjusted.ties(&causal), [Tie::Unbroken; 2]);
        adjusted.is_converged = false;
        assert_eq!(adjusted.ties(&causal), [Tie::Guessed; 2]);
    }

    #[test]
    fn what_begins_lost_begins_when_it_is_found() {
        let causal = [(0, true), (1, false)];
        assert_eq!(ties(&causal, &[]), [Tie::Guessed, Tie::Unbroken]);
    }
}
