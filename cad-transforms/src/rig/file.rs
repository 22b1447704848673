//! Reading the rig file. Goes on after every mistake, so that one run shows them all; checks of the
//! tree as a whole come last and use the entries that could be read.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::ops::Range;

use toml::de::DeTable;

use super::table::{Log, Table, integer, line_of, list_of, numbers, rows, table_of, text_of};
use super::tags;
use super::{Edge, Problem, Problems, Provenance, ProvenanceKind, RIG_FORMAT, Rig, Step};
use crate::frame::{Frame, FramePart};
use crate::transform::RigidTransform;

pub(super) fn parse(text: &str) -> Result<Rig, Problems> {
    let document = match DeTable::parse(text) {
        Ok(document) => document,
        Err(error) => {
            let line = line_of(text, error.span().map_or(0, |span| span.start));
            return Err(Problems(vec![Problem {
                line,
                message: format!("not TOML: {}", error.message()),
            }]));
        }
    };
    let mut log = Log {
        text,
        problems: Vec::new(),
    };
    let root = Table {
        table: document.get_ref(),
        at: 0..0,
        name: "the rig file",
    };
    root.refuse_unknown(
        &[
            "format",
            "name",
            "revision",
            "provenance",
            "parent_from_child",
            "shoe_tag",
        ],
        &mut log,
    );

    // A newer format may mean anything by its keys: say so first and alone.
    if let Some((at, format)) = root.get("format", &mut log, integer, "an integer")
        && format != RIG_FORMAT
    {
        log.problems.clear();
        log.add(
            at,
            format!("format is {format}, this program reads {RIG_FORMAT}"),
        );
        return Err(Problems(log.problems));
    }
    let name = root.get("name", &mut log, text_of, "a text that is not empty");
    let revision = root.get("revision", &mut log, text_of, "a text that is not empty");
    let provenance = provenance(&root, &mut log);
    let edges = edges(&root, &mut log);
    check_cameras(&edges, &mut log);
    let towards_rig = check_tree(&edges, &mut log);
    let shoe_tags = tags::shoe_tags(&root, &mut log);

    match (name, revision, provenance) {
        (Some((_, name)), Some((_, revision)), Some(provenance)) if log.problems.is_empty() => {
            Ok(Rig {
                name,
                revision,
                provenance,
                edges: edges.into_iter().map(|(_, edge)| edge).collect(),
                towards_rig,
                shoe_tags,
            })
        }
        _ => {
            log.problems.sort_by_key(|problem| problem.line);
            Err(Problems(log.problems))
        }
    }
}

fn provenance(root: &Table<'_, '_>, log: &mut Log<'_>) -> Option<Provenance> {
    let (at, table) = root.get("provenance", log, table_of, "a table with kind and note")?;
    let table = Table {
        table,
        at,
        name: "[provenance]",
    };
    table.refuse_unknown(&["kind", "note"], log);
    let note = table.get("note", log, text_of, "a text that is not empty");
    let (at, kind) = table.get("kind", log, text_of, "a text that is not empty")?;
    let known = ProvenanceKind::ALL.map(ProvenanceKind::as_str);
    match ProvenanceKind::ALL.into_iter().find(|k| k.as_str() == kind) {
        Some(kind) => Some(Provenance {
            kind,
            note: note?.1,
        }),
        None => {
            log.add(
                at,
                format!("kind is {kind:?}, expected one of {}", known.join(", ")),
            );
            None
        }
    }
}

/// The entries that could be read, each with its place.
fn edges(root: &Table<'_, '_>, log: &mut Log<'_>) -> Vec<(Range<usize>, Edge)> {
    let entries = root.get(
        "parent_from_child",
        log,
        list_of,
        "entries [[parent_from_child]]",
    );
    let mut edges = Vec::new();
    for entry in entries.map(|(_, entries)| entries).unwrap_or_default() {
        let Some(table) = entry.get_ref().as_table() else {
            log.add(
                entry.span(),
                "parent_from_child holds something that is not a table".to_owned(),
            );
            continue;
        };
        let table = Table {
            table,
            at: entry.span(),
            name: "[[parent_from_child]]",
        };
        if let Some(edge) = edge(&table, log) {
            edges.push((table.at, edge));
        }
    }
    edges
}

fn edge(table: &Table<'_, '_>, log: &mut Log<'_>) -> Option<Edge> {
    table.refuse_unknown(
        &[
            "parent",
            "child",
            "rotation_wxyz",
            "rotation_rows",
            "translation_m",
        ],
        log,
    );
    let parent = frame(table, "parent", log);
    let child = frame(table, "child", log);
    let transform = transform(table, log);
    let edge = Edge {
        parent: parent?,
        child: child?,
        parent_from_child: transform?,
    };
    if edge.parent == edge.child {
        log.add(
            table.at.clone(),
            format!("{} is its own parent", edge.child),
        );
        return None;
    }
    Some(edge)
}

