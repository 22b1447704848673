//! What a session says of its rig: lenses, where eyes sit, and how far that may be off.
//!
//! Contract: lenses and right eyes are those of the recorded calibrations, which are the makers', places of cameras those of the
//! session's rig file where it has one, else those of the recorded transforms. What neither says stays unknown. A rig
//! file that is named stands alone: the recorded transforms are in the frame of another rig.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result};
use cad_transforms::{Covariance, Frame, FramePart, Rig, RigidTransform};
use calib::CameraModel;
use calib::cameras::Told;
use nalgebra::Matrix6;
use session_archive::reader::{Entry, SessionReader};
use session_archive::record::{CameraCalibration, FrameTransforms, Record};
use session_archive::verify::rig_file;

use crate::frame_tree::Frames;

/// Where the rig file says nothing of tolerances: m and rad, as plates come from a workshop.
const MOUNTING_SIGMA: (f64, f64) = (1.5e-3, 5e-3);
/// How far a maker's placement of the right eye may be off, m and rad.
const RIGHT_EYE_SIGMA: (f64, f64) = (1e-4, 2e-3);

/// What is known of the rig.
pub struct NominalRig {
    /// First calibration of each eye, as in `feet/left`.
    calibrations: BTreeMap<String, CameraCalibration>,
    /// The recorded transforms.
    pub frames: Frames,
    /// The rig file with its name, where the session has one that can be read.
    pub rig: Option<(String, Rig)>,
    /// What is wrong with the session's rig file, where there is one that cannot be read.
    pub unreadable: Option<String>,
    /// Whether the rig file is not the session's but was named.
    is_named: bool,
}

impl NominalRig {
    /// What a session says.
    ///
    /// # Errors
    /// The disk says no.
    pub fn read(reader: &SessionReader) -> Result<Self> {
        let manifest = reader.manifest();
        let mut unreadable = None;
        let rig = manifest.rig.iter().find_map(|file| {
            // What is true of a simulated rig is not what is told of it, and boards are no rigs.
            let name = &file.name;
            if !name.ends_with(".toml") || name.starts_with("truth.") || name.starts_with("target.")
            {
                return None;
            }
            let read = || -> Result<Rig, String> {
                let bytes = rig_file(&**reader.storage(), file)
                    .ok_or("its bytes are not those that the manifest tells of")?;
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
            // Both are written at the beginning of every segment.
            if nominal.calibrations.len() >= 2 * manifest.cameras.len()
                && !nominal.frames.is_empty()
            {
                break;
            }
        }
        Ok(nominal)
    }

    /// Takes a rig file that was named in the place of the session's.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn start_from(&mut self, path: &Path) -> Result<()> {
        let rig = Rig::read(path).context("reading the rig file of --rig")?;
        self.rig = Some((path.display().to_string(), rig));
        self.unreadable = None;
        self.is_named = true;
        Ok(())
    }

    /// The lens of an eye, as in `feet/left`; none where it is not known.
    pub fn lens(&self, eye: &str) -> Option<CameraModel> {
        let c = self.calibrations.get(eye)?;
        calib::foxglove::lens([c.width, c.height], &c.distortion_model, &c.d, &c.k)
    }

    /// `rig_from_left` of a camera; that of the origin is held.
    pub fn rig_from_left(&self, camera: &str) -> Option<Told> {
        let left = Frame::of_camera(camera, FramePart::Left).ok()?;
        let mut nominal = self.nominal(&Frame::rig(), &left, MOUNTING_SIGMA)?;
        let rig = self.rig.as_ref().map(|(_, rig)| rig);
        if rig.and_then(Rig::origin_camera) == Some(camera) {
            // It stays where it is by definition, or the next revision would have no origin.
            nominal.covariance = Matrix6::zeros();
        }
        Some(nominal)
    }

    /// `left_from_right` of a camera: as recorded, which is the maker's calibration where there is one.
    pub fn left_from_right(&self, camera: &str) -> Option<Told> {
        let left = format!("{camera}/left");
        let right = format!("{camera}/right");
        let transform = self.frames.transform(&left, &right)?;
        Some(Told {
            transform,
            covariance: even(RIGHT_EYE_SIGMA),
        })
    }

    fn nominal(&self, parent: &Frame, child: &Frame, otherwise: (f64, f64)) -> Option<Told> {
        if let Some((_, rig)) = &self.rig
            && let Ok(transform) = rig.transform(parent, child)
        {
            let covariance = rig.covariance(parent, child).ok().flatten();
            let covariance = covariance.map(|c| in_parent(&c, &transform));
            return Some(Told {
                transform,
                covariance: covariance.unwrap_or(even(otherwise)),
            });
        }
        if self.is_named {
            return None;
        }
        let transform = self.frames.transform(parent.as_str(), child.as_str())?;
        Some(Told {
            transform,
            covariance: even(otherwise),
        })
    }
}

/// A covariance with one sigma for translations and one for rotations.
fn even((metres, radians): (f64, f64)) -> Matrix6<f64> {
    let (v, w) = (metres * metres, radians * radians);
    Matrix6::from_diagonal(&[v, v, v, w, w, w].into())
}

/// Blocks that turn `[v, ω]` from a child's axes to its parent's.
fn rotation_blocks(parent_from_child: &RigidTransform) -> Matrix6<f64> {
    let rotation = parent_from_child.rotation().to_rotation_matrix();
    let mut both = Matrix6::zeros();
    both.fixed_view_mut::<3, 3>(0, 0)
        .copy_from(rotation.matrix());
    both.fixed_view_mut::<3, 3>(3, 3)
        .copy_from(rotation.matrix());
    both
}

/// From the child's axes, which rig files use, to the parent's, which the adjustment uses.
fn in_parent(covariance: &Covariance, parent_from_child: &RigidTransform) -> Matrix6<f64> {
    let turn = rotation_blocks(parent_from_child);
    turn * covariance.matrix() * turn.transpose()
}

/// From the parent's axes to the child's; none for a covariance that cannot be written.
pub fn in_child(
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

    /// A rig file of boards alone, its origin the camera `feet`; the recorded transforms have `chest` besides.
    fn nominal(is_named: bool) -> NominalRig {
        let rig = Rig::from_parts(RigParts {
            name: "calibrated rig".to_owned(),
            revision: "1".to_owned(),
            provenance: Provenance {
                kind: ProvenanceKind::Calibrated,
                note: "made up".to_owned(),
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
    fn a_camera_that_a_named_rig_file_lacks_is_not_placed_in_the_frame_of_another() {
        assert!(nominal(false).rig_from_left("chest").is_some());
        assert!(nominal(true).rig_from_left("chest").is_none());
        assert!(nominal(true).rig_from_left("feet").is_some());
    }

    #[test]
    fn the_origin_of_a_rig_is_held() {
        let origin = nominal(true).rig_from_left("feet").unwrap();
        assert_eq!(origin.covariance, Matrix6::zeros());
        let other = nominal(false).rig_from_left("chest").unwrap();
        assert_eq!(other.covariance, even(MOUNTING_SIGMA));
    }
}
