//! Content of a calibration file of any format: one or more named cameras, their extrinsics, and
//! the IMU.
//!
//! Contract: the first camera is the reference, so that its pose is the identity. A camera whose
//! pose is not in the file has none; nothing is assumed. Intrinsics are finite and valid, and no
//! two sensors are farther apart than 10 m (a file in millimetres is rejected, not scaled).

use cad_transforms::RigidTransform;

use crate::camera::CameraModel;
use crate::imu::{ImuCalibration, ImuNoise};
use crate::note::Note;
use crate::plausibility::{InvalidCalibration, MAX_USUAL_BASELINE_M, swapped, too_far, wide};
use crate::stereo::{Provenance, StereoCalibration};

/// The cameras of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSet {
    /// The cameras in the order of the file, at least one.
    pub cameras: Vec<NamedCamera>,
    /// The IMU, if the file contains one.
    pub imu: Option<SetImu>,
    /// Source of the calibration.
    pub provenance: Provenance,
}

/// One camera of a set.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCamera {
    /// Name in the file, for example `cam0` or `left`.
    pub name: String,
    /// Image size and intrinsics.
    pub model: CameraModel,
    /// Takes points in the first camera's optical frame to this one's, metres.
    pub camera_from_first: Option<RigidTransform>,
}

/// The IMU of a set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetImu {
    /// Takes points in the first camera's optical frame to the IMU's frame, metres.
    pub imu_from_first: RigidTransform,
    /// Nominal rate, Hz.
    pub rate_hz: Option<f64>,
    /// Noise model.
    pub noise: Option<ImuNoise>,
    /// Added to a camera's time to get the IMU's, seconds (Kalibr's `timeshift_cam_imu`, Basalt's
    /// `cam_time_offset_ns`).
    pub time_offset_s: Option<f64>,
    /// Bias to subtract from the measured angular rate, rad/s.
    pub gyro_bias: Option<[f64; 3]>,
    /// Bias to subtract from the measured specific force, m/s².
    pub accel_bias: Option<[f64; 3]>,
}

impl CameraSet {
    /// The cameras of a stereo calibration, as `left` and `right`.
    pub fn of_stereo(stereo: &StereoCalibration) -> Self {
        let camera = |name: &str, model, camera_from_first| NamedCamera {
            name: name.to_owned(),
            model,
            camera_from_first: Some(camera_from_first),
        };
        Self {
            cameras: vec![
                camera("left", stereo.left, RigidTransform::identity()),
                camera("right", stereo.right, stereo.right_from_left),
            ],
            imu: stereo.imu.map(|imu| SetImu {
                imu_from_first: imu.imu_from_left,
                rate_hz: Some(imu.rate_hz),
                noise: imu.noise,
                time_offset_s: None,
                gyro_bias: None,
                accel_bias: None,
            }),
            provenance: stereo.provenance.clone(),
        }
    }