/// The rotation, in one of its two forms, and the translation of an entry.
pub(super) fn transform(table: &Table<'_, '_>, log: &mut Log<'_>) -> Option<RigidTransform> {
    let translation = table.get("translation_m", log, numbers::<3>, "three finite numbers");
    let has = |key: &str| table.table.contains_key(key);
    let transform = match (has("rotation_wxyz"), has("rotation_rows")) {
        (true, true) | (false, false) => {
            let found = if has("rotation_wxyz") {
                "both"
            } else {
                "neither"
            };
            log.add(
                table.at.clone(),
                format!(
                    "{found} of rotation_wxyz and rotation_rows in {}, expected exactly one",
                    table.name
                ),
            );
            None
        }
        (true, false) => {
            let rotation = table.get(
                "rotation_wxyz",
                log,
                numbers::<4>,
                "four finite numbers, w first",
            );
            rotation.map(|(at, wxyz)| {
                (
                    at,
                    RigidTransform::from_wxyz(wxyz, translation_or_zero(&translation)),
                )
            })
        }
        (false, true) => {
            let rotation = table.get(
                "rotation_rows",
                log,
                rows,
                "three rows of three finite numbers",
            );
            rotation.map(|(at, rows)| {
                (
                    at,
                    RigidTransform::from_rotation_rows(rows, translation_or_zero(&translation)),
                )
            })
        }
    };
    let transform = transform
        .and_then(|(at, result)| result.map_err(|error| log.add(at, error.to_string())).ok());
    translation?;
    transform
}

/// A rotation is checked even where the translation is missing or misspelt.
fn translation_or_zero(translation: &Option<(Range<usize>, [f64; 3])>) -> [f64; 3] {
    translation.as_ref().map_or([0.0; 3], |(_, value)| *value)
}

fn frame(table: &Table<'_, '_>, key: &'static str, log: &mut Log<'_>) -> Option<Frame> {
    let (at, name) = table.get(key, log, text_of, "the name of a frame")?;
    match name.parse::<Frame>() {
        Ok(frame) if frame == Frame::world() => {
            log.add(at, format!("{key} is world, but the rig moves in the world: only frames fixed to the plate belong here"));
            None
        }
        Ok(frame) => Some(frame),
        Err(error) => {
            log.add(at, error.to_string());
            None
        }
    }
}

fn check_cameras(edges: &[(Range<usize>, Edge)], log: &mut Log<'_>) {
    let frames: BTreeSet<&Frame> = edges
        .iter()
        .flat_map(|(_, e)| [&e.parent, &e.child])
        .collect();
    let mut reported = BTreeSet::new();
    for (at, edge) in edges {
        for frame in [&edge.parent, &edge.child] {
            let Some((camera, _)) = frame.camera() else {
                continue;
            };
            let left =
                Frame::of_camera(camera, FramePart::Left).expect("the camera's name is valid");
            if !frames.contains(&left) && reported.insert(camera) {
                log.add(
                    at.clone(),
                    format!(
                        "{frame} is there but {left} is not: the left frame is a camera's reference"
                    ),
                );
            }
        }
    }
}

/// Reports duplicated edges, loops and frames without a connection to `rig`; returns each frame's
/// step towards `rig`.
fn check_tree(edges: &[(Range<usize>, Edge)], log: &mut Log<'_>) -> BTreeMap<Frame, Step> {
    // `group` merges as edges come in; an edge inside one group closes a loop.
    let mut group: BTreeMap<&Frame, usize> = BTreeMap::new();
    let mut tree: Vec<&Edge> = Vec::new();
    for (i, (at, edge)) in edges.iter().enumerate() {
        let same = |(_, other): &&(Range<usize>, Edge)| {
            (&other.parent, &other.child) == (&edge.parent, &edge.child)
                || (&other.child, &other.parent) == (&edge.parent, &edge.child)
        };
        if let Some((first_at, _)) = edges[..i].iter().find(same) {
            let line = log.line(first_at);
            log.add(
                at.clone(),
                format!(
                    "{} and {} are already connected on line {line}",
                    edge.parent, edge.child
                ),
            );
            continue;
        }
        let next = group.len();
        let parent = *group.entry(&edge.parent).or_insert(next);
        let next = group.len();
        let child = *group.entry(&edge.child).or_insert(next);
        if parent == child {
            log.add(
                at.clone(),
                format!("connecting {} and {} closes a loop: they are connected already through other frames", edge.parent, edge.child),
            );
            continue;
        }
        group
            .values_mut()
            .filter(|g| **g == child)
            .for_each(|g| *g = parent);
        tree.push(edge);
    }

    let mut towards_rig = BTreeMap::new();
    let mut front = VecDeque::from([Frame::rig()]);
    while let Some(here) = front.pop_front() {
        for edge in &tree {
            let (far, here_from_far) = if edge.parent == here {
                (&edge.child, edge.parent_from_child)
            } else if edge.child == here {
                (&edge.parent, edge.parent_from_child.inverse())
            } else {
                continue;
            };
            if *far != Frame::rig() && !towards_rig.contains_key(far) {
                towards_rig.insert(
                    far.clone(),
                    Step {
                        next: here.clone(),
                        next_from_this: here_from_far,
                    },
                );
                front.push_back(far.clone());
            }
        }
    }

    for (at, edge) in edges {
        let lost: Vec<&Frame> = [&edge.parent, &edge.child]
            .into_iter()
            .filter(|frame| **frame != Frame::rig() && !towards_rig.contains_key(*frame))
            .collect();
        if let [first, ..] = lost.as_slice() {
            log.add(at.clone(), format!("{first} has no connection to rig"));
        }
    }
    towards_rig
}
