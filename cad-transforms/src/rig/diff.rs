//! What changed between two rigs.
//!
//! Contract: every frame of either rig is in the result, `rig` left out, sorted by name. A change
//! is a motion of the frame in its own axes, as the tolerances are, once as seen from `rig` and
//! once from its neighbour: a mount that was bent moves all that is attached to it in `rig`, but
//! one joint only.
//!
//! Everything else that a file holds is compared by [`other_changes`], in words. Numbers that
//! differ by rounding are the same, see [`ROUNDING`]; so are files that say the same in another
//! order, in other units or from the other end of a joint.

use super::{Closure, Rig, ShoeTag, Sole, Step, same_serial};
use crate::covariance::Covariance;
use crate::frame::Frame;
use crate::transform::RigidTransform;

/// What is less than this is rounding: m, rad, and as a share of tolerances and sizes.
pub const ROUNDING: f64 = 1e-9;

/// One frame in two rigs.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameDiff {
    /// Its name.
    pub frame: Frame,
    /// Its change.
    pub change: Change,
}

/// The change of a frame.
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

/// From where a frame was in the first rig to where it is in the second, in its own axes as they
/// were.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// `was_from_is`.
    pub motion: RigidTransform,
    /// Its length in sigmas, where a tolerance is known: of both rigs together if both state one.
    pub sigmas: Option<f64>,
}

impl Motion {
    /// Whether it is more than rounding.
    pub fn is_one(&self) -> bool {
        is_one(&self.motion)
    }
}

