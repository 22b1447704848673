//! OpenCV's FileStorage YAML: one camera (`camera_matrix`, `distortion_coefficients`) or a pair
//! (`K1 D1 K2 D2 R T`, or `M1 ...` with R and T in `extrinsics.yml`, as OpenCV's own samples write
//! them).
//!
//! Contract: R and T take points from the left to the right camera. The files have neither a unit
//! nor, often, the image size or the lens model: T must be in metres, and a pair more than 10 m
//! apart is rejected; the size comes from `image_width` and `image_height`, `image_size`, or the
//! caller; four coefficients are radial-tangential unless `fisheye_model: 1` or a
//! `distortion_model` says otherwise, which is noted. Coefficients that are all 0 are no
//! distortion. Thin prism and tilt terms (12 and 14 coefficients) are rejected unless they are 0.

use std::path::{Path, PathBuf};

use cad_transforms::RigidTransform;
use camera_models::plausibility::{swapped, too_far};
use camera_models::{CameraModel, CameraSet, Distortion, LensModel, NamedCamera, Note, Provenance};

use crate::entry::{Entry, InFolder, SetResult, Signs};
use crate::error::CalibError;
use crate::files::Files;
use crate::format::Format;
use crate::output::{FormatFiles, WriteError, lens};
use crate::text::number_texts;
use crate::tree::{At, yaml};

/// The format.
pub(crate) const ENTRY: Entry = Entry {
    format: Format::OpenCv,
    models: MODELS,
    imu_fields: &[],
    in_folder: InFolder::Named(&["calibration.yml", "intrinsics.yml"]),
    signs: Signs {
        yaml: Some(|root| root.find_any(LEFT[0]).is_some() || root.find_any(MONO[0]).is_some()),
        ..Signs::NONE
    },
    read,
    read_pair: None,
    write,
};

/// The lens models of the format, the smallest of a family first.
const MODELS: &[LensModel] = &[
    LensModel::None,
    LensModel::RadTan4,
    LensModel::RadTan5,
    LensModel::Rational8,
    LensModel::KannalaBrandt4,
];

/// Names for the matrix and the coefficients of the one camera, the left one, the right one.
const MONO: [&[&str]; 2] = [
    &["camera_matrix", "cameraMatrix", "Camera_Matrix", "K"],
    &[
        "distortion_coefficients",
        "distCoeffs",
        "Distortion_Coefficients",
        "dist_coeffs",
        "D",
    ],
];
const LEFT: [&[&str]; 2] = [
    &[
        "K1",
        "M1",
        "cameraMatrix1",
        "camera_matrix_1",
        "camera_matrix_left",
        "cameraMatrixL",
    ],
    &[
        "D1",
        "distCoeffs1",
        "dist_coeffs_1",
        "distortion_coefficients_left",
        "distCoeffsL",
    ],
];
const RIGHT: [&[&str]; 2] = [
    &[
        "K2",
        "M2",
        "cameraMatrix2",
        "camera_matrix_2",
        "camera_matrix_right",
        "cameraMatrixR",
    ],
    &[
        "D2",
        "distCoeffs2",
        "dist_coeffs_2",
        "distortion_coefficients_right",
        "distCoeffsR",
    ],
];
const EXTRINSICS: [&str; 2] = ["extrinsics.yml", "extrinsics.yaml"];

/// Reads a file; `size` is used if the file has none.
///
/// # Errors
/// [`CalibError`].
fn read(files: &dyn Files, path: &Path, size: Option<[u32; 2]>) -> SetResult {
    let source = files.text(path)?;
    let tree = yaml::parse(&source)?;
    let root = At::root(&source, &tree);
    let size = match (own_size(&root)?, size) {
        (Some(own), _) => own,
        (None, Some(given)) => given,
        (None, None) => {
            return Err(CalibError::SizeUnknown {
                path: path.to_owned(),
                found: "no image_width and image_height".to_owned(),
            });
        }
    };
    let mut notes = Vec::new();
    let mut used = vec![path.to_owned()];
    let named = |name: &str, model, camera_from_first| NamedCamera {
        name: name.to_owned(),
        model,
        camera_from_first,
    };
    let cameras = if root.find_any(LEFT[0]).is_some() {
        let left = camera(&root, LEFT, size, &mut notes)?;
        let right = camera(&root, RIGHT, size, &mut notes)?;
        let right_from_left = match placement(&root)? {
            Some(here) => Some(here),
            None => match beside(files, path) {
                Some(file) => {
                    let source = files.text(&file)?;
                    let tree = yaml::parse(&source)?;
                    used.push(file);
                    placement(&At::root(&source, &tree))?
                }
                None => None,
            },
        };
        if right_from_left.is_none() {
            notes.push(Note(
                "no R and T: the pose of the right camera is unknown".to_owned(),
            ));
        }
        vec![
            named("left", left, Some(RigidTransform::identity())),
            named("right", right, right_from_left),
        ]
    } else {
        let model = camera(&root, MONO, size, &mut notes)?;
        vec![named("camera", model, Some(RigidTransform::identity()))]
    };
    let set = CameraSet {
        cameras,
        imu: None,
        provenance: Provenance {
            format: Some(Format::OpenCv.name().to_owned()),
            files: used,
            part: None,
        },
    };
    Ok((set.validate().map_err(CalibError::invalid(path))?, notes))
}

