//! Stage `rig`: the rig as used by later stages.
//!
//! Contract: intrinsics are those of the recorded calibrations; extrinsics those of the session's
//! rig file, or, for parts that it does not name or if it cannot be read, of the recorded
//! transforms, which have the makers' calibrations. Command-line overrides take precedence over
//! both. IMUs with complete data come before those without. A camera without intrinsics or
//! extrinsics is a loss, and so is an IMU without extrinsics; a rig without any camera is an error.
//! Noise of IMUs is an override, or that of the recorded calibration, or that of known devices;
//! values that sessions do not hold (range of IMUs, rolling shutters) are overrides, or those of
//! known devices, with a note.

use std::collections::BTreeMap;

use cad_transforms::Rig;
use cad_transforms::frame::FramePart;
use cad_transforms::rig::Foot;
use camera_models::{CameraModel, Provenance, StereoCalibration, camera_info};
use scene_bundle::outputs::rig::{RigCamera, RigImu, RigModel, RigShoe, RigShoeTag};
use scene_bundle::outputs::{self, RIG};
use serde::Serialize;
use serde_json::{Value, json};
use session_archive::index::ImuIndex;
use session_archive::layout;
use session_archive::manifest::Camera;
use video::raw_image::coded_size;

use crate::input::{HANDOFF, Input};
use crate::pipeline::{Report, Stage, StageError, Work};

mod devices;
mod part_poses;

use self::part_poses::PartPoses;

/// Minimum coverage of the primary IMU, as a ratio of the best-covered IMU's time.
const MIN_IMU_COVERAGE: f64 = 0.9;

/// Calibration that overrides that of the session.
#[derive(Clone, Debug, Default)]
pub struct RigOverrides {
    /// A rig file: its text.
    pub rig: Option<String>,
    /// Calibrations of cameras, by name.
    pub calibrations: BTreeMap<String, StereoCalibration>,
    /// Readout line times of cameras, s, by name.
    pub line_times_s: BTreeMap<String, f64>,
    /// The files that these values were read from.
    pub files: Vec<OverrideFile>,
}

/// A file given in addition to the session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct OverrideFile {
    /// Its name, without the folder.
    pub file: String,
    /// BLAKE3 of its bytes, hex.
    pub blake3: String,
}

/// See the module.
pub(super) struct RigStage {
    pub(super) rig_overrides: RigOverrides,
}

impl Stage<Input> for RigStage {
    fn name(&self) -> &'static str {
        "rig"
    }

    fn version(&self) -> u32 {
        5
    }

    fn inputs(&self) -> &'static [&'static str] {
        &[HANDOFF]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[RIG]
    }

    fn settings(&self) -> Value {
        let RigOverrides {
            rig,
            calibrations,
            line_times_s,
            files,
        } = &self.rig_overrides;
        // The folder of a calibration does not matter.
        let lenses: BTreeMap<&String, Value> = (calibrations.iter())
            .map(|(name, c)| {
                let place = json!({
                    "left": c.left,
                    "right": c.right,
                    "right_from_left": c.right_from_left,
                    "imu": c.imu,
                });
                (name, place)
            })
            .collect();
        let mut settings = json!({
            "rig": rig,
            "calibrations": lenses,
            "lines_s": line_times_s,
        });
        // Absent if nothing is given, as before this key was introduced.
        if !files.is_empty() {
            settings["given"] = json!(files);
        }
        settings
    }

    fn run(&self, work: &Work<'_, Input>) -> Result<(), StageError> {
        let (model, report) = model(work.source(), &self.rig_overrides)?;
        report.notes.into_iter().for_each(|note| work.note(note));
        report
            .losses
            .into_iter()
            .for_each(|loss| work.record_loss(loss));
        outputs::rig::write(work.draft(RIG), &model)?;
        Ok(())
    }
}

