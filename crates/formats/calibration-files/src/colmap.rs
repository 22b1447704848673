//! COLMAP's `cameras.txt` and `cameras.bin`, with the `rigs.txt` beside them.
//!
//! Contract: COLMAP puts the centre of the top-left pixel at (0.5, 0.5), so that half a pixel is
//! subtracted from principal points on reading and added on writing. Cameras are named by their
//! identifiers. A model with one focal length or fewer coefficients is read as the smallest model
//! here that means the same. If `rigs.txt` (COLMAP 3.12 and later) names the first camera in a rig
//! with poses, the cameras of that rig have their extrinsics; `sensor_from_rig`, quaternion `w x y
//! z`, takes points from the rig to the sensor. FOV and thin-prism models are rejected.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, CameraSet, Distortion, LensModel, NamedCamera, Note, Provenance};

use crate::entry::{Entry, InFolder, SetResult, Signs};
use crate::error::CalibError;
use crate::files::Files;
use crate::format::Format;
use crate::output::{FormatFiles, WriteError, lens};
use crate::text::number_texts;

/// The text form.
pub(crate) const TEXT: Entry = Entry {
    format: Format::Colmap,
    models: MODELS,
    imu_fields: &[],
    in_folder: InFolder::Named(&["cameras.txt"]),
    signs: Signs {
        name: Some("cameras.txt"),
        words: Some(|words| words.get(1).is_some_and(|model| is_model(model))),
        ..Signs::NONE
    },
    read,
    read_pair: None,
    write: |set| write(set, Form::Text),
};

/// The binary form.
pub(crate) const BINARY: Entry = Entry {
    format: Format::ColmapBin,
    models: MODELS,
    imu_fields: &[],
    in_folder: InFolder::Named(&["cameras.bin"]),
    signs: Signs {
        name: Some("cameras.bin"),
        ..Signs::NONE
    },
    read,
    read_pair: None,
    write: |set| write(set, Form::Binary),
};

/// The lens models of the format, the smallest of a family first.
const MODELS: &[LensModel] = &[
    LensModel::None,
    LensModel::Radial2,
    LensModel::RadTan4,
    LensModel::Rational8,
    LensModel::KannalaBrandt4,
];

/// Offset of COLMAP's pixel coordinates.
const HALF: f64 = 0.5;

/// Text or binary.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    Text,
    Binary,
}

/// Name, number and parameter count of a model (COLMAP `src/colmap/sensor/models.h`).
const COLMAP_MODELS: [(&str, i32, usize); 9] = [
    ("SIMPLE_PINHOLE", 0, 3),
    ("PINHOLE", 1, 4),
    ("SIMPLE_RADIAL", 2, 4),
    ("RADIAL", 3, 5),
    ("OPENCV", 4, 8),
    ("OPENCV_FISHEYE", 5, 8),
    ("FULL_OPENCV", 6, 12),
    ("SIMPLE_RADIAL_FISHEYE", 8, 4),
    ("RADIAL_FISHEYE", 9, 5),
];

