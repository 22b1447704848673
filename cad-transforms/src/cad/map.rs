//! From parts to a rig: which part is which frame.
//!
//! Contract: the mapping is a file, and nothing is guessed from names beyond it. Without a file,
//! parts that are called like frames (`feet/left`) are those frames, as in what [`super::export`]
//! writes.
//!
//! ```toml
//! format = 1
//! name = "chest plate"
//! revision = "C"
//! note = "drawing 12"
//! root = "plate/datum"             # optional: the part that is the rig's datum; else the root of the file
//!
//! [rig_from_root]                  # optional: where its axes are not x forward, y left, z up
//! translation_mm = [0, 0, 0]
//! rpy_deg = [0, 0, 90]
//!
//! [[camera]]                       # a stereo camera on a mount
//! name = "feet"
//! part = "feet_mount"              # path of the part, or its end; see [`super::Cad::find`]
//! model = "zed_mini"               # a known device, or one of [[device]] below
//! serial = "12345678"              # optional
//! baseline_m = 0.06292             # optional: from the factory file, in place of the device's
//! sigma_translation_mm = 0.2       # optional: of the mount on the plate; the device's own sigma is added
//! sigma_rotation_deg = 0.2
//! [camera.part_from_datum]         # optional: where the camera's mounting datum is in the part
//! translation_mm = [0, 0, 3]
//! rpy_deg = [0, 0, 0]
//!
//! [[frame]]                        # any other frame, taken as it is
//! frame = "feet/imu"
//! part = "feet_imu"
//!
//! [[device]]                       # optional: a device of your own, or other numbers for a known one
//! name = "zed_mini"
//! # … see devices/zed.toml
//! ```

use std::collections::BTreeSet;

use toml::de::DeTable;

use super::device::{Device, devices};
use super::table::{PLACEMENT_KEYS, placement};
use super::{Cad, Part};
use crate::covariance::Covariance;
use crate::frame::{Frame, FramePart};
use crate::rig::file::frame;
use crate::rig::table::{Log, Table, integer, not_toml, positive, table_of, text_of};
use crate::rig::tolerance;
use crate::rig::{
    CadSource, CameraInfo, Edge, Problem, Problems, Provenance, ProvenanceKind, Rig, RigError,
    RigParts,
};
use crate::transform::RigidTransform;

/// The version of the file this crate reads.
const MAP_FORMAT: i64 = 1;

/// A map file.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    name: String,
    revision: String,
    note: Option<String>,
    root: Option<(String, usize)>,
    rig_from_root: RigidTransform,
    cameras: Vec<MappedCamera>,
    frames: Vec<(Frame, String, usize)>,
    devices: Vec<Device>,
}

#[derive(Clone, Debug, PartialEq)]
struct MappedCamera {
    name: String,
    part: String,
    model: String,
    serial: Option<String>,
    baseline_m: Option<f64>,
    covariance: Option<Covariance>,
    part_from_datum: RigidTransform,
    /// Line of `part`.
    line: usize,
}

/// Why a map and a CAD file give no rig.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// The map file is wrong, or does not fit the CAD file: correct everything listed.
    #[error("mapping parts to frames: {0}")]
    Invalid(Problems),
    /// What came out is no rig.
    #[error(transparent)]
    Rig(#[from] RigError),
}

impl Map {
    /// Reads the text of a map file.
    ///
    /// # Errors
    /// [`MapError::Invalid`] with everything that is wrong.
    pub fn parse(text: &str) -> Result<Self, MapError> {
        let document = DeTable::parse(text)
            .map_err(|error| MapError::Invalid(Problems(vec![not_toml(text, &error)])))?;
        let mut log = Log {
            text,
            problems: Vec::new(),
        };
        let root = Table {
            table: document.get_ref(),
            at: 0..0,
            name: "the map file",
        };
        let map = read(&root, &mut log);
        log.problems.sort_by_key(|problem| problem.line);
        match map {
            Some(map) if log.problems.is_empty() => Ok(map),
            _ => Err(MapError::Invalid(Problems(log.problems))),
        }
    }

