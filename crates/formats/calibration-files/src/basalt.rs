//! Basalt's `calibration.json` (Usenko et al. 2020): any number of cameras on one IMU.
//!
//! Contract: `T_imu_cam` takes points from a camera to the IMU, quaternion with `qw` last, metres.
//! Lenses: `ds`, `eucm`, `kb4`, `pinhole`, `pinhole-radtan8`, and `ucm`, which is the EUCM with
//! `beta = 1`. Noise is continuous-time, one value per axis; if the axes differ, the largest is
//! taken and noted. `cam_time_offset_ns` is added to a camera's time to get the IMU's. Biases are
//! subtracted from measurements. Values that are not represented (vignetting, scale and
//! misalignment of the IMU, the motion-capture system) are noted. A file written without an IMU has
//! its frame in the first camera and a rate of 0.

use std::path::Path;

use cad_transforms::RigidTransform;
use camera_models::plausibility::too_far;
use camera_models::{
    CameraModel, CameraSet, Distortion, ImuNoise, LensModel, NamedCamera, Note, Provenance, SetImu,
};

use crate::entry::{Entry, ImuField, InFolder, SetResult, Signs};
use crate::error::CalibError;
use crate::files::Files;
use crate::format::Format;
use crate::output::{FormatFiles, WriteError, lens, required_pose};
use crate::text::{number_text, number_texts};
use crate::tree::{At, json};

/// The format.
pub(crate) const ENTRY: Entry = Entry {
    format: Format::Basalt,
    models: MODELS,
    imu_fields: &[
        ImuField::Placement,
        ImuField::Rate,
        ImuField::Noise,
        ImuField::TimeOffset,
        ImuField::Biases,
    ],
    in_folder: InFolder::Named(&["calibration.json"]),
    signs: Signs {
        json: Some(|root| root.find("value0").is_some()),
        ..Signs::NONE
    },
    read,
    read_pair: None,
    write,
};

/// The lens models of the format, the smallest of a family first.
const MODELS: &[LensModel] = &[
    LensModel::None,
    LensModel::Rational8,
    LensModel::KannalaBrandt4,
    LensModel::DoubleSphere,
    LensModel::Eucm,
];

/// Reads a calibration.
///
/// # Errors
/// [`CalibError`].
fn read(files: &dyn Files, path: &Path, _: Option<[u32; 2]>) -> SetResult {
    let source = files.text(path)?;
    let tree = json::parse(&source)?;
    let root = At::root(&source, &tree);
    let value = root.get("value0")?;
    let placements = value.get("T_imu_cam")?;
    let lenses = value.get("intrinsics")?;
    let sizes = value.get("resolution")?;
    let (poses, lens_items, size_items) = (placements.items()?, lenses.items()?, sizes.items()?);
    for (at, count) in [(&lenses, lens_items.len()), (&sizes, size_items.len())] {
        if count != poses.len() {
            let expected = format!("one for each of the {} in T_imu_cam", poses.len());
            return Err(at.wrong_because(&format!("{count} elements"), &expected));
        }
    }
    let mut notes = Vec::new();
    let mut cameras = Vec::new();
    let mut imu_from_first = RigidTransform::identity();
    for (i, ((pose, lens), size)) in poses.iter().zip(&lens_items).zip(&size_items).enumerate() {
        let imu_from_camera = rigid(pose)?;
        let name = format!("cam{i}");
        let camera_from_first = if i == 0 {
            imu_from_first = imu_from_camera;
            pose.reject_if(too_far("the IMU", &imu_from_first))?;
            RigidTransform::identity()
        } else {
            imu_from_camera.inverse() * imu_from_first
        };
        pose.reject_if(too_far(&name, &camera_from_first))?;
        cameras.push(NamedCamera {
            name,
            model: camera(lens, size.sizes()?, &mut notes)?,
            camera_from_first: Some(camera_from_first),
        });
    }
    let imu = imu(&value, imu_from_first, &mut notes)?;
    let bent = value.find("vignette").and_then(|at| at.items().ok());
    if bent.is_some_and(|all| !all.is_empty()) {
        notes.push(Note("the vignetting is not carried".to_owned()));
    }
    let set = CameraSet {
        cameras,
        imu,
        provenance: Provenance {
            format: Some(Format::Basalt.name().to_owned()),
            files: vec![path.to_owned()],
            part: None,
        },
    };
    Ok((set.validate().map_err(CalibError::invalid(path))?, notes))
}

