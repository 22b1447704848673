//! ROS `camera_info` YAML as `camera_calibration` and `camera_calibration_parsers` write it, one
//! file per camera.
//!
//! Contract: a file whose name is `left`, or ends in `_left` or `-left`, is read together with its
//! `right` sibling, and vice versa. The pair's extrinsics follow from its rectification:
//! `x_right_rect = x_left_rect + P[3] / P[0]` along x, and the two `rectification_matrix` rotate
//! each camera's points into the rectified frame. If the right projection has no such term, the
//! extrinsics are unknown. Models: `plumb_bob` (5, or 4), `rational_polynomial` (8), `equidistant`
//! (4), and Kalibr's `radtan` (4), which some drivers write here. Coefficients that are all 0 are
//! no distortion; those beside `none` or an empty model must be.

use std::path::{Path, PathBuf};

use cad_transforms::RigidTransform;
use camera_models::plausibility::{swapped, too_far};
use camera_models::rectify::{Rectification, View};
use camera_models::{CameraModel, CameraSet, Distortion, LensModel, NamedCamera, Note, Provenance};

use crate::entry::{Entry, InFolder, SetResult, Signs};
use crate::error::CalibError;
use crate::files::Files;
use crate::format::Format;
use crate::opencv::{camera_matrix, data, fisheye_of, radial_tangential_of};
use crate::output::{FormatFiles, WriteError, lens, stereo};
use crate::text::number_texts;
use crate::tree::{At, yaml};

/// The format.
pub(crate) const ENTRY: Entry = Entry {
    format: Format::Ros,
    models: MODELS,
    imu_fields: &[],
    in_folder: InFolder::Named(&["left.yaml", "camera.yaml"]),
    signs: Signs {
        yaml: Some(|root| {
            root.find("camera_matrix").is_some()
                && root
                    .find_any(&["projection_matrix", "distortion_model"])
                    .is_some()
        }),
        ..Signs::NONE
    },
    read,
    read_pair: None,
    write,
};

/// The lens models of the format, the smallest of a family first.
const MODELS: &[LensModel] = &[
    LensModel::None,
    LensModel::RadTan5,
    LensModel::Rational8,
    LensModel::KannalaBrandt4,
];

struct File {
    model: CameraModel,
    rectified_from_camera: RigidTransform,
    projection: [f64; 12],
    /// Line and key, for messages.
    projection_at: String,
}

/// Reads a file and its sibling.
///
/// # Errors
/// [`CalibError`].
fn read(files: &dyn Files, path: &Path, _: Option<[u32; 2]>) -> SetResult {
    let mut notes = Vec::new();
    let provenance = |used: Vec<PathBuf>| Provenance {
        format: Some(Format::Ros.name().to_owned()),
        files: used,
        part: None,
    };
    let named = |name: &str, model, camera_from_first| NamedCamera {
        name: name.to_owned(),
        model,
        camera_from_first,
    };
    let identity = RigidTransform::identity();
    let Some([left_path, right_path]) = pair(files, path) else {
        let file = file(files, path, &mut notes)?;
        let set = CameraSet {
            cameras: vec![named("camera", file.model, Some(identity))],
            imu: None,
            provenance: provenance(vec![path.to_owned()]),
        };
        return Ok((set.validate().map_err(CalibError::invalid(path))?, notes));
    };
    let left = file(files, &left_path, &mut notes)?;
    let right = file(files, &right_path, &mut notes)?;
    let p = right.projection;
    let right_from_left = if p[3] == 0.0 {
        notes.push(Note(
            "the right projection matrix has no baseline: the pose of the right camera is unknown"
                .to_owned(),
        ));
        None
    } else {
        let offset = RigidTransform::from_translation_m([p[3] / p[0], p[7] / p[5], 0.0]);
        let implausible = |reason: String| CalibError::Implausible {
            path: right_path.clone(),
            reason: format!("{}: {reason}", right.projection_at),
        };
        let offset = offset.map_err(|error| implausible(error.to_string()))?;
        let place = right.rectified_from_camera.inverse() * offset * left.rectified_from_camera;
        if let Some(reason) = too_far("right", &place).or_else(|| swapped(&place)) {
            return Err(implausible(reason));
        }
        Some(place)
    };
    let set = CameraSet {
        cameras: vec![
            named("left", left.model, Some(identity)),
            named("right", right.model, right_from_left),
        ],
        imu: None,
        provenance: provenance(vec![left_path, right_path]),
    };
    Ok((set.validate().map_err(CalibError::invalid(path))?, notes))
}

