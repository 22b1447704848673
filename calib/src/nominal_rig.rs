//! Nominal calibration of a session's rig: intrinsics, extrinsics and their sigmas.
//!
//! Contract: intrinsics and `left_from_right` are those of the recorded factory calibrations;
//! `rig_from_left` is that of the session's rig file if there is one, else of the recorded
//! transforms. What neither gives is unknown. A named rig file is used alone: the recorded
//! transforms are relative to another rig frame.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result};
use cad_transforms::{Covariance, Frame, FramePart, Rig, RigidTransform};
use calib::cameras::ExtrinsicsPrior;
use camera_models::CameraModel;
use nalgebra::Matrix6;
use session_access::Frames;
use session_archive::reader::{Entry, SessionReader};
use session_archive::record::{CameraCalibration, FrameTransforms, Record};
use session_archive::verify::rig_file;

/// Default sigmas of camera mounts if the rig file states no tolerances, m and rad: machining
/// tolerances of a plate.
const MOUNTING_SIGMA: (f64, f64) = (1.5e-3, 5e-3);
/// Sigmas of `left_from_right` in a factory calibration, m and rad.
const RIGHT_EYE_SIGMA: (f64, f64) = (1e-4, 2e-3);

/// Nominal calibration of a rig.
pub(crate) struct NominalRig {
    /// First calibration of each eye, as in `feet/left`.
    calibrations: BTreeMap<String, CameraCalibration>,
    /// The recorded transforms.
    pub(crate) frames: Frames,
    /// The rig file with its name, where the session has one that can be read.
    pub(crate) rig: Option<(String, Rig)>,
    /// Error of the session's rig file, if it cannot be read.
    pub(crate) unreadable: Option<String>,
    /// Whether the rig file was named instead of taken from the session.
    is_named: bool,
}

impl NominalRig {
    /// Reads the nominal calibration of a session.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub(crate) fn read(reader: &SessionReader) -> Result<Self> {
        let manifest = reader.manifest();
        let mut unreadable = None;
        let rig = manifest.rig.iter().find_map(|file| {
            // Skip the ground truth of a simulated rig, and boards.
            let name = &file.name;
            if !name.ends_with(".toml") || name.starts_with("truth.") || name.starts_with("target.")
            {
                return None;
            }
            let read = || -> Result<Rig, String> {
                let bytes = rig_file(&**reader.storage(), file)
                    .ok_or("its bytes do not match the manifest")?;
                let text = std::str::from_utf8(&bytes).map_err(|e| e.to_string())?;
                Rig::parse(text).map_err(|e| e.to_string())
            };
            match read() {
                Ok(rig) => Some((name.clone(), rig)),
                Err(problem) => {
                    unreadable = Some(format!("reading rig/{name} of the session: {problem}"));
                    None
                }
            }
        });
        let mut nominal = Self {
            calibrations: BTreeMap::new(),
            frames: Frames::default(),
            rig,
            unreadable,
            is_named: false,
        };
        let schema = |id: u16| reader.stream(id).map(|s| s.schema.as_str());
        for entry in reader.entries() {
            let Entry::Message(m) = entry.context("reading the session")? else {
                continue;
            };
            if schema(m.stream) == Some(CameraCalibration::SCHEMA.name) {
                if let Ok(calibration) = m.decode::<CameraCalibration>() {
                    nominal
                        .calibrations
                        .insert(calibration.frame_id.clone(), calibration);
                }
            } else if schema(m.stream) == Some(FrameTransforms::SCHEMA.name)
                && let Ok(transforms) = m.decode::<FrameTransforms>()
            {
                nominal.frames = Frames::of(&transforms);
            }
            // Both are at the beginning of every segment.
            if nominal.calibrations.len() >= 2 * manifest.cameras.len()
                && !nominal.frames.is_empty()
            {
                break;
            }
        }
        Ok(nominal)
    }

    /// Replaces the session's rig file by a named one.
    ///
    /// # Errors
    /// It cannot be read.
    pub(crate) fn replace_rig_file(&mut self, path: &Path) -> Result<()> {
        let rig = Rig::read(path).context("reading the rig file of --rig")?;
        self.rig = Some((path.display().to_string(), rig));
        self.unreadable = None;
        self.is_named = true;
        Ok(())
    }

    /// The camera model of an eye, as in `feet/left`, if known.
    pub(crate) fn lens(&self, eye: &str) -> Option<CameraModel> {
        let c = self.calibrations.get(eye)?;
        camera_models::camera_info::lens([c.width, c.height], &c.distortion_model, &c.d, &c.k)
    }

    /// `rig_from_left` of a camera; that of the origin is fixed.
    pub(crate) fn rig_from_left(&self, camera: &str) -> Option<ExtrinsicsPrior> {
        let left = Frame::of_camera(camera, FramePart::Left).ok()?;
        let mut nominal = self.nominal(&Frame::rig(), &left, MOUNTING_SIGMA)?;
        let rig = self.rig.as_ref().map(|(_, rig)| rig);
        if rig.and_then(Rig::origin_camera) == Some(camera) {
            // Fixed by definition: otherwise the next revision would have no origin.
            nominal.covariance = Matrix6::zeros();
        }
        Some(nominal)
    }

    /// `left_from_right` of a camera, as recorded: from the factory calibration if there is one.
    pub(crate) fn left_from_right(&self, camera: &str) -> Option<ExtrinsicsPrior> {
        let left = format!("{camera}/left");
        let right = format!("{camera}/right");
        let transform = self.frames.transform(&left, &right)?;
        Some(ExtrinsicsPrior {
            transform,
            covariance: diagonal(RIGHT_EYE_SIGMA),
        })
    }

    fn nominal(
        &self,
        parent: &Frame,
        child: &Frame,
        otherwise: (f64, f64),
    ) -> Option<ExtrinsicsPrior> {
        if let Some((_, rig)) = &self.rig
            && let Ok(transform) = rig.transform(parent, child)
        {
            let covariance = rig.covariance(parent, child).ok().flatten();
            let covariance = covariance.map(|c| in_parent(&c, &transform));
            return Some(ExtrinsicsPrior {
                transform,
                covariance: covariance.unwrap_or(diagonal(otherwise)),
            });
        }
        if self.is_named {
            return None;
        }
        let transform = self.frames.transform(parent.as_str(), child.as_str())?;
        Some(ExtrinsicsPrior {
            transform,
            covariance: diagonal(otherwise),
        })
    }
}

