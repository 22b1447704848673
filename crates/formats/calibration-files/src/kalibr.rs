//! Kalibr's `camchain.yaml` and `camchain-imucam.yaml`, with the `imu.yaml` beside them.
//!
//! Contract: `T_cn_cnm1` takes points from the previous camera to this one, `T_cam_imu` from the
//! IMU to the camera (its inverse, `T_imu_cam`, as OpenVINS writes it, is accepted too), both
//! row-major and in metres. `timeshift_cam_imu` is added to a camera's time to get the IMU's,
//! seconds. Lenses: `pinhole` with `none`, `radtan` (k1 k2 p1 p2) or `equidistant`, `ds`, `eucm`,
//! and `omni` without distortion, which is the EUCM with `alpha = xi / (1 + xi)`, `beta = 1` and
//! the focal lengths divided by `1 + xi` (both are `x / (xi d + z)` up to that factor). `omni` with
//! `radtan` and `fov` are rejected. A pinhole must have a `distortion_model`, and coefficients
//! beside `none` must be 0. All `cam0`, `cam1` and so on of the file are read; a missing value or a
//! block without keys is an error.

use std::path::Path;

use cad_transforms::RigidTransform;
use camera_models::plausibility::too_far;
use camera_models::{
    CameraModel, CameraSet, Distortion, ImuNoise, LensModel, NamedCamera, Note, Provenance, SetImu,
};

use crate::entry::{Entry, ImuField, InFolder, SetResult, Signs};
use crate::error::CalibError;
use crate::files::{Disk, Files};
use crate::format::Format;
use crate::output::{FormatFiles, WriteError, lens, required_pose};
use crate::text::{Source, number_text, number_texts};
use crate::tree::{At, yaml};

/// The format.
pub(crate) const ENTRY: Entry = Entry {
    format: Format::Kalibr,
    models: MODELS,
    imu_fields: &[
        ImuField::Placement,
        ImuField::Rate,
        ImuField::Noise,
        ImuField::TimeOffset,
    ],
    in_folder: InFolder::Named(&["camchain-imucam.yaml", "camchain.yaml"]),
    signs: Signs {
        yaml: Some(|root| root.find("cam0").is_some()),
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
    LensModel::KannalaBrandt4,
    LensModel::DoubleSphere,
    LensModel::Eucm,
];

/// Content of an `imu.yaml`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuFile {
    /// Noise model.
    pub noise: ImuNoise,
    /// Nominal rate, Hz.
    pub rate_hz: f64,
}

/// Possible names of an IMU file beside a chain.
const IMU_FILES: [&str; 2] = ["imu.yaml", "imu0.yaml"];

/// Tolerance between two poses of one camera, metres and radians; beyond it there is a note.
const SAME_PLACE: f64 = 1e-6;

/// Reads a chain of cameras, and the `imu.yaml` beside it if the chain has IMU extrinsics.
///
/// # Errors
/// [`CalibError`].
fn read(files: &dyn Files, path: &Path, _: Option<[u32; 2]>) -> SetResult {
    let source = files.text(path)?;
    let tree = yaml::parse(&source)?;
    let root = At::root(&source, &tree);
    let blocks = root.entries()?;
    let count = blocks.iter().filter(|(key, _)| is_camera(key)).count();
    let mut chain = Chain {
        count,
        ..Chain::default()
    };
    for number in 0..count {
        let name = format!("cam{number}");
        let block = blocks.iter().find(|(key, _)| *key == name);
        let at = block.map_or_else(|| root.get(&name), |(_, at)| Ok(at.clone()))?;
        chain.add(name, &at)?;
    }
    let Chain {
        cameras,
        mut imu,
        mut notes,
        ..
    } = chain;
    if cameras.is_empty() {
        return Err(root.get("cam0").err().expect("there was no cam0"));
    }
    let mut used = vec![path.to_owned()];
    let beside = IMU_FILES
        .iter()
        .map(|name| path.with_file_name(name))
        .find(|file| files.is_file(file));
    match (&mut imu, beside) {
        (Some(imu), Some(file)) => {
            let read = imu_of(&files.text(&file)?)?;
            imu.noise = Some(read.noise);
            imu.rate_hz = Some(read.rate_hz);
            used.push(file);
        }
        (Some(_), None) => notes.push(Note(
            "no imu.yaml beside the chain: rate and noise of the IMU are not known".to_owned(),
        )),
        (None, _) => {}
    }
    let set = CameraSet {
        cameras,
        imu,
        provenance: Provenance {
            format: Some(Format::Kalibr.name().to_owned()),
            files: used,
            part: None,
        },
    };
    Ok((set.validate().map_err(CalibError::invalid(path))?, notes))
}