fn beside(files: &dyn Files, path: &Path) -> Option<PathBuf> {
    EXTRINSICS
        .iter()
        .map(|name| path.with_file_name(name))
        .find(|file| files.is_file(file) && file != path)
}

fn own_size(root: &At<'_>) -> Result<Option<[u32; 2]>, CalibError> {
    if let Some(at) = root.find_any(&["image_size", "imageSize", "size", "Image_size"]) {
        return at.sizes().map(Some);
    }
    match root.find_any(&["image_width", "image_Width", "width"]) {
        Some(width) => {
            let height = root
                .find_any(&["image_height", "image_Height", "height"])
                .map_or_else(|| root.get("image_height"), Ok)?;
            Ok(Some([width.size()?, height.size()?]))
        }
        None => Ok(None),
    }
}

fn camera(
    root: &At<'_>,
    [matrices, coefficients]: [&[&str]; 2],
    [width, height]: [u32; 2],
    notes: &mut Vec<Note>,
) -> Result<CameraModel, CalibError> {
    let matrix = root
        .find_any(matrices)
        .map_or_else(|| root.get(matrices[0]), Ok)?;
    let matrix = data(&matrix, Some([3, 3]))?;
    let [fx, fy, cx, cy] = camera_matrix(&matrix)?;
    let at = root
        .find_any(coefficients)
        .map_or_else(|| root.get(coefficients[0]), Ok)?;
    let fisheye = match root.find_any(&["fisheye_model", "distortion_model", "camera_model"]) {
        Some(at) => match at.one_of(&[
            "0",
            "1",
            "fisheye",
            "equidistant",
            "kannala_brandt",
            "pinhole",
            "radtan",
            "plumb_bob",
            "rational_polynomial",
        ])? {
            "1" | "fisheye" | "equidistant" | "kannala_brandt" => Some(true),
            _ => Some(false),
        },
        None => None,
    };
    let at = data(&at, None)?;
    let d = at.number_list()?;
    if d.len() == 4 && fisheye.is_none() && d.iter().any(|v| *v != 0.0) {
        notes.push(Note(format!(
            "{} has four coefficients and nothing says which model: read as k1 k2 p1 p2, not as a fisheye",
            at.path()
        )));
    }
    let distortion = if fisheye == Some(true) {
        fisheye_of(&d)
    } else {
        radial_tangential_of(&d)
    };
    let model = CameraModel::new(
        (width, height),
        [fx, fy, cx, cy],
        distortion.map_err(|(found, expected)| at.wrong_because(&found, expected))?,
    );
    matrix.reject_invalid_model(&model)?;
    Ok(model)
}

/// The numbers of a matrix: its `data`, or itself where it is a plain list. Checks rows and
/// columns.
pub(crate) fn data<'a>(at: &At<'a>, shape: Option<[u32; 2]>) -> Result<At<'a>, CalibError> {
    if at.is_list() {
        return Ok(at.clone());
    }
    if let Some(expected) = shape {
        let found = [at.get("rows")?.size()?, at.get("cols")?.size()?];
        if found != expected {
            let [r, c] = expected;
            return Err(at.wrong_because(
                &format!("{} rows and {} columns", found[0], found[1]),
                &format!("{r} rows and {c} columns"),
            ));
        }
    }
    at.get("data")
}

/// fx fy cx cy of a 3x3 camera matrix.
pub(crate) fn camera_matrix(at: &At<'_>) -> Result<[f64; 4], CalibError> {
    let k: [f64; 9] = at.numbers()?;
    let [fx, skew, cx, zero, fy, cy, a, b, c] = k;
    if (skew, zero, a, b, c) != (0.0, 0.0, 0.0, 0.0, 1.0) {
        return Err(at.wrong_because(&format!("{k:?}"), "the form fx 0 cx 0 fy cy 0 0 1"));
    }
    Ok([fx, fy, cx, cy])
}