/// Diagonal covariance with one sigma for translations and one for rotations.
fn diagonal((metres, radians): (f64, f64)) -> Matrix6<f64> {
    let (v, w) = (metres * metres, radians * radians);
    Matrix6::from_diagonal(&[v, v, v, w, w, w].into())
}

/// Block-diagonal rotation of `[v, ω]` from a child's axes to its parent's.
fn rotation_blocks(parent_from_child: &RigidTransform) -> Matrix6<f64> {
    let rotation = parent_from_child.rotation().to_rotation_matrix();
    let mut both = Matrix6::zeros();
    both.fixed_view_mut::<3, 3>(0, 0)
        .copy_from(rotation.matrix());
    both.fixed_view_mut::<3, 3>(3, 3)
        .copy_from(rotation.matrix());
    both
}

/// Covariance from the child's axes, as in rig files, to the parent's, as in the adjustment.
fn in_parent(covariance: &Covariance, parent_from_child: &RigidTransform) -> Matrix6<f64> {
    let turn = rotation_blocks(parent_from_child);
    turn * covariance.matrix() * turn.transpose()
}

/// Covariance from the parent's axes to the child's; `None` if it is not valid in a rig file.
pub(crate) fn in_child(
    covariance: &Matrix6<f64>,
    parent_from_child: &RigidTransform,
) -> Option<Covariance> {
    let turn = rotation_blocks(parent_from_child).transpose();
    let moved = turn * covariance * turn.transpose();
    let symmetric = 0.5 * (moved + moved.transpose());
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| symmetric[(i, j)]));
    Covariance::from_rows(rows).ok()
}

#[cfg(test)]
mod tests {
    use cad_transforms::rig::{CameraInfo, Edge, Provenance, ProvenanceKind, RigParts};
    use session_archive::record::{FrameTransform, Quaternion, Vector3};

    use super::*;

    /// A rig file of boards alone, its origin the camera `feet`; the recorded transforms have
    /// `chest` besides.
    fn nominal(is_named: bool) -> NominalRig {
        let rig = Rig::from_parts(RigParts {
            name: "calibrated rig".to_owned(),
            revision: "1".to_owned(),
            provenance: Provenance {
                kind: ProvenanceKind::Calibrated,
                note: "synthetic".to_owned(),
                cad: None,
            },
            cameras: vec![CameraInfo {
                name: "feet".to_owned(),
                serial: None,
                model: None,
            }],
            edges: vec![Edge {
                parent: Frame::rig(),
                child: Frame::of_camera("feet", FramePart::Left).unwrap(),
                parent_from_child: RigidTransform::body_from_optical(),
                covariance: Some(Covariance::from_sigmas([1e-6; 3], [1e-6; 3]).unwrap()),
            }],
            closures: Vec::new(),
            shoe_tags: Vec::new(),
            soles: Vec::new(),
        });
        let chest = FrameTransform {
            timestamp: None,
            parent_frame_id: "rig".to_owned(),
            child_frame_id: "chest/left".to_owned(),
            translation: Some(Vector3 {
                x: 0.1,
                y: 0.0,
                z: 0.3,
            }),
            rotation: Some(Quaternion {
                w: 1.0,
                x: 0.0,
                y: 0.0,
                z: 0.0,
            }),
        };
        NominalRig {
            calibrations: BTreeMap::new(),
            frames: Frames::of(&FrameTransforms {
                transforms: vec![chest],
            }),
            rig: Some(("rig.toml".to_owned(), rig.unwrap())),
            unreadable: None,
            is_named,
        }
    }

    #[test]
    fn camera_missing_in_a_named_rig_file_has_no_pose() {
        assert!(nominal(false).rig_from_left("chest").is_some());
        assert!(nominal(true).rig_from_left("chest").is_none());
        assert!(nominal(true).rig_from_left("feet").is_some());
    }

    #[test]
    fn origin_of_a_rig_is_fixed() {
        let origin = nominal(true).rig_from_left("feet").unwrap();
        assert_eq!(origin.covariance, Matrix6::zeros());
        let other = nominal(false).rig_from_left("chest").unwrap();
        assert_eq!(other.covariance, diagonal(MOUNTING_SIGMA));
    }
}