/// Error of the stage `rig`.
#[derive(Debug, thiserror::Error)]
pub enum RigStageError {
    /// The given file is not a rig file: correct it.
    #[error("reading the given rig file")]
    RigFile(#[source] cad_transforms::rig::RigError),
    /// An override names a camera that the session does not have: correct the name.
    #[error(
        "applying calibration overrides: the session has no camera {found:?}, expected one of {known}"
    )]
    Unknown {
        /// The name.
        found: String,
        /// All names.
        known: String,
    },
    /// The intrinsics are for images of another size: calibrate at this one.
    #[error(
        "the lens of {eye} is for {found}, expected {expected}, the size of the images: give a \
         calibration for this size (--calibration)"
    )]
    Size {
        /// Camera side.
        eye: String,
        /// Size that the intrinsics are for.
        found: String,
        /// Size of the images.
        expected: String,
    },
    /// No camera has both intrinsics and extrinsics: give calibrations, or record with them.
    #[error(
        "no camera of the session has intrinsics and a pose on the rig: {}; to fix it: {}",
        .0,
        command_line::remedy::after_recording()
    )]
    NoCamera(String),
}

/// Name and revision of the session's rig, or of the given rig file.
pub fn revision(input: &Input, rig_overrides: &RigOverrides) -> scene_bundle::RigRevision {
    let parsed = rig_overrides
        .rig
        .as_deref()
        .and_then(|text| Rig::parse(text).ok());
    let rig = parsed.or_else(|| rig_file(input, &mut Report::default()));
    let of = |text: fn(&Rig) -> &str| rig.as_ref().map_or("unknown", text).to_owned();
    scene_bundle::RigRevision {
        name: of(Rig::name),
        revision: of(Rig::revision),
    }
}

/// The rig of a session, with notes and losses.
///
/// # Errors
/// [`RigStageError`].
pub fn model(
    input: &Input,
    rig_overrides: &RigOverrides,
) -> Result<(RigModel, Report), RigStageError> {
    check_names(input, rig_overrides)?;
    let mut report = Report::default();
    for OverrideFile { file, blake3 } in &rig_overrides.files {
        let note = format!(
            "given in addition to the session, with precedence over its content: {file}, blake3 {blake3}"
        );
        report.notes.push(note);
    }
    let parse = |text: &String| Rig::parse(text).map_err(RigStageError::RigFile);
    let rig = match rig_overrides.rig.as_ref().map(parse).transpose()? {
        Some(rig) => Some(rig),
        None => rig_file(input, &mut report),
    };
    let part_poses = PartPoses::new(rig.as_ref(), input, &mut report);
    let sources = Sources {
        input,
        rig_overrides,
        rig: rig.as_ref(),
        part_poses,
    };
    let cameras = sources.cameras(&mut report)?;
    let mut imus = sources.imus(&mut report);
    let coverage_s: BTreeMap<&str, f64> = (input.index().imus.iter())
        .map(|imu| (imu.name.as_str(), imu_coverage_s(imu)))
        .collect();
    order_by_coverage(&mut imus, &coverage_s, &mut report);
    let revision = revision(input, rig_overrides);
    let model = RigModel {
        name: revision.name,
        revision: revision.revision,
        cameras,
        imus,
        shoes: rig.as_ref().map(shoes).unwrap_or_default(),
    };
    Ok((model, report))
}

/// Shoes of a rig file, the left one first.
pub fn shoes(rig: &Rig) -> Vec<RigShoe> {
    let of_foot = |foot: Foot| {
        let tags = rig.shoe_tags().iter().filter(|tag| tag.foot == foot);
        let sole = rig.soles().iter().find(|sole| sole.foot == foot);
        RigShoe {
            foot,
            outline_m: sole.map(|sole| sole.outline_m.clone()).unwrap_or_default(),
            outline_sigma_m: sole.and_then(|sole| sole.sigma_m),
            tags: tags
                .map(|tag| RigShoeTag {
                    family: tag.family,
                    id: tag.id,
                    size_m: tag.size_m,
                    size_sigma_m: tag.size_sigma_m,
                    foot_from_tag: tag.foot_from_tag,
                    foot_from_tag_covariance: tag.covariance,
                })
                .collect(),
        }
    };
    let shoes = Foot::ALL.map(of_foot).into_iter();
    let is_known = |shoe: &RigShoe| !(shoe.tags.is_empty() && shoe.outline_m.is_empty());
    shoes.filter(is_known).collect()
}

