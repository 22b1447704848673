//! Intrinsics, stereo extrinsics and the rig: from a folder that `paws calib cameras` wrote, else
//! from the session.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result};
use cad_transforms::{Frame, FramePart, Rig, RigidTransform};
use camera_models::{CameraModel, StereoCalibration};
use session_archive::manifest::{Camera, Manifest};

use crate::cameras::{RIG, file_of};
use crate::nominal_rig::NominalRig;

/// Calibration inputs; see the module.
pub(super) struct Inputs<'a> {
    nominal: &'a NominalRig,
    /// Stereo calibrations by camera, for cameras with a file in the folder.
    pairs: BTreeMap<String, StereoCalibration>,
    /// The folder's rig file.
    rig: Option<Rig>,
}

impl<'a> Inputs<'a> {
    /// # Errors
    /// A folder was named and its rig file, or a file of a camera in it, cannot be read.
    pub(super) fn read(
        nominal: &'a NominalRig,
        folder: Option<&Path>,
        manifest: &Manifest,
    ) -> Result<Self> {
        let mut inputs = Self {
            nominal,
            pairs: BTreeMap::new(),
            rig: None,
        };
        let Some(folder) = folder else {
            return Ok(inputs);
        };
        let rig = folder.join(RIG);
        inputs.rig = Some(Rig::read(&rig).with_context(|| {
            format!(
                "--calibration: expected what `paws calib cameras` writes in {}",
                folder.display()
            )
        })?);
        for Camera {
            name,
            width,
            height,
            ..
        } in &manifest.cameras
        {
            let file = folder.join(file_of(name));
            if file.exists() {
                // Images of a session are side-by-side stereo.
                let (pair, _) = calibration_files::read_stereo(&file, width / 2, *height)?;
                inputs.pairs.insert(name.clone(), pair);
            }
        }
        Ok(inputs)
    }

    /// Camera model and `eye_from_left` of each eye.
    ///
    /// # Errors
    /// The intrinsics of an eye are unknown.
    pub(super) fn lenses(&self, camera: &str) -> Result<Vec<(CameraModel, RigidTransform)>> {
        if let Some(pair) = self.pairs.get(camera) {
            return Ok(vec![
                (pair.left, RigidTransform::identity()),
                (pair.right, pair.right_from_left),
            ]);
        }
        let frame = |eye: &str| format!("{camera}/{eye}");
        let lens = |eye: &str| {
            let lens = self.nominal.lens(&frame(eye));
            lens.with_context(|| {
                format!(
                    "the session has no known intrinsics of {camera}/{eye}: `paws calib cameras` estimates them, \
                     and --calibration DIR names its output"
                )
            })
        };
        let mut lenses = vec![(lens("left")?, RigidTransform::identity())];
        let frames = &self.nominal.frames;
        if let Some(right) = frames.transform(&frame("right"), &frame("left")) {
            lenses.push((lens("right")?, right));
        }
        Ok(lenses)
    }

    /// Nominal `imu_from_left`, if known.
    pub(super) fn imu_from_left(&self, camera: &str) -> Option<RigidTransform> {
        let frame = |part| Frame::of_camera(camera, part).ok();
        let (imu, left) = (frame(FramePart::Imu)?, frame(FramePart::Left)?);
        let by_rig = self
            .rig
            .as_ref()
            .and_then(|rig| rig.transform(&imu, &left).ok());
        by_rig.or_else(|| self.nominal.frames.transform(imu.as_str(), left.as_str()))
    }

    /// The rig file to start from, or why there is none.
    pub(super) fn rig(&self) -> Result<&Rig, &str> {
        match (&self.rig, &self.nominal.rig, &self.nominal.unreadable) {
            (Some(rig), ..) | (None, Some((_, rig)), _) => Ok(rig),
            (None, None, Some(problem)) => Err(problem),
            (None, None, None) => Err(
                "the session has no rig file to start from; `paws calib cameras` writes one, and --calibration DIR names it",
            ),
        }
    }
}
