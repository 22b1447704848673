//! `transforms.json` of nerfstudio and instant-ngp.
//!
//! Contract: intrinsics are shared, or given per frame; each different one is a camera here. Pixel
//! coordinates are those of COLMAP: half a pixel is subtracted on reading. `transform_matrix` takes
//! points from the camera to the world, in OpenGL's axes (x right, y up, z backward). `OPENCV` has
//! k1 k2 k3 p1 p2 (a k4 is rejected: it is a term in r⁸ that no model here has), `OPENCV_FISHEYE`
//! k1 to k4. A missing coefficient is 0, a missing `fl_y` is `fl_x`, a missing principal point is
//! the image center. Coefficients that the model does not have must be 0.
//!
//! A file whose two frames are called `left` and `right` is a stereo camera, and the frames' poses,
//! in metres, are its extrinsics; this is how a pair is written. Intrinsics missing in a frame are
//! shared. In other files the poses are those of a moving camera.

use std::path::Path;

use cad_transforms::RigidTransform;
use camera_models::plausibility::{swapped, too_far};
use camera_models::{CameraModel, CameraSet, Distortion, LensModel, NamedCamera, Note, Provenance};

use crate::entry::{Entry, InFolder, SetResult, Signs};
use crate::error::CalibError;
use crate::files::Files;
use crate::format::Format;
use crate::opencv::{fisheye_of, radial_tangential_of};
use crate::output::{FormatFiles, WriteError, lens, required_pose};
use crate::text::{number_text, number_texts};
use crate::tree::{At, json};