/// What the rig is made from.
struct Sources<'a> {
    input: &'a Input,
    rig_overrides: &'a RigOverrides,
    rig: Option<&'a Rig>,
    part_poses: PartPoses<'a>,
}

impl Sources<'_> {
    /// The cameras with intrinsics and a pose; a note if some are left out.
    ///
    /// # Errors
    /// There is none, or the intrinsics are those of another size of images.
    fn cameras(&self, report: &mut Report) -> Result<Vec<RigCamera>, RigStageError> {
        let all = &self.input.manifest().cameras;
        let mut cameras = Vec::new();
        for camera in all {
            cameras.extend(self.camera(camera, report)?);
        }
        if cameras.is_empty() {
            return Err(RigStageError::NoCamera(report.losses.join("; ")));
        }
        if cameras.len() < all.len() {
            let note = format!(
                "cameras without intrinsics or a pose are left out; to use them: {}",
                command_line::remedy::after_recording()
            );
            report.notes.push(note);
        }
        Ok(cameras)
    }

    /// A camera; `None`, with a loss, if its intrinsics or its pose are not known.
    fn camera(
        &self,
        camera: &Camera,
        report: &mut Report,
    ) -> Result<Option<RigCamera>, RigStageError> {
        let name = camera.name.as_str();
        let size = [camera.width / 2, camera.height];
        let calibration = self.rig_overrides.calibrations.get(name);
        let eye = |eye: &str, given: Option<CameraModel>| {
            let recorded = || {
                let c = self.input.calibration(&format!("{name}/{eye}"))?;
                camera_info::lens([c.width, c.height], &c.distortion_model, &c.d, &c.k)
            };
            given.or_else(recorded)
        };
        let left = eye("left", calibration.map(|c| c.left));
        let right = eye("right", calibration.map(|c| c.right));
        let right_from_left = match calibration {
            Some(calibration) => Some((calibration.right_from_left, None)),
            None => self
                .part_poses
                .transform(name, FramePart::Right, FramePart::Left),
        };
        let rig_from_left = self.part_poses.on_rig(name, FramePart::Left);
        let (Some(left), Some(right)) = (left, right) else {
            report
                .losses
                .push(format!("camera {name}: its intrinsics are not known"));
            return Ok(None);
        };
        let (Some((right_from_left, stereo_covariance)), Some((rig_from_left, covariance))) =
            (right_from_left, rig_from_left)
        else {
            let loss = format!("camera {name}: its pose on the rig is not known");
            report.losses.push(loss);
            return Ok(None);
        };
        let left = of_size(&format!("{name}/left"), left, size, report)?;
        let right = of_size(&format!("{name}/right"), right, size, report)?;
        let line_s = self.rig_overrides.line_times_s.get(name).copied();
        let line_s =
            line_s.unwrap_or_else(|| devices::line_s(device(self.rig, name), camera, report));
        Ok(Some(RigCamera {
            name: name.to_owned(),
            left,
            right,
            rig_from_left,
            rig_from_left_covariance: covariance,
            right_from_left,
            right_from_left_covariance: stereo_covariance,
            line_s,
        }))
    }

    /// The IMUs with a pose; a loss for each other, and a note.
    fn imus(&self, report: &mut Report) -> Vec<RigImu> {
        let all = &self.input.manifest().imus;
        let mut imus = Vec::new();
        for imu in all {
            let name = imu.name.as_str();
            let (camera, _) = name.rsplit_once('/').unwrap_or((name, ""));
            let calibrations = &self.rig_overrides.calibrations;
            let given = calibrations.get(camera).and_then(|c| c.imu);
            let placed = match given {
                Some(imu) => self
                    .part_poses
                    .on_rig(camera, FramePart::Left)
                    .map(|(rig_from_left, _)| (rig_from_left * imu.imu_from_left.inverse(), None)),
                None => self.part_poses.on_rig(camera, FramePart::Imu),
            };
            let Some((rig_from_imu, covariance)) = placed else {
                let loss = format!("IMU {name}: its pose on the rig is not known");
                report.losses.push(loss);
                continue;
            };
            let known = devices::imu(device(self.rig, camera), &imu.source);
            let noise = given.and_then(|imu| imu.noise);
            imus.push(RigImu {
                name: name.to_owned(),
                rig_from_imu,
                rig_from_imu_covariance: covariance,
                rate_hz: (imu.rate_hz > 0.0).then_some(imu.rate_hz),
                noise: Some(noise.unwrap_or_else(|| known.noise(imu, report))),
                range: known.range,
            });
        }
        if imus.len() < all.len() {
            let note = format!(
                "IMUs without a pose are left out; to use them: `{}`, then `{}`",
                command_line::remedy::CALIBRATE_IMUS,
                command_line::remedy::RECONSTRUCT
            );
            report.notes.push(note);
        }
        imus
    }
}

