//! `sensor.yaml` files of an ASL folder, as EuRoC has them (Burri et al. 2016).
//!
//! Contract: `cam0` is the left camera, `cam1` the right one. `T_BS` takes points from the sensor
//! to the body, row-major, so that `right_from_left = body_from_right⁻¹ · body_from_left`. The
//! resolution in the files must be that of the images. Without `imu0` there is no IMU; one that
//! exists must be complete, except for its noise, whose absence is noted.

use std::path::{Path, PathBuf};

use cad_transforms::RigidTransform;
use camera_models::{
    CameraModel, CameraSet, Distortion, ImuNoise, LensModel, NamedCamera, Note, Provenance, SetImu,
};

use crate::entry::{Entry, ImuField, InFolder, PairResult, SetResult, Signs};
use crate::error::CalibError;
use crate::files::Files;
use crate::format::Format;
use crate::output::{FormatFiles, WriteError, lens, required_pose};
use crate::text::{number_text, number_texts};
use crate::tree::{At, yaml};

/// The format.
pub(crate) const ENTRY: Entry = Entry {
    format: Format::Euroc,
    models: MODELS,
    imu_fields: &[ImuField::Placement, ImuField::Rate, ImuField::Noise],
    in_folder: InFolder::Below {
        file: "cam0/sensor.yaml",
        inner: "mav0",
    },
    signs: Signs {
        name: Some("sensor.yaml"),
        yaml: Some(|root| root.find("sensor_type").is_some()),
        ..Signs::NONE
    },
    read,
    read_pair: Some(read_pair),
    write,
};

/// The lens models of the format, the smallest of a family first.
const MODELS: &[LensModel] = &[
    LensModel::None,
    LensModel::RadTan4,
    LensModel::KannalaBrandt4,
];

/// Reads the calibration of an ASL folder for images of `width` x `height` pixels. `path` is the
/// folder with `cam0` and `cam1` (`mav0`), or one of the `sensor.yaml` below it.
///
/// # Errors
/// [`CalibError`].
fn read_pair(files: &dyn Files, path: &Path, [width, height]: [u32; 2]) -> PairResult {
    let (set, mut notes) = read_cameras(files, path, Some([width, height]), 2)?;
    let folder = folder_of(path);
    let imu = set.imu.is_some();
    let (calibration, more) = set
        .stereo(Some(["cam0", "cam1"]))
        .map_err(CalibError::invalid(folder))?;
    if !imu {
        notes.push(Note(
            "no imu0/sensor.yaml: the IMU extrinsics are unknown".to_owned(),
        ));
    }
    notes.extend(more);
    Ok((calibration, notes))
}

/// Reads all cameras of an ASL folder, at least one.
fn read(files: &dyn Files, path: &Path, size: Option<[u32; 2]>) -> SetResult {
    read_cameras(files, path, size, 1)
}

/// Reads `cam0`, `cam1` and so on, at least the given number. With a size, all images must have it.
///
/// # Errors
/// [`CalibError`].
fn read_cameras(
    files: &dyn Files,
    path: &Path,
    size: Option<[u32; 2]>,
    least: usize,
) -> Result<(CameraSet, Vec<Note>), CalibError> {
    let folder = folder_of(path);
    let file = |sensor: &str| folder.join(sensor).join("sensor.yaml");
    let mut used: Vec<PathBuf> = Vec::new();
    let mut cameras: Vec<NamedCamera> = Vec::new();
    let mut body_from_first = RigidTransform::identity();
    for number in 0.. {
        let name = format!("cam{number}");
        let path = file(&name);
        if number >= least && !files.is_file(&path) {
            break;
        }
        let (model, body_from_camera) = camera(files, &path, size)?;
        let camera_from_first = if number == 0 {
            body_from_first = body_from_camera;
            RigidTransform::identity()
        } else {
            body_from_camera.inverse() * body_from_first
        };
        cameras.push(NamedCamera {
            name,
            model,
            camera_from_first: Some(camera_from_first),
        });
        used.push(path);
    }
    let mut notes = Vec::new();
    let imu_file = file("imu0");
    let imu = if files.is_file(&imu_file) {
        let imu = imu(files, &imu_file, body_from_first, &mut notes)?;
        used.push(imu_file);
        Some(imu)
    } else {
        None
    };
    let set = CameraSet {
        cameras,
        imu,
        provenance: Provenance {
            format: Some(Format::Euroc.name().to_owned()),
            files: used,
            part: None,
        },
    };
    Ok((set.validate().map_err(CalibError::invalid(folder))?, notes))
}