    /// Two of the cameras as a stereo calibration: the named ones, otherwise those with `left` and
    /// `right` in their names, otherwise the first two.
    ///
    /// # Errors
    /// [`InvalidCalibration::Missing`] without such cameras or their pose,
    /// [`InvalidCalibration::Implausible`] if left and right are swapped.
    ///
    /// ```
    /// use cad_transforms::RigidTransform;
    /// use camera_models::{CameraModel, CameraSet, Distortion, NamedCamera, StereoCalibration};
    /// # use camera_models::Provenance;
    ///
    /// let model = CameraModel::new((640, 480), [500.0, 500.0, 319.5, 239.5], Distortion::None);
    /// let camera = |name: &str, x: f64| -> Result<NamedCamera, Box<dyn std::error::Error>> {
    ///     let camera_from_first = Some(RigidTransform::from_translation_m([x, 0.0, 0.0])?);
    ///     Ok(NamedCamera { name: name.to_owned(), model, camera_from_first })
    /// };
    /// let set = CameraSet {
    ///     cameras: vec![camera("cam0", 0.0)?, camera("cam1", -0.1)?, camera("cam2", -0.3)?],
    ///     imu: None,
    ///     provenance: Provenance { format: None, files: Vec::new(), part: None },
    /// };
    /// let (outer, _notes) = set.stereo(Some(["cam0", "cam2"]))?;
    /// assert!((outer.baseline_m() - 0.3).abs() < 1e-12);
    /// // The other way round the right camera is on the left.
    /// assert!(set.stereo(Some(["cam2", "cam0"])).is_err());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn stereo(
        &self,
        pair: Option<[&str; 2]>,
    ) -> Result<(StereoCalibration, Vec<Note>), InvalidCalibration> {
        let missing = |what: String| InvalidCalibration::Missing {
            what,
            found: format!("cameras {}", self.names().join(", ")),
        };
        let [left, right] = match pair {
            Some(names) => {
                let index = |name: &str| {
                    self.cameras
                        .iter()
                        .position(|c| c.name == name)
                        .ok_or_else(|| missing(format!("camera {name}")))
                };
                [index(names[0])?, index(names[1])?]
            }
            None => self
                .left_and_right()
                .ok_or_else(|| missing("a second camera".to_owned()))?,
        };
        let from_first = |i: usize| {
            self.cameras[i]
                .camera_from_first
                .ok_or_else(|| missing(format!("the pose of camera {}", self.cameras[i].name)))
        };
        let left_from_first = from_first(left)?;
        let right_from_first = from_first(right)?;
        let mut notes = Vec::new();
        if self.cameras.len() > 2 {
            notes.push(Note(format!(
                "of {} cameras, {} and {} are used",
                self.cameras.len(),
                self.cameras[left].name,
                self.cameras[right].name
            )));
        }
        // For the first camera the pose is exact, without arithmetic.
        let from_left = |b_from_first: RigidTransform| {
            if left == 0 {
                b_from_first
            } else {
                b_from_first * left_from_first.inverse()
            }
        };
        let imu = self.imu.and_then(|imu| match imu.rate_hz {
            Some(rate_hz) => Some(ImuCalibration {
                imu_from_left: from_left(imu.imu_from_first),
                rate_hz,
                noise: imu.noise,
            }),
            None => {
                notes.push(Note(
                    "the IMU's rate is not known: the IMU is left out".to_owned(),
                ));
                None
            }
        });
        let stereo = StereoCalibration {
            left: self.cameras[left].model,
            right: self.cameras[right].model,
            right_from_left: from_left(right_from_first),
            imu,
            provenance: self.provenance.clone(),
        }
        .validate()?;
        notes.extend(wide(stereo.baseline_m()));
        Ok((stereo, notes))
    }

    /// The names of the cameras.
    pub fn names(&self) -> Vec<&str> {
        self.cameras.iter().map(|c| c.name.as_str()).collect()
    }

    fn left_and_right(&self) -> Option<[usize; 2]> {
        self.named_pair()
            .or((self.cameras.len() >= 2).then_some([0, 1]))
    }

    /// The one camera with `left` and the one with `right` in its name.
    fn named_pair(&self) -> Option<[usize; 2]> {
        let named = |word: &str| {
            let mut with = (0..self.cameras.len())
                .filter(|&i| self.cameras[i].name.to_ascii_lowercase().contains(word));
            with.next().filter(|_| with.next().is_none())
        };
        match (named("left"), named("right")) {
            (Some(left), Some(right)) if left != right => Some([left, right]),
            _ => None,
        }
    }

    /// Notes on implausible poses of the cameras.
    ///
    /// # Errors
    /// [`InvalidCalibration::Implausible`] if cameras called left and right are swapped. Two
    /// cameras with other names may be anywhere, so for them it is a note.
    pub fn plausibility_notes(&self) -> Result<Vec<Note>, InvalidCalibration> {
        let mut notes = Vec::new();
        for NamedCamera {
            name,
            camera_from_first,
            ..
        } in &self.cameras
        {
            let metres = camera_from_first.map_or(0.0, |t| t.distance_m());
            if metres > MAX_USUAL_BASELINE_M {
                notes.push(Note(format!(
                    "{name} is {metres} m from the first camera: is the file in metres?"
                )));
            }
        }
        let b_from_a = |a: usize, b: usize| {
            let [a, b] = [a, b].map(|i| self.cameras[i].camera_from_first);
            Some(b? * a?.inverse())
        };
        if let Some([left, right]) = self.named_pair() {
            if let Some(reason) = b_from_a(left, right).as_ref().and_then(swapped) {
                return Err(InvalidCalibration::Implausible { reason });
            }
        } else if let [first, second] = &self.cameras[..]
            && b_from_a(0, 1).as_ref().and_then(swapped).is_some()
        {
            notes.push(Note(format!(
                "{} sits to the right of {}: are they swapped?",
                first.name, second.name
            )));
        }
        Ok(notes)
    }

    /// The set itself if its values are valid.
    ///
    /// # Errors
    /// [`InvalidCalibration`] without a camera, and for impossible intrinsics, poses or numbers of
    /// the IMU.
    pub fn validate(self) -> Result<Self, InvalidCalibration> {
        let implausible = |reason: String| InvalidCalibration::Implausible { reason };
        if self.cameras.is_empty() {
            return Err(InvalidCalibration::Missing {
                what: "a camera".to_owned(),
                found: "none".to_owned(),
            });
        }
        for camera in &self.cameras {
            if let Some(reason) = camera.model.invalid_reason() {
                return Err(implausible(format!("camera {}: {reason}", camera.name)));
            }
        }
        let placed = self
            .cameras
            .iter()
            .filter_map(|c| Some((c.name.as_str(), c.camera_from_first?)))
            .chain(self.imu.map(|imu| ("the IMU", imu.imu_from_first)));
        for (name, transform) in placed {
            if let Some(reason) = too_far(name, &transform) {
                return Err(implausible(reason));
            }
        }
        if let Some(imu) = &self.imu {
            let numbers = [imu.rate_hz, imu.time_offset_s].into_iter().flatten();
            let biases = imu.gyro_bias.into_iter().chain(imu.accel_bias).flatten();
            if numbers.chain(biases).any(|n| !n.is_finite()) {
                return Err(implausible("a number of the IMU is not finite".to_owned()));
            }
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Distortion;

    fn set(names: &[&str], offsets_x: &[f64]) -> CameraSet {
        let model = CameraModel {
            width: 640,
            height: 480,
            fx: 500.0,
            fy: 500.0,
            cx: 320.0,
            cy: 240.0,
            distortion: Distortion::None,
        };
        CameraSet {
            cameras: names
                .iter()
                .zip(offsets_x)
                .map(|(name, x)| NamedCamera {
                    name: (*name).to_owned(),
                    model,
                    camera_from_first: Some(
                        RigidTransform::from_translation_m([*x, 0.0, 0.0]).unwrap(),
                    ),
                })
                .collect(),
            imu: None,
            provenance: Provenance {
                format: None,
                files: Vec::new(),
                part: None,
            },
        }
    }

    #[test]
    fn the_pair_is_chosen_by_name_or_number() {
        let by_name = set(&["cam_right", "cam_left"], &[0.0, 0.1]);
        let (stereo, notes) = by_name.stereo(None).unwrap();
        assert_eq!(stereo.right_from_left.translation_m(), [-0.1, 0.0, 0.0]);
        assert!(notes.is_empty());

        let three = set(&["cam0", "cam1", "cam2"], &[0.0, -0.1, -0.3]);
        let (stereo, notes) = three.stereo(None).unwrap();
        assert_eq!(stereo.baseline_m(), 0.1);
        assert_eq!(notes[0].0, "of 3 cameras, cam0 and cam1 are used");
        let (stereo, _) = three.stereo(Some(["cam1", "cam2"])).unwrap();
        assert!((stereo.baseline_m() - 0.2).abs() < 1e-15);

        let error = |result: Result<(StereoCalibration, Vec<Note>), InvalidCalibration>| {
            result.unwrap_err().to_string()
        };
        assert!(error(three.stereo(Some(["cam1", "cam9"]))).contains("camera cam9 is missing"));
        assert!(error(three.stereo(Some(["cam1", "cam0"]))).contains("left and right swapped"));
        assert!(error(set(&["a"], &[0.0]).stereo(None)).contains("a second camera is missing"));
        let mut unplaced = three.clone();
        unplaced.cameras[1].camera_from_first = None;
        assert!(error(unplaced.stereo(None)).contains("the pose of camera cam1 is missing"));
    }

    #[test]
    fn impossible_numbers_are_rejected() {
        let error = |set: CameraSet| set.validate().unwrap_err().to_string();
        assert!(error(set(&[], &[])).contains("a camera is missing"));
        assert!(error(set(&["a", "b"], &[0.0, -63.0])).contains("b is 63 m from the first camera"));
        let mut bad = set(&["a"], &[0.0]);
        bad.cameras[0].model.fx = f64::NAN;
        assert!(error(bad).contains("camera a: an intrinsic is not a finite number"));
    }
}