/// Total time covered by an IMU's samples, s.
fn imu_coverage_s(imu: &ImuIndex) -> f64 {
    let batches = imu.batches.iter();
    batches.map(|b| (b.end_ns - b.start_ns) as f64 * 1e-9).sum()
}

/// The odometry uses the first IMU that has samples, and another one only when that is silent: an
/// IMU with less coverage of the session than another comes after it. Otherwise the order of the
/// rig is kept.
fn order_by_coverage(
    imus: &mut [RigImu],
    imu_coverage_s: &BTreeMap<&str, f64>,
    report: &mut Report,
) {
    let of = |imu: &RigImu| {
        imu_coverage_s
            .get(imu.name.as_str())
            .copied()
            .unwrap_or(0.0)
    };
    let Some(first) = imus.first().map(|imu| imu.name.clone()) else {
        return;
    };
    let most = imus.iter().map(of).fold(0.0, f64::max);
    imus.sort_by_key(|imu| of(imu) < MIN_IMU_COVERAGE * most);
    if imus[0].name != first {
        report.notes.push(format!(
            "IMU {} has samples for {:.1} s and {first} for {:.1} s: the odometry prefers the former",
            imus[0].name,
            of(&imus[0]),
            imu_coverage_s.get(first.as_str()).copied().unwrap_or(0.0)
        ));
    }
}

/// The rig as input of the odometry.
pub fn odometry_rig(model: &RigModel) -> odometry::Rig {
    let camera = |camera: &RigCamera| odometry::rig::StereoCamera {
        name: camera.name.clone(),
        left: camera.left,
        right: camera.right,
        rig_from_left: camera.rig_from_left,
        covariance: (camera.rig_from_left_covariance.as_ref()).map(|c| *c.matrix()),
        right_from_left: camera.right_from_left,
        right_from_left_covariance: (camera.right_from_left_covariance.as_ref())
            .map(|c| *c.matrix()),
        line_s: camera.line_s,
    };
    let imu = |imu: &RigImu| odometry::rig::Imu {
        name: imu.name.clone(),
        rig_from_imu: imu.rig_from_imu,
        noise: imu.noise.unwrap_or(devices::UNKNOWN_NOISE),
        rate_hz: imu.rate_hz.unwrap_or(devices::UNKNOWN_RATE_HZ),
        range: imu.range.unwrap_or([f64::INFINITY; 2]),
    };
    odometry::Rig {
        cameras: model.cameras.iter().map(camera).collect(),
        imus: model.imus.iter().map(imu).collect(),
    }
}

/// Stereo calibration of one camera of it.
pub fn calibration(camera: &RigCamera) -> StereoCalibration {
    StereoCalibration {
        left: camera.left,
        right: camera.right,
        right_from_left: camera.right_from_left,
        imu: None,
        provenance: Provenance {
            format: None,
            files: Vec::new(),
            part: None,
        },
    }
}

/// The maker's name of a camera's model, as the rig file has it.
fn device<'a>(rig: Option<&'a Rig>, camera: &str) -> Option<&'a str> {
    let infos = rig?.camera_infos();
    let info = infos.iter().find(|info| info.name == camera)?;
    info.model.as_deref()
}

/// The rig file that was in force when the session was recorded.
fn rig_file(input: &Input, report: &mut Report) -> Option<Rig> {
    for file in &input.manifest().rig {
        let name = &file.name;
        // Files with the ground truth of a simulated rig are not its nominal calibration, and board
        // files are not rigs.
        let is_other = name.starts_with("truth.") || name.starts_with("target.");
        if !name.ends_with(".toml") || is_other {
            continue;
        }
        match Rig::read(&input.root().join(layout::rig_file(name))) {
            Ok(rig) => return Some(rig),
            Err(error) => {
                let error = error.to_string().replace('\n', " ");
                let note = format!("rig/{name} of the session cannot be read: {error}");
                report.notes.push(note);
            }
        }
    }
    None
}