/// Whether a word names one of COLMAP's models, read here or not.
fn is_model(word: &str) -> bool {
    COLMAP_MODELS.iter().any(|(name, ..)| *name == word)
        || ["FOV", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE"].contains(&word)
}

/// Reads `cameras.txt` or, by its name, `cameras.bin`.
///
/// # Errors
/// [`CalibError`].
fn read(files: &dyn Files, path: &Path, _: Option<[u32; 2]>) -> SetResult {
    let is_binary = path.extension().is_some_and(|e| e == "bin");
    let mut notes = Vec::new();
    let found = if is_binary {
        binary(files, path)?
    } else {
        text(files, path, &mut notes)?
    };
    let form = if is_binary {
        Format::ColmapBin
    } else {
        Format::Colmap
    };
    let mut used = vec![path.to_owned()];
    let mut places = BTreeMap::new();
    let rigs = path.with_file_name("rigs.txt");
    if let Some((first, _)) = found.first() {
        places.insert(*first, RigidTransform::identity());
        if files.is_file(&rigs) {
            places.extend(places_in_rig(files, &rigs, *first)?);
            used.push(rigs);
            let without: Vec<String> = found
                .iter()
                .filter(|(id, _)| !places.contains_key(id))
                .map(|(id, _)| id.to_string())
                .collect();
            if !without.is_empty() {
                notes.push(Note(format!(
                    "rigs.txt does not say where camera {} is beside camera {first}",
                    without.join(", ")
                )));
            }
        } else if found.len() > 1 {
            notes.push(Note(
                "no rigs.txt beside the cameras: their poses are unknown".to_owned(),
            ));
        }
    }
    let set = CameraSet {
        cameras: found
            .into_iter()
            .map(|(id, model)| NamedCamera {
                name: id.to_string(),
                model,
                camera_from_first: places.get(&id).copied(),
            })
            .collect(),
        imu: None,
        provenance: Provenance {
            format: Some(form.name().to_owned()),
            files: used,
            part: None,
        },
    };
    Ok((set.validate().map_err(CalibError::invalid(path))?, notes))
}

fn text(
    files: &dyn Files,
    path: &Path,
    notes: &mut Vec<Note>,
) -> Result<Vec<(u32, CameraModel)>, CalibError> {
    let source = files.document(path)?;
    let mut cameras: Vec<(u32, CameraModel)> = Vec::new();
    let mut known = BTreeSet::new();
    let mut announced = None;
    for (line, text) in source.lines() {
        if let Some(count) = text.strip_prefix("# Number of cameras:") {
            announced = count.trim().parse::<usize>().ok();
        }
        if text.is_empty() || text.starts_with('#') {
            continue;
        }
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        let [id, model, width, height, ref parameters @ ..] = words[..] else {
            let expected = "CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS";
            return Err(source.malformed(line, text, expected));
        };
        let whole = |word: &str| {
            word.parse::<u32>()
                .map_err(|_| source.malformed(line, word, "a whole number"))
        };
        let id = whole(id)?;
        if !known.insert(id) {
            return Err(source.malformed(line, text, "each CAMERA_ID once"));
        }
        let parameters = parameters
            .iter()
            .map(|word| source.number_for(line, word, &format!(" as a parameter of camera {id}")))
            .collect::<Result<Vec<f64>, _>>()?;
        let Some((_, _, count)) = COLMAP_MODELS.iter().find(|(name, ..)| *name == model) else {
            return Err(source.malformed(line, model, &known_models()));
        };
        if parameters.len() != *count {
            let found = format!("{} parameters", parameters.len());
            return Err(source.unexpected(line, &found, &format!("{count} of {model}")));
        }
        let size = [whole(width)?, whole(height)?];
        cameras.push((id, camera(model, size, &parameters)));
    }
    if let Some(announced) = announced.filter(|count| *count != cameras.len()) {
        notes.push(Note(format!(
            "the file says that it has {announced} cameras, found {}: was it cut off?",
            cameras.len()
        )));
    }
    Ok(cameras)
}

fn known_models() -> String {
    let names: Vec<&str> = COLMAP_MODELS.iter().map(|(name, ..)| *name).collect();
    format!("one of {}", names.join(", "))
}

/// A camera of a known model; `p` has its number of parameters.
fn camera(model: &str, [width, height]: [u32; 2], p: &[f64]) -> CameraModel {
    let one_focal = matches!(
        model,
        "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "SIMPLE_RADIAL_FISHEYE" | "RADIAL_FISHEYE"
    );
    let ([fx, fy, cx, cy], k) = if one_focal {
        ([p[0], p[0], p[1], p[2]], &p[3..])
    } else {
        ([p[0], p[1], p[2], p[3]], &p[4..])
    };
    let at = |i: usize| k.get(i).copied().unwrap_or(0.0);
    let distortion = match model {
        "SIMPLE_PINHOLE" | "PINHOLE" => Distortion::None,
        "SIMPLE_RADIAL" | "RADIAL" => Distortion::Radial2 {
            k1: at(0),
            k2: at(1),
        },
        "OPENCV" => Distortion::RadTan4 {
            k1: at(0),
            k2: at(1),
            p1: at(2),
            p2: at(3),
        },
        "FULL_OPENCV" => Distortion::Rational8 {
            k1: at(0),
            k2: at(1),
            p1: at(2),
            p2: at(3),
            k3: at(4),
            k4: at(5),
            k5: at(6),
            k6: at(7),
        },
        _ => Distortion::KannalaBrandt4 {
            k1: at(0),
            k2: at(1),
            k3: at(2),
            k4: at(3),
        },
    };
    CameraModel {
        width,
        height,
        fx,
        fy,
        cx: cx - HALF,
        cy: cy - HALF,
        distortion,
    }
}

fn binary(files: &dyn Files, path: &Path) -> Result<Vec<(u32, CameraModel)>, CalibError> {
    let bytes = files.bytes(path, plain_file::DOCUMENT_LIMIT);
    let bytes = bytes.map_err(|source| CalibError::unread(path, source))?;
    let mut rest = &bytes[..];
    let cut = |camera: u64| CalibError::Missing {
        path: path.to_owned(),
        what: format!("the rest of camera {camera}"),
        found: "the end of the file".to_owned(),
    };
    let implausible = |reason: String| CalibError::Implausible {
        path: path.to_owned(),
        reason,
    };
    let count = u64::from_le_bytes(take(&mut rest).ok_or_else(|| cut(0))?);
    let mut cameras: Vec<(u32, CameraModel)> = Vec::new();
    let mut known = BTreeSet::new();
    for number in 0..count {
        let end = || cut(number + 1);
        let id = u32::from_le_bytes(take(&mut rest).ok_or_else(end)?);
        let model = i32::from_le_bytes(take(&mut rest).ok_or_else(end)?);
        let width = u64::from_le_bytes(take(&mut rest).ok_or_else(end)?);
        let height = u64::from_le_bytes(take(&mut rest).ok_or_else(end)?);
        let Some((name, _, parameters)) = COLMAP_MODELS.iter().find(|(_, n, _)| *n == model) else {
            return Err(implausible(format!(
                "camera {id} has model number {model}, expected {}",
                known_models()
            )));
        };
        let (Ok(width), Ok(height)) = (u32::try_from(width), u32::try_from(height)) else {
            return Err(implausible(format!(
                "camera {id} has {width}x{height} pixels"
            )));
        };
        if !known.insert(id) {
            return Err(implausible(format!("camera {id} comes twice")));
        }
        let parameters = (0..*parameters)
            .map(|_| take(&mut rest).map(f64::from_le_bytes).ok_or_else(end))
            .collect::<Result<Vec<f64>, _>>()?;
        cameras.push((id, camera(name, [width, height], &parameters)));
    }
    if !rest.is_empty() {
        return Err(implausible(format!(
            "{} bytes behind the last of {count} cameras",
            rest.len()
        )));
    }
    Ok(cameras)
}

fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (head, tail) = rest.split_first_chunk()?;
    *rest = tail;
    Some(*head)
}