/// The cameras of a file so far, in its order.
#[derive(Default)]
struct Chain {
    /// Number of cameras in the file.
    count: usize,
    cameras: Vec<NamedCamera>,
    /// Extrinsics and time offset of the IMU, from the first camera.
    imu: Option<SetImu>,
    notes: Vec<Note>,
}

impl Chain {
    /// Adds the next camera.
    fn add(&mut self, name: String, at: &At<'_>) -> Result<(), CalibError> {
        // An empty block after a camera's name means that the file is truncated.
        at.entries()?;
        let model = camera(at)?;
        at.get("intrinsics")?.reject_invalid_model(&model)?;
        self.check_overlaps(at)?;
        let chained = self.pose_by_chain(&name, at)?;
        let camera_from_imu = self.camera_from_imu(at)?;
        let through_imu = match (&self.imu, camera_from_imu) {
            (Some(imu), Some(camera_from_imu)) => Some(camera_from_imu * imu.imu_from_first),
            _ => None,
        };
        if let (Some(a), Some(b)) = (chained, through_imu) {
            let off = a * b.inverse();
            if off.distance_m() > SAME_PLACE || off.angle_rad() > SAME_PLACE {
                self.notes.push(Note(format!(
                    "{name}: T_cn_cnm1 and T_cam_imu differ by {:.3} mm and {:.4} degrees: the chain is taken",
                    1e3 * off.distance_m(),
                    off.angle_rad().to_degrees()
                )));
            }
        }
        let shift = at.find("timeshift_cam_imu").map(|at| at.number());
        self.add_imu(&name, camera_from_imu, shift.transpose()?);
        let camera_from_first = chained.or(through_imu);
        if camera_from_first.is_none() {
            self.notes.push(Note(format!(
                "{name} has neither T_cn_cnm1 nor T_cam_imu: its pose is unknown"
            )));
        }
        self.cameras.push(NamedCamera {
            name,
            model,
            camera_from_first,
        });
        Ok(())
    }

    fn check_overlaps(&mut self, at: &At<'_>) -> Result<(), CalibError> {
        let Some(overlaps) = at.find("cam_overlaps") else {
            return Ok(());
        };
        for other in overlaps.number_list()? {
            if other >= self.count as f64 {
                self.notes.push(Note(format!(
                    "{} names cam{other}, which the file does not have: was it cut off?",
                    overlaps.path()
                )));
            }
        }
        Ok(())
    }

    /// `camera_from_first` from the pose relative to the camera before.
    fn pose_by_chain(&self, name: &str, at: &At<'_>) -> Result<Option<RigidTransform>, CalibError> {
        if self.cameras.is_empty() {
            return Ok(Some(RigidTransform::identity()));
        }
        let Some(at) = at.find("T_cn_cnm1") else {
            return Ok(None);
        };
        let before = self.cameras.last().and_then(|c| c.camera_from_first);
        let here_from_before = rigid(&at)?;
        let here = before.map(|before| here_from_before * before);
        at.reject_if(here.as_ref().and_then(|here| too_far(name, here)))?;
        Ok(here)
    }

    fn camera_from_imu(&self, at: &At<'_>) -> Result<Option<RigidTransform>, CalibError> {
        let place = at.find_any(&["T_cam_imu", "T_imu_cam"]);
        let camera_from_imu = match (at.find("T_cam_imu"), at.find("T_imu_cam")) {
            (Some(at), _) => Some(rigid(&at)?),
            (None, Some(at)) => Some(rigid(&at)?.inverse()),
            (None, None) => None,
        };
        if let (Some(at), Some(camera_from_imu)) = (place, &camera_from_imu)
            && self.cameras.is_empty()
        {
            at.reject_if(too_far("the IMU", &camera_from_imu.inverse()))?;
        }
        Ok(camera_from_imu)
    }

    /// Takes the IMU of the first camera, and compares the time offsets of the others with its.
    fn add_imu(
        &mut self,
        name: &str,
        camera_from_imu: Option<RigidTransform>,
        time_offset_s: Option<f64>,
    ) {
        if self.cameras.is_empty() {
            self.imu = camera_from_imu.map(|camera_from_imu| SetImu {
                imu_from_first: camera_from_imu.inverse(),
                rate_hz: None,
                noise: None,
                time_offset_s,
                gyro_bias: None,
                accel_bias: None,
            });
        } else if let (Some(first), Some(here)) =
            (self.imu.and_then(|i| i.time_offset_s), time_offset_s)
            && first != here
        {
            self.notes.push(Note(format!(
                "{name}: timeshift_cam_imu is {here} s, of cam0 {first} s: that of cam0 is taken"
            )));
        }
    }
}