/// The folder with `cam0`.
fn folder_of(path: &Path) -> &Path {
    match path.file_name() {
        Some(name) if name == "sensor.yaml" => path
            .parent()
            .and_then(Path::parent)
            .unwrap_or(Path::new("")),
        _ => path,
    }
}

fn camera(
    files: &dyn Files,
    path: &Path,
    size: Option<[u32; 2]>,
) -> Result<(CameraModel, RigidTransform), CalibError> {
    let source = files.text(path)?;
    let tree = yaml::parse(&source)?;
    let yaml = At::root(&source, &tree);
    yaml.get("sensor_type")?.one_of(&["camera"])?;
    yaml.get("camera_model")?.one_of(&["pinhole"])?;
    let [width, height] = yaml.get("resolution")?.sizes()?;
    if let Some([w, h]) = size
        && [w, h] != [width, height]
    {
        return Err(CalibError::Resolution {
            path: path.to_owned(),
            width: w,
            height: h,
            found: format!("{width}x{height}"),
        });
    }
    let [fx, fy, cx, cy] = yaml.get("intrinsics")?.numbers()?;
    let model =
        yaml.get("distortion_model")?
            .one_of(&["radial-tangential", "equidistant", "none"])?;
    let distortion = if model == "none" {
        if let Some(coefficients) = yaml.find("distortion_coefficients") {
            coefficients.only_zeros("distortion_model none")?;
        }
        Distortion::None
    } else {
        let [a, b, c, d] = yaml.get("distortion_coefficients")?.numbers()?;
        match model {
            "equidistant" => Distortion::KannalaBrandt4 {
                k1: a,
                k2: b,
                k3: c,
                k4: d,
            },
            _ => Distortion::RadTan4 {
                k1: a,
                k2: b,
                p1: c,
                p2: d,
            },
        }
    };
    let model = CameraModel::new((width, height), [fx, fy, cx, cy], distortion);
    yaml.get("intrinsics")?.reject_invalid_model(&model)?;
    Ok((model, body_from_sensor(&yaml)?))
}

fn imu(
    files: &dyn Files,
    path: &Path,
    body_from_first: RigidTransform,
    notes: &mut Vec<Note>,
) -> Result<SetImu, CalibError> {
    let source = files.text(path)?;
    let tree = yaml::parse(&source)?;
    let yaml = At::root(&source, &tree);
    yaml.get("sensor_type")?.one_of(&["imu"])?;
    let noise = if yaml.find("gyroscope_noise_density").is_some() {
        Some(ImuNoise {
            gyro_noise_density: yaml.get("gyroscope_noise_density")?.number()?,
            gyro_random_walk: yaml.get("gyroscope_random_walk")?.number()?,
            accel_noise_density: yaml.get("accelerometer_noise_density")?.number()?,
            accel_random_walk: yaml.get("accelerometer_random_walk")?.number()?,
        })
    } else {
        notes.push(Note("imu0/sensor.yaml has no noise densities".to_owned()));
        None
    };
    let rate_hz = yaml.get("rate_hz")?.positive()?;
    Ok(SetImu {
        imu_from_first: body_from_sensor(&yaml)?.inverse() * body_from_first,
        rate_hz: Some(rate_hz),
        noise,
        time_offset_s: None,
        gyro_bias: None,
        accel_bias: None,
    })
}