/// The left and the right file if this is one of them and the other exists. The last word of the
/// name decides: `left_shoulder_right.yaml` belongs to `left_shoulder_left.yaml`.
fn pair(files: &dyn Files, path: &Path) -> Option<[PathBuf; 2]> {
    let stem = path.file_stem()?.to_str()?;
    let before = &stem[..stem.rfind(['_', '-']).map_or(0, |at| at + 1)];
    if !["left", "right"].contains(&&stem[before.len()..]) {
        return None;
    }
    let paths = ["left", "right"].map(|eye| {
        let mut name = std::ffi::OsString::from(format!("{before}{eye}"));
        if let Some(extension) = path.extension() {
            name.push(".");
            name.push(extension);
        }
        path.with_file_name(name)
    });
    paths
        .iter()
        .all(|path| files.is_file(path))
        .then_some(paths)
}

fn file(files: &dyn Files, path: &Path, notes: &mut Vec<Note>) -> Result<File, CalibError> {
    let source = files.text(path)?;
    let tree = yaml::parse(&source)?;
    let root = At::root(&source, &tree);
    let [width, height] = [
        root.get("image_width")?.size()?,
        root.get("image_height")?.size()?,
    ];
    let matrix = data(&root.get("camera_matrix")?, Some([3, 3]))?;
    let [fx, fy, cx, cy] = camera_matrix(&matrix)?;
    let name = root.get("distortion_model")?;
    let kind = name.one_of(&[
        "plumb_bob",
        "rational_polynomial",
        "equidistant",
        "fisheye",
        "kannala_brandt",
        "radtan",
        "none",
        "",
    ])?;
    let distortion = if matches!(kind, "none" | "") {
        if let Some(at) = root.find("distortion_coefficients") {
            data(&at, None)?.only_zeros("no distortion_model")?;
        }
        Distortion::None
    } else {
        let at = data(&root.get("distortion_coefficients")?, None)?;
        let d = at.number_list()?;
        let expected: &[usize] = match kind {
            "plumb_bob" => &[4, 5],
            "rational_polynomial" => &[8, 12, 14],
            _ => &[4],
        };
        if !expected.contains(&d.len()) {
            let expected: Vec<String> = expected.iter().map(ToString::to_string).collect();
            return Err(at.wrong_because(
                &format!("{} coefficients", d.len()),
                &format!("{} of {kind}", expected.join(" or ")),
            ));
        }
        match kind {
            "equidistant" | "fisheye" | "kannala_brandt" => fisheye_of(&d),
            _ => radial_tangential_of(&d),
        }
        .map_err(|(found, expected)| at.wrong_because(&found, expected))?
    };
    let rectified_from_camera = match root.find("rectification_matrix") {
        Some(at) => {
            let at = data(&at, Some([3, 3]))?;
            RigidTransform::from_rotation_rows(at.numbers()?, [0.0; 3]).map_err(|error| {
                at.wrong_because(&format!("a matrix where {error}"), "a rotation")
            })?
        }
        None => RigidTransform::identity(),
    };
    let (projection, projection_at) = match root.find("projection_matrix") {
        Some(at) => {
            let at = data(&at, Some([3, 4]))?;
            let p: [f64; 12] = at.numbers()?;
            if p[0] <= 0.0 || p[5] <= 0.0 {
                return Err(at.wrong_because(
                    &format!("focal lengths {} and {}", p[0], p[5]),
                    "both above 0",
                ));
            }
            (p, at.place())
        }
        None => {
            notes.push(Note(format!("{}: no projection_matrix", path.display())));
            let own = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0];
            (own, matrix.place())
        }
    };
    let model = CameraModel::new((width, height), [fx, fy, cx, cy], distortion);
    matrix.reject_invalid_model(&model)?;
    Ok(File {
        model,
        rectified_from_camera,
        projection,
        projection_at,
    })
}

