//! Loop closures: second paths to the same frame.

use std::ops::Range;

use super::file::{frame, transform};
use super::table::{Log, Table, positive};
use super::tolerance::{Units, in_units};
use super::{Problem, Rig};
use crate::frame::Frame;
use crate::transform::RigidTransform;

/// A transform that closes a loop: measured or drawn apart from the tree, it has to agree with it.
#[derive(Clone, Debug, PartialEq)]
pub struct Closure {
    /// Frame the transform leads to.
    pub parent: Frame,
    /// Frame the transform starts from.
    pub child: Frame,
    /// Takes coordinates in `child` to coordinates in `parent`.
    pub parent_from_child: RigidTransform,
    /// Maximum distance of the two positions of `child`, m.
    pub within_m: f64,
    /// Maximum rotation between the two, rad.
    pub within_rad: f64,
}

impl Rig {
    /// The loops that do not close within what they state, in words; empty for a rig that was read
    /// from a file. A rig with changed entries ([`Rig::with_edge`]) may have some.
    pub fn open_loops(&self) -> Vec<String> {
        self.closures
            .iter()
            .filter_map(|closure| objection(self, closure))
            .collect()
    }
}

const WITHIN_M: Units = [("within_m", 1.0), ("within_mm", 1e-3)];
const WITHIN_RAD: Units = [
    ("within_rad", 1.0),
    ("within_deg", std::f64::consts::PI / 180.0),
];

/// All entries that could be read.
pub(super) fn closures(root: &Table<'_, '_>, log: &mut Log<'_>) -> Vec<(Range<usize>, Closure)> {
    let mut closures = Vec::new();
    let name = "[[closes_loop]]";
    for table in root.optional_entries("closes_loop", name, "entries [[closes_loop]]", log) {
        if let Some(closure) = closure(&table, log) {
            closures.push((table.at, closure));
        }
    }
    closures
}

fn closure(table: &Table<'_, '_>, log: &mut Log<'_>) -> Option<Closure> {
    table.refuse_unknown(
        &[
            "parent",
            "child",
            "rotation_wxyz",
            "rotation_rows",
            "translation_m",
            "within_m",
            "within_mm",
            "within_rad",
            "within_deg",
        ],
        log,
    );
    let parent = frame(table, "parent", log);
    let child = frame(table, "child", log);
    let transform = transform(table, log);
    let expected = "a number above 0";
    let within_m = in_units(table, &WITHIN_M, log, positive, expected, None);
    let within_rad = in_units(table, &WITHIN_RAD, log, positive, expected, None);
    Some(Closure {
        parent: parent?,
        child: child?,
        parent_from_child: transform?,
        within_m: within_m?.1,
        within_rad: within_rad?.1,
    })
}

/// Why a loop does not close.
pub(super) fn objection(rig: &Rig, closure: &Closure) -> Option<String> {
    let tree = match rig.transform(&closure.parent, &closure.child) {
        Ok(tree) => tree,
        Err(_) => {
            let missing =
                [&closure.parent, &closure.child].map(|frame| (frame, rig.way_to_rig(frame)));
            let (frame, _) = missing.into_iter().find(|(_, way)| way.is_err())?;
            return Some(format!(
                "{frame} is in no [[parent_from_child]] connected to rig"
            ));
        }
    };
    let closing_from_tree = closure.parent_from_child.inverse() * tree;
    let (off_m, off_rad) = (
        closing_from_tree.distance_m(),
        closing_from_tree.angle_rad(),
    );
    (off_m > closure.within_m || off_rad > closure.within_rad).then(|| {
        format!(
            "the loop of {} and {} does not close: the other way round is off by {:.3} mm and {:.4} deg, \
             allowed are {:.3} mm and {:.4} deg",
            closure.parent,
            closure.child,
            1e3 * off_m,
            off_rad.to_degrees(),
            1e3 * closure.within_m,
            closure.within_rad.to_degrees()
        )
    })
}

/// All loops of `rig` that do not close, as problems without a line.
pub(super) fn problems(rig: &Rig) -> Vec<Problem> {
    let problem = |message| Problem { line: 0, message };
    rig.open_loops().into_iter().map(problem).collect()
}
