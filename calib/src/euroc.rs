//! `sensor.yaml` files of an ASL folder, as EuRoC has them (Burri et al. 2016).
//!
//! Contract: `cam0` is the left camera, `cam1` the right one. `T_BS` takes points from the sensor to the
//! body, rows first, so `right_from_left = body_from_right⁻¹ · body_from_left`. The resolution in the
//! files must be that of the pictures. An absent `imu0` leaves the IMU empty; one that is there must be
//! whole, except for its noise, whose absence is noted.

use std::path::{Path, PathBuf};

use cad_transforms::RigidTransform;

use crate::camera::{CameraModel, Distortion};
use crate::error::{CalibError, Note};
use crate::stereo::{Format, ImuCalibration, ImuNoise, Provenance, StereoCalibration};
use crate::text::Source;
use crate::yaml::Yaml;

/// Reads the calibration of an ASL folder for pictures of `width` x `height` pixels. `path` is the
/// folder with `cam0` and `cam1` (`mav0`), or one of the `sensor.yaml` below it.
///
/// # Errors
/// [`CalibError`].
pub fn read(
    path: &Path,
    width: u32,
    height: u32,
) -> Result<(StereoCalibration, Vec<Note>), CalibError> {
    let folder = match path.file_name() {
        Some(name) if name == "sensor.yaml" => path
            .parent()
            .and_then(Path::parent)
            .unwrap_or(Path::new("")),
        _ => path,
    };
    let file = |sensor: &str| folder.join(sensor).join("sensor.yaml");
    let mut files: Vec<PathBuf> = vec![file("cam0"), file("cam1")];
    let (left, body_from_left) = camera(&files[0], width, height)?;
    let (right, body_from_right) = camera(&files[1], width, height)?;
    let mut notes = Vec::new();
    let imu = if file("imu0").is_file() {
        files.push(file("imu0"));
        Some(imu(&files[2], body_from_left, &mut notes)?)
    } else {
        notes.push(Note(
            "no imu0/sensor.yaml: the place of the IMU is not known".to_owned(),
        ));
        None
    };
    let calibration = StereoCalibration {
        left,
        right,
        right_from_left: body_from_right.inverse() * body_from_left,
        imu,
        provenance: Provenance {
            format: Some(Format::Euroc),
            files,
            part: None,
        },
    };
    calibration
        .checked(folder)
        .map(|calibration| (calibration, notes))
}

fn camera(
    path: &Path,
    width: u32,
    height: u32,
) -> Result<(CameraModel, RigidTransform), CalibError> {
    let source = Source::read(path)?;
    let yaml = Yaml::parse(&source)?;
    expect_text(&source, &yaml, "sensor_type", &["camera"])?;
    expect_text(&source, &yaml, "camera_model", &["pinhole"])?;
    let (_, [w, h]) = yaml.numbers("resolution")?;
    if (w, h) != (f64::from(width), f64::from(height)) {
        let found = format!("{w}x{h}");
        return Err(CalibError::Resolution {
            path: path.to_owned(),
            width,
            height,
            found,
        });
    }
    let (_, [fx, fy, cx, cy]) = yaml.numbers("intrinsics")?;
    let model = expect_text(
        &source,
        &yaml,
        "distortion_model",
        &["radial-tangential", "equidistant", "none"],
    )?;
    let distortion = if model == "none" {
        Distortion::None
    } else {
        let (_, [a, b, c, d]) = yaml.numbers("distortion_coefficients")?;
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
    Ok((
        CameraModel {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            distortion,
        },
        body_from_sensor(&source, &yaml)?,
    ))
}

fn imu(
    path: &Path,
    body_from_left: RigidTransform,
    notes: &mut Vec<Note>,
) -> Result<ImuCalibration, CalibError> {
    let source = Source::read(path)?;
    let yaml = Yaml::parse(&source)?;
    expect_text(&source, &yaml, "sensor_type", &["imu"])?;
    let noise = if yaml.contains("gyroscope_noise_density") {
        Some(ImuNoise {
            gyro_noise_density: yaml.number("gyroscope_noise_density")?,
            gyro_random_walk: yaml.number("gyroscope_random_walk")?,
            accel_noise_density: yaml.number("accelerometer_noise_density")?,
            accel_random_walk: yaml.number("accelerometer_random_walk")?,
        })
    } else {
        notes.push(Note("imu0/sensor.yaml has no noise densities".to_owned()));
        None
    };
    let rate_hz = yaml.number("rate_hz")?;
    if rate_hz <= 0.0 {
        let (line, text) = yaml.text("rate_hz")?;
        return Err(source.malformed(line, text, "a rate above 0"));
    }
    let imu_from_left = body_from_sensor(&source, &yaml)?.inverse() * body_from_left;
    Ok(ImuCalibration {
        imu_from_left,
        rate_hz,
        noise,
    })
}

fn body_from_sensor(source: &Source, yaml: &Yaml<'_>) -> Result<RigidTransform, CalibError> {
    let (line, rows) = yaml.numbers::<16>("T_BS.data")?;
    RigidTransform::from_rows_4x4(rows).map_err(|error| CalibError::Malformed {
        path: source.path.clone(),
        line,
        found: format!("a T_BS where {error}"),
        expected: "a rigid transform".to_owned(),
    })
}

fn expect_text<'s>(
    source: &Source,
    yaml: &Yaml<'s>,
    key: &str,
    known: &[&str],
) -> Result<&'s str, CalibError> {
    let (line, text) = yaml.text(key)?;
    if known.contains(&text) {
        return Ok(text);
    }
    Err(source.malformed(line, text, &format!("{key} to be {}", known.join(" or "))))
}

#[cfg(test)]
mod tests;