fn is_camera(key: &str) -> bool {
    key.strip_prefix("cam")
        .is_some_and(|number| !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit()))
}

/// Reads an `imu.yaml`: one block, or the block `imu0` of Kalibr's result.
///
/// # Errors
/// [`CalibError`].
pub fn read_imu(path: &Path) -> Result<ImuFile, CalibError> {
    let disk: &dyn Files = &Disk;
    imu_of(&disk.text(path)?)
}

fn imu_of(source: &Source) -> Result<ImuFile, CalibError> {
    let tree = yaml::parse(source)?;
    let root = At::root(source, &tree);
    let at = root.find("imu0").unwrap_or(root);
    let number = |key: &str| at.get(key)?.positive();
    Ok(ImuFile {
        noise: ImuNoise {
            gyro_noise_density: number("gyroscope_noise_density")?,
            gyro_random_walk: number("gyroscope_random_walk")?,
            accel_noise_density: number("accelerometer_noise_density")?,
            accel_random_walk: number("accelerometer_random_walk")?,
        },
        rate_hz: number("update_rate")?,
    })
}

/// An `imu.yaml` for Kalibr.
///
/// ```
/// use camera_models::ImuNoise;
/// use calibration_files::kalibr::{ImuFile, imu_text, read_imu};
///
/// let imu = ImuFile {
///     noise: ImuNoise {
///         gyro_noise_density: 1.7e-4,
///         gyro_random_walk: 1.9e-5,
///         accel_noise_density: 2e-3,
///         accel_random_walk: 3e-3,
///     },
///     rate_hz: 200.0,
/// };
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("imu.yaml");
/// std::fs::write(&path, imu_text(&imu))?;
/// assert_eq!(read_imu(&path)?, imu);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn imu_text(imu: &ImuFile) -> String {
    let n = &imu.noise;
    format!(
        "accelerometer_noise_density: {} # m/s^2/sqrt(Hz)\n\
         accelerometer_random_walk: {} # m/s^3/sqrt(Hz)\n\
         gyroscope_noise_density: {} # rad/s/sqrt(Hz)\n\
         gyroscope_random_walk: {} # rad/s^2/sqrt(Hz)\n\
         rostopic: /imu0\nupdate_rate: {} # Hz\n",
        number_text(n.accel_noise_density),
        number_text(n.accel_random_walk),
        number_text(n.gyro_noise_density),
        number_text(n.gyro_random_walk),
        number_text(imu.rate_hz)
    )
}

fn camera(at: &At<'_>) -> Result<CameraModel, CalibError> {
    let [width, height] = at.get("resolution")?.sizes()?;
    let model = at.get("camera_model")?;
    // This key distinguishes a pinhole from a lens whose distortion was lost.
    let said = match model.text()? {
        "pinhole" => Some(at.get("distortion_model")?),
        _ => at.find("distortion_model"),
    };
    let lens = match said {
        Some(lens) => lens.one_of(&["none", "radtan", "equidistant", "fov"])?,
        None => "none",
    };
    if let ("none", Some(coefficients)) = (lens, at.find("distortion_coeffs")) {
        coefficients.only_zeros("distortion_model none")?;
    }
    let intrinsics = at.get("intrinsics")?;
    let pinhole = |[fx, fy, cx, cy]: [f64; 4], distortion| {
        CameraModel::new((width, height), [fx, fy, cx, cy], distortion)
    };
    let alone = |what: &str| match lens {
        "none" => Ok(()),
        other => Err(model.wrong_because(
            &format!("{what} with {other}"),
            &format!("{what} without distortion (no model here is both)"),
        )),
    };
    match model.one_of(&["pinhole", "omni", "ds", "eucm"])? {
        "pinhole" => {
            let distortion = match lens {
                "none" => Distortion::None,
                "fov" => {
                    let lens = at.get("distortion_model")?;
                    return Err(
                        lens.wrong("none, radtan or equidistant (the FOV model is not read)")
                    );
                }
                lens => {
                    let [a, b, c, d] = at.get("distortion_coeffs")?.numbers()?;
                    if lens == "radtan" {
                        Distortion::RadTan4 {
                            k1: a,
                            k2: b,
                            p1: c,
                            p2: d,
                        }
                    } else {
                        Distortion::KannalaBrandt4 {
                            k1: a,
                            k2: b,
                            k3: c,
                            k4: d,
                        }
                    }
                }
            };
            Ok(pinhole(intrinsics.numbers()?, distortion))
        }
        "omni" => {
            let [xi, fx, fy, cx, cy] = intrinsics.numbers()?;
            let bent = match at.find("distortion_coeffs") {
                Some(coefficients) => coefficients.number_list()?.iter().any(|c| *c != 0.0),
                None => false,
            };
            if bent {
                alone("omni")?;
            }
            if xi < 0.0 {
                return Err(intrinsics.wrong_because(&format!("xi = {xi}"), "xi not below 0"));
            }
            let distortion = Distortion::Eucm {
                alpha: xi / (1.0 + xi),
                beta: 1.0,
            };
            Ok(pinhole(
                [fx / (1.0 + xi), fy / (1.0 + xi), cx, cy],
                distortion,
            ))
        }
        "ds" => {
            alone("ds")?;
            let [xi, alpha, fx, fy, cx, cy] = intrinsics.numbers()?;
            Ok(pinhole(
                [fx, fy, cx, cy],
                Distortion::DoubleSphere { xi, alpha },
            ))
        }
        _ => {
            alone("eucm")?;
            let [alpha, beta, fx, fy, cx, cy] = intrinsics.numbers()?;
            Ok(pinhole([fx, fy, cx, cy], Distortion::Eucm { alpha, beta }))
        }
    }
}