type Odd = (String, &'static str);

/// OpenCV's list of coefficients as a model: all 0 is no distortion, 4, 5 or 8 as they are, 2 are
/// radial, and 12 or 14 if all but the first 8 are 0.
pub(crate) fn radial_tangential_of(d: &[f64]) -> Result<Distortion, Odd> {
    let family = [
        Distortion::Radial2 { k1: 0.0, k2: 0.0 },
        Distortion::RadTan4 {
            k1: 0.0,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
        },
        Distortion::RadTan5 {
            k1: 0.0,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
            k3: 0.0,
        },
        Distortion::Rational8 {
            k1: 0.0,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
            k3: 0.0,
            k4: 0.0,
            k5: 0.0,
            k6: 0.0,
        },
    ];
    if d.iter().all(|v| *v == 0.0) {
        return Ok(Distortion::None);
    }
    let used = match d.len() {
        12 | 14 if d[8..].iter().all(|v| *v == 0.0) => 8,
        12 | 14 => {
            return Err((
                format!("thin prism or tilt terms in {} coefficients", d.len()),
                "2, 4, 5 or 8 coefficients, no model here has these terms",
            ));
        }
        other => other,
    };
    family
        .into_iter()
        .find(|model| model.coefficient_names().len() == used)
        .map(|model| model.with_coefficients(&d[..used]))
        .ok_or((
            format!("{} coefficients", d.len()),
            "2, 4, 5, 8, 12 or 14 coefficients",
        ))
}

/// The four coefficients of a fisheye.
pub(crate) fn fisheye_of(d: &[f64]) -> Result<Distortion, Odd> {
    match *d {
        [k1, k2, k3, k4] => Ok(Distortion::KannalaBrandt4 { k1, k2, k3, k4 }),
        _ => Err((
            format!("{} coefficients", d.len()),
            "4 coefficients of a fisheye",
        )),
    }
}

fn placement(root: &At<'_>) -> Result<Option<RigidTransform>, CalibError> {
    let (Some(r), Some(t)) = (root.find("R"), root.find("T")) else {
        return Ok(None);
    };
    let t = data(&t, None)?;
    let translation: [f64; 3] = t.numbers()?;
    let rotation = data(&r, None)?;
    let numbers = rotation.number_list()?;
    let transform = match *numbers {
        [x, y, z] => RigidTransform::from_rotation_vector([x, y, z], translation),
        _ => RigidTransform::from_rotation_rows(rotation.numbers()?, translation),
    };
    let transform = transform
        .map_err(|error| r.wrong_because(&format!("R and T where {error}"), "a rigid transform"))?;
    t.reject_if(too_far("right", &transform).or_else(|| swapped(&transform)))?;
    Ok(Some(transform))
}

fn write(set: &CameraSet) -> Result<FormatFiles, WriteError> {
    let refused = |found: String, expected: &str| WriteError::Refused {
        format: Format::OpenCv.name(),
        found,
        expected: expected.to_owned(),
    };
    let names = match set.cameras.len() {
        1 => &[["camera_matrix", "distortion_coefficients"]][..],
        2 => &[["K1", "D1"], ["K2", "D2"]][..],
        n => return Err(refused(format!("{n} cameras"), "one or two")),
    };
    let first = &set.cameras[0].model;
    let mut text = format!(
        "%YAML:1.0\n---\nimage_width: {}\nimage_height: {}\n",
        first.width, first.height
    );
    let mut fisheye = None;
    let mut body = String::new();
    for (camera, [k, d]) in set.cameras.iter().zip(names) {
        let m = &camera.model;
        if (m.width, m.height) != (first.width, first.height) {
            return Err(refused(
                format!(
                    "images of {}x{} and {}x{}",
                    first.width, first.height, m.width, m.height
                ),
                "one size, there is one place for it",
            ));
        }
        let distortion = lens(&camera.name, &m.distortion, Format::OpenCv, MODELS)?;
        let is_fisheye = matches!(distortion, Distortion::KannalaBrandt4 { .. });
        if *fisheye.get_or_insert(is_fisheye) != is_fisheye {
            return Err(refused(
                "a fisheye beside another lens".to_owned(),
                "two of one family; convert one",
            ));
        }
        let mut coefficients = distortion.coefficients();
        if coefficients.is_empty() {
            coefficients = vec![0.0; 5];
        }
        body.push_str(&matrix(k, 3, &m.k_matrix()));
        body.push_str(&matrix(d, 1, &coefficients));
    }
    text.push_str(&format!(
        "fisheye_model: {}\n",
        u8::from(fisheye == Some(true))
    ));
    text.push_str(&body);
    if let [_, right] = &set.cameras[..]
        && let Some(right_from_left) = right.camera_from_first
    {
        text.push_str(&matrix("R", 3, &right_from_left.rotation_rows()));
        text.push_str(&matrix("T", 3, &right_from_left.translation_m()));
    }
    Ok(FormatFiles::file("calibration.yml", text))
}

fn matrix(name: &str, rows: usize, numbers: &[f64]) -> String {
    let columns = numbers.len() / rows;
    let data: Vec<String> = numbers
        .chunks(columns.max(1))
        .map(|row| number_texts(row, ", "))
        .collect();
    format!(
        "{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {} ]\n",
        data.join(",\n       ")
    )
}

#[cfg(test)]
mod tests;
