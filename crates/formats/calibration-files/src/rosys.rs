//! Camera JSON of RoSys: a map of cameras, each with intrinsics and a pose in some frame.
//!
//! Contract: `matrix` is the camera matrix, `distortion` is in OpenCV's order, `extrinsics` is the
//! pose of the camera's optical frame in the frame `_frame_id`, metres. Cameras of one such frame
//! have relative poses; others have not. Coefficients that are all 0 are no distortion, as in the
//! rectified images of the maker.

use std::path::Path;

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, CameraSet, Distortion, LensModel, NamedCamera, Note, Provenance};

use crate::entry::{Entry, InFolder, SetResult, Signs};
use crate::error::CalibError;
use crate::files::Files;
use crate::format::Format;
use crate::opencv::{camera_matrix, fisheye_of, radial_tangential_of};
use crate::output::{FormatFiles, WriteError, lens};
use crate::text::{number_text, number_texts};
use crate::tree::{At, json};

/// The format.
pub(crate) const ENTRY: Entry = Entry {
    format: Format::Rosys,
    models: MODELS,
    imu_fields: &[],
    in_folder: InFolder::Named(&["cameras.json"]),
    signs: Signs {
        json: Some(|root| root.find("cameras").is_some()),
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

/// Reads the cameras of a file.
///
/// # Errors
/// [`CalibError`].
fn read(files: &dyn Files, path: &Path, _: Option<[u32; 2]>) -> SetResult {
    let source = files.text(path)?;
    let tree = json::parse(&source)?;
    let root = At::root(&source, &tree);
    let mut cameras: Vec<NamedCamera> = Vec::new();
    let mut first: Option<(String, RigidTransform)> = None;
    let mut notes = Vec::new();
    for (name, at) in root.get("cameras")?.entries()? {
        let calibration = at.get("calibration")?;
        let model = camera(&calibration.get("intrinsics")?)?;
        let placement = match calibration.find("extrinsics") {
            Some(at) => Some(place(&at)?),
            None => None,
        };
        let camera_from_first = match (&first, &placement) {
            _ if cameras.is_empty() => Some(RigidTransform::identity()),
            (Some((frame, frame_from_first)), Some((own, frame_from_camera))) if own == frame => {
                Some(frame_from_camera.inverse() * *frame_from_first)
            }
            _ => {
                notes.push(Note(format!(
                    "the pose of {name} relative to the first camera is unknown"
                )));
                None
            }
        };
        if cameras.is_empty() {
            first = placement;
        }
        cameras.push(NamedCamera {
            name: name.to_owned(),
            model,
            camera_from_first,
        });
    }
    let set = CameraSet {
        cameras,
        imu: None,
        provenance: Provenance {
            format: Some(Format::Rosys.name().to_owned()),
            files: vec![path.to_owned()],
            part: None,
        },
    };
    Ok((set.validate().map_err(CalibError::invalid(path))?, notes))
}

fn camera(at: &At<'_>) -> Result<CameraModel, CalibError> {
    let model = match at.find("model") {
        Some(model) => model.one_of(&["pinhole", "fisheye"])?,
        None => "pinhole",
    };
    let matrix = at.get("matrix")?;
    let [fx, fy, cx, cy] = camera_matrix(&matrix)?;
    let d = at.get("distortion")?;
    let coefficients = d.number_list()?;
    let distortion = match model {
        "fisheye" => fisheye_of(&coefficients),
        _ => radial_tangential_of(&coefficients),
    };
    let model = CameraModel {
        width: at.get("size.width")?.size()?,
        height: at.get("size.height")?.size()?,
        fx,
        fy,
        cx,
        cy,
        distortion: distortion.map_err(|(found, expected)| d.wrong_because(&found, expected))?,
    };
    matrix.reject_invalid_model(&model)?;
    Ok(model)
}

/// The frame and `frame_from_camera`.
fn place(at: &At<'_>) -> Result<(String, RigidTransform), CalibError> {
    let number = |key: &str| at.get(key)?.number();
    let metres = [number("x")?, number("y")?, number("z")?];
    let rotation = at.get("rotation.R")?;
    let transform =
        RigidTransform::from_rotation_rows(rotation.numbers()?, metres).map_err(|error| {
            rotation.wrong_because(&format!("a matrix where {error}"), "a rotation")
        })?;
    let frame = match at.find("_frame_id") {
        Some(frame) => frame.text()?.to_owned(),
        None => String::new(),
    };
    Ok((frame, transform))
}

fn write(set: &CameraSet) -> Result<FormatFiles, WriteError> {
    let mut cameras = Vec::new();
    for camera in &set.cameras {
        let m = &camera.model;
        let distortion = lens(&camera.name, &m.distortion, Format::Rosys, MODELS)?;
        let model = match distortion {
            Distortion::KannalaBrandt4 { .. } => "fisheye",
            _ => "pinhole",
        };
        let mut d = distortion.coefficients();
        if d.is_empty() {
            d = vec![0.0; 5];
        }
        let rows = |numbers: [f64; 9]| {
            let rows: Vec<String> = numbers
                .chunks(3)
                .map(|row| format!("[{}]", number_texts(row, ", ")))
                .collect();
            format!("[{}]", rows.join(", "))
        };
        let extrinsics = match &camera.camera_from_first {
            Some(camera_from_first) => {
                let first_from_camera = camera_from_first.inverse();
                let [x, y, z] = first_from_camera.translation_m().map(number_text);
                format!(
                    ",\n        \"extrinsics\": {{\"_frame_id\": \"first_camera\", \"x\": {x}, \"y\": {y}, \"z\": {z}, \
                     \"rotation\": {{\"R\": {}}}}}",
                    rows(first_from_camera.rotation_rows())
                )
            }
            None => String::new(),
        };
        let name = serde_json::Value::from(camera.name.as_str());
        cameras.push(format!(
            "    {name}: {{\n      \"id\": {name},\n      \"calibration\": {{\n        \"intrinsics\": {{\"model\": \
             \"{model}\", \"matrix\": {}, \"distortion\": [{}], \"size\": {{\"width\": {}, \"height\": {}}}}}\
             {extrinsics}\n      }}\n    }}",
            rows(m.k_matrix()),
            number_texts(&d, ", "),
            m.width,
            m.height
        ));
    }
    let text = format!("{{\n  \"cameras\": {{\n{}\n  }}\n}}\n", cameras.join(",\n"));
    Ok(FormatFiles::file("cameras.json", text))
}