fn rigid(at: &At<'_>) -> Result<RigidTransform, CalibError> {
    RigidTransform::from_rows_4x4(at.numbers()?)
        .map_err(|error| at.wrong_because(&format!("a matrix where {error}"), "a rigid transform"))
}

fn write(set: &CameraSet) -> Result<FormatFiles, WriteError> {
    let mut text = String::new();
    let mut before: Option<RigidTransform> = None;
    for (number, camera) in set.cameras.iter().enumerate() {
        let m = &camera.model;
        let distortion = lens(&camera.name, &m.distortion, Format::Kalibr, MODELS)?;
        let here = required_pose(camera, Format::Kalibr)?;
        let coefficients = distortion.coefficients();
        let (model, own, lens, coefficients) = match distortion {
            Distortion::DoubleSphere { .. } => ("ds", &coefficients[..], "none", &[][..]),
            Distortion::Eucm { .. } => ("eucm", &coefficients[..], "none", &[][..]),
            Distortion::None => ("pinhole", &[][..], "none", &[][..]),
            Distortion::KannalaBrandt4 { .. } => {
                ("pinhole", &[][..], "equidistant", &coefficients[..])
            }
            _ => ("pinhole", &[][..], "radtan", &coefficients[..]),
        };
        let intrinsics = [own, &[m.fx, m.fy, m.cx, m.cy]].concat();
        let others: Vec<String> = (0..set.cameras.len())
            .filter(|i| *i != number)
            .map(|i| i.to_string())
            .collect();
        text.push_str(&format!(
            "cam{number}: # {}\n  cam_overlaps: [{}]\n  camera_model: {model}\n  intrinsics: [{}]\n  \
             distortion_model: {lens}\n  distortion_coeffs: [{}]\n  resolution: [{}, {}]\n  rostopic: \
             /cam{number}/image_raw\n",
            camera.name.replace(['\n', '\r'], " "),
            others.join(", "),
            number_texts(&intrinsics, ", "),
            number_texts(coefficients, ", "),
            m.width,
            m.height
        ));
        if let Some(before) = before {
            text.push_str(&matrix("T_cn_cnm1", &(here * before.inverse())));
        }
        if let Some(imu) = &set.imu {
            let camera_from_imu = here * imu.imu_from_first.inverse();
            text.push_str(&matrix("T_cam_imu", &camera_from_imu));
            if let Some(shift) = imu.time_offset_s {
                text.push_str(&format!("  timeshift_cam_imu: {}\n", number_text(shift)));
            }
        }
        before = Some(here);
    }
    let Some(imu) = &set.imu else {
        return Ok(FormatFiles::file("camchain.yaml", text));
    };
    let mut all = FormatFiles::file("camchain-imucam.yaml", text);
    match (imu.noise, imu.rate_hz) {
        (Some(noise), Some(rate_hz)) => {
            let text = imu_text(&ImuFile { noise, rate_hz });
            all.files.push(("imu.yaml".to_owned(), text.into_bytes()));
        }
        _ => all.notes.push(Note(
            "noise or rate of the IMU is not known: no imu.yaml".to_owned(),
        )),
    }
    Ok(all)
}

fn matrix(key: &str, b_from_a: &RigidTransform) -> String {
    let (r, t) = (b_from_a.rotation_rows(), b_from_a.translation_m());
    let rows: String = (0..3)
        .map(|i| {
            let row = [r[3 * i], r[3 * i + 1], r[3 * i + 2], t[i]];
            format!("  - [{}]\n", number_texts(&row, ", "))
        })
        .collect();
    format!("  {key}:\n{rows}  - [0.0, 0.0, 0.0, 1.0]\n")
}

#[cfg(test)]
mod tests;