fn camera(
    at: &At<'_>,
    [width, height]: [u32; 2],
    notes: &mut Vec<Note>,
) -> Result<CameraModel, CalibError> {
    let kind = at.get("camera_type")?.one_of(&[
        "ds",
        "eucm",
        "ucm",
        "kb4",
        "pinhole",
        "pinhole-radtan8",
    ])?;
    let numbers = at.get("intrinsics")?;
    let number = |key: &str| numbers.get(key)?.number();
    let distortion = match kind {
        "ds" => Distortion::DoubleSphere {
            xi: number("xi")?,
            alpha: number("alpha")?,
        },
        "eucm" => Distortion::Eucm {
            alpha: number("alpha")?,
            beta: number("beta")?,
        },
        "ucm" => Distortion::Eucm {
            alpha: number("alpha")?,
            beta: 1.0,
        },
        "kb4" => Distortion::KannalaBrandt4 {
            k1: number("k1")?,
            k2: number("k2")?,
            k3: number("k3")?,
            k4: number("k4")?,
        },
        "pinhole" => Distortion::None,
        _ => {
            if numbers.find("rpmax").is_some() {
                notes.push(Note(format!(
                    "{}: rpmax is not carried, the domain follows from the coefficients",
                    numbers.path()
                )));
            }
            Distortion::Rational8 {
                k1: number("k1")?,
                k2: number("k2")?,
                p1: number("p1")?,
                p2: number("p2")?,
                k3: number("k3")?,
                k4: number("k4")?,
                k5: number("k5")?,
                k6: number("k6")?,
            }
        }
    };
    let model = CameraModel {
        width,
        height,
        fx: number("fx")?,
        fy: number("fy")?,
        cx: number("cx")?,
        cy: number("cy")?,
        distortion,
    };
    numbers.reject_invalid_model(&model)?;
    Ok(model)
}

fn imu(
    value: &At<'_>,
    imu_from_first: RigidTransform,
    notes: &mut Vec<Note>,
) -> Result<Option<SetImu>, CalibError> {
    let rate_hz = match value.find("imu_update_rate") {
        Some(at) => match at.number()? {
            0.0 => {
                notes.push(Note("imu_update_rate is 0: there is no IMU".to_owned()));
                return Ok(None);
            }
            _ => Some(at.positive()?),
        },
        None => None,
    };
    let mut same = |key: &str| -> Result<f64, CalibError> {
        let axes: [f64; 3] = value.get(key)?.numbers()?;
        let largest = axes.into_iter().fold(0.0, f64::max);
        if axes.iter().any(|a| *a != largest) {
            notes.push(Note(format!(
                "{key} differs between the axes: the largest, {largest}, is taken"
            )));
        }
        Ok(largest)
    };
    let noise = if value.find("gyro_noise_std").is_some() {
        Some(ImuNoise {
            gyro_noise_density: same("gyro_noise_std")?,
            gyro_random_walk: same("gyro_bias_std")?,
            accel_noise_density: same("accel_noise_std")?,
            accel_random_walk: same("accel_bias_std")?,
        })
    } else {
        None
    };
    let mut bias = |key: &str| -> Result<Option<[f64; 3]>, CalibError> {
        let Some(at) = value.find(key) else {
            return Ok(None);
        };
        let all = at.number_list()?;
        let [x, y, z, ref rest @ ..] = all[..] else {
            return Err(at.wrong("three biases and more"));
        };
        if rest.iter().any(|v| *v != 0.0) {
            notes.push(Note(format!(
                "{key}: scale and misalignment are not carried"
            )));
        }
        Ok(Some([x, y, z]))
    };
    let (gyro_bias, accel_bias) = (bias("calib_gyro_bias")?, bias("calib_accel_bias")?);
    let time_offset_s = value.find("cam_time_offset_ns");
    let time_offset_s = time_offset_s.map(|at| at.number().map(|ns| ns / 1e9));
    Ok(Some(SetImu {
        imu_from_first,
        rate_hz,
        noise,
        time_offset_s: time_offset_s.transpose()?,
        gyro_bias,
        accel_bias,
    }))
}

fn rigid(at: &At<'_>) -> Result<RigidTransform, CalibError> {
    let number = |key: &str| at.get(key)?.number();
    let wxyz = [number("qw")?, number("qx")?, number("qy")?, number("qz")?];
    let metres = [number("px")?, number("py")?, number("pz")?];
    RigidTransform::from_wxyz(wxyz, metres)
        .map_err(|error| at.wrong_because(&format!("a pose where {error}"), "a rigid transform"))
}