    /// The rig that the parts make. `source` is the CAD file with its hash.
    ///
    /// # Errors
    /// [`MapError`]: a part is not there or fits several; the frames are no rig.
    pub fn rig(&self, cad: &Cad, source: CadSource) -> Result<Rig, MapError> {
        let mut problems = Vec::new();
        let mut find = |key: &str, part: &str, line: usize| match cad.find(part) {
            Ok(part) => Some(part.root_from_part),
            Err(message) => {
                let message = format!("{key}: {message}");
                problems.push(Problem { line, message });
                None
            }
        };
        let root_from_datum = match &self.root {
            Some((part, line)) => find("root in the map file", part, *line),
            None => Some(RigidTransform::identity()),
        };
        let cameras: Vec<_> = self
            .cameras
            .iter()
            .map(|camera| {
                let part = find("part in [[camera]]", &camera.part, camera.line);
                (camera, part)
            })
            .collect();
        let frames: Vec<_> = self
            .frames
            .iter()
            .map(|(frame, part, line)| (frame, find("part in [[frame]]", part, *line)))
            .collect();
        if !problems.is_empty() {
            return Err(MapError::Invalid(Problems(problems)));
        }
        let Some(root_from_datum) = root_from_datum else {
            return Err(MapError::Invalid(Problems(problems)));
        };
        let rig_from_root = self.rig_from_root * root_from_datum.inverse();

        let (mut edges, mut infos) = (Vec::new(), Vec::new());
        let mut sources = BTreeSet::new();
        for (camera, root_from_part) in cameras {
            let (Some(root_from_part), Some(device)) = (root_from_part, self.device(&camera.model))
            else {
                continue;
            };
            sources.insert(format!("{}: {}", device.title, device.source));
            let rig_from_part = rig_from_root * root_from_part;
            edges.extend(camera_edges(camera, &device, rig_from_part));
            infos.push(CameraInfo {
                name: camera.name.clone(),
                serial: camera.serial.clone(),
                model: Some(device.title),
            });
        }
        for (frame, root_from_part) in frames {
            let Some(root_from_part) = root_from_part else {
                continue;
            };
            edges.push(Edge {
                parent: Frame::rig(),
                child: frame.clone(),
                parent_from_child: rig_from_root * root_from_part,
                covariance: None,
            });
        }
        let mut note = self
            .note
            .clone()
            .unwrap_or_else(|| "converted from CAD".to_owned());
        for source in sources {
            note += &format!("; {source}");
        }
        Ok(Rig::from_parts(RigParts {
            name: self.name.clone(),
            revision: self.revision.clone(),
            provenance: Provenance {
                kind: ProvenanceKind::Cad,
                note,
                cad: Some(source),
            },
            cameras: infos,
            edges,
            closures: Vec::new(),
            shoe_tags: Vec::new(),
            soles: Vec::new(),
        })?)
    }

    /// A device of the map, or one that is known.
    fn device(&self, name: &str) -> Option<Device> {
        let own = self.devices.iter().find(|device| device.name == name);
        own.cloned().or_else(|| Device::find(name))
    }
}

/// The edges to both lenses of a camera.
fn camera_edges(
    camera: &MappedCamera,
    device: &Device,
    rig_from_part: RigidTransform,
) -> [Edge; 2] {
    let datum_from_left = device.datum_from_left();
    // The mount moves the whole camera about its datum; seen from the lens that is a longer lever.
    let left_from_datum = datum_from_left.inverse();
    let mount = camera.covariance.map(|c| c.moved(&left_from_datum));
    let baseline_m = camera.baseline_m.unwrap_or(device.baseline_m);
    let left_from_right = RigidTransform::from_translation_m([baseline_m, 0.0, 0.0]);
    let frame_of = |part| Frame::of_camera(&camera.name, part).expect("checked on reading");
    [
        Edge {
            parent: Frame::rig(),
            child: frame_of(FramePart::Left),
            parent_from_child: rig_from_part * camera.part_from_datum * datum_from_left,
            // Without a word on the mount the whole is not known, however well the device is.
            covariance: mount.map(|mount| mount.plus(&device.covariance)),
        },
        Edge {
            parent: frame_of(FramePart::Left),
            child: frame_of(FramePart::Right),
            parent_from_child: left_from_right.expect("a finite number"),
            covariance: Some(device.covariance_of_right()),
        },
    ]
}

