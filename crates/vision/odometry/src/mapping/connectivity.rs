//! Connectivity of poses with the first pose.
//!
//! At a tracking loss the trajectory breaks: the translation and rotation meanwhile are unknown,
//! and later observations do not determine them. Keyframes on both sides are optimized by their own
//! observations; between them there is a constant-velocity factor, as wide as the covariance of the
//! causal pose. Only a loop closure connects them.

use super::MappingResult;

/// Connectivity of a pose with the first one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Connectivity {
    /// Without a tracking loss in between.
    Continuous,
    /// Through loop closures, possibly through other spans.
    LoopClosed,
    /// Only by a guess: the pose was lost, or it came after a tracking loss. Its covariance is that
    /// of the causal pose, which also holds where gravity was initialized again.
    Unconstrained,
}

impl MappingResult {
    /// Connectivity of all poses. `causal` gives their times (ns, ascending) and whether the
    /// estimator reported them as lost. If bundle adjustment did not converge, none of its
    /// covariances holds.
    ///
    /// ```
    /// use odometry::mapping::Connectivity::{Continuous, Unconstrained};
    /// use odometry::{Config, Mapping, Preset, Rig};
    /// # use cad_transforms::RigidTransform;
    /// # use camera_models::{CameraModel, Distortion};
    /// # use odometry::rig::StereoCamera;
    /// # let lens = CameraModel::new((160, 120), [100.0, 100.0, 79.5, 59.5], Distortion::None);
    /// # let camera = StereoCamera {
    /// #     name: "front".to_owned(),
    /// #     left: lens,
    /// #     right: lens,
    /// #     rig_from_left: RigidTransform::identity(),
    /// #     covariance: None,
    /// #     right_from_left: RigidTransform::from_translation_m([-0.08, 0.0, 0.0])?,
    /// #     right_from_left_covariance: None,
    /// #     line_s: 0.0,
    /// # };
    /// # let rig = Rig { cameras: vec![camera], imus: Vec::new() };
    /// let refined = Mapping::new(&rig, &Config::preset(Preset::Fast)).optimize(|_| {});
    /// // The second pose was lost, and no loop closure connects what follows with the first one.
    /// let causal = [(0, false), (1, true), (2, false)];
    /// assert_eq!(refined.connectivity(&causal), [Continuous, Unconstrained, Unconstrained]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
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

/// Connectivity with the times of loop closures, ns.
fn connectivity(causal: &[(i64, bool)], loops: &[[i64; 2]]) -> Vec<Connectivity> {
    // Index of the continuous span of each pose; `None` where it was lost.
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
    // A span may be connected through others: each iteration connects at least one more, or ends
    // the loop.
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
    fn only_loop_closures_connect_poses_after_a_tracking_loss() {
        use Connectivity::{Continuous, LoopClosed, Unconstrained};
        let is_lost = [false, true, false, false, true, true, false, true, false];
        let causal: Vec<(i64, bool)> = (0..).zip(is_lost).collect();
        let mut expected = [Unconstrained; 9];
        expected[0] = Continuous;
        assert_eq!(connectivity(&causal, &[]), expected);
        // A closure with an unconnected span does not connect.
        assert_eq!(connectivity(&causal, &[[6, 8]]), expected);
        // The last span is connected through the second, the third is not connected.
        for k in [2, 3, 8] {
            expected[k] = LoopClosed;
        }
        assert_eq!(connectivity(&causal, &[[3, 8], [0, 2]]), expected);
        assert_eq!(connectivity(&[], &[]), []);
    }

    #[test]
    fn unconverged_solution_leaves_poses_unconstrained() {
        let causal = [(0, false), (1, false)];
        let mut adjusted = MappingResult {
            poses: Vec::new(),
            loop_closures: Vec::new(),
            iterations: 30,
            is_converged: true,
            landmarks: 0,
            extrinsics: Vec::new(),
            stereo: Vec::new(),
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
    fn trajectory_that_starts_lost_begins_at_the_first_tracked_pose() {
        let causal = [(0, true), (1, false)];
        assert_eq!(
            connectivity(&causal, &[]),
            [Connectivity::Unconstrained, Connectivity::Continuous]
        );
    }
}