fn write(set: &CameraSet) -> Result<FormatFiles, WriteError> {
    let imu_from_first = set
        .imu
        .map_or(RigidTransform::identity(), |imu| imu.imu_from_first);
    let (mut poses, mut lenses, mut sizes) = (Vec::new(), Vec::new(), Vec::new());
    for camera in &set.cameras {
        let m = &camera.model;
        let distortion = lens(&camera.name, &m.distortion, Format::Basalt, MODELS)?;
        let imu_from_camera = imu_from_first * required_pose(camera, Format::Basalt)?.inverse();
        let ([w, x, y, z], [px, py, pz]) = (
            imu_from_camera.rotation_wxyz(),
            imu_from_camera.translation_m(),
        );
        poses.push(object(
            &["px", "py", "pz", "qx", "qy", "qz", "qw"],
            &[px, py, pz, x, y, z, w],
        ));
        let kind = match distortion {
            Distortion::DoubleSphere { .. } => "ds",
            Distortion::Eucm { .. } => "eucm",
            Distortion::KannalaBrandt4 { .. } => "kb4",
            Distortion::None => "pinhole",
            _ => "pinhole-radtan8",
        };
        let model = CameraModel { distortion, ..*m };
        let mut names = model.parameter_names();
        let mut numbers = model.parameters();
        if kind == "pinhole-radtan8" {
            // 0: Basalt works out the largest valid radius itself.
            names.push("rpmax");
            numbers.push(0.0);
        }
        lenses.push(format!(
            "{{\"camera_type\": \"{kind}\", \"intrinsics\": {}}}",
            object(&names, &numbers)
        ));
        sizes.push(format!("[{}, {}]", m.width, m.height));
    }
    let imu = set.imu.as_ref();
    let noise = imu.and_then(|i| i.noise);
    let list = |numbers: &[f64]| format!("[{}]", number_texts(numbers, ", "));
    let axes = |of: fn(&ImuNoise) -> f64| list(&[noise.as_ref().map_or(0.0, of); 3]);
    let biases = |bias: Option<[f64; 3]>, length: usize| {
        let mut all = bias.unwrap_or_default().to_vec();
        all.resize(length, 0.0);
        list(&all)
    };
    let offset_ns = imu.and_then(|i| i.time_offset_s).unwrap_or(0.0) * 1e9;
    let mut notes = Vec::new();
    if offset_ns != offset_ns.round() {
        notes.push(Note(
            "the time offset is rounded to whole nanoseconds".to_owned(),
        ));
    }
    match imu {
        None => notes.push(Note(
            "no IMU: its frame is put into the first camera, its rate is written as 0".to_owned(),
        )),
        Some(imu) if imu.rate_hz.is_none() || imu.noise.is_none() => {
            return Err(WriteError::Refused {
                format: Format::Basalt.name(),
                found: "an IMU of unknown rate or noise".to_owned(),
                expected: "both, which Basalt's filters need".to_owned(),
            });
        }
        Some(_) => {}
    }
    let fields = [
        ("T_imu_cam", lines(&poses)),
        ("intrinsics", lines(&lenses)),
        ("resolution", format!("[{}]", sizes.join(", "))),
        ("vignette", "[]".to_owned()),
        (
            "calib_accel_bias",
            biases(imu.and_then(|i| i.accel_bias), 9),
        ),
        ("calib_gyro_bias", biases(imu.and_then(|i| i.gyro_bias), 12)),
        (
            "imu_update_rate",
            number_text(imu.and_then(|i| i.rate_hz).unwrap_or(0.0)),
        ),
        ("accel_noise_std", axes(|n| n.accel_noise_density)),
        ("gyro_noise_std", axes(|n| n.gyro_noise_density)),
        ("accel_bias_std", axes(|n| n.accel_random_walk)),
        ("gyro_bias_std", axes(|n| n.gyro_random_walk)),
        (
            "cam_time_offset_ns",
            format!("{}", offset_ns.round() as i64),
        ),
    ];
    let fields: Vec<String> = fields
        .iter()
        .map(|(key, value)| format!("    \"{key}\": {value}"))
        .collect();
    let text = format!("{{\n  \"value0\": {{\n{}\n  }}\n}}\n", fields.join(",\n"));
    let mut all = FormatFiles::file("calibration.json", text);
    all.notes = notes;
    Ok(all)
}

fn object(names: &[&str], numbers: &[f64]) -> String {
    let fields: Vec<String> = names
        .iter()
        .zip(numbers)
        .map(|(name, number)| format!("\"{name}\": {}", number_text(*number)))
        .collect();
    format!("{{{}}}", fields.join(", "))
}

fn lines(items: &[String]) -> String {
    format!("[\n      {}\n    ]", items.join(",\n      "))
}

#[cfg(test)]
mod tests;