/// The rig of a file whose parts are called like frames. `rig` is the part of that name, or the
/// root.
///
/// # Errors
/// [`MapError`]: no part is called like a frame, two are called alike, or the frames are no rig.
pub fn rig_of_frames(cad: &Cad, name: &str, source: CadSource) -> Result<Rig, MapError> {
    let invalid = |message: String| MapError::Invalid(Problems(vec![Problem { line: 0, message }]));
    let datum = cad.parts.iter().find(|part| part.name == "rig");
    let rig_from_root = datum.map_or_else(RigidTransform::identity, |part| {
        part.root_from_part.inverse()
    });
    let mut found: Vec<(Frame, &Part)> = cad
        .parts
        .iter()
        .filter_map(|part| Some((part.name.parse().ok()?, part)))
        .filter(|(frame, _)| *frame != Frame::rig() && *frame != Frame::world())
        .collect();
    if found.is_empty() {
        let some: Vec<&str> = cad.parts.iter().take(8).map(|p| p.path.as_str()).collect();
        return Err(invalid(format!(
            "no part is called like a frame (feet/left, …), so a map file is needed; the parts begin with {}",
            some.join(", ")
        )));
    }
    found.sort_by(|(a, _), (b, _)| a.cmp(b));
    if let Some(pair) = found.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        let (a, b) = (&pair[0].1.place, &pair[1].1.place);
        return Err(invalid(format!(
            "two parts are called {}: {a} and {b}",
            pair[0].0
        )));
    }
    let rig_from = |part: &Part| rig_from_root * part.root_from_part;
    let edges = found.iter().map(|(frame, part)| {
        // Right lens and IMU belong to the left lens, where there is one.
        let left = frame
            .camera()
            .filter(|(_, part)| *part != FramePart::Left)
            .and_then(|(camera, _)| Frame::of_camera(camera, FramePart::Left).ok())
            .and_then(|left| found.iter().find(|(frame, _)| *frame == left));
        let (parent, parent_from_child) = match left {
            Some((left, at)) => (left.clone(), rig_from(at).inverse() * rig_from(part)),
            None => (Frame::rig(), rig_from(part)),
        };
        Edge {
            parent,
            child: frame.clone(),
            parent_from_child,
            covariance: None,
        }
    });
    Ok(Rig::from_parts(RigParts {
        name: name.to_owned(),
        revision: "unnamed".to_owned(),
        provenance: Provenance {
            kind: ProvenanceKind::Cad,
            note: "converted; parts are called like frames".to_owned(),
            cad: Some(source),
        },
        cameras: Vec::new(),
        edges: edges.collect(),
        closures: Vec::new(),
        shoe_tags: Vec::new(),
        soles: Vec::new(),
    })?)
}

fn read(root: &Table<'_, '_>, log: &mut Log<'_>) -> Option<Map> {
    root.refuse_unknown(
        &[
            "format",
            "name",
            "revision",
            "note",
            "root",
            "rig_from_root",
            "camera",
            "frame",
            "device",
        ],
        log,
    );
    let format = root.get("format", log, integer, "an integer");
    if let Some((at, format)) = format
        && format != MAP_FORMAT
    {
        log.problems.clear();
        log.add(
            at,
            format!("format is {format}, this program reads {MAP_FORMAT}"),
        );
        return None;
    }
    let text = "a text that is not empty";
    let optional = |key: &str, log: &mut Log<'_>| {
        let has = root.table.contains_key(key);
        has.then(|| root.get(key, log, text_of, text)).flatten()
    };
    let name = root.get("name", log, text_of, text);
    let revision = root.get("revision", log, text_of, text);
    let note = optional("note", log);
    let datum = optional("root", log);
    let rig_from_root = inner_placement(root, "rig_from_root", "[rig_from_root]", log);
    let devices = devices(root, log);
    let mut cameras: Vec<MappedCamera> = Vec::new();
    for table in root.optional_entries("camera", "[[camera]]", "a list of tables", log) {
        let Some(camera) = camera(&table, &devices, log) else {
            continue;
        };
        if cameras.iter().any(|other| other.name == camera.name) {
            let message = format!("camera {} is there already", camera.name);
            log.add(table.at.clone(), message);
        }
        cameras.push(camera);
    }
    let mut frames = Vec::new();
    for table in root.optional_entries("frame", "[[frame]]", "a list of tables", log) {
        table.refuse_unknown(&["frame", "part"], log);
        let frame = frame(&table, "frame", log);
        let part = table.get("part", log, text_of, "the path of a part");
        if let (Some(frame), Some((at, part))) = (frame, part) {
            frames.push((frame, part, log.line(&at)));
        }
    }
    if cameras.is_empty() && frames.is_empty() && log.problems.is_empty() {
        let message = "neither [[camera]] nor [[frame]] is in the map file";
        log.add(0..0, message.to_owned());
    }
    Some(Map {
        name: name?.1,
        revision: revision?.1,
        note: note.map(|(_, note)| note),
        root: datum.map(|(at, part)| (part, log.line(&at))),
        rig_from_root: rig_from_root?,
        cameras,
        frames,
        devices,
    })
}

