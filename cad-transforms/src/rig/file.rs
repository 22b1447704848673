//! Reading the rig file. Goes on after every mistake, so that one run shows them all; checks of the
//! tree as a whole come last and use the entries that could be read.

use std::collections::BTreeMap;
use std::ops::Range;

use toml::de::{DeTable, DeValue};

use super::table::{Log, Table, integer, not_toml, numbers, rows, table_of, text_of};
use super::{
    CadSource, Edge, Problem, Problems, Provenance, ProvenanceKind, RIG_FORMAT, Rig, devices,
    loops, shoes, tolerance, tree,
};
use crate::frame::Frame;
use crate::transform::RigidTransform;

/// What could be read of a file, and everything that is wrong with it.
pub(super) struct ParsedRig {
    /// Of what could be read; texts that are missing are empty. Its tree leaves out what is wrong.
    pub(super) rig: Rig,
    /// Line of each of the rig's entries.
    pub(super) edge_lines: Vec<usize>,
    /// Line of each `[[camera]]`.
    pub(super) camera_lines: Vec<usize>,
    /// By line.
    pub(super) problems: Vec<Problem>,
    /// Nothing at all could be read.
    pub(super) hopeless: bool,
}

impl ParsedRig {
    /// The rig, if nothing is wrong.
    pub(super) fn into_rig(self) -> Result<Rig, Problems> {
        if self.problems.is_empty() {
            Ok(self.rig)
        } else {
            Err(Problems(self.problems))
        }
    }

    fn hopeless(problem: Problem) -> Self {
        Self {
            rig: Rig {
                name: String::new(),
                revision: String::new(),
                provenance: nothing_known(),
                cameras: Vec::new(),
                edges: Vec::new(),
                closures: Vec::new(),
                towards_rig: BTreeMap::new(),
                shoe_tags: Vec::new(),
                soles: Vec::new(),
            },
            edge_lines: Vec::new(),
            camera_lines: Vec::new(),
            problems: vec![problem],
            hopeless: true,
        }
    }
}

pub(super) fn read(text: &str) -> ParsedRig {
    let document = match DeTable::parse(text) {
        Ok(document) => document,
        Err(error) => return ParsedRig::hopeless(not_toml(text, &error)),
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
            "sole",
            "camera",
            "closes_loop",
        ],
        &mut log,
    );

    // A newer format may mean anything by its keys: say so first and alone.
    if let Some((at, format)) = root.get("format", &mut log, integer, "an integer")
        && format != RIG_FORMAT
    {
        let line = log.line(&at);
        return ParsedRig::hopeless(Problem {
            line,
            message: format!("format is {format}, this program reads {RIG_FORMAT}"),
        });
    }
    let name = root.get("name", &mut log, text_of, "a text that is not empty");
    let revision = root.get("revision", &mut log, text_of, "a text that is not empty");
    let provenance = provenance(&root, &mut log);
    let edges = edges(&root, &mut log);
    tree::check_cameras(&edges, &mut log);
    let towards_rig = tree::check(&edges, &mut log);
    let cameras = devices::cameras(&root, &edges, &mut log);
    let closures = loops::closures(&root, &mut log);
    let shoe_tags = shoes::shoe_tags(&root, &mut log);
    let soles = shoes::soles(&root, &mut log);

    let lines = |places: Vec<&Range<usize>>| places.iter().map(|at| log.line(at)).collect();
    let edge_lines = lines(edges.iter().map(|(at, _)| at).collect());
    let camera_lines = lines(cameras.iter().map(|(at, _)| at).collect());
    let text_or_none =
        |found: Option<(Range<usize>, String)>| found.map_or_else(String::new, |v| v.1);
    let mut rig = Rig {
        name: text_or_none(name),
        revision: text_or_none(revision),
        provenance: provenance.unwrap_or_else(nothing_known),
        cameras: cameras.into_iter().map(|(_, camera)| camera).collect(),
        edges: edges.into_iter().map(|(_, edge)| edge).collect(),
        closures: Vec::new(),
        towards_rig,
        shoe_tags,
        soles,
    };
    for (at, closure) in closures {
        if let Some(message) = loops::objection(&rig, &closure) {
            log.add(at, message);
        }
        rig.closures.push(closure);
    }
    log.problems.sort_by_key(|problem| problem.line);
    ParsedRig {
        rig,
        edge_lines,
        camera_lines,
        problems: log.problems,
        hopeless: false,
    }
}