fn check_names(input: &Input, rig_overrides: &RigOverrides) -> Result<(), RigStageError> {
    let manifest = input.manifest();
    let cameras: Vec<&str> = manifest.cameras.iter().map(|c| c.name.as_str()).collect();
    for name in rig_overrides
        .calibrations
        .keys()
        .chain(rig_overrides.line_times_s.keys())
    {
        if !cameras.contains(&name.as_str()) {
            return Err(RigStageError::Unknown {
                found: name.clone(),
                known: cameras.join(", "),
            });
        }
    }
    Ok(())
}

/// The intrinsics of images of this size. Recorders of before repeated an odd last row or column:
/// such an image is one pixel larger than its calibration, and coordinates in it are the same.
///
/// # Errors
/// The intrinsics are for images of another size.
fn of_size(
    eye: &str,
    lens: CameraModel,
    [width, height]: [u32; 2],
    report: &mut Report,
) -> Result<CameraModel, RigStageError> {
    if (lens.width, lens.height) == (width, height) {
        return Ok(lens);
    }
    let found = format!("{}x{}", lens.width, lens.height);
    if coded_size(lens.width, lens.height) != (width, height) {
        return Err(RigStageError::Size {
            eye: eye.to_owned(),
            found,
            expected: format!("{width}x{height}"),
        });
    }
    report.notes.push(format!(
        "{eye}: its calibration is for {found}, and its images are {width}x{height} with the last \
         row or column repeated, as recorders of before did with odd sizes: it is used for them"
    ));
    Ok(CameraModel {
        width,
        height,
        ..lens
    })
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;

    use super::*;

    #[test]
    fn calibration_fits_the_images_or_their_padding() {
        use camera_models::Distortion;

        let lens = |size| CameraModel::new(size, [700.0, 700.0, 600.0, 180.0], Distortion::None);
        let check = |calibrated, recorded| {
            let mut report = Report::default();
            let lens = of_size("feet/left", lens(calibrated), recorded, &mut report);
            (
                lens.map(|lens| [lens.width, lens.height]),
                report.notes.len(),
            )
        };
        for size in [(1241, 376), (1242, 375)] {
            let (found, notes) = check(size, [1242, 376]);
            assert_eq!((found.expect("its padding"), notes), ([1242, 376], 1));
        }
        let (found, notes) = check((1241, 375), [1241, 375]);
        assert_eq!((found.expect("its size"), notes), ([1241, 375], 0));
        for (calibrated, recorded) in [
            ((1242, 376), [1241, 376]),
            ((1240, 376), [1242, 376]),
            ((1241, 376), [1243, 376]),
        ] {
            let error = check(calibrated, recorded).0.expect_err("another size");
            assert!(error.to_string().contains("feet/left is for"), "{error}");
        }
    }

    #[test]
    fn an_imu_with_little_coverage_is_not_the_first() {
        let imu = |name: &str| RigImu {
            name: name.to_owned(),
            rig_from_imu: RigidTransform::identity(),
            rig_from_imu_covariance: None,
            rate_hz: None,
            noise: None,
            range: None,
        };
        let order = |coverage_s: [f64; 3]| {
            let mut imus = ["a", "b", "c"].map(imu);
            let coverage_s = ["a", "b", "c"].into_iter().zip(coverage_s).collect();
            let mut report = Report::default();
            order_by_coverage(&mut imus, &coverage_s, &mut report);
            (imus.map(|i| i.name).concat(), report.notes.len())
        };
        assert_eq!(order([59.8, 60.0, 60.0]), ("abc".to_owned(), 0));
        assert_eq!(order([20.0, 60.0, 59.9]), ("bca".to_owned(), 1));
        assert_eq!(order([0.0, 0.0, 7.0]), ("cab".to_owned(), 1));
        assert_eq!(order([0.0; 3]), ("abc".to_owned(), 0));
    }
}