fn write(set: &CameraSet) -> Result<FormatFiles, WriteError> {
    let identity = RigidTransform::identity();
    if let [camera] = &set.cameras[..] {
        let m = &camera.model;
        let p = [
            m.fx, 0.0, m.cx, 0.0, 0.0, m.fy, m.cy, 0.0, 0.0, 0.0, 1.0, 0.0,
        ];
        let text = text(camera, &camera.name, &identity, p)?;
        return Ok(FormatFiles::file("camera.yaml", text));
    }
    let files = |cameras: [&NamedCamera; 2],
                 rotations: [RigidTransform; 2],
                 projections: [[f64; 12]; 2]| {
        let file = |i: usize, name: &str| {
            let text = text(cameras[i], name, &rotations[i], projections[i])?;
            Ok((format!("{name}.yaml"), text.into_bytes()))
        };
        Ok(FormatFiles {
            files: vec![file(0, "left")?, file(1, "right")?],
            notes: Vec::new(),
        })
    };
    let own = |m: &CameraModel, x: f64| {
        [
            m.fx,
            0.0,
            m.cx,
            m.fx * x,
            0.0,
            m.fy,
            m.cy,
            0.0,
            0.0,
            0.0,
            1.0,
            0.0,
        ]
    };
    if let [left, right] = &set.cameras[..]
        && right.camera_from_first.is_none()
    {
        let projections = [own(&left.model, 0.0), own(&right.model, 0.0)];
        return files([left, right], [identity; 2], projections);
    }
    let pair = stereo(set, Format::Ros)?;
    let [left, right] = if set.cameras[0].model == pair.left {
        [&set.cameras[0], &set.cameras[1]]
    } else {
        [&set.cameras[1], &set.cameras[0]]
    };
    // For a pair that is rectified as delivered the rectified camera is the original one.
    if pair.is_rectified() {
        let [x, _, _] = pair.right_from_left.translation_m();
        let projections = [own(&pair.left, 0.0), own(&pair.right, x)];
        return files([left, right], [identity; 2], projections);
    }
    let rectified =
        Rectification::new(&pair, View::Filled).map_err(|error| WriteError::Refused {
            format: Format::Ros.name(),
            found: error.to_string(),
            expected: "a pair that can be rectified, the format holds its placement only so"
                .to_owned(),
        })?;
    files(
        [left, right],
        [
            rectified.rectified_from_left,
            rectified.rectified_from_right,
        ],
        [rectified.left_projection(), rectified.right_projection()],
    )
}

fn text(
    camera: &NamedCamera,
    name: &str,
    rectified_from_camera: &RigidTransform,
    projection: [f64; 12],
) -> Result<String, WriteError> {
    let m = &camera.model;
    let distortion = lens(&camera.name, &m.distortion, Format::Ros, MODELS)?;
    let model = match distortion {
        Distortion::Rational8 { .. } => "rational_polynomial",
        Distortion::KannalaBrandt4 { .. } => "equidistant",
        _ => "plumb_bob",
    };
    let mut d = distortion.coefficients();
    if d.is_empty() {
        d = vec![0.0; 5];
    }
    let matrix = |key: &str, rows: usize, numbers: &[f64]| {
        format!(
            "{key}:\n  rows: {rows}\n  cols: {}\n  data: [{}]\n",
            numbers.len() / rows,
            number_texts(numbers, ", ")
        )
    };
    Ok(format!(
        "image_width: {}\nimage_height: {}\ncamera_name: {}\n{}distortion_model: {model}\n{}{}{}",
        m.width,
        m.height,
        name.replace(|c: char| !c.is_ascii_alphanumeric(), "_"),
        matrix("camera_matrix", 3, &m.k_matrix()),
        matrix("distortion_coefficients", 1, &d),
        matrix(
            "rectification_matrix",
            3,
            &rectified_from_camera.rotation_rows()
        ),
        matrix("projection_matrix", 3, &projection),
    ))
}

#[cfg(test)]
mod tests;