fn is_one(motion: &RigidTransform) -> bool {
    motion.distance_m() > ROUNDING || motion.angle_rad() > ROUNDING
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
    let covariance = |of: &Rig| of.covariance(from, frame).expect("the frame is in both");
    moved(&place(a), &place(b), covariance(a), covariance(b))
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
    // The second's covariance is given in axes that moved; to first order they are the same.
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

/// What changed besides the places of the frames, in words: names and provenance, devices, where
/// frames hang and with what tolerance, loops and shoe tags. A line each, without the rig's name.
pub fn other_changes(a: &Rig, b: &Rig) -> Vec<String> {
    let mut words = Vec::new();
    let mut text = |what: &str, was: Option<&str>, is: Option<&str>| match (was, is) {
        (Some(was), Some(is)) if was != is => words.push(format!("{what}: {was:?}, then {is:?}")),
        (Some(was), None) => words.push(format!("{what}: {was:?} in a only")),
        (None, Some(is)) => words.push(format!("{what}: {is:?} in b only")),
        _ => {}
    };
    text("name", Some(&a.name), Some(&b.name));
    text("revision", Some(&a.revision), Some(&b.revision));
    let (was, is) = (&a.provenance, &b.provenance);
    let kinds = [was, is].map(|p| Some(p.kind.as_str()));
    text("kind", kinds[0], kinds[1]);
    text("note", Some(&was.note), Some(&is.note));
    let cad = [was, is].map(|p| p.cad.as_ref());
    let files = cad.map(|cad| cad.map(|cad| cad.file.as_str()));
    text("CAD file", files[0], files[1]);
    let hashes = cad.map(|cad| cad.map(|cad| cad.blake3.as_str()));
    text("BLAKE3 of the CAD file", hashes[0], hashes[1]);

    let info = |rig: &Rig, name: &str| rig.cameras.iter().find(|info| info.name == name).cloned();
    let names = |rig: &Rig| {
        rig.cameras
            .iter()
            .map(|i| i.name.clone())
            .collect::<Vec<_>>()
    };
    let mut cameras = [names(a), names(b)].concat();
    cameras.sort();
    cameras.dedup();
    for camera in cameras {
        let infos = [a, b].map(|rig| info(rig, &camera));
        let models = infos.each_ref().map(|info| info.as_ref()?.model.as_deref());
        text(&format!("model of {camera}"), models[0], models[1]);
        let serials = infos
            .each_ref()
            .map(|info| info.as_ref()?.serial.as_deref());
        match serials {
            [Some(was), Some(is)] if same_serial(was, is) => {}
            [was, is] => text(&format!("serial of {camera}"), was, is),
        }
    }

    for (frame, was) in &a.towards_rig {
        if let Some(is) = b.towards_rig.get(frame) {
            joint(frame, was, is, &mut words);
        }
    }
    listed(
        (&a.closures, &b.closures),
        |closure| format!("loop of {} and {}", closure.parent, closure.child),
        loop_changes,
        &mut words,
    );
    listed(
        (&a.shoe_tags, &b.shoe_tags),
        |tag| format!("shoe tag {} {}", tag.family.as_str(), tag.id),
        tag_changes,
        &mut words,
    );
    listed(
        (&a.soles, &b.soles),
        |sole| format!("sole of {}", sole.foot.as_str()),
        sole_changes,
        &mut words,
    );
    words
}

/// The neighbour that a frame is attached to, and the tolerance there.
fn joint(frame: &Frame, was: &Step, is: &Step, words: &mut Vec<String>) {
    if was.next != is.next {
        let (was, is) = (&was.next, &is.next);
        words.push(format!("{frame} hangs on {was}, then on {is}"));
        return;
    }
    let what = format!("tolerance of {frame} on {}", is.next);
    match (&was.covariance, &is.covariance) {
        (Some(was), None) => words.push(format!("{what}: {} in a only", sigmas(was))),
        (None, Some(is)) => words.push(format!("{what}: {} in b only", sigmas(is))),
        (Some(was), Some(is)) if !same_covariance(was, is) => {
            let [old, new] = [was, is].map(sigmas);
            words.push(if old == new {
                format!("{what}: {old} as before, other correlations")
            } else {
                format!("{what}: {old}, then {new}")
            });
        }
        _ => {}
    }
}

fn same_covariance(a: &Covariance, b: &Covariance) -> bool {
    let (rows_a, rows_b, sigma) = (a.rows(), b.rows(), a.sigmas());
    let close = |i: usize, j: usize| {
        (rows_a[i][j] - rows_b[i][j]).abs() <= 2.0 * ROUNDING * sigma[i] * sigma[j]
    };
    (0..6).all(|i| (0..6).all(|j| close(i, j)))
}

/// Standard deviations: one number where three are the same.
fn sigmas(covariance: &Covariance) -> String {
    let all = covariance.sigmas();
    let three = |all: &[f64], to_unit: f64, unit: &str| {
        let shown: Vec<String> = all.iter().map(|v| short(v * to_unit)).collect();
        match shown.as_slice() {
            [x, y, z] if x == y && y == z => format!("{x} {unit}"),
            _ => format!("[{}] {unit}", shown.join(", ")),
        }
    };
    let turns = three(&all[3..], 1f64.to_degrees(), "deg");
    format!("{}, {turns}", three(&all[..3], 1e3, "mm"))
}

/// Six digits, without zeros at the end.
fn short(value: f64) -> String {
    let rounded: f64 = format!("{value:.5e}").parse().unwrap_or(value);
    format!("{rounded}")
}

/// Entries of the same name one after the other: what is in one rig only, and what changed.
fn listed<T>(
    (a, b): (&[T], &[T]),
    name: impl Fn(&T) -> String,
    changes: impl Fn(&T, &T) -> Vec<String>,
    words: &mut Vec<String>,
) {
    let mut names: Vec<String> = a.iter().chain(b).map(&name).collect();
    names.sort();
    names.dedup();
    for wanted in names {
        let [mut was, mut is] = [a, b].map(|all| all.iter().filter(|one| name(one) == wanted));
        loop {
            match (was.next(), is.next()) {
                (None, None) => break,
                (Some(_), None) => words.push(format!("{wanted}: in a only")),
                (None, Some(_)) => words.push(format!("{wanted}: in b only")),
                (Some(was), Some(is)) => {
                    let changes = changes(was, is).into_iter();
                    words.extend(changes.map(|change| format!("{wanted}: {change}")));
                }
            }
        }
    }
}

fn loop_changes(was: &Closure, is: &Closure) -> Vec<String> {
    [
        moved_by(&was.parent_from_child, &is.parent_from_child),
        number("within", 1e3 * was.within_m, 1e3 * is.within_m, "mm"),
        number(
            "within",
            was.within_rad.to_degrees(),
            is.within_rad.to_degrees(),
            "deg",
        ),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn tag_changes(was: &ShoeTag, is: &ShoeTag) -> Vec<String> {
    let feet = [was, is].map(|tag| tag.foot.as_str());
    [
        (feet[0] != feet[1]).then(|| format!("on {}, then on {}", feet[0], feet[1])),
        number("size", 1e3 * was.size_m, 1e3 * is.size_m, "mm"),
        moved_by(&was.foot_from_tag, &is.foot_from_tag),
        (was.size_sigma_m != is.size_sigma_m || was.covariance != is.covariance)
            .then(|| "tolerance changed".to_owned()),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn sole_changes(was: &Sole, is: &Sole) -> Vec<String> {
    let mut words = Vec::new();
    if was.outline_m != is.outline_m {
        words.push("outline changed".to_owned());
    }
    if was.sigma_m != is.sigma_m {
        words.push("tolerance changed".to_owned());
    }
    words
}

fn number(what: &str, was: f64, is: f64, unit: &str) -> Option<String> {
    let same = (was - is).abs() <= ROUNDING * was.abs();
    (!same).then(|| format!("{what} {} {unit}, then {} {unit}", short(was), short(is)))
}

fn moved_by(was: &RigidTransform, is: &RigidTransform) -> Option<String> {
    let motion = was.inverse() * *is;
    is_one(&motion).then(|| {
        format!(
            "moved by {:.3} mm and {:.4} deg",
            1e3 * motion.distance_m(),
            motion.angle_rad().to_degrees()
        )
    })
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

    /// Every key of a file, changed one at a time.
    #[test]
    fn every_change_is_reported() {
        let tag = "[[shoe_tag]]\nfamily = \"36h11\"\nid = 3\nfoot = \"left_foot\"\nsize_m = 0.06\n\
                   rotation_wxyz = [1, 0, 0, 0]\ntranslation_m = [0.08, 0, 0.075]\n";
        let closure = "[[closes_loop]]\nparent = \"a/right\"\nchild = \"a/left\"\nrotation_wxyz = [1, 0, 0, 0]\n\
                       translation_m = [-0.1, 0, 0]\nwithin_mm = 0.5\nwithin_deg = 0.1\n";
        let camera = "[[camera]]\nname = \"a\"\nserial = \"0123\"\nmodel = \"ZED Mini\"\n";
        let sure = format!("{PLAIN}{TOLERANCE}");
        let tree = file(&[("rig", "a/left", &sure), ("a/left", "a/right", PLAIN)]);
        let text = format!("{tree}{camera}{closure}{tag}");
        let a = Rig::parse(&text).unwrap();
        assert_eq!(other_changes(&a, &a), Vec::<String>::new());
        // The same in other words.
        let same = text
            .replace(
                "sigma_translation_mm = 1\n",
                "sigma_translation_m = 0.001\n",
            )
            .replace(
                "sigma_rotation_deg = 0.1",
                "sigma_rotation_rad = 0.0017453292519943296",
            )
            .replace("within_deg = 0.1", "within_rad = 0.0017453292519943295")
            .replace("\"0123\"", "123");
        assert_ne!(same, text);
        assert_eq!(
            other_changes(&a, &Rig::parse(&same).unwrap()),
            Vec::<String>::new()
        );

        for (from, to, expected) in [
            (
                "kind = \"nominal\"",
                "kind = \"measured\"",
                "kind: \"nominal\", then \"measured\"",
            ),
            ("\"0123\"", "124", "serial of a: \"0123\", then \"124\""),
            ("serial = \"0123\"\n", "", "serial of a: \"0123\" in a only"),
            (
                camera,
                "[[camera]]\nname = \"a\"\nserial = 123\n",
                "model of a: \"ZED Mini\" in a only",
            ),
            (
                TOLERANCE,
                "",
                "tolerance of a/left on rig: 1 mm, 0.1 deg in a only",
            ),
            (
                "sigma_rotation_deg = 0.1",
                "sigma_rotation_deg = [0.1, 0.25, 0.1]",
                "tolerance of a/left on rig: 1 mm, 0.1 deg, then 1 mm, [0.1, 0.25, 0.1] deg",
            ),
            (closure, "", "loop of a/right and a/left: in a only"),
            (
                "within_mm = 0.5",
                "within_mm = 0.6",
                "loop of a/right and a/left: within 0.5 mm, then 0.6 mm",
            ),
            (
                "[-0.1, 0, 0]",
                "[-0.1, 0.0002, 0]",
                "loop of a/right and a/left: moved by 0.200 mm and 0.0000 deg",
            ),
            (tag, "", "shoe tag 36h11 3: in a only"),
            (
                "left_foot",
                "right_foot",
                "shoe tag 36h11 3: on left_foot, then on right_foot",
            ),
            ("0.06", "0.05", "shoe tag 36h11 3: size 60 mm, then 50 mm"),
            (
                "0.075]",
                "0.076]",
                "shoe tag 36h11 3: moved by 1.000 mm and 0.0000 deg",
            ),
        ] {
            let changed = text.replace(from, to);
            assert_ne!(changed, text, "{from}");
            let b = Rig::parse(&changed).unwrap();
            assert_eq!(other_changes(&a, &b), [expected]);
            // Frames stay where they are, and the comparison in the other direction reports it too.
            assert!(
                diff(&a, &b)
                    .iter()
                    .all(|d| matches!(&d.change, Change::Moved { in_rig, .. } if !in_rig.is_one()))
            );
            assert_eq!(other_changes(&b, &a).len(), 1);
        }
        let cad = format!(
            "cad_file = \"p.step\"\ncad_blake3 = \"{}\"\n",
            "0a".repeat(32)
        );
        let b = a
            .clone()
            .with_revision("D")
            .to_toml()
            .replace("[provenance]\n", &format!("[provenance]\n{cad}"));
        let b = Rig::parse(&b).unwrap();
        let words = other_changes(&a, &b);
        assert_eq!(words.len(), 3, "{words:?}");
        assert!(
            words[0].starts_with("revision: ") && words[1] == "CAD file: \"p.step\" in b only",
            "{words:?}"
        );
        // A lens that was hung on another frame, at the same place.
        let hung = "rotation_wxyz = [1, 0, 0, 0]\ntranslation_m = [0.2, 0, 0]";
        let b = text
            .replace("parent = \"a/left\"", "parent = \"rig\"")
            .replacen(PLAIN, hung, 2);
        let b = b.replacen(&format!("{hung}{TOLERANCE}"), &sure, 1);
        let b = Rig::parse(&b).unwrap();
        assert_eq!(
            other_changes(&a, &b),
            ["a/right hangs on a/left, then on rig"]
        );
    }
}