fn body_from_sensor(yaml: &At<'_>) -> Result<RigidTransform, CalibError> {
    let at = yaml.get("T_BS.data")?;
    RigidTransform::from_rows_4x4(at.numbers()?)
        .map_err(|error| at.wrong_because(&format!("a T_BS where {error}"), "a rigid transform"))
}

/// The body is the IMU, or without one the first camera.
fn write(set: &CameraSet) -> Result<FormatFiles, WriteError> {
    let body_from_first = set
        .imu
        .map_or(RigidTransform::identity(), |imu| imu.imu_from_first);
    let mut files = Vec::new();
    for (number, camera) in set.cameras.iter().enumerate() {
        let m = &camera.model;
        let distortion = lens(&camera.name, &m.distortion, Format::Euroc, MODELS)?;
        let body_from_camera = body_from_first * required_pose(camera, Format::Euroc)?.inverse();
        let (model, coefficients) = match distortion {
            Distortion::None => ("none", Vec::new()),
            Distortion::KannalaBrandt4 { .. } => ("equidistant", distortion.coefficients()),
            _ => ("radial-tangential", distortion.coefficients()),
        };
        let name = camera.name.replace(|c: char| c.is_control(), " ");
        let text = format!(
            "%YAML:1.0\nsensor_type: camera\ncomment: {name}\n{}resolution: [{}, {}]\ncamera_model: pinhole\n\
             intrinsics: [{}] # fu, fv, cu, cv\ndistortion_model: {model}\ndistortion_coefficients: [{}]\n",
            placement(&body_from_camera),
            m.width,
            m.height,
            number_texts(&[m.fx, m.fy, m.cx, m.cy], ", "),
            number_texts(&coefficients, ", ")
        );
        files.push((format!("cam{number}/sensor.yaml"), text.into_bytes()));
    }
    let mut notes = Vec::new();
    if let Some(imu) = &set.imu {
        let Some(rate_hz) = imu.rate_hz else {
            return Err(WriteError::Refused {
                format: Format::Euroc.name(),
                found: "an IMU of unknown rate".to_owned(),
                expected: "its rate".to_owned(),
            });
        };
        let mut text = format!(
            "%YAML:1.0\nsensor_type: imu\n{}rate_hz: {}\n",
            placement(&RigidTransform::identity()),
            number_text(rate_hz)
        );
        match &imu.noise {
            Some(noise) => text.push_str(&format!(
                "gyroscope_noise_density: {} # rad/s/sqrt(Hz)\ngyroscope_random_walk: {} # rad/s^2/sqrt(Hz)\n\
                 accelerometer_noise_density: {} # m/s^2/sqrt(Hz)\naccelerometer_random_walk: {} # m/s^3/sqrt(Hz)\n",
                number_text(noise.gyro_noise_density),
                number_text(noise.gyro_random_walk),
                number_text(noise.accel_noise_density),
                number_text(noise.accel_random_walk)
            )),
            None => notes.push(Note("the noise of the IMU is not known".to_owned())),
        }
        files.push(("imu0/sensor.yaml".to_owned(), text.into_bytes()));
    }
    if files.len() == 1 {
        return Err(WriteError::Refused {
            format: Format::Euroc.name(),
            found: "one camera without an IMU".to_owned(),
            expected: "a stereo camera or an IMU".to_owned(),
        });
    }
    Ok(FormatFiles { files, notes })
}

fn placement(body_from_sensor: &RigidTransform) -> String {
    let (r, t) = (
        body_from_sensor.rotation_rows(),
        body_from_sensor.translation_m(),
    );
    let row = |i: usize| number_texts(&[r[3 * i], r[3 * i + 1], r[3 * i + 2], t[i]], ", ");
    format!(
        "T_BS:\n  cols: 4\n  rows: 4\n  data: [{},\n         {},\n         {},\n         0.0, 0.0, 0.0, 1.0]\n",
        row(0),
        row(1),
        row(2)
    )
}

#[cfg(test)]
mod tests;