/// `camera_from_first` of the cameras in the rig of `first`.
fn places_in_rig(
    files: &dyn Files,
    path: &Path,
    first: u32,
) -> Result<BTreeMap<u32, RigidTransform>, CalibError> {
    let source = files.document(path)?;
    for (line, text) in source.lines() {
        if text.is_empty() || text.starts_with('#') {
            continue;
        }
        let mut words = text.split_ascii_whitespace();
        let mut word = |what: &str| {
            words
                .next()
                .ok_or_else(|| source.malformed(line, text, &format!("{what} before the end")))
        };
        let whole = |word: &str| {
            word.parse::<u32>()
                .map_err(|_| source.malformed(line, word, "a whole number"))
        };
        word("RIG_ID")?;
        let sensors = whole(word("NUM_SENSORS")?)?;
        if sensors == 0 {
            continue;
        }
        let mut from_rig = BTreeMap::new();
        if word("REF_SENSOR_TYPE")? == "CAMERA" {
            let id = whole(word("REF_SENSOR_ID")?)?;
            from_rig.insert(id, RigidTransform::identity());
        } else {
            word("REF_SENSOR_ID")?;
        }
        for _ in 1..sensors {
            let kind = word("SENSOR_TYPE")?;
            let id = whole(word("SENSOR_ID")?)?;
            if word("HAS_POSE")? != "1" {
                continue;
            }
            let mut numbers = [0.0; 7];
            for (number, name) in numbers
                .iter_mut()
                .zip(["QW", "QX", "QY", "QZ", "TX", "TY", "TZ"])
            {
                *number = source.number_for(line, word(name)?, &format!(" as {name}"))?;
            }
            let [w, x, y, z, tx, ty, tz] = numbers;
            let transform =
                RigidTransform::from_wxyz([w, x, y, z], [tx, ty, tz]).map_err(|error| {
                    let found = format!("a pose of sensor {id} where {error}");
                    source.unexpected(line, &found, "a rigid transform")
                })?;
            if kind == "CAMERA" {
                from_rig.insert(id, transform);
            }
        }
        if let Some(first_from_rig) = from_rig.get(&first).copied() {
            return Ok(from_rig
                .into_iter()
                .filter(|(id, _)| *id != first)
                .map(|(id, camera_from_rig)| (id, camera_from_rig * first_from_rig.inverse()))
                .collect());
        }
    }
    Ok(BTreeMap::new())
}