fn nothing_known() -> Provenance {
    Provenance {
        kind: ProvenanceKind::Nominal,
        note: String::new(),
        cad: None,
    }
}

fn provenance(root: &Table<'_, '_>, log: &mut Log<'_>) -> Option<Provenance> {
    let (at, table) = root.get("provenance", log, table_of, "a table with kind and note")?;
    let table = Table {
        table,
        at,
        name: "[provenance]",
    };
    table.refuse_unknown(&["kind", "note", "cad_file", "cad_blake3"], log);
    let note = table.get("note", log, text_of, "a text that is not empty");
    let cad = cad_source(&table, log);
    let (at, kind) = table.get("kind", log, text_of, "a text that is not empty")?;
    let known = ProvenanceKind::ALL.map(ProvenanceKind::as_str);
    match ProvenanceKind::ALL.into_iter().find(|k| k.as_str() == kind) {
        Some(kind) => Some(Provenance {
            kind,
            note: note?.1,
            cad,
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

fn cad_source(table: &Table<'_, '_>, log: &mut Log<'_>) -> Option<CadSource> {
    let has = |key: &str| table.table.contains_key(key);
    if !has("cad_file") && !has("cad_blake3") {
        return None;
    }
    let file = table.get("cad_file", log, text_of, "a text that is not empty");
    let hash = |value: &DeValue<'_>| {
        text_of(value).filter(|hash| {
            let digit = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
            hash.len() == 64 && hash.bytes().all(digit)
        })
    };
    let blake3 = table.get(
        "cad_blake3",
        log,
        hash,
        "64 hexadecimal digits in lower case",
    );
    Some(CadSource {
        file: file?.1,
        blake3: blake3?.1,
    })
}

/// The entries that could be read, each with its place.
fn edges(root: &Table<'_, '_>, log: &mut Log<'_>) -> Vec<(Range<usize>, Edge)> {
    let mut edges = Vec::new();
    let (name, expected) = ("[[parent_from_child]]", "entries [[parent_from_child]]");
    for table in root.entries("parent_from_child", name, expected, log) {
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
            "sigma_translation_m",
            "sigma_translation_mm",
            "sigma_rotation_rad",
            "sigma_rotation_deg",
            "covariance",
        ],
        log,
    );
    let parent = frame(table, "parent", log);
    let child = frame(table, "child", log);
    let transform = transform(table, log);
    let covariance = tolerance::covariance(table, log);
    let edge = Edge {
        parent: parent?,
        child: child?,
        parent_from_child: transform?,
        covariance,
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
pub(crate) fn transform(table: &Table<'_, '_>, log: &mut Log<'_>) -> Option<RigidTransform> {
    let translation = table.get_list(
        "translation_m",
        log,
        numbers::<3>,
        "three finite numbers",
        3,
    );
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
            let rotation = table.get_list(
                "rotation_wxyz",
                log,
                numbers::<4>,
                "four finite numbers, w first",
                4,
            );
            rotation.map(|(at, wxyz)| {
                (
                    at,
                    RigidTransform::from_wxyz(wxyz, translation_or_zero(&translation)),
                )
            })
        }
        (false, true) => {
            let rotation = table.get_list(
                "rotation_rows",
                log,
                rows,
                "three rows of three finite numbers",
                3,
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

pub(crate) fn frame(table: &Table<'_, '_>, key: &'static str, log: &mut Log<'_>) -> Option<Frame> {
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
