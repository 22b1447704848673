//! What changed between two rigs.
//!
//! Contract: every frame of either rig is in the result, `rig` left out, sorted by name. A change is a motion of the
//! frame in its own axes, as the tolerances are, once as seen from `rig` and once from its neighbour: a mount that
//! was bent moves all that hangs on it in `rig`, but one joint only.

use super::{Rig, Step};
use crate::covariance::Covariance;
use crate::frame::Frame;
use crate::transform::RigidTransform;

/// One frame in two rigs.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameDiff {
    /// Its name.
    pub frame: Frame,
    /// What became of it.
    pub change: Change,
}

/// What became of a frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// It is in the second rig only.
    Added,
    /// It is in the first rig only.
    Removed,
    /// It is in both.
    Moved {
        /// Seen from `rig`.
        in_rig: Motion,
        /// Seen from its neighbour towards `rig`, where that is the same frame in both.
        in_neighbour: Option<(Frame, Motion)>,
    },
}

/// From where a frame was in the first rig to where it is in the second, in its own axes as they were.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// `was_from_is`.
    pub motion: RigidTransform,
    /// Its length in sigmas, where a tolerance is known: of both rigs together if both state one.
    pub sigmas: Option<f64>,
}

/// All frames of both rigs.
pub fn diff(a: &Rig, b: &Rig) -> Vec<FrameDiff> {
    let mut frames: Vec<Frame> = a.frames().chain(b.frames()).collect();
    frames.sort();
    frames.dedup();
    let rig = Frame::rig();
    let known = frames.into_iter().filter(|frame| *frame != rig);
    known
        .map(|frame| {
            let step = |of: &Rig| of.towards_rig.get(&frame).cloned();
            let change = match (step(a), step(b)) {
                (None, _) => Change::Added,
                (_, None) => Change::Removed,
                (Some(was), Some(is)) => Change::Moved {
                    in_rig: motion(a, b, &rig, &frame),
                    in_neighbour: in_neighbour(&was, &is),
                },
            };
            FrameDiff { frame, change }
        })
        .collect()
}

fn motion(a: &Rig, b: &Rig, from: &Frame, frame: &Frame) -> Motion {
    let place = |of: &Rig| of.transform(from, frame).expect("the frame is in both");
    let doubt = |of: &Rig| of.covariance(from, frame).expect("the frame is in both");
    moved(&place(a), &place(b), doubt(a), doubt(b))
}

fn in_neighbour(was: &Step, is: &Step) -> Option<(Frame, Motion)> {
    (was.next == is.next).then(|| {
        let (a, b) = (&was.next_from_this, &is.next_from_this);
        (was.next.clone(), moved(a, b, was.covariance, is.covariance))
    })
}

fn moved(
    was: &RigidTransform,
    is: &RigidTransform,
    doubt_was: Option<Covariance>,
    doubt_is: Option<Covariance>,
) -> Motion {
    let motion = was.inverse() * *is;
    // The second's doubt is written in axes that moved; to first order they are the same.
    let covariance = match (doubt_was, doubt_is) {
        (Some(a), Some(b)) => Some(a.plus(&b)),
        (one, other) => one.or(other),
    };
    let [x, y, z] = motion.translation_m();
    let [u, v, w] = motion.rotation_vector();
    Motion {
        motion,
        sigmas: covariance.map(|c| c.distance([x, y, z, u, v, w])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::tests::{file, frame};

    const PLAIN: &str = "rotation_wxyz = [1, 0, 0, 0]\ntranslation_m = [0.1, 0, 0]";
    const TOLERANCE: &str = "\nsigma_translation_mm = 1\nsigma_rotation_deg = 0.1";

    #[test]
    fn a_bent_mount_moves_what_hangs_on_it() {
        let sure = format!("{PLAIN}{TOLERANCE}");
        let a = file(&[
            ("rig", "a/left", &sure),
            ("a/left", "a/right", PLAIN),
            ("rig", "b/left", PLAIN),
        ]);
        let a = Rig::parse(&a).unwrap();
        let half = 0.25_f64.to_radians();
        let bent = format!(
            "rotation_wxyz = [{:?}, 0, {:?}, 0]\ntranslation_m = [0.1, 0, 0]{TOLERANCE}",
            half.cos(),
            half.sin()
        );
        let b = file(&[
            ("rig", "a/left", &bent),
            ("a/left", "a/right", PLAIN),
            ("rig", "c/left", PLAIN),
        ]);
        let b = Rig::parse(&b).unwrap();
        let found = diff(&a, &b);
        let names: Vec<&str> = found.iter().map(|d| d.frame.as_str()).collect();
        assert_eq!(names, ["a/left", "a/right", "b/left", "c/left"]);
        assert_eq!(
            (&found[2].change, &found[3].change),
            (&Change::Removed, &Change::Added)
        );
        let Change::Moved { in_rig, .. } = &found[0].change else {
            panic!()
        };
        assert!((in_rig.motion.angle_rad().to_degrees() - 0.5).abs() < 1e-9);
        assert!(in_rig.motion.distance_m() < 1e-15);
        // 0.5 degrees against 0.1 degrees twice.
        assert!(
            (in_rig.sigmas.unwrap() - 5.0 / 2_f64.sqrt()).abs() < 1e-6,
            "{in_rig:?}"
        );
        let Change::Moved {
            in_rig,
            in_neighbour,
        } = &found[1].change
        else {
            panic!()
        };
        // The right lens swings on a lever of 10 cm; its own joint is as it was.
        assert!(
            (1e3 * in_rig.motion.distance_m() - 0.872_66).abs() < 1e-4,
            "{in_rig:?}"
        );
        assert_eq!(in_rig.sigmas, None);
        let (neighbour, joint) = in_neighbour.as_ref().unwrap();
        assert_eq!(*neighbour, frame("a/left"));
        assert_eq!(
            (joint.motion.distance_m(), joint.motion.angle_rad()),
            (0.0, 0.0)
        );
        assert!(diff(&a, &a).iter().all(|d| matches!(&d.change, Change::Moved { in_rig, .. } if in_rig.motion.distance_m() < 1e-15)));
    }
}