fn camera(table: &Table<'_, '_>, devices: &[Device], log: &mut Log<'_>) -> Option<MappedCamera> {
    table.refuse_unknown(
        &[
            "name",
            "part",
            "model",
            "serial",
            "baseline_m",
            "part_from_datum",
            "sigma_translation_m",
            "sigma_translation_mm",
            "sigma_rotation_rad",
            "sigma_rotation_deg",
            "covariance",
        ],
        log,
    );
    let text = "a text that is not empty";
    let name = table.get("name", log, text_of, "the name of a camera");
    if let Some((at, name)) = &name
        && let Err(error) = Frame::of_camera(name, FramePart::Left)
    {
        log.add(at.clone(), error.to_string());
        return None;
    }
    let part = table.get("part", log, text_of, "the path of a part");
    let model = table.get("model", log, text_of, text);
    let known = |name: &str| devices.iter().any(|d| d.name == name) || Device::find(name).is_some();
    if let Some((at, model)) = &model
        && !known(model)
    {
        let own = devices.iter().map(|d| d.name.clone());
        let all: BTreeSet<String> = Device::known()
            .into_iter()
            .map(|d| d.name)
            .chain(own)
            .collect();
        let all: Vec<String> = all.into_iter().collect();
        let message = format!(
            "model is {model:?}, expected one of {} or a [[device]]",
            all.join(", ")
        );
        log.add(at.clone(), message);
    }
    let has = |key: &str| table.table.contains_key(key);
    let serial = |value: &toml::de::DeValue<'_>| {
        text_of(value).or_else(|| integer(value).map(|n| n.to_string()))
    };
    let serial = has("serial").then(|| table.get("serial", log, serial, "a number or a text"));
    let baseline =
        has("baseline_m").then(|| table.get("baseline_m", log, positive, "a number above 0"));
    let covariance = tolerance::covariance(table, log);
    let offset = inner_placement(table, "part_from_datum", "[camera.part_from_datum]", log);
    let (part_at, part) = part?;
    Some(MappedCamera {
        name: name?.1,
        part,
        model: model?.1,
        serial: serial.flatten().map(|(_, serial)| serial),
        baseline_m: baseline.flatten().map(|(_, metres)| metres),
        covariance,
        part_from_datum: offset?,
        line: log.line(&part_at),
    })
}

/// The placement in a table of its own; without the table it is the identity.
fn inner_placement(
    table: &Table<'_, '_>,
    key: &'static str,
    name: &'static str,
    log: &mut Log<'_>,
) -> Option<RigidTransform> {
    if !table.table.contains_key(key) {
        return Some(RigidTransform::identity());
    }
    let (at, inner) = table.get(key, log, table_of, "a table with a placement")?;
    let inner = Table {
        table: inner,
        at,
        name,
    };
    inner.refuse_unknown(&PLACEMENT_KEYS, log);
    placement(&inner, log)
}

#[cfg(test)]
mod tests;