/// The format.
pub(crate) const ENTRY: Entry = Entry {
    format: Format::Nerfstudio,
    models: MODELS,
    imu_fields: &[],
    in_folder: InFolder::Named(&["transforms.json"]),
    signs: Signs {
        json: Some(|root| {
            root.find_any(&["frames", "fl_x", "camera_angle_x"])
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
    LensModel::RadTan4,
    LensModel::RadTan5,
    LensModel::KannalaBrandt4,
];

const HALF: f64 = 0.5;
/// The two axes with opposite sign in OpenGL.
const FLIPPED: [f64; 4] = [1.0, -1.0, -1.0, 1.0];

/// Reads the cameras of a file.
///
/// # Errors
/// [`CalibError`].
fn read(files: &dyn Files, path: &Path, _: Option<[u32; 2]>) -> SetResult {
    let source = files.document(path)?;
    let tree = json::parse(&source)?;
    let root = At::root(&source, &tree);
    let mut notes = Vec::new();
    let frames = match root.find("frames") {
        Some(frames) => frames.items()?,
        None => Vec::new(),
    };
    let own = |at: &At<'_>| at.find_any(&["fl_x", "w", "camera_angle_x"]).is_some();
    let mut cameras: Vec<NamedCamera> = Vec::new();
    let named = |name: &str, model, camera_from_first| NamedCamera {
        name: name.to_owned(),
        model,
        camera_from_first,
    };
    if let Some([left, right]) = pair(&frames) {
        let right_from_left = pose(right)?.inverse() * pose(left)?;
        right
            .get("transform_matrix")?
            .reject_if(too_far("right", &right_from_left).or_else(|| swapped(&right_from_left)))?;
        cameras.push(named("left", camera(left, &root, &mut notes)?, None));
        let model = camera(right, &root, &mut notes)?;
        cameras.push(named("right", model, Some(right_from_left)));
    } else {
        if own(&root) {
            cameras.push(named("camera", camera(&root, &root, &mut notes)?, None));
        }
        for frame in frames.iter().filter(|frame| own(frame)) {
            let model = camera(frame, &root, &mut notes)?;
            if cameras.iter().all(|c| c.model != model) {
                cameras.push(named(&stem(frame), model, None));
            }
        }
        if cameras.len() > 1 {
            notes.push(Note(
                "several lenses: this format has no extrinsics of cameras on a rig".to_owned(),
            ));
        }
    }
    if let Some(first) = cameras.first_mut() {
        first.camera_from_first = Some(RigidTransform::identity());
    } else {
        // The error names the missing key.
        root.get("fl_x")?;
    }
    let set = CameraSet {
        cameras,
        imu: None,
        provenance: Provenance {
            format: Some(Format::Nerfstudio.name().to_owned()),
            files: vec![path.to_owned()],
            part: None,
        },
    };
    Ok((set.validate().map_err(CalibError::invalid(path))?, notes))
}

/// Takes points in the optical frame to the world of the file, in the file's unit of length.
fn pose(frame: &At<'_>) -> Result<RigidTransform, CalibError> {
    let at = frame.get("transform_matrix")?;
    let rows: [f64; 16] = at.numbers()?;
    let optical = std::array::from_fn(|i| rows[i] * FLIPPED[i % 4]);
    RigidTransform::from_rows_4x4(optical)
        .map_err(|error| at.wrong_because(&format!("a pose where {error}"), "a rigid transform"))
}

/// The frames of a stereo camera, left first.
fn pair<'a, 's>(frames: &'a [At<'s>]) -> Option<[&'a At<'s>; 2]> {
    match frames {
        [a, b] if stem(a) == "left" && stem(b) == "right" => Some([a, b]),
        [a, b] if stem(a) == "right" && stem(b) == "left" => Some([b, a]),
        _ => None,
    }
}

fn stem(frame: &At<'_>) -> String {
    let path = frame.find("file_path").and_then(|at| at.text().ok());
    let name = Path::new(path.unwrap_or_default()).file_stem();
    name.unwrap_or_default().to_string_lossy().into_owned()
}

/// Intrinsics of one frame; values missing there are those of the file.
fn camera(frame: &At<'_>, root: &At<'_>, notes: &mut Vec<Note>) -> Result<CameraModel, CalibError> {
    let find = |key: &str| frame.find(key).or_else(|| root.find(key));
    let need = |key: &str| find(key).map_or_else(|| frame.get(key), Ok);
    let or_zero = |key: &str| find(key).map_or(Ok(0.0), |at| at.number());
    let (width, height) = (need("w")?.size()?, need("h")?.size()?);
    let fx = match (find("fl_x"), find("camera_angle_x")) {
        (Some(at), _) => at.number()?,
        (None, Some(at)) => 0.5 * f64::from(width) / (0.5 * at.positive()?).tan(),
        (None, None) => need("fl_x")?.number()?,
    };
    let fy = find("fl_y").map_or(Ok(fx), |at| at.number())?;
    let mut center = |key: &str, size: u32| match find(key) {
        Some(at) => at.number(),
        None => {
            notes.push(Note(format!("no {key}: the image center is taken")));
            Ok(0.5 * f64::from(size))
        }
    };
    let (cx, cy) = (center("cx", width)?, center("cy", height)?);
    let model = match find("camera_model") {
        Some(at) => at.one_of(&["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "OPENCV_FISHEYE"])?,
        None if find("is_fisheye").is_some_and(|at| at.text().is_ok_and(|t| t == "true")) => {
            "OPENCV_FISHEYE"
        }
        None => "OPENCV",
    };
    let [k1, k2, k3, k4] = [
        or_zero("k1")?,
        or_zero("k2")?,
        or_zero("k3")?,
        or_zero("k4")?,
    ];
    let [p1, p2] = [or_zero("p1")?, or_zero("p2")?];
    // Coefficients that the model does not have must not be dropped silently.
    let foreign: &[&str] = match model {
        "OPENCV_FISHEYE" => &["p1", "p2"],
        "OPENCV" => &[],
        _ => &["k1", "k2", "k3", "k4", "p1", "p2"],
    };
    for key in foreign {
        if or_zero(key)? != 0.0 {
            return Err(need(key)?.wrong(&format!("0 of {model}")));
        }
    }
    let distortion = match model {
        "OPENCV_FISHEYE" => fisheye_of(&[k1, k2, k3, k4]),
        "OPENCV" => {
            if k4 != 0.0 {
                return Err(need("k4")?.wrong("0 (no model here has a term in r to the 8th)"));
            }
            if k3 == 0.0 {
                radial_tangential_of(&[k1, k2, p1, p2])
            } else {
                radial_tangential_of(&[k1, k2, p1, p2, k3])
            }
        }
        _ => Ok(Distortion::None),
    };
    let model = CameraModel {
        width,
        height,
        fx,
        fy,
        cx: cx - HALF,
        cy: cy - HALF,
        distortion: distortion.expect("the number of coefficients is right"),
    };
    if let Some((name, reason)) = model.invalid_parameter() {
        let keys: &[&str] = match name {
            "fx" => &["fl_x", "camera_angle_x"],
            "fy" => &["fl_y", "fl_x", "camera_angle_x"],
            other => &[other],
        };
        let at = keys.iter().find_map(|key| find(key));
        at.map_or_else(|| need("w"), Ok)?.reject_if(Some(reason))?;
    }
    Ok(model)
}

fn write(set: &CameraSet) -> Result<FormatFiles, WriteError> {
    let text = match &set.cameras[..] {
        [camera] => format!("{{\n{},\n  \"frames\": []\n}}\n", fields(camera, "  ")?),
        [left, right] => {
            // The world is the left camera.
            let frames = [
                ("left", left, RigidTransform::identity()),
                (
                    "right",
                    right,
                    required_pose(right, Format::Nerfstudio)?.inverse(),
                ),
            ];
            let frames = frames
                .iter()
                .map(|(name, camera, world_from_camera)| {
                    Ok(format!(
                        "    {{\n      \"file_path\": \"{name}.png\",\n{},\n      \"transform_matrix\": {}\n    }}",
                        fields(camera, "      ")?,
                        opengl(world_from_camera)
                    ))
                })
                .collect::<Result<Vec<String>, WriteError>>()?;
            format!("{{\n  \"frames\": [\n{}\n  ]\n}}\n", frames.join(",\n"))
        }
        more => {
            return Err(WriteError::Refused {
                format: Format::Nerfstudio.name(),
                found: format!("{} cameras", more.len()),
                expected: "one, or a pair".to_owned(),
            });
        }
    };
    Ok(FormatFiles::file("transforms.json", text))
}

fn fields(camera: &NamedCamera, indent: &str) -> Result<String, WriteError> {
    let m = &camera.model;
    let distortion = lens(&camera.name, &m.distortion, Format::Nerfstudio, MODELS)?;
    let model = match distortion {
        Distortion::KannalaBrandt4 { .. } => "OPENCV_FISHEYE",
        _ => "OPENCV",
    };
    let mut lines = vec![
        format!("\"camera_model\": \"{model}\""),
        format!("\"w\": {}", m.width),
        format!("\"h\": {}", m.height),
    ];
    let numbers = [
        ("fl_x", m.fx),
        ("fl_y", m.fy),
        ("cx", m.cx + HALF),
        ("cy", m.cy + HALF),
    ];
    let coefficients = distortion.coefficients();
    let coefficients = distortion
        .coefficient_names()
        .iter()
        .copied()
        .zip(coefficients);
    for (key, number) in numbers.into_iter().chain(coefficients) {
        lines.push(format!("\"{key}\": {}", number_text(number)));
    }
    let lines: Vec<String> = lines.iter().map(|line| format!("{indent}{line}")).collect();
    Ok(lines.join(",\n"))
}

fn opengl(world_from_camera: &RigidTransform) -> String {
    let (r, t) = (
        world_from_camera.rotation_rows(),
        world_from_camera.translation_m(),
    );
    let rows: Vec<String> = (0..3)
        .map(|i| {
            let row: [f64; 4] = [r[3 * i], r[3 * i + 1], r[3 * i + 2], t[i]];
            let row: Vec<f64> = row.iter().zip(FLIPPED).map(|(a, b)| a * b).collect();
            format!("[{}]", number_texts(&row, ", "))
        })
        .collect();
    format!("[{}, [0.0, 0.0, 0.0, 1.0]]", rows.join(", "))
}

#[cfg(test)]
mod tests;