fn write(set: &CameraSet, form: Form) -> Result<FormatFiles, WriteError> {
    let format = match form {
        Form::Text => Format::Colmap,
        Form::Binary => Format::ColmapBin,
    };
    let mut rows = Vec::new();
    for camera in &set.cameras {
        let m = &camera.model;
        let one_focal = m.fx == m.fy;
        // RADIAL has one focal length; two need the larger model.
        let distortion = match lens(&camera.name, &m.distortion, format, MODELS)? {
            Distortion::Radial2 { k1, k2 } if !one_focal => Distortion::RadTan4 {
                k1,
                k2,
                p1: 0.0,
                p2: 0.0,
            },
            other => other,
        };
        let name = match distortion {
            Distortion::None => "PINHOLE",
            Distortion::Radial2 { .. } => "RADIAL",
            Distortion::RadTan4 { .. } => "OPENCV",
            Distortion::KannalaBrandt4 { .. } => "OPENCV_FISHEYE",
            _ => "FULL_OPENCV",
        };
        let mut parameters = if name == "RADIAL" {
            vec![m.fx]
        } else {
            vec![m.fx, m.fy]
        };
        parameters.extend([m.cx + HALF, m.cy + HALF]);
        parameters.extend(distortion.coefficients());
        rows.push((name, m.width, m.height, parameters));
    }
    let mut files = Vec::new();
    match form {
        Form::Text => {
            let mut text =
                "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, \
                            HEIGHT, PARAMS[]\n"
                    .to_owned();
            text.push_str(&format!("# Number of cameras: {}\n", rows.len()));
            for (id, (name, width, height, parameters)) in (1..).zip(&rows) {
                let parameters = number_texts(parameters, " ");
                text.push_str(&format!("{id} {name} {width} {height} {parameters}\n"));
            }
            files.push(("cameras.txt".to_owned(), text.into_bytes()));
        }
        Form::Binary => {
            let mut bytes = (rows.len() as u64).to_le_bytes().to_vec();
            for (id, (name, width, height, parameters)) in (1_u32..).zip(&rows) {
                let (_, number, _) = COLMAP_MODELS
                    .iter()
                    .find(|(known, ..)| known == name)
                    .expect("only known models are written");
                bytes.extend(id.to_le_bytes());
                bytes.extend(number.to_le_bytes());
                bytes.extend(u64::from(*width).to_le_bytes());
                bytes.extend(u64::from(*height).to_le_bytes());
                bytes.extend(parameters.iter().flat_map(|p| p.to_le_bytes()));
            }
            files.push(("cameras.bin".to_owned(), bytes));
        }
    }
    if set.cameras.len() > 1 {
        files.push(("rigs.txt".to_owned(), rigs(set).into_bytes()));
    }
    Ok(FormatFiles {
        files,
        notes: Vec::new(),
    })
}

fn rigs(set: &CameraSet) -> String {
    let mut text = "# Rig calib list with one line of data per calib:\n#   RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, \
                    REF_SENSOR_ID, SENSORS[] as (SENSOR_TYPE, SENSOR_ID, HAS_POSE, [QW, QX, QY, QZ, TX, TY, \
                    TZ])\n# Number of rigs: 1\n"
        .to_owned();
    text.push_str(&format!("1 {} CAMERA 1", set.cameras.len()));
    for (id, camera) in (1..).zip(&set.cameras).skip(1) {
        match &camera.camera_from_first {
            Some(t) => text.push_str(&format!(
                " CAMERA {id} 1 {} {}",
                number_texts(&t.rotation_wxyz(), " "),
                number_texts(&t.translation_m(), " ")
            )),
            None => text.push_str(&format!(" CAMERA {id} 0")),
        }
    }
    text.push('\n');
    text
}

#[cfg(test)]
mod tests;
